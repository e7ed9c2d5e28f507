//! Weighted least squares over runs: Levenberg-Marquardt with priors and bounds, and a linear screen for candidates.
//!
//! Cost = mean over runs of the sum over channels of the mean square error in units of that channel's tolerance, plus the
//! priors. All sums run in a fixed order, so the result does not depend on the number of threads.

mod algebra;
mod shared;
mod spread;
mod stop;

use self::algebra::{cholesky, dot, solve};
pub use self::shared::Linear;
pub use self::spread::{Spread, spread};
pub use self::stop::Stop;
use rayon::prelude::*;

use crate::joint::data::CHANNELS;
use crate::joint::{Errors, P, Params, Problem, Weights};

/// Residuals of a run, and their slopes, a column per free parameter.
type Columns = (Vec<f64>, Vec<Vec<f64>>);

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
    /// Whether it has one value only.
    #[must_use]
    pub fn fixed(&self) -> bool {
        self.low >= self.high
    }

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

impl Model {
    /// The same with everything that has a prior back at its neutral value.
    #[must_use]
    pub fn as_stated(&self) -> Self {
        let mut out = self.clone();
        for f in self.free.iter().filter(|f| f.tolerance.is_some()) {
            out.params.set(f.p, Params::neutral(f.p));
        }
        out
    }
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
    /// Ends the work early.
    pub stop: Stop<'a>,
}

/// Relative step of the finite differences: large enough to step over the kinks that dry friction makes.
const DIFFERENCE: f64 = 2e-3;

/// Beyond this many tolerances an error counts linearly: single instants (an edge, a slip) must not outvote the rest.
const HUBER: f64 = 4.0;

/// Normal equations of one linearisation.
#[derive(Debug, Clone, PartialEq)]
struct Normal {
    cost: f64,
    gradient: Vec<f64>,
    hessian: Vec<f64>,
}

impl Normal {
    fn zero(n: usize) -> Self {
        Self {
            cost: 0.0,
            gradient: vec![0.0; n],
            hessian: vec![0.0; n * n],
        }
    }

    /// Adds `sign` times another.
    fn add(&mut self, o: &Self, sign: f64) {
        self.cost += sign * o.cost;
        let add = |a: &mut [f64], b: &[f64]| a.iter_mut().zip(b).for_each(|(a, b)| *a += sign * b);
        add(&mut self.gradient, &o.gradient);
        add(&mut self.hessian, &o.hessian);
    }
}

/// Dampings tried at once after each linearisation, relative to the present one.
const DAMPINGS: [f64; 3] = [1.0, 12.0, 500.0];

impl Objective<'_> {
    /// Same cost on other runs.
    #[must_use]
    pub fn on(&self, runs: Vec<usize>) -> Self {
        Self {
            runs,
            ..self.clone()
        }
    }

    /// Recordings behind all runs in use.
    fn recordings(&self) -> f64 {
        self.runs.iter().map(|r| self.problem.runs[*r].count).sum()
    }

    /// Weighted residuals of one run, a column per parameter set; columns without a row once the work is to end.
    fn residuals(&self, run: usize, sets: &[Params]) -> Errors {
        if self.stop.asked() {
            return Errors::none(sets.len());
        }
        let data = &self.problem.runs[run];
        let weights = Weights {
            channels: self.weight,
            share: data.count / self.recordings(),
            huber: if self.robust { HUBER } else { f64::INFINITY },
        };
        Errors::new(data, sets, self.problem.dt_s, weights)
    }

    /// What the priors add to the cost.
    #[must_use]
    pub fn prior_cost(&self, model: &Model) -> f64 {
        let pull = |f: &Free| f.pull(model.params.get(f.p));
        self.prior_weight * model.free.iter().map(|f| pull(f) * pull(f)).sum::<f64>()
    }

    /// Cost of each run in use, without priors (already weighted), for every parameter set.
    #[must_use]
    pub fn run_costs_of(&self, sets: &[Params]) -> Vec<Vec<f64>> {
        let one = |run: &usize| -> Vec<f64> {
            self.residuals(*run, sets)
                .iter()
                .map(|r| dot(r, r))
                .collect()
        };
        self.runs.par_iter().map(one).collect()
    }

    /// Cost of each run in use, without priors (already divided by their number).
    #[must_use]
    pub fn run_costs(&self, params: &Params) -> Vec<f64> {
        let all = self.run_costs_of(std::slice::from_ref(params));
        all.into_iter().map(|c| c[0]).collect()
    }

    /// Cost without priors of every parameter set.
    #[must_use]
    pub fn data_costs(&self, sets: &[Params]) -> Vec<f64> {
        let runs = self.run_costs_of(sets);
        (0..sets.len())
            .map(|k| runs.iter().map(|r| r[k]).sum())
            .collect()
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

    /// Costs with priors.
    #[must_use]
    pub fn costs(&self, models: &[Model]) -> Vec<f64> {
        let sets: Vec<Params> = models.iter().map(|m| m.params).collect();
        let data = self.data_costs(&sets);
        let with = |(c, m): (f64, &Model)| c + self.prior_cost(m);
        data.into_iter().zip(models).map(with).collect()
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

    /// Residuals of one run at every model, and their slopes along its free parameters.
    fn run_columns(&self, run: usize, models: &[Model]) -> Vec<Columns> {
        let mut sets = Vec::new();
        let mut steps = Vec::new();
        for m in models {
            sets.push(m.params);
            steps.push(0.0);
            for f in &m.free {
                let (p, step) = Self::shifted(f, &m.params);
                sets.push(p);
                steps.push(step);
            }
        }
        let errors = self.residuals(run, &sets);
        let mut all = errors.iter().zip(steps);
        models
            .iter()
            .map(|m| {
                let r = all.next().map_or(&[] as &[f64], |c| c.0);
                let column = |(c, step): (&[f64], f64)| {
                    c.iter().zip(r).map(|(c, r)| (c - r) / step).collect()
                };
                let columns = all.by_ref().take(m.free.len()).map(column).collect();
                (r.to_vec(), columns)
            })
            .collect()
    }

    /// Normal equations of every model, run by run, without priors.
    fn run_normals(&self, models: &[Model]) -> Vec<Vec<Normal>> {
        let part = |run: &usize| -> Vec<Normal> {
            let one = |(r, c): Columns| {
                let n = c.len();
                let mut out = Normal::zero(n);
                out.cost = dot(&r, &r);
                for i in 0..n {
                    out.gradient[i] = dot(&c[i], &r);
                    for j in 0..=i {
                        out.hessian[i * n + j] = dot(&c[i], &c[j]);
                    }
                }
                out
            };
            self.run_columns(*run, models)
                .into_iter()
                .map(one)
                .collect()
        };
        self.runs.par_iter().map(part).collect()
    }

    fn add_prior(&self, model: &Model, e: &mut Normal) {
        let n = model.free.len();
        e.cost += self.prior_cost(model);
        for (i, f) in model.free.iter().enumerate() {
            if let Some(t) = f.tolerance {
                e.gradient[i] += self.prior_weight * f.pull(model.params.get(f.p)) / t;
                e.hessian[i * n + i] += self.prior_weight / (t * t);
            }
        }
    }

    fn normals(&self, models: &[Model]) -> Vec<Normal> {
        let runs = self.run_normals(models);
        let one = |(k, m): (usize, &Model)| {
            let mut out = Normal::zero(m.free.len());
            runs.iter().for_each(|r| out.add(&r[k], 1.0));
            self.add_prior(m, &mut out);
            out
        };
        models.iter().enumerate().map(one).collect()
    }

    /// Improves `model` by at most `iterations` steps; returns the cost with priors.
    pub fn polish(&self, model: &mut Model, iterations: usize) -> f64 {
        self.polish_all(std::slice::from_mut(model), iterations)[0]
    }

    /// Improves every model by at most `iterations` steps (Levenberg-Marquardt); returns the costs with priors.
    /// Models are simulated side by side but do not touch each other.
    pub fn polish_all(&self, models: &mut [Model], iterations: usize) -> Vec<f64> {
        let mut damping = vec![1e-2; models.len()];
        let mut best = vec![f64::INFINITY; models.len()];
        let mut active: Vec<usize> = (0..models.len()).collect();
        for _ in 0..iterations {
            let now: Vec<Model> = active.iter().map(|i| models[*i].clone()).collect();
            let normals = self.normals(&now);
            let mut tries: Vec<Model> = Vec::new();
            let mut owner: Vec<(usize, f64)> = Vec::new();
            for ((i, m), e) in active.iter().zip(&now).zip(&normals) {
                best[*i] = e.cost;
                for d in DAMPINGS {
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
            active.retain(|i| gain[*i] > 1e-4);
            if active.is_empty() {
                break;
            }
        }
        if iterations == 0 {
            return self.costs(models);
        }
        best
    }

    /// Share of the recordings that `runs` hold.
    fn part(&self, runs: &[usize]) -> f64 {
        let count: f64 = runs.iter().map(|r| self.problem.runs[*r].count).sum();
        count / self.recordings()
    }

    /// Held-out cost of each fold: from `model`, one step towards the optimum of the other folds' runs, at the fold.
    /// The shares add up to a mean over all runs.
    #[must_use]
    pub fn fold_costs(&self, model: &Model, folds: &[Vec<usize>]) -> Vec<f64> {
        let n = model.free.len();
        let normals = self.run_normals(std::slice::from_ref(model));
        let mut all = Normal::zero(n);
        normals.iter().for_each(|r| all.add(&r[0], 1.0));
        let one = |fold: &Vec<usize>| {
            let mut rest = all.clone();
            let mut mine = Vec::new();
            for (run, e) in self.runs.iter().zip(&normals) {
                if fold.contains(run) {
                    rest.add(&e[0], -1.0);
                    mine.push(*run);
                }
            }
            self.add_prior(model, &mut rest);
            let others: Vec<usize> = self
                .runs
                .iter()
                .copied()
                .filter(|r| !mine.contains(r))
                .collect();
            let on_rest = |m: &Model| {
                self.on(others.clone()).data_cost(&m.params) * self.part(&others)
                    + self.prior_cost(m)
            };
            // Where a parabola is no good picture of the cost, staying is better than its optimum.
            let moved = step(model, &rest, 1e-3)
                .filter(|m| on_rest(m) < rest.cost)
                .unwrap_or_else(|| model.clone());
            let share = self.part(&mine);
            self.on(mine).data_cost(&moved.params) * share
        };
        folds.iter().map(one).collect()
    }

    /// Steps out of small valleys that rounding, play and dry friction make: tries each of `moving` alone at several
    /// distances, as long as that helps, and polishes. Returns the cost with priors.
    pub fn jiggle(&self, model: &mut Model, moving: &[P]) -> f64 {
        // Relative steps, from a hundredth of a percent to a tenth.
        const STEPS: [f64; 16] = [
            -0.12, -0.04, -0.012, -0.004, -0.0015, -0.0006, -0.0002, -0.0001, 0.0001, 0.0002,
            0.0006, 0.0015, 0.004, 0.012, 0.04, 0.12,
        ];
        let mut best = self.cost(model);
        for _ in 0..3 {
            let before = best;
            for p in moving {
                let Some(f) = model.free.iter().find(|f| f.p == *p).copied() else {
                    continue;
                };
                let x = f.to_x(model.params.get(*p));
                let size = if f.map == Map::Log { 1.0 } else { x.abs() };
                let shifted = |d: &f64| Model {
                    params: model.params.with(*p, f.to_value(x + d * size)),
                    ..model.clone()
                };
                let tries: Vec<Model> = STEPS.iter().map(shifted).collect();
                for (m, c) in tries.iter().zip(self.costs(&tries)) {
                    if c < best {
                        best = c;
                        *model = m.clone();
                    }
                }
            }
            if best > 0.99 * before {
                break;
            }
            best = self.polish(model, 2);
        }
        best
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
