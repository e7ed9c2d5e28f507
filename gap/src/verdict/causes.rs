//! The parts of a verdict that causes give, of a robot or of a joint.

use std::collections::BTreeMap;

use super::{Alternative, Ambiguous, EffectRow, Estimate, Gap, Member, Probabilities};
use crate::math;
use crate::vocabulary::{Compound, Effect};
use crate::whole::{self, Row, Shrink};

/// An effect, its joint, and its values.
pub(crate) type Part = (Effect, Option<usize>, BTreeMap<String, Estimate>);

/// Members of a class beside its first.
const RIVALS: usize = 2;
/// Draws of a bootstrap.
const DRAWS: usize = 400;

/// 95 % interval of the mean by bootstrap.
fn bootstrap(values: &[f64], seed: u64) -> [f64; 2] {
    if values.is_empty() {
        return [0.0, 0.0];
    }
    let mut rng = math::Rng::new(seed);
    let mut draw = || -> f64 {
        let sum: f64 = values.iter().map(|_| values[rng.index(values.len())]).sum();
        sum / values.len() as f64
    };
    let all: Vec<f64> = (0..DRAWS).map(|_| draw()).collect();
    [math::quantile(&all, 0.025), math::quantile(&all, 0.975)]
}

/// The signal of `primary` that the causes lower most, from nominal numbers where they fit best; the first one without
/// a cause.
pub(crate) fn metric(
    primary: &[&'static str],
    errors: &BTreeMap<&'static str, Shrink>,
    named: bool,
) -> Option<&'static str> {
    let mut known = primary.iter().copied().filter(|n| errors.contains_key(n));
    let fall = |n: &&str| errors[n].after / errors[n].calibrated.max(1e-30);
    if named {
        known.min_by(|a, b| fall(a).total_cmp(&fall(b)))
    } else {
        known.next()
    }
}

/// The gap in one metric: its floor and where that comes from, and the errors of the held-out runs with the causes.
pub(crate) fn gap(
    (metric, errors): (&'static str, &BTreeMap<&'static str, Shrink>),
    (floor, floor_source): (f64, &str),
    (runs, by_run): (&[String], &[f64]),
    seed: u64,
) -> Gap {
    let e = errors.get(metric);
    let of = |x: fn(&Shrink) -> f64| e.map_or(0.0, x);
    let (before, calibrated, after) = (of(|e| e.before), of(|e| e.calibrated), of(|e| e.after));
    let share = |from: f64| if from > 0.0 { 1.0 - after / from } else { 0.0 };
    let achievable = || match before > floor {
        true => (before - after) / (before - floor),
        false => 1.0,
    };
    Gap {
        metric: metric.into(),
        unit: e.map_or("rad", |e| e.unit).into(),
        before,
        after_calibration: calibrated,
        after,
        floor,
        floor_source: floor_source.into(),
        ci95_after: bootstrap(by_run, seed),
        shrink: share(before),
        shrink_after_calibration: share(calibrated),
        shrink_of_achievable: (floor_source == "repeats").then(achievable),
        held_out_runs: runs.to_vec(),
    }
}

/// Probabilities of the answers that are no effects; without an effect one of them is right.
pub(crate) fn probabilities(own: whole::Probabilities, named: bool) -> Probabilities {
    let all = if named { 1.0 } else { own.none + own.unknown };
    Probabilities {
        none: own.none / all,
        unknown: own.unknown / all,
    }
}

/// One row for each effect and joint that the causes are made of.
pub(crate) fn effects(
    causes: &[(&Row, Vec<Part>)],
    p: Probabilities,
    metric: &'static str,
) -> Vec<EffectRow> {
    let all: f64 = causes.iter().map(|c| c.0.probability).sum();
    let rest = (1.0 - p.none - p.unknown).max(0.0);
    let mut out = Vec::new();
    for (row, parts) in causes {
        let alternatives: Vec<Alternative> = row
            .alternatives
            .iter()
            .filter_map(|a| {
                Some(Alternative {
                    effect: first(a.effect?)?,
                    distinguishable: a.distinguishable,
                    margin: (a.margin * 1e3).round() / 1e3,
                })
            })
            .collect();
        let confidence = rest * row.probability / all.max(1e-30) / parts.len().max(1) as f64;
        for (effect, joint, parameters) in parts {
            let within = |p: &files::effects::EffectParam| {
                let found = parameters.get(p.key);
                found.is_none_or(|e| (p.min..=p.max).contains(&e.value))
            };
            out.push(EffectRow {
                effect: *effect,
                part_of: row.effect.and_then(Compound::from_name),
                stage: effect.stage().name().into(),
                joint: *joint,
                confidence,
                alternatives: alternatives.clone(),
                gap_added_alone: row.alone.get(metric).copied().unwrap_or(0.0),
                gap_removed_from_full: row.without.get(metric).copied().unwrap_or(0.0),
                kind: row.kind.into(),
                plausible: effect.info().parameters.iter().all(within),
                parameters: parameters.clone(),
            });
        }
    }
    out
}

/// The effect of that name, or the first of a compound.
fn first(name: &str) -> Option<Effect> {
    let of = |c: Compound| c.effects()[0];
    Effect::from_name(name).or_else(|| Compound::from_name(name).map(of))
}

/// Classes of causes that the data do not tell apart.
pub(crate) fn ambiguous(
    causes: &[Row],
    separate_by: &dyn Fn(&[Effect]) -> &'static str,
) -> Vec<Ambiguous> {
    let class = |row: &Row| {
        let own = first(row.effect?)?;
        let member = |effect: Effect, joints: &[usize], probability| Member {
            effect,
            stage: effect.stage().name().into(),
            joint: joints.first().copied(),
            probability,
        };
        let near = row.alternatives.iter().filter(|a| !a.distinguishable);
        let mut members = vec![member(own, &row.joints, 1.0)];
        members.extend(
            near.filter_map(|a| {
                let effect = first(a.effect?)?;
                (effect != own).then(|| member(effect, &a.joints, libm::exp(-a.margin)))
            })
            .take(RIVALS),
        );
        let sum: f64 = members.iter().map(|m| m.probability).sum();
        members.iter_mut().for_each(|m| m.probability /= sum);
        let mut effects: Vec<Effect> = Vec::new();
        for m in &members {
            if !effects.contains(&m.effect) {
                effects.push(m.effect);
            }
        }
        (members.len() > 1).then(|| Ambiguous {
            separate_by: separate_by(&effects).into(),
            effects,
            members,
        })
    };
    causes.iter().filter_map(class).collect()
}
