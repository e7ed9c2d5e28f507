//! Orders: what is accepted when, and what moves because of it.

use crate::common::{gait, ready};
use hil_sim::robot::host::{AskError, SimHost};
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::bus::Request;
use protocol::link::{BusStatus, FromModule, ModuleState, Reject, Tag, TelemetryRate, ToModule};

/// Power is up, and the module has said who it is.
fn powered() -> (EmulatedRobot, SimHost) {
    let mut robot = EmulatedRobot::ideal(Setup::default());
    let mut host = SimHost::new(robot.link());
    robot.run_for(200_000);
    host.hello(&mut robot).expect("answers");
    (robot, host)
}

#[test]
fn after_power_up_the_module_is_unhomed_and_refuses_to_start() {
    let (mut robot, mut host) = powered();
    let digest = host
        .upload(&mut robot, 0, &gait(0))
        .expect("uploading needs no zero");
    let FromModule::Info(info) = host.ask(&mut robot, &ToModule::GetInfo).expect("answers") else {
        panic!()
    };
    assert_eq!(
        (info.state, info.homed_mask, info.motor_mask),
        (ModuleState::Unhomed, 0, 63)
    );
    let refused = host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off);
    assert_eq!(
        refused,
        Err(AskError::Rejected(Reject::NotHomed { missing_mask: 63 }))
    );
    robot.run_for(2_000_000);
    for joint in 0..6 {
        assert!(
            robot.motors().borrow().taken(joint).is_empty()
                && !robot.motors().borrow().torque(joint)
        );
    }
}

#[test]
fn stop_is_effective_within_one_cycle_and_three_ms_at_any_phase() {
    let mut worst_us = 0;
    for phase_us in (0..50_000).step_by(1_700) {
        let (mut robot, mut host, digest) = ready(3);
        host.start(&mut robot, 0, digest, 60_000, TelemetryRate::Off)
            .expect("ready");
        robot.run_for(6_000_000 + phase_us);
        let at_us = robot.now_us();
        let answer = host.ask(&mut robot, &ToModule::Stop);
        assert_eq!(answer, Ok(FromModule::Ack { request: 9 }));
        let FromModule::Info(info) = host.ask(&mut robot, &ToModule::GetInfo).expect("answers")
        else {
            panic!()
        };
        assert_eq!(info.state, ModuleState::Stopping);
        let end = host
            .wait_for_end(&mut robot, 10_000_000)
            .expect("the ramp ends");
        assert_eq!(end.reason, protocol::link::EndReason::Stopped);
        // The first set-point after the order already belongs to the ramp: the count of gait cycles stops before it.
        let after = robot
            .motors()
            .borrow()
            .taken(0)
            .into_iter()
            .find(|taken| taken.at_ns > at_us * 1000);
        let latency_us = after.expect("the ramp moves").at_ns / 1000 - at_us;
        worst_us = worst_us.max(latency_us);
        assert!((0..6).all(|joint| !robot.motors().borrow().torque(joint)));
    }
    println!("STOP: first set-point of the ramp {worst_us} us after the order at the latest");
    assert!(worst_us <= 53_000, "{worst_us} us");
}

/// The joint was placed while the task stood still: the zero was that of before, 150 ms old.
#[test]
fn a_reading_of_before_a_stall_becomes_no_zero() {
    let mut robot = EmulatedRobot::ideal(Setup {
        link_byte_ns: 0,
        ..Setup::default()
    });
    let mut host = SimHost::new(robot.link());
    host.hello(&mut robot).expect("answers");
    let zero = ToModule::Zero {
        joint_mask: 63,
        tag: Tag::NONE,
    };
    robot.run_until(310_000);
    robot.motors().borrow_mut().stall_once(110_000);
    robot.run_until(355_000);
    robot.motors().borrow_mut().place(0, 50_000);
    robot.run_until(480_000);
    let refused = host.ask(&mut robot, &zero);
    let Err(AskError::Rejected(Reject::MotorsMissing { missing_mask })) = refused else {
        panic!("{refused:?}")
    };
    assert_eq!(missing_mask & 1, 1);
    robot.run_until(510_000);
    host.ask(&mut robot, &zero).expect("read again");
}

#[test]
fn a_zero_of_no_joint_or_of_one_that_is_not_there_is_refused() {
    let (mut robot, mut host) = powered();
    for joint_mask in [0, 1 << 6, 0b111_1111, 1 << 15] {
        let tag = Tag::NONE;
        let refused = host.ask(&mut robot, &ToModule::Zero { joint_mask, tag });
        let wanted = Err(AskError::Rejected(Reject::JointMask));
        assert_eq!(refused, wanted, "{joint_mask:b}");
    }
}

#[test]
fn more_than_a_reply_holds_is_said_to_be_too_much() {
    let (mut robot, mut host) = powered();
    // An answer has 11 bytes more than it carries.
    for (len, status) in [(30, BusStatus::Heard), (60, BusStatus::Overflow)] {
        let request = Request::sync_read(0, len, &[1, 2, 3, 4, 5, 6]).expect("fits");
        let order = ToModule::BusRaw {
            bytes: heapless::Vec::from_slice(request.bytes()).expect("fits"),
            listen_ms: 100,
            tag: Tag::NONE,
        };
        let answer = host.ask(&mut robot, &order).expect("allowed at rest");
        let FromModule::BusReply {
            status: found,
            bytes,
        } = answer
        else {
            panic!("{answer:?}")
        };
        assert_eq!(found, status, "{len} bytes of each of six");
        assert!(bytes.len() > 200, "{} bytes", bytes.len());
    }
}
