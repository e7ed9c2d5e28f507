//! Trials on the body simulator, spread over threads by whole groups of lanes.

use crate::meta::{Motion, MotionJob, MotionTrials};
use crate::score::TrialOutcome;
use crate::search::{GaitJob, GaitTrials};
use control::kinematics;
use control::linalg::{Pose, Rot3, Vec3};
use control::robot::{BODIES, JOINTS, RobotModel};
use files::model::{Key, Model, ModelError};
use physics::{Drive, Level, Options, Outcome, Params, ParamsError, Robot, Start, Trial};
use rand_chacha::rand_core::Rng;
use rayon::prelude::*;
use std::sync::Arc;
use swarm::{Purpose, stream};

/// Points per second of a searched gait's path; twice the highest harmonic worth comparing at 0.2 Hz gaits.
const PATH_RATE_HZ: f64 = 2.0;
/// Frames per second of a motion; the paper's camera.
const FILM_RATE_HZ: f64 = 30.0;

/// Trials of one model with noise on the CPG outputs.
#[derive(Clone, Debug)]
pub struct Simulated {
    params: Arc<Params>,
    options: Options,
    level: Level,
    noise_rad: f64,
    duration_s: f64,
    seed: u64,
    stop: fn() -> bool,
}

impl Simulated {
    /// Trials of `duration_s` on `model`, noise from the model's `cpg_noise_rad`, streams named under `seed`.
    ///
    /// # Errors
    /// When the model cannot be simulated.
    pub fn new(model: &Model, duration_s: f32, seed: u64) -> Result<Self, ParamsError> {
        let robot = Robot::meta_module(model)?;
        Self::on(Arc::new(robot), model, duration_s, seed)
    }

    /// As [`Simulated::new`], on another structure.
    ///
    /// # Errors
    /// When the model does not fit the structure.
    pub fn on(
        robot: Arc<Robot>,
        model: &Model,
        duration_s: f32,
        seed: u64,
    ) -> Result<Self, ParamsError> {
        Ok(Self {
            params: Arc::new(Params::new(model, robot)?),
            options: Options {
                sample_rate_hz: PATH_RATE_HZ,
                stop_on_collision: true,
                ..Options::default()
            },
            level: Level::detect(),
            noise_rad: model.value(Key::CpgNoise),
            duration_s: duration_s.into(),
            seed,
            stop: never,
        })
    }

    /// The same trials on another instruction set than the fastest of this processor; the outcomes are the same bits.
    #[must_use]
    pub fn at(self, level: Level) -> Self {
        Self { level, ..self }
    }

    /// The same trials, asking `stop` before every group of lanes whether to leave the rest.
    #[must_use]
    pub fn until(self, stop: fn() -> bool) -> Self {
        Self { stop, ..self }
    }

    fn trial(&self, job: &GaitJob<'_>) -> Trial {
        let purpose = Purpose::Noise(job.repetition);
        Trial {
            params: Arc::clone(&self.params),
            start: Start::Home,
            drive: Drive::Gait {
                gait: Arc::new(job.gait.clone()),
                noise_rad: self.noise_rad,
                seed: stream(self.seed, job.iteration, job.particle, purpose).next_u64(),
            },
            duration_s: self.duration_s,
        }
    }
}

impl GaitTrials for Simulated {
    fn run(&self, jobs: &[GaitJob<'_>]) -> Vec<TrialOutcome> {
        let trials: Vec<Trial> = jobs.iter().map(|job| self.trial(job)).collect();
        let groups = trials.par_chunks(self.level.lanes());
        let run = |group: &[Trial]| match (self.stop)() {
            true => Vec::new(),
            false => run_group(self.level, group, &self.options),
        };
        groups.flat_map_iter(run).map(outcome).collect()
    }

    fn stopped(&self) -> bool {
        (self.stop)()
    }
}

/// Nobody wants the work to end.
fn never() -> bool {
    false
}

fn outcome(outcome: Outcome) -> TrialOutcome {
    TrialOutcome {
        path_m: outcome
            .poses
            .iter()
            .map(|pose| [pose.position_m[0], pose.position_m[1]])
            .collect(),
        period_s: (1.0 / PATH_RATE_HZ) as f32,
        collided: outcome.collided_at_s.is_some(),
        impact_m_s: outcome.impact_m_s as f32,
        failed_at_step: outcome.not_finite.map(|lost| lost.step),
    }
}

/// Motions for films: every job its own parameters, no noise.
#[derive(Clone, Debug)]
pub struct SimulatedMotions {
    model: Model,
    robot: RobotModel,
    options: Options,
    level: Level,
    duration_s: f64,
    stop: fn() -> bool,
}

impl SimulatedMotions {
    /// Motions of `duration_s` on `model` with the rows of Table II replaced per job.
    #[must_use]
    pub fn new(model: &Model, robot: RobotModel, duration_s: f64) -> Self {
        let options = Options {
            sample_rate_hz: FILM_RATE_HZ,
            record_angles: true,
            ..Options::default()
        };
        Self {
            model: model.clone(),
            robot,
            options,
            level: Level::detect(),
            duration_s,
            stop: never,
        }
    }

    /// The same motions on another instruction set than the fastest of this processor; they are the same bits.
    #[must_use]
    pub fn at(self, level: Level) -> Self {
        Self { level, ..self }
    }

    /// The same motions, asking `stop` before every group of lanes whether to leave the rest.
    #[must_use]
    pub fn until(self, stop: fn() -> bool) -> Self {
        Self { stop, ..self }
    }

    /// The model with these values in the rows of Table II.
    ///
    /// # Errors
    /// When a value is outside what a model may hold.
    pub fn model_with(&self, rows: &[f64]) -> Result<Model, ModelError> {
        let mut model = self.model.clone();
        for (key, value) in Key::TABLE_II.iter().zip(rows) {
            model.set(*key, *value)?;
        }
        Ok(model)
    }

    fn trial(&self, job: &MotionJob<'_>) -> Option<Trial> {
        let model = self.model_with(job.parameters).ok()?;
        Some(Trial {
            params: Arc::new(Params::try_from(&model).ok()?),
            start: Start::Home,
            drive: Drive::Gait {
                gait: Arc::new(job.gait.clone()),
                noise_rad: 0.0,
                seed: 0,
            },
            duration_s: self.duration_s,
        })
    }

    fn motion(&self, job: &MotionJob<'_>, outcome: &Outcome) -> Option<Motion> {
        let angles = outcome.angles_rad.as_chunks::<JOINTS>().0;
        let samples = job.times.samples(FILM_RATE_HZ);
        let bodies =
            samples.map_while(|k| Some(pose(&self.robot, outcome.poses.get(k)?, angles.get(k)?)));
        Some(Motion {
            start: base_pose(outcome.poses.first()?),
            bodies: bodies.collect(),
        })
    }
}

/// Body poses of every recorded sample of a trial that recorded its link angles.
#[must_use]
pub fn bodies(robot: &RobotModel, outcome: &Outcome) -> Vec<[Pose; BODIES]> {
    let samples = outcome
        .poses
        .iter()
        .zip(outcome.angles_rad.as_chunks::<JOINTS>().0);
    samples
        .map(|(base, angles)| pose(robot, base, angles))
        .collect()
}

fn pose(robot: &RobotModel, base: &physics::Pose, angles_rad: &[f32; JOINTS]) -> [Pose; BODIES] {
    *kinematics::forward(robot, angles_rad)
        .rebased(3, &base_pose(base))
        .bodies()
}

/// The simulator's pose of body 3 as a pose of the law.
#[must_use]
pub fn base_pose(base: &physics::Pose) -> Pose {
    let [x, y, z] = base.position_m;
    Pose {
        position_m: Vec3::new(x, y, z),
        rotation: Rot3::from_quaternion(base.quaternion),
    }
}

impl MotionTrials for SimulatedMotions {
    fn run(&self, jobs: &[MotionJob<'_>]) -> Vec<Option<Motion>> {
        let run = |jobs: &[MotionJob<'_>]| {
            if (self.stop)() {
                return vec![None; jobs.len()];
            }
            let trials: Vec<Option<Trial>> = jobs.iter().map(|job| self.trial(job)).collect();
            let possible: Vec<Trial> = trials.iter().flatten().cloned().collect();
            let mut outcomes = run_group(self.level, &possible, &self.options).into_iter();
            let motion = |(trial, job): (&Option<Trial>, &MotionJob<'_>)| {
                trial.as_ref()?;
                let outcome = outcomes.next().filter(|o| o.not_finite.is_none())?;
                self.motion(job, &outcome)
            };
            trials.iter().zip(jobs).map(motion).collect::<Vec<_>>()
        };
        let groups = jobs.par_chunks(self.level.lanes());
        groups.flat_map_iter(run).collect()
    }

    fn stopped(&self) -> bool {
        (self.stop)()
    }
}

/// Trials that fit the lanes, on this thread.
fn run_group(level: Level, trials: &[Trial], options: &Options) -> Vec<Outcome> {
    // Settings are ours and gaits have the robot's joints, so a refusal means a structure without outcomes: none are given.
    physics::run_at(level, trials, options).unwrap_or_default()
}
