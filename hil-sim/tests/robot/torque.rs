//! What leaves for the drivers rests on what is certain: no torque without a watchdog, no set-point of an old reading.

use crate::common::{check_set_points, gait, ready};
use crate::faults::{expect_end, running};
use hil_sim::robot::host::SimHost;
use hil_sim::robot::ideal::{IdealMotors, Trouble};
use hil_sim::robot::wire::{MotorBus, Received};
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::bus::{Instruction, Register};
use protocol::link::{EndReason, Fault, TelemetryRate};
use std::collections::VecDeque;

/// A driver that restarted between its reading and torque-on got torque without a watchdog, and kept it to the end of the hold.
#[test]
fn a_driver_that_restarts_as_torque_goes_on_is_let_go_at_once() {
    let mut caught = 0;
    for (joint, after_us) in (0..6_000).step_by(250).enumerate() {
        let joint = joint % 6;
        let (mut robot, mut host, digest) = ready(0);
        host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off)
            .expect("ready");
        let cycle_us = robot.now_us().next_multiple_of(50_000);
        robot.run_until(cycle_us + after_us);
        robot.motors().borrow_mut().restart(joint);
        let mut bare_us = 0;
        for _ in 0..2_000 {
            robot.run_for(50);
            let motors = robot.motors().borrow();
            let bare = motors.torque(joint) && !motors.has_watchdog(joint);
            bare_us += if bare { 50 } else { 0 };
        }
        assert!(
            bare_us < 3_000,
            "joint {joint}, {after_us} us: {bare_us} us"
        );
        caught += u32::from(bare_us > 0);
        let end = expect_end(&mut robot, &mut host);
        let joint = joint as u8;
        assert_eq!(end.reason, EndReason::Fault(Fault::DriverReset { joint }));
    }
    assert!(
        caught > 3,
        "{caught} restarts fell between reading and torque"
    );
}

/// A stalled task sent a set-point 47 ms after the reading it rests on.
#[test]
fn a_set_point_that_would_leave_late_does_not_leave() {
    for stall_us in [10_000, 30_000, 46_000, 70_000] {
        let (mut robot, _) = running(0, 10_000);
        let begun_ns = robot.now_us() * 1_000;
        robot.motors().borrow_mut().stall_once(stall_us);
        robot.run_for(300_000);
        check_set_points(&robot);
        let taken = robot.motors().borrow().taken(3);
        let taken = taken.iter().filter(|taken| taken.at_ns > begun_ns);
        let late_us = taken.map(|taken| taken.at_ns / 1_000 % 50_000);
        let most_us = late_us.max().expect("the run goes on");
        assert!(most_us < 25_000, "{most_us} us, stalled for {stall_us} us");
    }
}

/// A stalled task sent torque, and the set-points before it, 92 ms after the reading they rest on.
#[test]
fn torque_that_would_go_on_late_does_not_go_on() {
    for stall_us in [10_000, 24_000, 30_000, 46_000, 70_000] {
        // From the first packet of the cycle to the one before torque-on.
        for after_us in (0..6_000).step_by(500) {
            let (mut robot, mut host, digest) = ready(0);
            host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off)
                .expect("ready");
            let cycle_us = robot.now_us().next_multiple_of(50_000);
            robot.run_until(cycle_us + after_us);
            let before = robot.motors().borrow().torque(0);
            robot.motors().borrow_mut().stall_once(stall_us);
            let mut on_us = 0;
            while !robot.motors().borrow().torque(0) {
                robot.run_for(100);
                on_us = robot.now_us() % 50_000;
            }
            assert!(
                before || on_us < 25_100,
                "{on_us} us, stalled for {stall_us} us"
            );
            let end = expect_end(&mut robot, &mut host);
            assert_eq!(end.reason, EndReason::Completed);
        }
    }
}

/// In the next cycle it was sent where it had stood before, in the frame it had lost.
#[test]
fn a_driver_that_restarts_as_torque_goes_on_and_falls_silent_is_sent_nowhere() {
    let mut caught = 0;
    for (joint, after_us) in (0..6_000).step_by(250).enumerate() {
        let joint = joint % 6;
        let mut motors = IdealMotors::new(false);
        (0..6).for_each(|joint| motors.place(joint, 400_000));
        let mut robot = EmulatedRobot::with_motors(Setup::default(), motors);
        let mut host = SimHost::new(robot.link());
        host.home(&mut robot).expect("drivers answer");
        let digest = host.upload(&mut robot, 0, &gait(0)).expect("clear");
        host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off)
            .expect("ready");
        let cycle_us = robot.now_us().next_multiple_of(50_000);
        robot.run_until(cycle_us + after_us);
        let begun_ns = robot.now_us() * 1_000;
        robot.motors().borrow_mut().restart(joint);
        robot.motors().borrow_mut().trouble(joint, Trouble::Mute);
        robot.run_for(300_000);
        let taken = robot.motors().borrow().taken(joint);
        let mut taken = taken
            .iter()
            .filter(|taken| taken.at_ns > begun_ns && taken.torque);
        let far = taken.find(|taken| taken.goal_urad.abs_diff(taken.from_urad) > 1_000);
        assert_eq!(far, None, "joint {joint}, {after_us} us");
        caught += u32::from(robot.motors().borrow().torque(joint));
    }
    assert!(
        caught > 3,
        "{caught} restarts fell between reading and torque"
    );
}

/// It came after the readings: five silent drivers delayed it by 15 ms.
#[test]
fn the_stop_input_waits_for_no_silent_driver() {
    for after_us in (1_000..50_000).step_by(7_000) {
        let (mut robot, _) = running(0, 50_000);
        let cycle_us = robot.now_us().next_multiple_of(50_000);
        robot.run_until(cycle_us + after_us);
        for joint in 1..6 {
            robot.motors().borrow_mut().trouble(joint, Trouble::Missing);
        }
        robot.board().set_stop_input(true);
        robot.run_until(cycle_us + 51_000);
        assert!(!robot.motors().borrow().torque(0), "{after_us} us");
    }
}

/// Ideal drivers, and when torque-off and readings left for them.
struct Heard {
    motors: IdealMotors,
    /// Time in us, and whether it was torque-off.
    packets: Vec<(u64, bool)>,
}

impl MotorBus for Heard {
    fn transmit(&mut self, now_ns: u64, bytes: &[u8]) -> u64 {
        let [low, high] = Register::TorqueEnable.address().to_le_bytes();
        let off = bytes[7..10] == [Instruction::SyncWrite as u8, low, high];
        if off || bytes[7] == Instruction::SyncRead as u8 {
            self.packets.push((now_ns / 1_000, off));
        }
        self.motors.transmit(now_ns, bytes)
    }

    fn receive(&mut self, now_ns: u64, into: &mut VecDeque<Received>) {
        self.motors.receive(now_ns, into);
    }

    fn advance(&mut self, now_ns: u64) {
        self.motors.advance(now_ns);
    }

    fn next_event_ns(&self) -> Option<u64> {
        self.motors.next_event_ns()
    }
}

/// Drivers that answer nothing may have torque all the same. The wire carries no more of it than it did after the readings.
#[test]
fn after_a_restart_torque_off_is_first_in_three_cycles_and_then_no_more() {
    let motors = Heard {
        motors: IdealMotors::new(false),
        packets: Vec::new(),
    };
    let mut robot = EmulatedRobot::with_motors(Setup::default(), motors);
    robot.run_for(600_000);
    let packets = robot.motors().borrow().packets.clone();
    let offs: Vec<bool> = packets.iter().map(|packet| packet.1).collect();
    assert_eq!(offs[..7], [true, false, true, false, true, false, false]);
    assert!(offs.len() > 10 && !offs[7..].contains(&true), "{packets:?}");
}
