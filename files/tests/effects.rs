//! The registry of effects: complete, in order, consistent in itself, and the source of the reference page.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use files::effects::{Effect, JointScales, Kind, Plant, Prior, Scale, Scope, page};
use std::path::Path;

/// A joint whose figures are all one, so that shares are what they say.
const ONE: JointScales = JointScales {
    torque_nm: 1.0,
    speed_rad_s: 1.0,
    current_a: 1.0,
    voltage_v: 1.0,
};

#[test]
fn rows_are_in_the_order_of_the_chain() {
    for (k, effect) in Effect::ALL.iter().enumerate() {
        let info = effect.info();
        assert_eq!((*effect as usize, info.effect), (k, *effect));
        assert_eq!(Effect::from_name(info.name), Some(*effect));
    }
    let stages = Effect::ALL.windows(2).map(|w| (w[0].stage(), w[1].stage()));
    for (before, after) in stages {
        assert!(before <= after, "{before:?} before {after:?}");
    }
}

/// Names and keys are a contract with every file that was written so far: this list grows at its end only.
#[test]
fn contract_names_and_keys_stay() {
    let mut text = String::new();
    for effect in Effect::ALL {
        let keys: Vec<&str> = effect.parameters().iter().map(|p| p.key).collect();
        text.push_str(&format!("{}({})\n", effect.name(), keys.join(",")));
    }
    let contract = "joint_order(permutation)\njoint_sign(sign)\njoint_scale(ratio)\njoint_offset(offset_rad)\nlatency(delay_s)\n\
        jitter(sigma_s)\npacket_loss(probability)\nquantisation(step_rad)\nclock_skew(ratio)\nloop_gain(ratio)\ndamping_gain(ratio)\n\
        deadband(half_width_rad)\nvelocity_limit(limit_rad_s)\nfeedback_delay(delay_s)\nmotor_lag(time_constant_s)\n\
        motor_constant(ratio)\nwinding_resistance(ratio)\ncurrent_limit(limit_a)\ntorque_limit(limit_nm)\n\
        thermal_derating(time_constant_s,fraction)\nsupply_voltage(value_v)\nsupply_sag(resistance_ohm)\ncoulomb_friction(torque_nm)\n\
        viscous_friction(nm_s_rad)\nstribeck_friction(static_nm,velocity_rad_s)\nload_dependent_friction(fraction)\n\
        asymmetric_friction(difference_nm,difference_nm_s_rad)\nquadratic_friction(nm_s2_rad2)\n\
        torque_ripple(amplitude_nm,periods,phase_rad)\ninertia(ratio)\ngravity_load(ratio)\nbacklash(half_width_rad)\n\
        compliance(stiffness_nm_rad)\nconnector_compliance(stiffness_nm_rad)\nconnector_play(half_width_rad)\n\
        ground_friction(coefficient)\nfriction_anisotropy(ratio,direction_rad)\ntorsional_friction(coefficient_m)\n\
        restitution(coefficient)\nground_slope(roll_rad,pitch_rad)\nground_compliance(stiffness_n_m,damping_n_s_m)\nmass(ratio)\n\
        com_offset(x_m,y_m,z_m)\ncamera_height(value_m)\ncamera_offset(x_m,y_m)\ncamera_yaw(angle_rad)\ncamera_time_shift(shift_s)\n\
        frame_drop(probability)\n";
    assert_eq!(text, contract);
}

#[test]
fn values_lie_in_their_ranges() {
    for effect in Effect::ALL {
        for p in effect.parameters() {
            let at = format!("{}.{}", effect.name(), p.key);
            assert!(p.min < p.max, "{at}");
            assert!((p.min..=p.max).contains(&p.neutral), "{at}");
            let discrete = matches!(p.prior, Prior::OneOf(_));
            for start in p.prior.starts() {
                assert!(discrete || (p.min..=p.max).contains(&start), "{at} {start}");
                assert!(p.prior.ln_density(start).is_finite(), "{at} {start}");
            }
            assert!(!p.prior_source.is_empty(), "{at}");
            if let Some(r) = p.resolution {
                assert!(r.size > 0.0 && !r.source.is_empty(), "{at}");
            }
        }
        // Something must say from which size on the effect has a name.
        let sized = effect.parameters().iter().any(|p| p.resolution.is_some());
        assert!(sized, "{}", effect.name());
    }
}

/// Where off is the nominal model's own value, it is the shipped model's.
#[test]
fn nominal_values_are_those_of_the_shipped_model() {
    use files::model::{Key, Model};
    let model = Model::hand_tuned();
    for (effect, key) in [
        (Effect::SupplyVoltage, Key::SupplyVoltage),
        (Effect::GroundFriction, Key::Friction),
        (Effect::Restitution, Key::Bounce),
        (Effect::CameraHeight, Key::CameraHeight),
    ] {
        assert_eq!(effect.parameters()[0].neutral, model.value(key), "{key:?}");
    }
}

/// Which motor drives which joint stands in the shipped robot too.
#[test]
fn motors_of_the_model_are_those_of_the_shipped_robot() {
    use files::model::{JOINTS, MOTORS};
    use files::structure::Structure;
    let text = include_str!("../../robots/metamodule.toml");
    let robot = Structure::parse("metamodule.toml", text).unwrap();
    let mut seen = 0;
    for hinge in robot.bodies.iter().flatten() {
        let keys = hinge.motor.keys().unwrap();
        assert_eq!(keys, MOTORS[hinge.joint], "joint {}", hinge.joint);
        seen += 1;
    }
    assert_eq!(seen, usize::from(JOINTS));
}

#[test]
fn keys_end_in_their_units() {
    let ends = [
        ("N m s2/rad2", "nm_s2_rad2"),
        ("N m s/rad", "nm_s_rad"),
        ("N m/rad", "nm_rad"),
        ("N s/m", "n_s_m"),
        ("N/m", "n_m"),
        ("rad/s", "rad_s"),
        ("N m", "nm"),
        ("rad", "rad"),
        ("ohm", "ohm"),
        ("s", "s"),
        ("m", "m"),
        ("A", "a"),
        ("V", "v"),
    ];
    for p in Effect::ALL.iter().flat_map(|e| e.parameters()) {
        match ends.iter().find(|(unit, _)| *unit == p.unit) {
            Some((_, end)) => {
                let whole = p.key == *end || p.key.ends_with(&format!("_{end}"));
                assert!(whole, "{} in {}", p.key, p.unit);
            }
            None => assert_eq!(p.unit, "1", "{}", p.key),
        }
    }
}

#[test]
fn sentences_hold_every_size_and_the_joints() {
    for effect in Effect::ALL {
        let info = effect.info();
        let mut left = info.sentence.to_owned();
        for p in info.parameters {
            left = left.replace(&format!("{{{}}}", p.key), "");
            let stated = left != info.sentence;
            // A sign has one value other than none; phase and number are shape.
            assert!(
                stated || p.key == "sign",
                "{}: {}",
                info.name,
                info.sentence
            );
        }
        assert_eq!(
            left.contains("{joints}"),
            info.scope == Scope::Joint,
            "{}",
            info.name
        );
        assert!(!left.replace("{joints}", "").contains('{'), "{left}");
        assert!(info.sentence.ends_with('.') && !info.plain.ends_with('.'));
    }
}

#[test]
fn rivals_and_plants_fit() {
    for effect in Effect::ALL {
        let info = effect.info();
        assert!(!info.confounded.contains(effect), "{}", info.name);
        assert!(!info.confounded.is_empty() && !info.signals.is_empty());
        let bench = info.plants.contains(&Plant::BenchJoint);
        assert!(
            !bench || info.scope == Scope::Joint || info.stage <= files::effects::Stage::Supply
        );
    }
    assert_eq!(Effect::Mass.info().kind, Kind::Parametric);
}

#[test]
fn priors_are_densities() {
    // The rectangle rule over a wide range gives one.
    let total = |prior: Prior, low: f64, high: f64| {
        let n = 400_000;
        let h = (high - low) / f64::from(n);
        let at = |k: i32| low + (f64::from(k) + 0.5) * h;
        (0..n)
            .map(|k| h * prior.ln_density(at(k)).exp())
            .sum::<f64>()
    };
    let (median, ln_sigma) = (0.3, 0.5);
    for sum in [
        total(Prior::LogNormal { median, ln_sigma }, 0.0, 20.0),
        total(
            Prior::Normal {
                mean: 1.0,
                sigma: 0.2,
            },
            -3.0,
            5.0,
        ),
        total(
            Prior::Uniform {
                low: -1.0,
                high: 2.0,
            },
            -2.0,
            3.0,
        ),
    ] {
        assert!((sum - 1.0).abs() < 1e-4, "{sum}");
    }
    assert_eq!(
        Prior::LogNormal { median, ln_sigma }.ln_density(-1.0),
        f64::NEG_INFINITY
    );
}

#[test]
fn scales_follow_the_joint() {
    let joint = JointScales {
        torque_nm: 4.0,
        speed_rad_s: 2.0,
        ..ONE
    };
    assert_eq!(Scale::Torque.of(&joint), 4.0);
    assert_eq!(Scale::TorquePerSpeed.of(&joint), 2.0);
    assert_eq!(Scale::TorquePerSpeed2.of(&joint), 1.0);
    assert_eq!(Scale::Unit.of(&joint), 1.0);
}

#[test]
fn published_page_is_that_of_the_registry() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/reference/effects.md");
    let published = std::fs::read_to_string(path).unwrap();
    assert!(
        published == page(),
        "run `cargo run -p files --example docs`"
    );
}
