//! From the search to the verdict.

mod drift;
mod interval;
mod place;
mod word;

use std::collections::BTreeMap;

use self::place::{places, regimes};
use self::word::{probabilities, word};
use super::{Diagnosis, Settings};
use crate::candidates::{self, Candidate};
use crate::experiment;
use crate::fit;
use crate::joint::{Channel, Params, Trace, simulate, simulate_all};
use crate::locate;
use crate::math;
use crate::names;
use crate::report::words::listed;
use crate::select::{PULL, Search};
use crate::sentence::sentence;
use crate::verdict::*;
use crate::vocabulary::{Effect, Stage};

/// Two models explain the data equally well below this many standard deviations.
const MARGIN: f64 = 3.0;

fn per_run(d: &Diagnosis, params: &Params, ideal: bool, absolute: bool) -> Vec<f64> {
    let one = |r: &usize| {
        let e = locate::errors(
            &d.problem,
            &d.problem.runs[*r],
            params,
            ideal,
            Channel::Position,
        );
        if absolute {
            e.iter().map(|x| x.abs()).sum::<f64>() / e.len().max(1) as f64
        } else {
            math::rms(&e)
        }
    };
    d.score_runs.iter().map(one).collect()
}

/// Names of the metrics: RMS and mean absolute position, link, effort.
fn metric_names(linear: bool) -> [&'static str; 4] {
    if linear {
        [
            "position_rmse_m",
            "position_mae_m",
            "link_rmse_m",
            "effort_rmse_n",
        ]
    } else {
        [
            "position_rmse_rad",
            "position_mae_rad",
            "link_rmse_rad",
            "effort_rmse_nm",
        ]
    }
}

/// All metrics on the score runs: per run first, then the equal-weight mean.
pub(super) fn metrics(d: &Diagnosis, params: &Params, ideal: bool) -> BTreeMap<&'static str, f64> {
    let mut out = BTreeMap::new();
    let [rmse, mae, link, effort] = metric_names(d.problem.linear);
    out.insert(rmse, math::mean(&per_run(d, params, ideal, false)));
    out.insert(mae, math::mean(&per_run(d, params, ideal, true)));
    for (name, channel) in [(link, Channel::Link), (effort, Channel::Effort)] {
        if candidates::measured(&d.problem, channel) {
            let one = |r: &usize| {
                math::rms(&locate::errors(
                    &d.problem,
                    &d.problem.runs[*r],
                    params,
                    false,
                    channel,
                ))
            };
            out.insert(
                name,
                math::mean(&d.score_runs.iter().map(one).collect::<Vec<_>>()),
            );
        }
    }
    out
}

fn score(d: &Diagnosis, params: &Params, ideal: bool) -> f64 {
    math::mean(&per_run(d, params, ideal, false))
}

fn bootstrap(values: &[f64], seed: u64) -> [f64; 2] {
    let mut rng = math::Rng::new(seed);
    let draw = |rng: &mut math::Rng| {
        math::mean(
            &values
                .iter()
                .map(|_| values[rng.index(values.len())])
                .collect::<Vec<_>>(),
        )
    };
    let all: Vec<f64> = (0..400).map(|_| draw(&mut rng)).collect();
    [math::quantile(&all, 0.025), math::quantile(&all, 0.975)]
}

fn gap(d: &Diagnosis, settings: &Settings) -> Gap {
    let before = score(d, &d.nominal, d.ideal);
    let after_calibration = score(d, &d.calibrated.params, false);
    let runs = per_run(d, &d.selection.model.params, false, false);
    let after = math::mean(&runs);
    let floor = d.floor.of(0);
    let share = |a: f64, b: f64| if b > 0.0 { 1.0 - a / b } else { 0.0 };
    let linear = d.problem.linear;
    Gap {
        metric: metric_names(linear)[0].into(),
        unit: if linear { "m" } else { "rad" }.into(),
        before,
        after_calibration,
        after,
        floor,
        floor_source: if d.floor.repeat.is_some() {
            "repeats"
        } else {
            "noise"
        }
        .into(),
        ci95_after: bootstrap(&runs, settings.seed),
        shrink: share(after, before),
        shrink_after_calibration: share(after, after_calibration),
        shrink_of_achievable: d.floor.repeat.map(|_| {
            if before > floor {
                (before - after) / (before - floor)
            } else {
                1.0
            }
        }),
        held_out_runs: d
            .score_runs
            .iter()
            .map(|r| d.problem.runs[*r].name.clone())
            .collect(),
    }
}

/// How many standard deviations a rival is worse: likelihood ratio of two fits to errors of unknown size.
fn margin(cost_ratio: f64, independent: f64) -> f64 {
    (independent * libm::log(cost_ratio.max(1.0))).sqrt()
}

/// The dead-zone class of design and literature: with set-point and position alone they cannot be told apart.
const DEAD_ZONE: [Effect; 3] = [Effect::Deadband, Effect::Backlash, Effect::StribeckFriction];

fn position_only(d: &Diagnosis) -> bool {
    [
        Channel::Current,
        Channel::Duty,
        Channel::Link,
        Channel::Effort,
    ]
    .iter()
    .all(|c| !candidates::measured(&d.problem, *c))
}

/// Members of the class of effect `k` of the search that this data cannot separate, with their weights.
fn class(d: &Diagnosis, k: usize) -> Vec<(Effect, f64)> {
    let found = d.selection.found[k].candidate.effect;
    let mut out = vec![(found, 1.0)];
    for r in &d.selection.rivals[k] {
        let m = margin(r.cost_ratio, d.independent);
        if m < MARGIN {
            out.push((r.effect, libm::exp(-0.5 * m * m)));
        }
    }
    if position_only(d) && DEAD_ZONE.contains(&found) {
        for e in DEAD_ZONE {
            if out.iter().all(|o| o.0 != e) {
                out.push((e, 0.3));
            }
        }
        out.retain(|o| DEAD_ZONE.contains(&o.0));
    }
    let taken = |e: Effect| {
        d.selection
            .found
            .iter()
            .enumerate()
            .any(|(i, f)| i != k && f.candidate.effect == e)
    };
    out.retain(|o| !taken(o.0));
    out.truncate(3);
    let sum: f64 = out.iter().map(|o| o.1).sum();
    out.iter_mut().for_each(|o| o.1 /= sum);
    out
}

fn effect_rows(d: &Diagnosis, left: f64) -> Vec<EffectRow> {
    let s = &d.selection;
    let spread = interval::spread(d);
    let n = s.found.len() as f64;
    let row = |(k, f): (usize, &crate::select::Found)| {
        let c = &f.candidate;
        let alternative = |r: &crate::select::Rival| {
            let m = margin(r.cost_ratio, d.independent);
            Alternative {
                effect: r.effect,
                distinguishable: m >= MARGIN,
                margin: round(m),
            }
        };
        let (alone, removed) = &d.alone_removed[k];
        EffectRow {
            effect: c.effect,
            stage: c.effect.stage().name().into(),
            joint: Some(d.problem.joint),
            // Without a unit of effort, a torque is a number without meaning.
            parameters: (interval::estimates(d, c, spread.as_ref()).into_iter())
                .filter(|(key, _)| d.problem.known.effort_unit || !key.contains("nm"))
                .collect(),
            confidence: (1.0 - left) / n,
            alternatives: d.selection.rivals[k].iter().map(alternative).collect(),
            gap_added_alone: score(d, &alone.params, false),
            gap_removed_from_full: score(d, &removed.params, false),
            kind: if c.effect.is_base() {
                "parametric"
            } else {
                "structural"
            }
            .into(),
            plausible: names::plausible(c, &s.model.params, &d.scales),
        }
    };
    let mut rows: Vec<EffectRow> = s.found.iter().enumerate().map(row).collect();
    // Ranked by what the model loses without them.
    rows.sort_by(|a, b| b.gap_removed_from_full.total_cmp(&a.gap_removed_from_full));
    rows
}

fn round(x: f64) -> f64 {
    (x * 1e3).round() / 1e3
}

/// Largest change that each candidate of plausible size makes, in tolerances.
fn visibility(d: &Diagnosis, candidates: &[Candidate]) -> Vec<f64> {
    let weight = d.floor.weights();
    let base = d.selection.model.params;
    // Traces held in memory at once.
    const MOST: usize = 64;
    let (mut sets, mut owners) = (Vec::new(), Vec::new());
    for (k, c) in candidates.iter().enumerate() {
        for start in c.starts.iter().rev().take(3) {
            let moved = c.free.iter().zip(start);
            sets.push(moved.fold(base, |p, (f, v)| p.with(f.p, *v)));
            owners.push(k);
        }
    }
    let mut squares = vec![0.0; owners.len()];
    for run in d.fit_runs.iter().map(|r| &d.problem.runs[*r]) {
        let mut plain = Trace::new();
        simulate(run, &base, d.problem.dt_s, &mut plain);
        let n = plain.len().max(1) as f64;
        for (sets, squares) in sets.chunks(MOST).zip(squares.chunks_mut(MOST)) {
            let traces = simulate_all(run, sets, d.problem.dt_s);
            for (sum, trace) in squares.iter_mut().zip(&traces) {
                for (x, y) in plain.iter().zip(trace) {
                    let change = |k: usize| ((x[k] - y[k]) * weight[k]).powi(2);
                    let used = (0..weight.len()).filter(|k| weight[*k] > 0.0);
                    *sum += used.map(change).sum::<f64>() / n;
                }
            }
        }
    }
    let runs = d.fit_runs.len().max(1) as f64;
    let mut largest: Vec<f64> = vec![0.0; candidates.len()];
    for (k, sum) in owners.into_iter().zip(squares) {
        largest[k] = largest[k].max((sum / runs).sqrt());
    }
    largest
}

fn unseen(d: &Diagnosis, library: &[Candidate], settings: &Settings) -> Vec<Unseen> {
    let visible = visibility(d, library);
    let mut out = Vec::new();
    for e in Effect::ALL
        .iter()
        .filter(|e| Stage::JOINT.contains(&e.stage()) && !settings.withhold.contains(e))
    {
        let mut mine = library.iter().zip(&visible).filter(|c| c.0.effect == *e);
        if d.selection.found.iter().any(|f| f.candidate.effect == *e) {
            continue;
        }
        let why = if library.iter().all(|c| c.effect != *e) {
            match e {
                Effect::JointOrder => "a bench has one joint",
                Effect::Jitter | Effect::PacketLoss => {
                    "needs the applied set-point as the driver echoes it"
                }
                Effect::Compliance => {
                    "the encoder sits before the gear; needs link_position and a load"
                }
                Effect::ConnectorCompliance | Effect::ConnectorPlay => "a bench has no connector",
                _ => "its parameter has no nominal value in this data set, or no signal shows it",
            }
        } else if mine.all(|(_, visible)| *visible < 1.0) {
            "largest plausible size stays under the noise floor in these runs"
        } else {
            continue;
        };
        out.push(Unseen {
            effect: *e,
            why: why.into(),
        });
    }
    out
}

fn ambiguous(d: &Diagnosis) -> Vec<Ambiguous> {
    let mut out = Vec::new();
    for k in 0..d.selection.found.len() {
        let members = class(d, k);
        if members.len() < 2 {
            continue;
        }
        let effects: Vec<Effect> = members.iter().map(|m| m.0).collect();
        let member = |m: &(Effect, f64)| Member {
            effect: m.0,
            stage: m.0.stage().name().into(),
            joint: Some(d.problem.joint),
            probability: m.1,
        };
        out.push(Ambiguous {
            members: members.iter().map(member).collect(),
            separate_by: names::separate_by(&effects, &d.problem).into(),
            effects,
        });
    }
    out
}

/// Nominal values of base effects that calibration took beyond their tolerances without an effect of that name being found:
/// they take the place of whatever the data shows. The farthest comes first.
fn displaced(d: &Diagnosis) -> Vec<Displaced> {
    let model = &d.selection.model;
    let one = |f: &fit::Free| {
        f.tolerance?;
        let effect = candidates::base_effect(f.p)?;
        let tolerances = candidates::pull(&model.free, f.p, &model.params)?;
        (tolerances > PULL).then(|| Displaced {
            effect,
            stage: effect.stage().name().into(),
            joint: Some(d.problem.joint),
            value: model.params.get(f.p),
            tolerances: round(tolerances),
        })
    };
    let mut out: Vec<Displaced> = model.free.iter().filter_map(one).collect();
    out.sort_by(|a, b| b.tolerances.total_cmp(&a.tolerances));
    out
}

/// What is to be said of nominal values beyond their tolerances.
fn taken_off(displaced: &[Displaced]) -> String {
    let one = |s: &Displaced| format!("{} ({:.1} tolerances)", s.effect.plain(), s.tolerances);
    match displaced {
        [] => String::new(),
        some => format!(
            " Calibration moved stated values beyond their tolerances: {}.",
            listed(&some.iter().map(one).collect::<Vec<_>>(), 3, "and")
        ),
    }
}

/// What is to be said of end stops.
fn stops(d: &Diagnosis) -> String {
    let unit = if d.problem.linear { "m" } else { "rad" };
    let travel = d.problem.runs.first().map(|r| r.nominal.travel);
    let met = travel.into_iter().flatten().filter(|x| x.is_finite());
    met.map(|x| format!(" The joint ran against a stop at {x:.3} {unit}; that is in the model."))
        .collect()
}

/// A verdict with nothing in it, replaced before anyone sees it.
pub(super) fn empty() -> Verdict {
    Verdict {
        schema: "rb.gap/1".into(),
        verdict: Word::None,
        sentence: String::new(),
        partial: false,
        gap: Gap {
            metric: String::new(),
            unit: String::new(),
            before: 0.0,
            after_calibration: 0.0,
            after: 0.0,
            floor: 0.0,
            floor_source: String::new(),
            ci95_after: [0.0; 2],
            shrink: 0.0,
            shrink_after_calibration: 0.0,
            shrink_of_achievable: None,
            held_out_runs: Vec::new(),
        },
        metrics: BTreeMap::new(),
        staircase: Vec::new(),
        place: Vec::new(),
        regimes: Vec::new(),
        effects: Vec::new(),
        probabilities: Probabilities {
            none: 1.0,
            unknown: 0.0,
        },
        unseen: Vec::new(),
        ambiguous: Vec::new(),
        next_experiment: None,
        pulled: BTreeMap::new(),
        displaced: Vec::new(),
        provenance: Provenance {
            tool: concat!("gap ", env!("CARGO_PKG_VERSION")).into(),
            commit: None,
            data_sha256: String::new(),
            seed: 0,
            split: String::new(),
            wall_time_s: 0.0,
            warnings: Vec::new(),
        },
    }
}

fn staircase(d: &Diagnosis) -> Vec<Stair> {
    let mut out = vec![Stair {
        step: "nominal".into(),
        gap: score(d, &d.nominal, d.ideal),
    }];
    for s in &d.selection.steps {
        let step = s.added.map_or("calibrated", Effect::name).into();
        out.push(Stair {
            step,
            gap: score(d, &s.model.params, false),
        });
    }
    out
}

/// Models of the other members of the class of effect `k`: as the search fitted them, else fitted now.
fn rivals(d: &Diagnosis, k: usize, search: &Search<'_>) -> Vec<fit::Model> {
    let mine = &d.selection.found[k].candidate;
    let others = class(d, k).into_iter().filter(|m| m.0 != mine.effect);
    let one = |(effect, _): (Effect, f64)| {
        let fitted = d.selection.rivals[k].iter().find(|r| r.effect == effect);
        match fitted {
            Some(r) => Some(r.model.clone()),
            None => search.stand_in(&d.selection.model, mine, effect),
        }
    };
    others.filter_map(one).collect()
}

/// The next experiment: what tells the first class apart, else what shows more of a gap that nothing explains.
pub(super) fn propose(d: &mut Diagnosis, search: &Search<'_>) {
    let first = (0..d.selection.found.len()).find(|k| class(d, *k).len() > 1);
    let open = matches!(d.verdict.verdict, Word::Unknown | Word::PartlyExplained);
    let (experiment, separates, advice) = match first {
        Some(k) => {
            let effects: Vec<Effect> = class(d, k).iter().map(|m| m.0).collect();
            let others = rivals(d, k, search);
            let truth = &d.selection.model.params;
            let best = if others.is_empty() {
                experiment::survey(&d.problem)
            } else {
                let weight = d.floor.weights();
                let stop = search.objective.stop;
                experiment::separating(&d.problem, truth, &others, weight, d.independent, stop)
            };
            let advice = format!(
                "To distinguish {}: {}.",
                list(&effects),
                names::separate_by(&effects, &d.problem)
            );
            (best, effects, advice)
        }
        None if open => {
            let advice = "Record signed current, duty and bus voltage at 100 Hz; they tell the driver, the electrical part and the gear apart.";
            (experiment::survey(&d.problem), Vec::new(), advice.into())
        }
        None => return,
    };
    let text = match &experiment {
        Some(e) if e.separation.is_some() => experiment::words(e, &separates, d.problem.linear),
        Some(e) => {
            let motion = experiment::words(e, &separates, d.problem.linear);
            format!("{motion} {advice}")
        }
        None => advice,
    };
    d.experiment = experiment;
    d.verdict.next_experiment = Some(NextExperiment {
        text,
        separates,
        gait: None,
    });
}

fn list(effects: &[Effect]) -> String {
    let names: Vec<&str> = effects.iter().map(|e| e.plain()).collect();
    listed(&names, names.len(), "and")
}

/// Puts a diagnosis into the public form.
pub(super) fn verdict(d: &Diagnosis, library: &[Candidate], settings: &Settings) -> Verdict {
    let gap = gap(d, settings);
    let word = word(d, &gap, settings);
    let probabilities = probabilities(d, word, settings);
    let mut effects = effect_rows(d, probabilities.none + probabilities.unknown);
    let place = places(d, word, settings);
    let displaced = displaced(d);
    let ambiguous = ambiguous(d);
    keep_together(&mut effects, &ambiguous);
    let three = [
        (&d.nominal, d.ideal),
        (&d.calibrated.params, false),
        (&d.selection.model.params, false),
    ];
    let all = three.map(|(p, ideal)| metrics(d, p, ideal));
    let pulled = d
        .selection
        .model
        .free
        .iter()
        .filter(|f| f.tolerance.is_some());
    let mut out = Verdict {
        displaced,
        verdict: word,
        metrics: all[0]
            .keys()
            .map(|k| ((*k).to_string(), [all[0][k], all[1][k], all[2][k]]))
            .collect(),
        staircase: staircase(d),
        place,
        regimes: regimes(d),
        effects,
        probabilities,
        unseen: unseen(d, library, settings),
        ambiguous,
        pulled: pulled
            .map(|f| {
                (
                    format!("{:?}", f.p).to_lowercase(),
                    round(f.pull(d.selection.model.params.get(f.p))),
                )
            })
            .filter(|(_, z)| z.abs() > 3.0)
            .collect(),
        provenance: Provenance {
            seed: settings.seed,
            split: d.split.clone(),
            ..empty().provenance
        },
        partial: d.selection.partial,
        gap,
        ..empty()
    };
    out.sentence = sentence(&out, false) + &taken_off(&out.displaced) + &stops(d);
    out
}
