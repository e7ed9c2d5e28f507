//! One joint, from recordings to verdict.

mod answer;
mod calibrate;

use std::collections::BTreeMap;

use files::dataset::{Manifest, Recording, Role};

use crate::candidates::{self, Candidate, Scales};
use crate::experiment::Experiment;
use crate::fit::{Model, Objective, Stop};
use crate::floor::{self, Floor};
use crate::joint::{P, Params, Problem};
use crate::report::Subject;
use crate::select::{Options, Search, Selection, Watch};
use crate::verdict::Verdict;
use crate::vocabulary::Effect;

/// Settings of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Seed of global starts and bootstraps.
    pub seed: u64,
    /// Effects the library must not contain (leave-one-out checks).
    pub withhold: Vec<Effect>,
    /// Limits and thresholds of the search.
    pub options: Options,
    /// A joint that was diagnosed before: its whole model is taken as it is, and only what came on top is named.
    pub baseline: Option<Params>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 1,
            withhold: Vec::new(),
            options: Options::default(),
            baseline: None,
        }
    }
}

/// Why a data set cannot be diagnosed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DiagnoseError {
    /// No run has a position column for this joint.
    #[error(
        "joint {joint}: no run measured position; record position_rad (or _m) to get a diagnosis"
    )]
    NoPosition {
        /// Joint.
        joint: usize,
    },
    /// Nothing to fit.
    #[error(
        "joint {joint}: no run with role \"fit\" measured position; give at least one run role = \"fit\""
    )]
    NoFitRuns {
        /// Joint.
        joint: usize,
    },
}

/// Everything that was found about one joint, before it is put into words.
#[derive(Debug, Clone)]
pub struct Diagnosis {
    /// Data.
    pub problem: Problem,
    /// Noise.
    pub floor: Floor,
    /// Runs that were fitted.
    pub fit_runs: Vec<usize>,
    /// Runs the figures are taken on.
    pub score_runs: Vec<usize>,
    /// How they were split.
    pub split: String,
    /// Nothing is known of the servo: the nominal model is "position = set-point".
    pub ideal: bool,
    /// Nominal model.
    pub nominal: Params,
    /// Calibrated model.
    pub calibrated: Model,
    /// Search.
    pub selection: Selection,
    /// Cost of a perfect model.
    pub floor_cost: f64,
    /// Models with one effect alone, and with all but one.
    pub alone_removed: Vec<(Model, Model)>,
    /// Typical sizes.
    pub scales: Scales,
    /// Independent samples.
    pub independent: f64,
    /// What to record next.
    pub experiment: Option<Experiment>,
    /// The verdict.
    pub verdict: Verdict,
}

fn measured(problem: &Problem, run: usize) -> bool {
    problem.runs[run]
        .samples
        .iter()
        .any(|s| s.enabled && s.measured[0].is_finite())
}

/// Fit runs and score runs, and how they were chosen.
fn split(problem: &Problem) -> (Vec<usize>, Vec<usize>, String) {
    let usable: Vec<usize> = (0..problem.runs.len())
        .filter(|r| measured(problem, *r))
        .collect();
    let role = |r: &usize| problem.runs[*r].role;
    if usable.iter().any(|r| role(r) == Some(Role::Check)) {
        let fit = usable
            .iter()
            .copied()
            .filter(|r| role(r) != Some(Role::Check))
            .collect();
        let score = usable
            .iter()
            .copied()
            .filter(|r| role(r) == Some(Role::Check))
            .collect();
        return (fit, score, "roles of the data set".into());
    }
    let mut gaits: Vec<usize> = usable.iter().map(|r| problem.runs[*r].gait).collect();
    gaits.dedup();
    gaits.sort_unstable();
    gaits.dedup();
    if gaits.len() >= 3 {
        // Every third gait is held out, beginning with the third.
        let held = |r: &usize| {
            gaits
                .iter()
                .position(|g| *g == problem.runs[*r].gait)
                .is_some_and(|i| i % 3 == 2)
        };
        let (score, fit) = usable.iter().partition(|r| held(r));
        return (fit, score, "every third gait held out".into());
    }
    if usable.len() >= 3 {
        let (score, fit): (Vec<(usize, usize)>, Vec<_>) = usable
            .into_iter()
            .enumerate()
            .partition(|(i, _)| i % 3 == 2);
        let strip = |v: Vec<(usize, usize)>| v.into_iter().map(|x| x.1).collect();
        return (
            strip(fit),
            strip(score),
            "every third run held out: fewer than three gaits".into(),
        );
    }
    (
        usable.clone(),
        usable,
        "nothing held out: fewer than three runs".into(),
    )
}

/// At most four groups of gaits (of runs, where there is only one gait).
fn folds(problem: &Problem, runs: &[usize]) -> Vec<Vec<usize>> {
    let mut keys: Vec<usize> = runs.iter().map(|r| problem.runs[*r].gait).collect();
    keys.sort_unstable();
    keys.dedup();
    let by_gait = keys.len() >= 2;
    let count = if by_gait { keys.len() } else { runs.len() }.min(4);
    let mut out = vec![Vec::new(); count];
    for (i, r) in runs.iter().enumerate() {
        let key = if by_gait {
            keys.iter()
                .position(|k| *k == problem.runs[*r].gait)
                .unwrap_or(0)
        } else {
            i
        };
        out[key % count].push(*r);
    }
    out
}

/// Diagnoses joint `joint` of a data set.
///
/// # Errors
/// When no run measured the joint's position.
pub fn diagnose(
    manifest: &Manifest,
    recordings: &[Recording],
    joint: usize,
    settings: &Settings,
) -> Result<Diagnosis, DiagnoseError> {
    diagnose_watched(manifest, recordings, joint, settings, Watch::NOBODY)
}

/// [`diagnose`], telling `watch` what comes next. When it ends the search, the verdict is made from what is there and
/// marked as partial.
///
/// # Errors
/// When no run measured the joint's position.
pub fn diagnose_watched(
    manifest: &Manifest,
    recordings: &[Recording],
    joint: usize,
    settings: &Settings,
    watch: Watch<'_>,
) -> Result<Diagnosis, DiagnoseError> {
    let problem =
        Problem::new(manifest, recordings, joint).ok_or(DiagnoseError::NoPosition { joint })?;
    let (mut fit_runs, score_runs, mut split) = split(&problem);
    if fit_runs.is_empty() {
        return Err(DiagnoseError::NoFitRuns { joint });
    }
    let floor = floor::floor(&problem);
    let lost = problem.out_of_step(floor.noise[0]);
    let kept = without(&fit_runs, &lost);
    if kept.len() < fit_runs.len() && folds(&problem, &kept).len() > 1 {
        split += "; runs that swing out of step not fitted";
        fit_runs = kept;
    }
    let independent = independent(&problem, &fit_runs);
    let free = candidates::nominal(&problem);
    let unknown = free.iter().any(|f| f.tolerance.is_none());
    let k = problem.known;
    let ideal = k.kp.is_none() && !k.effort_unit && settings.baseline.is_none();
    let merged = problem.merged(&fit_runs);
    let objective = Objective {
        problem: &merged,
        runs: (0..merged.runs.len()).collect(),
        weight: floor.weights(),
        prior_weight: 0.0,
        robust: floor.repeat.is_some(),
        stop: Stop::NEVER,
    };
    let floor_cost = floor.cost(mean_count(&merged));
    let unfitted: Vec<P> = (free.iter().filter(|f| f.tolerance.is_none()))
        .map(|f| f.p)
        .collect();
    let rich = match settings.baseline {
        Some(_) => None,
        None => calibrate::rich(&objective, &free, independent, settings.seed),
    };
    let (nominal, calibrated) = match settings.baseline {
        Some(params) => (params, fixed(params)),
        None => calibrate::calibrate(&objective, free, independent, floor_cost, settings.seed),
    };
    let scales = candidates::scales(&problem, &calibrated.params);
    let library = library(&problem, &scales, settings, &unfitted);
    let options = Options {
        thorough: unknown && settings.baseline.is_none(),
        ..settings.options
    };
    let checked = problem.merged(&without(&without(&score_runs, &fit_runs), &lost));
    let check = (!checked.runs.is_empty()).then(|| Objective {
        problem: &checked,
        runs: (0..checked.runs.len()).collect(),
        ..objective.clone()
    });
    let search = Search {
        check,
        objective: objective.clone(),
        folds: folds(&merged, &objective.runs),
        library,
        scales,
        floor_cost,
        independent,
        rich,
        nominal: calibrated.free.iter().map(|f| f.p).collect(),
        options,
    };
    let selection = search.run(calibrated.clone(), watch);
    let alone_removed = search.alone_and_removed(&selection.found, &selection.model, &calibrated);
    let mut out = Diagnosis {
        floor,
        fit_runs,
        score_runs,
        split,
        ideal,
        nominal,
        calibrated,
        selection,
        floor_cost,
        alone_removed,
        scales,
        independent,
        experiment: None,
        verdict: answer::empty(),
        problem,
    };
    out.verdict = answer::verdict(&out, &search.library, settings);
    let said = std::mem::take(&mut out.verdict.sentence);
    out.verdict.sentence = Subject::new(manifest, None).careful(&out.verdict, said);
    if watch.goes_on("choosing the next experiment") {
        let mut with = out.clone();
        answer::propose(&mut with, &search.until(Stop::when(watch.stop)));
        if !(watch.stop)() {
            out = with;
        }
    }
    Ok(out)
}

/// Independent samples in the runs that are fitted.
fn independent(problem: &Problem, runs: &[usize]) -> f64 {
    let steps = runs.iter().map(|r| problem.runs[*r].steps as f64);
    let seconds = steps.map(|n| n * problem.dt_s).sum::<f64>();
    // Model errors of a joint are alike for about half a second; beyond a thousand samples priors hardly matter.
    (2.0 * seconds).clamp(10.0, 1000.0)
}

/// A model of which nothing may move.
fn fixed(params: Params) -> Model {
    Model {
        params,
        free: Vec::new(),
    }
}

/// The effects that may be found.
fn library(
    problem: &Problem,
    scales: &Scales,
    settings: &Settings,
    unfitted: &[P],
) -> Vec<Candidate> {
    let mut out = candidates::library(problem, scales);
    out.retain(|c| !settings.withhold.contains(&c.effect));
    if settings.baseline.is_some() {
        // What the data set leaves unknown was fitted by the baseline; it is no effect then, as it would be none without one.
        // A gain that the data set does not state is one with the unknown strength of the motor.
        let stated = |e: Effect| match e {
            Effect::LoopGain => problem.known.kp.is_some(),
            Effect::DampingGain => problem.known.kd.is_some(),
            _ => true,
        };
        out.retain(|c| stated(c.effect) && c.free.iter().all(|f| !unfitted.contains(&f.p)));
    }
    out
}

/// `runs` that are not among `others`.
fn without(runs: &[usize], others: &[usize]) -> Vec<usize> {
    let rest = runs.iter().filter(|r| !others.contains(r));
    rest.copied().collect()
}

/// Recordings behind one averaged run.
fn mean_count(problem: &Problem) -> f64 {
    problem.runs.iter().map(|r| r.count).sum::<f64>() / problem.runs.len().max(1) as f64
}

/// Metrics of a model on the score runs.
#[must_use]
pub fn metrics(d: &Diagnosis, params: &Params, ideal: bool) -> BTreeMap<&'static str, f64> {
    answer::metrics(d, params, ideal)
}
