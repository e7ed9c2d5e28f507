//! A first look at every candidate: one step of least squares from each of its starts.

use rayon::prelude::*;

use super::least::{add, blocks, cost, solve, total};
use super::search::Search;
use super::terms::{Evaluate, Fit};

/// Share of its tolerance's reach from which a nominal number may stand for its own effect, which is tried then.
const STRAINED: f64 = 0.8;
/// Rounds in which the weights of outliers follow what a straight line foretells: at a start far from the data all samples are outliers.
const ROUNDS: usize = 2;
/// A candidate with more starts than this is searched by its starts alone.
const DENSE: usize = 20;

/// What is known at the fit that a candidate is to be added to.
struct Ground {
    /// Numbers that are free without the candidate.
    free: Vec<usize>,
    /// Residuals at a glimpse, and after a step of each of these numbers.
    residuals: Vec<Vec<f64>>,
    columns: Vec<Vec<Vec<f64>>>,
    steps: Vec<f64>,
    /// Priors of these numbers.
    prior: Vec<(f64, f64)>,
}

/// Where a straight line from a start leads.
pub(super) struct Lead {
    pub(super) candidate: usize,
    pub(super) theta: Vec<f64>,
    /// Cost that the line promises.
    pub(super) promised: f64,
    /// The least cost that was seen, at the start or where the line leads; where the cost is smooth that is what the line promises.
    pub(super) seen: f64,
}

impl<E: Evaluate> Search<'_, E> {
    /// Where a straight line from every start of every open candidate leads at a glimpse, the best promise first; and the cost of `base`.
    pub(super) fn screen(&self, base: &Fit, open: &[usize]) -> (Vec<Lead>, f64) {
        let free = self.free(&base.members);
        let (columns, steps) = self.slopes(&base.theta, &free, &|t| self.model.glimpse(t));
        let ground = Ground {
            residuals: self.model.glimpse(&base.theta),
            prior: self.prior(&base.members, &free, &base.theta),
            free,
            columns,
            steps,
        };
        let starts = |c: &usize| {
            let all = self.candidates[*c].starts.iter();
            all.map(|s| (*c, s.as_slice())).collect::<Vec<_>>()
        };
        let tasks: Vec<(usize, &[f64])> = open.iter().flat_map(starts).collect();
        let mut out: Vec<Lead> = tasks
            .into_par_iter()
            .map(|(c, start)| self.lead(base, &ground, c, start))
            .collect();
        out.sort_by(|a, b| a.promised.total_cmp(&b.promised));
        (out, cost(&ground.residuals))
    }

    /// One step of least squares from a start of candidate `c`, all free numbers adapted to first order.
    fn lead(&self, base: &Fit, ground: &Ground, c: usize, start: &[f64]) -> Lead {
        let glimpse = |t: &[f64]| self.model.glimpse(t);
        let candidate = &self.candidates[c];
        let mut t = base.theta.clone();
        for (i, v) in candidate.free.iter().zip(start) {
            let [low, high] = self.coordinates[*i].range;
            t[*i] = v.clamp(low, high);
        }
        let r = glimpse(&t);
        // Columns at the base point serve here too: only their differences enter.
        let shifted = |col: &Vec<Vec<f64>>| add(col, &ground.residuals, &r);
        let mut all: Vec<Vec<Vec<f64>>> = ground.columns.iter().map(shifted).collect();
        let mut steps = ground.steps.clone();
        // A dense grid of starts means a number that no slope leads to.
        let own: Vec<usize> = if candidate.starts.len() > DENSE {
            Vec::new()
        } else {
            let own = candidate.free.iter().copied();
            own.filter(|i| !ground.free.contains(i)).collect()
        };
        let apart = |i: &usize| base.theta[*i] - t[*i];
        if let [i] = own.as_slice()
            && apart(i) != 0.0
        {
            // The secant from here is slope enough for one number.
            all.push(ground.residuals.clone());
            steps.push(apart(i));
        } else {
            let (more, h) = self.slopes(&t, &own, &glimpse);
            all.extend(more);
            steps.extend(h);
        }
        let moved = [ground.free.as_slice(), own.as_slice()].concat();
        let weight = self.prior_weight(base.cost);
        let pull = |j: usize| {
            let held = |p: &&(f64, f64)| p.0 > 0.0 && !candidate.free.contains(&moved[j]);
            let prior = ground.prior.get(j).filter(held);
            prior.map(|p| (weight * p.0, p.1 / p.0))
        };
        let at_start = cost(&r);
        let (d, promised) = adapted(r, all, &steps, &pull);
        let members = [base.members.as_slice(), &[c]].concat();
        let mut there = t.clone();
        for (n, (i, d)) in moved.iter().zip(&d).enumerate() {
            let range = self.range(&members, *i);
            there[*i] = (t[*i] - d).clamp(range[0], range[1]);
            if n >= ground.free.len() {
                t[*i] = there[*i];
            }
        }
        let seen = if self.limits.rough {
            cost(&glimpse(&there)).min(at_start)
        } else {
            promised
        };
        Lead {
            candidate: c,
            theta: t,
            promised,
            seen,
        }
    }

    /// Whether a nominal number that candidate `c` frees is nearly as far off as its tolerance lets it be.
    pub(super) fn strained(&self, base: &Fit, c: usize) -> bool {
        let far = |i: &usize| {
            let x = &self.coordinates[*i];
            (base.theta[*i] - x.neutral).abs() > STRAINED * self.limits.beyond * x.sigma
        };
        let free = &self.candidates[c].free;
        free.iter().all(|i| self.coordinates[*i].sigma > 0.0) && free.iter().any(far)
    }

    /// For a candidate that is searched by starts: the best of a fine scan around `theta`.
    pub(super) fn scanned(&self, theta: &[f64], c: usize) -> Vec<f64> {
        let candidate = &self.candidates[c];
        let (true, [i]) = (candidate.starts.len() > DENSE, candidate.free.as_slice()) else {
            return theta.to_vec();
        };
        let tries: Vec<(Vec<f64>, f64)> = (-8..=8)
            .into_par_iter()
            .map(|k| {
                let mut t = theta.to_vec();
                t[*i] *= 1.0 + 0.0025 * f64::from(k);
                let cost = cost(&self.model.residuals(&t));
                (t, cost)
            })
            .collect();
        tries
            .into_iter()
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map_or_else(|| theta.to_vec(), |t| t.0)
    }
}

/// What `columns`, residuals after each of the `steps`, take off the residuals `r` as straight lines: by how much each number goes back, and the cost there.
/// `pull` is a number's prior: its weight in the cost, and how far the number is off.
fn adapted(
    mut r: Vec<Vec<f64>>,
    mut columns: Vec<Vec<Vec<f64>>>,
    steps: &[f64],
    pull: &dyn Fn(usize) -> Option<(f64, f64)>,
) -> (Vec<f64>, f64) {
    let n = steps.len();
    let mut back = vec![0.0; n];
    for _ in 0..ROUNDS {
        let (mut a, mut b, _, groups) = total(&blocks(&r, &columns, steps), &|_| true);
        for j in 0..n {
            a[j * n + j] += 1e-15;
            if let Some((weight, off)) = pull(j) {
                a[j * n + j] += weight * groups;
                b[j] += weight * groups * (off - back[j]);
            }
            a[j * n + j] *= 1.001;
        }
        let d = solve(&a, &b);
        let next = foretold(&r, &columns, steps, &d);
        columns = columns.iter().map(|c| add(c, &r, &next)).collect();
        r = next;
        back.iter_mut().zip(&d).for_each(|(x, d)| *x += d);
    }
    let strain = |j: usize| {
        let (weight, off) = pull(j)?;
        Some(weight * ((off - back[j]).powi(2) - off * off))
    };
    let strain: f64 = (0..n).filter_map(strain).sum();
    let there = cost(&r) + strain;
    // What is no number ranks last.
    (
        back,
        if there.is_finite() {
            there.max(0.0)
        } else {
            f64::INFINITY
        },
    )
}

/// Residuals after every number goes back by `d`, by straight lines.
fn foretold(r: &[Vec<f64>], columns: &[Vec<Vec<f64>>], steps: &[f64], d: &[f64]) -> Vec<Vec<f64>> {
    let mut out = r.to_vec();
    for ((column, h), d) in columns.iter().zip(steps).zip(d) {
        for ((out, r), column) in out.iter_mut().zip(r).zip(column) {
            for ((out, r), x) in out.iter_mut().zip(r).zip(column) {
                *out -= (x - r) / h * d;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::search::Search;
    use super::super::terms::samples::{LIMITS, fit};
    use super::super::terms::{Candidate, Coordinate, Evaluate, Fit, Limits};
    use super::adapted;
    use crate::vocabulary::Effect;

    /// Samples that a play of 1 explains, by way of a bend that is gone there; an offset takes half of them away at 0.5 and none at 1.
    struct Bent;

    impl Evaluate for Bent {
        fn residuals(&self, theta: &[f64]) -> Vec<Vec<f64>> {
            let [play, offset] = [theta[0], theta[1]];
            let right = play + offset.min(1.0 - offset) - 1.0;
            let bend = 3.0 * play * (1.0 - play);
            // Of two patterns that have nothing in common.
            let one = |i: i32| 4.0 * if i % 2 == 0 { right } else { bend };
            vec![(0..40).map(one).collect()]
        }
    }

    #[test]
    fn where_the_cost_is_rough_what_is_there_tells_of_a_start_whose_line_promises_little() {
        let coordinate = Coordinate {
            neutral: 0.0,
            sigma: 0.0,
            step: 0.01,
            least: 0.01,
            range: [0.0, 2.0],
        };
        let candidate = |effect, i, start| Candidate {
            effect,
            joint: Some(0),
            free: vec![i],
            starts: vec![vec![start]],
        };
        let candidates = [
            candidate(Effect::Backlash, 0, 0.9),
            candidate(Effect::JointOffset, 1, 0.2),
        ];
        let coordinates = [coordinate.clone(), coordinate];
        for rough in [true, false] {
            let search = Search {
                model: &Bent,
                coordinates: &coordinates,
                candidates: &candidates,
                limits: Limits { rough, ..LIMITS },
            };
            let base = Fit {
                theta: vec![0.0; 2],
                ..fit(&[])
            };
            let (ranked, _) = search.screen(&base, &[0, 1]);
            assert_eq!(ranked[0].candidate, 1, "{rough}");
            assert_eq!(ranked[1].seen < ranked[0].seen, rough, "{rough}");
        }
    }

    #[test]
    fn a_start_that_makes_outliers_of_all_samples_is_judged_by_where_its_line_leads() {
        // One gait; samples turn by 1, 2, 3 for every unit of the first number and by 1, 0, 0 for every unit of the second.
        let turns = [[1.0, 1.0], [2.0, 0.0], [3.0, 0.0]];
        let at = |x: [f64; 2]| {
            vec![
                turns
                    .iter()
                    .map(|t| t[0] * x[0] + t[1] * x[1])
                    .collect::<Vec<f64>>(),
            ]
        };
        let start = [40.0, -7.0];
        let columns = vec![at([40.5, -7.0]), at([40.0, -6.9])];
        let (back, there) = adapted(at(start), columns.clone(), &[0.5, 0.1], &|_| None);
        assert!(
            (back[0] - 40.0).abs() < 0.1 && (back[1] + 7.0).abs() < 0.1,
            "{back:?}"
        );
        assert!(there < 0.01, "{there}");
        // A prior of weight 2 on the second number, which stands at its neutral value of 3.
        let pull = |j: usize| (j == 1).then_some((2.0, 0.0));
        let (_, there) = adapted(
            at([0.0, 3.0]),
            vec![at([0.5, 3.0]), at([0.0, 3.1])],
            &[0.5, 0.1],
            &pull,
        );
        let closed_form = {
            // Least of the mean of (x + y)^2, 4 x^2 and 9 x^2, and of 2 (y - 3)^2.
            let best = |y: f64| (y * y * (1.0 - 1.0 / 14.0)) / 3.0 + 2.0 * (y - 3.0).powi(2);
            (0..=3000)
                .map(|k| best(f64::from(k) * 1e-3))
                .fold(f64::INFINITY, f64::min)
        };
        assert!((there - closed_form).abs() < 0.02, "{there} {closed_form}");
        let broken = adapted(
            at([0.0, 3.0]),
            vec![at([0.5, 3.0]), at([0.0, 3.0])],
            &[0.5, 0.0],
            &|_| None,
        );
        assert_eq!(broken.1, f64::INFINITY);
    }
}
