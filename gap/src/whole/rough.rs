//! Ways down a rough cost, whose slope is that of contacts that come and go.

use rayon::prelude::*;

use super::least::cost;
use super::search::{Evaluate, Search};

impl<E: Evaluate> Search<'_, E> {
    /// Goes on from `theta` through a better point as long as the cost falls: slopes across contacts that come and go are steeper
    /// than the way down.
    pub(super) fn further(
        &self,
        (theta, mut next, mut r, mut then): (&[f64], Vec<f64>, Vec<Vec<f64>>, f64),
        members: &[usize],
        free: &[usize],
        groups: f64,
        weight: f64,
    ) -> (Vec<f64>, Vec<Vec<f64>>, f64) {
        for _ in 0..4 {
            let mut t = theta.to_vec();
            for i in free {
                let range = self.range(members, *i);
                let way = 2.0 * (next[*i] - theta[*i]);
                t[*i] = (theta[*i] + way).clamp(range[0], range[1]);
            }
            let tried = self.model.residuals(&t);
            let c = cost(&tried) * groups + weight * self.penalty(members, &t);
            if c >= then {
                break;
            }
            (next, r, then) = (t, tried, c);
        }
        (next, r, then)
    }

    /// Tries every free coordinate by itself, those of the members first: whether that helped.
    pub(super) fn feel(
        &self,
        mut theta: Vec<f64>,
        mut residuals: Vec<Vec<f64>>,
        (members, free): (&[usize], &[usize]),
        (groups, weight): (f64, f64),
    ) -> (Vec<f64>, Vec<Vec<f64>>, bool) {
        let of = |t: &[f64], r: &[Vec<f64>]| cost(r) * groups + weight * self.penalty(members, t);
        let first = of(&theta, &residuals);
        let mut now = first;
        let mut order = free.to_vec();
        order.sort_by_key(|i| !self.freed(members, *i));
        for i in order {
            let range = self.range(members, i);
            let step = self.coordinates[i].step;
            // Far, near, and to both sides at once.
            let tries: Vec<(Vec<f64>, Vec<Vec<f64>>, f64)> = [-2.0, -1.0, -0.4, 0.4, 1.0, 2.0]
                .into_par_iter()
                .map(|k| {
                    let mut t = theta.clone();
                    t[i] = (t[i] + k * step).clamp(range[0], range[1]);
                    let r = self.model.residuals(&t);
                    let c = of(&t, &r);
                    (t, r, c)
                })
                .collect();
            for (t, r, c) in tries {
                if c < now {
                    (theta, residuals, now) = (t, r, c);
                }
            }
        }
        (theta, residuals, now < first * (1.0 - 3e-3))
    }
}
