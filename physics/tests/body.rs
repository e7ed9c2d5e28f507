//! The single-robot interface: energy, reaction torques, inertial sensor, agreement with the batch engine.
// Helpers outside `#[test]` functions may fail a test by panicking too.
#![allow(clippy::unwrap_used)]

use files::model::Model;
use physics::{
    Body, Drive, GRAVITY_M_S2, JointDrive, Level, Options, Params, Pose, Start, Trial, Twist,
    run_at,
};
use std::sync::Arc;

fn body(time_step_s: f64) -> Body {
    let params = Arc::new(Params::try_from(&Model::hand_tuned()).unwrap());
    let options = Options {
        time_step_s,
        ..Options::default()
    };
    Body::new(params, &options).unwrap()
}

fn high() -> Pose {
    Pose {
        position_m: [0.0, 0.0, 50.0],
        quaternion: [1.0, 0.0, 0.0, 0.0],
    }
}

#[test]
fn a_limp_robot_keeps_its_energy_in_the_air() {
    let drift = |h: f64| {
        let mut body = body(h);
        let twist = Twist {
            linear_m_s: [0.3, 0.0, 2.0],
            angular_rad_s: [1.0, -2.0, 1.5],
        };
        let speeds = [2.0, -1.0, 1.5, -2.0, 1.0, 0.5];
        body.place(&high(), &twist, &[0.3, -0.5, 0.7, -0.2, 0.4, 0.1], &speeds)
            .unwrap();
        let sum = |b: &Body| b.energy_j().0 + b.energy_j().1;
        let start = sum(&body);
        let kinetic = body.energy_j().0;
        for _ in 0..(1.0 / h) as u32 {
            body.step(&[JointDrive::Torque { nm: 0.0 }; 6]);
        }
        assert!(body.is_finite());
        // Free fall of semi-implicit Euler loses m g^2 h t / 2; put back here.
        let fall = 2.6 * GRAVITY_M_S2 * GRAVITY_M_S2 * h * 0.5;
        (sum(&body) - start + fall).abs() / kinetic
    };
    let (coarse, fine) = (drift(0.002), drift(0.000_25));
    assert!(fine < 0.004, "{fine}");
    // First order: an eighth of the step, about an eighth of the drift.
    assert!(fine < 0.3 * coarse, "{coarse} {fine}");
}

#[test]
fn imu_at_rest_shows_gravity() {
    let mut body = body(0.002);
    for _ in 0..500 {
        body.step(&[JointDrive::Servo { set_point_rad: 0.0 }; 6]);
    }
    let imu = body.imu();
    assert!((imu.accel_m_s2[2] - GRAVITY_M_S2).abs() < 0.05, "{imu:?}");
    assert!(imu.gyro_rad_s.iter().all(|w| w.abs() < 1e-3), "{imu:?}");
}

#[test]
fn reaction_torque_is_that_of_the_lifted_weight() {
    // Module B folded up about A.M2's neighbour would need its path; here: in the air, accelerate one joint and compare with its inertia.
    let mut body = body(0.001);
    body.place(&high(), &Twist::default(), &[0.0; 6], &[0.0; 6])
        .unwrap();
    let mut drives = [JointDrive::Speed {
        rad_s: 0.0,
        limit_nm: f64::INFINITY,
    }; 6];
    body.step(&drives);
    let inertia: Vec<f64> = body.inertias_kg_m2().collect();
    for joint in 0..6 {
        body.place(&high(), &Twist::default(), &[0.0; 6], &[0.0; 6])
            .unwrap();
        drives[joint] = JointDrive::Speed {
            rad_s: 0.01,
            limit_nm: f64::INFINITY,
        };
        body.step(&drives);
        let torque = body.torques_nm().nth(joint).unwrap();
        let expected = inertia[joint] * 0.01 / 0.001;
        assert!(
            (torque - expected).abs() < 1e-6,
            "joint {joint}: {torque} N m, {expected} N m"
        );
        drives[joint] = JointDrive::Speed {
            rad_s: 0.0,
            limit_nm: f64::INFINITY,
        };
    }
}

#[test]
fn batch_and_body_are_one_engine() {
    let set_point = [0.3f32, -0.2, 0.4, 0.1, -0.5, 0.2];
    let mut body = body(0.004);
    let drives = set_point.map(|x| JointDrive::Servo {
        set_point_rad: f64::from(x),
    });
    for _ in 0..250 {
        body.step(&drives);
    }
    let trial = Trial {
        params: Arc::new(Params::try_from(&Model::hand_tuned()).unwrap()),
        start: Start::HomeAtOnce,
        drive: Drive::SetPoints {
            period_s: 1.0,
            values_rad: Arc::from(set_point),
        },
        duration_s: 1.0,
    };
    let out = run_at(Level::Reference, &[trial], &Options::default()).unwrap();
    assert_eq!(*out[0].poses.last().unwrap(), body.base());
}
