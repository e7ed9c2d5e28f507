//! What a verdict says: causes as people count them, places with their shares, and the sentence on top.
//!
//! Sentence, picture, cards and staircase of a report all read these, so that they cannot contradict each other.

use std::collections::BTreeSet;

use crate::report::words::{listed, quantity, range};
use crate::verdict::{EffectRow, Gap, Verdict, Word};
use crate::vocabulary::{Compound, Effect, Stage};

/// Causes named before the rest is counted.
const NAMED: usize = 3;
/// Joints of a robot.
const JOINTS: usize = 6;

/// `joint 2`, `joints 1, 2 and 4`, `all six joints`.
pub(crate) fn joints(which: &[usize]) -> String {
    let names: Vec<String> = which.iter().map(ToString::to_string).collect();
    match which {
        [one] => format!("joint {one}"),
        all if all.len() == JOINTS => "all six joints".into(),
        _ => format!("joints {}", listed(&names, JOINTS, "and")),
    }
}

/// One cause: an effect at all joints that have it, or the effects of a compound.
pub(crate) struct Cause<'a> {
    /// Rows of the verdict, at least one.
    pub(crate) rows: Vec<&'a EffectRow>,
    /// What the recordings cannot distinguish it from, most probable first.
    pub(crate) members: Vec<Effect>,
}

impl Cause<'_> {
    /// Its effect; of a compound the first.
    pub(crate) fn effect(&self) -> Effect {
        self.rows[0].effect
    }

    /// Its effects.
    pub(crate) fn effects(&self) -> Vec<Effect> {
        let mut out: Vec<Effect> = self.rows.iter().map(|r| r.effect).collect();
        out.dedup();
        out
    }

    /// As a noun, without a place.
    pub(crate) fn plain(&self) -> &'static str {
        let compound = self.rows[0].part_of.map(Compound::plain);
        compound.unwrap_or(self.effect().plain())
    }

    /// Joints that have it; none where the whole robot has it.
    pub(crate) fn joints(&self) -> Vec<usize> {
        let all: BTreeSet<usize> = self.rows.iter().filter_map(|r| r.joint).collect();
        all.into_iter().collect()
    }

    pub(crate) fn plausible(&self) -> bool {
        self.rows.iter().all(|r| r.plausible)
    }

    /// The effect as a noun, with its joints on a robot, and with a mark where the size found is not plausible.
    pub(crate) fn noun(&self, robot: bool) -> String {
        let (mut noun, which) = (self.plain().to_owned(), self.joints());
        if robot && !which.is_empty() {
            noun = format!("{noun} ({})", joints(&which));
        }
        if !self.plausible() {
            noun.push_str(" (no plausible size)");
        }
        noun
    }

    /// Key of every parameter of an effect with the smallest and the largest value over the joints.
    pub(crate) fn sizes(&self, of: Effect) -> Vec<(&str, [f64; 2])> {
        let rows = || self.rows.iter().filter(|r| r.effect == of);
        let keys = rows().take(1).flat_map(|r| r.parameters.keys());
        let ends = |key: &String| {
            let own = rows().filter_map(|r| r.parameters.get(key));
            own.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], p| {
                [a.min(p.value), b.max(p.value)]
            })
        };
        keys.map(|k| (k.as_str(), ends(k))).collect()
    }

    /// Rivals that every joint's recordings rule out, and the others that are not in the class.
    pub(crate) fn rivals(&self) -> [Vec<Effect>; 2] {
        let all: BTreeSet<Effect> = self
            .rows
            .iter()
            .flat_map(|r| r.alternatives.iter().map(|a| a.effect))
            .filter(|e| !self.members.contains(e))
            .collect();
        let ruled_out = |e: &Effect| {
            let own = self.rows.iter().flat_map(|r| &r.alternatives);
            own.filter(|a| a.effect == *e).all(|a| a.distinguishable)
        };
        let (out, open): (Vec<Effect>, Vec<Effect>) = all.into_iter().partition(ruled_out);
        [out, open]
    }
}

/// The causes of a verdict in its order: equal effects at several joints are one, and those of a compound.
pub(crate) fn causes(v: &Verdict) -> Vec<Cause<'_>> {
    let mut out: Vec<Cause<'_>> = Vec::new();
    for row in &v.effects {
        let same = |c: &&mut Cause<'_>| match row.part_of {
            Some(compound) => c.rows[0].part_of == Some(compound),
            None => c.rows[0].part_of.is_none() && c.effect() == row.effect,
        };
        match out.iter_mut().find(same) {
            Some(c) => c.rows.push(row),
            None => out.push(Cause {
                rows: vec![row],
                members: Vec::new(),
            }),
        }
    }
    for class in &v.ambiguous {
        let first = class.members.first().map(|m| (m.effect, m.joint));
        let own = |c: &&mut Cause<'_>| c.rows.iter().any(|r| Some((r.effect, r.joint)) == first);
        let Some(cause) = out.iter_mut().find(own) else {
            continue;
        };
        for e in &class.effects {
            if *e != cause.effect() && !cause.members.contains(e) {
                cause.members.push(*e);
            }
        }
    }
    out
}

/// What a share of the gap belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A cause that is named acts here, or what nothing explains arises here.
    Cause,
    /// What calibration of stated and default values explains.
    Calibrated,
    /// What stays.
    Rest,
}

/// A place with its share of the gap.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Spot {
    /// `None` is what stays.
    pub(crate) stage: Option<Stage>,
    /// None where a stage is the whole robot's.
    pub(crate) joints: Vec<usize>,
    pub(crate) share: f64,
    pub(crate) kind: Kind,
}

/// The stage of a place; `None` is what stays.
pub(crate) fn stage(name: &str) -> Option<Stage> {
    Stage::ALL.into_iter().find(|s| s.name() == name)
}

/// All places, the largest first; a cause has one even where its share rounds to nothing.
pub(crate) fn spots(v: &Verdict) -> Vec<Spot> {
    let named = |s: Option<Stage>, joint: Option<usize>| {
        let acts =
            |r: &EffectRow| Some(r.effect.stage()) == s && (r.joint == joint || joint.is_none());
        v.effects.iter().any(acts)
    };
    let mut out: Vec<Spot> = Vec::new();
    for w in &v.place {
        let stage = stage(&w.stage);
        let kind = match stage {
            None => Kind::Rest,
            _ if v.verdict != Word::Unknown && named(stage, w.joint) => Kind::Cause,
            _ => Kind::Calibrated,
        };
        out.push(Spot {
            stage,
            joints: stage.and(w.joint).into_iter().collect(),
            share: w.share,
            kind,
        });
    }
    if v.verdict != Word::Unknown {
        for r in &v.effects {
            let (stage, joint) = (Some(r.effect.stage()), r.joint);
            let own: Vec<usize> = joint.into_iter().collect();
            let here = |s: &Spot| s.stage == stage && (s.joints == own || s.joints.is_empty());
            if !out.iter().any(here) {
                out.push(Spot {
                    stage,
                    joints: own,
                    share: 0.0,
                    kind: Kind::Cause,
                });
            }
        }
    }
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    let suspect = out.iter_mut().find(|s| s.stage.is_some());
    if let (Word::Unknown, Some(s)) = (v.verdict, suspect) {
        s.kind = Kind::Cause;
    }
    out
}

/// The same with the joints of one stage together, where causes act in them.
pub(crate) fn together(all: &[Spot]) -> Vec<Spot> {
    let mut out: Vec<Spot> = Vec::new();
    for spot in all {
        let same = |s: &&mut Spot| s.kind == Kind::Cause && s.stage == spot.stage;
        match out
            .iter_mut()
            .find(same)
            .filter(|_| spot.kind == Kind::Cause)
        {
            Some(first) => {
                first.joints.extend(&spot.joints);
                first.joints.sort_unstable();
                first.share += spot.share;
            }
            None => out.push(spot.clone()),
        }
    }
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    out
}

/// Stages in which the causes act by other readings that the recordings leave open.
pub(crate) fn perhaps(v: &Verdict) -> Vec<Stage> {
    let causes = causes(v);
    let named: Vec<Stage> = causes.iter().map(|c| c.effect().stage()).collect();
    let others = causes.iter().flat_map(|c| &c.members).map(|e| e.stage());
    let open: BTreeSet<Stage> = others.filter(|s| !named.contains(s)).collect();
    open.into_iter().collect()
}

/// A stage as people call it.
pub(crate) const fn part(stage: Stage) -> &'static str {
    match stage {
        Stage::Conventions => "wiring, signs and zeros",
        Stage::Cpg => "gait generator",
        Stage::Transport => "set-point transport",
        Stage::Driver => "controller",
        Stage::Electrical => "motor",
        Stage::Supply => "supply",
        Stage::Drivetrain => "gear and load",
        Stage::Transmission => "gear play and twist",
        Stage::Body => "body and ground",
        Stage::Camera => "camera",
    }
}

/// A place as people call it.
pub(crate) fn place(stage: Option<Stage>, which: &[usize], robot: bool) -> String {
    let name = stage.map_or("what stays", part);
    if robot && !which.is_empty() {
        format!("{name} of {}", joints(which))
    } else {
        name.into()
    }
}

/// How sure the verdict is of what it says, in per cent that never claims to be certain.
pub(crate) fn sure(v: &Verdict) -> String {
    let p = v.probabilities;
    percent(match v.verdict {
        Word::None => p.none,
        Word::Unknown => p.unknown,
        // Calibration alone has no row that carries its probability.
        _ => 1.0 - p.none - p.unknown,
    })
}

/// A probability.
pub(crate) fn percent(p: f64) -> String {
    match (100.0 * p).round() {
        x if x >= 100.0 => "over 99 %".into(),
        x if x < 1.0 => "under 1 %".into(),
        x => format!("{x:.0} %"),
    }
}

/// How far the held-out error falls, and how much of that calibration does alone.
pub(crate) fn fall(gap: &Gap) -> String {
    let percent = |after: f64| (100.0 * (1.0 - after / gap.before.max(f64::MIN_POSITIVE))).round();
    let (all, calibrated) = (percent(gap.after), percent(gap.after_calibration));
    if all <= 0.0 {
        return "The held-out error does not fall by it".into();
    }
    let [from, to] = range([gap.before, gap.after], &gap.unit);
    let fall = format!("The held-out error falls from {from} to {to}");
    // Half of it is no small part.
    if 2.0 * calibrated >= all {
        format!(
            "{fall}, to {} by calibration alone",
            quantity(gap.after_calibration, &gap.unit)
        )
    } else {
        fall
    }
}

/// Where a gap arises that nothing explains.
fn suspect(v: &Verdict, robot: bool) -> String {
    let spots = spots(v);
    let first = spots.iter().find(|s| s.kind == Kind::Cause);
    first.map_or_else(
        || "place unknown".into(),
        |s| place(s.stage, &s.joints, robot),
    )
}

/// The sentence `text` of the verdict without how sure it is: for one that stands on too little.
pub(crate) fn unsure(text: &str, v: &Verdict) -> String {
    let sure = sure(v);
    text.replace(&format!(" ({sure} sure)"), "")
        .replace(&format!(" ({sure} sure that it is one of them)"), "")
}

/// How sure the verdict is of a cause that it names, in the figure of the sentence on top.
pub(crate) fn sure_of(v: &Verdict, c: &Cause<'_>) -> Option<String> {
    let (sure, alone) = (sure(v), causes(v).len() == 1);
    match v.verdict {
        // The causes there may be imitations.
        Word::Unknown => None,
        _ if !alone => Some(format!("{sure} sure of all causes together.")),
        _ if c.members.is_empty() => Some(format!("{sure} sure.")),
        _ => Some(format!("{sure} sure that it is one of them.")),
    }
}

/// The sentence on top, of a `robot` or of a joint on a bench.
pub(crate) fn sentence(v: &Verdict, robot: bool) -> String {
    let (causes, sure, fall) = (causes(v), sure(v), fall(&v.gap));
    let nouns: Vec<String> = causes.iter().map(|c| c.noun(robot)).collect();
    let list = listed(&nouns, NAMED, "and");
    let mut out = match (v.verdict, causes.as_slice()) {
        (Word::None, _) => {
            format!(
                "The model explains the recordings as well as they can be explained: no gap to name ({sure} sure)."
            )
        }
        (Word::Unknown, _) => format!(
            "No effect of the library explains the gap ({sure} sure); look first at the {}.",
            suspect(v, robot)
        ),
        (Word::PartlyExplained, []) => {
            format!(
                "No cause is named: calibration explains a part of the gap, a remainder stays. {fall}."
            )
        }
        (_, []) => format!("Calibration of known values explains the gap ({sure} sure). {fall}."),
        (word, some) => {
            let from = match word {
                Word::PartlyExplained => "A part of the gap comes from",
                _ => "The gap comes from",
            };
            match some {
                [one] if !one.members.is_empty() => {
                    let mut all = nouns;
                    all.extend(one.members.iter().map(|e| e.plain().to_owned()));
                    let list = listed(&all, NAMED + 1, "or");
                    format!(
                        "{from} {list}, which these recordings cannot distinguish ({sure} sure that it is one of them). {fall}."
                    )
                }
                _ => format!("{from} {list} ({sure} sure). {fall}."),
            }
        }
    };
    if v.verdict == Word::PartlyExplained && !causes.is_empty() {
        out.push_str(" A remainder stays.");
    }
    if let [_, _, ..] = causes.as_slice() {
        let open = causes.iter().filter(|c| !c.members.is_empty());
        let names: Vec<&str> = open.map(Cause::plain).collect();
        if !names.is_empty() {
            let list = listed(&names, NAMED, "and");
            out.push_str(&format!(
                " The recordings leave other readings of {list}; see the cards."
            ));
        }
    }
    out
}

/// How far the body of a robot without a gap still ends off, where that is more than `least` times what its start
/// explains.
pub(crate) fn body_off(gap: &Gap, least: f64) -> Option<String> {
    let off = gap.metric == "pose_rmse_m" && gap.after > least * gap.floor;
    off.then(|| {
        format!(
            " The body ends {} off after 1 s where its measured start explains {}: as much as contacts of different simulators differ by.",
            quantity(gap.after, &gap.unit),
            quantity(gap.floor, &gap.unit)
        )
    })
}
