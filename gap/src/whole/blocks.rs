//! The robot's chain as blocks of prediction errors: each cut at what was measured, each effect a column.

pub(super) mod body;
pub(super) mod position;
pub(super) mod torque;

use super::data::Track;

/// Values of a track on a grid of `step_s` from its first sample: `count` of them.
pub(super) fn resampled(track: &Track, from_s: f64, step_s: f64, count: usize) -> Vec<f64> {
    (0..count)
        .map(|i| track.at(from_s + i as f64 * step_s))
        .collect()
}
