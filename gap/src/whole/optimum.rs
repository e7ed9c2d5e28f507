//! What the quadratic at an optimum says: the cost of gaits left out, and how well every free number is known.

use super::least::{Block, solve, total};
use crate::math;

/// Most folds of gaits.
const FOLDS: usize = 4;
/// Slope squared below which a residual does not depend on a number.
const FLAT: f64 = 1e-12;

/// Normal equations by gait, and priors.
pub(super) struct Optimum<'a> {
    pub(super) blocks: &'a [Block],
    /// Weight of the priors, for all gaits.
    pub(super) weight: f64,
    /// Curvature and pull of the prior of every free number.
    pub(super) prior: &'a [(f64, f64)],
    /// Numbers at a border of their range, which stay there.
    pub(super) held: Vec<bool>,
}

impl Optimum<'_> {
    /// Gaits with samples.
    fn used(&self) -> Vec<usize> {
        (0..self.blocks.len())
            .filter(|g| self.blocks[*g].n > 0.0)
            .collect()
    }

    /// Adds a share of the priors to normal equations, and holds what is at a border.
    fn regularise(&self, a: &mut [f64], b: &mut [f64], share: f64) {
        let n = self.prior.len();
        for (j, (curvature, pull)) in self.prior.iter().enumerate() {
            if self.held[j] {
                a[j * n + j] *= 1e9;
            }
            a[j * n + j] += self.weight * share * curvature + 1e-15;
            b[j] += self.weight * share * pull;
        }
    }

    /// Cost of every fold of gaits after one step towards the optimum of the others.
    pub(super) fn folds(&self) -> Vec<f64> {
        let n = self.prior.len();
        let used = self.used();
        let count = used.len().min(FOLDS);
        let fold_of = |g: usize| {
            let place = used.iter().position(|u| *u == g);
            place.map_or(0, |p| p % count.max(1))
        };
        let one = |f: usize| {
            let (mut a, mut b, _, train) = total(self.blocks, &|g| fold_of(g) != f);
            let (at, bt, ct, test) = total(self.blocks, &|g| fold_of(g) == f);
            if train == 0.0 {
                return ct;
            }
            self.regularise(&mut a, &mut b, train / (train + test));
            let d = solve(&a, &b);
            let mut held = ct;
            for j in 0..n {
                held -= 2.0 * bt[j] * d[j];
                for k in 0..n {
                    held += d[j] * at[j * n + k] * d[k];
                }
            }
            held.max(0.0)
        };
        (0..count).map(one).collect()
    }

    /// Variance of every number from the curvature, per unit of cost: held at borders, and free of them. A number without a slope (one
    /// that is counted) is as it is.
    pub(super) fn variances(&self) -> Vec<[f64; 2]> {
        let n = self.prior.len();
        let (mut a, mut b, _, _) = total(self.blocks, &|_| true);
        // The border of a tolerance bounds a value, not what is known about it.
        let mut open = a.clone();
        for (j, (curvature, _)) in self.prior.iter().enumerate() {
            open[j * n + j] += self.weight * curvature + 1e-15;
        }
        self.regularise(&mut a, &mut b, 1.0);
        let one = |j: usize| {
            let mut unit = vec![0.0; n];
            unit[j] = 1.0;
            let of = |a: &[f64]| solve(a, &unit)[j].max(0.0);
            if a[j * n + j] > FLAT {
                [of(&a), of(&open)]
            } else {
                [0.0; 2]
            }
        };
        (0..n).map(one).collect()
    }

    /// Variance of every number as the gaits disagree: jackknife by one step from the optimum, widened for few gaits.
    pub(super) fn apart(&self) -> Vec<f64> {
        let n = self.prior.len();
        let used = self.used();
        let count = used.len() as f64;
        if used.len() < 3 {
            return vec![0.0; n];
        }
        let step = |left: &usize| {
            let (mut a, mut b, _, rest) = total(self.blocks, &|g| g != *left);
            self.regularise(&mut a, &mut b, rest / count);
            solve(&a, &b)
        };
        let steps: Vec<Vec<f64>> = used.iter().map(step).collect();
        let few = math::few(count - 1.0);
        let one = |j: usize| {
            let mean = steps.iter().map(|s| s[j]).sum::<f64>() / count;
            let square: f64 = steps.iter().map(|s| (s[j] - mean).powi(2)).sum();
            few * few * (count - 1.0) / count * square
        };
        (0..n).map(one).collect()
    }
}
