//! Every effect from `drivetrain` to `body`: off gives the bits of the base model, on does what its name says.
// Helpers outside `#[test]` functions may fail a test by panicking too.
#![allow(clippy::unwrap_used)]

use files::model::{Effect, Key, Model, Stage};
use peers::random_gait;
use physics::{
    Body, Drive, GRAVITY_M_S2, JointDrive, Level, Options, Outcome, Params, Pose, Robot, Start,
    Trial, Twist, run_at,
};
use std::sync::Arc;

fn options() -> Options {
    Options {
        record_angles: true,
        record_motors: true,
        ..Options::default()
    }
}

fn gait_trial(model: &Model, k: u32) -> Trial {
    Trial {
        params: Arc::new(Params::try_from(model).unwrap()),
        start: Start::HomeAtOnce,
        drive: Drive::Gait {
            gait: Arc::new(random_gait(5, k, (0.5, 1.2))),
            noise_rad: 0.0,
            seed: 0,
        },
        duration_s: 5.0,
    }
}

fn with(effect: Effect, values: &[f64]) -> Model {
    let mut model = Model::hand_tuned();
    if effect.info().per_joint() {
        for joint in 0..6 {
            model.set_effect(effect, Some(joint), values).unwrap();
        }
    } else {
        model.set_effect(effect, None, values).unwrap();
    }
    model
}

fn simulated(effect: Effect) -> bool {
    let body = matches!(
        effect.info().stage,
        Stage::Drivetrain | Stage::Transmission | Stage::Body
    );
    body || effect == Effect::ClockSkew
}

/// Values that mean "off"; base effects are off at the nominal value.
fn neutral(effect: Effect) -> Vec<f64> {
    effect.info().parameters.iter().map(|p| p.neutral).collect()
}

/// Values large enough to change a five-second gait.
fn strong(effect: Effect) -> Vec<f64> {
    match effect {
        Effect::CoulombFriction => vec![2.0],
        Effect::ViscousFriction => vec![2.0],
        Effect::StribeckFriction => vec![2.0, 1.0],
        Effect::LoadDependentFriction => vec![0.9],
        Effect::AsymmetricFriction => vec![4.0, 0.0],
        Effect::QuadraticFriction => vec![3.0],
        Effect::TorqueRipple => vec![2.0, 3.0, 0.5],
        Effect::Inertia => vec![3.0],
        Effect::GravityLoad => vec![2.0],
        Effect::Backlash => vec![0.05],
        Effect::Compliance | Effect::ConnectorCompliance => vec![20.0],
        Effect::ConnectorPlay => vec![0.03],
        Effect::GroundFriction => vec![0.3],
        Effect::FrictionAnisotropy => vec![3.0, 0.3],
        Effect::TorsionalFriction => vec![0.02],
        Effect::Restitution => vec![0.0],
        Effect::GroundSlope => vec![0.03, 0.05],
        Effect::GroundCompliance => vec![2000.0, 20.0],
        Effect::Mass => vec![1.5],
        Effect::ComOffset => vec![0.01, 0.0, 0.02],
        Effect::ClockSkew => vec![1.1],
        other => panic!("{other:?} is not simulated here"),
    }
}

fn run(trials: &[Trial], level: Level) -> Vec<Outcome> {
    let out = run_at(level, trials, &options()).unwrap();
    assert!(out.iter().all(|o| o.not_finite.is_none()));
    out
}

#[test]
fn off_is_the_base_model_to_the_bit() {
    let base = gait_trial(&Model::hand_tuned(), 0);
    let expected = run(std::slice::from_ref(&base), Level::detect());
    for effect in Effect::ALL.iter().copied().filter(|e| simulated(*e)) {
        let connector = matches!(effect, Effect::ConnectorCompliance | Effect::ConnectorPlay);
        if connector {
            // Split bodies are another structure; off means absent.
            continue;
        }
        let off = gait_trial(&with(effect, &neutral(effect)), 0);
        assert_eq!(run(&[off], Level::detect()), expected, "{effect:?} alone");
    }
}

#[test]
fn a_neighbour_with_an_effect_changes_nothing() {
    let base = gait_trial(&Model::hand_tuned(), 0);
    let expected = run(std::slice::from_ref(&base), Level::Scalar);
    for effect in Effect::ALL.iter().copied().filter(|e| simulated(*e)) {
        let other = gait_trial(&with(effect, &strong(effect)), 0);
        let pair = run(&[base.clone(), other.clone()], Level::detect());
        assert_eq!(pair[0], expected[0], "{effect:?}");
        assert_ne!(pair[1].poses, expected[0].poses, "{effect:?} has no effect");
        // The effect itself gives the same bits alone and scalar.
        assert_eq!(run(&[other], Level::Scalar)[0], pair[1], "{effect:?}");
    }
}

#[test]
fn effects_of_other_stages_are_refused_by_name() {
    let error = Params::try_from(&with(Effect::MotorLag, &[0.1])).unwrap_err();
    assert!(
        error.to_string().contains("`motor_lag` (stage driver)"),
        "{error}"
    );
}

/// When the first encoder is half way through a step of 0.2 rad, which is sent at the 20th set-point of 20 Hz, s.
fn half_way_s(model: &Model) -> f64 {
    const RATE_HZ: f64 = 200.0;
    let values: Vec<f32> = (0..60)
        .flat_map(|i| [if i < 20 { 0.0 } else { 0.2 }; 6])
        .collect();
    let trial = Trial {
        params: Arc::new(Params::try_from(model).unwrap()),
        start: Start::HomeAtOnce,
        drive: Drive::SetPoints {
            period_s: 0.05,
            values_rad: Arc::from(values),
        },
        duration_s: 3.0,
    };
    let options = Options {
        sample_rate_hz: RATE_HZ,
        ..options()
    };
    let outcome = run_at(Level::detect(), &[trial], &options)
        .unwrap()
        .remove(0);
    let mut first = outcome.encoders_rad.iter().step_by(6);
    first.position(|q| *q > 0.1).unwrap() as f64 / RATE_HZ
}

#[test]
fn late_set_points_arrive_between_ticks() {
    let at_once_s = half_way_s(&with(Effect::Latency, &[0.0]));
    for delay_s in [0.02, 0.05, 0.08, 0.1] {
        let late_s = half_way_s(&with(Effect::Latency, &[delay_s])) - at_once_s;
        assert!((late_s - delay_s).abs() < 0.006, "{late_s} for {delay_s}");
    }
}

#[test]
fn a_robot_whose_clock_is_fast_reaches_its_set_points_early() {
    let at_once_s = half_way_s(&with(Effect::ClockSkew, &[1.0]));
    for ratio in [0.5, 0.97, 1.03, 2.0] {
        // The 20th set-point is due after a second of the robot's clock.
        let early_s = at_once_s - half_way_s(&with(Effect::ClockSkew, &[ratio]));
        assert!(
            (early_s - (1.0 - 1.0 / ratio)).abs() < 0.006,
            "{early_s} for {ratio}"
        );
    }
}

fn high() -> Pose {
    Pose {
        position_m: [0.0, 0.0, 50.0],
        quaternion: [1.0, 0.0, 0.0, 0.0],
    }
}

fn weightless(model: &Model, time_step_s: f64) -> Body {
    let params = Params {
        gravity_m_s2: [0.0; 3],
        ..Params::try_from(model).unwrap()
    };
    let options = Options {
        time_step_s,
        ..Options::default()
    };
    let mut body = Body::new(Arc::new(params), &options).unwrap();
    body.place(&high(), &Twist::default(), &[0.0; 6], &[0.0; 6])
        .unwrap();
    body
}

/// Lets joint 1 run down from 1 rad/s with all others held, returns its speed after `seconds` and its inertia.
fn coast(effect: Effect, values: &[f64], seconds: f64) -> (f64, f64) {
    let h = 0.001;
    let mut body = weightless(&with(effect, values), h);
    let mut speeds = [0.0; 6];
    speeds[1] = 1.0;
    body.place(&high(), &Twist::default(), &[0.0; 6], &speeds)
        .unwrap();
    let mut drives = [JointDrive::Speed {
        rad_s: 0.0,
        limit_nm: f64::INFINITY,
    }; 6];
    drives[1] = JointDrive::Torque { nm: 0.0 };
    let mut inertia = 0.0;
    for _ in 0..(seconds / h).round() as u32 {
        body.step(&drives);
        inertia = body.inertias_kg_m2().nth(1).unwrap();
    }
    (body.speeds_rad_s().nth(1).unwrap(), inertia)
}

#[test]
fn coulomb_friction_brakes_linearly_and_stops() {
    let (v, inertia) = coast(Effect::CoulombFriction, &[0.002], 0.2);
    assert!(
        (v - (1.0 - 0.002 * 0.2 / inertia)).abs() < 0.02,
        "{v} {inertia}"
    );
    let (v, _) = coast(Effect::CoulombFriction, &[0.2], 0.2);
    assert!(v.abs() < 1e-6, "{v}");
}

#[test]
fn viscous_friction_brakes_exponentially() {
    let (v, inertia) = coast(Effect::ViscousFriction, &[0.01], 0.2);
    let exact = libm::exp(-0.01 * 0.2 / inertia);
    assert!((v - exact).abs() < 0.02, "{v} {exact}");
}

#[test]
fn quadratic_friction_brakes_hyperbolically() {
    let (v, inertia) = coast(Effect::QuadraticFriction, &[0.02], 0.2);
    let exact = 1.0 / (1.0 + 0.02 * 0.2 / inertia);
    assert!((v - exact).abs() < 0.02, "{v} {exact}");
}

#[test]
fn stribeck_friction_falls_as_a_bell() {
    let (static_nm, width_rad_s) = (0.4, 0.2);
    // Torque that turns joint 1 at `rad_s`, all others held.
    let torque = |model: &Model, rad_s: f64| {
        let mut body = weightless(model, 0.001);
        let held = |rad_s| JointDrive::Speed {
            rad_s,
            limit_nm: f64::INFINITY,
        };
        let mut drives = [held(0.0); 6];
        drives[1] = held(rad_s);
        for _ in 0..20 {
            body.step(&drives);
        }
        body.torques_nm().nth(1).unwrap()
    };
    let rubbing = with(Effect::StribeckFriction, &[static_nm, width_rad_s]);
    for rad_s in [-0.5, -0.2, -0.05, 0.05, 0.1, 0.2, 0.4, 1.0] {
        let rub = torque(&rubbing, rad_s) - torque(&Model::hand_tuned(), rad_s);
        let bell = libm::exp(-(rad_s / width_rad_s) * (rad_s / width_rad_s));
        let exact = static_nm * bell * rad_s.signum();
        assert!((rub - exact).abs() < 1e-3, "{rad_s}: {rub} {exact}");
    }
}

#[test]
fn sticking_friction_goes_by_the_speed_of_the_joint() {
    // Far above the width nothing brakes; were it to go by the speed that is asked for, the joint would stop.
    let (v, _) = coast(Effect::StribeckFriction, &[0.2, 0.1], 0.2);
    assert!((v - 1.0).abs() < 0.02, "{v}");
}

#[test]
fn a_servo_with_a_dead_zone_comes_to_its_edge_like_one_without_to_its_set_point() {
    let gain_per_s = Model::hand_tuned().value(Key::InterGain);
    let mut model = Model::hand_tuned();
    model.set(Key::Cfm, 0.0).unwrap();
    model
        .set_effect(Effect::Deadband, Some(1), &[0.04])
        .unwrap();
    let mut body = weightless(&model, 0.001);
    let held = JointDrive::Servo { set_point_rad: 0.0 };
    let mut drives = [held; 6];
    drives[1] = JointDrive::Servo { set_point_rad: 0.1 };
    let steps = (1000.0 / gain_per_s).round() as u32;
    for _ in 0..steps {
        body.step(&drives);
    }
    let reached = body.encoders_rad().nth(1).unwrap();
    let exact = 0.06 * (1.0 - libm::exp(-gain_per_s * f64::from(steps) * 0.001));
    assert!((reached - exact).abs() < 1e-3, "{reached} {exact}");
}

#[test]
fn inertia_ratio_slows_the_answer_to_a_torque() {
    let angle = |ratio: f64| {
        let mut body = weightless(&with(Effect::Inertia, &[ratio]), 0.001);
        let mut drives = [JointDrive::Speed {
            rad_s: 0.0,
            limit_nm: f64::INFINITY,
        }; 6];
        drives[0] = JointDrive::Torque { nm: 0.001 };
        for _ in 0..50 {
            body.step(&drives);
        }
        body.angles_rad().next().unwrap()
    };
    let ratio = angle(1.0) / angle(2.5);
    assert!((ratio - 2.5).abs() < 0.01, "{ratio}");
}

#[test]
fn backlash_lets_the_link_lag_by_its_half_width() {
    let mut body = weightless(&with(Effect::Backlash, &[0.03]), 0.002);
    for _ in 0..1500 {
        body.step(&[JointDrive::Servo { set_point_rad: 0.4 }; 6]);
    }
    for (motor, link) in body.encoders_rad().zip(body.angles_rad()) {
        assert!((motor - 0.4).abs() < 0.005, "{motor}");
        assert!((motor - link).abs() < 0.0302, "{motor} {link}");
    }
    let spread: f64 = body
        .encoders_rad()
        .zip(body.angles_rad())
        .map(|(m, l)| (m - l).abs())
        .fold(0.0, f64::max);
    assert!(spread > 0.02, "{spread}");
}

#[test]
fn compliance_bends_by_torque_over_stiffness() {
    // Resting on the ground at home a joint carries little; held in the air by a constant outside torque it bends by torque / stiffness.
    let mut model = with(Effect::Compliance, &[50.0]);
    for joint in 0..6 {
        model
            .set_effect(Effect::ViscousFriction, Some(joint), &[0.3])
            .unwrap();
    }
    let params = Arc::new(Params::try_from(&model).unwrap());
    let mut body = Body::new(params, &options()).unwrap();
    for _ in 0..1000 {
        body.step(&[JointDrive::Servo { set_point_rad: 0.0 }; 6]);
    }
    for ((motor, link), torque) in body
        .encoders_rad()
        .zip(body.angles_rad())
        .zip(body.torques_nm())
    {
        assert!(
            ((motor - link) - torque / 50.0).abs() < 2e-4,
            "{motor} {link} {torque}"
        );
    }
}

#[test]
fn a_stiff_connector_is_close_to_none() {
    let trial = |model: &Model| {
        let mut t = gait_trial(model, 3);
        t.duration_s = 1.0;
        t
    };
    let rigid = run(&[trial(&Model::hand_tuned())], Level::Reference);
    let stiff = run(
        &[trial(&with(Effect::ConnectorCompliance, &[1e5]))],
        Level::Reference,
    );
    let (a, b) = (rigid[0].poses[15].position_m, stiff[0].poses[15].position_m);
    let apart = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt();
    assert!(apart < 0.002, "{apart} m after 0.75 s");
}

/// Way of the robot at home that slides with 0.5 m/s in a direction, m.
fn slide(params: Params, direction: f32) -> f64 {
    let (s, c) = (libm::sinf(direction), libm::cosf(direction));
    let trial = Trial {
        params: Arc::new(params),
        start: flat([0.5 * c, 0.5 * s, 0.0]),
        drive: Drive::SetPoints {
            period_s: 1.0,
            values_rad: Arc::from([0.0; 6]),
        },
        duration_s: 1.0,
    };
    run(&[trial], Level::detect())[0].distance_m
}

/// The robot at home on its faces, with a speed.
fn flat(linear_m_s: [f32; 3]) -> Start {
    Start::State {
        base: Pose {
            position_m: [0.0, 0.0, 0.055],
            quaternion: [1.0, 0.0, 0.0, 0.0],
        },
        twist: Twist {
            linear_m_s,
            angular_rad_s: [0.0; 3],
        },
        angles_rad: vec![0.0; 6],
        speeds_rad_s: vec![0.0; 6],
    }
}

/// A ground of friction 0.2 that throws nothing back, with more.
fn slippery(more: &[(Effect, &[f64])]) -> Params {
    let mut model = with(Effect::GroundFriction, &[0.2]);
    model.set_effect(Effect::Restitution, None, &[0.0]).unwrap();
    for (effect, values) in more {
        model.set_effect(*effect, None, values).unwrap();
    }
    Params::try_from(&model).unwrap()
}

/// Braking way from 0.5 m/s with a friction of 0.2, m.
const BRAKED_M: f64 = 0.25 / (2.0 * 0.2 * GRAVITY_M_S2);

#[test]
fn anisotropy_brakes_as_it_says() {
    let params = || slippery(&[(Effect::FrictionAnisotropy, &[2.0, 0.6])]);
    let along = slide(params(), 0.6);
    let across = slide(params(), 0.6 + std::f32::consts::FRAC_PI_2);
    assert!((along - BRAKED_M).abs() < 0.03 * BRAKED_M, "{along}");
    let half = BRAKED_M / 2.0;
    assert!((across - half).abs() < 0.06 * half, "{across}");
}

#[test]
fn a_pyramid_brakes_less_between_its_edges() {
    let params = || Params {
        pyramid: true,
        ..slippery(&[])
    };
    let edge = slide(params(), 0.0);
    let between = slide(params(), std::f32::consts::FRAC_PI_4);
    assert!((edge - BRAKED_M).abs() < 0.03 * BRAKED_M, "{edge}");
    let longer = BRAKED_M * std::f64::consts::SQRT_2;
    assert!((between - longer).abs() < 0.03 * longer, "{between}");
}

#[test]
fn contacts_with_slip_creep_down_a_slope() {
    // Twelve points carry the robot on its four faces, each a twelfth of the downhill force.
    let (slip, slope) = (0.002, 0.1);
    let model = with(Effect::GroundSlope, &[0.0, slope]);
    let params = Params {
        slip_m_s_n: slip,
        ..Params::try_from(&model).unwrap()
    };
    let mass: f64 = params.half_masses_kg.iter().sum();
    let trial = Trial {
        params: Arc::new(params),
        start: flat([0.0; 3]),
        drive: Drive::SetPoints {
            period_s: 1.0,
            values_rad: Arc::from([0.0; 6]),
        },
        duration_s: 3.0,
    };
    let way = run(&[trial], Level::detect())[0].distance_m;
    let exact = slip * mass * GRAVITY_M_S2 * slope.sin() / 12.0 * 3.0;
    assert!((way - exact).abs() < 0.05 * exact, "{way} {exact}");
}

#[test]
fn any_tree_of_the_kind_runs() {
    // A single module: the meta-module's raw structure cut after body 3's first half.
    let whole = Robot::meta_module(&Model::hand_tuned()).unwrap();
    let mut raw = whole.raw().clone();
    raw.bodies.truncate(4);
    raw.halves.truncate(4);
    raw.cubes.truncate(2);
    raw.pairs.clear();
    let robot = Arc::new(Robot::try_from(raw).unwrap());
    assert_eq!(robot.motors(), 3);
    let params = Params::new(&Model::hand_tuned(), robot).unwrap();
    let trial = Trial {
        params: Arc::new(params),
        start: Start::HomeAtOnce,
        drive: Drive::SetPoints {
            period_s: 1.0,
            values_rad: Arc::from([0.0, 0.0, 0.0, 0.8, 0.3, -0.4]),
        },
        duration_s: 3.0,
    };
    let out = run(&[trial], Level::detect());
    let end = &out[0].angles_rad[out[0].angles_rad.len() - 3..];
    for (q, expected) in end.iter().zip([0.8, 0.3, -0.4]) {
        assert!((q - expected).abs() < 0.01, "{end:?}");
    }
}

/// A robot that stands on joints turned from home, encoders led, and rests for two seconds.
fn standing(model: &Model) -> Trial {
    let target = [0.0, 0.7, 0.3, -0.6, 0.8, 0.0];
    let rows = [0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0];
    let values = rows.iter().flat_map(|share| target.map(|x| share * x));
    Trial {
        params: Arc::new(Params::try_from(model).unwrap()),
        start: Start::HomeAtOnce,
        drive: Drive::EncoderAngles {
            period_s: 0.5,
            values_rad: values.collect(),
        },
        duration_s: 3.0,
    }
}

fn last(outcome: &Outcome) -> [[f64; 3]; 6] {
    let at = |all: &[f32], k: usize| f64::from(all[all.len() - 6 + k]);
    std::array::from_fn(|k| {
        [
            &outcome.encoders_rad,
            &outcome.angles_rad,
            &outcome.torques_nm,
        ]
        .map(|all| at(all, k))
    })
}

#[test]
fn a_link_hangs_on_a_led_encoder_by_its_spring_and_its_play() {
    let (stiffness, half) = (20.0, 0.03);
    let springy = run(
        &[standing(&with(Effect::Compliance, &[stiffness]))],
        Level::detect(),
    );
    let loose = run(
        &[standing(&with(Effect::Backlash, &[half]))],
        Level::detect(),
    );
    let mut most = 0.0f64;
    for k in 0..6 {
        let [encoder, link, torque] = last(&springy[0])[k];
        assert!(
            (encoder - link - torque / stiffness).abs() < 2e-3,
            "{k}: {encoder} {link}"
        );
        most = most.max((encoder - link).abs());
        let [encoder, link, torque] = last(&loose[0])[k];
        assert!(
            (encoder - link).abs() < half + 1e-4,
            "{k}: {encoder} {link}"
        );
        if torque.abs() > 0.1 {
            let side = (encoder - link) * torque.signum();
            assert!((side - half).abs() < 2e-3, "{k}: {side} under {torque}");
        }
    }
    assert!(most > 0.01, "no spring was bent: {most}");
}

#[test]
fn a_trial_that_begins_where_another_ended_stays_there() {
    let mut model = with(Effect::Compliance, &[20.0]);
    model
        .set_effect(Effect::ConnectorCompliance, None, &[30.0])
        .unwrap();
    let first = standing(&model);
    let before = &run(std::slice::from_ref(&first), Level::detect())[0];
    assert_eq!(before.end_angles_rad.len(), 9, "connectors last");
    let held: Vec<f32> = last(before)
        .iter()
        .map(|[encoder, ..]| *encoder as f32)
        .collect();
    let went = |angles: &[f32]| {
        let trial = Trial {
            start: Start::State {
                base: *before.poses.last().unwrap(),
                twist: Twist::default(),
                angles_rad: angles.to_vec(),
                speeds_rad_s: vec![0.0; angles.len()],
            },
            drive: Drive::EncoderAngles {
                period_s: 1.0,
                values_rad: Arc::from(held.as_slice()),
            },
            duration_s: 0.3,
            ..first.clone()
        };
        let out = &run(&[trial], Level::detect())[0];
        let [from, to] = [before.poses.last(), out.poses.last()].map(|p| p.unwrap().position_m);
        let square = |k: usize| (f64::from(to[k]) - f64::from(from[k])).powi(2);
        (0..3).map(square).sum::<f64>().sqrt()
    };
    let (bent, straight) = (went(&before.end_angles_rad), went(&held));
    assert!(bent < 1e-3, "{bent} m");
    assert!(straight > 5.0 * bent, "{straight} m for {bent} m");
}
