//! Which causes a case plants, and how large.

use hil_sim::rng::Rng;

use super::{Planted, log_uniform, record};

/// Everything that is drawn before the recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Case name.
    pub name: String,
    /// Seed of disturbance and noise.
    pub seed: u64,
    /// Kind.
    pub kind: &'static str,
    /// Causes.
    pub planted: Vec<Planted>,
    /// Which channels are recorded.
    pub columns: [bool; record::CHANNELS],
    /// Stated inertia of the link, kg m^2.
    pub nominal_link_inertia: f64,
    /// Stated gravity effort, N m.
    pub nominal_gravity: f64,
    /// True over stated: inertia, gravity, supply, motor constant, resistance.
    pub ratios: [f64; 5],
}

/// A range of one parameter: log-uniform, optionally with a random sign.
struct Range {
    key: &'static str,
    low: f64,
    high: f64,
    /// 0: as it is; 1: random sign; 2: ratio exp(+-x); 3: 1 +- x.
    form: u8,
}

const fn r(key: &'static str, low: f64, high: f64, form: u8) -> Range {
    Range {
        key,
        low,
        high,
        form,
    }
}

/// From half of what can be seen to large; ratios of stated numbers start at about a tolerance.
const LIBRARY: &[(&str, &[Range])] = &[
    ("joint_sign", &[r("sign", -1.0, -1.0, 4)]),
    ("joint_scale", &[r("ratio", 0.01, 0.3, 3)]),
    ("joint_offset", &[r("offset_rad", 0.01, 0.3, 1)]),
    ("latency", &[r("delay_s", 0.003, 0.1, 0)]),
    ("quantisation", &[r("step_rad", 0.01, 0.2, 0)]),
    ("clock_skew", &[r("ratio", 0.0005, 0.02, 3)]),
    ("packet_loss", &[r("probability", 0.03, 0.4, 0)]),
    ("jitter", &[r("sigma_s", 0.008, 0.05, 0)]),
    ("loop_gain", &[r("ratio", 0.05, 0.7, 2)]),
    ("damping_gain", &[r("ratio", 0.2, 0.8, 2)]),
    ("deadband", &[r("half_width_rad", 0.002, 0.06, 0)]),
    ("velocity_limit", &[r("limit_rad_s", 0.3, 1.2, 0)]),
    ("feedback_delay", &[r("delay_s", 0.002, 0.015, 0)]),
    ("motor_lag", &[r("time_constant_s", 0.002, 0.03, 0)]),
    ("motor_constant", &[r("ratio", 0.03, 0.5, 2)]),
    ("winding_resistance", &[r("ratio", 0.03, 0.7, 2)]),
    ("current_limit", &[r("limit_a", 0.15, 0.7, 0)]),
    ("torque_limit", &[r("limit_nm", 0.6, 2.5, 0)]),
    (
        "thermal_derating",
        &[
            r("time_constant_s", 2.0, 8.0, 0),
            r("fraction", 0.1, 0.6, 0),
        ],
    ),
    ("supply_voltage", &[r("value_v", 0.02, 0.35, 5)]),
    ("supply_sag", &[r("resistance_ohm", 0.08, 1.0, 0)]),
    ("coulomb_friction", &[r("torque_nm", 0.03, 1.5, 0)]),
    ("viscous_friction", &[r("nm_s_rad", 0.05, 1.0, 0)]),
    (
        "stribeck_friction",
        &[
            r("static_nm", 0.1, 1.5, 0),
            r("velocity_rad_s", 0.03, 0.15, 0),
        ],
    ),
    ("load_dependent_friction", &[r("fraction", 0.04, 0.5, 0)]),
    ("asymmetric_friction", &[r("difference_nm", 0.1, 1.0, 1)]),
    ("quadratic_friction", &[r("nm_s2_rad2", 0.05, 0.8, 0)]),
    (
        "torque_ripple",
        &[
            r("amplitude_nm", 0.08, 0.8, 0),
            r("periods", 4.0, 16.0, 6),
            r("phase_rad", 0.1, 6.2, 0),
        ],
    ),
    ("inertia", &[r("ratio", 0.05, 1.0, 2)]),
    ("gravity_load", &[r("ratio", 0.03, 0.7, 2)]),
    ("backlash", &[r("half_width_rad", 0.003, 0.06, 0)]),
    ("compliance", &[r("stiffness_nm_rad", 20.0, 400.0, 0)]),
];

const OUTSIDE: &[(&str, &[Range])] = &[
    (
        "position_friction",
        &[r("torque_nm", 0.3, 1.5, 0), r("periods", 3.0, 8.0, 6)],
    ),
    (
        "hysteretic_spring",
        &[
            r("stiffness_nm_rad", 1.0, 6.0, 0),
            r("yield_rad", 0.1, 0.4, 0),
        ],
    ),
    ("zero_drift", &[r("rad_s", 0.002, 0.02, 1)]),
    ("asymmetric_gain", &[r("fraction", 0.1, 0.4, 1)]),
];

fn draw(rng: &mut Rng, entry: &(&'static str, &'static [Range])) -> Planted {
    let one = |range: &Range| {
        let x = if range.low > 0.0 {
            log_uniform(rng, range.low, range.high)
        } else {
            range.low
        };
        let sign = if rng.chance(0.5) { 1.0 } else { -1.0 };
        let value = match range.form {
            1 => sign * x,
            2 => libm::exp(sign * x),
            3 => 1.0 + sign * x,
            5 => 12.0 * libm::exp(-x),
            6 => libm::round(x),
            _ => x,
        };
        (range.key, value)
    };
    Planted {
        effect: entry.0,
        parameters: entry.1.iter().map(one).collect(),
    }
}

/// Stage of an effect; those that no vocabulary holds have one too.
pub(super) fn stage(effect: &str) -> &'static str {
    match effect {
        "position_friction" | "hysteretic_spring" => "drivetrain",
        "zero_drift" => "conventions",
        "asymmetric_gain" => "electrical",
        name => files::effects::Effect::from_name(name).map_or("", |e| e.stage().name()),
    }
}

/// Other names of the same: a limit of the motor is one of its current here.
pub(super) fn also(effect: &str) -> Vec<String> {
    match effect {
        "torque_limit" => vec!["current_limit".to_owned()],
        "current_limit" => vec!["torque_limit".to_owned()],
        _ => Vec::new(),
    }
}

/// Shares of the suite: 25 % without effect, 41 % one, 26 % two or three, 8 % outside the library. `index` beyond the
/// first 1000 makes nulls only, so that false alarms can be counted on many.
#[must_use]
pub fn plan(seed: u64, index: usize) -> Plan {
    let mut rng = Rng::new(seed, 0xB1, index as u64);
    let x = rng.uniform();
    let kind = match x {
        _ if index >= 1000 => "null",
        x if x < 0.25 => "null",
        x if x < 0.66 => "single",
        x if x < 0.92 => "several",
        _ => "outside",
    };
    let count = match kind {
        "null" => 0,
        "several" => 2 + usize::from(rng.chance(0.4)),
        _ => 1,
    };
    let mut planted: Vec<Planted> = Vec::new();
    while planted.len() < count {
        let table = if kind == "outside" { OUTSIDE } else { LIBRARY };
        let entry = &table[(rng.uniform() * table.len() as f64) as usize % table.len()];
        if planted.iter().all(|p| p.effect != entry.0) {
            planted.push(draw(&mut rng, entry));
        }
    }
    let tolerances = super::TOLERANCE.map(|t| t.1);
    let ratios = std::array::from_fn(|k| libm::exp(tolerances[k] * rng.normal()));
    Plan {
        name: format!("case_{index:04}"),
        seed: rng.next_u64(),
        kind,
        planted,
        // Encoder, current, duty, bus, link, applied set-point.
        columns: [1.0, 0.7, 0.6, 0.6, 0.3, 0.5].map(|p| rng.chance(p)),
        nominal_link_inertia: log_uniform(&mut rng, 0.01, 0.06),
        nominal_gravity: log_uniform(&mut rng, 0.8, 3.0),
        ratios,
    }
}
