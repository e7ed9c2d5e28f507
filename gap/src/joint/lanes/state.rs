//! What the loop carries from step to step.

use super::observer::Gains;
use super::resolve::{Late, Model};
use super::simd::{Eight, Lane};
use crate::joint::data::RunData;

/// The joint between two steps.
pub(super) struct State<F> {
    pub(super) q: F,
    pub(super) dq: F,
    pub(super) integral: F,
    pub(super) actuator: F,
    pub(super) output: F,
    pub(super) link: F,
    pub(super) link_dq: F,
    /// Torque that the gear transmits, where it gives.
    pub(super) torque: F,
    /// Controller output of the last tick.
    pub(super) held: F,
    pub(super) duty: F,
    pub(super) bus: F,
    /// Effort `a - b speed` of the last step; after and before any loss of torque: the latter is what the current shows.
    pub(super) driven: [F; 2],
    pub(super) electrical: [F; 2],
    /// Speed at the start and at the end of the last step.
    pub(super) speeds: [F; 2],
    /// Travel of dry friction that sticks.
    pub(super) bristle: F,
    pub(super) heat: F,
    /// Inertia times the last acceleration.
    pub(super) inertial: F,
}

/// What the controller remembers. Beside [`State`], which the compiler keeps in registers because nothing in it is picked by a number.
pub(super) struct Memory {
    /// Positions and speeds for a delayed encoder, around and around.
    history: Vec<[Eight; 2]>,
    at: usize,
    /// Positions as the controller saw them, around and around; the newest is at `newest`.
    seen: Vec<Eight>,
    newest: usize,
}

impl<F: Lane> State<F> {
    #[inline(always)]
    pub(super) fn new(run: &RunData, m: &Model<F>) -> Self {
        let e = run.edges.first().copied();
        let (q, dq) = e.map_or((0.0, 0.0), |e| (e.position, e.velocity));
        let (q, dq, zero) = (F::splat(q), F::splat(dq), F::zero());
        Self {
            q,
            dq,
            integral: zero,
            actuator: zero,
            output: q,
            link: q - m.sags(q),
            link_dq: dq,
            torque: zero,
            held: zero,
            duty: zero,
            bus: m.supply,
            driven: [zero; 2],
            electrical: [zero; 2],
            speeds: [zero; 2],
            bristle: zero,
            heat: zero,
            inertial: zero,
        }
    }

    /// A stop takes all speed.
    #[inline(always)]
    pub(super) fn stop(&mut self, [low, high]: &[f64; 2]) {
        if low.is_finite() || high.is_finite() {
            let held = self.q.clamp(F::splat(*low), F::splat(*high));
            self.dq = F::select(held.ne(self.q), F::zero(), self.dq);
            self.q = held;
        }
    }

    /// The joint stands elsewhere and moves faster.
    #[inline(always)]
    pub(super) fn shift(&mut self, by: F, faster: F) {
        self.q += by;
        self.output += by;
        self.dq += faster;
    }

    /// The same of what is behind its gear, by the errors of both angles. A gear that turns back within a row by itself
    /// keeps its twist: through a stiff one, the noise of angles would kick.
    #[inline(always)]
    pub(super) fn shift_link(&mut self, m: &Model<F>, [own, behind]: [F; 2], gains: &Gains) {
        let meets = (self.q - self.link).abs().gt(m.play);
        let stiffness = F::select(meets, m.stiffness, F::zero());
        let rows = F::splat(gains.steps * gains.steps);
        let turns = stiffness * rows * m.dt / m.load_per_dt;
        let error = own + (behind - own) / (F::one() + turns);
        self.link += error * F::splat(gains.position);
        self.link_dq += error * F::splat(gains.speed_hz);
    }

    #[inline(always)]
    pub(super) fn restart(&mut self, m: &Model<F>, position: f64, velocity: f64, running: bool) {
        (self.q, self.dq) = (F::splat(position), F::splat(velocity));
        (self.output, self.integral) = (self.q, F::zero());
        (self.link, self.link_dq) = (self.q - m.sags(self.q), self.dq);
        (self.inertial, self.bristle) = (F::zero(), F::zero());
        if running {
            self.actuator = F::zero();
        }
    }
}

impl Memory {
    pub(super) fn new<F: Lane>(run: &RunData, m: &Model<F>) -> Self {
        let e = run.edges.first().copied();
        let start = e
            .map_or([0.0; 2], |e| [e.position, e.velocity])
            .map(Eight::splat);
        Self {
            history: vec![start; m.delay.rows() + 1],
            at: 0,
            seen: vec![start[0]; m.speed.as_ref().map_or(1, Late::rows)],
            newest: 0,
        }
    }

    /// Encoder as the controller sees it.
    #[inline(always)]
    pub(super) fn feedback<F: Lane>(&mut self, m: &Model<F>, s: &State<F>) -> (F, F) {
        if !m.used.feedback_delay {
            return (s.q, s.dq);
        }
        let n = self.history.len();
        self.history[self.at] = [s.q.put(), s.dq.put()];
        let back = |by: usize| {
            let k = self.at + n - by;
            if k < n { k } else { k - n }
        };
        let one = |channel: usize| m.delay.between(|steps| &self.history[back(steps)][channel]);
        let seen = (one(0), one(1));
        self.at = if self.at + 1 < n { self.at + 1 } else { 0 };
        seen
    }

    /// Speed as the difference of seen positions over some steps; over less than one, in part the exact speed.
    #[inline(always)]
    pub(super) fn difference<F: Lane>(&mut self, late: &Late<F>, q: F, exact: F) -> F {
        let n = self.seen.len();
        self.newest = if self.newest > 0 { self.newest } else { n } - 1;
        self.seen[self.newest] = q.put();
        let back = |by: usize| {
            let k = self.newest + by;
            if k < n { k } else { k - n }
        };
        let before = late.between(|steps| &self.seen[back(steps)]);
        let speed = (q - before) * late.per_s;
        exact + late.share * (speed - exact)
    }

    /// As if the joint had come to be elsewhere evenly over the last `steps` steps.
    #[inline(always)]
    pub(super) fn shift<F: Lane>(&mut self, by: F, steps: f64, dt_s: f64) {
        let n = self.history.len();
        let speed = by * F::splat(1.0 / (steps * dt_s));
        let ages = 0..libm::ceil(steps) as usize;
        for age in ages.clone().take(n) {
            let [q, dq] = &mut self.history[(self.at + 2 * n - 1 - age) % n];
            let share = F::splat(1.0 - age as f64 / steps);
            *q = (F::of(*q) + by * share).put();
            *dq = (F::of(*dq) + speed).put();
        }
        let n = self.seen.len();
        for age in ages.take(n) {
            let q = &mut self.seen[(self.newest + age) % n];
            let share = F::splat(1.0 - age as f64 / steps);
            *q = (F::of(*q) + by * share).put();
        }
    }

    /// As if the joint had come here at this speed.
    pub(super) fn restart(&mut self, position: f64, velocity: f64, dt_s: f64) {
        self.newest = 0;
        for (k, seen) in self.seen.iter_mut().enumerate() {
            *seen = Eight::splat(position - velocity * ((k + 1) as f64 * dt_s));
        }
    }
}

impl<F: Lane> Late<F> {
    /// Rows that must be remembered.
    fn rows(&self) -> usize {
        self.whole.iter().copied().max().unwrap_or(0) + 2
    }

    /// The signal `at` so many steps ago, between two of them.
    #[inline(always)]
    fn between<'s>(&self, at: impl Fn(usize) -> &'s Eight) -> F {
        let first = self.whole[0];
        let (early, late) = if self.alike {
            (*at(first), *at(first + 1))
        } else {
            let lane = |more: usize| std::array::from_fn(|i| at(self.whole[i] + more).0[i]);
            (Eight(lane(0)), Eight(lane(1)))
        };
        let (early, late) = (F::of(early), F::of(late));
        early + self.part * (late - early)
    }
}
