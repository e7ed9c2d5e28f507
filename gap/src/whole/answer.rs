//! From the tiers to the verdict.

use std::collections::BTreeMap;

use super::advice;
use super::belief::{Belief, Remainder};
use super::found::{self, Item};
use super::score::{JointRow, Metrics, Score, State, bootstrap, unit};
use super::{Parts, Settings, conventions, joints, places, search, unseen};
use crate::math;
use crate::regimes::RegimeRow;
use crate::sentence::{body_off, sentence};
use crate::verdict::*;
use crate::vocabulary::Effect;

/// Cost per sample, in squared tolerances, above which a remainder is significant. Null robots stay below 4, see docs/diagnosis.md.
pub(super) const REMAINDER: f64 = 6.0;
/// Two effects explain the data equally well below this many standard deviations.
pub(super) const MARGIN: f64 = 3.0;
/// Error of the body's windows, over what their starts explain, from which a verdict of `none` says so.
const BEYOND: f64 = 1.25;

fn mean(m: &Metrics, name: &str) -> f64 {
    m.get(name).map_or(0.0, |v| math::mean(v))
}

/// The metrics of every state that the verdict quotes.
pub(super) struct Scores {
    before: Metrics,
    calibrated: Metrics,
    after: Metrics,
    /// Alone and removed, by item.
    items: Vec<(Metrics, Metrics)>,
    primary: &'static str,
    joints: Vec<JointRow>,
    regimes: Vec<RegimeRow>,
}

impl Scores {
    pub(super) fn new(d: &Parts, score: &Score, items: &[Item]) -> Self {
        let pick = |of: &dyn Fn(&search::Answer) -> Vec<f64>| State {
            joints: d.joints.iter().map(|f| of(&f.answer)).collect(),
            body: d.body.as_ref().map_or_else(Vec::new, |b| of(&b.answer)),
            camera: d.camera.as_ref().map_or_else(Vec::new, |c| of(&c.answer)),
            conventions: true,
            held: true,
        };
        // Without what was found outside the tiers' models.
        let bare = |mut state: State| {
            state.conventions = false;
            for (theta, f) in state.joints.iter_mut().zip(&d.joints) {
                found::unsigned(theta, &f.answer.nominal);
            }
            state
        };
        let first = State {
            held: false,
            ..bare(pick(&|a| a.nominal.clone()))
        };
        let base = pick(&|a| a.steps[0].theta.clone());
        let last = pick(&|a| a.last().theta.clone());
        let outside = items.iter().any(Item::outside);
        let or_bare = |state: State| if outside { bare(state) } else { state };
        let before = score.metrics(&first);
        let calibrated = score.metrics(&or_bare(base.clone()));
        let after = score.metrics(&last);
        let items = items
            .iter()
            .map(|i| {
                let (mut alone, mut removed) = (base.clone(), last.clone());
                if i.outside() {
                    // What was found outside the tiers' models comes and goes together.
                    return (score.metrics(&alone), score.metrics(&bare(removed)));
                }
                with_and_without(d, i.place, &mut alone, &mut removed);
                (score.metrics(&or_bare(alone)), score.metrics(&removed))
            })
            .collect();
        let mut out = Self {
            before,
            calibrated,
            after,
            items,
            primary: "position_rmse_rad",
            joints: score.by_joint(&first, &last),
            regimes: score.regimes(&d.data, &first, &last),
        };
        out.primary = out.choose(outside);
        out
    }

    /// The metric that the effects lower most, from the calibrated model or, where some act `outside` the tiers' models, from the
    /// nominal one; without effects the base pose where measured, else the angles.
    fn choose(&self, outside: bool) -> &'static str {
        let order = [
            "pose_rmse_m",
            "position_rmse_rad",
            "effort_rmse_nm",
            "link_rmse_rad",
        ];
        let known = order.into_iter().filter(|n| self.before.contains_key(n));
        if self.items.is_empty() {
            return known.into_iter().next().unwrap_or("position_rmse_rad");
        }
        let from = if outside {
            &self.before
        } else {
            &self.calibrated
        };
        let fall = |n: &str| mean(&self.after, n) / mean(from, n).max(1e-12);
        known
            .min_by(|a, b| fall(a).total_cmp(&fall(b)))
            .unwrap_or("position_rmse_rad")
    }
}

/// Puts the item at `place` into `alone`, a state without effects, and takes it out of `removed`, one with all.
fn with_and_without(d: &Parts, place: found::Place, alone: &mut State, removed: &mut State) {
    match place {
        found::Place::Joint(at, m) => {
            let (r, a) = &d.joints[at].answer.removed_alone[m];
            alone.joints[at].clone_from(&a.theta);
            removed.joints[at].clone_from(&r.theta);
        }
        found::Place::Body(m) => {
            if let Some(b) = &d.body {
                let (r, a) = &b.answer.removed_alone[m];
                alone.body.clone_from(&a.theta);
                removed.body.clone_from(&r.theta);
            }
        }
        found::Place::Told(b) => {
            if let Some(body) = &d.body {
                let (answer, b) = (&body.answer, b as usize);
                alone.body[b] = answer.last().theta[b];
                removed.body[b] = answer.nominal[b];
            }
        }
        found::Place::Camera(m) => {
            if let Some(c) = &d.camera {
                let (r, a) = &c.answer.removed_alone[m];
                alone.camera.clone_from(&a.theta);
                removed.camera.clone_from(&r.theta);
            }
        }
        found::Place::Convention | found::Place::Direct => {}
    }
}

/// Error below which `metric` tells nothing, and where that comes from: repeats of one motion, or what windows, loads and angles may be off by.
fn floor(d: &Parts, score: &Score, metric: &str) -> (f64, &'static str) {
    let of =
        |own: &dyn Fn(&joints::Found) -> f64| -> Vec<f64> { d.joints.iter().map(own).collect() };
    let mut spread = of(&|f| f.tier.repeat_rad);
    spread.retain(|x| x.is_finite());
    match metric {
        "pose_rmse_m" => (
            score.body.as_ref().map_or(0.0, |b| b.tolerance_m()),
            "tolerance",
        ),
        "effort_rmse_nm" => (
            math::mean(&of(&|f| f.tier.torque_tolerance_nm())),
            "tolerance",
        ),
        _ if !spread.is_empty() => (math::mean(&spread), "repeats"),
        _ => (math::mean(&of(&|f| f.tier.tolerance_rad)), "noise"),
    }
}

fn gap(d: &Parts, score: &Score, s: &Scores, settings: &Settings) -> Gap {
    let m = s.primary;
    let (before, cal, after) = (
        mean(&s.before, m),
        mean(&s.calibrated, m),
        mean(&s.after, m),
    );
    let (floor, floor_source) = floor(d, score, m);
    let repeats = floor_source == "repeats";
    let share = |a: f64, b: f64| if b > 0.0 { 1.0 - a / b } else { 0.0 };
    Gap {
        metric: m.into(),
        unit: unit(m).into(),
        before,
        after_calibration: cal,
        after,
        floor,
        floor_source: floor_source.into(),
        ci95_after: bootstrap(s.after.get(m).map_or(&[], |v| v), settings.seed),
        shrink: share(after, before),
        shrink_after_calibration: share(after, cal),
        shrink_of_achievable: repeats.then(|| {
            if before > floor {
                (before - after) / (before - floor)
            } else {
                1.0
            }
        }),
        held_out_runs: score
            .runs
            .iter()
            .map(|r| d.data.runs[*r].name.clone())
            .collect(),
    }
}

fn rows(items: &[Item], s: &Scores, belief: &Belief) -> Vec<EffectRow> {
    let mut out: Vec<(f64, EffectRow)> = items
        .iter()
        .enumerate()
        .map(|(i, item)| {
            let (alone, removed) = &s.items[i];
            let row = EffectRow {
                effect: item.effect,
                stage: item.effect.stage().name().into(),
                joint: item.joint,
                parameters: item.parameters.clone(),
                confidence: belief.effects()[i],
                alternatives: item
                    .rivals
                    .iter()
                    .map(|r| Alternative {
                        effect: r.effect,
                        distinguishable: r.margin >= MARGIN,
                        margin: (r.margin * 1e3).round() / 1e3,
                    })
                    .collect(),
                gap_added_alone: mean(alone, s.primary),
                gap_removed_from_full: mean(removed, s.primary),
                kind: if item.effect.is_base() {
                    "parametric"
                } else {
                    "structural"
                }
                .into(),
                plausible: item.plausible,
            };
            (item.gain, row)
        })
        .collect();
    out.sort_by(|a, b| b.0.total_cmp(&a.0));
    out.into_iter().map(|x| x.1).collect()
}

fn ambiguous(d: &Parts, items: &[Item]) -> Vec<Ambiguous> {
    let heard = |k: usize| d.conventions.echo[k].late_s.is_some();
    let mut out = Vec::new();
    for item in items {
        let close: Vec<_> = item
            .rivals
            .iter()
            .filter(|r| r.margin < MARGIN)
            .take(2)
            .collect();
        if close.is_empty() {
            continue;
        }
        let member = |effect: Effect, joint, weight| Member {
            effect,
            stage: effect.stage().name().into(),
            joint,
            probability: weight,
        };
        let mut members = vec![member(item.effect, item.joint, 1.0)];
        members.extend(
            close
                .iter()
                .map(|r| member(r.effect, r.joint, libm::exp(-0.5 * r.margin * r.margin))),
        );
        let sum: f64 = members.iter().map(|m| m.probability).sum();
        members.iter_mut().for_each(|m| m.probability /= sum);
        let effects: Vec<Effect> = members.iter().map(|m| m.effect).collect();
        out.push(Ambiguous {
            separate_by: advice::separate_by(&effects, item.joint.is_some_and(heard)).into(),
            effects,
            members,
        });
    }
    out
}

/// What is said where windows of the body were played on other contacts than the nominal model's.
fn held(contacts: &Contacts) -> Option<&'static str> {
    match (contacts.law, contacts.friction_pyramid) {
        (Law::Other, true) => Some(
            " The ground holds otherwise than the nominal model's: windows of the body were played on contacts that creep inside a pyramid of friction, and the patch has them.",
        ),
        (Law::Other, false) => Some(
            " The ground holds otherwise than the nominal model's: windows of the body were played on contacts that do not creep and hold by a round cone of friction, and the patch has them.",
        ),
        (Law::Nominal | Law::Unclear, _) => None,
    }
}

/// What stands behind the sentence of every report.
fn beyond(d: &Parts, v: &Verdict) -> String {
    let off = body_off(&v.gap, BEYOND).filter(|_| v.verdict == Word::None);
    let held = d.body.as_ref().and_then(|b| held(&b.contacts));
    off.unwrap_or_default() + held.unwrap_or_default()
}

/// The verdict.
pub(super) fn verdict(d: &Parts, score: &Score, settings: &Settings) -> (Verdict, Vec<JointRow>) {
    let items = found::items(d);
    let s = Scores::new(d, score, &items);
    let gap = gap(d, score, &s, settings);
    let mut remainder = Remainder::new(d, &items);
    if items.iter().any(Item::outside) {
        let share = gap.after / gap.before.max(1e-12);
        remainder.explain(1.0 - share * share);
    }
    let word = remainder.word(&items);
    let belief = remainder.belief(word, &items);
    let mut effects = rows(&items, &s, &belief);
    let place = places::places(d, &items, settings);
    let ambiguous = ambiguous(d, &items);
    keep_together(&mut effects, &ambiguous);
    let echo = &d.conventions.echo;
    let unheard = |f: &joints::Found| f.late && echo[f.tier.joint].late_s.is_none();
    let late = d.joints.iter().any(unheard);
    let metrics = s
        .before
        .keys()
        .map(|k| {
            (
                (*k).to_string(),
                [
                    mean(&s.before, k),
                    mean(&s.calibrated, k),
                    mean(&s.after, k),
                ],
            )
        })
        .collect();
    let mut staircase = vec![
        Stair {
            step: "before".into(),
            gap: gap.before,
        },
        Stair {
            step: "after calibration".into(),
            gap: gap.after_calibration,
        },
    ];
    for e in &effects {
        let joint = e.joint.map_or_else(String::new, |k| format!(" joint {k}"));
        staircase.push(Stair {
            step: format!("{}{joint} alone", e.effect.name()),
            gap: e.gap_added_alone,
        });
    }
    staircase.push(Stair {
        step: "after".into(),
        gap: gap.after,
    });
    let mut verdict = Verdict {
        schema: "rb.gap/1".into(),
        verdict: word,
        sentence: String::new(),
        partial: false,
        next_experiment: advice::next(&ambiguous, word, late),
        unseen: unseen::unseen(d, settings),
        pulled: BTreeMap::new(),
        displaced: Vec::new(),
        gap,
        metrics,
        staircase,
        place,
        regimes: s.regimes,
        effects,
        probabilities: belief.probabilities(),
        ambiguous,
        contacts: d.body.as_ref().map(|b| b.contacts.clone()),
        provenance: Provenance {
            tool: concat!("rb-gap ", env!("CARGO_PKG_VERSION")).into(),
            commit: None,
            data_sha256: String::new(),
            seed: settings.seed,
            split: d.split.clone(),
            wall_time_s: 0.0,
            warnings: Vec::new(),
        },
    };
    verdict.sentence = sentence(&verdict, true) + &beyond(d, &verdict);
    (verdict, s.joints)
}

/// Index of a permutation, for the effect `joint_order`: of the joints that set-points reach, the inverse of the columns `order` that
/// joints follow.
pub(super) fn permutation(order: &[usize; 6]) -> f64 {
    let mut reached = [0; 6];
    for (joint, column) in order.iter().enumerate() {
        reached[*column] = joint;
    }
    conventions::index(&reached) as f64
}
