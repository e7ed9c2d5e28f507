//! What is compared in a window: poses at some instants, and how far each may be off.

use super::{NUMBERS, Outcome, PERIOD_S, SAMPLES, WINDOW_S, turn};

/// Measured pose change and tolerance at one instant of a window: position then rotation vector.
#[derive(Debug, Clone, Copy)]
pub(super) struct Target {
    pub(super) pose: ([f64; 3], [f64; 4]),
    pub(super) tolerance: [f64; 6],
}

/// Floor of number `k` of a pose after a way of `way_m`.
pub(super) fn floor(floor: &[f64; 3], k: usize, way_m: f64) -> f64 {
    if k < 3 {
        floor[0] + floor[1] * way_m
    } else {
        floor[2]
    }
}

pub(super) fn sample_index(i: usize) -> usize {
    ((i + 1) as f64 * WINDOW_S / SAMPLES as f64 / PERIOD_S).round() as usize
}

pub(super) fn simulated(o: &Outcome, i: usize) -> Option<([f64; 3], [f64; 4])> {
    let p = o.poses.get(sample_index(i)).or(o.poses.last())?;
    Some((p.position_m.map(f64::from), p.quaternion.map(f64::from)))
}

/// Adds the covariance of numbers that are off by `column` to `covariance`, one standard deviation.
pub(super) fn spread_by(covariance: &mut [f64], column: &[f64]) {
    for (row, a) in covariance.chunks_mut(NUMBERS).zip(column) {
        row.iter_mut()
            .zip(column)
            .for_each(|(own, b)| *own += a * b);
    }
}

/// Poses of `o` less those of `from` at the instants compared.
pub(super) fn numbers(from: &Outcome, o: &Outcome) -> Option<Vec<f64>> {
    let mut out = Vec::with_capacity(NUMBERS);
    for i in 0..SAMPLES {
        let ((p, q), (pd, qd)) = (simulated(from, i)?, simulated(o, i)?);
        out.extend((0..3).map(|k| pd[k] - p[k]));
        out.extend(turn::between(q, qd));
    }
    out.iter().all(|x| x.is_finite()).then_some(out)
}
