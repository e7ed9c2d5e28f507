//! The whole robot: six joints, body, camera, from recordings to verdict.
//!
//! The chain is cut wherever a signal was measured, and each piece is a block of prediction errors ([`blocks`]). Gears are compared along
//! loads replayed from the measured motion, the body in short windows led along the measured angles ([`body`]), the camera against the
//! measured pose. One search explains all blocks together ([`causes`]). Where no tracker recorded a pose, it is read off the film
//! first ([`film`]).

mod advice;
mod blocks;
mod body;
mod body_library;
mod camera;
mod causes;
mod clock;
mod conventions;
pub mod data;
mod direct;
mod echo;
pub mod experiment;
mod film;
mod fit;
mod gaits;
pub mod inertial;
mod least;
mod nominal;
mod order;
mod page;
mod patch;
mod predict;
mod replay;
mod traffic;
mod turn;
mod verdict;
mod windows;

use std::collections::BTreeMap;
use std::sync::Arc;

use control::gait::Gait;
use files::dataset::{Manifest, Recording, Role};
use files::model::Model;
use physics::{Params, ParamsError};

use rayon::prelude::*;

use crate::decide::{Calibration, CalibrationError, Shown};
use crate::evidence::block::White;
use crate::evidence::ensemble::Spreads;
use crate::report::Subject;
use crate::verdict::Verdict;
use crate::vocabulary::Effect;
pub use camera::Film;
use causes::Beside;
pub use causes::{
    Alternative, Causes, HeldOut, Left, Nearest, Place, Probabilities, Row, Shrink, Value, Word,
};
use data::{Data, JOINTS};
pub use predict::predict;

/// Settings of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Seed of the bootstraps.
    pub seed: u64,
    /// Effects the library must not contain (leave-one-out checks).
    pub withhold: Vec<Effect>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 1,
            withhold: Vec::new(),
        }
    }
}

/// Why a data set cannot be diagnosed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WholeError {
    /// Neither joints nor base can be compared.
    #[error(
        "no run has set-points and positions of a joint, and none has all six positions and the base pose; record setpoint_rad_k and position_rad_k"
    )]
    Nothing,
    /// The nominal model cannot be simulated.
    #[error("the nominal model: {0}")]
    Model(#[from] ParamsError),
}

/// Runs that are fitted, runs that are scored, and how they were chosen.
struct Split {
    fit: Vec<usize>,
    score: Vec<usize>,
    how: String,
}

fn split(data: &Data) -> Split {
    let usable: Vec<usize> = (0..data.runs.len())
        .filter(|r| data.runs[*r].joints.iter().any(|j| j.position.is_some()))
        .collect();
    let made = |fit, score, how: &str| Split {
        fit,
        score,
        how: how.into(),
    };
    let check = |r: &usize| data.runs[*r].role == Some(Role::Check);
    if usable.iter().any(check) && !usable.iter().all(check) {
        let (score, fit) = usable.into_iter().partition(check);
        return made(fit, score, "roles of the data set");
    }
    let mut gaits: Vec<usize> = usable.iter().map(|r| data.runs[*r].gait).collect();
    gaits.sort_unstable();
    gaits.dedup();
    if gaits.len() < 3 {
        let how = "nothing held out: fewer than three gaits";
        return made(usable.clone(), usable, how);
    }
    // Every third gait is held out, beginning with the third.
    let held = |r: &usize| {
        gaits
            .iter()
            .position(|g| *g == data.runs[*r].gait)
            .is_some_and(|i| i % 3 == 2)
    };
    let (score, fit) = usable.into_iter().partition(held);
    made(fit, score, "every third gait held out")
}

/// A diagnosis.
pub struct Diagnosis {
    /// The nominal model.
    model: Model,
    causes: Causes,
    verdict: Verdict,
    replay: Option<replay::Replay>,
    /// What a further experiment on the ground should decide.
    question: Option<experiment::Question>,
}

impl Diagnosis {
    /// The verdict.
    #[must_use]
    pub fn verdict(&self) -> &Verdict {
        &self.verdict
    }

    /// The nominal model with the effects found switched on, those that the simulator has.
    #[must_use]
    pub fn patch(&self) -> Model {
        self.causes.patch(&self.model, "gap report")
    }

    /// The report as one page on the data set that `subject` describes.
    #[must_use]
    pub fn html(&self, subject: &Subject) -> String {
        let joints = &self.causes.held_out.parts.joints;
        page::html(&self.verdict, subject, joints, self.replay.as_ref())
    }

    /// Adds what whole runs show that no window restarts, nominal and with the patch: pose, speed and, in films, silhouettes.
    fn add_rollouts(&mut self, read: &Read<'_>) {
        let Ok(patched) = Params::try_from(&self.patch()).map(Arc::new) else {
            return;
        };
        let (data, runs) = (&read.data, &read.split.score);
        let nominal = &read.params;
        self.replay = replay::Replay::new(data, runs, &self.model, nominal, &patched);
        let mean = |params, which: usize| {
            let v: Vec<f64> = predict::errors(data, runs, params)
                .iter()
                .map(|(_, e)| e[which])
                .collect();
            (!v.is_empty()).then(|| crate::math::mean(&v))
        };
        let metrics = &mut self.verdict.metrics;
        for (which, name) in [(0, "pose_rollout_rmse_m"), (1, "speed_error")] {
            if let (Some(before), Some(after)) = (mean(nominal, which), mean(&patched, which)) {
                metrics.insert(name.into(), [before, before, after]);
            }
        }
        let (films, manifest) = (read.set.films, read.set.manifest);
        let similar =
            |p: &Arc<Params>| film::similarity(data, films, manifest, &read.model, runs, p);
        let off = similar(nominal).zip(similar(&patched));
        let seen = read.similarity(&self.causes).map(<(f64, f64)>::from);
        if let Some((before, after)) = off.or(seen) {
            metrics.insert("similarity_r".into(), [before, before, after]);
        }
    }

    /// The gait to play next where the body holds what is open: of `menu`, of the gaits on record and of variations of both, those that
    /// `accepts` lets pass. `None` where nothing is open about the body or no gait passes.
    #[must_use]
    pub fn experiment(
        &self,
        menu: &[Gait],
        accepts: &dyn Fn(&Gait) -> bool,
    ) -> Option<experiment::Experiment> {
        let question = self.question.as_ref()?;
        question.experiment(menu, accepts)
    }

    /// The verdict, to add provenance.
    pub fn verdict_mut(&mut self) -> &mut Verdict {
        &mut self.verdict
    }
}

/// A data set, and the nominal model that it is held against.
#[derive(Clone, Copy)]
pub struct DataSet<'a> {
    /// What the data set says of itself.
    pub manifest: &'a Manifest,
    /// Its runs.
    pub recordings: &'a [Recording],
    /// Its films.
    pub films: &'a [Film],
    /// The nominal model.
    pub model: &'a Model,
}

/// A data set that was read: joints in their own columns, with the order that body and set-points show.
struct Read<'a> {
    set: DataSet<'a>,
    model: Model,
    params: Arc<Params>,
    data: Arc<Data>,
    split: Split,
    /// Column in which each joint was recorded, and whether the body shows it turned round.
    columns: [usize; JOINTS],
    turned: [bool; JOINTS],
    tier: Option<body::Tier>,
}

impl<'a> Read<'a> {
    fn new(set: DataSet<'a>) -> Result<Self, WholeError> {
        let manifest = set.manifest;
        let model = manifest.stated(set.model);
        let params = Arc::new(Params::try_from(&model)?);
        let mut data = Data::new(manifest, set.recordings, &model);
        film::track(&mut data, set.films, manifest, &model, &params);
        let split = split(&data);
        if split.fit.is_empty() {
            return Err(WholeError::Nothing);
        }
        let new = |data: &Data| body::Tier::new(data, &model, &params, &split.fit);
        let mut tier = new(&data);
        let (mut columns, mut turned) = (std::array::from_fn(|k| k), [false; JOINTS]);
        if let Some(found) = &mut tier {
            let all = body_library::coordinates(&model);
            let nominal: Vec<f64> = all.iter().map(|c| c.neutral).collect();
            order::find(found, &nominal, &order::motors(&data, &split.fit));
            if !found.as_told() {
                let maps = found.maps;
                (columns, turned) = (found.order, maps.map(|m| m.ratio < 0.0));
                data = data.reordered(&columns);
                tier = new(&data).map(|own| own.mapped(&data, maps, nominal));
            }
        }
        Ok(Self {
            data: Arc::new(data),
            set,
            model,
            params,
            split,
            columns,
            turned,
            tier,
        })
    }

    /// Hands the question to `then`, with what a cause must add and what robots without a cause differ by.
    fn ask<T>(
        &mut self,
        (withhold, calibration): (&[Effect], &Calibration),
        then: impl FnOnce(&causes::Asked<'_>, Option<&mut body::Tier>) -> T,
    ) -> T {
        let (manifest, films) = (self.set.manifest, self.set.films);
        let data = &self.data;
        let mut conventions = conventions::find(data);
        let mut direct = Vec::new();
        echo::read(data, &mut conventions, &mut direct);
        let camera = camera::Tier::new(data, manifest, &self.model, films, &self.split.fit);
        let block = |tier| blocks::camera::block(tier, &camera::coordinates(manifest, &self.model));
        let films = (
            camera.as_ref().map(block),
            camera.as_ref().and_then(camera::dropped),
        );
        let asked = causes::Asked {
            data,
            model: &self.model,
            params: &self.params,
            conventions: &conventions,
            direct: &direct,
            columns: self.columns,
            turned: self.turned,
            films: &films,
            runs: &self.split.fit,
            held: &self.split.score,
            split: &self.split.how,
            withhold,
            calibration,
        };
        then(&asked, self.tier.as_mut())
    }

    /// Similarity of the films with the measured pose as the stated camera sees it, and as one with the `causes` does.
    fn similarity(&self, causes: &Causes) -> Option<[f64; 2]> {
        let (manifest, runs) = (self.set.manifest, &self.split.score);
        let camera = camera::Tier::new(&self.data, manifest, &self.model, self.set.films, runs)?;
        let stated: Vec<f64> = camera::coordinates(manifest, &self.model)
            .iter()
            .map(|c| c.neutral)
            .collect();
        let mut found = stated.clone();
        for (effect, _, values) in causes.causes.iter().flat_map(Row::parts) {
            camera::put(&mut found, effect, &values);
        }
        let mean = |theta: &[f64]| crate::math::mean(&camera.similarity(theta));
        Some([mean(&stated), mean(&found)])
    }
}

/// Names the causes of a robot's gap, those that joints share as one: `rb.gap/2`.
///
/// # Errors
/// As [`diagnose`].
pub fn name_causes(
    set: DataSet<'_>,
    withhold: &[Effect],
    calibration: &Calibration,
) -> Result<Causes, WholeError> {
    let mut read = Read::new(set)?;
    let found = read.ask((withhold, calibration), |asked, tier| {
        causes::explain(asked, tier, &|_| {})
    });
    Ok(found.0)
}

/// Blocks of a robot without a cause around its nominal model: what [`Spreads::learned`] learns from.
///
/// # Errors
/// As [`diagnose`].
pub fn null_blocks(set: DataSet<'_>) -> Result<Vec<White>, WholeError> {
    let calibration = Calibration::shipped();
    let mut read = Read::new(set)?;
    Ok(read.ask((&[], &calibration), |asked, tier| {
        asked.nominal_blocks(tier)
    }))
}

/// What robots without a cause, each by its [`null_blocks`], differ by, and how strong a cause they seem to have. The
/// strongest evidence of each robot is that under what robots of the other folds differ by.
///
/// # Errors
/// Too few robots.
pub fn calibrated(
    robots: &[Vec<White>],
    command: &str,
    source: &str,
) -> Result<Calibration, CalibrationError> {
    let all = Spreads::learned(robots);
    let folds: Vec<Spreads> = (0..FOLDS)
        .map(|fold| {
            let others = robots.iter().enumerate().filter(|(i, _)| i % FOLDS != fold);
            let others: Vec<Vec<White>> = others.map(|(_, r)| r.clone()).collect();
            all.of_most(&others)
        })
        .collect();
    let strongest: Vec<BTreeMap<Shown, f64>> = robots
        .par_iter()
        .enumerate()
        .map(|(i, r)| causes::strongest(r, &folds[i % FOLDS]))
        .collect();
    let lefts: Vec<_> = robots.iter().map(|r| causes::lefts(r)).collect();
    let mut out = Calibration::by_effect(&strongest, command, source)?.with_lefts(&lefts);
    out.spreads = all;
    Ok(out)
}

/// Folds of the cross-validation of a calibration.
pub const FOLDS: usize = 10;

/// Phases of a diagnosis of a robot, in order.
pub const PHASES: [&str; 4] = [
    "reading the signals",
    "searching causes",
    "playing the held-out runs",
    "playing whole runs",
];

/// Diagnoses a whole robot.
///
/// # Errors
/// When nothing can be compared, or the nominal model cannot be simulated.
pub fn diagnose(
    set: DataSet<'_>,
    settings: &Settings,
    calibration: &Calibration,
) -> Result<Diagnosis, WholeError> {
    diagnose_watched(set, settings, calibration, &|_| {})
}

/// The same; `begins` hears the number in [`PHASES`] of each phase as it begins.
///
/// # Errors
/// As [`diagnose`].
pub fn diagnose_watched(
    set: DataSet<'_>,
    settings: &Settings,
    calibration: &Calibration,
    begins: &dyn Fn(usize),
) -> Result<Diagnosis, WholeError> {
    begins(0);
    let mut read = Read::new(set)?;
    let (causes, beside) = read.ask((&settings.withhold, calibration), |asked, tier| {
        causes::explain(asked, tier, begins)
    });
    begins(3);
    let told = verdict::Told {
        data: &read.data,
        found: &causes,
        beside: &beside,
        seed: settings.seed,
    };
    let verdict = told.verdict();
    let Beside {
        open, torque_nm, ..
    } = beside;
    let mut out = Diagnosis {
        model: read.model.clone(),
        causes,
        verdict,
        replay: None,
        question: open.map(|open| experiment::Question::new(open, &read.data, torque_nm)),
    };
    out.add_rollouts(&read);
    Ok(out)
}
