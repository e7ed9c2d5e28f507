//! The encoder given the set-points: the angle less that of the nominal servo, which is stable and forgets its
//! start in 0.3 s.
//!
//! What is measured of the joint stands on one side only. With the measured angle in the loop its noise would be a
//! regressor, and a late encoder would explain the noise (seen: 100 times the evidence of any planted cause).

use crate::evidence::block::{Column, Raw, Segment, Site};
use crate::vocabulary::{Effect, Stage};

use super::super::data::Track;
use super::super::nominal::Nominal;

/// Step of the integrals, s: the drivers' own is 1 ms, the recordings' 5 to 50 ms.
const STEP_S: f64 = 0.002;
/// Least length of a prediction, s.
const HORIZON_S: f64 = 0.04;

/// What two simulators of one servo differ by from one angle to the next: rad, and share of the angle's spread. The
/// old servo of the diagnosis and the emulated driver of `hil-sim`, both at their own steps, differ by 0.2 mrad on
/// 0.8 rad.
const LEAST_RAD: f64 = 1.0e-4;
const SHARE: f64 = 5.0e-4;

/// Delays that are played, s; a factor of 1.4 apart where delays of real buses lie.
const DELAYS_S: [f64; 10] = [
    0.006, 0.01, 0.015, 0.022, 0.032, 0.045, 0.065, 0.095, 0.14, 0.2,
];
/// Time constants that are played, s.
const LAGS_S: [f64; 8] = [0.008, 0.014, 0.024, 0.04, 0.065, 0.11, 0.18, 0.3];
/// Half widths of dead bands that are played, rad.
const BANDS_RAD: [f64; 9] = [0.002, 0.0035, 0.006, 0.01, 0.017, 0.03, 0.05, 0.08, 0.13];
/// Speed limits that are played, rad/s; a factor of 1.2 apart.
const SPEEDS_RAD_S: [f64; 21] = [
    0.06, 0.072, 0.086, 0.104, 0.124, 0.149, 0.179, 0.215, 0.258, 0.31, 0.37, 0.45, 0.53, 0.64,
    0.77, 0.92, 1.11, 1.33, 1.6, 1.92, 2.3,
];
/// Steps of coarse set-points that are played, rad: 4 % apart, because steps of another size fall out of time after
/// a few.
const COARSEST_RAD: f64 = 0.25;
const FINEST_RAD: f64 = 0.004;
const APART: f64 = 1.04;
/// Steps that are kept of them.
const KEPT: usize = 3;

/// What one run of a joint holds.
pub(in crate::whole) struct Input<'a> {
    /// Set-points in force.
    pub(in crate::whole) command: Track,
    /// Encoder.
    pub(in crate::whole) position: &'a Track,
    /// Torque that the joint bears, N m, on a grid of `load_step_s`; empty where it is not known.
    pub(in crate::whole) load_nm: &'a [f64],
    /// Step of that grid, s.
    pub(in crate::whole) load_step_s: f64,
    /// Torque from which the motor is at its limit, N m, and the measured torque.
    pub(in crate::whole) limit: Option<(f64, &'a Track)>,
}

/// What is known of a joint's servo and its set-points.
pub(in crate::whole) struct Known {
    pub(in crate::whole) nominal: Nominal,
    /// Between which delays set-points come in force, s; `None` where nothing tells.
    pub(in crate::whole) late_s: Option<[f64; 2]>,
    /// The set-points are those that the driver applied.
    pub(in crate::whole) applied: bool,
    /// Tolerance of the largest speed, as a share of it.
    pub(in crate::whole) speed_tolerance: f64,
    /// The echo tells clock and rounding.
    pub(in crate::whole) echoed: bool,
    /// Time between rows, s.
    pub(in crate::whole) row_s: f64,
}

/// A run on the grid of the simulation.
struct Grid {
    /// Encoder and load.
    q: Vec<f64>,
    load: Vec<f64>,
    /// Whether the motor is at its limit.
    limited: Vec<bool>,
    /// Steps between compared angles.
    stride: usize,
    /// Set-points as steps in time.
    command: Track,
    from_s: f64,
}

/// The servo: `v = clamp(P (c - q))` with what may be different about it. Neutral values are those of the nominal
/// model.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Law {
    gain: f64,
    most: f64,
    /// Gain and speed limit as shares of these.
    ratio: f64,
    share: f64,
    offset: f64,
    scale: f64,
    delay_s: f64,
    clock: f64,
    step: f64,
    soft_band: f64,
    hard_band: f64,
    feedback_delay_s: f64,
    lag_s: f64,
    droop: f64,
    /// Drift of the zero, rad/s.
    drift: f64,
    /// Gain for positive errors over that for negative ones, less one.
    lopsided: f64,
}

impl Law {
    fn error(&self, c: f64, q: f64) -> f64 {
        let mut e = c * self.scale + self.offset - q;
        if e.abs() < self.hard_band {
            e = 0.0;
        }
        e.signum() * (e.abs() - self.soft_band).max(0.0)
    }
}

impl Grid {
    fn new(input: &Input<'_>) -> Option<Self> {
        let q = input.position;
        let period = q.period_s();
        let stride = ((HORIZON_S.max(period)) / STEP_S).round() as usize;
        let from_s = q.t_s[0];
        let end_s = q.t_s[q.t_s.len() - 1];
        let n = ((end_s - from_s) / STEP_S) as usize;
        if n < 100 * stride {
            return None;
        }
        let at = |i: usize| from_s + i as f64 * STEP_S;
        let load = |i: usize| {
            let place = (at(i) / input.load_step_s) as usize;
            input.load_nm.get(place).copied().unwrap_or(0.0)
        };
        let limited = |i: usize| {
            let full = |(limit, effort): (f64, &Track)| effort.at(at(i)).abs() > limit;
            input.limit.is_some_and(full)
        };
        Some(Self {
            q: (0..n).map(|i| q.at(at(i))).collect(),
            load: (0..n).map(load).collect(),
            limited: (0..n).map(limited).collect(),
            stride,
            command: input.command.clone(),
            from_s,
        })
    }

    /// Angles at the compared instants.
    fn compared(&self, q: &[f64]) -> Vec<f64> {
        q.iter().step_by(self.stride).copied().collect()
    }

    /// Angle under a law, from the measured start; the loop is stable, so that a wrong start is forgotten.
    fn simulated(&self, law: &Law) -> Vec<f64> {
        let h = STEP_S;
        let blend = if law.lag_s > 0.0 {
            1.0 - libm::exp(-h / law.lag_s)
        } else {
            1.0
        };
        let back = (law.feedback_delay_s / h).round() as usize;
        let (times, values) = (&self.command.t_s, &self.command.v);
        let mut cursor = 0;
        let mut out = Vec::with_capacity(self.q.len());
        let (gain, most) = (law.gain * law.ratio, law.most * law.share);
        let (mut q, mut v) = (self.q[0], 0.0);
        for i in 0..self.q.len() {
            let t = (self.from_s + i as f64 * h) * law.clock - law.delay_s;
            while cursor + 1 < times.len() && times[cursor + 1] <= t {
                cursor += 1;
            }
            let mut c = values[cursor];
            if law.step > 0.0 {
                c = (c / law.step).round() * law.step;
            }
            out.push(q);
            let seen = out[i.saturating_sub(back)];
            // Half a step of the loop's own answer makes the explicit law second order.
            let error = law.error(c + law.drift * i as f64 * h, seen);
            let side = if error > 0.0 { 1.0 + law.lopsided } else { 1.0 };
            let wanted = side * gain * error / (1.0 + 0.5 * gain * h);
            v += blend * (wanted.clamp(-most, most) - v);
            q += h * (v - law.droop * self.load[i]);
        }
        out
    }

    /// Weight of each compared angle: none at the start, at the motor's limit and while a joint comes back from there.
    fn weights(&self) -> Vec<f64> {
        const AFTER: usize = (0.5 / STEP_S) as usize;
        let mut left = AFTER;
        let free: Vec<bool> = self
            .limited
            .iter()
            .map(|l| {
                left = if *l { AFTER } else { left.saturating_sub(1) };
                left == 0
            })
            .collect();
        let one = |f: &bool| f64::from(u8::from(*f));
        free.iter().step_by(self.stride).map(one).collect()
    }
}

/// Shares of lost set-points between which a loss is tried: one in a hundred is a damaged frame now and then.
const LEAST_LOST: f64 = 0.005;
const MOST_LOST: f64 = 0.5;
/// Logarithm of the likelihood ratio from which a set-point counts as lost: one of 240 in a run by chance at 3.
const LOST: f64 = 6.0;
/// Time after a set-point in which its loss shows, s.
const SHOWS_S: f64 = 0.3;

impl Grid {
    /// What the set-points that were lost change at the compared angles, how many they are, and of how many.
    fn lost(&self, law: &Law) -> (Vec<f64>, f64, f64) {
        let plain = self.simulated(law);
        let left: Vec<f64> = self.q.iter().zip(&plain).map(|(q, p)| q - p).collect();
        let mut jumps: Vec<f64> = left
            .windows(self.stride + 1)
            .map(|w| (w[self.stride] - w[0]).abs())
            .collect();
        jumps.sort_by(f64::total_cmp);
        // Median absolute deviation of the change of the errors, as that of a normal distribution.
        let noise = jumps.get(jumps.len() / 2).map_or(0.0, |m| m / 0.6745) + LEAST_RAD;
        let gain = law.gain * law.ratio;
        let span = (SHOWS_S / STEP_S) as usize;
        let mut out = vec![0.0; self.q.len()];
        let (mut missed, mut sent) = (0.0, 0.0);
        let events: Vec<(f64, f64)> = self
            .command
            .t_s
            .iter()
            .copied()
            .zip(self.command.v.iter().copied())
            .collect();
        for e in events.windows(3) {
            let [before, now, next] = [e[0], e[1], e[2]];
            let late = next.0 - now.0;
            let from = (((now.0 + law.delay_s - self.from_s) / STEP_S).max(0.0)) as usize;
            sent += 1.0;
            // The angle stays behind while the set-point is missing, and comes back with the loop's rate.
            let jump = (before.1 - now.1) * law.scale;
            let shape = |i: usize| {
                let t = i as f64 * STEP_S;
                let held = libm::exp(-gain * (t - late).max(0.0));
                jump * (1.0 - libm::exp(-gain * t.min(late))) * held
            };
            let end = (from + span).min(self.q.len());
            if end <= from || jump.abs() < noise {
                continue;
            }
            let rows = (from..end).step_by(self.stride);
            let level = left[from.min(left.len() - 1)];
            let score: f64 = rows
                .map(|i| {
                    let u = shape(i - from);
                    ((left[i] - level) * u - 0.5 * u * u) / (noise * noise)
                })
                .sum();
            if score > LOST {
                missed += 1.0;
                for (i, slot) in out[from..end].iter_mut().enumerate() {
                    *slot += shape(i);
                }
            }
        }
        (self.compared(&out), missed, sent)
    }
}

fn less(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// What a column changes about the servo; the coefficient of a played shape is the share of its size.
#[derive(Debug, Clone, Copy)]
enum Change {
    Offset,
    Scale,
    Gain(f64),
    Droop,
    Delay(f64),
    Clock,
    Step(f64),
    SoftBand(f64),
    HardBand(f64),
    FeedbackDelay(f64),
    Lag(f64),
    /// Speed limit, as a share of the nominal one that is lost.
    Limit(f64),
    Drift,
    Lopsided,
}

impl Change {
    /// The law with `by` of the change.
    fn on(self, mut law: Law, by: f64) -> Law {
        match self {
            Self::Offset => law.offset += by,
            Self::Scale => law.scale += by,
            Self::Gain(size) => law.ratio = (law.ratio + size * by).max(0.05),
            Self::Droop => law.droop += by,
            Self::Delay(size) => law.delay_s += size * by,
            Self::Clock => law.clock += by,
            Self::Step(size) => law.step = (law.step + size * by).max(0.0),
            Self::SoftBand(size) => law.soft_band = (law.soft_band + size * by).max(0.0),
            Self::HardBand(size) => law.hard_band = (law.hard_band + size * by).max(0.0),
            Self::FeedbackDelay(size) => {
                law.feedback_delay_s = (law.feedback_delay_s + size * by).max(0.0);
            }
            Self::Lag(size) => law.lag_s = (law.lag_s + size * by).max(0.0),
            Self::Drift => law.drift += by,
            Self::Lopsided => law.lopsided += by,
            Self::Limit(size) => law.share = (law.share - size * by).max(0.01),
        }
        law
    }
}

/// A column and what it changes; `step` is the coefficient that is played where the column is not in the law yet.
struct Shape {
    column: Column,
    change: Change,
    step: f64,
}

fn shape(column: Column, change: Change, step: f64) -> Shape {
    Shape {
        column,
        change,
        step,
    }
}

fn shapes(known: &Known) -> Vec<Shape> {
    let mut out = conventions(known);
    transport(known, &mut out);
    driver(known, &mut out);
    out
}

fn conventions(known: &Known) -> Vec<Shape> {
    let tolerance = known.nominal.gain_tolerance.max(0.01);
    let speed = known.speed_tolerance.max(0.01);
    let mut out = vec![
        shape(
            Column::linear(Effect::JointOffset, "offset_rad", 0.0, 0.1).with_slack(0.001),
            Change::Offset,
            0.01,
        ),
        shape(
            Column::linear(Effect::JointScale, "ratio", 1.0, 0.15).with_slack(0.002),
            Change::Scale,
            0.01,
        ),
        shape(
            Column::linear(Effect::LoopGain, "ratio", 1.0, 0.5).with_slack(tolerance),
            Change::Gain(1.0),
            0.05,
        ),
        // Which of its own ticks a driver answers in, and when a row is taken.
        shape(
            Column::nuisance(0.5 * known.row_s.max(0.004)),
            Change::FeedbackDelay(1.0),
            0.01,
        ),
        // Speed lost per torque: a servo of another engine is not infinitely stiff.
        shape(Column::nuisance(0.03), Change::Droop, 0.01),
    ];
    for (i, size) in [-0.6, -0.4, -0.2, 0.3, 0.7, 1.5].into_iter().enumerate() {
        let ratio = Column::played(Effect::LoopGain, "ratio", 1.0, 1.0 + size, 1 + i);
        out.push(shape(ratio, Change::Gain(size), 1.0));
    }
    // Within its tolerances a speed limit is no effect.
    for tolerances in [-1.0, 1.0, 2.0] {
        let size = tolerances * speed;
        out.push(shape(Column::nuisance(1.0), Change::Limit(size), 1.0));
    }
    out
}

fn transport(known: &Known, out: &mut Vec<Shape>) {
    // A set-point acts at some time between two rows.
    let slack = 0.6 * known.row_s.max(0.002);
    out.push(shape(Column::nuisance(slack), Change::Delay(1.0), 0.004));
    if known.applied {
        return;
    }
    let delays: Vec<f64> = match known.late_s {
        None => DELAYS_S.to_vec(),
        Some([low, high]) if high > 0.0 => vec![0.5 * (low + high)],
        Some(_) => Vec::new(),
    };
    for (i, d) in delays.into_iter().enumerate() {
        let column = Column::played(Effect::Latency, "delay_s", 0.0, d, i);
        out.push(shape(column, Change::Delay(d), 1.0));
    }
    if !known.echoed {
        let column = Column::linear(Effect::ClockSkew, "ratio", 1.0, 0.005);
        let column = column.with_slack(5e-5).of_robot();
        out.push(shape(column, Change::Clock, 0.002));
    }
}

fn driver(known: &Known, out: &mut Vec<Shape>) {
    for (i, w) in BANDS_RAD.into_iter().enumerate() {
        let column = |s| Column::played(Effect::Deadband, "half_width_rad", 0.0, w, s);
        out.push(shape(column(2 * i), Change::SoftBand(w), 1.0));
        out.push(shape(column(2 * i + 1), Change::HardBand(w), 1.0));
    }
    for (i, d) in DELAYS_S.into_iter().enumerate().take(8) {
        let column = Column::played(Effect::FeedbackDelay, "delay_s", 0.0, d, i);
        out.push(shape(column, Change::FeedbackDelay(d), 1.0));
    }
    for (i, lag) in LAGS_S.into_iter().enumerate() {
        let column = Column::played(Effect::MotorLag, "time_constant_s", 0.0, lag, i);
        out.push(shape(column, Change::Lag(lag), 1.0));
    }
    out.push(shape(
        Column::open(0, 0.005).with_slack(1e-4),
        Change::Drift,
        0.001,
    ));
    out.push(shape(
        Column::open(1, 0.3).with_slack(0.02),
        Change::Lopsided,
        0.1,
    ));
    let most = known.nominal.max_speed_rad_s;
    let within = 1.0 - 3.0 * known.speed_tolerance;
    let limits = SPEEDS_RAD_S.into_iter().enumerate();
    for (i, limit) in limits.filter(|s| s.1 < within * most) {
        let column = Column {
            prior: [1.0, 0.1],
            ..Column::played(Effect::VelocityLimit, "limit_rad_s", most, limit, i)
        };
        out.push(shape(column, Change::Limit(1.0 - limit / most), 1.0));
    }
}

/// Spread of the angle, rad.
fn spread_rad(grids: &[Grid]) -> f64 {
    let mut all = Vec::new();
    for g in grids {
        let mean = crate::math::mean(&g.q);
        all.extend(g.q.iter().map(|q| q - mean));
    }
    crate::math::rms(&all)
}

/// Coarse set-points: the steps that explain most of the errors, by themselves.
fn steps_rad(grids: &[Grid], base: Law) -> Vec<f64> {
    let mut scored: Vec<(f64, f64)> = Vec::new();
    let plain: Vec<Vec<f64>> = grids.iter().map(|g| g.simulated(&base)).collect();
    let mut step = FINEST_RAD;
    while step < COARSEST_RAD {
        let (mut xy, mut xx) = (0.0, 1e-12);
        for (g, plain) in grids.iter().zip(&plain) {
            let x = less(&g.simulated(&Law { step, ..base }), plain);
            for ((x, q), p) in x.iter().zip(&g.q).zip(plain) {
                xy += x * (q - p);
                xx += x * x;
            }
        }
        scored.push((if xy > 0.0 { xy * xy / xx } else { 0.0 }, step));
        step *= APART;
    }
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored.iter().take(KEPT).map(|s| s.1).collect()
}

/// Set-points at the instants of the control tick, where rows show each of them late by a part of a row.
pub(in crate::whole) fn regular(track: Track) -> Track {
    let tick_s = 1.0 / physics::CONTROL_RATE_HZ;
    let row_s = track.period_s();
    let mut events: Vec<(f64, f64)> = Vec::new();
    for (t, v) in track.t_s.iter().zip(&track.v) {
        if events.last().is_none_or(|l| l.1 != *v) {
            events.push((*t, *v));
        }
    }
    let phases: Vec<f64> = events.iter().skip(1).map(|e| e.0 / tick_s).collect();
    let Some(first) = phases.first().copied() else {
        return track;
    };
    // Distance of each event to the ticks through the first one; the earliest is the least late.
    let off: Vec<f64> = phases
        .iter()
        .map(|p| (p - first) - (p - first).round())
        .collect();
    let [low, high] = [
        crate::math::quantile(&off, 0.0),
        crate::math::quantile(&off, 1.0),
    ];
    if (high - low) * tick_s > 1.05 * row_s || row_s >= tick_s {
        return track;
    }
    let phase = first + low;
    let mut out = Track::default();
    for (t, v) in events {
        let tick = ((t / tick_s - phase) + 1e-6).floor();
        out.t_s.push(((tick + phase) * tick_s).max(0.0));
        out.v.push(v);
    }
    out
}

/// The block of joint `joint` around the coefficients `start`; `None` without a run that is long enough.
pub(in crate::whole) fn raw(
    joint: usize,
    inputs: &[Input<'_>],
    known: &Known,
    start: &[(usize, f64)],
) -> Option<Raw> {
    let grids: Vec<Grid> = inputs.iter().filter_map(Grid::new).collect();
    let base = Law {
        gain: known.nominal.gain_per_s,
        most: known.nominal.max_speed_rad_s,
        ratio: 1.0,
        share: 1.0,
        offset: 0.0,
        scale: 1.0,
        delay_s: 0.0,
        clock: 1.0,
        step: 0.0,
        soft_band: 0.0,
        hard_band: 0.0,
        feedback_delay_s: 0.0,
        lag_s: 0.0,
        droop: 0.0,
        drift: 0.0,
        lopsided: 0.0,
    };
    let mut all = shapes(known);
    if !known.echoed && !known.applied {
        for (i, step) in steps_rad(&grids, base).into_iter().enumerate() {
            let column = Column {
                prior: [1.0, 0.05],
                ..Column::played(Effect::Quantisation, "step_rad", 0.0, step, i)
            };
            all.push(shape(column, Change::Step(step), 1.0));
        }
    }
    let heard = known.echoed || known.applied;
    let there = start
        .iter()
        .fold(base, |law, (c, by)| all[*c].change.on(law, *by));
    let mut segments = Vec::new();
    let lost: Vec<(Vec<f64>, f64, f64)> = grids.iter().map(|g| g.lost(&there)).collect();
    let [missed, sent] = [1, 2].map(|i| {
        lost.iter()
            .map(|l| if i == 1 { l.1 } else { l.2 })
            .sum::<f64>()
    });
    let share = missed / sent.max(1.0);
    let loses = !heard && (LEAST_LOST..MOST_LOST).contains(&share);
    for (grid, lost) in grids.iter().zip(&lost) {
        let plain = grid.compared(&grid.simulated(&there));
        let column = |(c, s): (usize, &Shape)| -> Vec<f64> {
            // What is in the law already is taken away, so that the errors with and without it are as they are
            // played; another shape of its effect stands in its place.
            let within = start.iter().find(|x| x.0 == c && x.1.abs() > 1e-9);
            let step = within.map_or(s.step, |x| -x.1);
            let rivals = start
                .iter()
                .filter(|x| within.is_none() && all[x.0].column.meaning == s.column.meaning);
            let from = rivals.fold(there, |law, (c, by)| all[*c].change.on(law, -by));
            let plain = if from == there {
                plain.clone()
            } else {
                grid.compared(&grid.simulated(&from))
            };
            let moved = grid.compared(&grid.simulated(&s.change.on(from, step)));
            less(&moved, &plain).iter().map(|x| x / step).collect()
        };
        let mut x: Vec<Vec<f64>> = all.iter().enumerate().map(column).collect();
        if loses {
            x.push(lost.0.clone());
        }
        let mut y = less(&grid.compared(&grid.q), &plain);
        for (c, by) in start {
            y.iter_mut().zip(&x[*c]).for_each(|(y, x)| *y += by * x);
        }
        segments.push(Segment {
            y,
            weight: grid.weights(),
            x,
        });
    }
    let spread = spread_rad(&grids);
    let mut columns: Vec<Column> = all.into_iter().map(|a| a.column).collect();
    if loses {
        columns.push(Column {
            prior: [1.0, 0.1],
            cost: missed * (1.0 - libm::log(share)),
            ..Column::played(Effect::PacketLoss, "probability", 0.0, share, 0)
        });
    }
    (!segments.is_empty()).then_some(Raw {
        site: Site {
            stage: Stage::Driver,
            joint: Some(joint),
        },
        columns,
        segments,
        floor: LEAST_RAD + SHARE * spread,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::block::Block;
    use crate::evidence::cause::causes;
    use crate::evidence::search::Problem;
    use crate::math::Rng;

    /// Gain of the loop, 1/s, and time between rows, s.
    const GAIN: f64 = 10.0;
    const ROW_S: f64 = 0.01;
    const TICK_S: f64 = 0.05;

    fn known() -> Known {
        Known {
            nominal: Nominal {
                gain_per_s: GAIN,
                gain_tolerance: 0.05,
                max_speed_rad_s: 2.5,
                max_torque_nm: 4.8,
                torque_tolerance_nm: 0.3,
                damping_nm_s_rad: 0.0,
                winding_ohm: 0.0,
                nm_per_a: 4.3,
            },
            late_s: None,
            applied: false,
            speed_tolerance: 0.1,
            echoed: false,
            row_s: ROW_S,
        }
    }

    /// Set-points of a slow swing, and the closed form of a loop that follows them `late_s` late with gain `GAIN *
    /// ratio`.
    fn run(late_s: f64, ratio: f64, offset: f64, rng: &mut Rng) -> (Track, Track) {
        let set = |i: usize| {
            0.6 * crate::math::sin(0.063 * i as f64) + 0.2 * crate::math::sin(0.17 * i as f64)
        };
        let mut command = Track::default();
        for i in 0..240 {
            command.t_s.push(i as f64 * TICK_S);
            command.v.push(set(i));
        }
        let mut position = Track::default();
        let mut q = set(0);
        for row in 0..1190 {
            let t = row as f64 * ROW_S;
            position.t_s.push(t);
            position.v.push(q + 3e-4 * rng.normal());
            // Between two instants the set-point is held but for one change: exact exponentials on both sides of it.
            let (mut from, end) = (t, t + ROW_S);
            while from < end - 1e-12 {
                let tick = ((from - late_s) / TICK_S + 1e-9).floor();
                let next = ((tick + 1.0) * TICK_S + late_s).min(end);
                let c = set(tick.max(0.0) as usize) + offset;
                q = c + (q - c) * libm::exp(-GAIN * ratio * (next - from));
                from = next;
            }
        }
        (command, position)
    }

    fn named(late_s: f64, ratio: f64, offset: f64) -> Vec<(Option<Effect>, f64)> {
        let mut rng = Rng::new(7);
        let runs: Vec<(Track, Track)> = (0..3)
            .map(|_| run(late_s, ratio, offset, &mut rng))
            .collect();
        let inputs: Vec<Input<'_>> = runs
            .iter()
            .map(|(command, position)| Input {
                command: command.clone(),
                position,
                load_nm: &[],
                load_step_s: 0.02,
                limit: None,
            })
            .collect();
        let raw = raw(0, &inputs, &known(), &[]).expect("long enough");
        let blocks = [Block::new(raw, 6).with_model_error(0.12)];
        let all = causes(&blocks, &[], &[]);
        let problem = Problem {
            blocks: &blocks,
            causes: &all,
            always: &[],
        };
        let found = problem.search(6.0, 3);
        let posterior = problem.posterior(&found.best.members);
        let members = found.best.members.iter().zip(&posterior.first);
        members
            .map(|(m, first)| {
                let number = &all[*m].numbers[0];
                let sd = number.of_latents[0].1;
                let coefficient = number.mean + sd * posterior.mean[*first];
                (all[*m].effect, number.neutral + number.scale * coefficient)
            })
            .collect()
    }

    #[test]
    fn closed_forms_of_the_loop_are_named_with_their_size() {
        let cases = [
            ("nothing", 0.0, 1.0, 0.0, None),
            ("late", 0.06, 1.0, 0.0, Some((Effect::Latency, 0.06, 0.01))),
            ("weak", 0.0, 0.6, 0.0, Some((Effect::LoopGain, 0.6, 0.06))),
            (
                "off",
                0.0,
                1.0,
                0.05,
                Some((Effect::JointOffset, 0.05, 0.005)),
            ),
        ];
        for (what, late_s, ratio, offset, expected) in cases {
            let found = named(late_s, ratio, offset);
            match expected {
                None => assert!(found.is_empty(), "{what}: {found:?}"),
                Some((effect, value, within)) => {
                    assert_eq!(found.len(), 1, "{what}: {found:?}");
                    assert_eq!(found[0].0, Some(effect), "{what}: {found:?}");
                    assert!((found[0].1 - value).abs() < within, "{what}: {found:?}");
                }
            }
        }
    }
}
