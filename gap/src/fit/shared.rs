//! One linearisation for many candidates: a screen, and refits that keep the slopes of the shared parameters.

use rayon::prelude::*;

use super::algebra::{cholesky, dot, solve};
use super::{Columns, Free, Model, Normal, Objective, step};
use crate::joint::{P, Params};

/// Residuals and their slopes, for the screen.
pub struct Linear {
    /// Cost at the point of linearisation, without priors.
    pub cost: f64,
    /// Parameters of the columns.
    free: Vec<P>,
    /// Slopes by run and parameter.
    columns: Vec<Vec<Vec<f64>>>,
    /// Their products by run, square.
    products: Vec<Vec<f64>>,
    factor: Option<Vec<f64>>,
    prior: Vec<f64>,
    offset: Vec<f64>,
}

/// Dampings tried at once where only a ranking is wanted.
const SHARED_DAMPINGS: [f64; 2] = [1.0, 100.0];

impl Objective<'_> {
    /// Like [`Self::polish_all`] for models that each add a few parameters (`own` of them, last in their list) to one
    /// linearised model: only those are linearised afresh, the shared ones keep their slopes. Good enough to rank.
    pub fn polish_shared(
        &self,
        linear: &Linear,
        models: &mut [Model],
        own: &[usize],
        iterations: usize,
    ) -> Vec<f64> {
        let mut damping = vec![1e-2; models.len()];
        let mut best = vec![f64::INFINITY; models.len()];
        let mut active: Vec<usize> = (0..models.len()).collect();
        for _ in 0..iterations {
            let now: Vec<(&Model, usize)> = active.iter().map(|i| (&models[*i], own[*i])).collect();
            let normals = self.shared_normals(linear, &now);
            let mut tries: Vec<Model> = Vec::new();
            let mut owner: Vec<(usize, f64)> = Vec::new();
            for ((i, (m, _)), e) in active.iter().zip(&now).zip(&normals) {
                best[*i] = e.cost;
                for d in SHARED_DAMPINGS {
                    if let Some(next) = step(m, e, damping[*i] * d) {
                        tries.push(next);
                        owner.push((*i, damping[*i] * d));
                    }
                }
            }
            let costs = self.costs(&tries);
            let mut gain = vec![0.0; models.len()];
            for ((m, (i, d)), cost) in tries.into_iter().zip(owner).zip(costs) {
                if cost < best[i] {
                    gain[i] += (best[i] - cost) / best[i].max(1e-300);
                    models[i] = m;
                    best[i] = cost;
                    damping[i] = (d * 0.1).max(1e-7);
                }
            }
            active.retain(|i| gain[*i] > 1e-3);
            if active.is_empty() {
                break;
            }
        }
        best
    }

    fn shared_normals(&self, linear: &Linear, models: &[(&Model, usize)]) -> Vec<Normal> {
        // Simulated: every model as it is, with no free parameters but its own.
        let thin: Vec<Model> = models
            .iter()
            .map(|(m, own)| Model {
                params: m.params,
                free: m.free[m.free.len() - own..].to_vec(),
            })
            .collect();
        let part = |(k, run): (usize, &usize)| -> Vec<Normal> {
            let shared = &linear.columns[k];
            let one = |((r, c), (m, own)): (Columns, &(&Model, usize))| {
                let n = m.free.len();
                let at = |f: &Free| linear.free.iter().position(|p| *p == f.p);
                let mut columns: Vec<&[f64]> = Vec::with_capacity(n);
                let mut index: Vec<Option<usize>> = Vec::with_capacity(n);
                for f in &m.free[..n - own] {
                    index.push(at(f));
                    columns.push(at(f).map_or(&[], |i| &shared[i]));
                }
                index.resize(n, None);
                columns.extend(c.iter().map(Vec::as_slice));
                let mut out = Normal::zero(n);
                out.cost = dot(&r, &r);
                for i in 0..n {
                    out.gradient[i] = dot(columns[i], &r);
                    for j in 0..=i {
                        out.hessian[i * n + j] = match (index[i], index[j]) {
                            (Some(a), Some(b)) => linear.products[k][a * linear.free.len() + b],
                            _ => dot(columns[i], columns[j]),
                        };
                    }
                }
                out
            };
            let parts = self.run_columns(*run, &thin);
            parts.into_iter().zip(models).map(one).collect()
        };
        let runs: Vec<Vec<Normal>> = self.runs.par_iter().enumerate().map(part).collect();
        let one = |(k, (m, _)): (usize, &(&Model, usize))| {
            let mut out = Normal::zero(m.free.len());
            runs.iter().for_each(|r| out.add(&r[k], 1.0));
            self.add_prior(m, &mut out);
            out
        };
        models.iter().enumerate().map(one).collect()
    }

    /// Linearises around `model`, for [`Self::screen`].
    #[must_use]
    pub fn linearise(&self, model: &Model) -> Linear {
        let models = std::slice::from_ref(model);
        let parts: Vec<Columns> = self
            .runs
            .par_iter()
            .map(|r| self.run_columns(*r, models).remove(0))
            .collect();
        let cost = parts.iter().map(|(r, _)| dot(r, r)).sum();
        let n = model.free.len();
        let product = |(_, c): &Columns| {
            let mut out = vec![0.0; n * n];
            for i in 0..n {
                for j in 0..=i {
                    out[i * n + j] = dot(&c[i], &c[j]);
                    out[j * n + i] = out[i * n + j];
                }
            }
            out
        };
        let products: Vec<Vec<f64>> = parts.iter().map(product).collect();
        let mut h = vec![0.0; n * n];
        for p in &products {
            h.iter_mut().zip(p).for_each(|(h, p)| *h += p);
        }
        let mut prior = vec![0.0; n];
        let mut offset = vec![0.0; n];
        for (i, f) in model.free.iter().enumerate() {
            if let Some(t) = f.tolerance {
                prior[i] = self.prior_weight / (t * t);
                offset[i] = f.pull(model.params.get(f.p)) * t;
            }
            let scale = h[i * n + i];
            h[i * n + i] += prior[i] + 1e-4 * scale + 1e-12;
        }
        Linear {
            cost,
            free: model.free.iter().map(|f| f.p).collect(),
            products,
            columns: parts.into_iter().map(|p| p.1).collect(),
            factor: cholesky(&h, n),
            prior,
            offset,
        }
    }

    /// Cost at every parameter set once the free parameters of the linearisation have adapted to it, to first order.
    #[must_use]
    pub fn screen(&self, linear: &Linear, sets: &[Params]) -> Vec<f64> {
        let part = |(k, run): (usize, &usize)| -> Vec<(f64, Vec<f64>)> {
            let one = |r: &[f64]| {
                let g = linear.columns[k].iter().map(|c| dot(c, r)).collect();
                (dot(r, r), g)
            };
            self.residuals(*run, sets).iter().map(one).collect()
        };
        let parts: Vec<Vec<(f64, Vec<f64>)>> = self.runs.par_iter().enumerate().map(part).collect();
        let one = |i: usize| {
            let mut cost = 0.0;
            let mut g = vec![0.0; linear.prior.len()];
            for part in &parts {
                cost += part[i].0;
                g.iter_mut().zip(&part[i].1).for_each(|(a, b)| *a += b);
            }
            for (i, gi) in g.iter_mut().enumerate() {
                cost += linear.prior[i] * linear.offset[i] * linear.offset[i];
                *gi += linear.prior[i] * linear.offset[i];
            }
            let gain = linear
                .factor
                .as_ref()
                .map_or(0.0, |l| dot(&solve(l, &g), &g));
            (cost - gain).max(0.0)
        };
        (0..sets.len()).map(one).collect()
    }
}
