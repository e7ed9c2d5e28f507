//! Causes in words and numbers: `rb.gap/2`.

use std::collections::BTreeMap;

use files::model::Model;
use serde::Serialize;

use super::places::{Place, UNEXPLAINED};
use super::remainder::{self, Left};
use super::{Explained, HeldOut, Part};
use crate::decide::{CLASS, Calibration, MOST};
use crate::evidence::cause::{Cause, Scope};
use crate::evidence::search::{Posterior, Rival};
use crate::verdict::Estimate;
use crate::vocabulary::Effect;
use crate::whole::patch::patched;

/// A value of one cause: at the joint that has most of it, with all joints beside.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Value {
    /// Mean over the joints that have it.
    pub value: f64,
    /// 95 % interval of one joint's value; over all joints where they differ.
    pub ci95: [f64; 2],
    /// By joint; empty for what the robot has once.
    pub by_joint: BTreeMap<usize, f64>,
}

/// Another cause that may stand in the place of one that is named.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Alternative {
    /// Effect; `null` is a shape that no effect of the library has.
    pub effect: Option<&'static str>,
    /// Who has it.
    pub scope: Scope,
    /// Joints.
    pub joints: Vec<usize>,
    /// Logarithm of the likelihood ratio against it.
    pub margin: f64,
    /// Whether the data tell the two apart.
    pub distinguishable: bool,
}

/// A cause that was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Effect; `null` is a shape that no effect of the library has.
    pub effect: Option<&'static str>,
    /// Its stage.
    pub stage: Option<&'static str>,
    /// Who has it.
    pub scope: Scope,
    /// Joints that have it; empty for what the robot has once.
    pub joints: Vec<usize>,
    /// `structural` or `parametric`; `open` for a shape of no effect.
    pub kind: &'static str,
    /// Values by parameter.
    pub values: BTreeMap<&'static str, Value>,
    /// Probability that this is the cause.
    pub probability: f64,
    /// Chance that a robot without a cause shows as much.
    pub p_value: f64,
    /// Evidence that it adds: logarithm of the likelihood ratio, priors included.
    pub evidence: f64,
    /// Evidence that a cause of its effect must add.
    pub asked: f64,
    /// Nearest others.
    pub alternatives: Vec<Alternative>,
    /// Errors of the held-out runs, by signal, with all causes but this one; empty where none were compared.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub without: BTreeMap<&'static str, f64>,
    /// The same with this cause alone.
    #[serde(skip)]
    pub(crate) alone: BTreeMap<&'static str, f64>,
}

/// The cause that comes nearest to what is asked of it and is not named.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Nearest {
    /// Effect; `null` is a shape that no effect of the library has.
    pub effect: Option<&'static str>,
    /// Who would have it.
    pub scope: Scope,
    /// Joints.
    pub joints: Vec<usize>,
    /// Evidence that it would add.
    pub evidence: f64,
    /// Evidence that a cause of its effect must add.
    pub asked: f64,
}

/// Probabilities of the answers that are no effects.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Probabilities {
    /// There is no cause.
    pub none: f64,
    /// What is there is no effect of the library.
    pub unknown: f64,
}

/// One word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Word {
    /// Nothing is there that robots without a cause do not show.
    None,
    /// Nominal values beyond their tolerance.
    Parametric,
    /// Causes are named; less than half of the gap stays, or no more than robots without a cause leave.
    PartlyExplained,
    /// What is there has no effect's shape, or too much is left.
    Unknown,
}

/// The causes of a robot's gap.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Causes {
    /// Always `rb.gap/2`.
    pub schema: &'static str,
    /// One word.
    pub verdict: Word,
    /// One sentence.
    pub sentence: String,
    /// Where the gap lies, largest part first; empty where no cause is named.
    #[serde(rename = "where")]
    pub places: Vec<Place>,
    /// Causes, strongest first.
    pub causes: Vec<Row>,
    /// None and unknown.
    pub probabilities: Probabilities,
    /// Where more is left than robots without a cause leave, the most unusual first.
    pub left: Vec<Left>,
    /// What is not named and comes nearest.
    pub nearest: Option<Nearest>,
    /// How far the gap shrinks on runs that no fit saw.
    pub held_out: HeldOut,
    /// How many robots without a cause say what a cause must add.
    pub null_robots: usize,
}

/// Alternatives that are listed.
const LISTED: usize = 5;

/// What a key of a column is called in the vocabulary, and its values there: a give is one over a stiffness.
fn named(key: &'static str, of: Value) -> (&'static str, Value) {
    let stiff = |give: f64| 1.0 / give.max(1e-6);
    let inverse = |of: Value| Value {
        value: stiff(of.value),
        ci95: [stiff(of.ci95[1]), stiff(of.ci95[0])],
        by_joint: of
            .by_joint
            .into_iter()
            .map(|(k, x)| (k, stiff(x)))
            .collect(),
    };
    match key {
        "give_rad_nm" => ("stiffness_nm_rad", inverse(of)),
        "give_m_n" => ("stiffness_n_m", inverse(of)),
        _ => (key, of),
    }
}

/// Puts size and direction in the place of sine and cosine parts: `a sin(x + phase)`.
fn polar(out: &mut BTreeMap<&'static str, Value>, from: [&str; 2], to: [&'static str; 2]) {
    let (Some(sine), Some(cosine)) = (out.remove(from[0]), out.remove(from[1])) else {
        return;
    };
    let size = libm::hypot(sine.value, cosine.value);
    let half = [&sine, &cosine].map(|v| 0.5 * (v.ci95[1] - v.ci95[0]));
    let off = half[0].max(half[1]);
    let phase = libm::atan2(cosine.value, sine.value);
    let turn = off / size.max(1e-12);
    let one = |value: f64, off: f64| Value {
        value,
        ci95: [value - off, value + off],
        by_joint: BTreeMap::new(),
    };
    out.insert(to[0], one(size, off));
    out.insert(to[1], one(phase, turn));
}

/// Whether two causes are one for a reader: the same effect at the same joints.
fn same(a: &Cause, b: &Cause) -> bool {
    a.effect == b.effect && a.joints == b.joints
}

fn alternatives(all: &[Cause], own: &Cause, rivals: &[Rival]) -> Vec<Alternative> {
    let mut seen: Vec<&Cause> = vec![own];
    let mut out = Vec::new();
    for r in rivals {
        let cause = &all[r.cause];
        if seen.iter().any(|s| same(s, cause)) {
            continue;
        }
        seen.push(cause);
        out.push(Alternative {
            effect: cause.effect.map(Effect::name),
            scope: cause.scope,
            joints: cause.joints.clone(),
            margin: r.margin,
            distinguishable: r.margin > CLASS,
        });
    }
    out.truncate(LISTED);
    out
}

/// Joints in words.
fn place(row: &Row) -> String {
    let list: Vec<String> = row.joints.iter().map(ToString::to_string).collect();
    match (row.scope, row.joints.as_slice()) {
        (Scope::All, _) => " in all joints".into(),
        (Scope::Robot, _) => String::new(),
        (_, [one]) => format!(" in joint {one}"),
        _ => format!(" in joints {}", list.join(", ")),
    }
}

fn sentence(word: Word, rows: &[Row], left: &[Left]) -> String {
    let one = |r: &Row| {
        let name = r
            .effect
            .and_then(Effect::from_name)
            .map_or("a shape that no effect of the library has", Effect::plain);
        format!("{name}{}", place(r))
    };
    let mut list: Vec<String> = rows.iter().map(one).collect();
    if word == Word::Unknown {
        list.extend(left.iter().map(|l| format!("what is left at {}", l.plain)));
    }
    match word {
        Word::None => "No cause shows that robots without a cause do not show as well.".into(),
        Word::Unknown => format!(
            "Something is there that no effect of the library explains: {}.",
            list.join("; ")
        ),
        Word::Parametric | Word::PartlyExplained => {
            format!("Causes, strongest first: {}.", list.join("; "))
        }
    }
}

/// What a patch takes of a cause: one entry a joint, or one of the robot.
pub(super) fn parts(
    effect: Effect,
    joints: &[usize],
    values: &BTreeMap<&'static str, Value>,
) -> Vec<Part> {
    let of = |joint: Option<usize>| {
        let values = values.iter().map(|(key, v)| {
            let own = joint.and_then(|k| v.by_joint.get(&k));
            let value = *own.unwrap_or(&v.value);
            let ci95 = v.ci95.map(|end| end - v.value + value);
            ((*key).to_owned(), Estimate { value, ci95 })
        });
        (effect, joint, values.collect())
    };
    if joints.is_empty() {
        return vec![of(None)];
    }
    joints.iter().map(|k| of(Some(*k))).collect()
}

impl Row {
    /// What a patch takes of it.
    pub(crate) fn parts(&self) -> Vec<Part> {
        let effect = self.effect.and_then(Effect::from_name);
        effect.map_or_else(Vec::new, |e| parts(e, &self.joints, &self.values))
    }
}

impl Causes {
    /// `model` with the causes found switched on, those that the simulator has; `command` found them.
    #[must_use]
    pub fn patch(&self, model: &Model, command: &str) -> Model {
        let parts: Vec<_> = self.causes.iter().flat_map(Row::parts).collect();
        let of = parts
            .iter()
            .map(|(effect, joint, values)| (*effect, *joint, values));
        patched(model, of, command)
    }
}

impl Explained {
    /// Mean and standard deviation of number `n` of `cause`; the mean of a servo's is where the runs, played, fit best.
    fn number(&self, cause: &Cause, n: usize, p: &Posterior, first: usize) -> (f64, f64) {
        let own = &cause.numbers[n];
        let size = p.mean.len();
        let (mut mean, mut variance) = (own.mean, 0.0);
        for (l, w) in &own.of_latents {
            mean += w * p.mean[first + l];
            for (m, v) in &own.of_latents {
                variance += w * v * p.covariance[(first + l) * size + first + m];
            }
        }
        let entries = own.of_latents.last().map(|l| cause.latents[l.0].as_slice());
        if let Some([(block, column, _)]) = entries {
            let here = |f: &&(usize, usize, f64)| (f.0, f.1) == (*block, *column);
            mean = self.fitted.iter().find(here).map_or(mean, |f| f.2);
        }
        let value = own.neutral + own.scale * mean;
        (value, (own.scale * variance.max(0.0).sqrt()).abs())
    }

    /// Values of `cause`, whose laws are off by the share `law`.
    pub(super) fn values(
        &self,
        cause: &Cause,
        p: &Posterior,
        first: usize,
        law: f64,
    ) -> BTreeMap<&'static str, Value> {
        let mut out: BTreeMap<&'static str, Value> = BTreeMap::new();
        let mut count: BTreeMap<&'static str, f64> = BTreeMap::new();
        for (i, own) in cause.numbers.iter().enumerate() {
            let (value, sd) = self.number(cause, i, p, first);
            let sd = libm::hypot(sd, law * (value - own.neutral));
            let ci95 = [value - 1.96 * sd, value + 1.96 * sd];
            let slot = out.entry(own.key).or_insert(Value {
                value: 0.0,
                ci95,
                by_joint: BTreeMap::new(),
            });
            slot.value += value;
            slot.ci95 = [slot.ci95[0].min(ci95[0]), slot.ci95[1].max(ci95[1])];
            *count.entry(own.key).or_default() += 1.0;
            if let Some(k) = own.joint {
                slot.by_joint.insert(k, value);
            }
        }
        for (key, n) in count {
            if let Some(v) = out.get_mut(key) {
                v.value /= n;
            }
        }
        let mut out: BTreeMap<&'static str, Value> =
            out.into_iter().map(|(key, of)| named(key, of)).collect();
        polar(
            &mut out,
            ["sine_nm", "cosine_nm"],
            ["amplitude_nm", "phase_rad"],
        );
        for (key, value) in &cause.fixed {
            let [value, off] = match *key {
                "damping_n_s_m" => [self.damping[0], 1.96 * self.damping[1]],
                _ => [*value, 0.0],
            };
            let fixed = Value {
                value,
                ci95: [value - off, value + off],
                by_joint: BTreeMap::new(),
            };
            out.entry(key).or_insert(fixed);
        }
        out
    }

    /// Causes in words and numbers, decided by `calibration`.
    pub(in crate::whole) fn rows(&self, calibration: &Calibration, held_out: HeldOut) -> Causes {
        let problem = self.problem();
        let posterior = problem.posterior(&self.found.best.members);
        let members = self.found.best.members.iter().enumerate();
        let mut rows: Vec<Row> = members
            .map(|(i, m)| {
                let cause = &self.causes[*m];
                let alternatives = alternatives(&self.causes, cause, &self.found.rivals[i]);
                let others: f64 = alternatives.iter().map(|a| libm::exp(-a.margin)).sum();
                let evidence = self.found.gains[i];
                let p_value = calibration.p_value(&cause.into(), evidence);
                let kind = match cause.effect {
                    None => "open",
                    Some(e) if e.is_base() => "parametric",
                    Some(_) => "structural",
                };
                Row {
                    effect: cause.effect.map(Effect::name),
                    stage: cause.effect.map(|e| e.stage().name()),
                    scope: cause.scope,
                    joints: cause.joints.clone(),
                    kind,
                    values: self.values(
                        cause,
                        &posterior,
                        posterior.first[i],
                        cause.effect.map_or(0.0, |e| calibration.law(e.stage())),
                    ),
                    probability: (1.0 - p_value) / (1.0 + others),
                    p_value,
                    evidence,
                    asked: calibration.ask(&cause.into()),
                    alternatives,
                    without: held_out.without[i].clone(),
                    alone: held_out.parts.alone[i].clone(),
                }
            })
            .collect();
        rows.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        let left = self.left(calibration);
        let places = match rows.is_empty() {
            true => remainder::places(&left),
            false => self.places(),
        };
        let other = places.iter().filter(|p| p.stage == UNEXPLAINED);
        let stays: f64 = other.map(|p| p.share).sum();
        // What was named is not what is there.
        let unnamed = left.first().filter(|_| rows.is_empty() || stays > MOST);
        let word = match rows.first() {
            _ if unnamed.is_some() => Word::Unknown,
            None => Word::None,
            Some(_) if rows.iter().any(|r| r.effect.is_none()) => Word::Unknown,
            Some(_) if !left.is_empty() => Word::PartlyExplained,
            Some(_) if rows.iter().all(|r| r.kind == "parametric") => Word::Parametric,
            Some(_) => Word::PartlyExplained,
        };
        let next = self.found.next;
        let none = if rows.is_empty() && unnamed.is_none() {
            next.map_or(1.0, |(c, adds)| {
                calibration.p_value(&(&self.causes[c]).into(), adds)
            })
        } else {
            0.0
        };
        let open = rows.iter().filter(|r| r.effect.is_none());
        let rest = unnamed.map(|l| 1.0 - l.p_value);
        let unknown = open.map(|r| r.probability).chain(rest).fold(0.0, f64::max);
        Causes {
            schema: "rb.gap/2",
            verdict: word,
            sentence: sentence(word, &rows, &left),
            places,
            causes: rows,
            probabilities: Probabilities { none, unknown },
            left,
            nearest: next.map(|(c, evidence)| {
                let cause = &self.causes[c];
                Nearest {
                    effect: cause.effect.map(Effect::name),
                    scope: cause.scope,
                    joints: cause.joints.clone(),
                    evidence,
                    asked: calibration.ask(&cause.into()),
                }
            }),
            held_out,
            null_robots: calibration.strongest.len(),
        }
    }
}
