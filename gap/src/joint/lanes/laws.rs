//! What happens within one step: controller, drive, mechanics, transmission.

use files::dataset::{Command, Output};

use super::resolve::Model;
use super::simd::{Lane, Lanes};
use super::state::{Memory, State};
use crate::joint::data::RunData;
use physics::laws;

/// Sine of every lane for |x| < 1e4 rad, error below 1e-10. Rounding by the floating-point adder comes first, then an odd polynomial of
/// degree 11 with the smallest error on half a turn (Lawson's iteration on 4001 points; 1.7e-11), in an order that waits least.
#[inline(always)]
pub(super) fn sin<F: Lane>(x: F) -> F {
    // 1.5 * 2^52: adding it leaves the nearest whole number in the last bits.
    let magic = F::splat(6_755_399_441_055_744.0);
    let k = (x * F::splat(std::f64::consts::FRAC_1_PI) + magic) - magic;
    let r = x - k * F::splat(std::f64::consts::PI);
    let r2 = r * r;
    let r4 = r2 * r2;
    let low = F::splat(-0.166_666_666_064_366_84) + F::splat(0.008_333_330_494_531_761) * r2;
    let high = F::splat(-0.000_198_408_038_993_286_45) + F::splat(2.752_261_193_841_611_6e-6) * r2;
    let p = low + r4 * (high + r4 * F::splat(-2.384_657_486_641_532e-8));
    let s = r + r * r2 * p;
    // Odd k: half of it is not whole.
    let half = k * F::splat(0.5);
    let whole = (half + magic) - magic;
    F::select(half.ne(whole), -s, s)
}

/// Dry friction above Coulomb's at speed `v`.
#[inline(always)]
fn stribeck<F: Lane>(m: &Model<F>, v: F) -> F {
    laws::stribeck::<Lanes<F>>(m.stick, v / m.stribeck_speed)
}

/// The joint's controller: set-point and encoder to controller output.
#[inline(always)]
pub(super) fn control<F: Lane>(
    m: &Model<F>,
    s: &mut State<F>,
    memory: &mut Memory,
    sp: F,
    run: &RunData,
    tick: bool,
) -> F {
    if run.nominal.command != Command::Position {
        return sp.clamp(-m.limit, m.limit);
    }
    let (q, mut dq) = memory.feedback(m, s);
    if let Some(steps) = &m.speed {
        dq = memory.difference(steps, q, dq);
    }
    if !tick {
        return s.held;
    }
    let e = laws::dead_zone::<Lanes<F>>(sp - q, m.band);
    if run.nominal.ki != 0.0 {
        let bound = F::splat(run.nominal.limit / run.nominal.ki.abs());
        let slow = m.ticks_per_step.map(|_| F::splat(run.nominal.period_s));
        let next = (s.integral + e * slow.unwrap_or(m.dt)).clamp(-bound, bound);
        let asked = m.kp * e + m.ki * next - m.kd * dq;
        let held = s.integral + m.windup * (next - s.integral);
        s.integral = F::select(asked.abs().gt(m.limit), held, next);
    }
    s.held = (m.kp * e + m.ki * s.integral - m.kd * dq).clamp(-m.limit, m.limit);
    s.held
}

/// Whether the controller takes a new look at `step`.
#[inline(always)]
pub(super) fn ticks<F: Lane>(m: &Model<F>, step: usize) -> bool {
    // The small part keeps a tick that falls onto a step in that step.
    let count = |step: usize, per_step: f64| (step as f64 * per_step + 1e-6) as usize;
    m.ticks_per_step
        .is_none_or(|r| step == 0 || count(step, r) > count(step - 1, r))
}

/// Motor effort `a - b dq` that the drive gives.
#[inline(always)]
pub(super) fn drive<F: Lane>(m: &Model<F>, s: &mut State<F>, u: F, output: Output) -> [F; 2] {
    s.actuator = if m.used.lag {
        s.actuator + m.lag * (u - s.actuator)
    } else {
        u
    };
    let u = s.actuator;
    let [mut a, mut b] = match output {
        Output::Duty | Output::Voltage => {
            let duty = if output == Output::Duty {
                u
            } else {
                // A drive that is asked for a voltage divides by that of its bus, and gives no more than it.
                (u / s.bus.max(F::splat(f64::MIN_POSITIVE))).clamp(-m.duty_limit, m.duty_limit)
            };
            s.duty = duty;
            if m.used.sag {
                // Bus current is duty times motor current; solved for the voltage of this very step.
                let k = m.sag * duty / m.kt;
                let bus = (m.supply + k * m.ge * s.dq) / (F::one() + k * m.gv * duty);
                let bus = bus.clamp(F::zero(), m.supply + m.supply);
                let above = (bus - m.supply).max(F::zero());
                s.bus = bus - (F::one() - m.regeneration) * above;
            }
            [m.gv * duty * s.bus, m.ge]
        }
        Output::Effort => [u * m.gv, F::zero()],
        Output::Velocity => {
            let v = u.clamp(-m.speed_limit, m.speed_limit);
            // Reaches its speed within the time constant of its inner loop, or a step, unless the effort limit stops it.
            [m.stiff * v, m.stiff]
        }
    };
    if m.used.limit {
        let now = a - b * s.dq;
        let beyond = now.abs().gt(m.effort_limit);
        a = F::select(beyond, now.clamp(-m.effort_limit, m.effort_limit), a);
        b = F::select(beyond, F::zero(), b);
    }
    [a, b]
}

/// One step of the mechanics, given motor effort `a - b dq`.
#[inline(always)]
pub(super) fn mechanics<F: Lane>(
    m: &Model<F>,
    s: &mut State<F>,
    electrical: [F; 2],
    enabled: bool,
) {
    let [a, b] = warmed(m, s, electrical, enabled);
    let mut load = F::zero();
    let mut k = m.k;
    if m.used.gravity {
        // Half a step ahead: the error of a step is then of third order.
        load -= m.gravity * sin(s.q + m.half * s.dq + m.mech);
    }
    let hanging = load;
    // No closure: one that is not inlined is compiled without its caller's instruction set.
    let elastic = if m.used.elastic {
        Some(Gear::new(m, s))
    } else {
        None
    };
    if let Some(gear) = &elastic {
        load = F::select(gear.gives, -gear.torque, load);
        k = F::select(gear.gives, m.k_motor, k);
    }
    if m.used.ripple {
        let x = m.ripple[2] * s.q;
        load += m.ripple[0] * sin(x) + m.ripple[1] * sin(x + F::splat(std::f64::consts::FRAC_PI_2));
    }
    let speed = s.dq;
    let (mut viscous, mut dry) = (m.viscous, m.coulomb);
    if m.used.directional {
        let sign = F::select(speed.ne(F::zero()), speed.sign(), (a + load).sign());
        viscous += sign * m.asymmetry_viscous + m.quadratic * speed.abs();
        dry += sign * m.asymmetry;
    }
    // What is proportional to speed decays as over a whole step of constant effort, to third order in the step.
    let one = F::one();
    // A velocity servo droops by its stiffness and decays by its time constant.
    let slow = k * (b + viscous);
    let (mut x, mut faster) = (slow, one);
    if m.used.droop {
        x = k * (b * m.droop + viscous);
        faster = F::select(slow.gt(F::zero()), x / slow, one);
    }
    let grown = one + x * (F::splat(0.5) + x * F::splat(1.0 / 6.0));
    let inverse = one / (one + x * grown);
    let mut gain = k * faster * grown * inverse;
    let mut free = speed * inverse + gain * (a + load);
    if let Some(gear) = &elastic {
        let held = one / (one + gain * F::select(gear.gives, gear.per_speed, F::zero()));
        (gain, free) = (gain * held, free * held);
    }
    if m.used.stribeck {
        // The speed that this friction leaves; that of the last step tells how much there is.
        let left = free.abs() - gain * (dry + stribeck(m, speed));
        dry += stribeck(m, left.max(F::zero()));
    }
    if m.used.load {
        let moved = transmitted(m, s, hanging, elastic.as_ref()).abs();
        let pressed = (a - b * speed).abs().max(hanging.abs());
        dry += m.load_share * (moved + m.load_of * (pressed - moved));
    }
    s.dq = slide(m, s, free, gain, dry.max(F::zero()));
    // A trapezium, less what the decay bends it.
    s.q += m.half * (speed + s.dq + x * F::splat(1.0 / 6.0) * (s.dq - speed));
    if m.used.load {
        s.inertial = (s.dq - speed) * m.per_k;
    }
    if let Some(gear) = &elastic {
        gear.turn(m, s);
    }
    s.speeds = [speed, s.dq];
    (s.driven, s.electrical) = ([a, b], electrical);
    // A run that blows up, or became NaN, is parked far away.
    let far = F::splat(1e6);
    s.dq = F::select(s.q.abs().le(far), s.dq, F::zero());
    s.q = s.q.min(far).max(-far);
}

/// Motor effort of a motor that warms.
#[inline(always)]
fn warmed<F: Lane>(m: &Model<F>, s: &mut State<F>, [a, b]: [F; 2], enabled: bool) -> [F; 2] {
    if !m.used.derate {
        return [a, b];
    }
    let target = F::splat(if enabled { 1.0 } else { 0.0 });
    s.heat += (target - s.heat) * m.warming;
    let warm = F::one() - m.derate * s.heat;
    [a * warm, b * warm]
}

/// What the gear transmits: the torque that turns it, or, of a rigid one, the hanging load, and the inertia behind it as it
/// was accelerated last.
#[inline(always)]
fn transmitted<F: Lane>(m: &Model<F>, s: &State<F>, hanging: F, gear: Option<&Gear<F>>) -> F {
    let rigid = m.behind * s.inertial - hanging;
    match gear {
        Some(gear) => F::select(gear.gives, s.torque, rigid),
        None => rigid,
    }
}

/// Speed after a step under dry friction: an effort that stops it within the step if it can. Friction that gives is a
/// spring up to where it slides, its effort taken at the end of the step.
#[inline(always)]
fn slide<F: Lane>(m: &Model<F>, s: &mut State<F>, free: F, gain: F, dry: F) -> F {
    let stopped = free.sign() * (free.abs() - gain * dry).max(F::zero());
    if !m.used.give {
        return stopped;
    }
    let gives = (m.give * dry).gt(F::zero());
    let stiffness = F::select(gives, dry / m.give, F::zero());
    let held = (free - gain * stiffness * s.bristle) / (F::one() + gain * stiffness * m.dt);
    let effort = (stiffness * (s.bristle + held * m.dt)).clamp(-dry, dry);
    s.bristle = F::select(gives, effort / stiffness, F::zero());
    F::select(gives, free - gain * effort, stopped)
}

#[inline(always)]
fn play<F: Lane>(out: F, input: F, half: F) -> F {
    out.clamp(input - half, input + half)
}

/// Damping ratio of a gear that gives, by the inertia of the rotor: gears ring for a few cycles.
const DAMPING: f64 = 0.1;

/// A gear with play that gives, between the rotor and the load: its torque over a step is the mean of those at both
/// ends (trapezium), `torque + per_speed v` with the rotor's speed `v` at the end.
struct Gear<F: Lane> {
    /// Lanes that have one; the others are rigid.
    gives: F::Mask,
    torque: F,
    per_speed: F,
    /// Torque at the speeds of the start, and what a difference of speed at the end adds.
    before: F,
    per_twist: F,
}

impl<F: Lane> Gear<F> {
    #[inline(always)]
    fn new(m: &Model<F>, s: &State<F>) -> Self {
        let zero = F::zero();
        let gives = m.stiffness.gt(zero);
        let (twist, turning) = (s.q - s.link, s.dq - s.link_dq);
        let near = twist + m.dt * turning;
        let beyond = near.abs().gt(m.play);
        let damping = F::splat(DAMPING) * (m.stiffness * m.rotor).sqrt();
        let per_twist = F::select(beyond, F::splat(0.5) * m.half * m.stiffness + damping, zero);
        let pressed = F::select(beyond, m.stiffness * (twist - near.sign() * m.play), zero);
        let before = pressed + per_twist * turning;
        let load = m.load_per_dt + per_twist;
        let moves = m.load_per_dt * s.link_dq + before + hangs(m, s);
        Self {
            gives,
            torque: before - per_twist * moves / load,
            per_speed: per_twist * m.load_per_dt / load,
            before,
            per_twist,
        }
    }

    /// The load's step, that of the rotor being done.
    #[inline(always)]
    fn turn(&self, m: &Model<F>, s: &mut State<F>) {
        let pull = self.before + self.per_twist * s.dq;
        let moves = m.load_per_dt * s.link_dq + pull + hangs(m, s);
        let after = moves / (m.load_per_dt + self.per_twist);
        let far = F::splat(1e6);
        let after = F::select(after.abs().le(far), after, F::zero());
        s.torque = pull - self.per_twist * after;
        s.link += m.half * (s.link_dq + after);
        s.link = s.link.min(far).max(-far);
        s.link_dq = after;
    }
}

/// Effort of gravity on the load, half a step ahead.
#[inline(always)]
fn hangs<F: Lane>(m: &Model<F>, s: &State<F>) -> F {
    if m.used.gravity {
        -(m.gravity * sin(s.link + m.half * s.link_dq + m.mech))
    } else {
        F::zero()
    }
}

/// Angles behind the gear and at the encoder.
#[inline(always)]
pub(super) fn transmission<F: Lane>(m: &Model<F>, s: &mut State<F>) {
    if m.used.elastic {
        let gives = m.stiffness.gt(F::zero());
        s.link = F::select(gives, s.link, s.q);
        s.link_dq = F::select(gives, s.link_dq, s.dq);
    } else {
        s.link = s.q;
    }
    s.output = if m.used.output_play {
        play(s.output, s.q, m.output_play)
    } else {
        s.q
    };
}
