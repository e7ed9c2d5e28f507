//! The driver's loop and supervision, without the bus.

use hil_sim::driver::{GoalError, Watchdog, error_bit};
use hil_sim::effects;
use hil_sim::motor::JointKind;
use hil_sim::world::{World, WorldParams};

const MS: u64 = 1_000_000;

fn bench(effects_on: &[(&str, &str, f64)]) -> World {
    let mut params = WorldParams::bench(5, JointKind::Intra.neutral());
    for (effect, key, value) in effects_on {
        effects::set(&mut params, effect, Some(0), key, *value).expect("known effect");
    }
    World::on_stand(&params).expect("valid")
}

fn angle(world: &World) -> f64 {
    world.joint(0).expect("one joint").link_rad
}

/// Torque on, one set-point, then the angle at each of `times_ms` after it.
fn step_response(world: &mut World, goal_rad: f64, times_ms: &[u64]) -> Vec<f64> {
    world.advance_to(10 * MS);
    let start = world.now_ns();
    let driver = world.driver_mut(0).expect("one driver");
    assert!(driver.set_torque(true));
    driver.set_goal(goal_rad, start).expect("plausible");
    times_ms
        .iter()
        .map(|ms| {
            world.advance_to(start + ms * MS);
            angle(world)
        })
        .collect()
}

/// In its linear range the loop is second order with kp kv and the motor's own damping: e^(st) of the slow pole.
#[test]
fn small_step_follows_the_closed_loop_poles() {
    let mut world = bench(&[]);
    let motor = JointKind::Intra.neutral().motor;
    let stall = motor.stall_torque_nm(12.0);
    let inertia = motor.reflected_inertia_kg_m2() + 1.31e-3;
    // J s^2 + (kv T + T/w0) s + kp kv T = 0 with T the stall torque per unit duty; torque stays under the limit.
    let (kp, kv) = (10.0, 0.8);
    let b = (kv * stall + stall / motor.no_load_speed_rad_s(12.0)) / inertia;
    let c = kp * kv * stall / inertia;
    let slow = (b - (b * b - 4.0 * c).sqrt()) / 2.0;
    let fast = (b + (b * b - 4.0 * c).sqrt()) / 2.0;
    let goal = 0.02;
    let times = [100, 200, 300, 400];
    for (ms, measured) in times.iter().zip(step_response(&mut world, goal, &times)) {
        let t = *ms as f64 * 1e-3;
        let expected =
            goal * (1.0 - (fast * (-slow * t).exp() - slow * (-fast * t).exp()) / (fast - slow));
        // One to two ticks of sampling delay at a speed below slow * goal.
        assert!(
            (measured - expected).abs() < 2.5e-3 * slow * goal + 1e-5,
            "{ms} ms: {measured} for {expected}"
        );
    }
}

#[test]
fn large_step_settles_without_overshoot_or_error() {
    let mut world = bench(&[]);
    let times: Vec<u64> = (1..=300).map(|k| k * 10).collect();
    let angles = step_response(&mut world, 1.5, &times);
    let highest = angles.iter().fold(0.0_f64, |a, b| a.max(*b));
    assert!(highest < 1.5 + 1e-4, "overshoot to {highest}");
    assert!(
        (angles[299] - 1.5).abs() < 1e-4,
        "settled at {}",
        angles[299]
    );
}

#[test]
fn integral_action_removes_the_load_error_and_does_not_wind_up() {
    let end_error = |ki: f64| {
        let mut params = WorldParams::bench(5, JointKind::Intra.neutral());
        params.joints[0].load.gravity_nm = 3.0;
        params.joints[0].driver.control.ki_1_rad_s = ki;
        let mut world = World::on_stand(&params).expect("valid");
        let times: Vec<u64> = (1..=600).map(|k| k * 10).collect();
        let angles = step_response(&mut world, 1.2, &times);
        let overshoot = angles.iter().fold(0.0_f64, |a, b| a.max(*b)) - 1.2;
        (angles[599] - 1.2, overshoot)
    };
    // Proportional: the load holds off 3 sin(1.2) N m / (kp kv stall).
    let stall = JointKind::Intra.neutral().motor.stall_torque_nm(12.0);
    let (droop, _) = end_error(0.0);
    assert!(
        (droop + 3.0 * 1.2_f64.sin() / (8.0 * stall)).abs() < 1e-3,
        "{droop}"
    );
    let (rest, overshoot) = end_error(10.0);
    assert!(rest.abs() < 2e-4, "{rest}");
    assert!(overshoot < 0.05, "{overshoot}");
}

#[test]
fn velocity_limit_holds() {
    let mut world = bench(&[("velocity_limit", "limit_rad_s", 0.5)]);
    let angles = step_response(&mut world, 2.0, &[1000, 2000, 3000]);
    assert!((angles[1] - angles[0] - 0.5).abs() < 1e-3, "{angles:?}");
    assert!((angles[2] - angles[1] - 0.5).abs() < 1e-3, "{angles:?}");
}

#[test]
fn driver_effects_show_as_named() {
    let times = [50, 100, 2000];
    let plain = step_response(&mut bench(&[]), 0.1, &times);
    let late = step_response(
        &mut bench(&[("latency", "delay_s", 0.050)]),
        0.1,
        &[50, 100, 150],
    );
    assert!(
        late[0].abs() < 1e-6,
        "moved before the latency had passed: {}",
        late[0]
    );
    assert!(
        (late[1] - plain[0]).abs() < 1e-3 && (late[2] - plain[1]).abs() < 1e-3,
        "{late:?} {plain:?}"
    );
    let banded = step_response(
        &mut bench(&[("deadband", "half_width_rad", 0.01)]),
        0.1,
        &times,
    );
    assert!((banded[2] - 0.09).abs() < 1e-4, "{banded:?}");
    let scaled = step_response(&mut bench(&[("joint_scale", "ratio", 2.0)]), 0.1, &times);
    assert!((scaled[2] - 0.2).abs() < 1e-4, "{scaled:?}");
    let mirrored = step_response(&mut bench(&[("joint_sign", "sign", -1.0)]), 0.1, &times);
    assert!((mirrored[2] + 0.1).abs() < 1e-4, "{mirrored:?}");
    let offset = step_response(
        &mut bench(&[("joint_offset", "offset_rad", 0.03)]),
        0.1,
        &times,
    );
    assert!((offset[2] - 0.13).abs() < 1e-4, "{offset:?}");
    let coarse = step_response(
        &mut bench(&[("quantisation", "step_rad", 0.04)]),
        0.1,
        &times,
    );
    assert!(
        (coarse[2] - 0.08).abs() < 1e-4 || (coarse[2] - 0.12).abs() < 1e-4,
        "{coarse:?}"
    );
    let lagging = step_response(
        &mut bench(&[("motor_lag", "time_constant_s", 0.02)]),
        0.1,
        &times,
    );
    assert!(lagging[0] < plain[0] - 3e-4, "{lagging:?} {plain:?}");
    let drifting = step_response(&mut bench(&[("zero_drift", "rad_s", 0.01)]), 0.0, &times);
    assert!((drifting[2] + 0.02).abs() < 2e-3, "{drifting:?}");
}

#[test]
fn silence_expires_the_watchdog_damps_and_stays_latched() {
    let mut world = bench(&[]);
    step_response(&mut world, 1.0, &[100]);
    let now = world.now_ns();
    let driver = world.driver_mut(0).expect("one");
    driver.set_watchdog(Some(150_000), now);
    for k in 1..=20 {
        let driver = world.driver_mut(0).expect("one");
        driver.heard(now + (k - 1) * 100 * MS);
        world.advance_to(now + k * 100 * MS);
    }
    assert!(matches!(
        world.driver(0).expect("one").watchdog(),
        Watchdog::Armed { .. }
    ));
    let last = world.now_ns();
    // Last heard 100 ms ago: 50 ms of grace are left.
    world.advance_to(last + 49 * MS);
    assert!(matches!(
        world.driver(0).expect("one").watchdog(),
        Watchdog::Armed { .. }
    ));
    world.advance_to(last + 53 * MS);
    let driver = world.driver_mut(0).expect("one");
    assert_eq!(driver.watchdog(), Watchdog::Expired);
    let bridge = driver.bridge();
    assert!(
        bridge.enabled && bridge.duty == 0.0,
        "shorted winding: damped, not driven"
    );
    driver.heard(last + 53 * MS);
    assert_eq!(
        driver.set_goal(0.9, last + 53 * MS),
        Err(GoalError::WatchdogExpired)
    );
    driver.set_watchdog(None, last + 53 * MS);
    assert_eq!(driver.set_goal(0.9, last + 53 * MS), Ok(()));
}

#[test]
fn implausible_set_points_are_refused() {
    let mut world = bench(&[]);
    step_response(&mut world, 0.5, &[1000]);
    let now = world.now_ns();
    let driver = world.driver_mut(0).expect("one");
    for bad in [f64::NAN, f64::INFINITY, -f64::INFINITY, 3.7, -2.7] {
        assert_eq!(
            driver.set_goal(bad, now),
            Err(GoalError::Implausible),
            "{bad}"
        );
    }
    world.advance_to(now + 100 * MS);
    assert!(
        (angle(&world) - 0.5).abs() < 1e-3,
        "a refused set-point moved the joint"
    );
}

#[test]
fn a_jam_latches_overload_and_only_a_reboot_clears_it() {
    let mut world = bench(&[]);
    world.set_stall(0, true);
    step_response(&mut world, 1.0, &[2000]);
    assert!(world.driver(0).expect("one").torque_on());
    world.advance_to(world.now_ns() + 2000 * MS);
    let now = world.now_ns();
    let driver = world.driver_mut(0).expect("one");
    assert_eq!(driver.hardware_error(), error_bit::OVERLOAD);
    assert!(!driver.torque_on());
    assert!(
        !driver.set_torque(true),
        "torque came on under a latched error"
    );
    driver.reboot(now);
    assert_eq!(driver.hardware_error(), 0);
    assert!(driver.set_torque(true));
}

#[test]
fn a_reboot_loses_the_zero_and_drops_the_torque() {
    let mut world = bench(&[]);
    step_response(&mut world, 0.7, &[1500]);
    let now = world.now_ns();
    let driver = world.driver_mut(0).expect("one");
    assert!((driver.readings().position_rad - 0.7).abs() < 1e-3);
    let boots = driver.boots();
    driver.reboot(now);
    world.advance_to(now + 5 * MS);
    let driver = world.driver(0).expect("one");
    assert_eq!(driver.boots(), boots + 1);
    assert!(
        driver.readings().position_rad.abs() < 1e-6,
        "{}",
        driver.readings().position_rad
    );
    assert!(!driver.torque_on());
    assert!(driver.readings().at_us <= 5_000);
}

#[test]
fn moving_the_zero_moves_nothing() {
    let mut world = bench(&[]);
    step_response(&mut world, 0.7, &[1500]);
    let before = angle(&world);
    let now = world.now_ns();
    world.driver_mut(0).expect("one").set_home(-0.25);
    world.advance_to(now + 200 * MS);
    assert!((angle(&world) - before).abs() < 1e-4);
    let driver = world.driver(0).expect("one");
    assert!((driver.readings().position_rad - (before - 0.25)).abs() < 1e-4);
}
