//! Weighted errors of a simulation against the rows of a recording, taken as the rows come.

use super::simd::{LANES, Lane};
use super::{Level, Sink, dispatch};
use crate::joint::data::{CHANNELS, RunData};
use crate::joint::param::Params;

/// How errors count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// One over the tolerance of each channel; 0 = not used.
    pub channels: [f64; CHANNELS],
    /// Weight of the run.
    pub share: f64,
    /// Beyond this many tolerances an error counts linearly (Huber), infinite = squares only.
    pub huber: f64,
}

/// One measured value that counts.
struct Value {
    channel: usize,
    /// Its place in a column.
    slot: usize,
    measured: f64,
}

/// The measured values of a run that count, row by row.
struct Plan {
    values: Vec<Value>,
    /// Where the values of each row begin.
    starts: Vec<usize>,
    scale: [f64; CHANNELS],
    weights: Weights,
}

impl Plan {
    fn new(run: &RunData, weights: Weights) -> Self {
        let used = |c: usize| weights.channels[c] > 0.0;
        let counts = |row: &crate::joint::Sample, c: usize| {
            used(c) && row.enabled && row.measured[c].is_finite()
        };
        let mut number = [0; CHANNELS];
        for row in &run.samples {
            for (c, n) in number.iter_mut().enumerate() {
                *n += usize::from(counts(row, c));
            }
        }
        // A column holds channel after channel.
        let mut next = [0; CHANNELS];
        for c in 1..CHANNELS {
            next[c] = next[c - 1] + number[c - 1];
        }
        let mut values = Vec::with_capacity(number.iter().sum());
        let mut starts = Vec::with_capacity(run.samples.len() + 1);
        for row in &run.samples {
            starts.push(values.len());
            for channel in (0..CHANNELS).filter(|c| counts(row, *c)) {
                values.push(Value {
                    channel,
                    slot: next[channel],
                    measured: row.measured[channel],
                });
                next[channel] += 1;
            }
        }
        starts.push(values.len());
        Self {
            values,
            starts,
            scale: number.map(|n| (weights.share / n.max(1) as f64).sqrt()),
            weights,
        }
    }
}

/// Weighted errors, a column per parameter set.
#[derive(Debug, Clone, PartialEq)]
pub struct Errors {
    rows: usize,
    count: usize,
    all: Vec<f64>,
}

impl Errors {
    /// Simulates `run` for all `sets` and takes the errors.
    #[must_use]
    pub fn new(run: &RunData, sets: &[Params], dt_s: f64, weights: Weights) -> Self {
        let plan = Plan::new(run, weights);
        let rows = plan.values.len();
        let mut all = vec![0.0; rows * sets.len()];
        let sink = &mut Scatter {
            plan: &plan,
            count: sets.len(),
            out: &mut all,
        };
        dispatch::walk(Level::detect(), run, sets, dt_s, sink);
        Self {
            rows,
            count: sets.len(),
            all,
        }
    }

    /// Columns without a row for `count` parameter sets.
    #[must_use]
    pub fn none(count: usize) -> Self {
        Self {
            rows: 0,
            count,
            all: Vec::new(),
        }
    }

    /// The columns in the order of the parameter sets.
    pub fn iter(&self) -> impl Iterator<Item = &[f64]> {
        (0..self.count).map(|k| &self.all[k * self.rows..][..self.rows])
    }
}

/// Writes the errors into the columns of the parameter sets.
struct Scatter<'a> {
    plan: &'a Plan,
    count: usize,
    out: &'a mut [f64],
}

impl Sink for Scatter<'_> {
    #[inline(always)]
    fn row<F: Lane>(&mut self, first: usize, at: usize, channels: &[F; CHANNELS]) {
        let plan = self.plan;
        let rows = plan.values.len();
        let lanes = LANES.min(self.count - first);
        for v in &plan.values[plan.starts[at]..plan.starts[at + 1]] {
            let c = v.channel;
            let r = (channels[c] - F::splat(v.measured)) * F::splat(plan.weights.channels[c]);
            let r = huber(r, plan.weights.huber) * F::splat(plan.scale[c]);
            for (lane, r) in r.put().0.iter().take(lanes).enumerate() {
                self.out[(first + lane) * rows + v.slot] = *r;
            }
        }
    }
}

/// Square root of the Huber loss, with the sign of `r`.
#[inline(always)]
fn huber<F: Lane>(r: F, limit: f64) -> F {
    let limit = F::splat(limit);
    let a = r.abs();
    let beyond = a.gt(limit);
    if !F::any(beyond) {
        return r;
    }
    let long = (limit * (a + a - limit)).max(F::zero()).sqrt();
    let signed = F::select(r.lt(F::zero()), -long, long);
    F::select(beyond, signed, r)
}
