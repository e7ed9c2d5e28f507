//! What a data set states of a joint, and references for what it leaves out.

use files::dataset::{Bench, Command, ControllerKind, Output, Quantity};

/// Absolute nominal values of one run; [`crate::joint::Params`] scale them.
#[derive(Debug, Clone, PartialEq)]
pub struct Nominal {
    /// kg m^2 or kg.
    pub inertia: f64,
    /// Amplitude of the gravity effort, 0 where unknown.
    pub gravity: f64,
    /// Effort at standstill with the full supply.
    pub stall: f64,
    /// Speed at which the full supply gives no effort; infinite where effort follows voltage alone.
    pub no_load_speed: f64,
    /// Effort per ampere.
    pub effort_per_a: f64,
    /// Angles at which the joint stops; infinite where it does not.
    pub travel: [f64; 2],
    /// Supply, V.
    pub supply_v: f64,
    /// Proportional gain, output unit per rad.
    pub kp: f64,
    /// Integral gain.
    pub ki: f64,
    /// Velocity gain, output unit per rad/s.
    pub kd: f64,
    /// Period of the controller, s; 0 where unknown.
    pub period_s: f64,
    /// Largest controller output.
    pub limit: f64,
    /// Largest duty of a drive that is asked for a voltage: 1, infinite where no supply is stated.
    pub duty_limit: f64,
    /// Largest speed of a velocity servo.
    pub speed_limit: f64,
    /// Largest effort of an effort or velocity servo.
    pub effort_limit: f64,
    /// What the controller puts out.
    pub output: Output,
    /// What the set-point is.
    pub command: Command,
}

/// What of the nominal values is known, with relative 1-sigma tolerance; `None` = unknown and fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Known {
    /// Inertia.
    pub inertia: Option<f64>,
    /// Gravity effort.
    pub gravity: Option<f64>,
    /// Stall effort (or drive gain).
    pub stall: Option<f64>,
    /// No-load speed.
    pub speed: Option<f64>,
    /// Supply.
    pub supply: Option<f64>,
    /// Position gain.
    pub kp: Option<f64>,
    /// Velocity gain.
    pub kd: Option<f64>,
    /// Whether an effort unit is known at all.
    pub effort_unit: bool,
    /// Whether what limits the controller is known, or the command goes past it.
    pub limit: bool,
}

fn value(q: Option<Quantity>, otherwise: f64) -> f64 {
    q.map_or(otherwise, |q| q.value)
}

/// Relative tolerance where a file gives a value but none: 5 %, a usual data-sheet spread.
const DEFAULT_TOLERANCE: f64 = 0.05;

fn tolerance(q: Option<Quantity>) -> Option<f64> {
    q.map(|q| q.tolerance.unwrap_or(DEFAULT_TOLERANCE))
}

/// What is known of a bench.
#[must_use]
pub fn known(b: &Bench) -> Known {
    let c = &b.controller;
    let stall = tolerance(b.max_effort.or(b.effort_per_volt));
    let n = nominal(b);
    let all = [n.limit, n.duty_limit, n.effort_limit, n.speed_limit];
    let limited = all.iter().any(|x| x.is_finite());
    Known {
        limit: limited || b.command != Command::Position,
        inertia: tolerance(b.inertia),
        gravity: tolerance(b.gravity),
        stall,
        speed: tolerance(b.max_speed),
        supply: tolerance(b.supply_v),
        kp: tolerance(c.kp.filter(|_| c.kind != Some(ControllerKind::Cascade) || c.kv.is_some())),
        kd: tolerance(c.kd.or(c.kv)),
        effort_unit: b.inertia.is_some() || b.gravity.is_some() || stall.is_some(),
    }
}

/// Gains on the error and on the speed; unknown ones get a reference from which the fit starts.
fn gains(b: &Bench, output: Output, volts: f64, bandwidth: f64, top_speed: f64) -> (f64, f64) {
    let c = &b.controller;
    if c.kind == Some(ControllerKind::Cascade) {
        let full = match output {
            Output::Duty => 1.0,
            Output::Voltage => volts,
            Output::Effort | Output::Velocity => value(b.max_effort, 1.0),
        };
        let kv = value(c.kv, full / top_speed);
        return (value(c.kp, bandwidth) * kv, kv);
    }
    let kp = value(c.kp, 1.0);
    let otherwise = if damping_unknown(b, output) {
        kp / bandwidth
    } else {
        0.0
    };
    (kp, value(c.kd, otherwise))
}

/// Whether the controller may damp the joint to an unknown degree. A motor on a voltage damps itself, which the fit knows as its top speed.
fn damping_unknown(b: &Bench, output: Output) -> bool {
    let c = &b.controller;
    let given = c.kd.or(c.kv).is_some() || c.kind == Some(ControllerKind::P);
    b.command == Command::Position && output == Output::Effort && !given
}

/// Nominal values of one run; unknown ones get a reference from which the fit starts.
#[must_use]
pub fn nominal(b: &Bench) -> Nominal {
    // References where nothing is known: a joint that answers at 20 rad/s, 10 rad/s of top speed. The fit moves them freely.
    const BANDWIDTH_RAD_S: f64 = 20.0;
    const TOP_SPEED_RAD_S: f64 = 10.0;
    let c = &b.controller;
    // Of a servo that nothing is known of, a motor on a voltage is the best guess: its speed is damped.
    let guess = if c.kp.is_none() {
        Output::Duty
    } else {
        Output::Effort
    };
    let output = match b.command {
        Command::Position => c.output.unwrap_or(guess),
        Command::Effort => Output::Effort,
        Command::Voltage => Output::Voltage,
    };
    let supply_v = value(b.supply_v, 1.0);
    let full_volts = if output == Output::Duty || b.supply_v.is_some() {
        supply_v
    } else {
        1.0
    };
    let (kp, kd) = gains(b, output, full_volts, BANDWIDTH_RAD_S, TOP_SPEED_RAD_S);
    let inertia = b.inertia.map(|q| q.value);
    // Effort per unit of controller output at full supply.
    let given = b
        .effort_per_volt
        .map(|q| q.value * full_volts)
        .or(b.max_effort.map(|q| q.value));
    let gain = if output == Output::Duty {
        kp
    } else {
        kp / full_volts
    };
    let stall = match output {
        Output::Duty | Output::Voltage => given
            .unwrap_or(BANDWIDTH_RAD_S * BANDWIDTH_RAD_S * inertia.unwrap_or(1.0) / gain.max(1e-9)),
        Output::Effort | Output::Velocity => full_volts,
    };
    let inertia = inertia.unwrap_or(match output {
        Output::Velocity => value(b.max_effort, 1.0) / (BANDWIDTH_RAD_S * BANDWIDTH_RAD_S),
        _ => stall / full_volts.max(1e-9) * gain * full_volts / (BANDWIDTH_RAD_S * BANDWIDTH_RAD_S),
    });
    let follows_voltage = b.effort_per_volt.is_some() && b.max_speed.is_none();
    let emf = matches!(output, Output::Duty | Output::Voltage) && !follows_voltage;
    let no_load_speed = if emf {
        value(b.max_speed, TOP_SPEED_RAD_S)
    } else {
        f64::INFINITY
    };
    // Without a gain and without an effort the unit of the controller's output is anything.
    let unit = c.kp.is_some() || given.is_some();
    let default_limit = match output {
        Output::Duty if unit => 1.0,
        _ => f64::INFINITY,
    };
    // A drive of known voltage and top speed turns amperes into effort as it turns speed into volts.
    let effort_per_a = match (output, b.supply_v, b.max_speed) {
        (Output::Duty | Output::Voltage, ..) if emf => full_volts / no_load_speed,
        (Output::Duty | Output::Voltage, ..) => stall / full_volts.max(1e-9),
        (_, Some(volts), Some(speed)) => volts.value / speed.value,
        _ => 1.0,
    };
    let free = f64::INFINITY;
    Nominal {
        inertia,
        gravity: value(b.gravity, 0.0),
        travel: [f64::NEG_INFINITY, f64::INFINITY],
        stall,
        no_load_speed,
        effort_per_a,
        supply_v: full_volts,
        kp,
        ki: value(c.ki, 0.0),
        kd,
        period_s: value(c.period_s, 0.0).max(0.0),
        limit: value(c.limit.filter(|_| unit), default_limit),
        duty_limit: match output {
            Output::Voltage if b.supply_v.is_some() => 1.0,
            _ => free,
        },
        speed_limit: if output == Output::Velocity {
            value(b.max_speed, free)
        } else {
            free
        },
        effort_limit: if output == Output::Duty || output == Output::Voltage {
            free
        } else {
            value(b.max_effort, free)
        },
        output,
        command: b.command,
    }
}

/// Nominal values of one run; what is unknown is unknown for all runs alike, so it takes one common reference.
pub(super) fn run_nominal(b: &Bench, reference: &Nominal) -> Nominal {
    let mut n = nominal(b);
    let k = known(b);
    if k.stall.is_none() {
        n.stall = reference.stall;
        n.effort_per_a = reference.effort_per_a;
    }
    if k.inertia.is_none() {
        n.inertia = reference.inertia;
    }
    n
}
