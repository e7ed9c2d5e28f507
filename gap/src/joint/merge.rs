//! Repeats of one stimulus as one averaged run: the model answers them alike, so one simulation serves them all.

use super::data::{Edge, Problem, RunData};

/// Largest difference of two instants that count as the same, in parts of a step.
const SAME_INSTANT: f64 = 1e-3;

fn same_list(a: &[f64], b: &[f64], within: f64) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= within)
}

/// Whether a model answers both runs with the same trace, but for the state they start from.
pub(crate) fn alike(a: &RunData, b: &RunData) -> bool {
    let edge = |(a, b): (&Edge, &Edge)| a.step == b.step && a.enabled == b.enabled;
    a.repeat == b.repeat
        && a.role == b.role
        && a.nominal == b.nominal
        && a.steps == b.steps
        && a.samples.len() == b.samples.len()
        && a.edges.len() == b.edges.len()
        && a.edges.iter().zip(&b.edges).all(edge)
        && same_list(&a.command_t_s, &b.command_t_s, 1e-9)
        && same_list(&a.command, &b.command, 1e-9)
        && a.arrivals == b.arrivals
        && a.samples.iter().zip(&b.samples).all(|(x, y)| {
            x.step == y.step && x.enabled == y.enabled && (x.part - y.part).abs() < SAME_INSTANT
        })
}

/// Adds `b` to the average `a`.
fn average(a: &mut RunData, b: &RunData) {
    let share = 1.0 / (a.count + 1.0);
    let mix = |a: &mut f64, b: f64| *a += share * (b - *a);
    for (x, y) in a.samples.iter_mut().zip(&b.samples) {
        for (x, y) in x.measured.iter_mut().zip(y.measured) {
            mix(x, y);
        }
    }
    for (x, y) in a.edges.iter_mut().zip(&b.edges) {
        mix(&mut x.position, y.position);
        mix(&mut x.velocity, y.velocity);
    }
    a.count += 1.0;
}

impl Problem {
    /// The runs `runs` with repeats averaged.
    #[must_use]
    pub fn merged(&self, runs: &[usize]) -> Self {
        let mut out: Vec<RunData> = Vec::new();
        for run in runs.iter().filter_map(|r| self.runs.get(*r)) {
            // Against the first of the average: later ones only move its measured values.
            match out.iter_mut().find(|o| alike(o, run)) {
                Some(o) => average(o, run),
                None => out.push(run.clone()),
            }
        }
        Self {
            runs: out,
            ..self.clone()
        }
    }

    /// The first `seconds` of every run.
    #[must_use]
    pub fn beginning(&self, seconds: f64) -> Self {
        let steps = (seconds / self.dt_s) as usize;
        let mut out = self.clone();
        for run in &mut out.runs {
            run.steps = run.steps.min(steps);
            run.samples.retain(|s| s.step < steps);
            run.edges.retain(|e| e.step < steps);
        }
        out
    }
}
