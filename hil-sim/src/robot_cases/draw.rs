//! Which causes a case plants, where, and how large.

use super::{KINDS, Planted, RobotCaseError};
use crate::bench_cases::log_uniform;
use crate::rng::Rng;

/// How a range is drawn: log-uniform in between, then made into a value.
#[derive(Clone, Copy, PartialEq)]
enum Form {
    /// As it is.
    Plain,
    /// With a random sign.
    Signed,
    /// exp(+-x).
    Ratio,
    /// 1 +- x.
    Near,
    /// 12 exp(-x): a voltage.
    Volt,
    /// Rounded.
    Whole,
    /// Uniform instead of log-uniform.
    Even,
    /// exp(-x).
    Less,
}

use Form::{Even, Less, Near, Plain, Ratio, Signed, Volt, Whole};

struct Range {
    key: &'static str,
    low: f64,
    high: f64,
    form: Form,
}

const fn r(key: &'static str, low: f64, high: f64, form: Form) -> Range {
    Range {
        key,
        low,
        high,
        form,
    }
}

struct Entry {
    effect: &'static str,
    per_joint: bool,
    ranges: &'static [Range],
}

const fn joint(effect: &'static str, ranges: &'static [Range]) -> Entry {
    Entry {
        effect,
        per_joint: true,
        ranges,
    }
}

const fn shared(effect: &'static str, ranges: &'static [Range]) -> Entry {
    Entry {
        effect,
        per_joint: false,
        ranges,
    }
}

/// From barely visible to large; parameters the nominal model holds start beyond three tolerances.
#[rustfmt::skip]
const LIBRARY: &[Entry] = &[
    shared("joint_order", &[r("permutation", 1.0, 719.0, Whole)]),
    joint("joint_sign", &[r("sign", -1.0, -1.0, Plain)]),
    joint("joint_scale", &[r("ratio", 0.02, 0.3, Near)]),
    joint("joint_offset", &[r("offset_rad", 0.02, 0.5, Signed)]),
    joint("latency", &[r("delay_s", 0.004, 0.12, Plain)]),
    joint("jitter", &[r("sigma_s", 0.008, 0.06, Plain)]),
    joint("packet_loss", &[r("probability", 0.03, 0.5, Plain)]),
    joint("quantisation", &[r("step_rad", 0.01, 0.2, Plain)]),
    shared("clock_skew", &[r("ratio", 0.001, 0.03, Near)]),
    joint("loop_gain", &[r("ratio", 0.2, 0.9, Ratio)]),
    joint("deadband", &[r("half_width_rad", 0.004, 0.08, Plain)]),
    joint("velocity_limit", &[r("limit_rad_s", 0.15, 1.0, Plain)]),
    joint("feedback_delay", &[r("delay_s", 0.004, 0.08, Plain)]),
    joint("motor_lag", &[r("time_constant_s", 0.005, 0.1, Plain)]),
    joint("motor_constant", &[r("ratio", 0.12, 0.5, Ratio)]),
    joint("winding_resistance", &[r("ratio", 0.12, 0.7, Ratio)]),
    joint("current_limit", &[r("limit_a", 0.05, 0.4, Plain)]),
    joint("torque_limit", &[r("limit_nm", 0.3, 1.6, Plain)]),
    joint("thermal_derating", &[r("time_constant_s", 2.0, 8.0, Plain), r("fraction", 0.1, 0.6, Plain)]),
    shared("supply_voltage", &[r("value_v", 0.08, 0.5, Volt)]),
    shared("supply_sag", &[r("resistance_ohm", 0.1, 2.0, Plain)]),
    joint("coulomb_friction", &[r("torque_nm", 0.05, 1.5, Plain)]),
    joint("viscous_friction", &[r("nm_s_rad", 0.06, 1.5, Plain)]),
    joint("stribeck_friction", &[r("static_nm", 0.1, 1.5, Plain), r("velocity_rad_s", 0.03, 0.2, Plain)]),
    joint("load_dependent_friction", &[r("fraction", 0.05, 0.5, Plain)]),
    joint("asymmetric_friction", &[r("difference_nm", 0.1, 1.0, Signed), r("difference_nm_s_rad", 0.0, 0.0, Plain)]),
    joint("quadratic_friction", &[r("nm_s2_rad2", 0.06, 1.2, Plain)]),
    joint("torque_ripple", &[r("amplitude_nm", 0.08, 0.8, Plain), r("periods", 4.0, 16.0, Whole), r("phase_rad", 0.1, 6.2, Even)]),
    joint("inertia", &[r("ratio", 0.5, 1.6, Ratio)]),
    joint("gravity_load", &[r("ratio", 0.2, 0.8, Ratio)]),
    joint("backlash", &[r("half_width_rad", 0.005, 0.1, Plain)]),
    joint("compliance", &[r("stiffness_nm_rad", 8.0, 200.0, Plain)]),
    shared("connector_compliance", &[r("stiffness_nm_rad", 3.0, 100.0, Plain)]),
    shared("connector_play", &[r("half_width_rad", 0.01, 0.15, Plain)]),
    shared("ground_friction", &[r("coefficient", 0.25, 1.6, Less)]),
    shared("friction_anisotropy", &[r("ratio", 0.2, 1.2, Ratio), r("direction_rad", 0.0, 3.1, Even)]),
    shared("torsional_friction", &[r("coefficient_m", 0.003, 0.05, Plain)]),
    shared("restitution", &[r("coefficient", 0.02, 0.95, Even)]),
    shared("ground_slope", &[r("roll_rad", 0.01, 0.12, Signed), r("pitch_rad", 0.01, 0.12, Signed)]),
    shared("ground_compliance", &[r("stiffness_n_m", 300.0, 4000.0, Plain), r("damping_n_s_m", 3.0, 30.0, Plain)]),
    shared("mass", &[r("ratio", 0.15, 0.5, Ratio)]),
    shared("com_offset", &[r("x_m", 0.004, 0.04, Signed), r("y_m", 0.004, 0.04, Signed), r("z_m", 0.004, 0.04, Signed)]),
    shared("camera_height", &[r("value_m", 0.05, 0.3, Ratio)]),
    shared("camera_offset", &[r("x_m", 0.02, 0.3, Signed), r("y_m", 0.02, 0.3, Signed)]),
    shared("camera_yaw", &[r("angle_rad", 0.02, 0.5, Signed)]),
    shared("camera_time_shift", &[r("shift_s", 0.1, 1.5, Signed)]),
    shared("frame_drop", &[r("probability", 0.05, 0.5, Plain)]),
];

/// Causes that no vocabulary holds.
#[rustfmt::skip]
const OUTSIDE: &[Entry] = &[
    joint("position_friction", &[r("torque_nm", 0.3, 1.5, Plain), r("periods", 3.0, 8.0, Whole)]),
    joint("hysteretic_spring", &[r("stiffness_nm_rad", 1.0, 6.0, Plain), r("yield_rad", 0.1, 0.4, Plain)]),
    joint("zero_drift", &[r("rad_s", 0.004, 0.04, Signed)]),
    joint("asymmetric_gain", &[r("fraction", 0.1, 0.4, Signed)]),
    shared("friction_drift", &[r("rate_1_s", 0.05, 0.3, Plain)]),
];

fn entry_of(effect: &str) -> Option<&'static Entry> {
    LIBRARY.iter().chain(OUTSIDE).find(|e| e.effect == effect)
}

/// Names of everything that can be planted.
pub fn effects() -> impl Iterator<Item = &'static str> {
    LIBRARY.iter().chain(OUTSIDE).map(|e| e.effect)
}

/// A cause by name with given parameters, in the order of its keys; missing ones are drawn.
///
/// # Errors
/// Unknown effect, a joint where none belongs or none where one does, more numbers than the effect has.
pub fn planted(
    effect: &str,
    on: Option<usize>,
    values: &[f64],
    seed: u64,
) -> Result<Planted, RobotCaseError> {
    let entry = entry_of(effect).ok_or_else(|| RobotCaseError::UnknownEffect {
        effect: effect.to_owned(),
    })?;
    if entry.per_joint != on.is_some() || on.is_some_and(|j| j >= super::JOINTS) {
        return Err(RobotCaseError::Joint {
            effect: entry.effect,
            per_joint: entry.per_joint,
        });
    }
    if values.len() > entry.ranges.len() {
        return Err(RobotCaseError::TooMany {
            effect: entry.effect,
            most: entry.ranges.len(),
        });
    }
    let mut planted = draw(&mut Rng::new(seed, 0xB3, 0), entry);
    planted.joint = on;
    planted.readings_too = false;
    for (slot, value) in planted.parameters.iter_mut().zip(values) {
        slot.1 = *value;
    }
    Ok(planted)
}

fn draw(rng: &mut Rng, entry: &Entry) -> Planted {
    let one = |rng: &mut Rng, range: &Range| {
        let x = match range.form {
            Even => range.low + (range.high - range.low) * rng.uniform(),
            _ if range.low > 0.0 => log_uniform(rng, range.low, range.high),
            _ => range.low,
        };
        let sign = if rng.chance(0.5) { 1.0 } else { -1.0 };
        let value = match range.form {
            Signed => sign * x,
            Ratio if range.key == "value_m" => super::CAMERA_HEIGHT_M * libm::exp(sign * x),
            Ratio => libm::exp(sign * x),
            Near => 1.0 + sign * x,
            Volt => super::SUPPLY_V * libm::exp(-x),
            Less => libm::exp(-x),
            Whole => libm::round(x),
            Plain | Even => x,
        };
        (range.key, value)
    };
    let on = (rng.uniform() * super::JOINTS as f64) as usize % super::JOINTS;
    let parameters = entry.ranges.iter().map(|range| one(rng, range)).collect();
    Planted {
        effect: entry.effect,
        joint: entry.per_joint.then_some(on),
        parameters,
        readings_too: entry.effect.starts_with("joint_") && rng.chance(0.5),
    }
}

/// Kind and causes of case number `index`: 25 % without effect, 40 % one, 25 % two or three, 10 % outside the library.
pub(super) fn causes(rng: &mut Rng) -> (&'static str, Vec<Planted>) {
    let x = rng.uniform();
    let kind = KINDS
        .iter()
        .find(|(_, until, _)| x < *until)
        .unwrap_or(&KINDS[0]);
    let (kind, count) = (kind.0, kind.2);
    let table = if kind == "outside" { OUTSIDE } else { LIBRARY };
    let mut planted: Vec<Planted> = Vec::new();
    while planted.len() < count {
        let entry = &table[(rng.uniform() * table.len() as f64) as usize % table.len()];
        if planted.iter().all(|p| p.effect != entry.effect) {
            planted.push(draw(rng, entry));
        }
    }
    (kind, planted)
}
