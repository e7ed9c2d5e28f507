//! A joint's recording as errors of what was simulated, repeats averaged.

use files::dataset::{Manifest, Recording, Role, Signal};
use rayon::prelude::*;

use super::model::Point;
use crate::joint::data::CHANNELS;
use crate::joint::merge::alike;
use crate::joint::{Channel, Params, Problem, RunData, simulate_all};
use crate::watch::Stop;

/// Rate to which errors are averaged, Hz: what a joint's loop of 40 rad/s does is below a tenth of it.
const RATE_HZ: f64 = 100.0;

/// Horizons over which positions may be predicted, s, beside whole runs: from some rows to what joints' loops of 20 and
/// 5 rad/s take. A joint that swings by itself is out of step with a play of its set-points.
pub(super) const HORIZONS_S: [f64; 4] = [0.02, 0.05, 0.15, 0.5];

/// Errors by series: channel after channel, each run after run.
pub(super) type Errors = Vec<Vec<f64>>;

/// What is compared.
#[derive(Debug, Clone)]
pub(super) struct Data<'a> {
    /// The joint; its runs are averages of repeats.
    pub(super) problem: Problem,
    /// Channels that were measured, in their order.
    pub(super) channels: Vec<usize>,
    /// Channels whose sign was not recorded.
    absolute: [bool; CHANNELS],
    /// Rows that are averaged into one.
    pub(super) stride: usize,
    /// Share of the rows of an average that count, by series.
    pub(super) weights: Errors,
    /// Standard deviation of averages of repeats, by channel; `None` without repeats.
    repeated: Vec<Option<f64>>,
    /// The wish that the search ends.
    pub(super) stop: Stop<'a>,
}

/// Puts unsigned columns in the place of signed ones that are missing, where the unit is known.
fn unsigned(recordings: &mut [Recording], known_effort: bool) -> [bool; CHANNELS] {
    let pairs = [
        (Signal::Current, Signal::CurrentAbs, Channel::Current),
        (Signal::Effort, Signal::EffortAbs, Channel::Effort),
    ];
    let mut out = [false; CHANNELS];
    for (signed, plain, channel) in pairs {
        let has = |s: Signal| {
            recordings
                .iter()
                .any(|r| r.joint(0).is_some_and(|j| j.get(s).is_some()))
        };
        if has(signed) || !has(plain) || !known_effort {
            continue;
        }
        out[channel as usize] = true;
        for r in recordings.iter_mut() {
            let column = r.joint(0).and_then(|j| j.get(plain)).map(<[f64]>::to_vec);
            if let Some(j) = r.joint_mut(0) {
                j.set(signed, column);
            }
        }
    }
    out
}

/// Whether amperes and newton metres mean anything: something that has an effort was stated.
fn efforts_known(problem: &Problem) -> bool {
    let k = problem.known;
    k.stall.is_some() || k.inertia.is_some() || k.gravity.is_some()
}

fn of_fit(problem: &Problem) -> Vec<usize> {
    let usable = |r: &RunData| {
        r.role != Some(Role::Check)
            && r.command.len() > 1
            && r.samples
                .iter()
                .any(|s| s.enabled && s.measured[0].is_finite())
    };
    (0..problem.runs.len())
        .filter(|r| usable(&problem.runs[*r]))
        .collect()
}

impl<'a> Data<'a> {
    /// `None` without a run that has set-points and positions.
    pub(super) fn new(
        manifest: &Manifest,
        recordings: &[Recording],
        stop: Stop<'a>,
    ) -> Option<Self> {
        let mut recordings = recordings.to_vec();
        let stated = &manifest.bench;
        let effort = stated.inertia.is_some() || stated.max_effort.is_some();
        let absolute = unsigned(&mut recordings, effort);
        let problem = Problem::new(manifest, &recordings, 0)?;
        let fit = of_fit(&problem);
        if fit.is_empty() {
            return None;
        }
        let every = problem.clone();
        let problem = problem.merged(&fit);
        let known = efforts_known(&problem);
        let used = |c: &usize| {
            let has = |r: &RunData| r.samples.iter().any(|s| s.measured[*c].is_finite());
            let unit = ![Channel::Current as usize, Channel::Effort as usize].contains(c) || known;
            unit && problem.runs.iter().any(has)
        };
        let channels: Vec<usize> = (0..CHANNELS).filter(used).collect();
        let mut out = Self {
            absolute,
            ..Self::of(problem, channels, stop)
        };
        out.repeated = out
            .channels
            .iter()
            .map(|c| out.spread(&every, &fit, *c))
            .collect();
        Some(out)
    }

    /// A joint without repeats, of which these channels were measured.
    pub(super) fn of(problem: Problem, channels: Vec<usize>, stop: Stop<'a>) -> Self {
        let row_s = row_s(&problem);
        let mut out = Self {
            repeated: vec![None; channels.len()],
            problem,
            channels,
            absolute: [false; CHANNELS],
            stride: ((1.0 / RATE_HZ) / row_s + 1e-6).floor().max(1.0) as usize,
            weights: Vec::new(),
            stop,
        };
        out.weights = out.each(|run, channel| out.counts(run, channel));
        out
    }

    /// Share of the rows of each average that count.
    pub(super) fn counts(&self, run: &RunData, channel: usize) -> Vec<f64> {
        let share = |rows: &[crate::joint::Sample]| {
            let own = |s: &&crate::joint::Sample| s.enabled && s.measured[channel].is_finite();
            rows.iter().filter(own).count() as f64 / rows.len().max(1) as f64
        };
        run.samples.chunks(self.stride).map(share).collect()
    }

    /// The same with positions predicted over a horizon.
    pub(super) fn over(&self, horizon_s: f64) -> Self {
        let mut out = self.clone();
        predicted(&mut out.problem, horizon_s);
        out
    }

    /// The horizon over which positions are predicted, s.
    pub(super) fn horizon_s(&self) -> f64 {
        let first = self.problem.runs.first();
        first.map_or(f64::INFINITY, |r| r.horizon_s)
    }

    /// Spread of the averages of repeats.
    fn spread(&self, every: &Problem, fit: &[usize], channel: usize) -> Option<f64> {
        let (mut sum, mut n) = (0.0, 0.0);
        for mean in self.problem.runs.iter().filter(|r| r.count > 1.5) {
            let own = fit
                .iter()
                .map(|r| &every.runs[*r])
                .filter(|r| alike(mean, r));
            for run in own {
                for (a, b) in mean
                    .samples
                    .chunks(self.stride)
                    .zip(run.samples.chunks(self.stride))
                {
                    let of = |rows: &[crate::joint::Sample]| {
                        average(rows.iter().map(|s| s.measured[channel]))
                    };
                    let off = of(a) - of(b);
                    sum += off * off / (mean.count * (mean.count - 1.0));
                    n += 1.0 / mean.count;
                }
            }
        }
        (n > 0.0).then(|| (sum / n).sqrt())
    }

    /// What the recording itself leaves in channel number `k`: the spread of repeats, or without them the noise from
    /// second differences; with what two simulators differ by.
    pub(super) fn own_noise(&self, k: usize) -> f64 {
        let fast = || fast_noise(self.measured()[self.series(k)].iter());
        libm::hypot(self.repeated[k].unwrap_or_else(fast), self.floor(k))
    }

    fn each(&self, of: impl Fn(&RunData, usize) -> Vec<f64>) -> Errors {
        let one = |c: &usize| {
            self.problem
                .runs
                .iter()
                .map(|r| of(r, *c))
                .collect::<Vec<_>>()
        };
        self.channels.iter().flat_map(one).collect()
    }

    /// Runs of a channel: the series of channel number `k` of [`Self::channels`].
    pub(super) fn series(&self, k: usize) -> std::ops::Range<usize> {
        let n = self.problem.runs.len();
        k * n..(k + 1) * n
    }

    /// Measured values, averaged as errors are.
    pub(super) fn measured(&self) -> Errors {
        self.each(|run, channel| {
            run.samples
                .chunks(self.stride)
                .map(|rows| {
                    average(
                        rows.iter()
                            .filter(|s| s.enabled)
                            .map(|s| s.measured[channel]),
                    )
                })
                .collect()
        })
    }

    /// Errors at every point.
    pub(super) fn errors(&self, points: &[Point]) -> Vec<Errors> {
        let sets: Vec<Params> = points.iter().map(|p| p.params).collect();
        let by_run: Vec<Vec<Vec<Vec<f64>>>> = self
            .problem
            .runs
            .par_iter()
            .map(|run| {
                if self.stop.asked() {
                    return vec![self.nothing(run); points.len()];
                }
                let traces = simulate_all(run, &sets, self.problem.dt_s);
                traces
                    .iter()
                    .zip(points)
                    .map(|(trace, point)| self.of_run(run, trace, point))
                    .collect()
            })
            .collect();
        (0..points.len())
            .map(|p| {
                (0..self.channels.len())
                    .flat_map(|k| by_run.iter().map(move |r| r[p][k].clone()))
                    .collect()
            })
            .collect()
    }

    /// Errors of a run that is not simulated any more.
    pub(super) fn nothing(&self, run: &RunData) -> Errors {
        let rows = run.samples.len().div_ceil(self.stride);
        vec![vec![0.0; rows]; self.channels.len()]
    }

    /// Errors of a run by channel.
    pub(super) fn of_run(&self, run: &RunData, trace: &[[f64; CHANNELS]], point: &Point) -> Errors {
        let one = |c: &usize| {
            let error = |(s, y): (&crate::joint::Sample, &[f64; CHANNELS])| {
                let simulated = point.columns[*c] * y[*c];
                let shown = if self.absolute[*c] {
                    simulated.abs()
                } else {
                    simulated
                };
                if s.enabled {
                    s.measured[*c] - shown
                } else {
                    f64::NAN
                }
            };
            let all: Vec<f64> = run.samples.iter().zip(trace).map(error).collect();
            all.chunks(self.stride)
                .map(|rows| average(rows.iter().copied()))
                .collect()
        };
        self.channels.iter().map(one).collect()
    }

    /// What two simulators of one law differ by in a channel, one standard deviation: steps, instants of holding, when
    /// a row was read (as in [`crate::floor`]: shares of the signal's spread).
    pub(super) fn floor(&self, k: usize) -> f64 {
        let share = match self.channels[k] {
            c if c == Channel::Position as usize || c == Channel::Link as usize => 5e-4,
            // Whether a row was taken before or after a set-point came is not known.
            c if c == Channel::Duty as usize || c == Channel::Applied as usize => 5e-3,
            c if c == Channel::BusVoltage as usize => 1e-3,
            _ => 0.02,
        };
        let all: Vec<f64> = self.measured()[self.series(k)]
            .iter()
            .flatten()
            .copied()
            .collect();
        let middle = crate::math::mean(&all);
        let spread: Vec<f64> = all.iter().map(|x| x - middle).collect();
        share * crate::math::rms(&spread)
    }
}

/// Noise from second differences of some series.
pub(super) fn fast_noise<'a>(all: impl Iterator<Item = &'a Vec<f64>>) -> f64 {
    let second = |m: &'a Vec<f64>| m.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).abs());
    let all: Vec<f64> = all.flat_map(second).collect();
    // Median of |N(0, 6 s^2)| is 0.6745 sqrt(6) s.
    crate::math::median(&all) / (0.6745 * 6.0_f64.sqrt())
}

/// Lets measured positions correct every run, so that rows are predicted over a horizon.
pub(super) fn predicted(problem: &mut Problem, horizon_s: f64) {
    let all = problem.runs.iter_mut();
    all.for_each(|r| r.horizon_s = horizon_s);
}

/// Mean of the numbers; 0 where there is none.
pub(super) fn average(all: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for x in all.filter(|x| x.is_finite()) {
        sum += x;
        n += 1.0;
    }
    if n > 0.0 { sum / n } else { 0.0 }
}

/// Median time between rows that hold a position, s.
pub(super) fn row_s(problem: &Problem) -> f64 {
    let gaps: Vec<f64> = problem
        .runs
        .iter()
        .flat_map(|r| {
            let with = r.samples.iter().filter(|s| s.measured[0].is_finite());
            let t: Vec<f64> = with
                .map(|s| (s.step as f64 + s.part) * problem.dt_s)
                .collect();
            t.windows(2).map(|w| w[1] - w[0]).collect::<Vec<_>>()
        })
        .collect();
    crate::math::median(&gaps).max(1e-5)
}
