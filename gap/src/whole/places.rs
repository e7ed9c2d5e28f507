//! Where the gap is: shares by stage, joint and regime.
//!
//! Shares are shares of squared tolerances. What an effect gains counts by the tolerances of the measurement. What the calibration of a
//! nominal parameter gains counts by what the tolerances that the parameter moves cost in the same fit. A precise encoder makes no large
//! gap of a gain that is known to some per cent only.

use std::collections::BTreeMap;

use super::belief::BARE;
use super::found::{Item, Place};
use super::steady::Change;
use super::{Parts, Settings, found};
use crate::math;
use crate::verdict::Where;
use crate::vocabulary::Stage;

/// Cost that signals changed on the way in a manner nobody knows stand for: above all that a fit leaves.
const ODD: f64 = 1e4;
/// The same for a law of joint or body that the library does not hold, which no signal shows by itself.
const LAWLESS: f64 = 1e3;

/// Stage and joint; the stage `None` is what nothing explains.
type Key = (Option<Stage>, Option<usize>);

/// Costs of a tier by group: what calibration and every effect gain, and what stays.
struct Fall {
    /// Stage, joint, cost gained by group.
    parts: Vec<(Stage, Option<usize>, Vec<f64>)>,
    left: Vec<f64>,
    /// Stage and joint in which what is left arose.
    arose: (Stage, Option<usize>),
    /// More is left than the library can be trusted to leave.
    remains: bool,
    /// More is left of a joint than is usual where nothing at all was named.
    bare: bool,
    /// A law that the library does not hold is in what is left.
    odd: bool,
}

fn falls(d: &Parts, items: &[Item]) -> Vec<Fall> {
    let mut out = Vec::new();
    let joints = d.joints.iter().map(|f| {
        let own = (Stage::Driver, Some(f.tier.joint));
        (own, &f.answer, (f.rest, own.1), [f.odd, f.astray])
    });
    let body = d.body.iter().map(|b| {
        let arose = match b.changes {
            Some(Change::Zero(k)) => (Stage::Conventions, Some(k)),
            _ => b.rest.place,
        };
        let odd = b.changes.is_some() || b.rest.evidence(!items.is_empty()) > 0.0;
        ((Stage::Body, None), &b.answer, arose, [odd, false])
    });
    let camera = d.camera.iter().map(|c| {
        let own = (Stage::Camera, None);
        (own, &c.answer, own, [false, false])
    });
    for (own, a, arose, [odd, astray]) in joints.chain(body).chain(camera) {
        let last = a.last();
        let base = &a.steps[0].groups;
        let bent: Vec<f64> = a
            .nominal_groups
            .iter()
            .zip(base)
            .map(|(x, y)| (x - y).max(0.0))
            .collect();
        let weight = (a.pull / math::mean(&bent).max(1e-12)).min(1.0);
        let bent = bent.iter().map(|x| x * weight).collect();
        let mut parts = vec![(own.0, own.1, bent)];
        // What every effect gains in the final model, scaled to the whole fall.
        let whole: Vec<f64> = base
            .iter()
            .zip(&last.groups)
            .map(|(x, y)| (x - y).max(0.0))
            .collect();
        let gains: Vec<f64> = a
            .removed_alone
            .iter()
            .map(|(r, _)| (r.cost - last.cost).max(1e-9))
            .collect();
        let sum: f64 = gains.iter().sum();
        for (m, g) in last.members.iter().zip(&gains) {
            let c = &a.candidates[*m];
            let part = whole.iter().map(|w| w * g / sum.max(1e-12)).collect();
            let stage = if astray { arose.0 } else { c.effect.stage() };
            parts.push((stage, c.joint, part));
        }
        out.push(Fall {
            parts,
            left: last.groups.iter().map(|c| (c - 1.0).max(0.0)).collect(),
            arose,
            remains: last.cost > a.limits.remainder,
            bare: own.1.is_some() && last.cost > BARE,
            odd,
        });
    }
    out
}

/// Costs of every place by group.
fn costs(d: &Parts, items: &[Item]) -> BTreeMap<Key, Vec<f64>> {
    let falls = falls(d, items);
    let groups = falls.iter().map(|f| f.left.len()).max().unwrap_or(0);
    let mut rows: BTreeMap<Key, Vec<f64>> = BTreeMap::from([((None, None), vec![0.0; groups])]);
    let mut add = |key: Key, v: &[f64]| {
        let slot = rows.entry(key).or_insert_with(|| vec![0.0; groups]);
        slot.iter_mut().zip(v).for_each(|(s, x)| *s += x.max(0.0));
    };
    for f in &falls {
        for (stage, joint, v) in &f.parts {
            add((Some(*stage), *joint), v);
        }
        let bare = items.is_empty() && f.bare;
        let key = if f.remains || bare || f.odd {
            (Some(f.arose.0), f.arose.1)
        } else {
            (None, None)
        };
        add(key, &f.left);
        if f.odd {
            add(key, &vec![LAWLESS; groups]);
        }
    }
    let odd: Vec<usize> = (0..6).filter(|k| d.conventions.echo[*k].odd).collect();
    // What all joints show is not theirs.
    let shared = odd.len() == 6;
    for k in odd.iter().take(if shared { 1 } else { 6 }) {
        let key = (Some(Stage::Transport), (!shared).then_some(*k));
        add(key, &vec![ODD; groups]);
    }
    for c in found::nameless(d) {
        add((Some(c.effect.stage()), c.joint), &vec![ODD; groups]);
    }
    let told = |i: &&Item| i.outside() || matches!(i.place, Place::Told(_));
    for c in items.iter().filter(told) {
        add((Some(c.effect.stage()), c.joint), &vec![c.gain; groups]);
    }
    rows
}

/// Shares of the gap by stage and joint; the remainder is placed where it is significant.
pub(super) fn places(d: &Parts, items: &[Item], settings: &Settings) -> Vec<Where> {
    let rows = costs(d, items);
    let groups = rows.values().map(Vec::len).max().unwrap_or(0);
    let total =
        |pick: &dyn Fn(&[f64]) -> f64| rows.values().map(|v| pick(v)).sum::<f64>().max(1e-12);
    let whole = total(&|v| v.iter().sum());
    let mut rng = math::Rng::new(settings.seed);
    let draws: Vec<Vec<usize>> = (0..200)
        .map(|_| (0..groups).map(|_| rng.index(groups)).collect())
        .collect();
    let totals: Vec<f64> = draws
        .iter()
        .map(|g| total(&|v| g.iter().map(|i| v[*i]).sum()))
        .collect();
    let row = |(key, v): (&Key, &Vec<f64>)| {
        let all: Vec<f64> = draws
            .iter()
            .zip(&totals)
            .map(|(g, t)| g.iter().map(|i| v[*i]).sum::<f64>() / t)
            .collect();
        let own = d.joints.iter().find(|f| Some(f.tier.joint) == key.1);
        Where {
            stage: key.0.map_or("unexplained", Stage::name).into(),
            joint: key.1,
            regime: own.map_or("all", |f| f.regime).into(),
            share: v.iter().sum::<f64>() / whole,
            ci95: [math::quantile(&all, 0.025), math::quantile(&all, 0.975)],
        }
    };
    let mut out: Vec<Where> = rows
        .iter()
        .map(row)
        .filter(|w| w.share > 1e-4 || w.stage == "unexplained")
        .collect();
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    let sum: f64 = out.iter().map(|w| w.share).sum();
    if sum > 0.0 {
        out.iter_mut().for_each(|w| w.share /= sum);
    } else if let Some(rest) = out.first_mut() {
        // A gap of nothing is unexplained.
        rest.share = 1.0;
    }
    out
}
