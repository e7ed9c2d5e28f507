//! The servo on the grid of the simulation, led by set-points.

use super::Input;
use crate::whole::data::Track;
use crate::whole::nominal::Nominal;

/// Step of the integrals, s: the drivers' own is 1 ms, the recordings' 5 to 50 ms.
pub(super) const STEP_S: f64 = 0.002;
/// Time between compared angles, at most, where rows come as often, s.
const HORIZON_S: f64 = 0.04;
/// Inertia that a motor at its limit still has to turn, kg m2: the load holds that of the body. Half a robot about a joint has 0.02.
const INERTIA_KG_M2: f64 = 0.01;
/// Change of the load per angle off the measured path, N m/rad: where torques were measured and where they were replayed. It holds a motor at its
/// limit on that path. Gravity alone gives 2 (half the robot on a lever of 0.15 m); a replayed load is wrong by some tenths of a newton metre.
/// Both were chosen by hand, on the closed form of the test and on two emulated robots of development.
const SURROUNDINGS_NM_RAD: [f64; 2] = [3.0, 10.0];
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
    pub(super) load: Vec<f64>,
    surroundings_nm_rad: f64,
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
    /// Largest torque, N m.
    pub(super) torque_nm: f64,
    /// Drift of the zero, rad/s.
    pub(super) drift: f64,
    /// Gain for positive errors over that for negative ones, less one.
    pub(super) lopsided: f64,
}

impl Law {
    /// Largest torque, N m; infinite where the law has no limit.
    pub(in crate::whole) const fn limit_nm(&self) -> f64 {
        self.torque_nm
    }

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
            torque_nm: f64::INFINITY,
            drift: 0.0,
            lopsided: 0.0,
        }
    }
}

/// Laws side by side, with what is the same in every step of the grid: one alone leaves the processor waiting for itself.
pub(super) struct Loops<const N: usize> {
    laws: [Law; N],
    /// Steps by which the encoder's answer is late.
    back: [usize; N],
    /// Share of the way to the wanted speed that a step takes.
    blend: [f64; N],
    scale: [f64; N],
    offset: [f64; N],
    drift: [f64; N],
    bands: [[f64; N]; 2],
    /// Gain for positive errors and for negative ones.
    gain: [[f64; N]; 2],
    most: [f64; N],
    /// Half a step of the loop's own answer makes the explicit law second order.
    own: [f64; N],
    droop: [f64; N],
    torque_nm: [f64; N],
    /// Whether any of them has a limit of its torque.
    limited: bool,
}

/// A joint over one step of the grid, as it was measured.
#[derive(Clone, Copy)]
struct Measured {
    angle: f64,
    speed: f64,
    load: f64,
    surroundings_nm_rad: f64,
}

impl Measured {
    /// The speed `wanted` of a joint that is at `q` with the speed `before`, as far as a torque of `most` allows.
    fn held(self, wanted: f64, before: f64, q: f64, most: f64) -> f64 {
        let off = q - self.angle;
        let k = self.surroundings_nm_rad;
        let needed = self.load + k * off;
        let m = INERTIA_KG_M2 / STEP_S;
        let aperiodic = 2.0 * (k * INERTIA_KG_M2).sqrt();
        let within = |torque: f64| {
            let push = m * (before - self.speed) + torque - needed;
            self.speed + push / (m + aperiodic + k * STEP_S)
        };
        if needed > most {
            wanted.min(within(most))
        } else if needed < -most {
            wanted.max(within(-most))
        } else {
            wanted
        }
    }
}

impl<const N: usize> Loops<N> {
    pub(super) fn new(laws: [Law; N]) -> Self {
        let blend = |law: Law| match law.lag_s {
            lag_s if lag_s > 0.0 => 1.0 - libm::exp(-STEP_S / lag_s),
            _ => 1.0,
        };
        let gain = |law: Law| law.gain * law.ratio;
        Self {
            back: laws.map(|l| (l.feedback_delay_s / STEP_S).round() as usize),
            blend: laws.map(blend),
            scale: laws.map(|l| l.scale),
            offset: laws.map(|l| l.offset),
            drift: laws.map(|l| l.drift),
            bands: [laws.map(|l| l.hard_band), laws.map(|l| l.soft_band)],
            gain: [laws.map(|l| (1.0 + l.lopsided) * gain(l)), laws.map(gain)],
            most: laws.map(|l| l.most * l.share),
            own: laws.map(|l| 1.0 + 0.5 * gain(l) * STEP_S),
            droop: laws.map(|l| l.droop),
            torque_nm: laws.map(|l| l.torque_nm),
            limited: laws.iter().any(|l| l.torque_nm.is_finite()),
            laws,
        }
    }

    /// A set-point as driver `l` takes it.
    fn taken(&self, l: usize, c: f64) -> f64 {
        match self.laws[l].step {
            step if step > 0.0 => (c / step).round() * step,
            _ => c,
        }
    }

    /// The angles after step `i` of those before it, under set-points that were `taken`.
    fn next(
        &self,
        i: usize,
        taken: &[f64; N],
        past: &[[f64; N]],
        there: Measured,
        speed: &mut [f64; N],
    ) -> [f64; N] {
        let mut q = past[i];
        let mut seen = q;
        let before = *speed;
        for l in 0..N {
            seen[l] = past[i.saturating_sub(self.back[l])][l];
        }
        for l in 0..N {
            let c = taken[l] + self.drift[l] * i as f64 * STEP_S;
            let e = c * self.scale[l] + self.offset[l] - seen[l];
            let size = if e.abs() < self.bands[0][l] {
                0.0
            } else {
                e.abs()
            };
            let size = (size - self.bands[1][l]).max(0.0);
            let (error, gain) = if e > 0.0 {
                (size, self.gain[0][l])
            } else {
                (-size, self.gain[1][l])
            };
            let wanted = (gain * error / self.own[l])
                .min(self.most[l])
                .max(-self.most[l]);
            speed[l] += self.blend[l] * (wanted - speed[l]);
        }
        if self.limited {
            for l in 0..N {
                speed[l] = there.held(speed[l], before[l], q[l], self.torque_nm[l]);
            }
        }
        for l in 0..N {
            q[l] += STEP_S * (speed[l] - self.droop[l] * there.load);
        }
        q
    }
}

/// Laws that are played side by side.
const LANES: usize = 8;

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
            surroundings_nm_rad: SURROUNDINGS_NM_RAD[usize::from(input.limit.is_none())],
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

    /// Instants at which angles are compared, s.
    pub(super) fn instants_s(&self) -> impl Iterator<Item = f64> + '_ {
        let at = |r: &Row| self.from_s + (r.step as f64 + r.share) * STEP_S;
        self.rows.iter().map(at)
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
        let played = self.side_by_side([*law], command);
        played.into_iter().map(|[q]| q).collect()
    }

    /// Compared angles under each of the `laws`.
    pub(super) fn all_compared(&self, laws: &[Law]) -> Vec<Vec<f64>> {
        let lanes = |laws: &[Law]| {
            let of = |l: usize| laws[l.min(laws.len() - 1)];
            let played = self.side_by_side::<LANES>(std::array::from_fn(of), &self.command);
            let lane = |l: usize| {
                let one = |r: &Row| {
                    let [from, to] = [r.step, r.step + 1].map(|i| played[i][l]);
                    from + r.share * (to - from)
                };
                self.rows.iter().map(one).collect::<Vec<f64>>()
            };
            (0..laws.len()).map(lane).collect::<Vec<_>>()
        };
        laws.chunks(LANES).flat_map(lanes).collect()
    }

    fn side_by_side<const N: usize>(&self, laws: [Law; N], command: &Track) -> Vec<[f64; N]> {
        let (times, values) = (&command.t_s, &command.v);
        let due = |at: usize| times.get(at).copied().unwrap_or(f64::INFINITY);
        let loops = Loops::new(laws);
        let mut next = [1; N];
        let mut due_s = [due(1); N];
        let mut taken: [f64; N] = std::array::from_fn(|l| loops.taken(l, values[0]));
        let mut past: Vec<[f64; N]> = Vec::with_capacity(self.q.len());
        let mut speed = [0.0; N];
        let mut q = [self.q[0]; N];
        for i in 0..self.q.len() {
            past.push(q);
            let t = self.from_s + i as f64 * STEP_S;
            for (l, law) in laws.iter().enumerate() {
                let t = t * law.clock - law.delay_s;
                while due_s[l] <= t {
                    taken[l] = loops.taken(l, values[next[l]]);
                    next[l] += 1;
                    due_s[l] = due(next[l]);
                }
            }
            q = loops.next(i, &taken, &past, self.measured(i), &mut speed);
        }
        past
    }

    /// The joint over step `i`.
    fn measured(&self, i: usize) -> Measured {
        let angle = self.q[i];
        let next = self.q.get(i + 1).copied().unwrap_or(angle);
        Measured {
            angle,
            speed: (next - angle) / STEP_S,
            load: self.load[i],
            surroundings_nm_rad: self.surroundings_nm_rad,
        }
    }

    /// The angle a step after the last one of `past`, under the set-point `c`.
    pub(super) fn next(
        &self,
        law: &Loops<1>,
        c: f64,
        past: &[[f64; 1]],
        speed: &mut [f64; 1],
    ) -> [f64; 1] {
        let i = past.len() - 1;
        law.next(i, &[law.taken(0, c)], past, self.measured(i), speed)
    }

    /// Whether `law` has a recorded set-point at an instant: a clock that is fast runs out of them before the end.
    pub(super) fn commanded(&self, law: &Law, t_s: f64) -> bool {
        let all = &self.command.t_s;
        let end_s = all[all.len() - 1] + self.command.period_s();
        t_s * law.clock - law.delay_s < end_s || law.clock <= 1.0
    }

    /// Weight of each compared angle under `law`: none at the start, without a set-point, at the motor's limit and while
    /// a joint comes back from there.
    pub(super) fn weights(&self, law: &Law) -> Vec<f64> {
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
        let one = |(r, t_s): (&Row, f64)| {
            let counts = free[r.step] && free[r.step + 1] && self.commanded(law, t_s);
            f64::from(u8::from(counts))
        };
        self.rows.iter().zip(self.instants_s()).map(one).collect()
    }
}
