//! The likelihood of a joint's signals and its maximum: Gauss and Newton under priors, eight step lengths at once.

use super::data::{Data, Errors};
use super::model::{Model, Point};
use super::noise::{Noise, Seen};
use crate::evidence::linear::{backward, cholesky, forward, inverse, log_determinant};

/// Most steps of a fit.
const STEPS: usize = 12;
/// Gain of half the squares below which a fit stands.
const STANDS: f64 = 0.02;
/// Shares of the full step that are tried at once, with the dampings of its normal equations.
const TRIED: [(f64, f64); 8] = [
    (1.0, 0.0),
    (0.5, 0.0),
    (1.5, 0.0),
    (1.0, 0.1),
    (0.2, 0.0),
    (1.0, 3.0),
    (0.05, 0.0),
    (1.0, 100.0),
];

/// A fitted model.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    pub(super) model: Model,
    pub(super) x: Vec<f64>,
    pub(super) errors: Errors,
    /// Slopes of the errors by coordinate.
    pub(super) slopes: Vec<Errors>,
    /// Half of the squares and of the priors' at the maximum.
    pub(super) cost: f64,
    /// Logarithm of the evidence, without the prior probability of causes.
    pub(super) evidence: f64,
    /// Factor of the normal equations.
    factor: Vec<f64>,
}

fn prior_squares(model: &Model, x: &[f64]) -> f64 {
    let own = model.coordinates.iter().zip(x);
    own.map(|(c, x)| ((x - c.mean) / c.sd) * ((x - c.mean) / c.sd))
        .sum()
}

/// Normal equations around a point, and the white errors that they are made of.
pub(super) struct Normal {
    pub(super) a: Vec<f64>,
    pub(super) gradient: Vec<f64>,
    pub(super) slopes: Vec<Seen>,
    pub(super) errors: Seen,
    pub(super) weights: Errors,
}

pub(super) fn normal(
    noise: &Noise,
    model: &Model,
    x: &[f64],
    white: Errors,
    slopes: &[Errors],
) -> Normal {
    let n = x.len();
    let (_, weights) = noise.left(&white);
    let all = slopes.iter().map(|s| noise.white(s));
    let slopes: Vec<Seen> = all.map(|s| noise.seen(s, &weights)).collect();
    let errors = noise.seen(white, &weights);
    let mut a = vec![0.0; n * n];
    let mut gradient = vec![0.0; n];
    for i in 0..n {
        for j in 0..=i {
            let p = noise.product(&slopes[i], &slopes[j], &weights);
            a[i * n + j] = p;
            a[j * n + i] = p;
        }
        let c = &model.coordinates[i];
        let stiff = 1.0 / (c.sd * c.sd);
        a[i * n + i] += stiff;
        gradient[i] = noise.product(&slopes[i], &errors, &weights) + stiff * (x[i] - c.mean);
    }
    Normal {
        a,
        gradient,
        slopes,
        errors,
        weights,
    }
}

fn slopes(data: &Data<'_>, model: &Model, x: &[f64], errors: &Errors) -> Vec<Errors> {
    let steps: Vec<f64> = model
        .coordinates
        .iter()
        .zip(x)
        .map(|(c, x)| c.step(*x))
        .collect();
    let points: Vec<Point> = (0..x.len())
        .map(|j| {
            let mut moved = x.to_vec();
            moved[j] += steps[j];
            model.point(&moved)
        })
        .collect();
    let mut out = data.errors(&points);
    for (slope, step) in out.iter_mut().zip(&steps) {
        for (s, e) in slope.iter_mut().zip(errors) {
            s.iter_mut().zip(e).for_each(|(s, e)| *s = (*s - e) / step);
        }
    }
    out
}

impl Fit {
    /// The maximum near `start`.
    pub(super) fn new(
        data: &Data<'_>,
        noise: &Noise,
        model: Model,
        start: &[f64],
        most: usize,
    ) -> Self {
        let inside = |x: &[f64]| -> Vec<f64> {
            model
                .coordinates
                .iter()
                .zip(x)
                .map(|(c, x)| c.inside(*x))
                .collect()
        };
        let mut x = inside(start);
        let mut errors = data.errors(&[model.point(&x)]).remove(0);
        let cost_of = |errors: &Errors, x: &[f64]| {
            0.5 * (noise.left(&noise.white(errors)).0 + prior_squares(&model, x))
        };
        let mut cost = cost_of(&errors, &x);
        let mut own = slopes(data, &model, &x, &errors);
        for _ in 0..most.min(STEPS) {
            let n = normal(noise, &model, &x, noise.white(&errors), &own);
            let tried = tried(&n, &x, &inside);
            let points: Vec<Point> = tried.iter().map(|x| model.point(x)).collect();
            let all = data.errors(&points);
            let mut best: Option<(f64, usize)> = None;
            for (i, (e, x)) in all.iter().zip(&tried).enumerate() {
                let c = cost_of(e, x);
                if c < best.map_or(cost, |b| b.0) {
                    best = Some((c, i));
                }
            }
            let Some((least, at)) = best else { break };
            let gain = cost - least;
            (cost, x, errors) = (least, tried[at].clone(), all[at].clone());
            own = slopes(data, &model, &x, &errors);
            if gain < STANDS {
                break;
            }
        }
        let mut out = Self {
            model,
            x,
            errors,
            slopes: own,
            cost,
            evidence: 0.0,
            factor: Vec::new(),
        };
        out.weigh(noise);
        out
    }

    /// Cost and evidence under `noise`, where the fit stands.
    pub(super) fn weigh(&mut self, noise: &Noise) {
        let n = self.x.len();
        let white = noise.white(&self.errors);
        self.cost = 0.5 * (noise.left(&white).0 + prior_squares(&self.model, &self.x));
        let own = normal(noise, &self.model, &self.x, white, &self.slopes);
        self.factor = cholesky(&own.a, n);
        let priors: f64 = self
            .model
            .coordinates
            .iter()
            .map(|c| 2.0 * libm::log(c.sd))
            .sum();
        self.evidence = -self.cost - 0.5 * (log_determinant(&self.factor, n) + priors);
    }

    pub(super) fn point(&self) -> Point {
        self.model.point(&self.x)
    }

    /// Covariance of the variables, row-major.
    pub(super) fn covariance(&self) -> Vec<f64> {
        inverse(&self.factor, self.x.len())
    }
}

/// The steps that are tried at once.
fn tried(n: &Normal, x: &[f64], inside: &dyn Fn(&[f64]) -> Vec<f64>) -> Vec<Vec<f64>> {
    let count = x.len();
    TRIED
        .iter()
        .map(|(share, damping)| {
            let mut a = n.a.clone();
            for i in 0..count {
                a[i * count + i] *= 1.0 + damping;
            }
            let l = cholesky(&a, count);
            let mut step = n.gradient.clone();
            forward(&l, count, &mut step);
            backward(&l, count, &mut step);
            let moved: Vec<f64> = x.iter().zip(&step).map(|(x, d)| x - share * d).collect();
            inside(&moved)
        })
        .collect()
}
