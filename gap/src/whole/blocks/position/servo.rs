//! The servo on the grid of the simulation, led by set-points.

use super::Input;
use crate::whole::data::Track;
use crate::whole::nominal::Nominal;

/// Step of the integrals, s: the drivers' own is 1 ms, the recordings' 5 to 50 ms.
pub(super) const STEP_S: f64 = 0.002;
/// Time between compared angles, at most, where rows come as often, s.
const HORIZON_S: f64 = 0.04;
/// Fewest compared angles of a run: 4 s.
const LEAST_ROWS: usize = 100;

/// A measured angle that is compared.
struct Row {
    /// Step of the grid before it, and the share of the step that has passed.
    step: usize,
    share: f64,
    q: f64,
}

/// A run on the grid of the simulation.
pub(super) struct Grid {
    /// Encoder between its rows, and load.
    pub(super) q: Vec<f64>,
    load: Vec<f64>,
    /// Whether the motor is at its limit.
    limited: Vec<bool>,
    /// Angles are compared where they were measured: between rows a joint turns a corner at every set-point.
    rows: Vec<Row>,
    /// Set-points as steps in time.
    pub(super) command: Track,
    pub(super) from_s: f64,
}

/// The servo: `v = clamp(P (c - q))` with what may be different about it. Neutral values are those of the nominal
/// model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::whole) struct Law {
    pub(super) gain: f64,
    pub(super) most: f64,
    /// Gain and speed limit as shares of these.
    pub(super) ratio: f64,
    pub(super) share: f64,
    pub(super) offset: f64,
    pub(super) scale: f64,
    pub(super) delay_s: f64,
    pub(super) clock: f64,
    pub(super) step: f64,
    pub(super) soft_band: f64,
    pub(super) hard_band: f64,
    pub(super) feedback_delay_s: f64,
    pub(super) lag_s: f64,
    pub(super) droop: f64,
    /// Drift of the zero, rad/s.
    pub(super) drift: f64,
    /// Gain for positive errors over that for negative ones, less one.
    pub(super) lopsided: f64,
}

impl Law {
    /// The nominal one.
    pub(super) fn nominal(servo: &Nominal) -> Self {
        Self {
            gain: servo.gain_per_s,
            most: servo.max_speed_rad_s,
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
        }
    }

    fn error(&self, c: f64, q: f64) -> f64 {
        let mut e = c * self.scale + self.offset - q;
        if e.abs() < self.hard_band {
            e = 0.0;
        }
        e.signum() * (e.abs() - self.soft_band).max(0.0)
    }
}

impl Grid {
    pub(super) fn new(input: &Input<'_>) -> Option<Self> {
        let q = input.position;
        // A hundredth of a row more: periods are medians of printed times.
        let every = (HORIZON_S / q.period_s() + 0.01).max(1.0) as usize;
        let from_s = q.t_s[0];
        let end_s = q.t_s[q.t_s.len() - 1];
        let n = ((end_s - from_s) / STEP_S) as usize;
        let row = |(t, q): (&f64, &f64)| {
            let at = (t - from_s) / STEP_S;
            Row {
                step: at as usize,
                share: at.fract(),
                q: *q,
            }
        };
        let mut rows: Vec<Row> = q.t_s.iter().zip(&q.v).step_by(every).map(row).collect();
        rows.retain(|r| r.step + 1 < n);
        if rows.len() < LEAST_ROWS {
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
            rows,
            command: input.command.clone(),
            from_s,
        })
    }

    /// Measured angles that are compared.
    pub(super) fn angles(&self) -> Vec<f64> {
        self.rows.iter().map(|r| r.q).collect()
    }

    /// An answer at the compared instants.
    pub(super) fn compared(&self, q: &[f64]) -> Vec<f64> {
        let one = |r: &Row| q[r.step] + r.share * (q[r.step + 1] - q[r.step]);
        self.rows.iter().map(one).collect()
    }

    /// Angle under a law, from the measured start; the loop is stable, so that a wrong start is forgotten.
    pub(super) fn simulated(&self, law: &Law) -> Vec<f64> {
        self.answer(law, &self.command)
    }

    /// The same to other set-points.
    pub(super) fn answer(&self, law: &Law, command: &Track) -> Vec<f64> {
        let (times, values) = (&command.t_s, &command.v);
        let mut cursor = 0;
        let mut out = Vec::with_capacity(self.q.len());
        let mut speed = 0.0;
        let mut q = self.q[0];
        for i in 0..self.q.len() {
            let t = (self.from_s + i as f64 * STEP_S) * law.clock - law.delay_s;
            while cursor + 1 < times.len() && times[cursor + 1] <= t {
                cursor += 1;
            }
            out.push(q);
            q = self.next(law, values[cursor], (&out, &mut speed));
        }
        out
    }

    /// The angle a step after the last one of `past`, under the set-point `c`.
    pub(super) fn next(&self, law: &Law, c: f64, (past, speed): (&[f64], &mut f64)) -> f64 {
        let h = STEP_S;
        let i = past.len() - 1;
        let back = (law.feedback_delay_s / h).round() as usize;
        let blend = if law.lag_s > 0.0 {
            1.0 - libm::exp(-h / law.lag_s)
        } else {
            1.0
        };
        let (gain, most) = (law.gain * law.ratio, law.most * law.share);
        let c = if law.step > 0.0 {
            (c / law.step).round() * law.step
        } else {
            c
        };
        let seen = past[i.saturating_sub(back)];
        // Half a step of the loop's own answer makes the explicit law second order.
        let error = law.error(c + law.drift * i as f64 * h, seen);
        let side = if error > 0.0 { 1.0 + law.lopsided } else { 1.0 };
        let wanted = side * gain * error / (1.0 + 0.5 * gain * h);
        *speed += blend * (wanted.clamp(-most, most) - *speed);
        past[i] + h * (*speed - law.droop * self.load[i])
    }

    /// Weight of each compared angle: none at the start, at the motor's limit and while a joint comes back from there.
    pub(super) fn weights(&self) -> Vec<f64> {
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
        let one = |r: &Row| f64::from(u8::from(free[r.step] && free[r.step + 1]));
        self.rows.iter().map(one).collect()
    }
}
