//! A parameter that a fit may move.

use crate::joint::{P, Params};

/// How a parameter is mapped to the fit's own variable.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Map {
    /// `value = exp(x)`.
    Log,
    /// `value = scale * x`.
    Linear {
        /// A typical size.
        scale: f64,
    },
}

/// A parameter that the fit may move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Free {
    /// Which.
    pub p: P,
    /// Map to the fit's variable.
    pub map: Map,
    /// Lowest value.
    pub low: f64,
    /// Highest value.
    pub high: f64,
    /// 1-sigma tolerance in the fit's variable around the neutral value; `None` = unknown beforehand.
    pub tolerance: Option<f64>,
}

impl Free {
    /// Whether it has one value only.
    #[must_use]
    pub fn fixed(&self) -> bool {
        self.low >= self.high
    }

    /// Value to fit variable.
    #[must_use]
    pub fn to_x(&self, value: f64) -> f64 {
        match self.map {
            Map::Log => libm::log(value.max(1e-300)),
            Map::Linear { scale } => value / scale,
        }
    }

    /// Distance from the neutral value in tolerances (0 without a tolerance).
    #[must_use]
    pub fn pull(&self, value: f64) -> f64 {
        self.tolerance.map_or(0.0, |t| {
            (self.to_x(value) - self.to_x(Params::neutral(self.p))) / t
        })
    }
}
