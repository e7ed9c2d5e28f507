//! From the tiers to the verdict.

use std::collections::BTreeMap;

use super::found::{self, Item};
use super::score::{JointRow, Metrics, Score, State, bootstrap, unit};
use super::{Parts, Settings, conventions, search};
use crate::math;
use crate::verdict::*;
use crate::vocabulary::{Effect, Stage};

/// Cost per sample, in squared tolerances, above which a remainder is significant. Null robots stay below 4, see docs/diagnosis.md.
pub(super) const REMAINDER: f64 = 6.0;
/// Share of the gap that must be explained for `explained`.
const EXPLAINED: f64 = 0.8;
/// Cost that set-points changed on the way in a manner nobody knows stand for: above all that a fit leaves.
const ODD: f64 = 1e4;
/// Two effects explain the data equally well below this many standard deviations.
pub(super) const MARGIN: f64 = 3.0;

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
}

impl Scores {
    pub(super) fn new(d: &Parts, score: &Score, items: &[Item]) -> Self {
        let pick = |of: &dyn Fn(&search::Answer) -> Vec<f64>, conventions: bool| State {
            joints: d.joints.iter().map(|f| of(&f.answer)).collect(),
            body: d.body.as_ref().map_or_else(Vec::new, |b| of(&b.answer)),
            camera: d.camera.as_ref().map_or_else(Vec::new, |c| of(&c.answer)),
            conventions,
        };
        let mut first = pick(&|a| a.nominal.clone(), false);
        for (theta, f) in first.joints.iter_mut().zip(&d.joints) {
            theta.clone_from(&f.answer.nominal);
            found::unsigned(theta);
        }
        let base = pick(&|a| a.steps[0].theta.clone(), true);
        let last = pick(&|a| a.last().theta.clone(), true);
        let before = score.metrics(&first);
        let calibrated = score.metrics(&base);
        let after = score.metrics(&last);
        let items = items
            .iter()
            .map(|i| {
                let (mut alone, mut removed) = (base.clone(), last.clone());
                match i.place {
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
                    found::Place::Camera(m) => {
                        if let Some(c) = &d.camera {
                            let (r, a) = &c.answer.removed_alone[m];
                            alone.camera.clone_from(&a.theta);
                            removed.camera.clone_from(&r.theta);
                        }
                    }
                    found::Place::Convention => removed = first.clone(),
                    // Its part of the model is outside the joints' laws.
                    found::Place::Direct => {}
                }
                (score.metrics(&alone), score.metrics(&removed))
            })
            .collect();
        let mut out = Self {
            before,
            calibrated,
            after,
            items,
            primary: "position_rmse_rad",
            joints: score.by_joint(&first, &last),
        };
        out.primary = out.choose();
        out
    }

    /// The metric that fell most; without effects the base pose where measured, else the angles.
    fn choose(&self) -> &'static str {
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
        let fall = |n: &str| mean(&self.after, n) / mean(&self.before, n).max(1e-12);
        known
            .min_by(|a, b| fall(a).total_cmp(&fall(b)))
            .unwrap_or("position_rmse_rad")
    }
}

fn floor(d: &Parts, score: &Score, metric: &str) -> (f64, bool) {
    let spread: Vec<f64> = d
        .joints
        .iter()
        .map(|f| f.tier.repeat_rad)
        .filter(|x| x.is_finite())
        .collect();
    match metric {
        "pose_rmse_m" => (score.body.as_ref().map_or(0.0, |b| b.tolerance_m()), false),
        "effort_rmse_nm" => {
            let own: Vec<f64> = d
                .joints
                .iter()
                .map(|f| f.tier.torque_tolerance_nm())
                .collect();
            (math::mean(&own), false)
        }
        _ if !spread.is_empty() => (math::mean(&spread), true),
        _ => {
            let own: Vec<f64> = d.joints.iter().map(|f| f.tier.tolerance_rad).collect();
            (math::mean(&own), false)
        }
    }
}

fn gap(d: &Parts, score: &Score, s: &Scores, settings: &Settings) -> Gap {
    let m = s.primary;
    let (before, cal, after) = (
        mean(&s.before, m),
        mean(&s.calibrated, m),
        mean(&s.after, m),
    );
    let (floor, repeats) = floor(d, score, m);
    let share = |a: f64, b: f64| if b > 0.0 { 1.0 - a / b } else { 0.0 };
    Gap {
        metric: m.into(),
        unit: unit(m).into(),
        before,
        after_calibration: cal,
        after,
        floor,
        floor_source: if repeats { "repeats" } else { "noise" }.into(),
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

/// Costs of a tier by group: nominal, calibrated, after every effect kept.
struct Fall {
    joint: Option<usize>,
    /// Stage, joint, cost gained by group.
    parts: Vec<(Stage, Option<usize>, Vec<f64>)>,
    left: Vec<f64>,
    stage_of_rest: Stage,
}

fn falls(d: &Parts) -> Vec<Fall> {
    let mut out = Vec::new();
    let tiers = d
        .joints
        .iter()
        .map(|f| (Some(f.tier.joint), &f.answer, Stage::Drivetrain))
        .chain(d.body.iter().map(|b| (None, &b.answer, Stage::Body)))
        .chain(d.camera.iter().map(|c| (None, &c.answer, Stage::Camera)));
    for (joint, a, rest) in tiers {
        let mut parts = Vec::new();
        let mut now = a.nominal_groups.clone();
        let mut down = |to: &[f64], stage: Stage, joint| {
            let gained = now.iter().zip(to).map(|(x, y)| x - y).collect();
            now = to.to_vec();
            parts.push((stage, joint, gained));
        };
        let calibrated = if joint.is_some() { Stage::Driver } else { rest };
        down(&a.steps[0].groups, calibrated, joint);
        let last = a.last();
        // What every effect gains in the final model, scaled to the whole fall.
        let whole: Vec<f64> = now
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
            parts.push((c.effect.stage(), c.joint, part));
        }
        let left = last.groups.iter().map(|c| (c - 1.0).max(0.0)).collect();
        out.push(Fall {
            joint,
            parts,
            left,
            stage_of_rest: rest,
        });
    }
    out
}

/// Shares of the gap by stage and joint; the remainder is placed where it is significant.
fn places(d: &Parts, items: &[Item], settings: &Settings) -> Vec<Where> {
    let falls = falls(d);
    let mut rows: BTreeMap<(String, Option<usize>), Vec<f64>> = BTreeMap::new();
    let groups = falls.iter().map(|f| f.left.len()).max().unwrap_or(0);
    let mut add = |key: (String, Option<usize>), v: &[f64]| {
        let slot = rows.entry(key).or_insert_with(|| vec![0.0; groups]);
        slot.iter_mut().zip(v).for_each(|(s, x)| *s += x.max(0.0));
    };
    for f in &falls {
        for (stage, joint, v) in &f.parts {
            add((stage.name().into(), *joint), v);
        }
        let odd = d
            .joints
            .iter()
            .any(|j| j.odd && Some(j.tier.joint) == f.joint);
        let unsteady = f.stage_of_rest == Stage::Body && unsteady(d);
        let key = if math::mean(&f.left) > REMAINDER || odd || unsteady {
            (f.stage_of_rest.name().to_string(), f.joint)
        } else {
            ("unexplained".into(), None)
        };
        add(key, &f.left);
    }
    let odd: Vec<usize> = (0..6).filter(|k| d.conventions.echo[*k].odd).collect();
    // What all joints show is not theirs.
    let shared = odd.len() == 6;
    for k in odd.iter().take(if shared { 1 } else { 6 }) {
        let key = (Stage::Transport.name().into(), (!shared).then_some(*k));
        add(key, &vec![ODD; groups]);
    }
    let told = |i: &&Item| matches!(i.place, found::Place::Convention | found::Place::Direct);
    for c in items.iter().filter(told) {
        add(
            (c.effect.stage().name().into(), c.joint),
            &vec![c.gain; groups],
        );
    }
    rows.entry(("unexplained".into(), None))
        .or_insert_with(|| vec![0.0; groups]);
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
    let row = |(key, v): (&(String, Option<usize>), &Vec<f64>)| {
        let all: Vec<f64> = draws
            .iter()
            .zip(&totals)
            .map(|(g, t)| g.iter().map(|i| v[*i]).sum::<f64>() / t)
            .collect();
        Where {
            stage: key.0.clone(),
            joint: key.1,
            regime: "all".into(),
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
    out.iter_mut().for_each(|w| w.share /= sum.max(1e-12));
    out
}

/// Largest cost that a tier keeps, and the share of all excess that was explained.
fn remainder(d: &Parts) -> (f64, f64) {
    let (mut worst, mut first, mut last) = (0.0f64, 0.0, 0.0);
    for a in d
        .joints
        .iter()
        .map(|f| &f.answer)
        .chain(d.body.iter().map(|b| &b.answer))
        .chain(d.camera.iter().map(|c| &c.answer))
    {
        worst = worst.max(a.last().cost);
        first += (math::mean(&a.nominal_groups) - 1.0).max(0.0);
        last += (a.last().cost - 1.0).max(0.0);
    }
    let explained = if first > 0.0 { 1.0 - last / first } else { 1.0 };
    let (odd, least) = unexplained(d);
    if odd {
        (worst.max(2.0 * REMAINDER), 0.0)
    } else {
        (worst, explained.min(least))
    }
}

/// Whether the ground does not stay the same during a run.
fn unsteady(d: &Parts) -> bool {
    d.body.as_ref().is_some_and(|b| b.unsteady)
}

/// Whether something follows a law that the library does not hold, and the least share explained of a joint that keeps a remainder.
fn unexplained(d: &Parts) -> (bool, f64) {
    let odd =
        d.conventions.echo.iter().any(|e| e.odd) || d.joints.iter().any(|f| f.odd) || unsteady(d);
    let share = |a: &search::Answer| {
        let excess = |cost: f64| (cost - 1.0).max(0.0);
        1.0 - excess(a.last().cost) / excess(math::mean(&a.nominal_groups)).max(1e-12)
    };
    let left = d
        .joints
        .iter()
        .map(|f| &f.answer)
        .filter(|a| a.last().cost > REMAINDER);
    (odd, left.map(share).fold(1.0, f64::min))
}

fn word(items: &[Item], worst: f64, explained: f64) -> Word {
    let left = worst > REMAINDER;
    match (items.is_empty(), left) {
        (true, false) => Word::None,
        (true, true) => Word::Unknown,
        (false, true) if explained < EXPLAINED => Word::Unknown,
        (false, true) => Word::PartlyExplained,
        (false, false) if items.iter().all(|i| i.effect.is_base()) => Word::Parametric,
        (false, false) => Word::Explained,
    }
}

/// How often a verdict was right on emulated robots made for development, where every margin was clear.
const TRUST: f64 = 0.87;

fn probabilities(word: Word, worst: f64) -> Probabilities {
    let logistic = |x: f64| 1.0 / (1.0 + libm::exp(-x));
    let beyond = worst / REMAINDER;
    match word {
        Word::None => {
            let unknown = 0.5 * logistic(6.0 * (beyond - 1.0));
            Probabilities {
                none: TRUST * (1.0 - unknown),
                unknown: 1.0 - TRUST * (1.0 - unknown),
            }
        }
        Word::Unknown => Probabilities {
            none: 0.01,
            unknown: logistic(2.0 * beyond).min(TRUST),
        },
        _ => Probabilities {
            none: 0.02,
            unknown: (0.98 - TRUST) + 0.4 * logistic(4.0 * (beyond - 1.5)),
        },
    }
}

fn rows(items: &[Item], s: &Scores, p: Probabilities) -> Vec<EffectRow> {
    let weights: Vec<f64> = items.iter().map(Item::certainty).collect();
    let sum: f64 = weights.iter().sum();
    let rest = 1.0 - p.none - p.unknown;
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
                confidence: rest * weights[i] / sum.max(1e-12),
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

fn ambiguous(items: &[Item]) -> Vec<Ambiguous> {
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
            separate_by: found::separate_by(&effects).into(),
            effects,
            members,
        });
    }
    out
}

fn sentence(word: Word, gap: &Gap, rows: &[EffectRow], place: &[Where]) -> String {
    let name = |r: &EffectRow| match r.joint {
        Some(k) => format!("{} (joint {k})", r.effect.plain()),
        None => r.effect.plain().to_string(),
    };
    let list = rows.iter().map(name).collect::<Vec<_>>().join(" and ");
    let percent = (100.0 * gap.shrink).round();
    match word {
        Word::None => "The model explains the recordings as well as they can be explained; there is no gap to name.".into(),
        Word::Explained | Word::Parametric => {
            format!("The gap comes from this: {list}. With it in the model the held-out error falls by {percent} %.")
        }
        Word::PartlyExplained => {
            format!("A part of the gap is named: {list}. The held-out error falls by {percent} %; a remainder stays.")
        }
        Word::Unknown => {
            let at = place.iter().find(|p| p.stage != "unexplained");
            let stage = at.map_or("body", |p| p.stage.as_str());
            let joint = at.and_then(|p| p.joint).map_or_else(String::new, |k| format!(" of joint {k}"));
            format!("There is a gap that no effect in the library explains; look at the {stage}{joint}.")
        }
    }
}

/// The verdict.
pub(super) fn verdict(d: &Parts, score: &Score, settings: &Settings) -> (Verdict, Vec<JointRow>) {
    let items = found::items(d);
    let s = Scores::new(d, score, &items);
    let gap = gap(d, score, &s, settings);
    let (worst, explained) = remainder(d);
    let word = word(&items, worst, explained);
    let probabilities = probabilities(word, worst);
    let effects = rows(&items, &s, probabilities);
    let place = places(d, &items, settings);
    let ambiguous = ambiguous(&items);
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
    let verdict = Verdict {
        schema: "rb.gap/1".into(),
        verdict: word,
        sentence: sentence(word, &gap, &effects, &place),
        partial: false,
        next_experiment: found::next(&ambiguous, word),
        unseen: found::unseen(d, settings),
        pulled: BTreeMap::new(),
        gap,
        metrics,
        staircase,
        place,
        effects,
        probabilities,
        ambiguous,
        provenance: Provenance {
            tool: concat!("rb-gap ", env!("CARGO_PKG_VERSION")).into(),
            commit: None,
            data_sha256: String::new(),
            seed: settings.seed,
            split: d.split.clone(),
            wall_time_s: 0.0,
        },
    };
    (verdict, s.joints)
}

/// Index of a permutation, for the effect `joint_order`.
pub(super) fn permutation(order: &[usize; 6]) -> f64 {
    conventions::index(order) as f64
}
