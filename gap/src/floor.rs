//! How well the hardware repeats itself, and how exact each channel is.

use crate::joint::data::CHANNELS;
use crate::joint::{Channel, Problem, RunData};
use crate::math;

/// Noise of the channels.
#[derive(Debug, Clone, PartialEq)]
pub struct Floor {
    /// Fast noise and resolution of each channel; NaN where not measured.
    pub noise: [f64; CHANNELS],
    /// Root mean square error that rounding to the column's own steps makes; 0 where no steps are seen.
    pub resolution: [f64; CHANNELS],
    /// Spread of repeated runs around their mean; `None` without repeats.
    pub repeat: Option<[f64; CHANNELS]>,
    /// Standard deviation of each channel.
    pub spread: [f64; CHANNELS],
}

/// Error that two honest simulators of one law may have between them, as a share of a signal's spread: steps, hold
/// instants, contact of dry friction. Measured between this simulator at 0.5 and 2 ms steps.
const MODEL_ERROR: f64 = 0.0005;
/// The same for duty and the like, which jump at every set-point edge.
const MODEL_ERROR_DUTY: f64 = 0.005;
/// The same for current and effort, which hang on the acceleration. Measured against an emulated motor with a 1 kHz loop.
const MODEL_ERROR_CURRENT: f64 = 0.05;

fn values(run: &RunData, channel: usize) -> Vec<f64> {
    run.samples
        .iter()
        .filter(|s| s.enabled)
        .map(|s| s.measured[channel])
        .filter(|x| x.is_finite())
        .collect()
}

/// Noise from second differences (immune to slow motion) and from the resolution of the column.
fn fast_noise(problem: &Problem, channel: usize) -> f64 {
    let mut second = Vec::new();
    let mut quanta = Vec::new();
    for run in &problem.runs {
        let v = values(run, channel);
        second.extend(v.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).abs()));
        quanta.push(files::dataset::quantum(&v));
    }
    // Median of |N(0, 6 s^2)| is 0.6745 sqrt(6) s.
    let gauss = math::median(&second) / (0.6745 * 6.0_f64.sqrt());
    let step = math::median(&quanta) / 12.0_f64.sqrt();
    // A column of many digits has no visible resolution; its smallest step is then no noise.
    if step > 3.0 * gauss && gauss > 0.0 {
        gauss
    } else {
        libm::hypot(gauss, step)
    }
}

/// Rounding error of a column whose values stand on a lattice; 0 for one of many digits.
fn resolution(problem: &Problem, channel: usize) -> f64 {
    // Share of the values that must stand on the lattice, and how near, in steps: numbers are printed with few digits.
    const ON: f64 = 0.95;
    const NEAR: f64 = 0.1;
    let mut sizes = Vec::new();
    for run in &problem.runs {
        let v = values(run, channel);
        let step = files::dataset::quantum(&v);
        let Some(first) = v.first().filter(|_| step > 0.0) else {
            continue;
        };
        let on = |x: &&f64| {
            let steps = (**x - first) / step;
            (steps - steps.round()).abs() < NEAR
        };
        let share = v.iter().filter(on).count() as f64 / v.len() as f64;
        sizes.push(if share > ON {
            step / 12.0_f64.sqrt()
        } else {
            0.0
        });
    }
    math::median(&sizes)
}

fn time_s(run: &RunData, row: usize, dt_s: f64) -> f64 {
    (run.samples[row].step as f64 + run.samples[row].part) * dt_s
}

/// Channel of `run` at the instants of `other`'s rows, by linear interpolation.
fn difference(a: &RunData, b: &RunData, channel: usize, dt_s: f64) -> Vec<f64> {
    let known: Vec<(f64, f64)> = (0..b.samples.len())
        .filter(|i| b.samples[*i].measured[channel].is_finite())
        .map(|i| (time_s(b, i, dt_s), b.samples[i].measured[channel]))
        .collect();
    let mut out = Vec::new();
    let mut k = 0;
    for (i, s) in a.samples.iter().enumerate() {
        let m = s.measured[channel];
        let t = time_s(a, i, dt_s);
        while k + 1 < known.len() && known[k + 1].0 < t {
            k += 1;
        }
        if !m.is_finite() || !s.enabled || k + 1 >= known.len() || known[k].0 > t {
            continue;
        }
        let (l, r) = (known[k], known[k + 1]);
        let y = l.1 + (r.1 - l.1) * ((t - l.0) / (r.0 - l.0).max(1e-12)).min(1.0);
        out.push(m - y);
    }
    out
}

/// Measures the floor of a data set.
#[must_use]
pub fn floor(problem: &Problem) -> Floor {
    let mut out = Floor {
        noise: [f64::NAN; CHANNELS],
        resolution: [0.0; CHANNELS],
        repeat: None,
        spread: [f64::NAN; CHANNELS],
    };
    let mut repeat = [f64::NAN; CHANNELS];
    for (c, repeat) in repeat.iter_mut().enumerate() {
        let all: Vec<f64> = problem.runs.iter().flat_map(|r| values(r, c)).collect();
        if all.len() < 3 {
            continue;
        }
        let m = math::mean(&all);
        out.spread[c] = math::rms(&all.iter().map(|x| x - m).collect::<Vec<_>>());
        out.resolution[c] = resolution(problem, c);
        // A coarse encoder hardly ever moves between two rows of a slow motion: that is no quiet one.
        out.noise[c] = fast_noise(problem, c).max(out.resolution[c]);
        let mut d = Vec::new();
        for (i, a) in problem.runs.iter().enumerate() {
            if let Some(b) = problem.runs[..i].iter().find(|b| b.repeat == a.repeat) {
                // The difference of two runs has twice the variance of one.
                d.push(math::rms(&difference(a, b, c, problem.dt_s)) / 2.0_f64.sqrt());
            }
        }
        if !d.is_empty() {
            // Repeats that a coarse encoder rounds alike repeat better than they are known.
            *repeat = math::mean(&d).max(out.resolution[c]);
            // What two recordings share is motion, however fast.
            out.noise[c] = out.noise[c].min(*repeat);
        }
    }
    if repeat[0].is_finite() {
        out.repeat = Some(repeat);
    }
    out
}

impl Floor {
    /// What a perfect model would still miss in `channel`: the spread of repeats, else the stated noise.
    #[must_use]
    pub fn of(&self, channel: usize) -> f64 {
        self.repeat
            .map_or(self.noise[channel], |r| r[channel].max(1e-12))
    }

    /// Tolerance of `channel` in the cost: noise and repeats, and what simulators may differ by.
    #[must_use]
    pub fn tolerance(&self, channel: usize) -> f64 {
        let share = match Channel::ALL[channel] {
            Channel::Position | Channel::Link => MODEL_ERROR,
            Channel::Current | Channel::Effort => MODEL_ERROR_CURRENT,
            _ => MODEL_ERROR_DUTY,
        };
        let s = share * self.spread[channel];
        libm::hypot(self.of(channel).max(self.noise[channel]), s).max(1e-9)
    }

    /// Weights of the cost: one over the tolerance of every measured channel.
    #[must_use]
    pub fn weights(&self) -> [f64; CHANNELS] {
        std::array::from_fn(|c| {
            if self.spread[c] > 0.0 {
                1.0 / self.tolerance(c)
            } else {
                0.0
            }
        })
    }

    /// Cost of a perfect model against averages of `count` recordings.
    #[must_use]
    pub fn cost(&self, count: f64) -> f64 {
        let one = |c: usize| {
            let (noise, fixed) = (self.of(c).max(self.noise[c]), self.resolution[c]);
            // Rounding is the same in every repeat and does not average away.
            let fixed = fixed.min(noise);
            let square = (noise * noise - fixed * fixed) / count + fixed * fixed;
            square / (self.tolerance(c) * self.tolerance(c))
        };
        (0..CHANNELS)
            .filter(|c| self.spread[*c] > 0.0)
            .map(one)
            .sum()
    }
}
