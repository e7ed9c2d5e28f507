//! Runs in which chance decides the phase of a loop that swings by itself.

use super::data::{Problem, RunData};
use crate::math;

/// Repeats that differ so many times more than those of the usual gait are out of step.
const OUT_OF_STEP: f64 = 3.0;

/// A joint turns so many times as often as its set-point, and so often per second beside that, if it swings by itself. A gait
/// that is followed turns as often as its set-point; a limit cycle of 4 Hz turns eight times a second.
const TURNS: (f64, f64) = (3.0, 8.0);

/// A turn of so many floors is no noise.
const SEEN: f64 = 6.0;

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

/// Root mean square difference of the positions of two runs, row by row.
fn apart(a: &RunData, b: &RunData) -> f64 {
    let rows = a.samples.iter().zip(&b.samples);
    let differences = rows.map(|(a, b)| a.measured[0] - b.measured[0]);
    math::rms(&differences.filter(|d| d.is_finite()).collect::<Vec<f64>>())
}

impl Problem {
    /// Runs that swing by themselves and whose repeats are out of step: a loop that swings up from rest does so from whatever touches
    /// it first, so no model can tell its phase. `noise` is that of the position.
    #[must_use]
    pub fn out_of_step(&self, noise: f64) -> Vec<usize> {
        let twin = |k: usize| {
            let group = self.runs[k].repeat;
            let others = (0..self.runs.len()).filter(|i| *i != k && self.runs[*i].repeat == group);
            let all: Vec<f64> = others
                .map(|i| apart(&self.runs[k], &self.runs[i]))
                .collect();
            all.into_iter().fold(f64::NAN, f64::max)
        };
        let spread: Vec<f64> = (0..self.runs.len()).map(twin).collect();
        let known: Vec<f64> = spread.iter().copied().filter(|s| s.is_finite()).collect();
        if known.is_empty() {
            return Vec::new();
        }
        let usual = math::median(&known);
        (0..self.runs.len())
            .filter(|k| spread[*k] > OUT_OF_STEP * usual)
            .filter(|k| swings(&self.runs[*k], self.dt_s, SEEN * noise))
            .collect()
    }
}
