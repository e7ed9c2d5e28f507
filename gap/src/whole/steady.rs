//! Whether the ground stays the same during a run.

use super::body::{B, NUMBERS, Tier};
use super::search::Evaluate;

/// Frictions tried on parts of the runs, as ratios to the one found.
const FRICTIONS: [f64; 9] = [0.3, 0.42, 0.55, 0.7, 0.85, 1.0, 1.2, 1.5, 1.9];
/// Parts of the runs' length.
const PARTS: usize = 3;
/// Least gain of a friction of its own in every part for the friction to be called unsteady.
const UNSTEADY: f64 = 0.05;
/// Least ratio of the first part's friction to the last's, or the other way round: robots on a ground that stays show 1.2.
const FAR: f64 = 1.4;

impl Tier {
    /// Whether windows early and late in the runs want different frictions of the ground: those of the other gaits, on every gait.
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
        // Costs by part and friction of the windows that are taken.
        let sums = |take: &dyn Fn(usize) -> bool| -> [[f64; FRICTIONS.len()]; PARTS] {
            let mut out = [[0.0; FRICTIONS.len()]; PARTS];
            for w in (0..self.windows.len()).filter(|w| take(*w)) {
                let own = &mut out[part(w).min(PARTS - 1)];
                own.iter_mut().zip(&costs).for_each(|(s, c)| *s += c[w]);
            }
            out
        };
        let values = apart(&sums(&|_| true)).map(|f| FRICTIONS[f]);
        let falls =
            values.windows(2).all(|v| v[1] <= v[0]) || values.windows(2).all(|v| v[1] >= v[0]);
        let (mut common, mut parted) = (0.0, 0.0);
        for g in 0..self.groups {
            let others = sums(&|w| self.group[w] != g);
            let own = sums(&|w| self.group[w] == g);
            let one = together(&others);
            let each = apart(&others);
            for (sum, friction) in own.iter().zip(each) {
                common += sum[one];
                parted += sum[friction];
            }
        }
        let far = libm::log(values[0] / values[PARTS - 1]).abs() > libm::log(FAR);
        falls && far && common - parted > UNSTEADY * common
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

/// The friction of least cost in every part.
fn apart(sums: &[[f64; FRICTIONS.len()]; PARTS]) -> [usize; PARTS] {
    sums.map(|s| least(&s))
}

/// The friction of least cost in all parts together.
fn together(sums: &[[f64; FRICTIONS.len()]; PARTS]) -> usize {
    let all: Vec<f64> = (0..FRICTIONS.len())
        .map(|f| sums.iter().map(|s| s[f]).sum())
        .collect();
    least(&all)
}

fn least(costs: &[f64]) -> usize {
    (0..costs.len())
        .min_by(|a, b| costs[*a].total_cmp(&costs[*b]))
        .unwrap_or(0)
}
