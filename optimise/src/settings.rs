//! `optimise.toml`: everything a search is told, with the choices the paper leaves open, and their ranges.

use crate::score::ScoreSettings;
use crate::search::{PAPER_ITERATIONS, PAPER_PARTICLES};
use crate::select::SelectSettings;
use crate::space::GaitSpace;
use control::gait;
use serde::{Deserialize, Serialize};

/// A search as written in a file; absent values are the paper's, or our choice where the paper is silent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SearchSettings {
    /// File format, 1.
    pub format: u32,
    /// Particles of the swarm; the paper's 300.
    pub particles: usize,
    /// Iterations; the paper's 200.
    pub iterations: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// The space of gaits.
    pub space: GaitSpace,
    /// The fitness.
    pub score: ScoreSettings,
    /// The choice of gaits at the end.
    pub select: SelectSettings,
}

impl Default for SearchSettings {
    fn default() -> Self {
        Self {
            format: 1,
            particles: PAPER_PARTICLES,
            iterations: PAPER_ITERATIONS,
            seed: 1,
            space: GaitSpace::default(),
            score: ScoreSettings::default(),
            select: SelectSettings::default(),
        }
    }
}

/// A value that a search cannot work with.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{key} is {value}; it must lie in [{min}, {max}]")]
pub struct OutOfRange {
    /// Key in the file.
    pub key: &'static str,
    /// Value as given.
    pub value: f64,
    /// Smallest accepted value.
    pub min: f64,
    /// Largest accepted value.
    pub max: f64,
}

impl SearchSettings {
    /// Check every value.
    ///
    /// # Errors
    /// The first value out of its range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let range = |key, value: f64, min: f64, max: f64| {
            let inside = value >= min && value <= max;
            if inside {
                Ok(())
            } else {
                Err(OutOfRange {
                    key,
                    value,
                    min,
                    max,
                })
            }
        };
        let gait = |key, value: f32, limits: gait::Range| {
            range(key, value.into(), limits.min.into(), limits.max.into())
        };
        range("format", self.format.into(), 1.0, 1.0)?;
        range("particles", self.particles as f64, 2.0, 1e5)?;
        range("iterations", self.iterations.into(), 1.0, 1e5)?;
        gait(
            "space.frequency_hz",
            self.space.frequency_hz,
            gait::Range {
                min: 0.01,
                ..gait::FREQUENCY_HZ
            },
        )?;
        gait(
            "space.rate_a_per_s",
            self.space.rate_a_per_s,
            gait::RATE_A_PER_S,
        )?;
        gait("space.weight", self.space.weight, gait::WEIGHT)?;
        gait(
            "space.duration_s",
            self.space.duration_s,
            gait::Range {
                min: 1.0,
                max: 600.0,
            },
        )?;
        gait(
            "space.offset_limit_rad",
            self.space.offset_limit_rad,
            gait::Range {
                min: 0.01,
                ..gait::OFFSET_RAD
            },
        )?;
        let joints = self.space.joints() as f64;
        let most = gait::MAX_OSCILLATORS as f64;
        range("number of space.joint_speed_rad_s", joints, 1.0, most)?;
        for &speed in &self.space.joint_speed_rad_s {
            range("space.joint_speed_rad_s", speed.into(), 0.01, 20.0)?;
        }
        range(
            "score.repetitions",
            self.score.repetitions.into(),
            1.0,
            100.0,
        )?;
        range(
            "score.deviation_half_m",
            self.score.deviation_half_m,
            1e-3,
            1e3,
        )?;
        range("select.count", self.select.count as f64, 1.0, 1000.0)?;
        range(
            "select.best",
            self.select.best as f64,
            0.0,
            self.select.count as f64,
        )?;
        range(
            "select.training",
            self.select.training as f64,
            0.0,
            self.select.count as f64,
        )?;
        range("select.least_fitness", self.select.least_fitness, 0.0, 1.0)?;
        range(
            "select.least_difference",
            self.select.least_difference,
            0.0,
            1.0,
        )
    }
}
