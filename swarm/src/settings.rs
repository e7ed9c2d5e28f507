//! What a search is given; checked once, so that the swarm cannot be wrong later.

use serde::{Deserialize, Serialize};

/// Clerc and Kennedy's usual attraction for both the own and the swarm's best: c1 = c2 = 2.05.
const ATTRACTION: f64 = 2.05;

/// A step of at most the whole range of a dimension. Constriction makes the swarm converge without it; the limit only
/// keeps early flights from bouncing between opposite faces (Eberhart and Shi 2000 recommend Vmax = Xmax).
const VELOCITY_LIMIT: f64 = 1.0;

/// A checked description of a search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    bounds: Vec<(f64, f64)>,
    particles: usize,
    seed: u64,
    c1: f64,
    c2: f64,
    velocity_limit: f64,
    start: Vec<Vec<f64>>,
}

/// Why settings were refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// No dimension to search.
    #[error("the search has no dimension")]
    NoDimension,
    /// A swarm of nobody.
    #[error("at least one particle is needed")]
    NoParticle,
    /// Bounds not finite or not in order.
    #[error(
        "bounds of dimension {dimension} are [{low}, {high}]; both must be finite and low < high"
    )]
    Bounds {
        /// Dimension, from 0.
        dimension: usize,
        /// Lower bound as given.
        low: f64,
        /// Upper bound as given.
        high: f64,
    },
    /// Constriction needs c1 + c2 > 4.
    #[error("c1 + c2 is {sum}; constriction needs a finite sum above 4")]
    Attraction {
        /// c1 + c2 as given.
        sum: f64,
    },
    /// A start position outside the bounds or of the wrong length.
    #[error("start position {index} does not lie inside the bounds")]
    Start {
        /// Index of the start position, from 0.
        index: usize,
    },
}

/// K = 2 / |2 - c - sqrt(c^2 - 4c)| for c = c1 + c2 (Clerc and Kennedy 2002, the paper's [22]); `None` unless c > 4.
#[must_use]
pub fn constriction(c: f64) -> Option<f64> {
    (c.is_finite() && c > 4.0).then(|| 2.0 / (2.0 - c - (c * c - 4.0 * c).sqrt()).abs())
}

impl Settings {
    /// A search over `bounds` (low, high) with `particles` and `seed`, c1 = c2 = 2.05.
    ///
    /// # Errors
    /// See [`SettingsError`].
    pub fn new(
        bounds: Vec<(f64, f64)>,
        particles: usize,
        seed: u64,
    ) -> Result<Self, SettingsError> {
        if bounds.is_empty() {
            return Err(SettingsError::NoDimension);
        }
        if particles == 0 {
            return Err(SettingsError::NoParticle);
        }
        for (dimension, &(low, high)) in bounds.iter().enumerate() {
            if !(low.is_finite() && high.is_finite() && low < high) {
                return Err(SettingsError::Bounds {
                    dimension,
                    low,
                    high,
                });
            }
        }
        Ok(Self {
            bounds,
            particles,
            seed,
            c1: ATTRACTION,
            c2: ATTRACTION,
            velocity_limit: VELOCITY_LIMIT,
            start: Vec::new(),
        })
    }

    /// Other cognitive and social factors.
    ///
    /// # Errors
    /// When c1 + c2 is not above 4.
    pub fn with_attraction(mut self, c1: f64, c2: f64) -> Result<Self, SettingsError> {
        constriction(c1 + c2).ok_or(SettingsError::Attraction { sum: c1 + c2 })?;
        (self.c1, self.c2) = (c1, c2);
        Ok(self)
    }

    /// Positions the first particles start from, for example the hand-tuned values.
    ///
    /// # Errors
    /// When a position has the wrong length or lies outside the bounds.
    pub fn with_start(mut self, start: Vec<Vec<f64>>) -> Result<Self, SettingsError> {
        for (index, position) in start.iter().enumerate() {
            let inside = position.len() == self.bounds.len()
                && position
                    .iter()
                    .zip(&self.bounds)
                    .all(|(x, (low, high))| low <= x && x <= high);
            if !inside {
                return Err(SettingsError::Start { index });
            }
        }
        self.start = start;
        Ok(self)
    }

    /// Lower and upper bound per dimension.
    #[must_use]
    pub fn bounds(&self) -> &[(f64, f64)] {
        &self.bounds
    }

    /// Number of particles.
    #[must_use]
    pub fn particles(&self) -> usize {
        self.particles
    }

    /// Seed of every stream of the search.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// K of equation (4).
    #[must_use]
    pub fn constriction(&self) -> f64 {
        constriction(self.c1 + self.c2).unwrap_or(1.0)
    }

    /// c1 and c2 of equation (4).
    #[must_use]
    pub fn attraction(&self) -> (f64, f64) {
        (self.c1, self.c2)
    }

    /// Longest step per iteration as a share of the range.
    #[must_use]
    pub fn velocity_limit(&self) -> f64 {
        self.velocity_limit
    }

    pub(crate) fn start_position(&self, index: usize) -> Option<&[f64]> {
        self.start.get(index).map(Vec::as_slice)
    }
}
