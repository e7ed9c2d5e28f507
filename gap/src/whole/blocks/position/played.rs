//! The servo where its causes fit best: angles of whole runs, played and not linearised.

use std::mem::discriminant;

use super::servo::{Grid, Law};
use super::shapes::Shape;
use super::{Input, Known, LEAST_RAD, SHARE, less, shapes, spread_rad};
use crate::whole::fit::{Coordinate, Evaluate, Fit};

/// Most steps of a fit.
const STEPS: usize = 12;
/// Step of a slope, and most of a coefficient, in units of its size: numerics of the fit, which decide no name.
const STEP: f64 = 0.02;
const MOST: f64 = 20.0;

/// A servo: its runs, and what may be different about it.
pub(in crate::whole) struct Played {
    grids: Vec<Grid>,
    shapes: Vec<Shape>,
    base: Law,
    tolerance_rad: f64,
    /// Independent errors: those of a servo are alike for about half a second.
    independent: f64,
}

/// A servo whose angles count by these weights.
struct Weighed<'a>(&'a Played, Vec<Vec<f64>>);

impl Evaluate for Weighed<'_> {
    fn residuals(&self, theta: &[f64]) -> Vec<Vec<f64>> {
        let Self(played, weights) = self;
        let law = played.law(theta.iter().copied().enumerate());
        let run = |(g, weights): (&Grid, &Vec<f64>)| {
            let errors = less(&g.compared(&g.simulated(&law)), &g.angles());
            let weighed = errors.iter().zip(weights);
            weighed.map(|(e, w)| w * e / played.tolerance_rad).collect()
        };
        played.grids.iter().zip(weights).map(run).collect()
    }
}

/// A coefficient with the tolerance `sigma` where no cause sets it.
fn coordinate(shape: &Shape, sigma: f64) -> Coordinate {
    let column = &shape.column;
    let size = libm::hypot(column.prior[0], column.prior[1]);
    let least = if column.positive { 0.0 } else { -MOST * size };
    let [low, high] = shape.change.range();
    Coordinate {
        neutral: 0.0,
        sigma,
        step: STEP * size,
        range: [least.max(low), high.min(MOST * size)],
    }
}

impl Played {
    /// The servo of these runs.
    pub(in crate::whole) fn new(inputs: &[Input<'_>], known: &Known) -> Self {
        let grids: Vec<Grid> = inputs.iter().filter_map(Grid::new).collect();
        let seconds: f64 = inputs.iter().map(|i| i.position.span_s()).sum();
        Self {
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
        // Of the columns of one speed limit the first is the number itself.
        let sizes = self.shapes.iter().filter(|s| s.column.slack > 0.0);
        let one = sizes.map(|s| s.change.limits()).fold(0.0, f64::min);
        let sigma = |s: &Shape| {
            let another = s.change.limits() != 0.0 && s.change.limits() != one;
            if moved.contains(&kind(s)) || another {
                0.0
            } else {
                s.column.slack
            }
        };
        let coordinates: Vec<Coordinate> = self
            .shapes
            .iter()
            .map(|s| coordinate(s, sigma(s)))
            .collect();
        let mut theta = vec![0.0; count];
        for (c, by) in start {
            let [low, high] = coordinates[*c].range;
            theta[*c] = by.clamp(low, high);
        }
        let there = self.law(theta.iter().copied().enumerate());
        let weights = self.grids.iter().map(|g| g.weights(&there)).collect();
        let fit = Fit {
            model: &Weighed(self, weights),
            coordinates: &coordinates,
            freed: &free,
            independent: self.independent,
        };
        let theta = fit.from(&theta, STEPS).theta;
        let moved = theta.into_iter().enumerate();
        moved.filter(|(_, by)| *by != 0.0).collect()
    }
}

/// Errors of the angle by run under a law, each with its instant, s and rad; none of a run that is too short.
pub(in crate::whole) fn errors_rad(inputs: &[Input<'_>], law: &Law) -> Vec<Vec<[f64; 2]>> {
    let run = |input: &Input<'_>| {
        let Some(g) = Grid::new(input) else {
            return Vec::new();
        };
        let errors = less(&g.compared(&g.simulated(law)), &g.angles());
        let all = g.instants_s().zip(errors);
        all.filter(|(t_s, _)| g.commanded(law, *t_s))
            .map(|(t_s, e)| [t_s, e])
            .collect()
    };
    inputs.iter().map(run).collect()
}
