//! Weighted least squares over runs: Levenberg-Marquardt with priors and bounds, and a linear screen for candidates.
//!
//! Cost = mean over runs of the sum over channels of the mean square error in units of that channel's tolerance, plus the
//! priors. All sums run in a fixed order, so the result does not depend on the number of threads.

use rayon::prelude::*;

use crate::joint::data::CHANNELS;
use crate::joint::{P, Params, Problem, Trace, simulate};

/// How a parameter is mapped to the fit's own variable.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Map {
    /// `value = exp(x)`.
    Log,
    /// `value = scale * x`.
    Linear {
        /// A typical size.
        scale: f64,
    },
}

/// A parameter that the fit may move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Free {
    /// Which.
    pub p: P,
    /// Map to the fit's variable.
    pub map: Map,
    /// Lowest value.
    pub low: f64,
    /// Highest value.
    pub high: f64,
    /// 1-sigma tolerance in the fit's variable around the neutral value; `None` = unknown beforehand.
    pub tolerance: Option<f64>,
}

impl Free {
    /// Value to fit variable.
    #[must_use]
    pub fn to_x(&self, value: f64) -> f64 {
        match self.map {
            Map::Log => libm::log(value.max(1e-300)),
            Map::Linear { scale } => value / scale,
        }
    }

    /// Fit variable to value, inside the bounds.
    #[must_use]
    pub fn to_value(&self, x: f64) -> f64 {
        let v = match self.map {
            Map::Log => libm::exp(x.clamp(-60.0, 60.0)),
            Map::Linear { scale } => x * scale,
        };
        v.clamp(self.low, self.high)
    }

    /// Distance from the neutral value in tolerances (0 without a tolerance).
    #[must_use]
    pub fn pull(&self, value: f64) -> f64 {
        self.tolerance.map_or(0.0, |t| {
            (self.to_x(value) - self.to_x(Params::neutral(self.p))) / t
        })
    }
}

/// A model to fit: fixed parameters and free ones.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Values, free ones included.
    pub params: Params,
    /// What may move.
    pub free: Vec<Free>,
}

/// The cost function.
#[derive(Debug, Clone)]
pub struct Objective<'a> {
    /// Data.
    pub problem: &'a Problem,
    /// Runs in use.
    pub runs: Vec<usize>,
    /// One over the tolerance of each channel; 0 = not used.
    pub weight: [f64; CHANNELS],
    /// Cost of one squared tolerance of a prior.
    pub prior_weight: f64,
    /// Huber loss; only where repeats give the tolerance a meaning.
    pub robust: bool,
}

/// Relative step of the finite differences: large enough to step over the kinks that dry friction makes.
const DIFFERENCE: f64 = 2e-3;

/// Beyond this many tolerances an error counts linearly: single instants (an edge, a slip) must not outvote the rest.
const HUBER: f64 = 4.0;

/// Square root of the Huber loss, with the sign of `r`; plain squares where the tolerance is only a guess.
fn huber(r: f64, robust: bool) -> f64 {
    let a = r.abs();
    if a <= HUBER || !robust {
        r
    } else {
        (HUBER * (2.0 * a - HUBER)).sqrt().copysign(r)
    }
}

/// Normal equations of one linearisation.
struct Normal {
    cost: f64,
    gradient: Vec<f64>,
    hessian: Vec<f64>,
}

/// Residuals and their slopes, for the screen.
pub struct Linear {
    /// Cost at the point of linearisation, without priors.
    pub cost: f64,
    columns: Vec<Vec<Vec<f64>>>,
    factor: Option<Vec<f64>>,
    prior: Vec<f64>,
    offset: Vec<f64>,
}

impl Objective<'_> {
    /// Same cost on other runs.
    #[must_use]
    pub fn on(&self, runs: Vec<usize>) -> Self {
        Self {
            runs,
            ..self.clone()
        }
    }

    /// Weighted residuals of one run.
    fn residuals(&self, run: usize, params: &Params, trace: &mut Trace) -> Vec<f64> {
        let data = &self.problem.runs[run];
        simulate(data, params, self.problem.dt_s, trace);
        let mut out = Vec::with_capacity(data.samples.len());
        for (c, weight) in self.weight.iter().enumerate().filter(|(_, w)| **w > 0.0) {
            let start = out.len();
            for (s, y) in data.samples.iter().zip(trace.iter()) {
                let m = s.measured[c];
                if s.enabled && m.is_finite() {
                    out.push(huber((y[c] - m) * weight, self.robust));
                }
            }
            let n = (out.len() - start).max(1);
            let scale = 1.0 / ((n * self.runs.len()) as f64).sqrt();
            out[start..].iter_mut().for_each(|r| *r *= scale);
        }
        out
    }

    fn prior_cost(&self, model: &Model) -> f64 {
        let pull = |f: &Free| f.pull(model.params.get(f.p));
        self.prior_weight * model.free.iter().map(|f| pull(f) * pull(f)).sum::<f64>()
    }

    /// Cost of each run in use, without priors (already divided by their number).
    #[must_use]
    pub fn run_costs(&self, params: &Params) -> Vec<f64> {
        let one = |run: &usize| {
            let r = self.residuals(*run, params, &mut Trace::new());
            r.iter().map(|x| x * x).sum::<f64>()
        };
        self.runs.par_iter().map(one).collect()
    }

    /// Cost without priors.
    #[must_use]
    pub fn data_cost(&self, params: &Params) -> f64 {
        self.run_costs(params).iter().sum()
    }

    /// Cost with priors.
    #[must_use]
    pub fn cost(&self, model: &Model) -> f64 {
        self.data_cost(&model.params) + self.prior_cost(model)
    }

    fn shifted(f: &Free, params: &Params) -> (Params, f64) {
        let x = f.to_x(params.get(f.p));
        let step = match f.map {
            Map::Log => DIFFERENCE,
            Map::Linear { .. } => DIFFERENCE * x.abs().max(1.0),
        };
        let up = f.to_value(x + step);
        // At the upper bound, step down instead.
        let (value, step) = if f.to_x(up) - x > 0.5 * step {
            (up, step)
        } else {
            (f.to_value(x - step), -step)
        };
        (params.with(f.p, value), step)
    }

    fn run_columns(&self, run: usize, model: &Model) -> (Vec<f64>, Vec<Vec<f64>>) {
        let mut trace = Trace::new();
        let r = self.residuals(run, &model.params, &mut trace);
        let column = |f: &Free| {
            let (p, step) = Self::shifted(f, &model.params);
            let mut c = self.residuals(run, &p, &mut Trace::new());
            c.iter_mut().zip(&r).for_each(|(c, r)| *c = (*c - r) / step);
            c
        };
        let columns = model.free.iter().map(column).collect();
        (r, columns)
    }

    fn normal(&self, model: &Model) -> Normal {
        let n = model.free.len();
        let part = |run: &usize| {
            let (r, c) = self.run_columns(*run, model);
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let mut hessian = vec![0.0; n * n];
            for i in 0..n {
                for j in 0..=i {
                    hessian[i * n + j] = dot(&c[i], &c[j]);
                }
            }
            let gradient: Vec<f64> = c.iter().map(|c| dot(c, &r)).collect();
            (dot(&r, &r), gradient, hessian)
        };
        let parts: Vec<_> = self.runs.par_iter().map(part).collect();
        let mut out = Normal {
            cost: self.prior_cost(model),
            gradient: vec![0.0; n],
            hessian: vec![0.0; n * n],
        };
        for (cost, g, h) in parts {
            out.cost += cost;
            out.gradient.iter_mut().zip(g).for_each(|(a, b)| *a += b);
            out.hessian.iter_mut().zip(h).for_each(|(a, b)| *a += b);
        }
        for (i, f) in model.free.iter().enumerate() {
            if let Some(t) = f.tolerance {
                out.gradient[i] += self.prior_weight * f.pull(model.params.get(f.p)) / t;
                out.hessian[i * n + i] += self.prior_weight / (t * t);
            }
        }
        out
    }

    /// Improves `model` by at most `iterations` steps; returns the cost with priors.
    pub fn polish(&self, model: &mut Model, iterations: usize) -> f64 {
        let n = model.free.len();
        if n == 0 {
            return self.cost(model);
        }
        let mut damping = 1e-2;
        let mut best = f64::INFINITY;
        for _ in 0..iterations {
            let e = self.normal(model);
            best = e.cost;
            let mut improved = false;
            for _ in 0..5 {
                let Some(next) = step(model, &e, damping) else {
                    damping *= 10.0;
                    continue;
                };
                let cost = self.cost(&next);
                if cost < best {
                    let gain = (best - cost) / best.max(1e-300);
                    *model = next;
                    best = cost;
                    damping = (damping * 0.2).max(1e-7);
                    improved = gain > 1e-4;
                    break;
                }
                damping *= 6.0;
            }
            if !improved {
                break;
            }
        }
        best
    }

    /// Linearises around `model`, for [`Self::screen`].
    #[must_use]
    pub fn linearise(&self, model: &Model) -> Linear {
        let parts: Vec<_> = self
            .runs
            .par_iter()
            .map(|r| self.run_columns(*r, model))
            .collect();
        let cost = parts
            .iter()
            .map(|(r, _)| r.iter().map(|x| x * x).sum::<f64>())
            .sum();
        let n = model.free.len();
        let mut h = vec![0.0; n * n];
        for (_, c) in &parts {
            for i in 0..n {
                for j in 0..=i {
                    h[i * n + j] += c[i].iter().zip(&c[j]).map(|(a, b)| a * b).sum::<f64>();
                }
            }
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
            columns: parts.into_iter().map(|p| p.1).collect(),
            factor: cholesky(&h, n),
            prior,
            offset,
        }
    }

    /// Cost at `params` once the free parameters of the linearisation have adapted to it, to first order.
    #[must_use]
    pub fn screen(&self, linear: &Linear, params: &Params) -> f64 {
        let part = |(k, run): (usize, &usize)| {
            let r = self.residuals(*run, params, &mut Trace::new());
            let g: Vec<f64> = linear.columns[k]
                .iter()
                .map(|c| c.iter().zip(&r).map(|(a, b)| a * b).sum::<f64>())
                .collect();
            (r.iter().map(|x| x * x).sum::<f64>(), g)
        };
        let parts: Vec<(f64, Vec<f64>)> = self.runs.par_iter().enumerate().map(part).collect();
        let mut cost = 0.0;
        let mut g = vec![0.0; linear.prior.len()];
        for (c, part) in parts {
            cost += c;
            g.iter_mut().zip(part).for_each(|(a, b)| *a += b);
        }
        for (i, gi) in g.iter_mut().enumerate() {
            cost += linear.prior[i] * linear.offset[i] * linear.offset[i];
            *gi += linear.prior[i] * linear.offset[i];
        }
        let gain = linear.factor.as_ref().map_or(0.0, |l| {
            let x = solve(l, &g);
            x.iter().zip(&g).map(|(x, g)| x * g).sum::<f64>()
        });
        (cost - gain).max(0.0)
    }
}

fn step(model: &Model, e: &Normal, damping: f64) -> Option<Model> {
    let n = model.free.len();
    let mut h = e.hessian.clone();
    for i in 0..n {
        h[i * n + i] += damping * h[i * n + i] + 1e-12;
    }
    let l = cholesky(&h, n)?;
    let d = solve(&l, &e.gradient);
    let mut next = model.clone();
    for (f, d) in model.free.iter().zip(d) {
        // Never more than a factor e, or one typical size plus the present one, at once.
        let x = f.to_x(model.params.get(f.p));
        let most = if f.map == Map::Log {
            1.0
        } else {
            1.0 + x.abs()
        };
        next.params.set(f.p, f.to_value(x - d.clamp(-most, most)));
    }
    Some(next)
}

/// Lower Cholesky factor of a symmetric matrix given by its lower half; `None` if not positive definite.
fn cholesky(h: &[f64], n: usize) -> Option<Vec<f64>> {
    let mut l = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..=i {
            let s: f64 = h[i * n + j] - (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum::<f64>();
            if i == j {
                if s.is_nan() || s <= 0.0 {
                    return None;
                }
                l[i * n + i] = s.sqrt();
            } else {
                l[i * n + j] = s / l[j * n + j];
            }
        }
    }
    Some(l)
}

fn solve(l: &[f64], b: &[f64]) -> Vec<f64> {
    let n = b.len();
    let mut y = b.to_vec();
    for i in 0..n {
        y[i] = (y[i] - (0..i).map(|k| l[i * n + k] * y[k]).sum::<f64>()) / l[i * n + i];
    }
    for i in (0..n).rev() {
        y[i] = (y[i] - (i + 1..n).map(|k| l[k * n + i] * y[k]).sum::<f64>()) / l[i * n + i];
    }
    y
}

/// Standard error of each free parameter in the fit's variable, from the curvature at the optimum, for residuals that are
/// independent over `independent` samples per run.
#[must_use]
pub fn standard_errors(o: &Objective<'_>, model: &Model) -> Vec<f64> {
    let n = model.free.len();
    let e = o.normal(model);
    let mut h = e.hessian;
    for i in 0..n {
        h[i * n + i] += 1e-12;
    }
    let Some(l) = cholesky(&h, n) else {
        return vec![f64::INFINITY; n];
    };
    (0..n)
        .map(|i| {
            let mut unit = vec![0.0; n];
            unit[i] = 1.0;
            solve(&l, &unit)[i].max(0.0).sqrt()
        })
        .collect()
}
