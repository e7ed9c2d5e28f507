//! The forward model of one joint, eight parameter sets at a time. Steps of second order; friction as a clipped
//! stop-effort, so it holds without chatter. Lanes never mix: a lane gives the same bits whatever its neighbours are.

mod resolve;

use files::dataset::{Command, Output};
use wide::f64x8 as F;

use self::resolve::{Model, resolve};
use super::command::Commands;
use super::data::{CHANNELS, RunData};
use super::param::Params;

/// Parameter sets simulated at once.
pub const LANES: usize = 8;

/// Positions that the controller remembers for its speed estimate.
const SEEN: usize = 16;

/// Steps whose set-points are worked out ahead at once: small enough for the fastest cache.
const BLOCK: usize = 128;

/// Simulated channels at one row, for all lanes.
pub type Row = [F; CHANNELS];

/// What the loop carries from step to step.
struct State {
    q: F,
    dq: F,
    integral: F,
    actuator: F,
    output: F,
    link: F,
    /// Controller output of the last tick.
    held: F,
    duty: F,
    bus: F,
    effort: F,
    /// Effort, and effort before any loss of torque, at the start of the step.
    began: [F; 2],
    /// Effort before any loss of torque: what the current shows.
    electrical: F,
    /// Travel of dry friction that sticks.
    bristle: F,
    heat: F,
    /// Inertia times the last acceleration.
    inertial: F,
    history: Vec<(F, F)>,
    at: usize,
    /// Positions as the controller saw them, newest first.
    seen: [F; SEEN],
}

fn zero() -> F {
    F::splat(0.0)
}

/// `x` between `low` and `high`; `low <= high`.
fn clamp(x: F, low: F, high: F) -> F {
    x.fast_max(low).fast_min(high)
}

fn sign_of(x: F) -> F {
    let one = F::splat(1.0);
    x.simd_lt(zero()).select(-one, one)
}

/// Sine of every lane: the polynomial of [`crate::math::sin`], rounding by the floating-point adder.
fn sin(x: F) -> F {
    // 1.5 * 2^52: adding it leaves the nearest whole number in the last bits.
    const MAGIC: f64 = 6_755_399_441_055_744.0;
    let k = (x * F::splat(std::f64::consts::FRAC_1_PI) + F::splat(MAGIC)) - F::splat(MAGIC);
    let r = x - k * F::splat(std::f64::consts::PI);
    let r2 = r * r;
    let mut p = F::splat(-1.0 / 1_307_674_368_000.0);
    for c in [
        1.0 / 6_227_020_800.0,
        -1.0 / 39_916_800.0,
        1.0 / 362_880.0,
        -1.0 / 5040.0,
        1.0 / 120.0,
        -1.0 / 6.0,
    ] {
        p = F::splat(c) + r2 * p;
    }
    let s = r + r * r2 * p;
    // Odd k: half of it is not whole.
    let half = k * F::splat(0.5);
    let whole = (half + F::splat(MAGIC)) - F::splat(MAGIC);
    half.simd_ne(whole).select(-s, s)
}

/// `exp(-x)` of every lane for `x >= 0`: the series of `exp(x / 16)`, turned over and squared four times. Good to 1e-5
/// below x = 4 and always between 0 and 1.
fn decay(x: F) -> F {
    let z = x.fast_min(F::splat(48.0)) * F::splat(1.0 / 16.0);
    let mut p = F::splat(1.0 / 120.0);
    for c in [1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        p = F::splat(c) + z * p;
    }
    let mut e = F::splat(1.0) / p;
    for _ in 0..4 {
        e *= e;
    }
    e
}

impl State {
    fn new(run: &RunData, m: &Model<'_>) -> Self {
        let e = run.edges.first().copied();
        let (q, dq) = e.map_or((0.0, 0.0), |e| (e.position, e.velocity));
        let (q, dq) = (F::splat(q), F::splat(dq));
        let deepest = m.delay_steps.iter().copied().fold(0.0, f64::max);
        Self {
            q,
            dq,
            integral: zero(),
            actuator: zero(),
            output: q,
            link: q,
            held: zero(),
            duty: zero(),
            bus: m.supply,
            effort: zero(),
            began: [zero(); 2],
            electrical: zero(),
            bristle: zero(),
            heat: zero(),
            inertial: zero(),
            history: vec![(q, dq); deepest.ceil() as usize + 2],
            at: 0,
            seen: [q; SEEN],
        }
    }

    /// Encoder as the controller sees it.
    fn feedback(&mut self, m: &Model<'_>) -> (F, F) {
        if !m.used.feedback_delay {
            return (self.q, self.dq);
        }
        let n = self.history.len();
        self.history[self.at] = (self.q, self.dq);
        let (mut q, mut dq) = ([0.0; LANES], [0.0; LANES]);
        for (i, steps) in m.delay_steps.iter().enumerate() {
            let whole = *steps as usize;
            let part = steps - whole as f64;
            let a = &self.history[(self.at + n - whole) % n];
            let b = &self.history[(self.at + n - whole - 1) % n];
            let mix = |a: F, b: F| {
                let (a, b) = (a.as_array()[i], b.as_array()[i]);
                a + part * (b - a)
            };
            (q[i], dq[i]) = (mix(a.0, b.0), mix(a.1, b.1));
        }
        self.at = (self.at + 1) % n;
        (F::from(q), F::from(dq))
    }

    /// Speed as the difference of seen positions over some steps; over less than one, in part the exact speed.
    fn difference(&self, m: &Model<'_>, steps: &[f64; LANES], exact: F) -> F {
        let (mut out, mut share) = ([0.0; LANES], [0.0; LANES]);
        for (i, steps) in steps.iter().enumerate() {
            share[i] = steps.min(1.0);
            let steps = &steps.max(1.0);
            let whole = (*steps as usize).min(SEEN - 2);
            let part = steps - whole as f64;
            let at = |k: usize| self.seen[k].as_array()[i];
            let before = at(whole) + part * (at(whole + 1) - at(whole));
            out[i] = (at(0) - before) / steps;
        }
        exact + F::from(share) * (F::from(out) / m.dt - exact)
    }

    /// A stop takes all speed.
    fn stop(&mut self, [low, high]: &[f64; 2]) {
        if low.is_finite() || high.is_finite() {
            let held = clamp(self.q, F::splat(*low), F::splat(*high));
            self.dq = held.simd_ne(self.q).select(zero(), self.dq);
            self.q = held;
        }
    }

    fn restart(&mut self, position: f64, velocity: f64, running: bool, dt_s: f64) {
        (self.q, self.dq) = (F::splat(position), F::splat(velocity));
        (self.output, self.link, self.integral) = (self.q, self.q, zero());
        (self.inertial, self.bristle) = (zero(), zero());
        for (k, seen) in self.seen.iter_mut().enumerate() {
            *seen = self.q - self.dq * F::splat((k + 1) as f64 * dt_s);
        }
        if running {
            self.actuator = zero();
        }
    }
}

/// The joint's controller: set-point and encoder to controller output.
fn control(m: &Model<'_>, s: &mut State, sp: F, run: &RunData, tick: bool) -> F {
    if run.nominal.command != Command::Position {
        return clamp(sp, -m.limit, m.limit);
    }
    let (q, mut dq) = s.feedback(m);
    if let Some(steps) = &m.speed {
        s.seen.copy_within(0..SEEN - 1, 1);
        s.seen[0] = q;
        dq = s.difference(m, steps, dq);
    }
    if !tick {
        return s.held;
    }
    let mut e = sp - q;
    e -= clamp(e, -m.band, m.band);
    if run.nominal.ki != 0.0 {
        let bound = F::splat(run.nominal.limit / run.nominal.ki.abs());
        let slow = m.ticks_per_step.map(|_| F::splat(run.nominal.period_s));
        let next = clamp(s.integral + e * slow.unwrap_or(m.dt), -bound, bound);
        let asked = m.kp * e + m.ki * next - m.kd * dq;
        let held = s.integral + m.windup * (next - s.integral);
        s.integral = asked.abs().simd_gt(m.limit).select(held, next);
    }
    s.held = clamp(m.kp * e + m.ki * s.integral - m.kd * dq, -m.limit, m.limit);
    s.held
}

/// Whether the controller takes a new look at `step`.
fn ticks(m: &Model<'_>, step: usize) -> bool {
    // The small part keeps a tick that falls onto a step in that step.
    let count = |step: usize, per_step: f64| (step as f64 * per_step + 1e-6) as usize;
    m.ticks_per_step
        .is_none_or(|r| step == 0 || count(step, r) > count(step - 1, r))
}

/// Motor effort `a - b dq` that the drive gives.
fn drive(m: &Model<'_>, s: &mut State, u: F, output: Output) -> (F, F) {
    s.actuator += m.lag * (u - s.actuator);
    let u = s.actuator;
    let (mut a, mut b) = match output {
        Output::Duty | Output::Voltage => {
            let duty = if output == Output::Duty {
                u
            } else {
                u / m.supply
            };
            s.duty = duty;
            if m.used.sag {
                // Bus current is duty times motor current; solved for the voltage of this very step.
                let k = m.sag * duty / m.kt;
                let bus = (m.supply + k * m.ge * s.dq) / (F::splat(1.0) + k * m.gv * duty);
                let bus = clamp(bus, zero(), m.supply + m.supply);
                let above = (bus - m.supply).fast_max(zero());
                s.bus = bus - (F::splat(1.0) - m.regeneration) * above;
            }
            (m.gv * duty * s.bus, m.ge)
        }
        Output::Effort => (u * m.gv, zero()),
        Output::Velocity => {
            let v = clamp(u, -m.speed_limit, m.speed_limit);
            // Reaches its speed within the time constant of its inner loop, or a step, unless the effort limit stops it.
            let stiff = m.inertia / m.grip;
            (stiff * v, stiff)
        }
    };
    if m.used.limit {
        let now = a - b * s.dq;
        let beyond = now.abs().simd_gt(m.effort_limit);
        a = beyond.select(clamp(now, -m.effort_limit, m.effort_limit), a);
        b = beyond.select(zero(), b);
    }
    (a, b)
}

/// One step of the mechanics, given motor effort `a - b dq`.
fn mechanics(m: &Model<'_>, s: &mut State, electrical: (F, F), enabled: bool) {
    let (mut a, mut b) = electrical;
    if m.used.derate {
        let target = F::splat(if enabled { 1.0 } else { 0.0 });
        s.heat += (target - s.heat) * m.warming;
        let warm = F::splat(1.0) - m.derate * s.heat;
        (a, b) = (a * warm, b * warm);
    }
    let mut load = zero();
    if m.used.gravity {
        // Half a step ahead: the error of a step is then of third order.
        load -= m.gravity * sin(s.q + m.half * s.dq + m.mech);
    }
    let hanging = load;
    if m.used.ripple {
        let x = m.ripple[2] * s.q;
        load += m.ripple[0] * sin(x) + m.ripple[1] * sin(x + F::splat(std::f64::consts::FRAC_PI_2));
    }
    let speed = s.dq;
    let (mut viscous, mut dry) = (m.viscous, m.coulomb);
    if m.used.directional {
        let sign = speed
            .simd_ne(zero())
            .select(sign_of(speed), sign_of(a + load));
        viscous += sign * m.asymmetry_viscous + m.quadratic * speed.abs();
        dry += sign * m.asymmetry;
    }
    // What is proportional to speed decays as over a whole step of constant effort, to third order in the step.
    let one = F::splat(1.0);
    let x = m.k * (b + viscous);
    let grown = one + x * (F::splat(0.5) + x * F::splat(1.0 / 6.0));
    let inverse = one / (one + x * grown);
    let gain = m.k * grown * inverse;
    let free = speed * inverse + gain * (a + load);
    if m.used.stribeck {
        // The speed that this friction leaves; that of the last step tells how much there is.
        let more = |v: F| {
            let x = v / m.stribeck_speed;
            m.stick * decay(x * x)
        };
        let left = free.abs() - gain * (dry + more(speed));
        dry += more(left.fast_max(zero()));
    }
    if m.used.load {
        // What the gear transmits: the hanging load, and the inertia behind the gear as it was accelerated last.
        let moved = (m.behind * s.inertial - hanging).abs();
        let pressed = (a - b * speed).abs().fast_max(hanging.abs());
        dry += m.load_share * (moved + m.load_of * (pressed - moved));
    }
    s.dq = slide(m, s, free, gain, dry.fast_max(zero()));
    // A trapezium, less what the decay bends it.
    s.q += m.half * (speed + s.dq + x * F::splat(1.0 / 6.0) * (s.dq - speed));
    s.inertial = (s.dq - speed) / m.k;
    s.began = [a - b * speed, electrical.0 - electrical.1 * speed];
    s.effort = a - b * s.dq;
    s.electrical = electrical.0 - electrical.1 * s.dq;
    // A run that blows up, or became NaN, is parked far away.
    let sane = s.q.abs().simd_le(F::splat(1e6));
    s.q = sane.select(s.q, F::splat(1e6));
    s.dq = sane.select(s.dq, zero());
}

/// Speed after a step under dry friction: an effort that stops it within the step if it can. Friction that gives is a
/// spring up to where it slides, its effort taken at the end of the step.
fn slide(m: &Model<'_>, s: &mut State, free: F, gain: F, dry: F) -> F {
    let stopped = sign_of(free) * (free.abs() - gain * dry).fast_max(zero());
    if !m.used.give {
        return stopped;
    }
    let gives = (m.give * dry).simd_gt(zero());
    let stiffness = gives.select(dry / m.give, zero());
    let held = (free - gain * stiffness * s.bristle) / (F::splat(1.0) + gain * stiffness * m.dt);
    let effort = clamp(stiffness * (s.bristle + held * m.dt), -dry, dry);
    s.bristle = gives.select(effort / stiffness, zero());
    gives.select(free - gain * effort, stopped)
}

fn play(out: F, input: F, half: F) -> F {
    clamp(out, input - half, input + half)
}

/// Angle behind play and twist, quasi-static.
fn transmission(m: &Model<'_>, s: &mut State) {
    if m.used.play || m.used.twist {
        let gravity = m.gravity * sin(s.link + m.mech);
        let target = s.q - m.flexibility * gravity;
        // The load presses the link to one flank; it crosses when the load turns.
        let full = F::splat(0.05) * m.gravity.abs() + F::splat(1e-300);
        let pressed = clamp(gravity / full, F::splat(-1.0), F::splat(1.0));
        let loaded = play(s.link, target - m.play * pressed, F::splat(0.2) * m.play);
        let hanging = m.gravity.abs().simd_gt(zero());
        s.link = hanging.select(loaded, play(s.link, target, m.play));
    } else {
        s.link = s.q;
    }
    s.output = if m.used.output_play {
        play(s.output, s.q, m.output_play)
    } else {
        s.q
    };
}

fn outputs(m: &Model<'_>, s: &State, applied: F) -> Row {
    [
        s.output * m.record_scale,
        s.electrical / m.kt,
        s.duty,
        s.bus,
        s.link + m.mech,
        s.effort,
        applied,
    ]
}

/// Simulates a run for up to eight parameter sets with step `dt_s`; one entry per row.
pub fn simulate_lanes(run: &RunData, params: &[Params], dt_s: f64, trace: &mut Vec<Row>) {
    trace.clear();
    let m = resolve(run, params, dt_s);
    let mut s = State::new(run, &m);
    let start = run.edges.first().map_or(0.0, |e| e.position);
    let mut commands = Commands::new(run, m.p, dt_s, start);
    let (mut applied, mut followed) = ([zero(); BLOCK], [zero(); BLOCK]);
    let (mut row, mut edge) = (0, 0);
    let mut enabled = true;
    let mut before = Before::of(&m, &s);
    let mut fresh = true;
    for block in (0..run.steps).step_by(BLOCK) {
        let count = BLOCK.min(run.steps - block);
        commands.fill(block, &mut applied[..count], &mut followed[..count]);
        for (k, (applied, sp)) in applied.iter().zip(&followed).take(count).enumerate() {
            let step = block + k;
            while let Some(e) = run.edges.get(edge).filter(|e| e.step <= step) {
                s.restart(e.position, e.velocity, step > 0, dt_s);
                enabled = e.enabled;
                before = Before::of(&m, &s);
                fresh = true;
                edge += 1;
            }
            let ab = if enabled {
                let tick = fresh || ticks(&m, step);
                fresh = false;
                let u = control(&m, &mut s, *sp, run, tick);
                drive(&m, &mut s, u, run.nominal.output)
            } else {
                (s.duty, s.actuator) = (zero(), zero());
                (zero(), zero())
            };
            mechanics(&m, &mut s, ab, enabled);
            s.stop(&run.nominal.travel);
            transmission(&m, &mut s);
            while let Some(x) = run.samples.get(row).filter(|x| x.step == step) {
                trace.push(blend(&m, &s, outputs(&m, &s, *applied), &before, x.part));
                row += 1;
            }
            before = Before::of(&m, &s);
        }
    }
    let last = trace.last().copied().unwrap_or([zero(); CHANNELS]);
    trace.resize(run.samples.len(), last);
}

/// Signals run on between steps. A row at the very instant of a step holds the duty that follows; current, voltage and
/// effort were read before the controller acted, after it, or in between: the data format does not say, a parameter does.
fn blend(m: &Model<'_>, s: &State, mut after: Row, before: &Before, part: f64) -> Row {
    let began = [s.began[1] / m.kt, s.began[0]];
    if part < AT_STEP {
        let mix = |early: F, late: F| early + m.read_after * (late - early);
        after[1] = mix(before.current, began[0]);
        after[3] = mix(before.bus, after[3]);
        after[5] = mix(before.effort, began[1]);
    }
    let between = |early: F, late: F| early + F::splat(part) * (late - early);
    if part >= AT_STEP {
        after[1] = between(began[0], after[1]);
        after[5] = between(began[1], after[5]);
    }
    after[0] = between(before.output * m.record_scale, after[0]);
    after[4] = between(before.link + m.mech, after[4]);
    after
}

/// A row within this part of a step is at its instant.
const AT_STEP: f64 = 1e-3;

/// Signals at the end of the last step.
struct Before {
    output: F,
    link: F,
    current: F,
    bus: F,
    effort: F,
}

impl Before {
    fn of(m: &Model<'_>, s: &State) -> Self {
        Self {
            output: s.output,
            link: s.link,
            current: s.electrical / m.kt,
            bus: s.bus,
            effort: s.effort,
        }
    }
}
