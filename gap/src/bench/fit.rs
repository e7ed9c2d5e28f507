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

/// Where a fit is: variables, the errors there and their slopes by coordinate.
struct Place {
    x: Vec<f64>,
    errors: Errors,
    slopes: Vec<Errors>,
}

/// Slopes of the errors at a point, where they are `errors` if these are known; the errors.
fn around(
    data: &Data<'_>,
    model: &Model,
    x: &[f64],
    errors: Option<Errors>,
) -> (Errors, Vec<Errors>) {
    let own = model.coordinates.iter().zip(x);
    let steps: Vec<f64> = own.map(|(c, x)| c.step(*x)).collect();
    let mut points: Vec<Point> = (0..x.len())
        .map(|j| {
            let mut moved = x.to_vec();
            moved[j] += steps[j];
            model.point(&moved)
        })
        .collect();
    if errors.is_none() {
        points.push(model.point(x));
    }
    let mut slopes = data.errors(&points);
    let errors = errors.or_else(|| slopes.pop()).unwrap_or_default();
    for (slope, step) in slopes.iter_mut().zip(&steps) {
        for (s, e) in slope.iter_mut().zip(&errors) {
            s.iter_mut().zip(e).for_each(|(s, e)| *s = (*s - e) / step);
        }
    }
    (errors, slopes)
}

/// A fit on its way.
struct Descent<'d, 'a> {
    data: &'d Data<'a>,
    noise: &'d Noise,
    model: &'d Model,
    here: Place,
    /// Whether the slopes are those of this point. Otherwise the steps since corrected them (Broyden's update).
    fresh: bool,
    cost: f64,
}

impl<'d, 'a> Descent<'d, 'a> {
    fn new(data: &'d Data<'a>, noise: &'d Noise, model: &'d Model, start: &[f64]) -> Self {
        let x = inside(model, start);
        let (errors, slopes) = around(data, model, &x, None);
        let here = Place { x, errors, slopes };
        Self::at(data, noise, model, here)
    }

    /// From a point whose errors and slopes are known.
    fn at(data: &'d Data<'a>, noise: &'d Noise, model: &'d Model, here: Place) -> Self {
        let mut out = Self {
            data,
            noise,
            model,
            here,
            fresh: true,
            cost: 0.0,
        };
        out.cost = out.cost_of(&out.here.errors, &out.here.x);
        out
    }

    /// Goes on for `most` steps at most.
    fn run(&mut self, most: usize) {
        for _ in 0..most.min(STEPS) {
            let fresh = self.fresh;
            let gain = self.step();
            if gain < STANDS {
                if fresh {
                    break;
                }
                self.refresh();
            }
        }
        self.refresh();
    }

    fn cost_of(&self, errors: &Errors, x: &[f64]) -> f64 {
        0.5 * (self.noise.left(&self.noise.white(errors)).0 + prior_squares(self.model, x))
    }

    /// Goes to the best of the steps that are tried at once; what that gains.
    fn step(&mut self) -> f64 {
        let white = self.noise.white(&self.here.errors);
        let (x, slopes) = (&self.here.x, &self.here.slopes);
        let normal = normal(self.noise, self.model, x, white, slopes);
        let tried = tried(&normal, x, self.model);
        let points: Vec<Point> = tried.iter().map(|x| self.model.point(x)).collect();
        let all = self.data.errors(&points).into_iter().zip(tried);
        let costs = all.map(|(errors, x)| (self.cost_of(&errors, &x), errors, x));
        let best = costs.min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((cost, errors, x)) = best.filter(|b| b.0 < self.cost) else {
            return 0.0;
        };
        let gain = self.cost - cost;
        // Slopes are as good where next to nothing was gained.
        if gain >= STANDS {
            self.correct(&errors, &x);
        }
        (self.here.x, self.here.errors, self.cost) = (x, errors, cost);
        gain
    }

    /// Corrects the slopes by what a step changed, in units of the priors: Broyden's update.
    fn correct(&mut self, errors: &Errors, x: &[f64]) {
        let own = self.model.coordinates.iter().zip(self.here.x.iter().zip(x));
        let moved: Vec<(f64, f64)> = own.map(|(c, (a, b))| (b - a, c.sd)).collect();
        let square: f64 = moved.iter().map(|(d, sd)| (d / sd) * (d / sd)).sum();
        if square <= 0.0 {
            return;
        }
        for s in 0..errors.len() {
            for row in 0..errors[s].len() {
                let each = self.here.slopes.iter().zip(&moved);
                let expected: f64 = each.map(|(slope, (d, _))| slope[s][row] * d).sum();
                let off = errors[s][row] - self.here.errors[s][row] - expected;
                for (slope, (d, sd)) in self.here.slopes.iter_mut().zip(&moved) {
                    slope[s][row] += off * d / (sd * sd * square);
                }
            }
        }
        self.fresh = false;
    }

    fn refresh(&mut self) {
        if !self.fresh {
            let errors = std::mem::take(&mut self.here.errors);
            (self.here.errors, self.here.slopes) =
                around(self.data, self.model, &self.here.x, Some(errors));
            self.fresh = true;
        }
    }
}

/// The variables inside the bounds of their values.
fn inside(model: &Model, x: &[f64]) -> Vec<f64> {
    let own = model.coordinates.iter().zip(x);
    own.map(|(c, x)| c.inside(*x)).collect()
}

impl Fit {
    /// The maximum near `start`, after `most` steps at most.
    pub(super) fn new(
        data: &Data<'_>,
        noise: &Noise,
        model: Model,
        start: &[f64],
        most: usize,
    ) -> Self {
        let mut own = Descent::new(data, noise, &model, start);
        own.run(most);
        let here = own.here;
        Self::at(noise, model, here)
    }

    /// The maximum under another noise, from where the fit stands.
    pub(super) fn under(self, data: &Data<'_>, noise: &Noise, most: usize) -> Self {
        let here = Place {
            x: self.x,
            errors: self.errors,
            slopes: self.slopes,
        };
        let model = self.model;
        let mut own = Descent::at(data, noise, &model, here);
        own.run(most);
        let here = own.here;
        Self::at(noise, model, here)
    }

    fn at(noise: &Noise, model: Model, here: Place) -> Self {
        let mut out = Self {
            model,
            x: here.x,
            errors: here.errors,
            slopes: here.slopes,
            cost: 0.0,
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
fn tried(n: &Normal, x: &[f64], model: &Model) -> Vec<Vec<f64>> {
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
            inside(model, &moved)
        })
        .collect()
}
