//! Faults of drivers, bus, battery and processor while the robot runs: it stops, says why, and nothing unsafe is sent.

use crate::common::{check_set_points, ready};
use firmware::ports::ResetCause;
use hil_sim::robot::host::{AskError, SimHost};
use hil_sim::robot::ideal::Trouble;
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::link::{
    EndReason, EventKind, Fault, FromModule, Info, ModuleState, Reject, RunEnd, Tag, TelemetryRate,
    ToModule,
};

fn info(robot: &mut EmulatedRobot, host: &mut SimHost) -> Info {
    match host.ask(robot, &ToModule::GetInfo) {
        Ok(FromModule::Info(info)) => info,
        other => panic!("{other:?}"),
    }
}

/// A robot in mid-run, `extra_us` after an instant of the grid.
pub(crate) fn running(number: u8, extra_us: u64) -> (EmulatedRobot, SimHost) {
    let (mut robot, mut host, digest) = ready(number);
    host.start(&mut robot, 0, digest, 60_000, TelemetryRate::Off)
        .expect("ready");
    let now_us = robot.now_us();
    robot.run_until((now_us / 50_000 + 50) * 50_000 + extra_us);
    host.receive(None);
    (robot, host)
}

pub(crate) fn expect_end(robot: &mut EmulatedRobot, host: &mut SimHost) -> RunEnd {
    let end = host.wait_for_end(robot, 12_000_000).expect("the run ends");
    check_set_points(robot);
    for joint in 0..6 {
        assert!(
            !robot.motors().borrow().is_driving(joint),
            "joint {joint} still drives"
        );
    }
    end
}

#[test]
fn every_subset_of_missing_motors_stops_the_run_names_the_motor_and_sends_nothing_unsafe() {
    let mut cases = 0;
    for subset in 1..64_u16 {
        // Begin of the cycle, in the reading, between reading and set-points, idle part.
        for phase_us in [0, 1_300, 2_450, 30_000] {
            let (mut robot, mut host) = running(1, phase_us);
            let begun_us = robot.now_us();
            for joint in (0..6).filter(|joint| subset >> joint & 1 != 0) {
                robot.motors().borrow_mut().trouble(joint, Trouble::Missing);
            }
            robot.run_for(250_000);
            host.receive(None);
            let told = host.events.iter().find_map(|event| match event.kind {
                EventKind::Fault(info) => Some((info.fault, event.t_us)),
                _ => None,
            });
            let (fault, at_us) = told.expect("the fault is told");
            let Fault::DriverLost { joint } = fault else {
                panic!("{fault:?}")
            };
            assert!(
                subset >> joint & 1 != 0,
                "subset {subset:06b}: blames joint {joint}"
            );
            // Three cycles without an answer, told with the instant of the third.
            assert!(
                at_us - begun_us <= 150_000,
                "told after {} us",
                at_us - begun_us
            );
            for joint in 0..6 {
                let lost = host.saw(|kind| *kind == EventKind::MotorLost { joint });
                assert_eq!(
                    lost,
                    subset >> joint & 1 != 0,
                    "subset {subset:06b} joint {joint}"
                );
            }
            // The lost ones have let go by their own watchdog, 160 ms after the last word they heard.
            for joint in (0..6).filter(|joint| subset >> joint & 1 != 0) {
                assert!(!robot.motors().borrow().is_driving(joint));
            }
            assert_eq!(
                expect_end(&mut robot, &mut host).reason,
                EndReason::Fault(fault)
            );
            assert_eq!(info(&mut robot, &mut host).motor_mask, 63 & !subset);
            cases += 1;
        }
    }
    println!("{cases} cases: 63 subsets at 4 phases of the cycle");
}

#[test]
fn a_start_with_missing_motors_is_refused_and_names_them() {
    for subset in 1..64_u16 {
        let (mut robot, mut host, digest) = ready(0);
        for joint in (0..6).filter(|joint| subset >> joint & 1 != 0) {
            robot.motors().borrow_mut().trouble(joint, Trouble::Mute);
        }
        robot.run_for(300_000);
        let refused = host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off);
        assert_eq!(
            refused,
            Err(AskError::Rejected(Reject::MotorsMissing {
                missing_mask: subset
            }))
        );
        robot.run_for(300_000);
        assert!((0..6).all(|joint| !robot.motors().borrow().torque(joint)));
        for joint in 0..6 {
            robot.motors().borrow_mut().trouble(joint, Trouble::None);
        }
        robot.run_for(300_000);
        host.start(&mut robot, 0, digest, 100, TelemetryRate::Off)
            .expect("all motors are back");
    }
}

#[test]
fn a_driver_reset_in_the_run_stops_it_and_revokes_the_zero() {
    for joint in 0..6_u8 {
        let (mut robot, mut host) = running(2, 10_000);
        let sent_before = robot.motors().borrow().taken(usize::from(joint)).len();
        robot.motors().borrow_mut().restart(usize::from(joint));
        let end = expect_end(&mut robot, &mut host);
        assert_eq!(end.reason, EndReason::Fault(Fault::DriverReset { joint }));
        assert_eq!(
            robot.motors().borrow().taken(usize::from(joint)).len(),
            sent_before,
            "nothing to a driver without zero"
        );
        host.ask(&mut robot, &ToModule::ClearFault { tag: Tag::NONE })
            .expect("the cause is gone");
        let now = info(&mut robot, &mut host);
        assert_eq!(
            (now.state, now.homed_mask),
            (ModuleState::Unhomed, 63 & !(1 << joint))
        );
        let FromModule::Slots { slots, .. } =
            host.ask(&mut robot, &ToModule::ListSlots).expect("answers")
        else {
            panic!()
        };
        let digest = slots[0].as_ref().expect("the gait is still there").digest;
        let refused = host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off);
        assert_eq!(
            refused,
            Err(AskError::Rejected(Reject::NotHomed {
                missing_mask: 1 << joint
            }))
        );
    }
}

#[test]
fn a_driver_reset_at_rest_revokes_the_zero_too() {
    let (mut robot, mut host, _) = ready(2);
    robot.motors().borrow_mut().restart(4);
    robot.run_for(200_000);
    let now = info(&mut robot, &mut host);
    assert_eq!(
        (now.state, now.homed_mask),
        (ModuleState::Unhomed, 0b10_1111)
    );
    assert!(host.saw(|kind| *kind == EventKind::MotorReset { joint: 4 }));
}

#[test]
fn readings_that_cannot_be_true_stop_the_run_with_their_own_fault() {
    let cases: [(Trouble, Fault); 4] = [
        (Trouble::Jump(400_000), Fault::EncoderJump { joint: 3 }),
        (Trouble::Jump(-2_000_000), Fault::EncoderJump { joint: 3 }),
        (Trouble::Frozen, Fault::DriverLost { joint: 3 }),
        (Trouble::WrongGoal(50_000), Fault::EchoMismatch { joint: 3 }),
    ];
    for (trouble, fault) in cases {
        for phase_us in [500, 20_000] {
            let (mut robot, mut host) = running(3, phase_us);
            robot.motors().borrow_mut().trouble(3, trouble);
            assert_eq!(
                expect_end(&mut robot, &mut host).reason,
                EndReason::Fault(fault),
                "{trouble:?}"
            );
        }
    }
}

#[test]
fn a_hardware_error_is_reported_with_its_bits() {
    let (mut robot, mut host) = running(4, 0);
    robot.motors().borrow_mut().hardware_error(5, 0b10_0000);
    let end = expect_end(&mut robot, &mut host);
    assert_eq!(
        end.reason,
        EndReason::Fault(Fault::DriverError {
            joint: 5,
            bits: 0b10_0000
        })
    );
    assert!(host.saw(|kind| *kind
        == EventKind::MotorError {
            joint: 5,
            bits: 0b10_0000
        }));
}

#[test]
fn a_babbling_bus_ends_the_run_and_every_motor_lets_go() {
    let (mut robot, mut host) = running(0, 12_345);
    robot.motors().borrow_mut().babble(true);
    robot.run_for(400_000);
    assert!(
        (0..6).all(|joint| !robot.motors().borrow().is_driving(joint)),
        "their own watchdogs have tripped"
    );
    robot.motors().borrow_mut().babble(false);
    let end = expect_end(&mut robot, &mut host);
    assert!(
        matches!(
            end.reason,
            EndReason::Fault(Fault::BusLost | Fault::DriverLost { .. })
        ),
        "{end:?}"
    );
    // The line is quiet again: usable without a power cycle.
    host.ask(&mut robot, &ToModule::ClearFault { tag: Tag::NONE })
        .expect("the cause is gone");
    robot.run_for(500_000);
    assert_eq!(info(&mut robot, &mut host).motor_mask, 63);
}

#[test]
fn lost_bytes_are_retried_inside_the_cycle_and_the_run_goes_on() {
    let (mut robot, mut host, digest) = ready(0);
    // One byte in 997: a damaged answer in every fourth to fifth cycle.
    robot.motors().borrow_mut().drop_every(997);
    host.start(&mut robot, 0, digest, 20_000, TelemetryRate::Cycle)
        .expect("ready");
    let end = host
        .wait_for_end(&mut robot, 40_000_000)
        .expect("the lease ends");
    assert_eq!((end.reason, end.cycles), (EndReason::Completed, 400));
    let counters = info(&mut robot, &mut host).counters;
    assert!(
        counters.bus_timeouts > 50 && counters.overruns == 0,
        "{counters:?}"
    );
    check_set_points(&robot);
}

#[test]
fn a_sinking_battery_stops_the_run_and_forbids_start_and_upload() {
    let (mut robot, mut host) = running(1, 0);
    for step in 0..40_u16 {
        robot.board().set_battery_mv(Some(6_600 - 25 * step));
        robot.run_for(50_000);
    }
    let end = expect_end(&mut robot, &mut host);
    assert_eq!(end.reason, EndReason::Fault(Fault::LowBattery));
    assert!(host.saw(|kind| matches!(kind, EventKind::BatteryLow { .. })));
    host.ask(&mut robot, &ToModule::ClearFault { tag: Tag::NONE })
        .expect("a fault of the past");
    let FromModule::Slots { slots, .. } =
        host.ask(&mut robot, &ToModule::ListSlots).expect("answers")
    else {
        panic!()
    };
    let digest = slots[0].as_ref().expect("kept").digest;
    let low = Err(AskError::Rejected(Reject::Battery {
        battery_mv: 5_625,
        needed_mv: 6_600,
    }));
    assert_eq!(
        host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off),
        low
    );
    assert_eq!(
        host.upload(&mut robot, 0, &crate::common::gait(2))
            .map(|_| ()),
        low.map(|_: FromModule| ())
    );
    // One dip is no reason to stop.
    robot.board().set_battery_mv(Some(7_400));
    robot.run_for(100_000);
    host.start(&mut robot, 0, digest, 3_000, TelemetryRate::Off)
        .expect("charged again");
    robot.run_for(3_000_000);
    robot.board().set_battery_mv(Some(5_900));
    robot.run_for(200_000);
    robot.board().set_battery_mv(Some(7_400));
    assert_eq!(
        expect_end(&mut robot, &mut host).reason,
        EndReason::Completed
    );
}

/// Half a second of low readings stops the run; what recovers in between begins anew.
#[test]
fn dips_of_the_battery_do_not_add_up() {
    let (mut robot, mut host) = running(1, 0);
    for _ in 0..5 {
        for (battery_mv, cycles) in [(6_000, 9), (7_400, 1)] {
            robot.board().set_battery_mv(Some(battery_mv));
            robot.run_for(50_000 * cycles);
        }
    }
    host.receive(None);
    let low = |kind: &EventKind| matches!(kind, EventKind::BatteryLow { .. });
    assert!(!host.saw(low), "{:?}", host.events);
    robot.board().set_battery_mv(Some(6_000));
    robot.run_for(500_000);
    let end = expect_end(&mut robot, &mut host);
    assert_eq!(end.reason, EndReason::Fault(Fault::LowBattery));
}

#[test]
fn a_reset_at_any_phase_of_a_run_leaves_an_unhomed_robot_that_does_not_move() {
    for (k, phase_us) in (0..50_000).step_by(1_111).enumerate() {
        let cause = [
            ResetCause::Watchdog,
            ResetCause::BrownOut,
            ResetCause::Software,
            ResetCause::Pin,
        ][k % 4];
        let (mut robot, _) = running(2, phase_us);
        robot.reset(cause);
        // A packet that was on the wire arrives.
        robot.run_for(1_000);
        let taken: Vec<usize> = (0..6)
            .map(|joint| robot.motors().borrow().taken(joint).len())
            .collect();
        robot.run_for(160_000);
        assert!(
            (0..6).all(|joint| !robot.motors().borrow().is_driving(joint)),
            "safe within 160 ms, phase {phase_us}"
        );
        robot.run_for(2_000_000);
        let mut host = SimHost::new(robot.link());
        host.hello(&mut robot).expect("answers after the reset");
        let now = info(&mut robot, &mut host);
        assert_eq!((now.state, now.homed_mask), (ModuleState::Unhomed, 0));
        let after: Vec<usize> = (0..6)
            .map(|joint| robot.motors().borrow().taken(joint).len())
            .collect();
        assert_eq!(taken, after, "no set-point without an order");
    }
}

#[test]
fn the_stop_input_takes_torque_away_and_latches() {
    let (mut robot, mut host) = running(0, 3_000);
    robot.board().set_stop_input(true);
    robot.run_for(53_000);
    assert!((0..6).all(|joint| !robot.motors().borrow().torque(joint)));
    let end = expect_end(&mut robot, &mut host);
    assert_eq!(end.reason, EndReason::StopInput);
    assert_eq!(info(&mut robot, &mut host).state, ModuleState::EStop);
    let clear = ToModule::ClearFault { tag: Tag::NONE };
    assert_eq!(
        host.ask(&mut robot, &clear),
        Err(AskError::Rejected(Reject::StopInputActive))
    );
    robot.board().set_stop_input(false);
    robot.run_for(500_000);
    assert_eq!(
        info(&mut robot, &mut host).state,
        ModuleState::EStop,
        "released is not cleared"
    );
    host.ask(&mut robot, &clear).expect("released");
    assert_eq!(info(&mut robot, &mut host).state, ModuleState::Idle);
}

#[test]
fn the_watchdog_is_fed_in_time_through_everything_a_host_may_ask() {
    let mut robot = EmulatedRobot::ideal(Setup::default());
    let mut host = SimHost::new(robot.link());
    host.home(&mut robot).expect("drivers answer");
    for slot in 0..8 {
        host.upload(&mut robot, slot, &crate::common::gait(slot))
            .expect("clear");
    }
    let ping = protocol::bus::Request::ping(protocol::bus::BROADCAST).expect("fits");
    let bytes = heapless::Vec::from_slice(ping.bytes()).expect("fits");
    let order = ToModule::BusRaw {
        bytes,
        listen_ms: 1_000,
        tag: Tag::NONE,
    };
    let FromModule::BusReply { bytes, .. } = host.ask(&mut robot, &order).expect("allowed at rest")
    else {
        panic!()
    };
    assert_eq!(bytes.len(), 6 * 14, "six drivers answer a broadcast ping");
    robot.run_for(1_000_000);
    assert_eq!(robot.resets(), 0);
    assert!(
        robot.board().longest_pet_gap_us() <= 100_000,
        "{}",
        robot.board().longest_pet_gap_us()
    );
    assert_eq!(
        info(&mut robot, &mut host).motor_mask,
        63,
        "the bus is read again afterwards"
    );
}

#[test]
fn one_overrun_holds_and_is_counted_three_in_a_row_stop() {
    for (stall_us, stops) in [(20_000, false), (60_000, false), (110_000, false)] {
        let (mut robot, mut host) = running(0, 10_000);
        robot.motors().borrow_mut().stall_once(stall_us);
        robot.run_for(1_000_000);
        host.receive(None);
        let overruns = info(&mut robot, &mut host).counters.overruns;
        assert_eq!(
            overruns,
            u32::from(stall_us > 50_000),
            "stalled for {stall_us} us"
        );
        assert_eq!(
            host.saw(|kind| matches!(kind, EventKind::Overrun { .. })),
            stall_us > 50_000
        );
        assert_eq!(host.ends.is_empty(), !stops);
        check_set_points(&robot);
        // The cycle after an overrun says the last set-point again.
        let taken = robot.motors().borrow().taken(3);
        let repeated = taken.windows(2).filter(|pair| {
            let [before, after] = pair else { return false };
            before.torque && before.at_ns > 2_500_000_000 && before.goal_urad == after.goal_urad
        });
        assert_eq!(repeated.count(), usize::from(stall_us > 50_000));
    }
    // Just before a cycle begins: each stall covers one instant of the grid, and the next cycle stalls again.
    let (mut robot, mut host) = running(0, 40_000);
    for _ in 0..3 {
        robot.motors().borrow_mut().stall_once(70_000);
        robot.run_for(100_000);
    }
    let end = expect_end(&mut robot, &mut host);
    assert_eq!(end.reason, EndReason::Fault(Fault::Overrun));
}

#[test]
fn a_stall_longer_than_the_watchdog_resets_the_processor_and_nothing_moves_after() {
    let (mut robot, _) = running(0, 10_000);
    robot.motors().borrow_mut().stall_once(400_000);
    robot.run_for(500_000);
    assert_eq!(robot.resets(), 1);
    assert!((0..6).all(|joint| !robot.motors().borrow().torque(joint)));
    let mut host = SimHost::new(robot.link());
    host.hello(&mut robot).expect("answers after the watchdog");
    let now = info(&mut robot, &mut host);
    assert_eq!(
        (now.state, now.reset_cause),
        (ModuleState::Unhomed, protocol::link::ResetCause::Watchdog)
    );
}

/// A driver that keeps an old goal would jump to it when its torque goes on.
#[test]
fn every_driver_hears_where_it_stands_before_it_gets_torque() {
    let (robot, _) = running(0, 0);
    for joint in 0..6 {
        let taken = robot.motors().borrow().taken(joint);
        let first = taken.first().expect("in a run");
        assert!(!first.torque, "joint {joint}: torque came first");
        assert_eq!(first.goal_urad, first.from_urad);
    }
}

/// A watchdog is set by a packet that has no answer. One that was lost left a driver with torque and without a watchdog.
#[test]
fn no_driver_gets_torque_before_it_says_that_its_watchdog_is_set() {
    for joint in 0..6 {
        let mut robot = EmulatedRobot::ideal(Setup {
            link_byte_ns: 0,
            ..Setup::default()
        });
        // It answers, and whatever sets its watchdog is lost.
        robot.motors().borrow_mut().forget_watchdogs(joint, true);
        let mut host = SimHost::new(robot.link());
        host.home(&mut robot).expect("drivers answer");
        let digest = host
            .upload(&mut robot, 0, &crate::common::gait(0))
            .expect("clear");
        host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off)
            .expect("ready");
        robot.run_for(2_000_000);
        assert!(!robot.motors().borrow().torque(joint), "joint {joint}");
        robot.motors().borrow_mut().forget_watchdogs(joint, false);
        let end = host.wait_for_end(&mut robot, 20_000_000).expect("ends");
        assert_eq!(end.reason, EndReason::Completed, "joint {joint}");
    }
}

/// The watchdog of a driver that fell silent is cleared and set again. Where the second packet was lost, the driver counted as guarded.
#[test]
fn a_driver_that_comes_back_gets_no_torque_before_its_watchdog_is_set_again() {
    let (mut robot, mut host, digest) = ready(0);
    robot.motors().borrow_mut().trouble(2, Trouble::Missing);
    robot.run_for(140_000);
    robot.motors().borrow_mut().trouble(2, Trouble::None);
    robot.motors().borrow_mut().forget_watchdogs(2, true);
    for silent_us in [100_000, 170_000, 240_000, 500_000] {
        robot.motors().borrow_mut().trouble(2, Trouble::Missing);
        robot.run_for(silent_us);
        robot.motors().borrow_mut().trouble(2, Trouble::None);
        robot.run_for(200_000);
        // Refused or not: no torque without a watchdog.
        let _ = host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off);
        for _ in 0..100 {
            robot.run_for(5_000);
            let motors = robot.motors().borrow();
            assert!(!motors.torque(2) || motors.has_watchdog(2));
        }
        host.ask(&mut robot, &ToModule::Stop).expect("always");
        robot.run_for(6_000_000);
    }
}

/// A driver whose watchdog has tripped keeps its torque and goes on towards its last set-point once the watchdog is cleared.
#[test]
fn a_driver_that_comes_back_loses_torque_before_its_watchdog_is_cleared() {
    for joint in 0..6 {
        let (mut robot, _) = running(1, 10_000);
        robot.motors().borrow_mut().trouble(joint, Trouble::Missing);
        robot.run_for(8_000_000);
        assert!(robot.motors().borrow().torque(joint), "as it was left");
        robot.motors().borrow_mut().trouble(joint, Trouble::None);
        for _ in 0..20_000 {
            robot.run_for(20);
            assert!(!robot.motors().borrow().is_driving(joint), "joint {joint}");
        }
        assert!(!robot.motors().borrow().torque(joint));
    }
}

/// The same where the packets that take its torque are lost for a while: a watchdog that has tripped holds it back until they come.
#[test]
fn a_driver_that_keeps_its_torque_keeps_its_tripped_watchdog() {
    for joint in 0..6 {
        let (mut robot, _) = running(1, 10_000);
        robot.motors().borrow_mut().trouble(joint, Trouble::Missing);
        robot.run_for(8_000_000);
        robot.motors().borrow_mut().keep_torque(joint, true);
        robot.motors().borrow_mut().trouble(joint, Trouble::None);
        for _ in 0..20_000 {
            robot.run_for(20);
            assert!(!robot.motors().borrow().is_driving(joint), "joint {joint}");
        }
        assert!(robot.motors().borrow().torque(joint), "nothing took it");
        robot.motors().borrow_mut().keep_torque(joint, false);
        robot.run_for(400_000);
        assert!(!robot.motors().borrow().torque(joint), "joint {joint}");
    }
}

/// The driver's tick comes round every 262 ms. A measurement that stood still counted as a new one after 200 ms.
#[test]
fn a_measurement_that_stands_still_stays_lost() {
    let (mut robot, mut host, digest) = ready(0);
    robot.motors().borrow_mut().trouble(3, Trouble::Frozen);
    robot.run_for(500_000);
    for _ in 0..40 {
        robot.run_for(50_000);
        assert_eq!(info(&mut robot, &mut host).motor_mask, 0b11_0111);
        let refused = host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off);
        let missing_mask = 0b00_1000;
        assert_eq!(
            refused,
            Err(AskError::Rejected(Reject::MotorsMissing { missing_mask }))
        );
    }
}
