//! Which causes a case plants, where, and how large.

use hil_sim::rng::Rng;

use super::{JOINTS, KINDS, Planted, RobotCaseError, Signal};
use crate::joint::log_uniform;
use crate::label::Scope;

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

/// From half of what can be seen to large; parameters that the nominal model holds start at about one tolerance.
#[rustfmt::skip]
const LIBRARY: &[Entry] = &[
    shared("joint_order", &[r("permutation", 1.0, 719.0, Whole)]),
    joint("joint_sign", &[r("sign", -1.0, -1.0, Plain)]),
    joint("joint_scale", &[r("ratio", 0.01, 0.3, Near)]),
    joint("joint_offset", &[r("offset_rad", 0.01, 0.5, Signed)]),
    joint("latency", &[r("delay_s", 0.004, 0.12, Plain)]),
    joint("jitter", &[r("sigma_s", 0.008, 0.06, Plain)]),
    joint("packet_loss", &[r("probability", 0.03, 0.5, Plain)]),
    joint("quantisation", &[r("step_rad", 0.01, 0.2, Plain)]),
    shared("clock_skew", &[r("ratio", 0.001, 0.03, Near)]),
    joint("loop_gain", &[r("ratio", 0.03, 0.9, Ratio)]),
    joint("deadband", &[r("half_width_rad", 0.004, 0.08, Plain)]),
    joint("velocity_limit", &[r("limit_rad_s", 0.15, 1.0, Plain)]),
    joint("feedback_delay", &[r("delay_s", 0.004, 0.08, Plain)]),
    joint("motor_lag", &[r("time_constant_s", 0.005, 0.1, Plain)]),
    joint("motor_constant", &[r("ratio", 0.03, 0.5, Ratio)]),
    joint("winding_resistance", &[r("ratio", 0.03, 0.7, Ratio)]),
    joint("current_limit", &[r("limit_a", 0.05, 0.4, Plain)]),
    joint("torque_limit", &[r("limit_nm", 0.3, 1.6, Plain)]),
    joint("thermal_derating", &[r("time_constant_s", 2.0, 8.0, Plain), r("fraction", 0.1, 0.6, Plain)]),
    shared("supply_voltage", &[r("value_v", 0.01, 0.5, Volt)]),
    shared("supply_sag", &[r("resistance_ohm", 0.1, 2.0, Plain)]),
    joint("coulomb_friction", &[r("torque_nm", 0.03, 1.5, Plain)]),
    joint("viscous_friction", &[r("nm_s_rad", 0.03, 1.5, Plain)]),
    joint("stribeck_friction", &[r("static_nm", 0.1, 1.5, Plain), r("velocity_rad_s", 0.03, 0.2, Plain)]),
    joint("load_dependent_friction", &[r("fraction", 0.05, 0.5, Plain)]),
    joint("asymmetric_friction", &[r("difference_nm", 0.1, 1.0, Signed), r("difference_nm_s_rad", 0.0, 0.0, Plain)]),
    joint("quadratic_friction", &[r("nm_s2_rad2", 0.06, 1.2, Plain)]),
    joint("torque_ripple", &[r("amplitude_nm", 0.08, 0.8, Plain), r("periods", 4.0, 16.0, Whole), r("phase_rad", 0.1, 6.2, Even)]),
    joint("inertia", &[r("ratio", 0.25, 1.6, Ratio)]),
    joint("gravity_load", &[r("ratio", 0.2, 0.8, Ratio)]),
    joint("backlash", &[r("half_width_rad", 0.005, 0.1, Plain)]),
    joint("compliance", &[r("stiffness_nm_rad", 8.0, 200.0, Plain)]),
    shared("connector_compliance", &[r("stiffness_nm_rad", 3.0, 100.0, Plain)]),
    shared("connector_play", &[r("half_width_rad", 0.01, 0.15, Plain)]),
    shared("ground_friction", &[r("coefficient", 0.06, 1.6, Less)]),
    shared("friction_anisotropy", &[r("ratio", 0.2, 1.2, Ratio), r("direction_rad", 0.0, 3.1, Even)]),
    shared("torsional_friction", &[r("coefficient_m", 0.003, 0.05, Plain)]),
    shared("restitution", &[r("coefficient", 0.02, 0.95, Even)]),
    shared("ground_slope", &[r("roll_rad", 0.01, 0.12, Signed), r("pitch_rad", 0.01, 0.12, Signed)]),
    shared("ground_compliance", &[r("stiffness_n_m", 300.0, 4000.0, Plain), r("damping_n_s_m", 3.0, 30.0, Plain)]),
    shared("mass", &[r("ratio", 0.02, 0.5, Ratio)]),
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
    if entry.per_joint != on.is_some() || on.is_some_and(|j| j >= JOINTS) {
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
    let mut rng = Rng::new(seed, 0xB3, 0);
    let drawn = entry.ranges.iter().map(|r| one(&mut rng, r, WHOLE));
    let mut planted = Planted {
        effect: entry.effect,
        joint: on,
        parameters: drawn.collect(),
        readings_too: false,
        cause: 0,
        scope: if on.is_some() {
            Scope::Joint
        } else {
            Scope::Robot
        },
    };
    for (slot, value) in planted.parameters.iter_mut().zip(values) {
        slot.1 = *value;
    }
    Ok(planted)
}

/// Stage of an effect; those that no vocabulary holds have one too.
pub(super) fn stage(effect: &str) -> &'static str {
    match effect {
        "position_friction" | "hysteretic_spring" => "drivetrain",
        "zero_drift" => "conventions",
        "asymmetric_gain" => "electrical",
        "friction_drift" => "body",
        name => files::effects::Effect::from_name(name).map_or("", |e| e.stage().name()),
    }
}

/// What a laboratory does not record: each signal is missing by its own chance.
pub(super) fn without(rng: &mut Rng) -> Vec<Signal> {
    let missing = |s: &Signal| match s {
        Signal::Echo | Signal::Bus | Signal::Inertial => 0.5,
        Signal::Velocity | Signal::Current => 0.4,
        Signal::Effort => 0.3,
        Signal::Duty => 0.6,
        Signal::Temperature => 0.8,
        Signal::Pose => 0.0,
    };
    let all = Signal::ALL.into_iter().filter(|s| *s != Signal::Pose);
    all.filter(|s| rng.chance(missing(s))).collect()
}

/// The part of a range, of its logarithm, that sizes are drawn from: all of it, or the middle where moderate causes
/// meet.
type Part = [f64; 2];
const WHOLE: Part = [0.0, 1.0];
const MIDDLE: Part = [0.3, 0.75];

fn one(rng: &mut Rng, range: &Range, part: Part) -> (&'static str, f64) {
    let x = match range.form {
        Even => range.low + (range.high - range.low) * rng.uniform(),
        _ if range.low > 0.0 => {
            let [low, high] = part.map(|p| range.low * libm::pow(range.high / range.low, p));
            log_uniform(rng, low, high)
        }
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
}

/// Scope of a cause of joints, and its joints: one joint as often as all, the rest the joints of one kind or module.
fn scope(rng: &mut Rng, effect: &str) -> (Scope, Vec<usize>) {
    let x = rng.uniform();
    if x < 0.38 || effect == "joint_sign" {
        let on = (rng.uniform() * JOINTS as f64) as usize % JOINTS;
        return (Scope::Joint, vec![on]);
    }
    let half = rng.chance(0.5);
    match x {
        x if x < 0.76 => (Scope::All, (0..JOINTS).collect()),
        x if x < 0.88 && half => (Scope::Kind, vec![1, 4]),
        x if x < 0.88 => (Scope::Kind, vec![0, 2, 3, 5]),
        _ if half => (Scope::Module, vec![0, 1, 2]),
        _ => (Scope::Module, vec![3, 4, 5]),
    }
}

/// The value of one of the joints that share a cause, which parts that wear differently spread by `factor`.
fn apart(form: Form, value: f64, factor: f64, sign: f64) -> f64 {
    match form {
        Plain => value * factor,
        Signed => sign * value * factor,
        Ratio => libm::pow(value, factor),
        Near => 1.0 + (value - 1.0) * factor,
        Volt | Whole | Even | Less => value,
    }
}

/// A cause, as its parts by joint.
fn draw(rng: &mut Rng, entry: &Entry, cause: usize, part: Part) -> Vec<Planted> {
    let parameters: Vec<(&'static str, f64)> =
        entry.ranges.iter().map(|r| one(rng, r, part)).collect();
    let readings_too = entry.effect.starts_with("joint_") && rng.chance(0.5);
    let whole = Planted {
        effect: entry.effect,
        joint: None,
        parameters,
        readings_too,
        cause,
        scope: Scope::Robot,
    };
    if !entry.per_joint {
        return vec![whole];
    }
    let (scope, joints) = scope(rng, entry.effect);
    let spread = if rng.chance(0.35) {
        0.0
    } else {
        0.05 + 0.35 * rng.uniform()
    };
    let of_joint = |rng: &mut Rng, joint: usize| {
        let mut planted = whole.clone();
        (planted.joint, planted.scope) = (Some(joint), scope);
        if scope != Scope::Joint && entry.ranges.first().is_some_and(|r| r.low > 0.0) {
            let factor = libm::exp(spread * rng.normal());
            let sign = if rng.chance(0.5) { 1.0 } else { -1.0 };
            for (slot, range) in planted.parameters.iter_mut().zip(entry.ranges).take(1) {
                slot.1 = apart(range.form, slot.1, factor, sign);
            }
        }
        planted
    };
    joints.into_iter().map(|j| of_joint(rng, j)).collect()
}

/// Kind and causes of a case: 25 % without effect, 41 % one, 26 % two or three, 8 % outside the library.
pub(super) fn causes(rng: &mut Rng) -> (&'static str, Vec<Planted>) {
    let x = rng.uniform();
    let kind = KINDS
        .iter()
        .find(|(_, until)| x < *until)
        .unwrap_or(&KINDS[0])
        .0;
    let count = match kind {
        "null" => 0,
        "several" => 2 + usize::from(rng.chance(0.4)),
        _ => 1,
    };
    let part = if count > 1 && rng.chance(0.6) {
        MIDDLE
    } else {
        WHOLE
    };
    let table = if kind == "outside" { OUTSIDE } else { LIBRARY };
    let mut planted: Vec<Planted> = Vec::new();
    for cause in 0..count {
        let entry = loop {
            let entry = &table[(rng.uniform() * table.len() as f64) as usize % table.len()];
            if planted.iter().all(|p| p.effect != entry.effect) {
                break entry;
            }
        };
        planted.extend(draw(rng, entry, cause, part));
    }
    (kind, planted)
}
