//! The nominal parameters that a fit may move.

use files::dataset::{Command, Output};

use super::{linear, log, measured};
use crate::fit::{Free, Map};
use crate::joint::{Channel, Nominal, P, Problem};

/// Nominal parameters that may move: within a tolerance where known, freely where not.
#[must_use]
pub fn nominal(problem: &Problem) -> Vec<Free> {
    let Some(n) = problem.runs.first().map(|r| &r.nominal) else {
        return Vec::new();
    };
    let mut out = Vec::new();
    plant(problem, n, &mut out);
    unstated(problem, n, &mut out);
    if n.command == Command::Position {
        controller(problem, n, &mut out);
    }
    out
}

fn volts(n: &Nominal) -> bool {
    matches!(n.output, Output::Duty | Output::Voltage)
}

/// Motor, load and supply.
fn plant(problem: &Problem, n: &Nominal, out: &mut Vec<Free>) {
    let k = problem.known;
    if k.effort_unit && (n.output != Output::Velocity || n.effort_limit.is_finite()) {
        out.push(log(P::Inertia, k.inertia));
    }
    if n.gravity != 0.0 {
        out.push(log(P::Gravity, k.gravity));
    } else if k.gravity.is_none() && n.output != Output::Velocity {
        // What a file does not state is unknown, not nought.
        out.push(linear(
            P::Weight,
            0.1 * n.stall,
            -1e3 * n.stall,
            1e3 * n.stall,
        ));
    }
    if !volts(n) && measured(problem, Channel::Current) {
        let known = k.speed.zip(k.supply).map(|(a, b)| libm::hypot(a, b));
        out.push(log(P::Ampere, known));
    }
    if volts(n) {
        // Without a voltage measurement the supply's tolerance is one with that of the winding resistance.
        let both = |a: f64, b: Option<f64>| (a * a + b.unwrap_or(0.0) * b.unwrap_or(0.0)).sqrt();
        out.push(log(
            P::Resistance,
            k.stall.map(|t| {
                if measured(problem, Channel::BusVoltage) {
                    t
                } else {
                    both(t, k.supply)
                }
            }),
        ));
        if n.no_load_speed.is_finite() {
            out.push(log(P::Motor, k.speed));
        }
        if measured(problem, Channel::BusVoltage) && k.supply.is_some() {
            out.push(log(P::Supply, k.supply));
        }
    }
}

/// How gears, inner loops and recordings are built, which no data set states.
fn unstated(problem: &Problem, n: &Nominal, out: &mut Vec<Free>) {
    if n.output == Output::Velocity {
        // A velocity servo has an inner loop of its own: a few milliseconds, stated nowhere.
        out.push(habit(P::Grip, 0.2, 0.005));
    }
    if n.effort_limit.is_finite() {
        out.push(log(P::Strength, problem.known.stall));
    }
    if n.output != Output::Velocity || n.effort_limit.is_finite() {
        // Teeth and bearings give before they slide, by a thousandth of the motion or so.
        out.push(Free {
            map: Map::Linear {
                scale: 1e-3 * problem.range,
            },
            ..habit(P::Give, 3e-3 * problem.range, 1.0)
        });
    }
    let electrical = [Channel::Current, Channel::BusVoltage, Channel::Effort];
    if electrical.iter().any(|c| measured(problem, *c)) {
        // When within a controller's tick a row's current was read is not said by a data set.
        out.push(habit(P::ReadAfter, 1.0, 1.0));
    }
}

/// The controller of a position.
fn controller(problem: &Problem, n: &Nominal, out: &mut Vec<Free>) {
    let k = problem.known;
    if !k.limit {
        let scale = 1.0 / (n.kp * problem.distance);
        out.push(linear(P::Tightness, scale, 0.0, 1e3 * scale));
    }
    if k.kp.is_some() || !volts(n) || k.stall.is_some() {
        out.push(log(P::LoopGain, k.kp.map(exact)));
    }
    if n.ki != 0.0 && n.limit.is_finite() {
        // Whether a saturated loop goes on integrating is stated nowhere.
        out.push(habit(P::Windup, 1.0, 1.0));
    }
    if n.kd > 0.0 {
        out.push(log(P::Damping, k.kd.map(exact)));
        if n.period_s > 0.0 {
            // A loop that differentiates its encoder sees the speed between half a period (one difference) and two
            // (a filtered one) late; a tachometer is not late at all.
            out.push(habit(P::SpeedDelay, 2.5, 0.5));
        }
    }
}

/// How a loop or a recording is built, from 0 to `high`; a prior, no gap.
fn habit(p: P, high: f64, tolerance: f64) -> Free {
    Free {
        p,
        map: Map::Linear { scale: 1.0 },
        low: 0.0,
        high,
        tolerance: Some(tolerance),
    }
}

/// Controller gains are numbers in a register: where a file gives no tighter tolerance than a data sheet's, they hold to 1 %.
fn exact(tolerance: f64) -> f64 {
    if (tolerance - 0.05).abs() < 1e-12 {
        0.01
    } else {
        tolerance.max(1e-3)
    }
}
