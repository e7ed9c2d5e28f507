//! Least squares with priors: Levenberg and Marquardt's steps from a starting point.

use rayon::prelude::*;

use super::least::{Block, blocks, cost, solve, total};
use crate::evidence::settle::REACH;

/// What is fitted.
pub(super) trait Evaluate: Sync {
    /// Residuals by group (gait) in units of their tolerances; the same lengths for every `theta`.
    fn residuals(&self, theta: &[f64]) -> Vec<Vec<f64>>;
}

/// One number that may be moved.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Coordinate {
    /// Value at which it has no effect.
    pub(super) neutral: f64,
    /// Prior, one standard deviation; 0 = fixed unless it is freed.
    pub(super) sigma: f64,
    /// Step of finite differences.
    pub(super) step: f64,
    /// Smallest and largest value.
    pub(super) range: [f64; 2],
}

/// A fitted state.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fitted {
    /// All coordinates.
    pub(super) theta: Vec<f64>,
    /// Standard deviation of each, from the curvature; 0 where fixed.
    pub(super) spread: Vec<f64>,
}

/// Damping of the first step, and factors after a step that helps and one that does not.
const DAMPING: f64 = 1e-3;
const EASIER: f64 = 0.2;
const HARDER: f64 = 8.0;
/// Steps that are tried with more and more damping.
const TRIES: usize = 4;
/// Share of the cost by which a step must lower it for another to follow.
const WORTH: f64 = 1e-4;

/// A fit.
pub(super) struct Fit<'a, E: Evaluate> {
    pub(super) model: &'a E,
    pub(super) coordinates: &'a [Coordinate],
    /// Coordinates that leave their tolerances.
    pub(super) freed: &'a [usize],
    /// Number of independent errors.
    pub(super) independent: f64,
}

/// A point, its residuals and its cost.
struct Point {
    theta: Vec<f64>,
    residuals: Vec<Vec<f64>>,
    cost: f64,
}

/// Normal equations around a point, and the weight of the priors in them.
struct Around {
    blocks: Vec<Block>,
    groups: f64,
    weight: f64,
}

impl<E: Evaluate> Fit<'_, E> {
    fn moved(&self) -> Vec<usize> {
        let all = self.coordinates.iter().enumerate();
        let own = all.filter(|(i, c)| c.sigma > 0.0 || self.freed.contains(i));
        own.map(|c| c.0).collect()
    }

    /// Weight of the prior of coordinate `i`.
    fn prior(&self, i: usize) -> f64 {
        let c = &self.coordinates[i];
        if c.sigma > 0.0 && !self.freed.contains(&i) {
            1.0 / (c.sigma * c.sigma)
        } else {
            0.0
        }
    }

    fn range(&self, i: usize) -> [f64; 2] {
        let c = &self.coordinates[i];
        if c.sigma == 0.0 || self.freed.contains(&i) {
            return c.range;
        }
        let reach = REACH * c.sigma;
        let low = (c.neutral - reach).max(c.range[0]);
        [low, (c.neutral + reach).min(c.range[1]).max(low)]
    }

    fn at(&self, theta: Vec<f64>, weigh: impl Fn(&[f64], f64) -> f64) -> Point {
        let residuals = self.model.residuals(&theta);
        Point {
            cost: weigh(&theta, cost(&residuals)),
            theta,
            residuals,
        }
    }

    fn around(&self, here: &Point, moved: &[usize]) -> Around {
        let step = |i: &usize| {
            let c = &self.coordinates[*i];
            if here.theta[*i] + c.step > c.range[1] {
                -c.step
            } else {
                c.step
            }
        };
        let steps: Vec<f64> = moved.iter().map(step).collect();
        let columns: Vec<Vec<Vec<f64>>> = moved
            .par_iter()
            .zip(&steps)
            .map(|(i, h)| {
                let mut theta = here.theta.clone();
                theta[*i] += h;
                self.model.residuals(&theta)
            })
            .collect();
        let blocks = blocks(&here.residuals, &columns, &steps);
        let (_, _, sum, groups) = total(&blocks, &|_| true);
        let weight = (sum / groups.max(1.0)).max(1.0) / self.independent * groups;
        Around {
            blocks,
            groups,
            weight,
        }
    }

    /// A damped step, within the ranges.
    fn step(&self, theta: &[f64], moved: &[usize], around: &Around, damping: f64) -> Vec<f64> {
        let n = moved.len();
        let (mut a, mut b, _, _) = total(&around.blocks, &|_| true);
        for (j, i) in moved.iter().enumerate() {
            let prior = around.weight * self.prior(*i);
            b[j] += prior * (theta[*i] - self.coordinates[*i].neutral);
            a[j * n + j] = (a[j * n + j] + prior) * (1.0 + damping) + 1e-15;
        }
        let mut out = theta.to_vec();
        for (i, d) in moved.iter().zip(solve(&a, &b)) {
            let [low, high] = self.range(*i);
            out[*i] = (out[*i] - d).clamp(low, high);
        }
        out
    }

    /// From `theta`, at most so many `steps`.
    pub(super) fn from(&self, theta: &[f64], steps: usize) -> Fitted {
        let moved = self.moved();
        let penalty = |theta: &[f64]| -> f64 {
            let off = |i: &usize| theta[*i] - self.coordinates[*i].neutral;
            moved.iter().map(|i| self.prior(*i) * off(i).powi(2)).sum()
        };
        let mut here = self.at(theta.to_vec(), |_, c| c);
        let mut around = self.around(&here, &moved);
        let mut damping = DAMPING;
        for _ in 0..steps {
            let weigh = |theta: &[f64], c: f64| c * around.groups + around.weight * penalty(theta);
            let before = weigh(&here.theta, cost(&here.residuals));
            let mut better = None;
            for _ in 0..TRIES {
                let next = self.step(&here.theta, &moved, &around, damping);
                let tried = self.at(next, weigh);
                if tried.cost < before {
                    damping = (damping * EASIER).max(1e-6);
                    better = Some(self.further(&here, tried, &moved, weigh));
                    break;
                }
                damping *= HARDER;
            }
            let Some(better) = better else {
                break;
            };
            let worth = before - better.cost > WORTH * before;
            here = better;
            around = self.around(&here, &moved);
            if !worth {
                break;
            }
        }
        Fitted {
            spread: self.spread(&here, &moved, &around),
            theta: here.theta,
        }
    }

    /// Goes on from `here` through a better point as long as the cost falls: slopes across contacts that come and go are steeper
    /// than the way down.
    fn further(
        &self,
        here: &Point,
        mut best: Point,
        moved: &[usize],
        weigh: impl Fn(&[f64], f64) -> f64,
    ) -> Point {
        for _ in 0..TRIES {
            let mut theta = here.theta.clone();
            for i in moved {
                let [low, high] = self.range(*i);
                let way = 2.0 * (best.theta[*i] - here.theta[*i]);
                theta[*i] = (here.theta[*i] + way).clamp(low, high);
            }
            let tried = self.at(theta, &weigh);
            if tried.cost >= best.cost {
                break;
            }
            best = tried;
        }
        best
    }

    /// Standard deviations from the curvature; a number without a slope is as it is.
    fn spread(&self, here: &Point, moved: &[usize], around: &Around) -> Vec<f64> {
        let n = moved.len();
        let (mut a, _, _, _) = total(&around.blocks, &|_| true);
        for (j, i) in moved.iter().enumerate() {
            a[j * n + j] += around.weight * self.prior(*i) + 1e-15;
        }
        let scale = cost(&here.residuals).max(1.0) * around.groups / self.independent;
        let mut out = vec![0.0; self.coordinates.len()];
        for (j, i) in moved.iter().enumerate() {
            let mut unit = vec![0.0; n];
            unit[j] = 1.0;
            if a[j * n + j] > FLAT {
                out[*i] = (solve(&a, &unit)[j].max(0.0) * scale).sqrt();
            }
        }
        out
    }
}

/// Slope squared below which a residual does not depend on a number.
const FLAT: f64 = 1e-12;

#[cfg(test)]
mod tests {
    use super::*;

    /// `y = a x + b x^2` at ten places, in units of `0.1`.
    struct Curve {
        a: f64,
        b: f64,
    }

    impl Evaluate for Curve {
        fn residuals(&self, theta: &[f64]) -> Vec<Vec<f64>> {
            let one = |i: i32| {
                let x = 0.1 * f64::from(i);
                ((theta[0] - self.a) * x + (theta[1] - self.b) * x * x) / 0.1
            };
            vec![(1..=10).map(one).collect()]
        }
    }

    fn coordinate(sigma: f64) -> Coordinate {
        Coordinate {
            neutral: 0.0,
            sigma,
            step: 1e-3,
            range: [-5.0, 5.0],
        }
    }

    #[test]
    fn what_is_free_is_found_and_what_has_a_tolerance_stays_in_it() {
        let coordinates = [coordinate(0.0), coordinate(0.1)];
        let truth = Curve { a: 0.8, b: 1.0 };
        let fit = |freed: &[usize]| {
            let fit = Fit {
                model: &truth,
                coordinates: &coordinates,
                freed,
                independent: 10.0,
            };
            fit.from(&[0.0; 2], 12)
        };
        let free = fit(&[0, 1]);
        assert!((free.theta[0] - 0.8).abs() < 1e-3, "{free:?}");
        assert!((free.theta[1] - 1.0).abs() < 1e-3, "{free:?}");
        assert!(free.spread.iter().all(|s| *s > 0.0), "{free:?}");
        // Three tolerances away at most; the other one makes up for it.
        let held = fit(&[0]);
        assert!(held.theta[1] <= 0.3 + 1e-12, "{held:?}");
        assert!(held.theta[0] > 1.0, "{held:?}");
        // Nothing is free that has neither tolerance nor cause.
        assert_eq!(fit(&[]).theta[0], 0.0);
    }
}
