//! Whether the ground stays the same during a run.

use super::body::{B, NUMBERS, Tier};
use super::search::Evaluate;

/// Frictions tried on parts of the runs, as ratios to the one found.
const FRICTIONS: [f64; 9] = [0.3, 0.42, 0.55, 0.7, 0.85, 1.0, 1.2, 1.5, 1.9];
/// Parts of the runs' length.
const PARTS: usize = 3;
/// Least gain of a friction of its own in every part for the friction to be called unsteady.
const UNSTEADY: f64 = 0.05;
impl Tier {
    /// Whether windows early and late in the runs want different frictions of the ground.
    pub(super) fn unsteady(&self, theta: &[f64]) -> bool {
        let costs: Vec<Vec<f64>> = FRICTIONS
            .iter()
            .map(|f| {
                let mut t = theta.to_vec();
                t[B::Friction as usize] *= f;
                self.window_costs(&t)
            })
            .collect();
        let latest = self.windows.iter().map(|w| w.from_s).fold(0.0, f64::max);
        let part = |w: usize| (PARTS as f64 * self.windows[w].from_s / (latest + 1.0)) as usize;
        let sums: Vec<Vec<f64>> = (0..PARTS)
            .map(|p| {
                let own: Vec<usize> = (0..self.windows.len()).filter(|w| part(*w) == p).collect();
                costs
                    .iter()
                    .map(|c| own.iter().map(|w| c[*w]).sum())
                    .collect()
            })
            .collect();
        let best = |c: &[f64]| {
            (0..c.len())
                .min_by(|a, b| c[*a].total_cmp(&c[*b]))
                .unwrap_or(0)
        };
        let all: Vec<f64> = (0..FRICTIONS.len())
            .map(|f| sums.iter().map(|s| s[f]).sum())
            .collect();
        let common = all[best(&all)];
        let apart: f64 = sums.iter().map(|s| s[best(s)]).sum();
        let values: Vec<f64> = sums.iter().map(|s| FRICTIONS[best(s)]).collect();
        let falls =
            values.windows(2).all(|v| v[1] <= v[0]) || values.windows(2).all(|v| v[1] >= v[0]);
        falls && common - apart > UNSTEADY * common
    }

    /// Mean square of the errors of every window.
    fn window_costs(&self, theta: &[f64]) -> Vec<f64> {
        let mut out = Vec::with_capacity(self.windows.len());
        let all = self.residuals(theta);
        let mut next = vec![0; self.groups];
        for g in &self.group {
            let own = &all[*g][next[*g]..next[*g] + NUMBERS];
            next[*g] += NUMBERS;
            out.push(own.iter().map(|x| x * x).sum::<f64>() / NUMBERS as f64);
        }
        out
    }
}
