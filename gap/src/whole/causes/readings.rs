//! What signals show without a simulation, each number as a block of one row.

use crate::evidence::block::{Column, Segment, Site, White};
use crate::vocabulary::Effect;
use crate::whole::direct::Reading;

/// Number of the shape of everything that is read off.
const SHAPE: usize = 200;
/// Least error of a number that was read off, as a share of it.
const LEAST_ERROR: f64 = 0.02;

/// A convention that set-points and angles show at once, with its `value`, as a block of one row.
pub(super) fn sure(
    effect: Effect,
    joint: Option<usize>,
    (key, value): (&'static str, f64),
) -> White {
    let segment = Segment {
        y: vec![SURE],
        x: vec![vec![SURE]],
        weight: vec![1.0],
    };
    let site = Site {
        stage: effect.stage(),
        joint,
        blind: false,
        coarse: false,
    };
    // The value is counted, not measured: nothing lies between two of them.
    let mut column = Column::linear(effect, key, 0.0, 1.0).shaped(SHAPE, &[]);
    (column.parameter.scale, column.prior) = (value, [1.0, 1e-6]);
    White::whitened(site, vec![column], &[segment], [1.0, SURE])
}

/// Standard deviations by which a joint that follows another set-point, or turns the other way, stands out.
const SURE: f64 = 20.0;

/// A number that was read off the signals, as a block of one row; `neutral` is what the nominal model has there.
pub(super) fn reading(r: &Reading, neutral: f64) -> White {
    let error = ((r.estimate.ci95[1] - r.estimate.value) / 1.96)
        .max(LEAST_ERROR * (r.estimate.value - neutral).abs());
    let off = r.estimate.value - neutral;
    let sd = off.abs().max(1e-6);
    let segment = Segment {
        y: vec![off / error],
        x: vec![vec![1.0 / error]],
        weight: vec![1.0],
    };
    let site = Site {
        stage: r.effect.stage(),
        joint: r.joint,
        blind: false,
        coarse: false,
    };
    let column = Column::linear(r.effect, r.key, neutral, sd).shaped(SHAPE, &[]);
    White::whitened(site, vec![column], &[segment], [1.0, off.abs() / error])
}
