//! A joint from recordings to a verdict: its causes, and how far they shrink the gap on runs that no fit saw.

use std::collections::BTreeMap;

use files::dataset::{Manifest, Recording};
use serde::Serialize;

use super::model::Point;
use super::refit::Points;
use super::rows::{Causes, Read};
use super::search::Known;
use super::split::Split;
use super::transport::as_applied;
use super::{Asked, BenchError, Explained, explain, next, verdict};
use crate::decide::Calibration;
use crate::experiment::Experiment;
use crate::floor::{self, Floor};
use crate::joint::{Channel, Problem, RunData};
use crate::locate::{Scored, State};
use crate::math;
use crate::predict;
use crate::report::Subject;
use crate::verdict::Verdict;
use crate::vocabulary::Effect;
use crate::watch::Watch;
use crate::whole::Shrink;

/// Settings of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Seed of bootstraps, and of the noise of plays.
    pub seed: u64,
    /// Effects the library must not contain (leave-one-out checks).
    pub withhold: Vec<Effect>,
    /// A joint that was diagnosed before: only what came on top is named.
    pub baseline: Option<State>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 1,
            withhold: Vec::new(),
            baseline: None,
        }
    }
}

/// The gap on runs that no fit saw.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeldOut {
    /// Names of the runs.
    pub runs: Vec<String>,
    /// How they were chosen.
    pub split: String,
    /// Mean over the runs of the root mean square error, by signal.
    pub errors: BTreeMap<&'static str, Shrink>,
}

/// A cause in words, and the joint without it and with it alone.
#[derive(Debug, Clone)]
pub(super) struct Step {
    /// Name of what came in.
    pub(super) name: &'static str,
    pub(super) state: State,
}

/// A joint's gap and its causes.
#[derive(Debug, Clone)]
pub struct Diagnosis {
    /// The joint with all of its runs, set-points as they were sent.
    pub problem: Problem,
    /// The same as they arrived.
    arrived: Problem,
    /// Runs the figures are taken on.
    pub score_runs: Vec<usize>,
    /// As stated, or as it was diagnosed before.
    pub nominal: State,
    /// With nominal numbers where they fit best.
    pub calibrated: State,
    /// With the causes, as fitted without the runs that the figures are taken on.
    pub found: State,
    /// Spread of repeats and noise.
    pub floor: Floor,
    /// The search from the calibrated joint on.
    pub(super) steps: Vec<Step>,
    /// The causes.
    pub causes: Causes,
    /// What to record next.
    pub experiment: Option<Experiment>,
    /// The verdict `rb.gap/1`.
    pub verdict: Verdict,
}

/// Name, unit and channel of each metric; the mean absolute position beside its root mean square.
pub(super) fn metrics(linear: bool) -> [(&'static str, &'static str, Channel); 3] {
    if linear {
        [
            ("position_rmse_m", "m", Channel::Position),
            ("link_rmse_m", "m", Channel::Link),
            ("effort_rmse_n", "N", Channel::Effort),
        ]
    } else {
        [
            ("position_rmse_rad", "rad", Channel::Position),
            ("link_rmse_rad", "rad", Channel::Link),
            ("effort_rmse_nm", "N m", Channel::Effort),
        ]
    }
}

/// Name of the mean absolute error of the position.
fn absolute(linear: bool) -> &'static str {
    if linear {
        "position_mae_m"
    } else {
        "position_mae_rad"
    }
}

impl Diagnosis {
    /// The runs the figures are taken on.
    #[must_use]
    pub fn scored(&self) -> Scored<'_> {
        Scored {
            sent: &self.problem,
            arrived: &self.arrived,
            runs: &self.score_runs,
        }
    }

    /// Every metric of a state on the scored runs: means over the runs.
    #[must_use]
    pub fn errors(&self, state: &State) -> BTreeMap<&'static str, f64> {
        let scored = self.scored();
        let measured = |c: Channel| crate::candidates::measured(&self.problem, c);
        let all = metrics(self.problem.linear).into_iter();
        let mut out: BTreeMap<&'static str, f64> = all
            .filter(|m| measured(m.2))
            .map(|(name, _, channel)| (name, math::mean(&scored.rmse(state, channel))))
            .collect();
        let each = scored.errors(state, Channel::Position);
        let mean = |e: &Vec<f64>| e.iter().map(|x| x.abs()).sum::<f64>() / e.len().max(1) as f64;
        let means: Vec<f64> = each.iter().map(mean).collect();
        out.insert(absolute(self.problem.linear), math::mean(&means));
        out
    }

    fn held_out(&self, split: &Split) -> HeldOut {
        let three = [&self.nominal, &self.calibrated, &self.found].map(|s| self.errors(s));
        let unit = |name: &str| {
            let own = metrics(self.problem.linear)
                .into_iter()
                .find(|m| m.0 == name);
            own.map_or(if self.problem.linear { "m" } else { "rad" }, |m| m.1)
        };
        let shrink = |name: &&'static str| Shrink {
            unit: unit(name),
            before: three[0][name],
            calibrated: three[1][name],
            after: three[2][name],
        };
        let names = three[0].keys();
        HeldOut {
            runs: self
                .score_runs
                .iter()
                .map(|r| self.problem.runs[*r].name.clone())
                .collect(),
            split: split.how.into(),
            errors: names.map(|n| (*n, shrink(n))).collect(),
        }
    }
}

/// The states of the model that the figures compare.
struct States {
    nominal: State,
    calibrated: State,
    found: State,
    /// Set-points come as the echo shows.
    cut: bool,
}

impl States {
    fn new(
        e: &Explained<'_>,
        problem: &Problem,
        baseline: Option<State>,
        named: &[Read],
        points: &Points,
    ) -> Self {
        let k = problem.known;
        let cut = e.transport.cut_off();
        let of = |point: Point, arrived: bool| State {
            columns: point.columns,
            arrived,
            ..State::new(point.params)
        };
        let stated = State {
            ideal: k.kp.is_none() && !k.effort_unit,
            ..State::new(e.search.start.params)
        };
        Self {
            nominal: baseline.unwrap_or(stated),
            calibrated: of(points.bare, cut && named.is_empty()),
            found: of(points.best, cut),
            cut,
        }
    }

    fn with(&self, point: Point, arrived: bool) -> State {
        State {
            columns: point.columns,
            arrived,
            ..State::new(point.params)
        }
    }
}

/// Diagnoses a joint: names its causes, decided by `calibration`, and compares errors on runs to which no size was fitted.
/// When `watch` ends the search, the verdict is made from what is there and marked as partial.
///
/// # Errors
/// A data set without set-points or positions.
pub fn diagnose(
    manifest: &Manifest,
    recordings: &[Recording],
    settings: &Settings,
    calibration: &Calibration,
    watch: Watch<'_>,
) -> Result<Diagnosis, BenchError> {
    let problem = Problem::new(manifest, recordings, 0).ok_or(BenchError::NoPosition)?;
    let split = Split::new(&problem)?;
    let asked = Asked {
        manifest,
        recordings,
        withhold: &settings.withhold,
        calibration: Some(calibration),
        baseline: settings.baseline,
        watch,
    };
    let known = Known {
        spreads: calibration.spreads_of(super::drive(manifest)),
        laws: &calibration.laws,
    };
    let explained = explain(&asked, known)?;
    let arrived = arrived(manifest, recordings);
    let own = Whole {
        e: &explained,
        split: &split,
        calibration,
    };
    let points = explained.refitted(manifest, &split);
    let mut out = own.diagnosis(problem, arrived, &points, settings);
    let subject = Subject::new(manifest, None);
    let sentence = std::mem::take(&mut out.verdict.sentence);
    out.verdict.sentence = subject.careful(&out.verdict, sentence);
    if watch.goes_on("choosing the next experiment") {
        let with = next::proposed(&out, &explained, subject.tentative, settings.seed);
        if !(watch.stop)() {
            (out.experiment, out.verdict.next_experiment) = with;
        }
    }
    Ok(out)
}

/// The joint with set-points as the driver echoes them.
fn arrived(manifest: &Manifest, recordings: &[Recording]) -> Option<Problem> {
    Problem::new(manifest, &as_applied(recordings), 0)
}

/// What a state of the joint predicts for every run: its name, and the CSV text of [`crate::predict::csv`].
///
/// # Errors
/// A data set without positions.
pub fn predicted(
    manifest: &Manifest,
    recordings: &[Recording],
    state: &State,
) -> Result<Vec<(String, String)>, BenchError> {
    let sent = Problem::new(manifest, recordings, 0).ok_or(BenchError::NoPosition)?;
    let arrived = arrived(manifest, recordings);
    let scored = Scored {
        sent: &sent,
        arrived: arrived.as_ref().unwrap_or(&sent),
        runs: &[],
    };
    let one = |(i, run): (usize, &RunData)| (run.name.clone(), predict::csv(&scored, i, state));
    Ok(sent.runs.iter().enumerate().map(one).collect())
}

/// What was explained, and what of it is compared.
struct Whole<'a> {
    e: &'a Explained<'a>,
    split: &'a Split,
    calibration: &'a Calibration,
}

impl Whole<'_> {
    fn diagnosis(
        &self,
        problem: Problem,
        arrived: Option<Problem>,
        points: &Points,
        settings: &Settings,
    ) -> Diagnosis {
        let (e, split) = (self.e, self.split);
        let named = e.named(self.calibration);
        let states = States::new(e, &problem, settings.baseline, &named, points);
        let steps = e.found.steps.iter().zip(&points.steps);
        let steps = steps.map(|(s, point)| Step {
            name: s.kind.name(),
            state: states.with(*point, states.cut),
        });
        let mut out = Diagnosis {
            arrived: arrived.unwrap_or_else(|| problem.clone()),
            floor: floor::floor(&problem),
            score_runs: split.score.clone(),
            nominal: states.nominal,
            calibrated: states.calibrated,
            found: states.found,
            steps: steps.collect(),
            causes: e.rows(self.calibration),
            experiment: None,
            verdict: Verdict::default(),
            problem,
        };
        let all = |points: &[Point], arrived: bool| -> Vec<State> {
            points.iter().map(|p| states.with(*p, arrived)).collect()
        };
        let without = all(&points.without, states.cut);
        let alone = all(&points.alone, states.calibrated.arrived);
        // What is read from the set-points' way: without it they come as they were sent, with it alone as they arrived.
        let sent = State {
            arrived: false,
            ..out.found
        };
        let arrive = State {
            arrived: states.cut,
            ..out.calibrated
        };
        for row in 0..out.causes.causes.len() {
            let name = out.causes.causes[row].effect;
            let members = &e.found.best.members;
            let kind = |m: &usize| Some(e.search.hypotheses[*m].kind.name()) == name;
            let (without, alone) = match members.iter().position(kind) {
                Some(i) => (without.get(i).unwrap_or(&out.found), &alone[i]),
                None => (&sent, &arrive),
            };
            let errors = [without, alone].map(|s| out.errors(s));
            let [without, alone] = errors;
            let own = &mut out.causes.causes[row];
            (own.without, own.alone) = (without, alone);
        }
        let held_out = out.held_out(split);
        out.causes.held_out = Some(held_out);
        out.verdict = verdict::verdict(&out, e, self.calibration, settings.seed);
        out
    }
}
