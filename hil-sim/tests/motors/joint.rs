//! One joint against closed forms.

use hil_sim::body::{Stand, StandJoint};
use hil_sim::motor::{Bridge, JointKind, JointParams};
use hil_sim::plant::Plant;
use hil_sim::supply::SupplyParams;

const STEP_NS: u64 = 50_000;
const STEP_S: f64 = 50.0e-6;
const LINK_KG_M2: f64 = 1.31e-3;

fn plant_with(joint: JointParams, stand: StandJoint, supply: SupplyParams) -> Plant {
    Plant::new(
        vec![joint],
        supply,
        Box::new(Stand::new(vec![stand])),
        STEP_NS,
        1,
    )
    .expect("valid parameters")
}

fn plant(joint: JointParams) -> Plant {
    plant_with(
        joint,
        StandJoint::inertia(LINK_KG_M2),
        SupplyParams::default(),
    )
}

fn bridge(duty: f64, enabled: bool) -> Bridge {
    Bridge {
        duty,
        enabled,
        limit_a: f64::INFINITY,
        bus_v: 0.0,
    }
}

fn run(plant: &mut Plant, duty: f64, seconds: f64) {
    let steps = (seconds / STEP_S).round() as u64;
    for _ in 0..steps {
        plant.step(&[bridge(duty, true)]);
    }
}

fn near(value: f64, expected: f64, relative: f64, what: &str) {
    assert!(
        (value - expected).abs() <= relative * expected.abs(),
        "{what}: {value} instead of {expected}"
    );
}

/// Table I: 26.6 and 19.4 rpm, with and without the catalogue's friction, at 12 V.
#[test]
fn no_load_speed_is_that_of_table_i() {
    for (kind, rpm) in [(JointKind::Intra, 26.6), (JointKind::Inter, 19.4)] {
        let expected = rpm * std::f64::consts::TAU / 60.0;
        for joint in [kind.neutral(), kind.catalogue_joint()] {
            let mut joint = joint;
            // Cold: warming changes the speed by design.
            joint.thermal.copper_rise_per_k = 0.0;
            joint.thermal.magnet_loss_per_k = 0.0;
            for duty in [1.0, -1.0] {
                let mut plant = plant(joint.clone());
                run(&mut plant, duty, 1.0);
                near(
                    plant.states()[0].gear_rad_s,
                    duty * expected,
                    1e-3,
                    "no-load speed",
                );
            }
        }
    }
}

/// Table I: nominal torque is where the driver's limit stands; without it the stall torque is kt N V / R.
#[test]
fn standstill_torque_is_the_limit_or_the_stall_torque() {
    for (kind, nominal) in [(JointKind::Intra, 4.9), (JointKind::Inter, 3.6)] {
        let mut plant = plant(kind.neutral());
        plant.set_jam(0, true);
        run(&mut plant, 1.0, 0.5);
        near(
            plant.states()[0].transmitted_nm,
            0.0,
            1.0,
            "nothing passes a jam",
        );
        let motor = &kind.neutral().motor;
        near(
            plant.states()[0].current_a * motor.kt_nm_a * motor.ratio,
            nominal,
            1e-9,
            "limited torque",
        );

        let mut free = kind.neutral();
        free.electrical.torque_limit_nm = f64::INFINITY;
        let stall = motor.kt_nm_a * motor.ratio * 12.0 / motor.resistance_ohm;
        near(
            motor.stall_torque_nm(12.0),
            stall,
            1e-12,
            "stall torque formula",
        );
        let mut plant = self::plant(free);
        plant.set_jam(0, true);
        run(&mut plant, 1.0, 0.5);
        near(
            plant.states()[0].current_a * motor.kt_nm_a * motor.ratio,
            stall,
            1e-3,
            "stall torque",
        );
    }
}

/// Speed after a voltage step is first order with J R / kt^2.
#[test]
fn mechanical_time_constant() {
    for kind in [JointKind::Intra, JointKind::Inter] {
        let mut joint = kind.neutral();
        joint.electrical.torque_limit_nm = f64::INFINITY;
        let motor = joint.motor.clone();
        let kt_out = motor.kt_nm_a * motor.ratio;
        let inertia = motor.reflected_inertia_kg_m2() + LINK_KG_M2;
        let tau_s = inertia * motor.resistance_ohm / (kt_out * kt_out);
        assert!((0.002..0.02).contains(&tau_s), "{tau_s}");
        let mut plant = plant(joint);
        run(&mut plant, 0.5, tau_s);
        let final_speed = motor.no_load_speed_rad_s(6.0);
        let expected = final_speed * (1.0 - (-1.0_f64).exp());
        // First-order integration at tau/80: 1 %.
        near(
            plant.states()[0].gear_rad_s,
            expected,
            0.015,
            "speed after one time constant",
        );
    }
}

/// Current after a voltage step at standstill is first order with L / R, exactly.
#[test]
fn electrical_time_constant() {
    let mut joint = JointKind::Inter.neutral();
    joint.electrical.torque_limit_nm = f64::INFINITY;
    joint.motor.inductance_h = 20.0e-3;
    joint.motor.rotor_inertia_kg_m2 = 1.0e-3;
    let (l, r) = (joint.motor.inductance_h, joint.motor.resistance_ohm);
    let mut plant = plant(joint);
    let seconds = 0.002;
    run(&mut plant, 0.1, seconds);
    let expected = 1.2 / r * (1.0 - (-seconds * r / l).exp());
    near(plant.states()[0].current_a, expected, 1e-3, "current");
}

/// Electrical energy in = heat + kinetic energy, without friction, over a speed-up.
#[test]
fn energy_balance() {
    let mut joint = JointKind::Intra.neutral();
    joint.electrical.torque_limit_nm = f64::INFINITY;
    let motor = joint.motor.clone();
    let mut plant = plant(joint);
    let (mut electrical_j, mut heat_j) = (0.0, 0.0);
    for _ in 0..2_000 {
        plant.step(&[bridge(0.8, true)]);
        let state = &plant.states()[0];
        electrical_j += 0.8 * 12.0 * state.current_a * STEP_S;
        heat_j += state.current_a * state.current_a * motor.resistance_ohm * STEP_S;
    }
    let speed = plant.states()[0].gear_rad_s;
    let kinetic_j = 0.5 * (motor.reflected_inertia_kg_m2() + LINK_KG_M2) * speed * speed;
    near(electrical_j, heat_j + kinetic_j, 0.01, "energy");
}

/// A coasting joint keeps its energy in a frictionless pendulum: amplitude after 20 swings.
#[test]
fn released_pendulum_keeps_its_swing() {
    let joint = JointKind::Inter.neutral();
    let gravity_nm = 0.5;
    let mut stand = Stand::new(vec![StandJoint {
        gravity_nm,
        ..StandJoint::inertia(LINK_KG_M2)
    }]);
    stand.place(0.5);
    let inertia = joint.motor.reflected_inertia_kg_m2() + LINK_KG_M2;
    let mut plant = Plant::new(
        vec![joint],
        SupplyParams::default(),
        Box::new(stand),
        STEP_NS,
        1,
    )
    .expect("valid");
    let (mut highest, mut crossings, mut before) = (0.0_f64, 0, 0.5);
    for step in 0..400_000_u32 {
        plant.step(&[bridge(0.0, false)]);
        let angle = plant.states()[0].link_rad;
        if angle * before < 0.0 {
            crossings += 1;
        }
        before = angle;
        if step > 300_000 {
            highest = highest.max(angle.abs());
        }
    }
    near(highest, 0.5, 1e-3, "amplitude after 20 s");
    // Period of a pendulum at 0.5 rad is 1.0158 times that of small swings.
    let period_s = std::f64::consts::TAU * (inertia / gravity_nm).sqrt() * 1.0158;
    let swings = 20.0 / period_s;
    assert!(
        (f64::from(crossings) / 2.0 - swings).abs() <= 0.5,
        "{crossings} crossings, {swings} swings"
    );
}

/// Coulomb friction: holds below its level, lets slip above; deceleration of a coasting joint is F / J.
#[test]
fn coulomb_friction_holds_and_brakes() {
    let mut joint = JointKind::Intra.neutral();
    joint.friction.coulomb_nm = 0.5;
    let kt_out = joint.motor.kt_nm_a * joint.motor.ratio;
    let duty_for = |nm: f64| nm / kt_out * joint.motor.resistance_ohm / 12.0;
    let mut plant = plant(joint.clone());
    run(&mut plant, duty_for(0.45), 1.0);
    let settled = plant.states()[0].gear_rad;
    assert!(
        settled.abs() < 4e-3,
        "slipped {settled} rad below the friction level"
    );
    run(&mut plant, duty_for(0.45), 1.0);
    let crept = plant.states()[0].gear_rad - settled;
    assert!(crept.abs() < 5e-5, "crept {crept} rad in 1 s");
    run(&mut plant, duty_for(0.55), 2.0);
    assert!(
        plant.states()[0].gear_rad > 0.01,
        "did not slip above the friction level"
    );

    let mut plant = self::plant(joint.clone());
    run(&mut plant, 1.0, 0.5);
    let start = plant.states()[0].gear_rad_s;
    for _ in 0..2_000 {
        plant.step(&[bridge(0.0, false)]);
    }
    let inertia = joint.motor.reflected_inertia_kg_m2() + LINK_KG_M2;
    near(
        start - plant.states()[0].gear_rad_s,
        0.5 / inertia * 0.1,
        0.01,
        "coast-down",
    );
}

/// Steady speed under viscous, quadratic and asymmetric friction solves the torque balance.
#[test]
fn steady_speed_solves_the_torque_balance() {
    let mut joint = JointKind::Intra.neutral();
    joint.friction.coulomb_nm = 0.4;
    joint.friction.viscous_nm_s_rad = 0.3;
    joint.friction.quadratic_nm_s2_rad2 = 0.2;
    joint.friction.asymmetry_nm = 0.2;
    joint.friction.asymmetry_nm_s_rad = 0.1;
    for direction in [1.0, -1.0] {
        let mut plant = plant(joint.clone());
        run(&mut plant, 0.7 * direction, 1.0);
        let state = &plant.states()[0];
        let motor_nm = state.current_a.abs() * joint.motor.kt_nm_a * joint.motor.ratio;
        let v = state.gear_rad_s.abs();
        let friction_nm = 0.4 + 0.1 * direction + (0.3 + 0.05 * direction) * v + 0.2 * v * v;
        near(motor_nm, friction_nm, 2e-3, "torque balance");
    }
}

/// Stribeck: more torque to start than to keep going slowly; load-dependent friction grows with what is carried.
#[test]
fn static_and_load_dependent_friction() {
    let mut joint = JointKind::Inter.neutral();
    joint.friction.coulomb_nm = 0.2;
    joint.friction.static_nm = 0.3;
    joint.friction.stribeck_rad_s = 0.005;
    let kt_out = joint.motor.kt_nm_a * joint.motor.ratio;
    let duty_for = |nm: f64| nm / kt_out * joint.motor.resistance_ohm / 12.0;
    let mut plant = plant(joint.clone());
    // Slowly: a blow may break away dynamically.
    for k in 1..=45 {
        run(&mut plant, duty_for(0.01 * f64::from(k)), 0.2);
    }
    assert!(
        plant.states()[0].gear_rad_s.abs() < 1e-3,
        "broke away below the static level"
    );
    run(&mut plant, duty_for(0.60), 0.5);
    run(&mut plant, duty_for(0.45), 1.0);
    assert!(
        plant.states()[0].gear_rad_s > 0.01,
        "stopped above the Coulomb level"
    );

    let mut joint = JointKind::Inter.neutral();
    joint.friction.load_fraction = 0.2;
    let hang = StandJoint {
        gravity_nm: 2.0,
        hang_rad: -std::f64::consts::FRAC_PI_2,
        ..StandJoint::inertia(LINK_KG_M2)
    };
    let mut plant = plant_with(joint, hang, SupplyParams::default());
    // 2 N m to hold at 0 rad; with 0.4 N m of friction 1.7 N m still hold and 1.5 do not.
    run(&mut plant, duty_for(1.7), 1.0);
    let settled = plant.states()[0].link_rad;
    run(&mut plant, duty_for(1.7), 1.0);
    let crept = plant.states()[0].link_rad - settled;
    assert!(crept.abs() < 1e-3, "slipped {crept} rad in 1 s");
    // The missing 0.1 N m meets 8.5 N m s/rad of back-EMF: 12 mrad in a second.
    run(&mut plant, duty_for(1.5), 1.0);
    let slipped = plant.states()[0].link_rad - settled - crept;
    assert!((-0.014..-0.009).contains(&slipped), "slipped {slipped} rad");
}

/// Backlash: the link lags by the half width on each side; compliance: twist = torque / stiffness.
#[test]
fn play_and_twist_are_those_set() {
    let mut joint = JointKind::Intra.neutral();
    joint.transmission.backlash_half_width_rad = 0.02;
    let drag = StandJoint {
        load: Some(Box::new(Drag)),
        ..StandJoint::inertia(LINK_KG_M2)
    };
    let mut plant = plant_with(joint, drag, SupplyParams::default());
    for (duty, side) in [(0.2, 1.0), (-0.2, -1.0)] {
        run(&mut plant, duty, 0.5);
        let state = &plant.states()[0];
        near(
            state.gear_rad - state.link_rad,
            side * 0.02,
            0.02,
            "lag in the play",
        );
    }

    let mut joint = JointKind::Intra.neutral();
    joint.transmission.stiffness_nm_rad = 200.0;
    let hang = StandJoint {
        gravity_nm: 1.0,
        hang_rad: -std::f64::consts::FRAC_PI_2,
        ..StandJoint::inertia(0.02)
    };
    let kt_out = joint.motor.kt_nm_a * joint.motor.ratio;
    let duty = 1.0 / kt_out * joint.motor.resistance_ohm / 12.0;
    let mut plant = plant_with(joint, hang, SupplyParams::default());
    run(&mut plant, duty, 3.0);
    let state = &plant.states()[0];
    let load_nm = (state.link_rad + std::f64::consts::FRAC_PI_2).sin();
    near(
        state.gear_rad - state.link_rad,
        load_nm / 200.0,
        0.02,
        "twist",
    );
}

struct Drag;

impl hil_sim::body::Load for Drag {
    fn torque_nm(&mut self, _t_s: f64, _angle_rad: f64, velocity_rad_s: f64) -> f64 {
        -0.05 * velocity_rad_s
    }
}

/// Bus voltage under load is V0 - R I, and the current at standstill follows.
#[test]
fn supply_sags_by_ohms_law() {
    let mut joint = JointKind::Inter.neutral();
    joint.electrical.torque_limit_nm = f64::INFINITY;
    let resistance = joint.motor.resistance_ohm;
    let supply = SupplyParams {
        voltage_v: 12.0,
        resistance_ohm: 0.5,
    };
    let mut plant = plant_with(joint, StandJoint::inertia(LINK_KG_M2), supply);
    plant.set_jam(0, true);
    run(&mut plant, 0.5, 0.5);
    // I = d V / R and V = V0 - Rs d I.
    let v = 12.0 / (1.0 + 0.5 * 0.25 / resistance);
    near(plant.bus_v(), v, 1e-3, "bus voltage");
}

/// Winding and case approach the temperatures that the heat paths give, case with its time constant.
#[test]
fn temperatures_follow_the_two_body_model() {
    let joint = JointKind::Inter.neutral();
    let thermal = joint.thermal.clone();
    let loss_w = 0.8 * 0.8 * joint.motor.resistance_ohm;
    let duty = 0.8 * joint.motor.resistance_ohm / 12.0;
    let mut plant = Plant::new(
        vec![{
            let mut j = joint;
            j.electrical.torque_limit_nm = f64::INFINITY;
            j
        }],
        SupplyParams::default(),
        Box::new(Stand::new(vec![StandJoint::inertia(LINK_KG_M2)])),
        1_000_000,
        1,
    )
    .expect("valid");
    plant.set_jam(0, true);
    for _ in 0..330_000 {
        plant.step(&[bridge(duty, true)]);
    }
    let state = &plant.states()[0];
    // Winding and case warm up together through the case's resistance; the winding stays its own drop above.
    let capacity_j_k = thermal.winding_time_constant_s / thermal.winding_case_k_w
        + thermal.case_time_constant_s / thermal.case_ambient_k_w;
    let share = 1.0 - (-330.0 / (capacity_j_k * thermal.case_ambient_k_w)).exp();
    let case_rise = loss_w * thermal.case_ambient_k_w * share;
    near(
        state.case_c - thermal.ambient_c,
        case_rise,
        0.03,
        "case rise",
    );
    near(
        state.winding_c - state.case_c,
        loss_w * thermal.winding_case_k_w,
        0.03,
        "winding drop",
    );
}

/// A body stepped ten times more rarely gives the same motion to the order of its step.
#[test]
fn a_coarser_body_step_agrees() {
    let end = |every| {
        let stand = Stand::new(vec![StandJoint {
            gravity_nm: 1.0,
            ..StandJoint::inertia(0.02)
        }]);
        let mut plant = Plant::new(
            vec![JointKind::Intra.neutral()],
            SupplyParams::default(),
            Box::new(stand),
            STEP_NS,
            every,
        )
        .expect("valid");
        run(&mut plant, 0.3, 0.5);
        plant.states()[0].link_rad
    };
    near(end(10), end(1), 0.01, "angle after 0.5 s");
}

/// Every effect at its neutral value leaves the motion bit-identical.
#[test]
fn neutral_values_are_bit_identical() {
    use hil_sim::effects::set;
    use hil_sim::world::{World, WorldParams};
    let mut plain = WorldParams::bench(3, JointKind::Intra.neutral());
    plain.joints[0].load.gravity_nm = 1.0;
    let neutral = [
        ("joint_sign", "sign", 1.0),
        ("joint_scale", "ratio", 1.0),
        ("joint_offset", "offset_rad", 0.0),
        ("latency", "delay_s", 0.0),
        ("jitter", "sigma_s", 0.0),
        ("packet_loss", "probability", 0.0),
        ("quantisation", "step_rad", 0.0),
        ("clock_skew", "ratio", 1.0),
        ("loop_gain", "ratio", 1.0),
        ("damping_gain", "ratio", 1.0),
        ("deadband", "half_width_rad", 0.0),
        ("velocity_limit", "limit_rad_s", f64::INFINITY),
        ("feedback_delay", "delay_s", 0.0),
        ("motor_lag", "time_constant_s", 0.0),
        ("motor_constant", "ratio", 1.0),
        ("winding_resistance", "ratio", 1.0),
        ("current_limit", "limit_a", f64::INFINITY),
        ("thermal_derating", "fraction", 0.0),
        ("supply_sag", "resistance_ohm", 0.0),
        ("coulomb_friction", "torque_nm", 0.0),
        ("viscous_friction", "nm_s_rad", 0.0),
        ("stribeck_friction", "static_nm", 0.0),
        ("load_dependent_friction", "fraction", 0.0),
        ("asymmetric_friction", "difference_nm", 0.0),
        ("asymmetric_friction", "difference_nm_s_rad", 0.0),
        ("quadratic_friction", "nm_s2_rad2", 0.0),
        ("torque_ripple", "amplitude_nm", 0.0),
        ("inertia", "ratio", 1.0),
        ("gravity_load", "ratio", 1.0),
        ("backlash", "half_width_rad", 0.0),
        ("compliance", "stiffness_nm_rad", f64::INFINITY),
        ("position_friction", "torque_nm", 0.0),
        ("hysteretic_spring", "stiffness_nm_rad", 0.0),
        ("zero_drift", "rad_s", 0.0),
        ("asymmetric_gain", "fraction", 0.0),
    ];
    let mut switched = plain.clone();
    for (effect, key, value) in neutral {
        set(&mut switched, effect, Some(0), key, value).expect("known");
    }
    let trace = |params: &WorldParams| {
        let mut world = World::on_stand(params).expect("valid");
        let mut bits = Vec::new();
        for k in 1..=400_u64 {
            world.advance_to(k * 5_000_000);
            let driver = world.driver_mut(0).expect("one driver");
            driver.set_torque(true);
            driver
                .set_goal((k as f64 * 0.01).sin(), k * 5_000_000)
                .expect("plausible");
            bits.push(world.joint(0).expect("one joint").link_rad.to_bits());
        }
        bits
    };
    assert_eq!(trace(&plain), trace(&switched));
}
