//! Meta-optimisation (paper, section VII): model parameters such that simulated films look like the robot's.
//!
//! The objective is equation (6): per gait the mean overlap ratio between the robot's film and the simulated one, shifted by the
//! fitted time shift, weighted by speed times repeatability. Any subset of Table II can be fitted; the rest stays hand-tuned.

mod film;
mod likeness;

pub use film::{
    FilmMaker, FilmSettings, FilmedGait, FrameTimes, Motion, MotionJob, MotionTrials, Placement,
};
pub use likeness::Likeness;

use crate::table2::ROWS;
use camera::ViewError;
use camera::similarity::SimilarityError;
use files::model::{Key, Model};
use serde::{Deserialize, Serialize};
use swarm::{Settings, SettingsError, Swarm};

/// The paper's meta-optimisation: 100 particles (its text also says 120), 100 iterations.
pub const PAPER_PARTICLES: usize = 100;
/// See [`PAPER_PARTICLES`].
pub const PAPER_ITERATIONS: u32 = 100;

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
    /// A trial shows nothing to compare with.
    #[error(
        "trial {trial} (from 1) never shows the robot: film it again, or take the film out of the data set"
    )]
    NeverSeen {
        /// Number of the trial.
        trial: usize,
    },
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
    /// Mean fitness of the particles in every iteration.
    means: Vec<f64>,
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
            means: Vec::new(),
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

    /// One iteration over the training gaits. Gives whether it came to its end; the fit stays as it was when the trials were stopped.
    ///
    /// # Errors
    /// When films do not compare; the fit is unchanged then.
    pub fn iterate(
        &mut self,
        likeness: &Likeness<'_>,
        trials: &impl MotionTrials,
    ) -> Result<bool, MetaError> {
        let candidates: Vec<[f64; ROWS]> = self
            .swarm
            .ask()
            .iter()
            .map(|x| self.parameters(x))
            .collect();
        let fitness = likeness.fitness(&candidates, trials)?;
        if trials.stopped() {
            return Ok(false);
        }
        // The count is right by construction.
        let _ = self.swarm.tell(&fitness);
        self.means
            .push(fitness.iter().sum::<f64>() / fitness.len().max(1) as f64);
        Ok(true)
    }

    /// The swarm: iteration, best, curve (the paper's figure 6).
    #[must_use]
    pub fn swarm(&self) -> &Swarm {
        &self.swarm
    }

    /// Mean fitness of the particles in every iteration, beside the best ones of [`Swarm::history`].
    #[must_use]
    pub fn means(&self) -> &[f64] {
        &self.means
    }

    /// Best values of all rows so far; the start before the first iteration.
    #[must_use]
    pub fn best(&self) -> [f64; ROWS] {
        self.parameters(self.swarm.best().map_or(&[], |best| &best.position))
    }
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
