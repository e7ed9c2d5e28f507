//! The verdict `rb.gap/1` of a joint.

use std::collections::BTreeMap;

use super::diagnosis::{Diagnosis, metrics};
use super::library::Kind;
use super::rows::Word as Found;
use super::{Explained, shown};
use crate::candidates::{base_effect, nominal, pull};
use crate::decide::{Calibration, LEVEL};
use crate::joint::{Channel, P};
use crate::locate;
use crate::names;
use crate::sentence::sentence;
use crate::verdict::causes::{self as parts, Part};
use crate::verdict::*;
use crate::vocabulary::{Compound, Effect, Stage};
use crate::whole::Row;

/// A stated number beyond so many tolerances is told.
const FAR: f64 = 3.0;

/// Effects that a cause of a joint is made of: a compound is several.
fn effects_of(row: &Row, supply_v: f64) -> Vec<Part> {
    let joint = row.joints.first().copied();
    let part = |effect: Effect, from: &str, to: &str, unit: f64| -> Part {
        let own = row.values.get(from).map(|v| {
            let estimate = Estimate {
                value: unit * v.value,
                ci95: v.ci95.map(|end| unit * end),
            };
            (to.to_owned(), estimate)
        });
        (effect, joint, own.into_iter().collect())
    };
    match row.effect.and_then(Compound::from_name) {
        Some(Compound::Payload) => vec![
            part(Effect::GravityLoad, "ratio", "ratio", 1.0),
            part(Effect::Inertia, "inertia_ratio", "ratio", 1.0),
        ],
        Some(Compound::WeakBattery) => vec![
            part(Effect::SupplyVoltage, "supply_ratio", "value_v", supply_v),
            part(Effect::SupplySag, "resistance_ohm", "resistance_ohm", 1.0),
        ],
        None => row.parts(),
    }
}

/// What is made into a verdict.
struct Told<'a> {
    d: &'a Diagnosis,
    e: &'a Explained<'a>,
    calibration: &'a Calibration,
    seed: u64,
}

pub(super) fn verdict(
    d: &Diagnosis,
    e: &Explained<'_>,
    calibration: &Calibration,
    seed: u64,
) -> Verdict {
    let told = Told {
        d,
        e,
        calibration,
        seed,
    };
    told.verdict()
}

impl Told<'_> {
    fn parts(&self, row: &Row) -> Vec<Part> {
        let first = self.d.problem.runs.first();
        effects_of(row, first.map_or(1.0, |r| r.nominal.supply_v))
    }

    /// Metric and channel in which the causes show most.
    fn metric(&self) -> (&'static str, Channel) {
        let all = metrics(self.d.problem.linear);
        let primary = all.map(|m| m.0);
        let errors = self.d.causes.held_out.as_ref().map(|h| &h.errors);
        let named = !self.d.causes.causes.is_empty();
        let name = errors.and_then(|e| parts::metric(&primary, e, named));
        let own = all.iter().find(|m| Some(m.0) == name).unwrap_or(&all[0]);
        (own.0, own.2)
    }

    fn gap(&self, (metric, channel): (&'static str, Channel)) -> Gap {
        let none = BTreeMap::new();
        let held_out = self.d.causes.held_out.as_ref();
        let source = match self.d.floor.repeat {
            Some(_) => "repeats",
            None => "noise",
        };
        parts::gap(
            (metric, held_out.map_or(&none, |h| &h.errors)),
            (self.d.floor.of(channel as usize), source),
            (
                held_out.map_or(&[], |h| &h.runs),
                &self.d.scored().rmse(&self.d.found, channel),
            ),
            self.seed,
        )
    }

    fn stairs(&self, (metric, _): (&'static str, Channel)) -> Vec<Stair> {
        let of = |step: &str, state| Stair {
            step: step.into(),
            gap: self.d.errors(state).get(metric).copied().unwrap_or(0.0),
        };
        let mut out = vec![
            of("nominal", &self.d.nominal),
            of("calibrated", &self.d.calibrated),
        ];
        out.extend(self.d.steps.iter().map(|s| of(s.name, &s.state)));
        out
    }

    /// Shares of the error by stage. What stays beyond what healthy joints leave is placed in the stages whose effects
    /// would take most of it off.
    fn places(&self, channel: Channel, more: bool) -> Vec<Where> {
        let (d, scored) = (self.d, self.d.scored());
        let ends = [&d.nominal, &d.found];
        let floor = match d.floor.repeat {
            Some(_) => d.floor.of(channel as usize),
            None => 0.0,
        };
        let regime = locate::regime(&scored, ends, channel);
        let row = |stage: Option<Stage>, share: f64, ci95: [f64; 2]| Where {
            stage: stage.map_or("unexplained", Stage::name).into(),
            joint: (stage != Some(Stage::Supply)).then_some(d.problem.joint),
            regime: regime.into(),
            share,
            ci95,
        };
        let named = !d.causes.causes.is_empty();
        let mut rows: Vec<Where> = Vec::new();
        let mut rest = 1.0;
        if named || !more {
            let shares = locate::shares(&scored, ends, channel, floor, self.seed);
            rows.extend(
                shares
                    .into_iter()
                    .filter(|s| s.share > 0.0 || s.stage.is_none())
                    .map(|s| row(s.stage, s.share, s.ci95)),
            );
            let left = rows.iter().filter(|r| r.stage == "unexplained");
            rest = left.map(|r| r.share).sum();
        }
        if more {
            rows.retain(|r| r.stage != "unexplained");
            for (stage, share) in self.e.search.left(&self.e.data, &self.e.found.best) {
                let name = stage.map_or("unexplained", Stage::name);
                match rows.iter_mut().find(|r| r.stage == name) {
                    Some(r) => r.share += rest * share,
                    None => rows.push(row(stage, rest * share, [0.0, rest])),
                }
            }
        }
        rows.sort_by(|a, b| b.share.total_cmp(&a.share));
        rows
    }

    /// Effects of a joint that these data could not show.
    fn unseen(&self) -> Vec<Unseen> {
        let visible = self.e.search.visible(&self.e.data, &self.e.bare);
        let read = self.e.transport.looked_for();
        let found = |e: Effect| {
            let own = self.d.causes.causes.iter();
            let mut parts = own.flat_map(|r| self.parts(r));
            parts.any(|p| p.0 == e)
        };
        let why = |effect: Effect| {
            let own = |k: &(Kind, f64)| k.0 == Kind::One(effect);
            let Some((kind, evidence)) = visible.iter().copied().find(own) else {
                return Some(absent(effect));
            };
            let asked = self.calibration.ask(&shown(&self.e.data, kind));
            (evidence < asked)
                .then_some("largest plausible size stays under the noise floor in these runs")
        };
        let joint = |e: &Effect| Stage::JOINT.contains(&e.stage());
        let withheld = |e: &Effect| self.e.search.withhold.contains(e);
        Effect::ALL
            .iter()
            .filter(|e| joint(e) && !withheld(e) && !found(**e) && !read.contains(e))
            .filter_map(|e| {
                Some(Unseen {
                    effect: *e,
                    why: why(*e)?.into(),
                })
            })
            .collect()
    }

    /// Stated numbers that were taken beyond their tolerances though no effect of that name was found, the farthest first.
    fn displaced(&self) -> Vec<Displaced> {
        let stated = nominal(&self.e.data.problem);
        let params = &self.d.found.params;
        let named: Vec<P> = self
            .e
            .found
            .best
            .members
            .iter()
            .flat_map(|m| self.e.search.hypotheses[*m].axes())
            .filter_map(|a| match a {
                super::model::Axis::Joint(p) => Some(p),
                super::model::Axis::Column(_) => None,
            })
            .collect();
        let one = |f: &crate::candidates::Free| {
            let effect = base_effect(f.p).filter(|_| !named.contains(&f.p))?;
            let tolerances = pull(&stated, f.p, params)?;
            (tolerances > FAR).then(|| Displaced {
                effect,
                stage: effect.stage().name().into(),
                joint: Some(self.d.problem.joint),
                value: params.get(f.p),
                tolerances: (tolerances * 1e3).round() / 1e3,
            })
        };
        let mut out: Vec<Displaced> = stated.iter().filter_map(one).collect();
        out.sort_by(|a, b| b.tolerances.total_cmp(&a.tolerances));
        out
    }

    fn verdict(&self) -> Verdict {
        let (d, found) = (self.d, &self.d.causes);
        let metric = self.metric();
        let more = found.remainder_p.is_some_and(|p| p < LEVEL);
        let p = parts::probabilities(found.probabilities, !found.causes.is_empty());
        let rows: Vec<(&Row, Vec<Part>)> =
            found.causes.iter().map(|r| (r, self.parts(r))).collect();
        let mut effects = parts::effects(&rows, p, metric.0);
        let by = |effects: &[Effect]| names::separate_by(effects, &d.problem);
        let ambiguous = parts::ambiguous(&found.causes, &by);
        keep_together(&mut effects, &ambiguous);
        let none = BTreeMap::new();
        let errors = found.held_out.as_ref().map_or(&none, |h| &h.errors);
        let displaced = self.displaced();
        let mut out = Verdict {
            schema: "rb.gap/1".into(),
            verdict: word(found.verdict),
            partial: self.e.found.partial,
            gap: self.gap(metric),
            metrics: errors
                .iter()
                .map(|(n, e)| ((*n).to_owned(), [e.before, e.calibrated, e.after]))
                .collect(),
            staircase: self.stairs(metric),
            place: self.places(metric.1, more),
            regimes: locate::regimes(&d.scored(), [&d.nominal, &d.found]),
            effects,
            probabilities: p,
            unseen: self.unseen(),
            ambiguous,
            pulled: displaced
                .iter()
                .map(|s| (s.effect.name().to_owned(), s.tolerances))
                .collect(),
            displaced,
            provenance: Provenance {
                tool: concat!("gap ", env!("CARGO_PKG_VERSION")).into(),
                seed: self.seed,
                split: found
                    .held_out
                    .as_ref()
                    .map_or(String::new(), |h| h.split.clone()),
                ..Provenance::default()
            },
            ..Verdict::default()
        };
        out.sentence = sentence(&out, false) + &self.beside(&out.displaced);
        out
    }

    /// What is said beside the causes: columns that are off, numbers beyond their tolerances, and end stops.
    fn beside(&self, displaced: &[Displaced]) -> String {
        let mut out = String::new();
        for m in &self.e.found.best.members {
            let h = &self.e.search.hypotheses[*m];
            if let Kind::ColumnScale(c) = h.kind {
                let times = self.d.found.columns[c as usize];
                let column = super::library::column(c);
                out += &format!(" The recorded {column} is {times:.2} times what the model gives.");
            }
        }
        let one = |s: &Displaced| format!("{} ({:.1} tolerances)", s.effect.plain(), s.tolerances);
        if !displaced.is_empty() {
            let list: Vec<String> = displaced.iter().map(one).collect();
            let list = crate::report::words::listed(&list, list.len(), "and");
            out += &format!(" Calibration moved stated values beyond their tolerances: {list}.");
        }
        let unit = if self.d.problem.linear { "m" } else { "rad" };
        let travel = self.d.problem.runs.first().map(|r| r.nominal.travel);
        for x in travel.into_iter().flatten().filter(|x| x.is_finite()) {
            out +=
                &format!(" The joint ran against a stop at {x:.3} {unit}; that is in the model.");
        }
        out
    }
}

/// Why an effect is no hypothesis.
fn absent(effect: Effect) -> &'static str {
    match effect {
        Effect::JointOrder => "a bench has one joint",
        Effect::Jitter => "needs the applied set-point as the driver echoes it",
        Effect::ConnectorCompliance | Effect::ConnectorPlay => "a bench has no connector",
        _ => "its parameter has no nominal value in this data set, or no signal shows it",
    }
}

fn word(found: Found) -> Word {
    match found {
        Found::None => Word::None,
        Found::Parametric => Word::Parametric,
        Found::Explained => Word::Explained,
        Found::PartlyExplained => Word::PartlyExplained,
        Found::Unknown => Word::Unknown,
    }
}
