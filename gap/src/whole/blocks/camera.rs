//! The films given the poses: centre, size and second moments of every silhouette, less those of the measured pose seen
//! by the camera as it is stated.

use super::super::camera::{C, Tier};
use super::super::fit::{Coordinate, Evaluate};
use super::FREEDOM;
use crate::evidence::block::{Column, Segment, Site, White};
use crate::evidence::linear::solve;
use crate::vocabulary::{Effect, Stage};

/// Shifts of the clock that the best camera is looked for from: so many either side, each half a standard deviation on.
const SHIFTS: i32 = 4;
/// Of them, those that are followed.
const FOLLOWED: usize = 2;
/// Steps to the best camera.
const STEPS: usize = 6;

/// A camera and how unlikely it is.
struct Fit {
    theta: Vec<f64>,
    cost: f64,
}

/// Errors at a camera, in standard deviations.
fn errors(tier: &Tier, theta: &[f64]) -> Vec<f64> {
    tier.residuals(theta).concat()
}

/// Minus the logarithm of the likelihood of errors.
fn cost(errors: &[f64]) -> f64 {
    let one = |e: &f64| 0.5 * (FREEDOM + 1.0) * libm::log1p(e * e / FREEDOM);
    errors.iter().map(one).sum()
}

/// Square roots of the weights of errors.
fn roots(errors: &[f64]) -> Vec<f64> {
    let one = |e: &f64| ((FREEDOM + 1.0) / (FREEDOM + e * e)).min(1.0).sqrt();
    errors.iter().map(one).collect()
}

/// Change of the errors per unit of every coordinate.
fn slopes(tier: &Tier, coordinates: &[Coordinate], theta: &[f64]) -> Vec<Vec<f64>> {
    let one = |(i, c): (usize, &Coordinate)| -> Vec<f64> {
        let at = |by: f64| {
            let mut theta = theta.to_vec();
            theta[i] += by;
            errors(tier, &theta)
        };
        let (less, more) = (at(-c.step), at(c.step));
        let slope = |(a, b): (&f64, &f64)| (b - a) / (2.0 * c.step);
        less.iter().zip(&more).map(slope).collect()
    };
    coordinates.iter().enumerate().map(one).collect()
}

/// The likeliest camera from `theta`, by weighted steps of Gauss and Newton.
fn followed(tier: &Tier, coordinates: &[Coordinate], mut theta: Vec<f64>) -> Fit {
    let n = coordinates.len();
    let mut least = cost(&errors(tier, &theta));
    for _ in 0..STEPS {
        let here = errors(tier, &theta);
        let roots = roots(&here);
        let slopes = slopes(tier, coordinates, &theta);
        let dot = |a: &[f64], b: &[f64]| -> f64 {
            let each = a.iter().zip(b).zip(&roots);
            each.map(|((a, b), w)| a * b * w * w).sum()
        };
        let mut gram = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..n {
                gram[i * n + j] = dot(&slopes[i], &slopes[j]);
            }
            // What no frame shows stays.
            gram[i * n + i] += 1e-6 / (coordinates[i].step * coordinates[i].step);
        }
        let moments: Vec<f64> = slopes.iter().map(|s| -dot(s, &here)).collect();
        let step = solve(&gram, &moments);
        let next: Vec<f64> = theta
            .iter()
            .zip(&step)
            .zip(coordinates)
            .map(|((t, s), c)| (t + s).clamp(c.range[0], c.range[1]))
            .collect();
        let new = cost(&errors(tier, &next));
        if new > least - 0.01 {
            break;
        }
        (theta, least) = (next, new);
    }
    Fit { theta, cost: least }
}

/// The likeliest camera.
fn likeliest(tier: &Tier, coordinates: &[Coordinate]) -> Vec<f64> {
    let apart_s = 0.5 * spread(Effect::CameraTimeShift, "shift_s");
    let mut order: Vec<i32> = (-SHIFTS..=SHIFTS).collect();
    // Where no frame shows the clock, it is as stated.
    order.sort_by_key(|i| i.abs());
    let started = order.into_iter().map(|i| {
        let mut theta: Vec<f64> = coordinates.iter().map(|c| c.neutral).collect();
        theta[C::Shift as usize] += f64::from(i) * apart_s;
        let cost = cost(&errors(tier, &theta));
        Fit { theta, cost }
    });
    let mut started: Vec<Fit> = started.collect();
    started.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let fits = started.into_iter().take(FOLLOWED);
    let best = fits
        .map(|f| followed(tier, coordinates, f.theta))
        .min_by(|a, b| a.cost.total_cmp(&b.cost));
    best.map_or_else(Vec::new, |f| f.theta)
}

/// What the registry expects an effect's parameter to be off by.
fn spread(effect: Effect, key: &str) -> f64 {
    let own = effect.parameters().iter().find(|p| p.key == key);
    own.map_or(0.0, |p| p.prior.spread())
}

fn columns(coordinates: &[Coordinate]) -> Vec<Column> {
    let one = |effect, key, c: C| {
        let own = &coordinates[c as usize];
        Column::linear(effect, key, own.neutral, spread(effect, key)).with_slack(own.sigma)
    };
    vec![
        one(Effect::CameraHeight, "value_m", C::Height),
        one(Effect::CameraOffset, "x_m", C::X),
        one(Effect::CameraOffset, "y_m", C::Y),
        one(Effect::CameraYaw, "angle_rad", C::Yaw),
        one(Effect::CameraTimeShift, "shift_s", C::Shift),
    ]
}

/// The block of the films around the likeliest camera; coefficients count from the stated one.
pub(in crate::whole) fn block(tier: &Tier, coordinates: &[Coordinate]) -> White {
    let theta = likeliest(tier, coordinates);
    let here = errors(tier, &theta);
    let roots = roots(&here);
    let x: Vec<Vec<f64>> = slopes(tier, coordinates, &theta)
        .into_iter()
        .map(|s| s.iter().zip(&roots).map(|(s, w)| s * w).collect())
        .collect();
    // Errors are simulated less measured.
    let mut y: Vec<f64> = here.iter().zip(&roots).map(|(e, w)| -e * w).collect();
    for ((x, at), c) in x.iter().zip(&theta).zip(coordinates) {
        y.iter_mut()
            .zip(x)
            .for_each(|(y, x)| *y += (at - c.neutral) * x);
    }
    let before = (y.iter().map(|y| y * y).sum::<f64>() / y.len().max(1) as f64).sqrt();
    let site = Site {
        stage: Stage::Camera,
        joint: None,
        blind: false,
        coarse: false,
    };
    let segment = Segment {
        weight: vec![1.0; y.len()],
        y,
        x,
    };
    White::whitened(site, columns(coordinates), &[segment], [1.0, before])
}
