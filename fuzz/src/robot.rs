//! The firmware's application behind both of its links: orders, time, switches.

use firmware::ports::ResetCause;
use hil_sim::robot::ideal::IdealMotors;
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::link::{Decoder, SOURCE_HOST, VERSION};

use crate::Bytes;
use crate::wires::framed;

/// Most operations of one input: a robot's second costs a thousand times a packet.
const OPERATIONS: usize = 24;
/// STOP and what the ramp and the hold after it take at most, us.
const AT_REST_US: u64 = 6_000_000;
/// How often it is looked whether all drivers have let go, us.
const LOOK_US: u64 = 200_000;
/// Types of STOP and PING on the wire.
const STOP: u8 = 9;

/// Whatever comes, the set-points stay within their limits, and STOP leaves no motor moving.
pub(crate) fn orders(data: &[u8]) {
    let mut input = Bytes::new(data);
    let setup = Setup {
        seed: u64::from(input.byte()),
        link_byte_ns: 0,
        radio: true,
        ..Setup::default()
    };
    let mut robot = EmulatedRobot::with_motors(setup, IdealMotors::new(false));
    let mut sequence = 0_u16;
    let mut boot_id = boot_id(&mut robot);
    for _ in 0..OPERATIONS {
        if input.is_empty() {
            break;
        }
        sequence += 1;
        let kind = input.byte();
        let line = if kind & 0x10 == 0 {
            robot.link()
        } else {
            robot.radio()
        };
        match kind % 16 {
            0..=8 => {
                let kind = input.byte();
                let _ = line.write(&framed(SOURCE_HOST, sequence, boot_id, kind, input.block()));
            }
            9 => {
                robot.reset(ResetCause::Pin);
                boot_id = self::boot_id(&mut robot);
            }
            10 => _ = line.write(input.block()),
            11 => robot.board().set_stop_input(input.byte() & 1 == 1),
            12 => {
                let battery_mv = u16::from(input.byte()) * 100;
                robot.board().set_battery_mv(Some(battery_mv));
            }
            13 => {
                let (joint, place) = (usize::from(input.byte()) % 6, input.byte());
                let place_urad = (i32::from(place) - 128) * 50_000;
                robot.motors().borrow_mut().place(joint, place_urad);
            }
            14 => robot
                .motors()
                .borrow_mut()
                .restart(usize::from(input.byte()) % 6),
            _ => robot.run_for(10_000 * u64::from(input.byte())),
        }
        robot.run_for(60_000);
        check(&robot);
    }
    let _ = robot.link().write(&framed(SOURCE_HOST, 999, 0, STOP, &[]));
    // Most inputs start no run: the drivers have let go at once.
    let driving = |robot: &EmulatedRobot| {
        let motors = robot.motors().borrow();
        (0..6).any(|joint| motors.is_driving(joint))
    };
    let until_us = robot.now_us() + AT_REST_US;
    robot.run_for(LOOK_US);
    while driving(&robot) && robot.now_us() < until_us {
        robot.run_for(LOOK_US);
    }
    assert!(!driving(&robot), "a driver has torque after STOP");
    check(&robot);
    let moving = |robot: &EmulatedRobot| {
        (0..6)
            .map(|k| robot.motors().borrow().position_urad(k))
            .collect::<Vec<_>>()
    };
    let before = moving(&robot);
    robot.run_for(LOOK_US);
    assert_eq!(before, moving(&robot), "a motor moves after STOP");
}

/// The boot id that the robot says in its answer to HELLO.
fn boot_id(robot: &mut EmulatedRobot) -> u32 {
    robot.run_for(50_000);
    let line = robot.link();
    let mut bytes = Vec::new();
    line.read(&mut bytes);
    let _ = line.write(&framed(SOURCE_HOST, 998, 0, 0, &[VERSION]));
    robot.run_for(20_000);
    bytes.clear();
    line.read(&mut bytes);
    let mut decoder = Decoder::new();
    let boot_id = |byte| decoder.push(byte).map(|frame| frame.header.boot_id);
    bytes.into_iter().filter_map(boot_id).last().unwrap_or(0)
}

/// Every set-point that a driver took lies within the range of the joint and within a cycle of where the joint stands.
fn check(robot: &EmulatedRobot) {
    for joint in 0..6 {
        // No-load speeds of the paper's Table I, and the rounding of wire counts.
        let rpm = if joint % 3 == 1 { 19.4 } else { 26.6 };
        let step_urad = (rpm / 60.0 * core::f64::consts::TAU * 0.05 * 1e6) as i32 + 12;
        for taken in robot.motors().borrow().taken(joint) {
            assert!(
                (taken.goal_urad - taken.from_urad).abs() <= step_urad,
                "joint {joint} steps from {} to {}",
                taken.from_urad,
                taken.goal_urad
            );
        }
    }
}
