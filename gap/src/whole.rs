//! The whole robot: six joints, body, camera, from recordings to verdict.
//!
//! Three tiers, each cut out of the loop by measured signals: every joint alone against loads replayed from the measured motion
//! ([`joints`]), the body in short windows led along the measured angles ([`body`]), the camera against the measured pose. Where no
//! tracker recorded a pose, it is read off the film first ([`film`]).

mod advice;
mod answer;
mod belief;
mod blocks;
mod body;
mod body_answer;
mod body_library;
mod body_order;
mod body_rest;
mod bounce;
mod camera;
mod causes;
mod clock;
mod collapse;
mod conventions;
mod course;
pub mod data;
mod direct;
mod drive;
mod echo;
pub mod experiment;
mod film;
mod found;
mod friction;
mod gaits;
pub mod inertial;
mod intervals;
mod joint_library;
mod joints;
mod last_word;
mod least;
#[cfg(test)]
mod linear;
mod loads;
mod nominal;
mod open;
mod optimum;
mod page;
mod patch;
mod places;
mod predict;
mod regime;
mod replay;
mod rivals;
mod rough;
mod score;
mod screen;
mod search;
mod servo;
mod stages;
mod stand_in;
mod steady;
mod terms;
mod traffic;
mod turn;
mod unseen;
mod windows;
mod witness;

use std::collections::BTreeMap;
use std::sync::Arc;

use control::gait::Gait;
use files::dataset::{Manifest, Recording, Role};
use files::model::{Key, Model};
use physics::{Params, ParamsError};

use rayon::prelude::*;

use crate::decide::{Calibration, CalibrationError, Shown};
use crate::evidence::block::White;
use crate::evidence::ensemble::Spreads;
use crate::report::Subject;
use crate::verdict::Verdict;
use crate::vocabulary::Effect;
pub use camera::Film;
pub use causes::{
    Alternative, Causes, HeldOut, Left, Nearest, Place, Probabilities, Row, Shrink, Value, Word,
};
use conventions::Conventions;
use data::Data;
use joints::Found;
pub use predict::predict;
use stages::Task;

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
    /// The nominal model on the contacts that windows show.
    model: Model,
    verdict: Verdict,
    joints: Vec<score::JointRow>,
    replay: Option<replay::Replay>,
    /// What a further experiment on the ground should decide.
    question: Option<experiment::Question>,
}

/// Everything found, before it is put into words.
struct Parts {
    data: Arc<Data>,
    conventions: Conventions,
    direct: Vec<direct::Reading>,
    /// What explains the loads of all joints as well as the reading that is named.
    twin: Option<direct::Reading>,
    /// Effects that must not be named.
    withhold: Vec<Effect>,
    split: String,
    joints: Vec<Found>,
    body: Option<body::Found>,
    camera: Option<camera::Found>,
    /// Friction of the nominal ground.
    friction: f64,
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
        patch::patched(
            &self.model,
            patch::parts(&self.verdict.effects),
            "gap report",
        )
    }

    /// The report as one page on the data set that `subject` describes.
    #[must_use]
    pub fn html(&self, subject: &Subject) -> String {
        page::html(&self.verdict, subject, &self.joints, self.replay.as_ref())
    }

    /// Adds the error of whole runs, which no window restarts: nominal, on the contacts that windows show, and with the patch.
    fn add_rollouts(&mut self, data: &Data, runs: &[usize], nominal: &Arc<Params>) {
        let of = |model: &Model| Params::try_from(model).map(Arc::new);
        let (Ok(held), Ok(patched)) = (of(&self.model), of(&self.patch())) else {
            return;
        };
        let same = body::Grip::of(&held) == body::Grip::of(nominal);
        self.replay = replay::Replay::new(data, runs, &self.model, nominal, &patched);
        let mean = |params, which: usize| {
            let v: Vec<f64> = predict::errors(data, runs, params)
                .iter()
                .map(|(_, e)| e[which])
                .collect();
            (!v.is_empty()).then(|| crate::math::mean(&v))
        };
        for (which, name) in [(0, "pose_rollout_rmse_m"), (1, "speed_error")] {
            let before = mean(nominal, which);
            let held = if same { before } else { mean(&held, which) };
            if let (Some(before), Some(held), Some(after)) = (before, held, mean(&patched, which)) {
                let metrics = &mut self.verdict.metrics;
                metrics.insert(name.into(), [before, held, after]);
            }
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

/// Reads a data set for the search of causes and hands it to `then`, with what a cause must add and what robots
/// without a cause differ by.
fn asked<T>(
    set: DataSet<'_>,
    (withhold, calibration): (&[Effect], &Calibration),
    then: impl FnOnce(&causes::Asked<'_>, Option<&mut body::Tier>) -> T,
) -> Result<T, WholeError> {
    let manifest = set.manifest;
    let model = &manifest.stated(set.model);
    let params = Arc::new(Params::try_from(model)?);
    let mut data = Data::new(manifest, set.recordings, model);
    film::track(&mut data, set.films, manifest, model, &params);
    let data = Arc::new(data);
    let split = split(&data);
    if split.fit.is_empty() {
        return Err(WholeError::Nothing);
    }
    let mut conventions = conventions::find(&data);
    let mut direct = Vec::new();
    echo::read(&data, &mut conventions, &[], &mut direct);
    let mut tier = body::Tier::new(&data, model, &params, &split.fit);
    let camera = camera::Tier::new(&data, manifest, model, set.films, &split.fit);
    let block = |tier| blocks::camera::block(tier, &camera::coordinates(manifest, model));
    let films = (
        camera.as_ref().map(block),
        camera.as_ref().and_then(camera::dropped),
    );
    let asked = causes::Asked {
        data: &data,
        model,
        params: &params,
        conventions: &conventions,
        direct: &direct,
        films: &films,
        runs: &split.fit,
        held: &split.score,
        split: &split.how,
        withhold,
        calibration,
    };
    Ok(then(&asked, tier.as_mut()))
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
    let (found, held_out) = asked(set, (withhold, calibration), causes::explain)?;
    Ok(found.rows(calibration, held_out))
}

/// Blocks of a robot without a cause around its nominal model: what [`Spreads::learned`] learns from.
///
/// # Errors
/// As [`diagnose`].
pub fn null_blocks(set: DataSet<'_>) -> Result<Vec<White>, WholeError> {
    let calibration = Calibration::shipped();
    asked(set, (&[], &calibration), |asked, tier| {
        asked.nominal_blocks(tier)
    })
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
    let folds: Vec<Spreads> = (0..FOLDS)
        .map(|fold| {
            let others = robots.iter().enumerate().filter(|(i, _)| i % FOLDS != fold);
            let others: Vec<Vec<White>> = others.map(|(_, r)| r.clone()).collect();
            Spreads::learned(&others)
        })
        .collect();
    let strongest: Vec<BTreeMap<Shown, f64>> = robots
        .par_iter()
        .enumerate()
        .map(|(i, r)| causes::strongest(r, &folds[i % FOLDS]))
        .collect();
    let lefts: Vec<_> = robots.iter().map(|r| causes::lefts(r)).collect();
    let mut out = Calibration::by_effect(&strongest, command, source)?.with_lefts(&lefts);
    out.spreads = Spreads::learned(robots);
    Ok(out)
}

/// Folds of the cross-validation of [`calibrated`].
const FOLDS: usize = 10;

/// Phases of a diagnosis of a robot, in order.
pub const PHASES: [&str; 7] = [
    "reading the signals",
    "replaying the loads of the joints",
    "searching each joint",
    "searching body and joints together",
    "comparing the films",
    "playing the held-out runs",
    "weighing what was found",
];

/// Diagnoses a whole robot.
///
/// # Errors
/// When nothing can be compared, or the nominal model cannot be simulated.
pub fn diagnose(
    manifest: &Manifest,
    recordings: &[Recording],
    films: &[Film],
    model: &Model,
    settings: &Settings,
) -> Result<Diagnosis, WholeError> {
    diagnose_watched((manifest, recordings, films), model, settings, &|_| {})
}

/// The same; `begins` hears the number in [`PHASES`] of each phase as it begins.
///
/// # Errors
/// As [`diagnose`].
pub fn diagnose_watched(
    (manifest, recordings, films): (&Manifest, &[Recording], &[Film]),
    model: &Model,
    settings: &Settings,
    begins: &dyn Fn(usize),
) -> Result<Diagnosis, WholeError> {
    let model = &manifest.stated(model);
    let params = Arc::new(Params::try_from(model)?);
    let task = Task {
        manifest,
        films,
        model,
        settings,
        params: Arc::clone(&params),
    };
    begins(0);
    let mut seen = task.see(recordings)?;
    begins(1);
    let mut loads = task.loads(&mut seen);
    begins(2);
    let mut joints = task.joints(&seen, &loads);
    begins(3);
    let twin = task.together(&mut seen, &joints, &mut loads);
    if joints.is_empty() && seen.body.is_none() {
        return Err(WholeError::Nothing);
    }
    begins(4);
    let camera = camera::Tier::new(&seen.data, manifest, model, films, &seen.split.fit)
        .map(|tier| camera::diagnose(tier, manifest, model, &settings.withhold));
    begins(5);
    let score = task.score(&seen, &joints, &loads, camera.is_some());
    last_word::refuted(&score, &mut joints, seen.body.is_some());
    let (fit_runs, score_runs) = (seen.split.fit, seen.split.score);
    begins(6);
    // All that follows plays whole runs on the contacts that windows show.
    let held = seen.body.as_ref().map(|b| b.tier.grip().on(model));
    let nominal = model;
    let model = held.as_ref().unwrap_or(nominal);
    let mut parts = Parts {
        body: seen.body,
        camera,
        data: seen.data,
        conventions: seen.conventions,
        direct: seen.direct,
        twin,
        withhold: settings.withhold.clone(),
        split: seen.split.how,
        joints,
        friction: model.value(Key::Friction),
    };
    let (mut verdict, mut joints) = answer::verdict(&parts, &score, settings);
    if collapse::refuted(&mut parts, &verdict, model, (&score, &score_runs)) {
        (verdict, joints) = answer::verdict(&parts, &score, settings);
    }
    if witness::borne_out(&mut parts, &verdict, model, &fit_runs) {
        (verdict, joints) = answer::verdict(&parts, &score, settings);
    }
    let mut out = Diagnosis {
        model: model.clone(),
        verdict,
        joints,
        replay: None,
        question: None,
    };
    let open = rivals::open(&parts, &out.verdict, model);
    out.question = open.map(|open| experiment::Question::new(open, &parts));
    out.add_rollouts(&parts.data, &score_runs, &params);
    let similar = |params: &Arc<Params>| {
        film::similarity(&parts.data, films, manifest, nominal, &score_runs, params)
    };
    if let (Some(before), Ok(patched)) = (similar(&params), Params::try_from(&out.patch()))
        && let Some(after) = similar(&Arc::new(patched))
    {
        let metrics = &mut out.verdict.metrics;
        metrics.insert("similarity_r".into(), [before, before, after]);
    }
    Ok(out)
}
