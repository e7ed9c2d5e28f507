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
fn sin<F: Lane>(x: F) -> F {
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
                u / m.supply
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
    let [mut a, mut b] = electrical;
    if m.used.derate {
        let target = F::splat(if enabled { 1.0 } else { 0.0 });
        s.heat += (target - s.heat) * m.warming;
        let warm = F::one() - m.derate * s.heat;
        (a, b) = (a * warm, b * warm);
    }
    let mut load = F::zero();
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
        let sign = F::select(speed.ne(F::zero()), speed.sign(), (a + load).sign());
        viscous += sign * m.asymmetry_viscous + m.quadratic * speed.abs();
        dry += sign * m.asymmetry;
    }
    // What is proportional to speed decays as over a whole step of constant effort, to third order in the step.
    let one = F::one();
    let x = m.k * (b + viscous);
    let grown = one + x * (F::splat(0.5) + x * F::splat(1.0 / 6.0));
    let inverse = one / (one + x * grown);
    let gain = m.k * grown * inverse;
    let free = speed * inverse + gain * (a + load);
    if m.used.stribeck {
        // The speed that this friction leaves; that of the last step tells how much there is.
        let left = free.abs() - gain * (dry + stribeck(m, speed));
        dry += stribeck(m, left.max(F::zero()));
    }
    if m.used.load {
        // What the gear transmits: the hanging load, and the inertia behind the gear as it was accelerated last.
        let moved = (m.behind * s.inertial - hanging).abs();
        let pressed = (a - b * speed).abs().max(hanging.abs());
        dry += m.load_share * (moved + m.load_of * (pressed - moved));
    }
    s.dq = slide(m, s, free, gain, dry.max(F::zero()));
    // A trapezium, less what the decay bends it.
    s.q += m.half * (speed + s.dq + x * F::splat(1.0 / 6.0) * (s.dq - speed));
    if m.used.load {
        s.inertial = (s.dq - speed) * m.per_k;
    }
    s.speeds = [speed, s.dq];
    (s.driven, s.electrical) = ([a, b], electrical);
    // A run that blows up, or became NaN, is parked far away.
    let far = F::splat(1e6);
    s.dq = F::select(s.q.abs().le(far), s.dq, F::zero());
    s.q = s.q.min(far).max(-far);
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

/// Angle behind play and twist, quasi-static.
#[inline(always)]
pub(super) fn transmission<F: Lane>(m: &Model<F>, s: &mut State<F>) {
    if m.used.play || m.used.twist {
        let gravity = m.gravity * sin(s.link + m.mech);
        let target = s.q - m.flexibility * gravity;
        // The load presses the link to one flank; it crosses when the load turns.
        let full = F::splat(0.05) * m.gravity.abs() + F::splat(1e-300);
        let pressed = (gravity / full).clamp(-F::one(), F::one());
        let loaded = play(s.link, target - m.play * pressed, F::splat(0.2) * m.play);
        let hanging = m.gravity.abs().gt(F::zero());
        s.link = F::select(hanging, loaded, play(s.link, target, m.play));
    } else {
        s.link = s.q;
    }
    s.output = if m.used.output_play {
        play(s.output, s.q, m.output_play)
    } else {
        s.q
    };
}
