//! Runs in which chance decides the phase of a loop that swings by itself.

use super::data::RunData;

/// A joint turns so many times as often as its set-point, and so often per second beside that, if it swings by itself. A gait
/// that is followed turns as often as its set-point; a limit cycle of 4 Hz turns eight times a second.
const TURNS: (f64, f64) = (3.0, 8.0);

/// How often `signal` turns by more than `least`.
fn turns(signal: impl Iterator<Item = f64>, least: f64) -> f64 {
    let (mut extreme, mut up, mut count) = (f64::NAN, true, 0.0);
    for x in signal.filter(|x| x.is_finite()) {
        if extreme.is_nan() || (x > extreme) == up {
            extreme = x;
        } else if (x - extreme).abs() > least {
            (extreme, up) = (x, !up);
            count += 1.0;
        }
    }
    count
}

/// Whether the position turns by more than `least` far more often than its set-point.
pub(crate) fn swings(run: &RunData, dt_s: f64, least: f64) -> bool {
    let position = run.samples.iter().filter(|s| s.enabled);
    let moved = turns(position.map(|s| s.measured[0]), least);
    let asked = turns(run.command.iter().copied(), least);
    moved > TURNS.0 * asked + TURNS.1 * run.steps as f64 * dt_s
}
