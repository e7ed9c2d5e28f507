//! One joint of the robot, cut out of it: the servo of Table II and its effects, against loads replayed from measurement.
//!
//! `v* = clamp(P (set-point - q), +-vmax)`; the motor gives what torque that takes, at most `Tmax`; a real drive loses some
//! speed per torque (`droop`, CFM in ODE's words). The load on the joint is what the body needs along the measured motion,
//! so joints do not couple. One step of the motor is in module `drive`.

use super::data::Track;
use super::drive::{Friction, Limits, drive, warm};
use super::nominal::Nominal;

macro_rules! coordinates {
    ($($id:ident, $doc:literal;)*) => {
        /// Index of a coordinate of the joint model.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(super) enum J { $(#[doc = $doc] $id),* }

        impl J {
            /// How many there are.
            pub(super) const COUNT: usize = [$(Self::$id),*].len();
        }
    };
}

coordinates! {
    Gain, "ratio to the nominal P";
    MaxSpeed, "ratio to the nominal speed limit";
    MaxTorque, "ratio to the nominal torque limit";
    Viscous, "N m s/rad";
    Droop, "speed lost per torque, rad/s per N m";
    Delay, "set-point delay, s";
    Skew, "robot clock rate over true rate";
    Scale, "ratio of the set-point";
    Offset, "added to the set-point, rad";
    Quantum, "set-point step, rad";
    DeadHard, "errors below count as none, rad";
    DeadSoft, "errors are reduced by this, rad";
    Slew, "largest speed of the followed set-point, rad/s; 0 = unlimited";
    FeedbackDelay, "age of the angle in the loop, s";
    Lag, "time constant from wanted speed to followed speed, s";
    Coulomb, "N m";
    Static, "friction above Coulomb at rest, N m";
    StribeckSpeed, "rad/s";
    LoadShare, "friction over load";
    Asymmetry, "Coulomb friction forward less backward, N m";
    AsymmetryViscous, "the same for the viscous part, N m s/rad";
    Quadratic, "N m s2/rad2";
    RippleSin, "N m";
    RippleCos, "N m";
    RipplePeriods, "per turn";
    Load, "ratio of the replayed load";
    Gravity, "gravity load of this joint over that of its model, less one";
    Play, "half play between encoder and link, rad";
    Flex, "twist between encoder and link, rad per N m";
    PerAmpere, "ratio to the nominal torque per current";
    DerateShare, "share of the torque per current, and of the limit, that a warm motor has lost";
    DerateTime, "time constant of the warming, s";
    DerateSince, "how long the motor was on before the run, s";
}

/// Time step, s. Ten per set-point; the laws are integrated implicitly.
pub(super) const STEP_S: f64 = 0.005;
/// Load at which the play is half taken up, N m.
const PLAY_LOAD_NM: f64 = 0.02;

/// A sample to compare with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sample {
    /// Step and the part of it.
    at: (usize, f64),
    value: f64,
}

impl Sample {
    /// Step of the simulation at or before it.
    pub(super) fn step(&self) -> usize {
        self.at.0
    }
}

/// What a model leaves of the torque at one instant, with the motion there.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Left {
    /// Measured less simulated.
    pub(super) torque_nm: f64,
    pub(super) angle_rad: f64,
    pub(super) speed_rad_s: f64,
    pub(super) load_nm: f64,
    /// Stop operators of the angle: it moves with it and stays within its width.
    pub(super) stops_rad: Vec<f64>,
}

impl Left {
    /// Direction of motion, 0 at rest.
    pub(super) fn direction(&self) -> f64 {
        // Speed below which there is none, rad/s.
        const STILL_RAD_S: f64 = 0.05;
        if self.speed_rad_s.abs() < STILL_RAD_S {
            0.0
        } else {
            self.speed_rad_s.signum()
        }
    }
}

/// Load of one joint in one run, on the grid of steps.
#[derive(Debug, Clone, Default)]
pub(super) struct Load {
    /// What the body needs along the measured motion, N m.
    pub(super) nm: Vec<f64>,
    /// The part of it that balances the weight of the joint's distal side, N m; empty = not known.
    pub(super) gravity_nm: Vec<f64>,
}

impl Load {
    fn at(&self, step: usize, p: &[f64]) -> f64 {
        let get = |v: &[f64]| v.get(step).copied().unwrap_or(0.0);
        p[J::Load as usize] * get(&self.nm) + p[J::Gravity as usize] * get(&self.gravity_nm)
    }
}

/// One run of one joint, prepared.
#[derive(Debug, Clone)]
pub(super) struct JointRun {
    /// Set-point events: time, value, integral up to there.
    events: Vec<[f64; 3]>,
    steps: usize,
    start: [f64; 2],
    /// Replayed load at each step.
    load: Load,
    /// What twists the transmission at each step: the measured torque, else the replayed load, N m.
    twisting: Vec<f64>,
    /// Measured angle at each step.
    path: Vec<f64>,
    /// Voltage of the supply at each step; empty where not measured.
    bus_v: Vec<f64>,
    /// Sizes of the measured torque, as it was sampled, N m.
    strength: Vec<f64>,
    /// The measured torque is a current times the nominal torque per current.
    ampere: bool,
    pub(super) position: Vec<Sample>,
    pub(super) effort: Vec<Sample>,
    /// Link less encoder.
    pub(super) twist: Vec<Sample>,
}

/// Least time between samples that are compared, s: errors of the angle are slower than this.
const SPACING_S: f64 = 0.03;

fn samples(track: Option<&Track>, steps: usize) -> Vec<Sample> {
    let mut out = Vec::new();
    let mut next = 0.0;
    let Some(track) = track else { return out };
    for (t, v) in track.t_s.iter().zip(&track.v) {
        let step = (t / STEP_S) as usize;
        if *t >= next && step + 1 < steps {
            out.push(Sample {
                at: (step, t / STEP_S - step as f64),
                value: *v,
            });
            next = t + SPACING_S - 1e-9;
        }
    }
    out
}

/// Strongest samples of the torque that are left out where the strongest are looked at: noise and what drives the motor.
const STRONGEST: usize = 10;

/// Means over one set-point period: the torque of each step of the set-point is a blow whose height hangs on the time step.
fn averaged(track: &Track) -> Track {
    const HALF_S: f64 = 0.05;
    let mean = |t: &f64| track.line(*t, HALF_S).map_or_else(|| track.at(*t), |l| l.0);
    Track {
        t_s: track.t_s.clone(),
        v: track.t_s.iter().map(mean).collect(),
    }
}

impl JointRun {
    /// The same under a supply of measured voltage.
    pub(super) fn supplied(mut self, bus_v: Option<&Track>) -> Self {
        // Half width of the straight lines through the readings, s.
        const HALF_S: f64 = 0.1;
        if let Some(bus) = bus_v {
            let at = |i: usize| {
                let t = i as f64 * STEP_S;
                bus.line(t, HALF_S).map_or_else(|| bus.at(t), |l| l.0)
            };
            self.bus_v = (0..self.steps).map(at).collect();
        }
        self
    }

    /// The same with a torque that is a current times the nominal torque per current, or not.
    pub(super) fn by_current(self, ampere: bool) -> Self {
        Self { ampere, ..self }
    }

    /// The same without the samples around where the measured torque lies in `limit_nm`: what a joint does at its limit hangs on its surroundings,
    /// which a joint by itself does not know. A joint that hardly leaves its limit keeps them.
    pub(super) fn below(mut self, limit_nm: [f64; 2]) -> Self {
        // Torques are means over 0.1 s; a joint that was held back catches up within some tenths of a second.
        const BEFORE: usize = (0.1 / STEP_S) as usize;
        const AFTER: usize = (0.5 / STEP_S) as usize;
        const LEAST: f64 = 0.1;
        if self.effort.is_empty() {
            return self;
        }
        let mut bound = vec![false; self.steps];
        for (i, nm) in self.twisting.iter().enumerate() {
            if (limit_nm[0]..=limit_nm[1]).contains(&nm.abs()) {
                bound[i.saturating_sub(BEFORE)..(i + AFTER).min(self.steps)].fill(true);
            }
        }
        let free = bound.iter().filter(|b| !**b).count();
        if free as f64 >= LEAST * self.steps as f64 {
            self.position.retain(|s| !bound[s.step()]);
            self.effort.retain(|s| !bound[s.step()]);
        }
        self
    }

    /// Prepares a run.
    pub(super) fn new(
        command: &Track,
        position: &Track,
        link: Option<&Track>,
        effort: Option<&Track>,
        load: Load,
    ) -> Self {
        let end = position.t_s[position.t_s.len() - 1];
        let steps = (end / STEP_S) as usize + 2;
        let mut events: Vec<[f64; 3]> = Vec::new();
        for (t, v) in command.t_s.iter().zip(&command.v) {
            match events.last() {
                Some(last) if last[1] == *v => {}
                Some(last) => events.push([*t, *v, last[2] + last[1] * (t - last[0])]),
                None => events.push([0.0, *v, 0.0]),
            }
        }
        let first = position.line(position.t_s[0] + 0.05, 0.06);
        let speed = first.map_or(0.0, |f| if f.1.abs() < 0.05 { 0.0 } else { f.1 });
        let twist = link.map(|l| Track {
            t_s: l.t_s.clone(),
            v: l.t_s
                .iter()
                .zip(&l.v)
                .map(|(t, v)| v - position.at(*t))
                .collect(),
        });
        let strength = effort.map_or_else(Vec::new, |e| e.v.iter().map(|x| x.abs()).collect());
        let effort = effort.map(averaged);
        let twisting = match &effort {
            Some(e) => (0..steps).map(|i| e.at(i as f64 * STEP_S)).collect(),
            None => load.nm.clone(),
        };
        Self {
            bus_v: Vec::new(),
            strength,
            ampere: false,
            twisting,
            events,
            steps,
            start: [position.v[0], speed],
            path: (0..steps).map(|i| position.at(i as f64 * STEP_S)).collect(),
            load,
            position: samples(Some(position), steps),
            effort: samples(effort.as_ref(), steps),
            twist: samples(twist.as_ref(), steps),
        }
    }

    /// Largest commanded speed between neighbouring set-points, rad/s (95 % quantile).
    pub(super) fn busy_rad_s(&self) -> f64 {
        let speed = |w: &[[f64; 3]]| ((w[1][1] - w[0][1]) / (w[1][0] - w[0][0]).max(1e-3)).abs();
        let v: Vec<f64> = self.events.windows(2).map(speed).collect();
        crate::math::quantile(&v, 0.95)
    }

    /// Largest measured speed over 0.1 s, rad/s (95 % quantile): that of a joint at its limit.
    pub(super) fn moved_rad_s(&self) -> f64 {
        const APART: usize = (0.1 / STEP_S) as usize;
        let ends = self.path.iter().zip(self.path.iter().skip(APART));
        let ways: Vec<f64> = ends.map(|(a, b)| (b - a).abs()).collect();
        crate::math::quantile(&ways, 0.95) / (APART as f64 * STEP_S)
    }

    /// Simulated less measured torque at every torque sample, N m. Where current was measured it is in units of that times the nominal
    /// torque per current. In units of torque a motor that had lost all its strength would fit best.
    pub(super) fn effort_errors<'a>(
        &'a self,
        trace: &'a Trace,
        p: &'a [f64],
    ) -> impl Iterator<Item = f64> + 'a {
        self.effort
            .iter()
            .map(|s| at(&trace.effort, s) / self.per_ampere(p, s) - s.value)
    }

    /// Torque over measured torque at a sample.
    fn per_ampere(&self, p: &[f64], s: &Sample) -> f64 {
        let warm = if self.ampere {
            warm(p, s.at.0 as f64 * STEP_S)
        } else {
            1.0
        };
        p[J::PerAmpere as usize] * warm
    }

    /// Measured torque, simulated torque and replayed load at every torque sample, N m.
    pub(super) fn loads<'a>(
        &'a self,
        trace: &'a Trace,
        p: &'a [f64],
    ) -> impl Iterator<Item = (f64, f64, f64)> + 'a {
        self.effort.iter().map(|s| {
            let measured = s.value * self.per_ampere(p, s);
            (measured, at(&trace.effort, s), at(&self.load.nm, s))
        })
    }

    /// What is left at every torque sample, with what may explain it; `widths_rad` are those of the stop operators.
    pub(super) fn left(&self, trace: &Trace, p: &[f64], widths_rad: &[f64]) -> Vec<Left> {
        // Half of the time over which torques are means, in steps.
        const HALF: usize = (0.05 / STEP_S) as usize;
        let mut stops: Vec<f64> = vec![0.0; widths_rad.len()];
        let mut out = Vec::with_capacity(self.effort.len());
        let mut next = self.effort.iter().peekable();
        for (i, q) in self.path.iter().enumerate() {
            let step = if i == 0 { 0.0 } else { q - self.path[i - 1] };
            for (stop, width) in stops.iter_mut().zip(widths_rad) {
                *stop = (*stop + step).clamp(-width, *width);
            }
            while let Some(s) = next.next_if(|s| s.at.0 <= i) {
                let (from, to) = (i.saturating_sub(HALF), (i + HALF).min(self.path.len() - 1));
                out.push(Left {
                    torque_nm: s.value * self.per_ampere(p, s) - at(&trace.effort, s),
                    angle_rad: *q,
                    speed_rad_s: (self.path[to] - self.path[from])
                        / ((to - from).max(1) as f64 * STEP_S),
                    load_nm: at(&self.load.nm, s),
                    stops_rad: stops.clone(),
                });
            }
        }
        out
    }

    /// Simulated less measured link angle, where the link was measured.
    pub(super) fn link_errors(&self, trace: &Trace) -> Vec<f64> {
        let one =
            |s: &Sample| at(&trace.position, s) + at(&trace.twist, s) - at(&self.path, s) - s.value;
        self.twist.iter().map(one).collect()
    }

    /// Largest measured torque but for rare blows, N m; `None` without torque.
    pub(super) fn strongest_nm(&self) -> Option<f64> {
        (!self.strength.is_empty()).then(|| crate::math::quantile(&self.strength, 0.99))
    }

    /// Root mean square of the torque that the weight of the joint's distal side takes, N m; 0 where it is not known.
    pub(super) fn weight_nm(&self) -> f64 {
        crate::math::rms(&self.load.gravity_nm)
    }

    /// Root mean square of the measured angle's acceleration, rad/s2.
    pub(super) fn acceleration_rad_s2(&self) -> f64 {
        // Over 0.1 s to either side: the resolution of an encoder must not count.
        const APART: usize = (0.1 / STEP_S) as usize;
        let bend = |i: usize| {
            let d = self.path[i + 2 * APART] - 2.0 * self.path[i + APART] + self.path[i];
            d / (APART as f64 * STEP_S).powi(2)
        };
        let all: Vec<f64> = (0..self.path.len().saturating_sub(2 * APART))
            .map(bend)
            .collect();
        crate::math::rms(&all)
    }

    /// The torque that a limited motor stays at, N m: the middle of the samples around the strongest three in a hundred, and that of the strongest of all, for a
    /// limit that blows alone meet. `None` without torque.
    pub(super) fn plateaus_nm(runs: &[Self]) -> [Option<f64>; 2] {
        let measured = || runs.iter().filter(|r| !r.strength.is_empty());
        let tops: Vec<f64> = measured()
            .map(|r| crate::math::quantile(&r.strength, 0.97))
            .collect();
        let often = crate::math::quantile(&tops, 0.8);
        let mut all: Vec<f64> = measured().flat_map(|r| &r.strength).copied().collect();
        all.sort_by(f64::total_cmp);
        let strong = all.iter().nth_back(STRONGEST).map_or(f64::INFINITY, |x| *x);
        let middle = |within: std::ops::Range<f64>| {
            let own: Vec<f64> = all.iter().copied().filter(|x| within.contains(x)).collect();
            (own.len() >= 2 * STRONGEST).then(|| crate::math::median(&own))
        };
        [
            middle(0.9 * often..1.1 * often),
            middle(0.9 * strong..f64::INFINITY),
        ]
    }

    /// Measured angle at each step, rad.
    pub(super) fn path(&self) -> &[f64] {
        &self.path
    }

    /// Number of steps.
    pub(super) fn steps(&self) -> usize {
        self.steps
    }
}

/// What a simulation gives at every step.
#[derive(Debug, Clone, Default)]
pub(super) struct Trace {
    pub(super) position: Vec<f64>,
    pub(super) effort: Vec<f64>,
    pub(super) twist: Vec<f64>,
    sums: Vec<f64>,
}

/// The held set-point's integral from 0 to `t_s`; `at` is a cursor that moves with time.
fn integral(events: &[[f64; 3]], t_s: f64, at: &mut usize) -> f64 {
    while *at + 1 < events.len() && events[*at + 1][0] <= t_s {
        *at += 1;
    }
    while *at > 0 && events[*at][0] > t_s {
        *at -= 1;
    }
    let e = events[*at];
    e[2] + e[1] * (t_s - e[0])
}

/// Simulates a run.
pub(super) fn simulate(run: &JointRun, nominal: &Nominal, p: &[f64], out: &mut Trace) {
    let get = |j: J| p[j as usize];
    let h = STEP_S;
    let gain = nominal.gain_per_s * get(J::Gain);
    let vmax = nominal.max_speed_rad_s * get(J::MaxSpeed);
    let tmax = nominal.max_torque_nm * get(J::MaxTorque);
    let volt_s = nominal.nm_per_a * get(J::PerAmpere);
    let mut limits = Limits {
        droop: get(J::Droop).max(1e-4),
        torque_nm: tmax,
        free_rad_s: f64::INFINITY,
        brake: nominal.winding_ohm / (volt_s * volt_s),
    };
    let blend = if get(J::Lag) > 0.0 {
        1.0 - libm::exp(-h / get(J::Lag))
    } else {
        1.0
    };
    let back = get(J::FeedbackDelay) / h;
    let ripple = get(J::RippleSin) != 0.0 || get(J::RippleCos) != 0.0;
    let (mut q, mut v) = (run.start[0], run.start[1]);
    let (mut cursor, mut wanted) = (0usize, v);
    let clock = |t: f64| t * get(J::Skew) - get(J::Delay);
    let mut before = integral(&run.events, clock(0.0), &mut cursor);
    let mut followed = f64::NAN;
    out.position.clear();
    out.effort.clear();
    out.twist.clear();
    for i in 0..run.steps {
        let t = i as f64 * h;
        let next = integral(&run.events, clock(t + h), &mut cursor);
        let mut sp = (next - before) / (h * get(J::Skew));
        before = next;
        if get(J::Quantum) > 0.0 {
            sp = (sp / get(J::Quantum)).round() * get(J::Quantum);
        }
        sp = sp * get(J::Scale) + get(J::Offset);
        if get(J::Slew) > 0.0 {
            let from = if followed.is_nan() { q } else { followed };
            followed = from + (sp - from).clamp(-get(J::Slew) * h, get(J::Slew) * h);
            sp = followed;
        }
        let seen = if back > 0.0 {
            old(&out.position, q, back)
        } else {
            q
        };
        let mut e = sp - seen;
        if e.abs() < get(J::DeadHard) {
            e = 0.0;
        }
        e = e.signum() * (e.abs() - get(J::DeadSoft)).max(0.0);
        // Half a step of the loop's own answer makes the explicit law second order.
        let v_star = (gain * e / (1.0 + 0.5 * gain * h)).clamp(-vmax, vmax);
        wanted += blend * (v_star - wanted);
        limits.torque_nm = tmax * warm(p, t);
        if let Some(volt) = run.bus_v.get(i).filter(|_| limits.brake > 0.0) {
            limits.free_rad_s = volt / volt_s;
        }
        let mut load = run.load.at(i, p);
        if ripple {
            // Torque that repeats with the turn has a whole number of periods in it.
            let (s, c) = libm::sincos(get(J::RipplePeriods).round() * q);
            load -= get(J::RippleSin) * s + get(J::RippleCos) * c;
        }
        let (speed, torque) = drive(
            v,
            wanted,
            load,
            q - run.path[i],
            &limits,
            &Friction::at(p, wanted, load),
        );
        out.position.push(q);
        out.effort.push(torque);
        let twisting = run.twisting.get(i).copied().unwrap_or(0.0);
        let side = twisting / PLAY_LOAD_NM;
        out.twist
            .push(-get(J::Flex) * twisting - get(J::Play) * side / (1.0 + side.abs()));
        v = speed;
        q += h * v;
    }
    if !run.effort.is_empty() {
        average(&mut out.effort, &mut out.sums);
    }
}

/// Means over 100 ms around every step, as the measured torque is taken.
fn average(series: &mut [f64], sums: &mut Vec<f64>) {
    const HALF: usize = (0.05 / STEP_S) as usize;
    sums.clear();
    sums.push(0.0);
    let mut sum = 0.0;
    for x in series.iter() {
        sum += x;
        sums.push(sum);
    }
    let n = series.len();
    for (i, x) in series.iter_mut().enumerate() {
        let (from, to) = (i.saturating_sub(HALF), (i + HALF + 1).min(n));
        *x = (sums[to] - sums[from]) / (to - from) as f64;
    }
}

/// Angle `back` steps ago, linear between steps.
fn old(position: &[f64], now: f64, back: f64) -> f64 {
    let n = position.len() as f64;
    let place = n - back;
    let first = position.first().copied().unwrap_or(now);
    if place <= 0.0 {
        return first;
    }
    let i = place as usize;
    let a = position.get(i).copied().unwrap_or(now);
    let b = position.get(i + 1).copied().unwrap_or(now);
    a + (b - a) * (place - i as f64)
}

/// Value of a series at a sample.
pub(super) fn at(series: &[f64], s: &Sample) -> f64 {
    let a = series[s.at.0];
    a + (series[s.at.0 + 1] - a) * s.at.1
}

/// Simulated less measured at every sample.
pub(super) fn errors<'a>(
    series: &'a [f64],
    samples: &'a [Sample],
) -> impl Iterator<Item = f64> + 'a {
    samples.iter().map(|s| at(series, s) - s.value)
}

/// Measured values.
pub(super) fn values(samples: &[Sample]) -> impl Iterator<Item = f64> + '_ {
    samples.iter().map(|s| s.value)
}

#[cfg(test)]
mod tests;
