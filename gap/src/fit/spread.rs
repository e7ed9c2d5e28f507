//! How far a fit may be off: what noise allows, and what the motions disagree on.

use super::algebra::{cholesky, dot, solve};
use super::{Model, Normal, Objective};

/// Covariance of the free parameters of a fit, in the fit's variables.
#[derive(Debug, Clone, PartialEq)]
pub struct Spread {
    n: usize,
    covariance: Vec<f64>,
}

impl Spread {
    /// Half of a 95 % interval of a quantity with these slopes along the free parameters, and where the free parameters
    /// stand at its upper end, as shifts.
    #[must_use]
    pub fn end(&self, slopes: &[f64]) -> Vec<f64> {
        let along: Vec<f64> = (0..self.n)
            .map(|i| dot(&self.covariance[i * self.n..][..self.n], slopes))
            .collect();
        let deviation = dot(&along, slopes).max(0.0).sqrt();
        if deviation > 0.0 {
            along.iter().map(|a| 1.96 * a / deviation).collect()
        } else {
            vec![0.0; self.n]
        }
    }
}

/// Spread of `model` at its optimum. `group` tells which runs are one motion; `independent` samples stand behind the cost.
///
/// Two sources are added. Noise: the inverse curvature, for residuals that are independent over `independent` samples.
/// Motions: each of them pulls the optimum its own way. The sum of the squares of those pulls is what another choice of
/// motions would have moved it by. The cause does not matter; it may be a law that is a little different.
#[must_use]
pub fn spread(
    o: &Objective<'_>,
    model: &Model,
    independent: f64,
    group: &[usize],
) -> Option<Spread> {
    let n = model.free.len();
    let runs = o.run_normals(std::slice::from_ref(model));
    let mut all = Normal::zero(n);
    runs.iter().for_each(|r| all.add(&r[0], 1.0));
    let cost = all.cost;
    o.add_prior(model, &mut all);
    for i in 0..n {
        all.hessian[i * n + i] += 1e-12;
    }
    let l = cholesky(&all.hessian, n)?;
    let mut keys = group.to_vec();
    keys.sort_unstable();
    keys.dedup();
    let count = keys.len() as f64;
    let pull = |key: &usize| {
        let mut sum = Normal::zero(n);
        let mine = runs.iter().zip(group).filter(|(_, g)| *g == key);
        mine.for_each(|(r, _)| sum.add(&r[0], 1.0));
        solve(&l, &sum.gradient)
    };
    let pulls: Vec<Vec<f64>> = keys.iter().map(pull).collect();
    let mut covariance = vec![0.0; n * n];
    for i in 0..n {
        let mut unit = vec![0.0; n];
        unit[i] = 1.0;
        let column = solve(&l, &unit);
        for j in 0..n {
            let motions: f64 = pulls.iter().map(|p| p[i] * p[j]).sum();
            covariance[i * n + j] =
                column[j] * cost / independent + motions * count / (count - 1.0).max(1.0);
        }
    }
    Some(Spread { n, covariance })
}
