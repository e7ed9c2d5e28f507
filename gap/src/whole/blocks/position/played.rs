//! The servo where its causes fit best: angles of whole runs, played and not linearised.

use std::mem::discriminant;

use super::servo::{Grid, Law};
use super::shapes::Shape;
use super::{Input, Known, LEAST_RAD, SHARE, less, shapes, spread_rad};
use crate::evidence::block::Column;
use crate::vocabulary::Effect;
use crate::whole::search::{Candidate, Coordinate, Evaluate, Limits, Search};

/// Most steps of a fit.
const STEPS: usize = 12;
/// Step of a slope, and most of a coefficient, in units of its size: numerics of the fit, which decide no name.
const STEP: f64 = 0.02;
const MOST: f64 = 20.0;

/// A servo: its runs, and what may be different about it.
pub(in crate::whole) struct Played {
    grids: Vec<Grid>,
    weights: Vec<Vec<f64>>,
    shapes: Vec<Shape>,
    base: Law,
    tolerance_rad: f64,
    /// Independent errors: those of a servo are alike for about half a second.
    independent: f64,
}

impl Evaluate for Played {
    fn residuals(&self, theta: &[f64]) -> Vec<Vec<f64>> {
        let law = self.law(theta.iter().copied().enumerate());
        let run = |(g, weights): (&Grid, &Vec<f64>)| {
            let errors = less(&g.compared(&g.simulated(&law)), &g.angles());
            let weighed = errors.iter().zip(weights);
            weighed.map(|(e, w)| w * e / self.tolerance_rad).collect()
        };
        self.grids.iter().zip(&self.weights).map(run).collect()
    }
}

/// A coefficient with the tolerance `sigma` where no cause sets it.
fn coordinate(column: &Column, sigma: f64) -> Coordinate {
    let size = libm::hypot(column.prior[0], column.prior[1]);
    let least = if column.positive { 0.0 } else { -MOST * size };
    Coordinate {
        neutral: 0.0,
        sigma,
        step: STEP * size,
        least: 0.0,
        range: [least, MOST * size],
    }
}

impl Played {
    /// The servo of these runs.
    pub(in crate::whole) fn new(inputs: &[Input<'_>], known: &Known) -> Self {
        let grids: Vec<Grid> = inputs.iter().filter_map(Grid::new).collect();
        let seconds: f64 = inputs.iter().map(|i| i.position.span_s()).sum();
        Self {
            weights: grids.iter().map(Grid::weights).collect(),
            shapes: shapes(known, &grids),
            base: Law::nominal(&known.nominal),
            tolerance_rad: LEAST_RAD + SHARE * spread_rad(&grids),
            independent: (2.0 * seconds).max(10.0),
            grids,
        }
    }

    /// The law with these coefficients; lost set-points are no part of it.
    pub(in crate::whole) fn law(&self, by: impl IntoIterator<Item = (usize, f64)>) -> Law {
        let own = by.into_iter().filter(|b| b.1 != 0.0);
        own.fold(self.base, |law, (c, by)| match self.shapes.get(c) {
            Some(shape) => shape.change.on(law, by),
            None => law,
        })
    }

    /// Coefficients that fit best: of the causes in `start`, and of nominal numbers within three tolerances.
    pub(in crate::whole) fn fitted(&self, start: &[(usize, f64)]) -> Vec<(usize, f64)> {
        let count = self.shapes.len();
        if start.iter().any(|s| s.0 >= count) {
            // Beside lost set-points, which are not played here, all numbers would be wrong.
            return start.to_vec();
        }
        let free: Vec<usize> = start.iter().map(|s| s.0).collect();
        // What a cause changes has no tolerance beside it.
        let kind = |shape: &Shape| discriminant(&shape.change);
        let moved: Vec<_> = free.iter().map(|c| kind(&self.shapes[*c])).collect();
        let sigma = |s: &Shape| {
            if moved.contains(&kind(s)) {
                0.0
            } else {
                s.column.slack
            }
        };
        let coordinates: Vec<Coordinate> = self
            .shapes
            .iter()
            .map(|s| coordinate(&s.column, sigma(s)))
            .collect();
        let mut theta = vec![0.0; count];
        for (c, by) in start {
            let [low, high] = coordinates[*c].range;
            theta[*c] = by.clamp(low, high);
        }
        // A fit frees the coordinates of its candidates, whatever they are called.
        let freed = Candidate {
            effect: Effect::LoopGain,
            joint: None,
            free,
            starts: Vec::new(),
        };
        let search = Search {
            model: self,
            coordinates: &coordinates,
            candidates: &[freed],
            limits: Limits {
                independent: self.independent,
                ..Limits::FIT
            },
        };
        let theta = search.fit(&theta, &[0], STEPS).theta;
        let moved = theta.into_iter().enumerate();
        moved.filter(|(_, by)| *by != 0.0).collect()
    }
}

/// Root mean square errors of the angle by run under a law, rad; `None` for a run that is too short.
pub(in crate::whole) fn errors_rad(inputs: &[Input<'_>], law: &Law) -> Vec<Option<f64>> {
    let run = |input: &Input<'_>| {
        let g = Grid::new(input)?;
        Some(crate::math::rms(&less(
            &g.compared(&g.simulated(law)),
            &g.angles(),
        )))
    };
    inputs.iter().map(run).collect()
}
