//! Motors and body together: the robot on the ground.

use std::any::Any;
use std::sync::Arc;

use files::model::Model;
use hil_sim::ground::Ground;
use hil_sim::motor::JointKind;
use hil_sim::recorder::{Plan, Row, record};
use hil_sim::world::{World, WorldParams};
use physics::{Options, Params};

const IDS: [u8; 6] = [1, 2, 3, 4, 5, 6];

fn robot(step_s: f64) -> World {
    let params = Arc::new(Params::try_from(&Model::hand_tuned()).expect("shipped model"));
    let options = Options {
        time_step_s: step_s,
        ..Options::default()
    };
    let ground = Ground::new(params, &options).expect("valid step");
    let mut world = WorldParams::metamodule(1, JointKind::catalogue_joint);
    ground.suit(&mut world);
    World::new(&world, Box::new(ground)).expect("valid")
}

fn ground(world: &World) -> &Ground {
    (world.plant().body() as &dyn Any)
        .downcast_ref()
        .expect("a robot on the ground")
}

fn swing(t_s: f64) -> Vec<f64> {
    let phase = std::f64::consts::TAU * 0.2 * t_s;
    (0..6)
        .map(|k| {
            0.5 * (phase + 1.5 * f64::from(k)).sin()
                - 0.5 * (1.5 * f64::from(k)).sin() * (-t_s).exp()
        })
        .collect()
}

#[test]
fn a_robot_told_to_hold_home_stays_where_it_lies() {
    let mut world = robot(0.001);
    let before = ground(&world).base();
    let plan = Plan {
        duration_s: 2.0,
        ..Plan::default()
    };
    record(&mut world, &IDS, &plan, &mut |_| vec![0.0; 6]).expect("healthy");
    let after = ground(&world).base();
    for (a, b) in before.position_m.iter().zip(after.position_m) {
        assert!((a - b).abs() < 2e-3, "{before:?} {after:?}");
    }
}

/// A gait moves the robot; joints follow their set-points with a bounded lag; nothing rings; it repeats bit for bit.
#[test]
fn a_gait_moves_the_robot_and_repeats() {
    let run = |step_s| {
        let mut world = robot(step_s);
        let plan = Plan {
            duration_s: 10.0,
            feedback_hz: 20,
            link: true,
            ..Plan::default()
        };
        let rows = record(&mut world, &IDS, &plan, &mut swing).expect("healthy");
        let base = ground(&world).base();
        (rows, base)
    };
    let (rows, base) = run(0.001);
    let mut worst = 0.0_f64;
    let mut roughest = 0.0_f64;
    let mut last: Option<Vec<f64>> = None;
    for row in &rows {
        if let Row::Reading { t_s, joints } = row {
            let position: Vec<f64> = joints
                .iter()
                .map(|m| f64::from(m.expect("answers").feedback.position_urad) * 1e-6)
                .collect();
            for (angle, goal) in position.iter().zip(swing(*t_s)) {
                worst = worst.max((angle - goal).abs());
            }
            if let Some(before) = &last {
                let step = position
                    .iter()
                    .zip(before)
                    .map(|(a, b)| (a - b).abs())
                    .fold(0.0, f64::max);
                roughest = roughest.max(step);
            }
            last = Some(position);
        }
    }
    assert!(worst < 0.25, "a joint was {worst} rad off");
    // The fastest set-point moves 0.5 * 1.26 rad/s * 50 ms = 32 mrad per reading.
    assert!(roughest < 0.08, "a joint jumped {roughest} rad in 50 ms");
    let [x, y, z] = base.position_m;
    assert!(x.hypot(y) > 0.01 && z < 0.4, "{base:?}");
    assert_eq!(rows, run(0.001).0, "bit for bit");
    let coarse = run(0.002).1;
    println!(
        "base after 10 s: {:?} at 1 ms, {:?} at 2 ms",
        base.position_m, coarse.position_m
    );
}

/// At rest in a raised pose the motors hold what the body weighs on them, with steady currents.
#[test]
fn holding_a_raised_pose_does_not_ring() {
    let mut world = robot(0.001);
    // Joint A.M2 folds the end of module A up.
    let pose = |t_s: f64| {
        let mut pose = vec![0.0; 6];
        pose[2] = 1.2 * (t_s / 3.0).min(1.0);
        pose
    };
    let plan = Plan {
        duration_s: 6.0,
        ..Plan::default()
    };
    let rows = record(&mut world, &IDS, &plan, &mut |t| pose(t)).expect("healthy");
    let mut held = Vec::new();
    for k in 0..6 {
        let late = rows.iter().filter_map(|row| match row {
            Row::Reading { t_s, joints } if *t_s > 5.0 => joints[k],
            _ => None,
        });
        let currents: Vec<f64> = late
            .map(|m| f64::from(m.feedback.current_ma) * 1e-3)
            .collect();
        let mean = currents.iter().sum::<f64>() / currents.len() as f64;
        let spread = currents
            .iter()
            .fold(0.0_f64, |worst, a| worst.max((a - mean).abs()));
        let motor = &world.plant().params()[k].motor;
        held.push(mean * motor.kt_nm_a * motor.ratio);
        assert!(spread < 0.005, "joint {k} rings: {spread} A");
    }
    assert!(
        held.iter().any(|nm| nm.abs() > 0.1),
        "something must be heavy: {held:?}"
    );
}
