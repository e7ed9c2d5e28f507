//! The robot's chain as blocks of prediction errors: each cut at what was measured, each effect a column.

pub(super) mod body;
pub(super) mod camera;
pub(super) mod electrical;
pub(super) mod position;
pub(super) mod torque;
pub(super) mod transmission;

/// Degrees of freedom of errors of which a few are gross (Student's t): a body that rests on an edge falls to either side, a
/// foot is hidden in a frame.
const FREEDOM: f64 = 6.0;

/// Value of a grid of `step_s` at `t_s`, linear between its points.
fn on(grid: &[f64], step_s: f64, t_s: f64) -> f64 {
    let place = t_s / step_s;
    let i = place as usize;
    let a = grid.get(i).copied().unwrap_or(0.0);
    let b = grid.get(i + 1).copied().unwrap_or(a);
    a + (b - a) * (place - i as f64)
}
