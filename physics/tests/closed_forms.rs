//! The engine against formulas: free fall, pendulum, sliding, bounce, holding torque, momentum.
// Helpers outside `#[test]` functions may fail a test by panicking too.
#![allow(clippy::unwrap_used)]

use files::model::{Effect, Key, Model};
use physics::{
    Drive, GRAVITY_M_S2, JointClass, Level, Options, Outcome, Params, Pose, RawBody, RawHalf,
    RawRobot, Robot, Start, Trial, Twist, run_at,
};
use std::sync::Arc;

const LEVELS: [Level; 2] = [Level::Reference, Level::Avx512];

fn at(z: f32) -> Pose {
    Pose {
        position_m: [0.0, 0.0, z],
        quaternion: [1.0, 0.0, 0.0, 0.0],
    }
}

fn still(params: Params, base: Pose, twist: Twist, duration_s: f64) -> Trial {
    Trial {
        params: Arc::new(params),
        start: Start::State {
            base,
            twist,
            angles_rad: vec![0.0; 6],
            speeds_rad_s: vec![0.0; 6],
        },
        drive: Drive::SetPoints {
            period_s: 1.0,
            values_rad: Arc::from([0.0; 6]),
        },
        duration_s,
    }
}

fn one(level: Level, trial: Trial, time_step_s: f64) -> Outcome {
    let options = Options {
        time_step_s,
        sample_rate_hz: 1.0 / time_step_s,
        record_motors: true,
        record_angles: true,
        ..Options::default()
    };
    let out = run_at(level, &[trial], &options).unwrap().remove(0);
    assert_eq!(out.not_finite, None);
    out
}

fn hand() -> Params {
    Params::try_from(&Model::hand_tuned()).unwrap()
}

#[test]
fn free_fall() {
    for level in LEVELS {
        let h = 0.001;
        let out = one(level, still(hand(), at(3.0), Twist::default(), 0.5), h);
        let fallen = 3.0 - f64::from(out.poses.last().unwrap().position_m[2]);
        // Semi-implicit Euler: g t (t + h) / 2, without rounding.
        let exact = 0.5 * GRAVITY_M_S2 * 0.5 * (0.5 + h);
        assert!((fallen - exact).abs() < 2e-5, "{level:?}: {fallen} {exact}");
    }
}

#[test]
fn sliding_distance() {
    // v^2 / (2 mu g), less v h / 2 of a first-order step; a robot lying flat, no bounce. Above mu = 0.52 it would tip over sideways.
    for level in LEVELS {
        for (mu, v) in [(0.3, 0.6f32), (0.45, 1.0)] {
            let mut model = Model::hand_tuned();
            model.set(Key::Friction, mu).unwrap();
            model.set(Key::Bounce, 0.0).unwrap();
            let params = Params::try_from(&model).unwrap();
            // One millisecond's weight deep: where the ground carries the robot from the start.
            let twist = Twist {
                linear_m_s: [v * 0.6, v * 0.8, 0.0],
                angular_rad_s: [0.0; 3],
            };
            let out = one(level, still(params, at(0.05499), twist, 1.0), 0.001);
            let end = out.poses.last().unwrap().position_m;
            let distance = f64::from(end[0]).hypot(f64::from(end[1]));
            let exact = f64::from(v * v) / (2.0 * mu * GRAVITY_M_S2) - 0.5 * f64::from(v) * 0.001;
            assert!(
                (distance - exact).abs() < 0.002 * exact,
                "{level:?} mu {mu}: {distance} m, formula {exact} m"
            );
            let turned = end[1] / end[0];
            assert!((turned - 4.0 / 3.0).abs() < 0.01, "direction {turned}");
        }
    }
}

#[test]
fn bounce_height() {
    // Flat on all four faces; after the first bounce e^2 of the height, second e^4.
    for level in LEVELS {
        let mut model = Model::hand_tuned();
        model.set(Key::Bounce, 0.7).unwrap();
        let params = Params::try_from(&model).unwrap();
        let out = one(
            level,
            still(params, at(0.055 + 0.2), Twist::default(), 0.62),
            0.001,
        );
        let heights: Vec<f32> = out.poses.iter().map(|p| p.position_m[2] - 0.055).collect();
        let landed = heights.iter().position(|z| *z < 0.0).unwrap();
        let top = heights[landed..].iter().fold(0.0f32, |a, z| a.max(*z));
        let exact = 0.2 * 0.49;
        // One step of travel at landing speed is 2 mm.
        assert!(
            (f64::from(top) - exact).abs() < 0.003,
            "{level:?}: {top} m, formula {exact}"
        );
        let impact = (2.0 * GRAVITY_M_S2 * 0.2).sqrt();
        assert!((out.impact_m_s - impact).abs() < 0.02, "{}", out.impact_m_s);
    }
}

#[test]
fn resting_robot_stays_and_is_carried() {
    for level in LEVELS {
        let out = one(
            level,
            still(hand(), at(0.055), Twist::default(), 2.0),
            0.004,
        );
        let end = out.poses.last().unwrap();
        assert!(
            end.position_m[0].abs() < 1e-4 && end.position_m[1].abs() < 1e-4,
            "{end:?}"
        );
        assert!((end.position_m[2] - 0.055).abs() < 2e-4, "{end:?}");
        assert!(out.penetration_m.1 < 1e-3, "{:?}", out.penetration_m);
    }
}

/// One cube of which half 0 is bolted to the world and half 1 turns about `axis` through the cube's centre.
fn pendulum(axis: [f64; 3]) -> Robot {
    let e = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let body = |parent, joint| RawBody {
        parent,
        offset_m: [0.0; 3],
        axis,
        joint,
        class: JointClass::Intra,
    };
    RawRobot {
        bodies: vec![body(None, None), body(Some(0), Some(0))],
        halves: vec![
            RawHalf {
                body: 0,
                centre_m: [0.0; 3],
                faces: e.map(|a| a.map(|x| -x)),
                mass_kg: None,
            },
            RawHalf {
                body: 1,
                centre_m: [0.0; 3],
                faces: e,
                mass_kg: None,
            },
        ],
        cubes: vec![[0, 1]],
        pairs: vec![],
        cube_m: 0.11,
        ball_radius_m: 0.062,
        fixed_base: true,
    }
    .try_into()
    .unwrap()
}

fn swing(level: Level, params: Params, angle: f32, h: f64, duration_s: f64) -> Outcome {
    let trial = Trial {
        params: Arc::new(params),
        start: Start::State {
            base: at(1.0),
            twist: Twist::default(),
            angles_rad: vec![angle],
            speeds_rad_s: vec![0.0],
        },
        drive: Drive::SetPoints {
            period_s: 1.0,
            values_rad: Arc::from([0.0]),
        },
        duration_s,
    };
    one(level, trial, h)
}

/// Horizontal axis at right angles to the half's diagonal, so that the centre of mass swings in a vertical plane.
fn swinging() -> (Params, f64, f64, f64) {
    let s = 1.0 / 2.0f64.sqrt();
    let robot = Arc::new(pendulum([s, -s, 0.0]));
    let shape = *robot.shape();
    let mut params = Params::new(&Model::hand_tuned(), robot).unwrap();
    params.joints[0].max_torque_nm = 0.0;
    // Bolted at body 0, half 1 points along (1,1,1): its height is com sin(35.26 deg + angle) for a turn about (1,-1,0)/sqrt 2... see use.
    let mass = params.half_masses_kg[1];
    (params, mass, shape.com_m, shape.centre_inertia_m2)
}

#[test]
fn pendulum_period_and_energy() {
    let (params, mass, com, inertia) = swinging();
    // Elevation of the half's diagonal above the horizon at angle q about (1,-1,0)/sqrt 2: (1,1,1) turns in the plane of (1,1,0) and z.
    let rest = 1.0f64.atan2(2.0f64.sqrt());
    // Axis (1,-1,0) x (1,1,1) = (-1,-1,2)/..: positive angles lift it. Hanging down is -90 deg elevation.
    let hanging = -std::f64::consts::FRAC_PI_2 - rest;
    for level in LEVELS {
        let start = hanging + 0.3;
        let h = 0.0005;
        let out = swing(level, params.clone(), start as f32, h, 4.0);
        let phi: Vec<f64> = out
            .angles_rad
            .iter()
            .map(|q| f64::from(*q) - hanging)
            .collect();
        let crossings: Vec<usize> = (1..phi.len())
            .filter(|k| phi[k - 1] > 0.0 && phi[*k] <= 0.0)
            .collect();
        let periods = crossings.len() - 1;
        let time = (crossings[periods] - crossings[0]) as f64 * h / periods as f64;
        // Pendulum: 2 pi sqrt(I / m g l) (1 + a^2/16 + 11 a^4/3072), inertia per kg, so the mass drops out.
        let a2 = 0.3f64 * 0.3;
        let exact = std::f64::consts::TAU
            * (inertia / (GRAVITY_M_S2 * com)).sqrt()
            * (1.0 + a2 / 16.0 + 11.0 * a2 * a2 / 3072.0);
        assert!(
            (time - exact).abs() < 0.004 * exact,
            "{level:?}: {time} s, formula {exact} s"
        );
        // Energy returns to its start at every turning point: amplitude is kept.
        let late = phi[phi.len() / 2..]
            .iter()
            .fold(0.0f64, |a, x| a.max(x.abs()));
        assert!((late - 0.3).abs() < 0.003, "{level:?}: amplitude {late}");
    }
    assert!(mass > 0.0);
}

#[test]
fn static_hold_torque() {
    // The diagonal held horizontal: m g l.
    let (mut params, mass, com, _) = swinging();
    params.joints[0].max_torque_nm = 4.8;
    let rest = 1.0f64.atan2(2.0f64.sqrt());
    for level in LEVELS {
        let mut trial_params = params.clone();
        trial_params.joints[0].command_offset_rad = -rest;
        let out = swing(level, trial_params, -rest as f32, 0.002, 1.0);
        let torque = f64::from(*out.torques_nm.last().unwrap());
        let exact = mass * GRAVITY_M_S2 * com;
        assert!(
            (torque - exact).abs() < 1e-4 * exact.max(1.0),
            "{level:?}: {torque} N m, formula {exact}"
        );
    }
}

#[test]
fn too_weak_motor_gives_way() {
    let (mut params, mass, com, _) = swinging();
    let rest = 1.0f64.atan2(2.0f64.sqrt());
    let load = mass * GRAVITY_M_S2 * com;
    for (share, holds) in [(1.02, true), (0.98, false)] {
        params.joints[0].max_torque_nm = share * load;
        params.joints[0].command_offset_rad = -rest;
        let out = swing(Level::Avx512, params.clone(), -rest as f32, 0.002, 1.5);
        let end = f64::from(*out.angles_rad.last().unwrap());
        assert_eq!((end + rest).abs() < 0.01, holds, "share {share}: {end}");
    }
}

#[test]
fn coulomb_friction_holds_like_a_motor() {
    // A joint without motor stays where |m g l cos| is below the friction, and swings through where it is above.
    let (mut params, mass, com, _) = swinging();
    let rest = 1.0f64.atan2(2.0f64.sqrt());
    let load = mass * GRAVITY_M_S2 * com;
    for (share, holds) in [(1.05, true), (0.9, false)] {
        params.joints[0].coulomb_nm = share * load;
        params.joints[0].max_speed_rad_s = 0.0;
        let out = swing(Level::Avx512, params.clone(), -rest as f32, 0.002, 1.0);
        let end = f64::from(*out.angles_rad.last().unwrap());
        assert_eq!((end + rest).abs() < 0.01, holds, "share {share}: {end}");
    }
}

#[test]
fn momentum_is_kept_in_free_fall() {
    // Joints driven hard in the air: the centre of mass falls, the base turns, nothing drifts sideways.
    let model = Model::hand_tuned();
    let params = Arc::new(Params::try_from(&model).unwrap());
    let values: Vec<f32> = (0..40).flat_map(|k| [(k as f32 * 0.4).sin(); 6]).collect();
    let trial = Trial {
        params,
        start: Start::State {
            base: at(20.0),
            twist: Twist::default(),
            angles_rad: vec![0.0; 6],
            speeds_rad_s: vec![0.0; 6],
        },
        drive: Drive::SetPoints {
            period_s: 0.05,
            values_rad: values.into(),
        },
        duration_s: 1.5,
    };
    let coarse = one(Level::Reference, trial.clone(), 0.001);
    let fine = one(Level::Reference, trial, 0.00025);
    let (a, b) = (coarse.poses.last().unwrap(), fine.poses.last().unwrap());
    for k in 0..3 {
        let fall = if k == 2 {
            0.5 * GRAVITY_M_S2 * 1.5 * 0.00075
        } else {
            0.0
        };
        let d = f64::from(a.position_m[k] - b.position_m[k]) + fall;
        assert!(d.abs() < 6e-3, "axis {k}: {d}");
    }
}

#[test]
fn slope_starts_to_slide_at_the_friction_angle() {
    for (tilt, slides) in [(0.9, false), (1.1, true)] {
        let mut model = Model::hand_tuned();
        model.set(Key::Friction, 0.5).unwrap();
        model.set(Key::Bounce, 0.0).unwrap();
        let angle = 0.5f64.atan() * tilt;
        model
            .set_effect(Effect::GroundSlope, None, &[0.0, angle])
            .unwrap();
        let params = Params::try_from(&model).unwrap();
        let out = one(
            Level::Avx512,
            still(params, at(0.055), Twist::default(), 1.0),
            0.002,
        );
        let moved = f64::from(out.poses.last().unwrap().position_m[0]);
        if slides {
            let a = GRAVITY_M_S2 * (angle.sin() - 0.5 * angle.cos());
            assert!(
                (moved - 0.5 * a).abs() < 0.03 * a,
                "{moved} against {}",
                0.5 * a
            );
        } else {
            assert!(moved.abs() < 1e-3, "{moved}");
        }
    }
}
