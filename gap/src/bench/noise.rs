//! The noise of a joint's signals, and what healthy joints differ by.

use super::data::{Data, Errors};
use crate::evidence::block::{Column, Segment};
use crate::evidence::linear::{backward, cholesky, dot, forward, log_determinant, weighted_dot};
use crate::evidence::noise::{HUBER, Whitening};

/// Order of the autoregression that whitens: 60 ms at 100 Hz.
pub(super) const ORDER: usize = 6;

/// The noise of every channel, how much each row of it counts, and directions in which healthy joints differ.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Noise {
    filters: Vec<Whitening>,
    /// Share by which all rows count: `1 / (1 + rows error^2)`, for the model error.
    count: f64,
    weights: Errors,
    /// Channel number of every series.
    channel: Vec<usize>,
    /// White directions, of the size by which healthy joints differ along them.
    healthy: Vec<Errors>,
    /// Factor of one and their products.
    factor: Vec<f64>,
}

/// A direction in the space of errors, with the prior of its coefficient.
pub(super) struct Direction {
    pub(super) errors: Errors,
    pub(super) prior: [f64; 2],
    /// Standard deviation of the coefficient among healthy joints.
    pub(super) healthy: f64,
}

/// White errors, and what of them healthy joints may differ by.
pub(super) struct Seen {
    pub(super) white: Errors,
    along: Vec<f64>,
}

impl Noise {
    /// From what `directions` together leave of `errors`; `error` is the model error in any one direction, as a share
    /// of the noise, which no number of rows averages away.
    pub(super) fn new(
        data: &Data<'_>,
        errors: &Errors,
        directions: &[Direction],
        error: f64,
    ) -> Self {
        let columns: Vec<Column> = directions
            .iter()
            .map(|d| Column {
                prior: d.prior,
                ..Column::nuisance(0.0)
            })
            .collect();
        let mut out = Self {
            filters: Vec::new(),
            count: 1.0,
            weights: Vec::new(),
            channel: Vec::new(),
            healthy: Vec::new(),
            factor: Vec::new(),
        };
        for k in 0..data.channels.len() {
            let segments: Vec<Segment> = data
                .series(k)
                .map(|s| Segment {
                    y: errors[s].clone(),
                    x: directions
                        .iter()
                        .map(|d| d.errors[s].iter().map(|e| -e).collect())
                        .collect(),
                    weight: data.weights[s].clone(),
                })
                .collect();
            let filter = Whitening::fit(&segments, &columns, ORDER, data.floor(k));
            for s in data.series(k) {
                let mut weight = data.weights[s].clone();
                weight
                    .iter_mut()
                    .take(filter.order())
                    .for_each(|w| *w = 0.0);
                out.weights.push(weight);
                out.channel.push(k);
            }
            out.filters.push(filter);
        }
        let rows: f64 = out.weights.iter().flatten().sum();
        out.count = 1.0 / (1.0 + rows * error * error);
        out.with_healthy(directions)
    }

    /// White noise as large as `errors`, which are alike for half a second: for fits that are to be played from set-points
    /// alone, whatever of the joint no model has.
    pub(super) fn plain(data: &Data<'_>, errors: &Errors) -> Self {
        let mut out = Self {
            filters: Vec::new(),
            count: 1.0,
            weights: data.weights.clone(),
            channel: Vec::new(),
            healthy: Vec::new(),
            factor: Vec::new(),
        };
        for k in 0..data.channels.len() {
            let own = data.series(k);
            let (mut squares, mut rows) = (0.0, 0.0);
            for s in own.clone() {
                let each = errors[s].iter().zip(&data.weights[s]);
                squares += each.map(|(e, w)| w * e * e).sum::<f64>();
                rows += data.weights[s].iter().sum::<f64>();
            }
            let noise = (squares / f64::max(rows, 1.0)).sqrt();
            out.filters
                .push(Whitening::plain(libm::hypot(noise, data.floor(k))));
            out.channel.extend(own.map(|_| k));
        }
        let seconds = data
            .problem
            .runs
            .iter()
            .map(|r| r.steps as f64)
            .sum::<f64>()
            * data.problem.dt_s;
        let rows = out.weights.iter().flatten().sum::<f64>() / data.channels.len().max(1) as f64;
        out.count = (2.0 * seconds / f64::max(rows, 1.0)).min(1.0);
        out
    }

    /// The same noise, with what healthy joints differ by along these directions.
    pub(super) fn with_healthy(mut self, directions: &[Direction]) -> Self {
        let scaled = |d: &Direction| -> Errors {
            let white = self.white(&d.errors);
            let all = white.into_iter();
            all.map(|s| s.into_iter().map(|x| d.healthy * x).collect())
                .collect()
        };
        let own = directions.iter().filter(|d| d.healthy > 0.0);
        let healthy: Vec<Errors> = own.map(scaled).collect();
        let n = healthy.len();
        let mut a = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let p = self.count * inner(&healthy[i], &healthy[j], &self.weights);
                a[i * n + j] = p;
                a[j * n + i] = p;
            }
            a[i * n + i] += 1.0;
        }
        self.factor = cholesky(&a, n);
        self.healthy = healthy;
        self
    }

    /// Logarithm of the likelihood of the errors that the noise was made from, beside their squares and a constant; rows
    /// count as they do in the squares.
    pub(super) fn log_likelihood(&self) -> f64 {
        let rows = self.weights.iter().zip(&self.channel);
        let own: f64 = rows
            .map(|(w, k)| w.iter().sum::<f64>() * libm::log(self.filters[*k].noise))
            .sum();
        -self.count * own - 0.5 * log_determinant(&self.factor, self.healthy.len())
    }

    /// The same of errors as large as the noise: what a set can reach that leaves no more.
    pub(super) fn reach(&self) -> f64 {
        let rows: f64 = self.weights.iter().flatten().sum();
        self.log_likelihood() - 0.5 * self.count * rows
    }

    pub(super) fn white(&self, errors: &Errors) -> Errors {
        errors
            .iter()
            .zip(&self.channel)
            .map(|(e, k)| self.filters[*k].apply(e))
            .collect()
    }

    /// Weights of rows around white errors: large ones count linearly.
    pub(super) fn weights(&self, white: &Errors) -> Errors {
        let row = |(w, z): (&f64, &f64)| w * HUBER / z.abs().max(HUBER);
        let all = self.weights.iter().zip(white);
        all.map(|(w, z)| w.iter().zip(z).map(row).collect())
            .collect()
    }

    /// White errors with what of them healthy joints may differ by.
    pub(super) fn seen(&self, white: Errors, weights: &Errors) -> Seen {
        let along = self.along(&white, weights);
        Seen { white, along }
    }

    /// How much of one direction another one holds: the coefficient of its regression.
    pub(super) fn share(&self, of: &Errors, along: &Errors) -> f64 {
        let square = inner(along, along, &self.weights);
        inner(of, along, &self.weights) / square.max(f64::MIN_POSITIVE)
    }

    fn along(&self, white: &Errors, weights: &Errors) -> Vec<f64> {
        let each = self.healthy.iter();
        let mut along: Vec<f64> = each
            .map(|d| self.count * inner(d, white, weights))
            .collect();
        forward(&self.factor, along.len(), &mut along);
        along
    }

    /// Squares of whitened errors that healthy joints do not differ by, large ones linearly, and the weights of rows.
    ///
    /// What healthy joints differ by is large where the errors are: it is taken out before errors count as large, or
    /// after, whichever leaves less.
    pub(super) fn left(&self, white: &Errors) -> (f64, Errors) {
        let weights = self.weights(white);
        let all = self.count * self.huber(white);
        if self.healthy.is_empty() {
            return (all, weights);
        }
        let along = self.along(white, &weights);
        let after = all - dot(&along, &along);
        let mut along = self.along(white, &self.weights);
        backward(&self.factor, along.len(), &mut along);
        let mut rest = white.clone();
        for (d, c) in self.healthy.iter().zip(&along) {
            for (r, d) in rest.iter_mut().zip(d) {
                r.iter_mut().zip(d).for_each(|(r, d)| *r -= c * d);
            }
        }
        let before = self.count * self.huber(&rest) + dot(&along, &along);
        if before < after {
            (before, self.weights(&rest))
        } else {
            (after, weights)
        }
    }

    fn huber(&self, white: &Errors) -> f64 {
        let row = |(w, z): (&f64, &f64)| {
            let z = z.abs();
            let square = if z > HUBER {
                HUBER * (2.0 * z - HUBER)
            } else {
                z * z
            };
            w * square
        };
        let series = |(w, z): (&Vec<f64>, &Vec<f64>)| w.iter().zip(z).map(row).sum::<f64>();
        self.weights.iter().zip(white).map(series).sum()
    }

    /// Product of two directions where rows have these weights.
    pub(super) fn product(&self, a: &Seen, b: &Seen, weights: &Errors) -> f64 {
        self.count * inner(&a.white, &b.white, weights) - dot(&a.along, &b.along)
    }
}

fn inner(a: &Errors, b: &Errors, weights: &Errors) -> f64 {
    let series = a.iter().zip(b).zip(weights);
    series.map(|((a, b), w)| weighted_dot(w, a, b)).sum()
}
