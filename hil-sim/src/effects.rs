//! Switches effects on by the names and keys that files, code and reports share.
//!
//! Covers the stages conventions to transmission, and a few effects that no vocabulary holds ([`OUTSIDE`]): cases that
//! a diagnosis must call unknown. A neutral value leaves the world bit-identical to one without the effect.

use thiserror::Error;

use crate::world::{JointSetup, WorldParams};

/// Effects of the shared vocabulary that act on motors, drivers or supply, with their keys.
pub const VOCABULARY: &[(&str, &[&str])] = &[
    ("joint_order", &["permutation"]),
    ("joint_sign", &["sign"]),
    ("joint_scale", &["ratio"]),
    ("joint_offset", &["offset_rad"]),
    ("latency", &["delay_s"]),
    ("jitter", &["sigma_s"]),
    ("packet_loss", &["probability"]),
    ("quantisation", &["step_rad"]),
    ("clock_skew", &["ratio"]),
    ("loop_gain", &["ratio"]),
    ("damping_gain", &["ratio"]),
    ("deadband", &["half_width_rad"]),
    ("velocity_limit", &["limit_rad_s"]),
    ("feedback_delay", &["delay_s"]),
    ("motor_lag", &["time_constant_s"]),
    ("motor_constant", &["ratio"]),
    ("winding_resistance", &["ratio"]),
    ("current_limit", &["limit_a"]),
    ("torque_limit", &["limit_nm"]),
    ("thermal_derating", &["time_constant_s", "fraction"]),
    ("supply_voltage", &["value_v"]),
    ("supply_sag", &["resistance_ohm"]),
    ("coulomb_friction", &["torque_nm"]),
    ("viscous_friction", &["nm_s_rad"]),
    ("stribeck_friction", &["static_nm", "velocity_rad_s"]),
    ("load_dependent_friction", &["fraction"]),
    (
        "asymmetric_friction",
        &["difference_nm", "difference_nm_s_rad"],
    ),
    ("quadratic_friction", &["nm_s2_rad2"]),
    ("torque_ripple", &["amplitude_nm", "periods", "phase_rad"]),
    ("inertia", &["ratio"]),
    ("gravity_load", &["ratio"]),
    ("backlash", &["half_width_rad"]),
    ("compliance", &["stiffness_nm_rad"]),
];

/// Effects outside the vocabulary, with their keys.
pub const OUTSIDE: &[(&str, &[&str])] = &[
    ("position_friction", &["torque_nm", "periods"]),
    ("hysteretic_spring", &["stiffness_nm_rad", "yield_rad"]),
    ("zero_drift", &["rad_s"]),
    ("asymmetric_gain", &["fraction"]),
];

/// Why an effect could not be set.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum EffectError {
    /// No such effect here.
    #[error(
        "no effect `{effect}` of motors, drivers or supply; body and camera effects belong to the physics model"
    )]
    UnknownEffect {
        /// Name given.
        effect: String,
    },
    /// The effect has no such parameter.
    #[error("effect `{effect}` has no parameter `{key}`; it has {known}")]
    UnknownKey {
        /// Effect.
        effect: String,
        /// Key given.
        key: String,
        /// Keys that exist, comma separated.
        known: String,
    },
    /// No such joint.
    #[error("joint {joint} does not exist: the world has joints 0 to {last}")]
    NoJoint {
        /// Joint given.
        joint: usize,
        /// Last joint.
        last: usize,
    },
    /// A value that no effect can have.
    #[error("{effect}.{key} = {value} is no usable value")]
    BadValue {
        /// Effect.
        effect: String,
        /// Key.
        key: String,
        /// Value given.
        value: f64,
    },
}

/// Sets one parameter of an effect, on one joint or (with `None`) on all.
///
/// # Errors
/// Unknown effect, key or joint, or a value that is not a number. Ranges are checked when the world is made.
pub fn set(
    world: &mut WorldParams,
    effect: &str,
    joint: Option<usize>,
    key: &str,
    value: f64,
) -> Result<(), EffectError> {
    check(effect, key, value)?;
    match (effect, key) {
        ("supply_voltage", _) => world.supply.voltage_v = value,
        ("supply_sag", _) => world.supply.resistance_ohm = value,
        ("joint_order", _) => permute(world, value)?,
        _ => {
            for setup in chosen(world, joint)? {
                set_driver(setup, effect, value);
                set_electrical(setup, effect, key, value);
                set_mechanical(setup, effect, key, value);
            }
        }
    }
    Ok(())
}

fn check(effect: &str, key: &str, value: f64) -> Result<(), EffectError> {
    let Some((_, keys)) = VOCABULARY
        .iter()
        .chain(OUTSIDE)
        .find(|(name, _)| *name == effect)
    else {
        return Err(EffectError::UnknownEffect {
            effect: effect.to_owned(),
        });
    };
    if !keys.contains(&key) {
        let (effect, key) = (effect.to_owned(), key.to_owned());
        return Err(EffectError::UnknownKey {
            effect,
            key,
            known: keys.join(", "),
        });
    }
    // Signs are +-1; probabilities and the supply have no other check behind them.
    let usable = match effect {
        "joint_sign" => value.abs() == 1.0,
        "packet_loss" => (0.0..=1.0).contains(&value),
        "supply_voltage" | "supply_sag" | "latency" | "jitter" | "quantisation" | "deadband"
        | "motor_lag" => (0.0..=100.0).contains(&value),
        "feedback_delay" => (0.0..=1.0).contains(&value),
        "clock_skew" => (0.5..=2.0).contains(&value),
        "loop_gain" | "damping_gain" => (0.0..=100.0).contains(&value),
        "joint_scale" => value != 0.0 && value.abs() <= 100.0,
        "joint_offset" | "gravity_load" => value.abs() <= 100.0,
        "velocity_limit" => value > 0.0,
        _ => !value.is_nan(),
    };
    if usable {
        Ok(())
    } else {
        Err(EffectError::BadValue {
            effect: effect.to_owned(),
            key: key.to_owned(),
            value,
        })
    }
}

fn chosen(world: &mut WorldParams, joint: Option<usize>) -> Result<&mut [JointSetup], EffectError> {
    let count = world.joints.len();
    match joint {
        None => Ok(&mut world.joints),
        Some(joint) => world
            .joints
            .get_mut(joint..=joint)
            .ok_or(EffectError::NoJoint {
                joint,
                last: count.saturating_sub(1),
            }),
    }
}

fn set_driver(setup: &mut JointSetup, effect: &str, value: f64) {
    let driver = &mut setup.driver;
    match effect {
        "joint_sign" => driver.convention.sign = value,
        "joint_scale" => driver.convention.scale = value,
        "joint_offset" => driver.convention.offset_rad = value,
        "latency" => driver.transport.latency_s = value,
        "jitter" => driver.transport.jitter_s = value,
        "packet_loss" => driver.transport.loss_probability = value,
        "quantisation" => driver.transport.quantisation_rad = value,
        "clock_skew" => driver.transport.clock_ratio = value,
        "loop_gain" => driver.control.loop_gain_ratio = value,
        "damping_gain" => driver.control.damping_gain_ratio = value,
        "deadband" => driver.control.deadband_half_width_rad = value,
        "velocity_limit" => driver.control.velocity_limit_rad_s = value,
        "feedback_delay" => driver.control.feedback_delay_s = value,
        "motor_lag" => driver.control.motor_lag_s = value,
        _ => {}
    }
}

fn set_electrical(setup: &mut JointSetup, effect: &str, key: &str, value: f64) {
    let electrical = &mut setup.joint.electrical;
    match (effect, key) {
        ("motor_constant", _) => electrical.motor_constant_ratio = value,
        ("winding_resistance", _) => electrical.winding_resistance_ratio = value,
        ("current_limit", _) => electrical.current_limit_a = value,
        ("torque_limit", _) => electrical.torque_limit_nm = value,
        ("thermal_derating", "time_constant_s") => electrical.derating_time_constant_s = value,
        ("thermal_derating", _) => electrical.derating_fraction = value,
        _ => {}
    }
}

fn set_mechanical(setup: &mut JointSetup, effect: &str, key: &str, value: f64) {
    let joint = &mut setup.joint;
    match (effect, key) {
        ("coulomb_friction", _) => joint.friction.coulomb_nm = value,
        ("viscous_friction", _) => joint.friction.viscous_nm_s_rad = value,
        ("stribeck_friction", "static_nm") => joint.friction.static_nm = value,
        ("stribeck_friction", _) => joint.friction.stribeck_rad_s = value,
        ("load_dependent_friction", _) => joint.friction.load_fraction = value,
        ("asymmetric_friction", "difference_nm") => joint.friction.asymmetry_nm = value,
        ("asymmetric_friction", _) => joint.friction.asymmetry_nm_s_rad = value,
        ("quadratic_friction", _) => joint.friction.quadratic_nm_s2_rad2 = value,
        ("torque_ripple", "amplitude_nm") => joint.ripple.amplitude_nm = value,
        ("torque_ripple", "periods") => joint.ripple.periods = value,
        ("torque_ripple", _) => joint.ripple.phase_rad = value,
        ("inertia", _) => {
            joint.inertia_ratio = value;
            setup.load.inertia_kg_m2 *= value;
        }
        ("gravity_load", _) => setup.load.gravity_nm *= value,
        ("backlash", _) => joint.transmission.backlash_half_width_rad = value,
        ("compliance", _) => joint.transmission.stiffness_nm_rad = value,
        ("position_friction", "torque_nm") => joint.friction.position_nm = value,
        ("position_friction", _) => joint.friction.position_periods = value,
        ("hysteretic_spring", "stiffness_nm_rad") => joint.extra.hysteresis_nm_rad = value,
        ("hysteretic_spring", _) => joint.extra.hysteresis_yield_rad = value,
        ("zero_drift", _) => joint.extra.zero_drift_rad_s = value,
        ("asymmetric_gain", _) => joint.extra.gain_asymmetry = value,
        _ => {}
    }
}

/// Rewires the bus addresses by the permutation of this index in lexicographic order.
fn permute(world: &mut WorldParams, index: f64) -> Result<(), EffectError> {
    let count = world.joints.len();
    let permutations: usize = (1..=count).product();
    let bad = || EffectError::BadValue {
        effect: "joint_order".to_owned(),
        key: "permutation".to_owned(),
        value: index,
    };
    if !(index >= 0.0 && index < permutations as f64 && libm::trunc(index) == index) {
        return Err(bad());
    }
    let mut left = index as usize;
    let mut ids: Vec<u8> = world.joints.iter().map(|setup| setup.id).collect();
    for (place, setup) in world.joints.iter_mut().enumerate() {
        let block: usize = (1..count - place).product();
        setup.id = ids.remove(left / block);
        left %= block;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::JointKind;

    fn world() -> WorldParams {
        WorldParams::metamodule(1, JointKind::neutral)
    }

    /// Names and keys are written here once more, so that reality does not lean on the diagnosis; they must still agree.
    #[test]
    fn names_and_keys_are_those_of_the_registry() {
        for (name, keys) in VOCABULARY {
            let effect = files::effects::Effect::from_name(name);
            let known: Vec<&str> = effect
                .expect(name)
                .parameters()
                .iter()
                .map(|p| p.key)
                .collect();
            assert_eq!(known, *keys, "{name}");
        }
        for (name, _) in OUTSIDE {
            assert_eq!(files::effects::Effect::from_name(name), None, "{name}");
        }
    }

    #[test]
    fn every_named_parameter_changes_something_on_its_joint_only() {
        for (effect, keys) in VOCABULARY.iter().chain(OUTSIDE) {
            for key in *keys {
                let mut changed = world();
                for setup in &mut changed.joints {
                    setup.load.gravity_nm = 1.0;
                }
                let before = changed.clone();
                let value = if *effect == "joint_sign" { -1.0 } else { 0.75 };
                let value = if *effect == "joint_order" { 7.0 } else { value };
                set(&mut changed, effect, Some(2), key, value).expect("known");
                assert_ne!(changed, before, "{effect}.{key} did nothing");
                if !effect.starts_with("supply") && *effect != "joint_order" {
                    assert_ne!(changed.joints[2], before.joints[2], "{effect}.{key}");
                    assert_eq!(changed.joints[3], before.joints[3], "{effect}.{key} leaked");
                }
            }
        }
    }

    #[test]
    fn permutations_are_lexicographic() {
        let ids = |index| {
            let mut w = world();
            set(&mut w, "joint_order", None, "permutation", index).expect("valid");
            w.joints.iter().map(|setup| setup.id).collect::<Vec<_>>()
        };
        assert_eq!(ids(0.0), [1, 2, 3, 4, 5, 6]);
        assert_eq!(ids(1.0), [1, 2, 3, 4, 6, 5]);
        assert_eq!(ids(719.0), [6, 5, 4, 3, 2, 1]);
    }

    #[test]
    fn errors_say_what_is_wrong() {
        let text = |effect, joint, key, value| {
            set(&mut world(), effect, joint, key, value)
                .expect_err("must fail")
                .to_string()
        };
        assert!(text("ground_slope", None, "roll_rad", 0.1).contains("physics model"));
        assert!(text("latency", None, "seconds", 0.1).contains("it has delay_s"));
        assert!(text("latency", Some(6), "delay_s", 0.1).contains("joints 0 to 5"));
        for (effect, key, value) in [
            ("packet_loss", "probability", 1.5),
            ("coulomb_friction", "torque_nm", f64::NAN),
            ("joint_order", "permutation", 720.0),
            ("joint_sign", "sign", 0.5),
            ("joint_scale", "ratio", 0.0),
            ("joint_scale", "ratio", f64::INFINITY),
            ("latency", "delay_s", -0.1),
            ("feedback_delay", "delay_s", 1.1),
            ("clock_skew", "ratio", 0.4),
            ("loop_gain", "ratio", -1.0),
            ("joint_offset", "offset_rad", f64::NAN),
            ("velocity_limit", "limit_rad_s", 0.0),
        ] {
            let said = text(effect, None, key, value);
            assert!(said.contains("no usable value"), "{effect} {value}: {said}");
        }
    }
}
