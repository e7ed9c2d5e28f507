//! Meta-optimisation (paper, section VII): model parameters such that simulated films look like the robot's.
//!
//! The objective is equation (6): per gait the mean overlap ratio between the robot's film and the simulated one, shifted by the
//! fitted time shift, weighted by speed times repeatability. Any subset of Table II can be fitted; the rest stays hand-tuned.

use crate::table2::ROWS;
use camera::similarity::{SimilarityError, meta_fitness, ratio, repeatability};
use camera::{Silhouette, Solid, View, ViewError};
use control::gait::Gait;
use control::linalg::Pose;
use control::robot::{BODIES, RobotModel};
use files::model::{Key, Model};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use swarm::{Settings, SettingsError, Swarm};

/// The paper's meta-optimisation: 100 particles (its text also says 120), 100 iterations.
pub const PAPER_PARTICLES: usize = 100;
/// See [`PAPER_PARTICLES`].
pub const PAPER_ITERATIONS: u32 = 100;

/// Index of the camera height in Table II.
const CAMERA_HEIGHT: usize = 20;
/// Index of the time shift in Table II.
const TIME_SHIFT: usize = 21;

/// One simulated motion to make.
#[derive(Clone, Copy, Debug)]
pub struct MotionJob<'a> {
    /// The gait to play, without noise.
    pub gait: &'a Gait,
    /// Values of all rows of Table II.
    pub parameters: &'a [f64; ROWS],
}

/// Body poses in the world at a constant rate, from the start of the gait.
pub type Motion = Vec<[Pose; BODIES]>;

/// Something that simulates motions; the result of a job depends on that job alone.
pub trait MotionTrials {
    /// Frames per second of every motion.
    fn rate_hz(&self) -> f64;
    /// Motions in the order of the jobs; `None` where a number was lost.
    fn run(&self, jobs: &[MotionJob<'_>]) -> Vec<Option<Motion>>;
}

/// What was filmed of one gait on the robot.
#[derive(Clone, Debug)]
pub struct FilmedGait {
    /// The gait.
    pub gait: Gait,
    /// One film per trial.
    pub films: Vec<Vec<Silhouette>>,
    /// Where body 3 began, in the camera's world, m; simulated motions begin at 0, 0.
    pub start_m: [f32; 2],
    /// W_gait, equation (7).
    pub weight: f64,
    /// Whether the fit may see it.
    pub training: bool,
}

impl FilmedGait {
    /// Weigh a gait by its mean speed and the likeness of its trials.
    ///
    /// # Errors
    /// With fewer than two trials, or films that do not compare.
    pub fn new(
        gait: Gait,
        films: Vec<Vec<Silhouette>>,
        start_m: [f32; 2],
        mean_speed_m_s: f64,
        training: bool,
    ) -> Result<Self, SimilarityError> {
        let trials: Vec<&[Silhouette]> = films.iter().map(Vec::as_slice).collect();
        let weight = camera::similarity::gait_weight(mean_speed_m_s, repeatability(&trials)?);
        Ok(Self {
            gait,
            films,
            start_m,
            weight,
            training,
        })
    }
}

/// The real camera and how finely the search looks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FilmSettings {
    /// Frames per second of the robot's films.
    pub rate_hz: f64,
    /// Camera position over the ground, m.
    pub x_m: f32,
    /// Camera position over the ground, m.
    pub y_m: f32,
    /// Camera yaw, rad.
    pub yaw_rad: f32,
    /// Frame size of the films, px.
    pub width_px: usize,
    /// Frame size of the films, px.
    pub height_px: usize,
    /// Focal length at that frame size, px.
    pub focal_px: f32,
    /// Every how many frames of the robot's film are compared.
    pub stride: usize,
}

/// Why a fit could not be set up or a film not compared.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MetaError {
    /// No gait to fit to.
    #[error("no gait of the training set was given")]
    NoTraining,
    /// A row that is not in Table II, or twice.
    #[error("row {number} of Table II does not exist or is given twice; rows are 1 to 22")]
    Row {
        /// As given.
        number: u8,
    },
    /// The swarm refused.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// Films do not compare.
    #[error(transparent)]
    Similarity(#[from] SimilarityError),
    /// The camera is impossible.
    #[error(transparent)]
    View(#[from] ViewError),
    /// The simulator lost a number on this gait.
    #[error("the simulator lost a number on gait {gait} (from 0) with these parameters")]
    Simulation {
        /// Index of the gait.
        gait: usize,
    },
}

/// The values of Table II's rows in a model.
#[must_use]
pub fn rows_of(model: &Model) -> [f64; ROWS] {
    Key::TABLE_II.map(|key| model.value(key))
}

/// A fit in progress; serialise it after an iteration, and it goes on with the same bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    rows: Vec<u8>,
    start: Vec<f64>,
    swarm: Swarm,
}

impl Fit {
    /// Fit the given rows of Table II (numbers from 1) from `start`; other rows keep the values of `start`.
    ///
    /// A start value outside its row's range (the paper's camera height is one) begins at the nearest end.
    ///
    /// # Errors
    /// When a row does not exist or stands twice.
    pub fn start(
        rows: &[u8],
        start: &[f64; ROWS],
        particles: usize,
        seed: u64,
    ) -> Result<Self, MetaError> {
        let mut seen = [false; ROWS];
        for &number in rows {
            let index = usize::from(number).wrapping_sub(1);
            match seen.get_mut(index) {
                Some(seen) if !*seen => *seen = true,
                _ => return Err(MetaError::Row { number }),
            }
        }
        let searched = |number: &u8| Key::TABLE_II[usize::from(*number) - 1].info().search;
        let bounds = rows.iter().map(searched).collect();
        let first = rows.iter().map(|number| {
            let (low, high) = searched(number);
            start[usize::from(*number) - 1].clamp(low, high)
        });
        let settings = Settings::new(bounds, particles, seed)?.with_start(vec![first.collect()])?;
        Ok(Self {
            rows: rows.to_vec(),
            start: start.to_vec(),
            swarm: Swarm::start(settings),
        })
    }

    /// Values of all 22 rows for a position of the swarm.
    #[must_use]
    pub fn parameters(&self, position: &[f64]) -> [f64; ROWS] {
        let mut all: [f64; ROWS] =
            core::array::from_fn(|i| self.start.get(i).copied().unwrap_or(0.0));
        for (&number, &value) in self.rows.iter().zip(position) {
            all[usize::from(number) - 1] = value;
        }
        all
    }

    /// One iteration over the training gaits.
    ///
    /// # Errors
    /// When films do not compare; the fit is unchanged then.
    pub fn iterate(
        &mut self,
        likeness: &Likeness<'_>,
        trials: &impl MotionTrials,
    ) -> Result<(), MetaError> {
        let candidates: Vec<[f64; ROWS]> = self
            .swarm
            .ask()
            .iter()
            .map(|x| self.parameters(x))
            .collect();
        let fitness = likeness.fitness(&candidates, trials)?;
        // The count is right by construction.
        let _ = self.swarm.tell(&fitness);
        Ok(())
    }

    /// The swarm: iteration, best, curve (the paper's figure 6).
    #[must_use]
    pub fn swarm(&self) -> &Swarm {
        &self.swarm
    }

    /// Best values of all rows so far; the start before the first iteration.
    #[must_use]
    pub fn best(&self) -> [f64; ROWS] {
        self.parameters(self.swarm.best().map_or(&[], |best| &best.position))
    }
}

/// The virtual camera and what stands before it.
#[derive(Clone, Debug)]
pub struct FilmMaker {
    settings: FilmSettings,
    solids: Vec<Solid>,
}

impl FilmMaker {
    /// A camera over a meta-module.
    #[must_use]
    pub fn new(settings: FilmSettings, robot: &RobotModel) -> Self {
        Self {
            settings,
            solids: Solid::meta_module(robot),
        }
    }

    /// The simulated film, begun at `start_m`: S(t + s) at the times t of `frames` frames, every `stride`-th of them; times past the end of the motion
    /// are left out.
    ///
    /// # Errors
    /// When the camera height is impossible.
    pub fn film(
        &self,
        motion: &Motion,
        rate_hz: f64,
        parameters: &[f64; ROWS],
        frames: usize,
        stride: usize,
        start_m: [f32; 2],
    ) -> Result<Vec<Silhouette>, ViewError> {
        let view = self.view(parameters, start_m)?;
        let times = (0..frames)
            .step_by(stride.max(1))
            .map(|k| k as f64 / self.settings.rate_hz);
        Ok(times
            .map_while(|t_s| {
                let at = (t_s + parameters[TIME_SHIFT]) * rate_hz + 0.5;
                motion.get(at.max(0.0) as usize)
            })
            .map(|poses| view.render(&self.solids, poses))
            .collect())
    }

    /// The camera of these parameters over a motion that began at `start_m`.
    ///
    /// # Errors
    /// When its height is impossible.
    pub fn view(&self, parameters: &[f64; ROWS], start_m: [f32; 2]) -> Result<View, ViewError> {
        let s = &self.settings;
        let height_m = parameters[CAMERA_HEIGHT] as f32;
        View::new(
            height_m,
            (s.x_m - start_m[0], s.y_m - start_m[1]),
            s.yaw_rad,
            (s.width_px, s.height_px),
            s.focal_px,
        )
    }
}

/// The comparison of simulated with filmed gaits.
pub struct Likeness<'a> {
    gaits: &'a [FilmedGait],
    maker: FilmMaker,
}

impl<'a> Likeness<'a> {
    /// Compare with `gaits` through `maker`.
    ///
    /// # Errors
    /// When no gait belongs to the training set.
    pub fn new(gaits: &'a [FilmedGait], maker: FilmMaker) -> Result<Self, MetaError> {
        if !gaits.iter().any(|gait| gait.training) {
            return Err(MetaError::NoTraining);
        }
        Ok(Self { gaits, maker })
    }

    /// F_meta over the training gaits for every candidate; a candidate on which the simulator loses a number gets 0.
    fn fitness(
        &self,
        candidates: &[[f64; ROWS]],
        trials: &impl MotionTrials,
    ) -> Result<Vec<f64>, MetaError> {
        let training: Vec<&FilmedGait> = self.gaits.iter().filter(|gait| gait.training).collect();
        let jobs: Vec<MotionJob<'_>> = candidates
            .iter()
            .flat_map(|parameters| {
                training.iter().map(move |filmed| MotionJob {
                    gait: &filmed.gait,
                    parameters,
                })
            })
            .collect();
        let motions = trials.run(&jobs);
        let rate_hz = trials.rate_hz();
        let stride = self.maker.settings.stride;
        let per_candidate: Vec<_> = candidates
            .iter()
            .zip(motions.chunks(training.len().max(1)))
            .collect();
        per_candidate
            .par_iter()
            .map(|(parameters, motions)| {
                let mut weighted = Vec::with_capacity(training.len());
                for (filmed, motion) in training.iter().zip(*motions) {
                    let r = match motion {
                        Some(motion) => self.ratio(filmed, motion, rate_hz, parameters, stride)?,
                        None => 0.0,
                    };
                    weighted.push((filmed.weight, r));
                }
                Ok(meta_fitness(&weighted)?)
            })
            .collect()
    }

    /// R of every gait with these parameters at full frame rate, in the order given: the body of Table III.
    ///
    /// # Errors
    /// When films do not compare or the simulator loses a number.
    pub fn ratios(
        &self,
        parameters: &[f64; ROWS],
        trials: &impl MotionTrials,
    ) -> Result<Vec<f64>, MetaError> {
        let jobs: Vec<MotionJob<'_>> = self
            .gaits
            .iter()
            .map(|filmed| MotionJob {
                gait: &filmed.gait,
                parameters,
            })
            .collect();
        let motions = trials.run(&jobs);
        let rate_hz = trials.rate_hz();
        let pairs = self.gaits.iter().zip(motions).enumerate();
        pairs
            .map(|(gait, (filmed, motion))| {
                let motion = motion.ok_or(MetaError::Simulation { gait })?;
                self.ratio(filmed, &motion, rate_hz, parameters, 1)
            })
            .collect()
    }

    /// Mean over trials and frames of R between the robot's film and the simulation seen through the candidate's camera.
    fn ratio(
        &self,
        filmed: &FilmedGait,
        motion: &Motion,
        rate_hz: f64,
        parameters: &[f64; ROWS],
        stride: usize,
    ) -> Result<f64, MetaError> {
        let stride = stride.max(1);
        let frames = filmed.films.iter().map(Vec::len).max().unwrap_or(0);
        let simulated =
            self.maker
                .film(motion, rate_hz, parameters, frames, stride, filmed.start_m)?;
        let mut sum = 0.0;
        for hardware in &filmed.films {
            sum += mean_ratio_strided(hardware, &simulated, stride)?;
        }
        Ok(sum / filmed.films.len().max(1) as f64)
    }
}

/// Mean R of every `stride`-th hardware frame with the simulated frame of that time.
fn mean_ratio_strided(
    hardware: &[Silhouette],
    simulated: &[Silhouette],
    stride: usize,
) -> Result<f64, SimilarityError> {
    let (mut sum, mut n) = (0.0, 0u32);
    for (k, (h, s)) in hardware.iter().step_by(stride).zip(simulated).enumerate() {
        let frame = k * stride;
        if let Some(r) = ratio(h, s).map_err(|_| SimilarityError::FrameSize { frame })? {
            sum += r;
            n += 1;
        }
    }
    if n == 0 {
        return Err(SimilarityError::NoCommonFrame { shift_frames: 0 });
    }
    Ok(sum / f64::from(n))
}

/// The paper's Table III: mean R of a group of gaits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TableIii {
    /// Mean R of the training set.
    pub training: f64,
    /// Mean R of the test set; `None` without test gaits.
    pub test: Option<f64>,
    /// Mean R of all gaits.
    pub all: f64,
}

impl TableIii {
    /// Equal-weight means of `ratios`, one per gait. (The paper's own "all" row is not the 6 to 11 mean of the other two.)
    #[must_use]
    pub fn new(gaits: &[FilmedGait], ratios: &[f64]) -> Self {
        let mean = |training: Option<bool>| {
            let (mut sum, mut n) = (0.0, 0u32);
            for (_, r) in gaits
                .iter()
                .zip(ratios)
                .filter(|(gait, _)| training.is_none_or(|t| t == gait.training))
            {
                sum += r;
                n += 1;
            }
            (n > 0).then(|| sum / f64::from(n))
        };
        Self {
            training: mean(Some(true)).unwrap_or(0.0),
            test: mean(Some(false)),
            all: mean(None).unwrap_or(0.0),
        }
    }
}
