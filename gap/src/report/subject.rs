//! What a report is about: data set, date, robot, and what was not stated of it.

use files::dataset::{Bench, Command, Manifest, Motion, Robot};

use super::words::{capital, floor_explained, listed, quantity, range, size};
use crate::bench::missing;
use crate::sentence::{Cause, causes, sentence, sure_of, unsure};
use crate::verdict::{Verdict, Word};
use crate::vocabulary::Effect;

/// The data set that a verdict is about.
#[derive(Debug, Clone, PartialEq)]
pub struct Subject {
    /// Name of the data set.
    pub name: String,
    /// Day on which the files of the recordings were written, if known.
    pub date: Option<String>,
    /// A robot with six joints, or one joint on a bench.
    pub robot: bool,
    /// The joint of a bench is linear: m and N in place of rad and N m.
    pub linear: bool,
    /// Runs of the data set.
    pub runs: usize,
    /// What the data set does not state of a bench.
    pub unstated: Vec<&'static str>,
    /// So little is stated that names of causes are tentative.
    pub tentative: bool,
    /// What the error before is the error of.
    pub before: String,
}

/// What a bench does not state.
fn unstated(b: &Bench) -> Vec<&'static str> {
    let strength = b.effort_per_volt.is_some() || b.max_effort.is_some();
    let gains = b.controller.kp.is_some();
    let position = b.command == Command::Position;
    let all = [
        ("inertia", b.inertia.is_some()),
        (
            "supply voltage",
            b.supply_v.is_some() || b.command == Command::Effort,
        ),
        ("motor strength", strength || b.command == Command::Effort),
        ("controller gains", gains || !position),
    ];
    let missing = all.iter().filter(|x| !x.1).map(|x| x.0);
    missing.collect()
}

impl Subject {
    /// Of the data set of `manifest`, whose files are of `date`.
    #[must_use]
    pub fn new(manifest: &Manifest, date: Option<String>) -> Self {
        let robot = manifest.robot == Robot::Metamodule;
        let bench = &manifest.bench;
        // Without these keys no cause of a joint is certain.
        let first = if robot { Vec::new() } else { missing(manifest) };
        let tentative = !first.is_empty();
        let mut unstated = if robot { Vec::new() } else { unstated(bench) };
        if tentative && unstated.is_empty() {
            unstated = first;
        }
        let ideal = bench.command == Command::Position && bench.controller.kp.is_none();
        let before = match (robot, &manifest.model) {
            (true, Some(file)) => format!("the nominal model in {file}"),
            (true, None) => "the shipped nominal model".into(),
            (false, _) if ideal && bench.max_effort.is_none() => {
                "a joint that follows its set-point exactly, since its controller is not stated"
                    .into()
            }
            (false, _) => "a model with the stated values, the others fitted".into(),
        };
        Self {
            name: manifest.name.clone(),
            date,
            robot,
            linear: !robot && bench.motion == Motion::Linear,
            runs: manifest.runs.len(),
            unstated,
            tentative,
            before,
        }
    }

    /// Data set, date, robot and number of runs, as one line.
    pub(super) fn line(&self) -> String {
        let kind = match (self.robot, self.linear) {
            (true, _) => "robot of two modules, six joints",
            (false, true) => "one linear joint on a bench",
            (false, false) => "one joint on a bench",
        };
        let runs = if self.runs == 1 { "run" } else { "runs" };
        let date = self.date.as_ref().map(|d| format!(", files of {d}"));
        format!("{kind}, {} {runs}{}", self.runs, date.unwrap_or_default())
    }

    /// What to state, as the words of a list.
    fn missing(&self, joined_by: &str) -> String {
        listed(&self.unstated, self.unstated.len(), joined_by)
    }

    /// The sentence on top.
    pub(super) fn lead(&self, v: &Verdict) -> String {
        if v.sentence.is_empty() {
            self.careful(v, sentence(v, self.robot))
        } else {
            v.sentence.clone()
        }
    }

    /// The sentence `text` of the verdict. Where too little is stated it says what to state first, and claims no certainty.
    pub(crate) fn careful(&self, v: &Verdict, text: String) -> String {
        if !self.tentative || v.verdict == Word::None {
            return text;
        }
        let missing = self.missing("and");
        let text = unsure(&text, v);
        let mut letters = text.chars();
        let first = letters.next().map(|c| c.to_ascii_lowercase());
        let rest: String = first.into_iter().chain(letters).collect();
        format!(
            "State {missing} under [bench] first: without them no cause is certain. Tentatively, {rest}"
        )
    }

    /// What to do now, most useful first; never empty.
    pub(super) fn next(&self, v: &Verdict) -> Vec<String> {
        let mut out = Vec::new();
        if self.tentative {
            let missing = self.missing("and");
            out.push(format!(
                "State this first: {missing}, under [bench] of dataset.toml. Data sheet values are enough."
            ));
        }
        if let Some(n) = &v.next_experiment {
            out.push(n.text.clone());
        }
        let asked = |text: &str| out.iter().any(|o| o.contains(text));
        let classes = v
            .ambiguous
            .iter()
            .map(|a| a.separate_by.trim_end_matches('.'));
        let more: Vec<String> = classes
            .filter(|text| !text.is_empty() && !asked(text))
            .map(|text| format!("{}.", capital(text)))
            .collect();
        for text in more {
            if !out.contains(&text) {
                out.push(text);
            }
        }
        if !self.tentative && !self.unstated.is_empty() && v.verdict != Word::None {
            let missing = self.missing("and");
            out.push(format!(
                "State {missing} too, under [bench] of dataset.toml."
            ));
        }
        if out.is_empty() {
            out.push(match v.verdict {
                Word::None => "Nothing is to be done for these motions. Record other motions, or add signals, to look for effects that these could not show.".into(),
                _ => "Put the found values into the simulator (`rb-host gap report --patch`), and check it on a motion that is not in this data set.".into(),
            });
        }
        out
    }

    /// Effect and sizes in a few words: `dry friction in the gear (joint 2), 0.499 N m`.
    pub(super) fn headline(&self, c: &Cause<'_>) -> String {
        let mut out = c.noun(self.robot);
        let sizes = c.sizes(c.effect());
        if let [(key, ends)] = sizes.as_slice()
            && !["sign", "permutation"].contains(key)
        {
            out = format!("{out}, {}", size(key, *ends, self.linear));
        }
        out
    }

    /// The sentences of the registry with the values found, where they fill them.
    pub(super) fn filled(&self, c: &Cause<'_>) -> Option<String> {
        let joints = c.joints();
        let whom = if self.robot {
            crate::sentence::joints(&joints)
        } else {
            "the joint".into()
        };
        let one = |effect: &Effect| {
            let mut out = effect.info().sentence.replace("{joints}", &whom);
            for (key, ends) in c.sizes(*effect) {
                out = out.replace(&format!("{{{key}}}"), &size(key, ends, self.linear));
            }
            (!out.contains('{')).then(|| capital(&out))
        };
        let all: Option<Vec<String>> = c.effects().iter().map(one).collect();
        all.map(|all| all.join(" "))
    }

    /// How sure a card is of its cause.
    pub(super) fn sure_of(&self, v: &Verdict, c: &Cause<'_>) -> Option<String> {
        match self.tentative {
            true => Some("Not certain: too little is stated.".into()),
            false => sure_of(v, c),
        }
    }

    /// Before, after and floor in one unit.
    pub(super) fn distance(&self, v: &Verdict) -> String {
        let g = &v.gap;
        let [from, to] = range([g.before, g.after], &g.unit);
        let floor = quantity(g.floor, &g.unit);
        format!("{from} to {to}; {} {floor}", floor_explained(v))
    }

    /// The causes as headlines, with the number of other readings.
    pub(super) fn which(&self, v: &Verdict) -> Vec<String> {
        let one = |c: &Cause<'_>| match c.members.as_slice() {
            [] => self.headline(c),
            [other] => format!("{}, or {}", self.headline(c), other.plain()),
            others => format!("{}, or {} others", self.headline(c), others.len()),
        };
        causes(v).iter().map(one).collect()
    }
}
