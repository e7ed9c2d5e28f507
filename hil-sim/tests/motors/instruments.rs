//! Camera, tracker and inertial sensor beside the robot: rates, clocks, places and noise against what the scenario says.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use std::any::Any;

use control::robot::RobotModel;
use hil_sim::ground::Ground;
use hil_sim::lab::Lab;
use hil_sim::scenario::parse;
use hil_sim::world::World;

const SCENARIO: &str = r#"
body = "ground"
seed = 9
[start]
x_m = 0.3
y_m = -0.2
yaw_deg = 90
[camera]
height_m = 2.0
x_m = 0.1
clock_ahead_s = 5.01
clock_ratio = 1.001
[tracker]
rate_hz = 50
sigma_m = 0.001
sigma_deg = 0.5
[imu]
rate_hz = 200
gyro_sigma_rad_s = 0.01
accel_sigma_m_s2 = 0.05
"#;

fn rest(text: &str, until_s: f64) -> World {
    let mut world = parse("lab.toml", text).unwrap().build().unwrap();
    world.advance_to((until_s * 1e9) as u64);
    world
}

fn lab(world: &World) -> &Lab {
    let body: &dyn Any = world.plant().body();
    body.downcast_ref::<Ground>().unwrap().lab().unwrap()
}

fn mean_and_sigma(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64;
    (mean, square.sqrt())
}

/// Frames come at whole periods of the camera's own clock, which is ahead and fast.
#[test]
fn frames_follow_the_cameras_clock() {
    let world = rest(SCENARIO, 2.0);
    let times: Vec<f64> = lab(&world)
        .film(&RobotModel::default())
        .map(|(t_s, _)| t_s)
        .collect();
    // From 5.01 s to 5.01 + 2 x 1.001 s: the readings 151/30 to 210/30.
    assert_eq!(times.len(), 60);
    assert!((times[0] - 151.0 / 30.0).abs() < 1e-12);
    for pair in times.windows(2) {
        assert!((pair[1] - pair[0] - 1.0 / 30.0).abs() < 1e-9);
    }
}

/// A robot at rest is seen where it was put down: in the picture, by the tracker, and by gravity.
#[test]
fn a_robot_at_rest_is_seen_where_it_lies() {
    let world = rest(SCENARIO, 4.0);
    let lab = lab(&world);
    let (_, frame) = lab.film(&RobotModel::default()).last().unwrap();
    let (x_px, y_px) = frame.centre_px().unwrap();
    // Body 3 lies in the middle of the robot; outline at half a cube's height: 580 px / (2.0 - 0.055) m.
    let scale = 580.0 / (2.0 - 0.055);
    assert!((x_px - (320.0 + scale * (0.3 - 0.1))).abs() < 4.0, "{x_px}");
    assert!((y_px - (240.0 + scale * 0.2)).abs() < 4.0, "{y_px}");
    let column = |pick: &dyn Fn(&hil_sim::lab::Tracked) -> f64| {
        mean_and_sigma(&lab.poses().map(pick).collect::<Vec<_>>())
    };
    let (x_m, x_sigma_m) = column(&|pose| pose.position_m[0]);
    assert!((x_m - 0.3).abs() < 5e-4, "{x_m}");
    assert!((x_sigma_m - 0.001).abs() < 3e-4, "{x_sigma_m}");
    let (yaw_rad, yaw_sigma_rad) =
        column(&|pose| 2.0 * pose.quaternion[3].atan2(pose.quaternion[0]));
    assert!((yaw_rad.to_degrees() - 90.0).abs() < 0.2, "{yaw_rad}");
    assert!(
        (yaw_sigma_rad.to_degrees() - 0.5).abs() < 0.15,
        "{yaw_sigma_rad}"
    );
    let late: Vec<f64> = lab
        .readings()
        .filter(|reading| reading.t_s > 1.0)
        .map(|reading| reading.accel_m_s2[2])
        .collect();
    let (g, g_sigma) = mean_and_sigma(&late);
    assert!((g - 9.81).abs() < 0.02, "{g}");
    assert!((g_sigma - 0.05).abs() < 0.01, "{g_sigma}");
    assert!((late.len() as f64 - 600.0).abs() <= 1.0, "{}", late.len());
}

/// Placing by hand differs from seed to seed by what the scenario says; instruments change nothing of the motion.
#[test]
fn repeats_are_put_down_differently_and_watching_changes_nothing() {
    let text = SCENARIO.replace("yaw_deg = 90", "sigma_m = 0.01\nsigma_deg = 2");
    let scenario = parse("lab.toml", &text).unwrap();
    let place = |repeat: u64| {
        let world = scenario.clone().repeat(repeat).build().unwrap();
        let body: &dyn Any = world.plant().body();
        f64::from(body.downcast_ref::<Ground>().unwrap().base().position_m[0])
    };
    let places: Vec<f64> = (0..200).map(place).collect();
    let (mean, sigma) = mean_and_sigma(&places);
    assert!(
        (mean - 0.3).abs() < 0.003 && (sigma - 0.01).abs() < 0.002,
        "{mean} {sigma}"
    );
    let watched = rest(SCENARIO, 0.5);
    let alone = SCENARIO.split("[camera]").next().unwrap();
    let alone = rest(alone, 0.5);
    let base = |world: &World| {
        let body: &dyn Any = world.plant().body();
        body.downcast_ref::<Ground>().unwrap().base()
    };
    assert_eq!(base(&watched), base(&alone));
}
