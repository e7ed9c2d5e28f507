//! The nominal parameters that a fit may move.

use files::dataset::{Command, Output};

use super::{Free, Map, linear, log, measured};

use crate::joint::{Channel, Nominal, P, Params, Problem};
use crate::vocabulary::Effect;

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
        // It follows from torque and speed of the data sheet, so their tolerances add up in it. Without a voltage measurement
        // the supply's is one with them.
        let unseen = k.supply.filter(|_| !measured(problem, Channel::BusVoltage));
        let sheet = k.speed.filter(|_| n.no_load_speed.is_finite());
        let others = libm::hypot(sheet.unwrap_or(0.0), unseen.unwrap_or(0.0));
        out.push(log(P::Resistance, k.stall.map(|t| libm::hypot(t, others))));
        if n.no_load_speed.is_finite() {
            out.push(log(P::Motor, k.speed));
        }
        // A drive that is asked for a voltage reaches that of its bus, measured or not.
        let shows = measured(problem, Channel::BusVoltage) || n.output == Output::Voltage;
        if shows && k.supply.is_some() {
            out.push(log(P::Supply, k.supply));
        }
    }
}

/// How often the supply's logarithm is in that of a motor value that was computed from a supply, a torque and a speed measured
/// together: `V/speed` and `V^2/(speed torque)`.
fn supplies(p: P) -> f64 {
    match p {
        P::Motor => 1.0,
        P::Resistance => 2.0,
        _ => 0.0,
    }
}

/// Distance of a nominal parameter from what is stated, in tolerances; `None` where nothing is stated of it. A data sheet's torque
/// and speed hold at the stated supply; measured on the bench they hold at the real one, and an error of the stated supply is
/// in all that was computed from it. Which of the two, no data set says: the nearer one counts.
#[must_use]
pub fn pull(known: &[Free], p: P, params: &Params) -> Option<f64> {
    let own = |p: P| known.iter().find(|f| f.p == p && f.tolerance.is_some());
    let f = own(p)?;
    let sheet = f.pull(params.get(p)).abs();
    let Some(supply) = own(P::Supply).filter(|_| supplies(p) > 0.0) else {
        return Some(sheet);
    };
    let real = params.get(P::Supply);
    let rest = f.pull(params.get(p) / libm::pow(real, supplies(p)));
    Some(sheet.min(libm::hypot(rest, supply.pull(real))))
}

/// The base effect whose parameter `p` is.
#[must_use]
pub fn base_effect(p: P) -> Option<Effect> {
    match p {
        P::LoopGain => Some(Effect::LoopGain),
        P::Damping => Some(Effect::DampingGain),
        P::Motor | P::Ampere => Some(Effect::MotorConstant),
        P::Resistance => Some(Effect::WindingResistance),
        P::Strength => Some(Effect::TorqueLimit),
        P::Supply => Some(Effect::SupplyVoltage),
        P::Inertia => Some(Effect::Inertia),
        P::Gravity | P::Weight => Some(Effect::GravityLoad),
        _ => None,
    }
}

/// How gears, inner loops and recordings are built, which no data set states.
fn unstated(problem: &Problem, n: &Nominal, out: &mut Vec<Free>) {
    if n.output == Output::Velocity {
        // A velocity servo has an inner loop of its own: a few milliseconds, stated nowhere.
        out.push(habit(P::Grip, 0.2, 0.005));
        // A loop that holds its effort for a tick, the part `h` of what it droops by, leaves `1 - h` of an error a tick:
        // its time constant is shorter by `-ln(1 - h) / h`. That is a tenth for a fifth, and twice for four fifths; an
        // integrating loop droops less.
        let ratio = log(P::Droop, Some(0.1));
        out.push(Free {
            low: 0.5,
            high: 2.0,
            ..ratio
        });
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A stated supply that is 4 % low, with a resistance computed from it 10 % low (the torque takes the rest), is within its
    /// tolerances; the same resistance beside a right supply, or one that the supply cannot mend, is not.
    #[test]
    fn an_error_of_the_stated_supply_is_no_strain_of_what_was_computed_from_it() {
        let known = [log(P::Resistance, Some(0.03)), log(P::Supply, Some(0.03))];
        let cases = [
            (1.10, 1.04, true),
            (0.90, 0.96, true),
            (1.10, 1.00, false),
            (1.10, 0.96, false),
            (1.30, 1.15, false),
            (1.00, 1.20, true),
        ];
        for (resistance, supply, within) in cases {
            let params = Params::default()
                .with(P::Resistance, resistance)
                .with(P::Supply, supply);
            let pull = pull(&known, P::Resistance, &params);
            assert_eq!(
                pull.map(|x| x < 3.0),
                Some(within),
                "{resistance} at {supply}: {pull:?}"
            );
        }
    }

    #[test]
    fn what_is_not_stated_has_no_pull() {
        let known = [log(P::Resistance, None)];
        assert_eq!(pull(&known, P::Resistance, &Params::default()), None);
        assert_eq!(pull(&known, P::Motor, &Params::default()), None);
    }

    /// The place of a nominal value that was taken off is that of the effect whose name it is told under.
    #[test]
    fn a_base_effect_acts_where_its_parameter_does() {
        for p in P::ALL {
            if let Some(e) = base_effect(*p) {
                assert!(e.is_base(), "{p:?}");
                assert_eq!(e.stage(), crate::locate::stage_of(*p), "{p:?}");
            }
        }
    }
}
