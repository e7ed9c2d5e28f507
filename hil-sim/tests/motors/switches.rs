//! Every effect, switched on at a plausible size, changes what a recording shows; and where its name says so.

use hil_sim::effects::{OUTSIDE, VOCABULARY, set};
use hil_sim::motor::JointKind;
use hil_sim::recorder::{Measured, Plan, Row, record};
use hil_sim::world::{World, WorldParams};

/// A loaded bench joint in a swing with reversals, at rest, and with a fast part that meets the limits.
fn motion(t_s: f64) -> Vec<f64> {
    let fast = if t_s > 6.0 {
        0.25 * (std::f64::consts::TAU * 1.5 * t_s).sin()
    } else {
        0.0
    };
    vec![0.6 * (std::f64::consts::TAU * 0.2 * t_s).sin() + fast]
}

fn run(effect: &[(&str, &str, f64)]) -> Vec<Measured> {
    let mut params = WorldParams::bench(1, JointKind::Intra.neutral());
    params.joints[0].load.gravity_nm = 1.5;
    params.joints[0].load.inertia_kg_m2 = 0.02;
    for (name, key, value) in effect {
        set(&mut params, name, Some(0), key, *value).expect("known");
    }
    let mut world = World::on_stand(&params).expect("valid");
    let plan = Plan {
        duration_s: 10.0,
        link: true,
        ..Plan::default()
    };
    let rows = record(&mut world, &[1], &plan, &mut motion).expect("healthy");
    rows.iter()
        .filter_map(|row| match row {
            Row::Reading { joints, .. } => joints[0],
            Row::SetPoints { .. } => None,
        })
        .collect()
}

/// Root mean square difference of two recordings in one signal.
fn rms(a: &[Measured], b: &[Measured], signal: fn(&Measured) -> f64) -> f64 {
    let sum: f64 = a
        .iter()
        .zip(b)
        .map(|(a, b)| (signal(a) - signal(b)).powi(2))
        .sum();
    (sum / a.len() as f64).sqrt()
}

const POSITION: fn(&Measured) -> f64 = |m| f64::from(m.feedback.position_urad) * 1e-6;
const CURRENT: fn(&Measured) -> f64 = |m| f64::from(m.feedback.current_ma) * 1e-3;
const LINK: fn(&Measured) -> f64 = |m| m.link_rad;
const VOLTAGE: fn(&Measured) -> f64 = |m| f64::from(m.feedback.voltage_5mv) * 5e-3;
const APPLIED: fn(&Measured) -> f64 = |m| f64::from(m.feedback.applied_urad) * 1e-6;

/// (effect with its sizes, signal in which it must show, least difference in that signal's unit)
type Case = (
    &'static [(&'static str, &'static str, f64)],
    fn(&Measured) -> f64,
    f64,
);

const CASES: &[Case] = &[
    (&[("joint_sign", "sign", -1.0)], LINK, 0.5),
    (&[("joint_scale", "ratio", 1.1)], LINK, 0.02),
    (&[("joint_offset", "offset_rad", 0.05)], LINK, 0.03),
    (&[("latency", "delay_s", 0.04)], APPLIED, 0.02),
    (&[("jitter", "sigma_s", 0.04)], APPLIED, 0.01),
    (&[("packet_loss", "probability", 0.2)], APPLIED, 0.01),
    (&[("quantisation", "step_rad", 0.02)], APPLIED, 0.004),
    (&[("clock_skew", "ratio", 1.02)], POSITION, 1e-4),
    (&[("loop_gain", "ratio", 0.7)], POSITION, 0.01),
    (&[("damping_gain", "ratio", 1.5)], POSITION, 0.01),
    (&[("deadband", "half_width_rad", 0.02)], POSITION, 0.005),
    (&[("velocity_limit", "limit_rad_s", 1.0)], POSITION, 0.01),
    (&[("feedback_delay", "delay_s", 0.004)], POSITION, 1e-3),
    (&[("motor_lag", "time_constant_s", 0.004)], POSITION, 1e-4),
    (&[("motor_constant", "ratio", 0.8)], CURRENT, 0.01),
    (&[("winding_resistance", "ratio", 1.5)], POSITION, 1e-3),
    (&[("current_limit", "limit_a", 0.4)], CURRENT, 0.02),
    (&[("torque_limit", "limit_nm", 2.0)], CURRENT, 0.01),
    (
        &[
            ("thermal_derating", "time_constant_s", 3.0),
            ("thermal_derating", "fraction", 0.3),
        ],
        CURRENT,
        0.02,
    ),
    (&[("supply_voltage", "value_v", 9.0)], VOLTAGE, 2.9),
    (&[("supply_sag", "resistance_ohm", 1.0)], VOLTAGE, 0.01),
    (&[("coulomb_friction", "torque_nm", 0.3)], CURRENT, 0.03),
    (&[("viscous_friction", "nm_s_rad", 0.3)], CURRENT, 0.02),
    (
        &[
            ("stribeck_friction", "static_nm", 0.4),
            ("stribeck_friction", "velocity_rad_s", 0.1),
        ],
        CURRENT,
        0.01,
    ),
    (
        &[("load_dependent_friction", "fraction", 0.2)],
        CURRENT,
        0.02,
    ),
    (
        &[
            ("asymmetric_friction", "difference_nm", 0.3),
            ("coulomb_friction", "torque_nm", 0.3),
        ],
        CURRENT,
        0.03,
    ),
    (
        &[
            ("asymmetric_friction", "difference_nm_s_rad", 0.3),
            ("viscous_friction", "nm_s_rad", 0.3),
        ],
        CURRENT,
        0.01,
    ),
    (&[("quadratic_friction", "nm_s2_rad2", 0.3)], CURRENT, 0.01),
    (
        &[
            ("torque_ripple", "amplitude_nm", 0.3),
            ("torque_ripple", "periods", 12.0),
            ("torque_ripple", "phase_rad", 0.5),
        ],
        CURRENT,
        0.02,
    ),
    (&[("inertia", "ratio", 2.0)], CURRENT, 0.01),
    (&[("gravity_load", "ratio", 1.5)], CURRENT, 0.04),
    (&[("backlash", "half_width_rad", 0.02)], LINK, 0.01),
    (&[("compliance", "stiffness_nm_rad", 60.0)], LINK, 0.008),
    (
        &[
            ("position_friction", "torque_nm", 0.4),
            ("position_friction", "periods", 5.0),
        ],
        CURRENT,
        0.02,
    ),
    (
        &[
            ("hysteretic_spring", "stiffness_nm_rad", 2.0),
            ("hysteretic_spring", "yield_rad", 0.2),
        ],
        CURRENT,
        0.03,
    ),
    (&[("zero_drift", "rad_s", 0.003)], LINK, 0.01),
    (&[("asymmetric_gain", "fraction", 0.2)], CURRENT, 0.01),
];

#[test]
fn every_effect_shows_where_its_name_says() {
    let plain = run(&[]);
    let mut seen = Vec::new();
    for (effect, signal, least) in CASES {
        let difference = rms(&plain, &run(effect), *signal);
        assert!(
            difference > *least,
            "{effect:?}: {difference} in its signal, at least {least} expected"
        );
        seen.extend(effect.iter().map(|(name, key, _)| (*name, *key)));
    }
    for (name, keys) in VOCABULARY
        .iter()
        .chain(OUTSIDE)
        .filter(|(name, _)| *name != "joint_order")
    {
        for key in *keys {
            assert!(
                seen.contains(&(*name, *key)),
                "{name}.{key} is not in the table above"
            );
        }
    }
}

/// The encoder is on the motor: play moves the link by far more than what the encoder sees.
#[test]
fn play_hides_from_the_encoder() {
    let plain = run(&[]);
    let loose = run(&[("backlash", "half_width_rad", 0.02)]);
    let (at_link, at_encoder) = (rms(&plain, &loose, LINK), rms(&plain, &loose, POSITION));
    assert!(
        at_link > 10.0 * at_encoder,
        "link {at_link}, encoder {at_encoder}"
    );
}
