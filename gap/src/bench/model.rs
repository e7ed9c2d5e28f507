//! Points in the space of a joint's parameters, and coordinates with priors.

use crate::candidates::{Free, Map};
use crate::joint::data::CHANNELS;
use crate::joint::{P, Params};

/// What a coordinate moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Axis {
    /// A parameter of the joint.
    Joint(P),
    /// Recorded over true, by channel.
    Column(usize),
}

/// Parameters of the joint, and what its columns are off by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    pub(super) params: Params,
    pub(super) columns: [f64; CHANNELS],
}

impl Default for Point {
    fn default() -> Self {
        Self {
            params: Params::default(),
            columns: [1.0; CHANNELS],
        }
    }
}

impl Point {
    pub(super) fn get(&self, axis: Axis) -> f64 {
        match axis {
            Axis::Joint(p) => self.params.get(p),
            Axis::Column(c) => self.columns[c],
        }
    }

    pub(super) fn set(&mut self, axis: Axis, value: f64) {
        match axis {
            Axis::Joint(p) => self.params.set(p, value),
            Axis::Column(c) => self.columns[c] = value,
        }
    }
}

/// A parameter that a fit moves, as a variable with a Gaussian prior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Coordinate {
    pub(super) axis: Axis,
    map: Map,
    low: f64,
    high: f64,
    /// Prior mean and standard deviation of the variable.
    pub(super) mean: f64,
    pub(super) sd: f64,
    /// Whether the data set says what it is.
    pub(super) stated: bool,
}

/// Standard deviations of what is not stated: a factor of 4.5 for a positive number, thirty typical sizes for another.
const UNSTATED_LOG: f64 = 1.5;
const UNSTATED_LINEAR: f64 = 30.0;

impl Coordinate {
    /// A stated number within its tolerance, or one that is not stated.
    pub(super) fn nominal(free: &Free, base: &Point) -> Self {
        let unstated = match free.map {
            Map::Log => UNSTATED_LOG,
            Map::Linear { .. } => UNSTATED_LINEAR,
        };
        Self {
            axis: Axis::Joint(free.p),
            map: free.map,
            low: free.low,
            high: free.high,
            mean: free.to_x(base.params.get(free.p)),
            sd: free.tolerance.unwrap_or(unstated),
            stated: free.tolerance.is_some(),
        }
    }

    /// A parameter of an effect around `mean` with `sd`, both of its variable.
    pub(super) fn of_effect(free: &Free, mean: f64, sd: f64) -> Self {
        Self {
            axis: Axis::Joint(free.p),
            map: free.map,
            low: free.low,
            high: free.high,
            mean,
            sd,
            stated: true,
        }
    }

    /// A number within `low` and `high` whose variable is itself over `scale`.
    pub(super) fn linear(
        axis: Axis,
        scale: f64,
        [low, high]: [f64; 2],
        mean: f64,
        sd: f64,
    ) -> Self {
        Self {
            axis,
            map: Map::Linear { scale },
            low,
            high,
            mean: mean / scale,
            sd: sd / scale,
            stated: true,
        }
    }

    /// The same around what a joint is like.
    pub(super) fn around(self, base: &Point) -> Self {
        Self {
            mean: self.variable(base.get(self.axis)),
            ..self
        }
    }

    /// A ratio whose logarithm has a standard deviation of `sd`.
    pub(super) fn ratio(axis: Axis, sd: f64) -> Self {
        Self {
            axis,
            map: Map::Log,
            low: 1e-3,
            high: 1e3,
            mean: 0.0,
            sd,
            stated: true,
        }
    }

    pub(super) fn value(&self, x: f64) -> f64 {
        let v = match self.map {
            Map::Log => libm::exp(x.clamp(-60.0, 60.0)),
            Map::Linear { scale } => x * scale,
        };
        v.clamp(self.low, self.high)
    }

    pub(super) fn variable(&self, value: f64) -> f64 {
        match self.map {
            Map::Log => libm::log(value.max(1e-300)),
            Map::Linear { scale } => value / scale,
        }
    }

    /// The variable inside the bounds of its value.
    pub(super) fn inside(&self, x: f64) -> f64 {
        self.variable(self.value(x))
    }

    /// A step of the variable for slopes, inwards at a bound: part of the prior, over the kinks that dry friction makes.
    pub(super) fn step(&self, x: f64) -> f64 {
        const PART: f64 = 0.02;
        let step = PART * self.sd.min(1.0);
        if self.value(x + step) >= self.high {
            -step
        } else {
            step
        }
    }
}

/// Where a fit starts from, and what it moves.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Model {
    pub(super) base: Point,
    pub(super) coordinates: Vec<Coordinate>,
}

impl Model {
    /// The variables at a point.
    pub(super) fn start(&self, point: &Point) -> Vec<f64> {
        let all = self.coordinates.iter();
        all.map(|c| c.variable(point.get(c.axis))).collect()
    }

    pub(super) fn point(&self, x: &[f64]) -> Point {
        let mut out = self.base;
        for (c, x) in self.coordinates.iter().zip(x) {
            out.set(c.axis, c.value(*x));
        }
        out
    }
}
