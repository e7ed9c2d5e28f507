//! Robots of one to twelve motors: told by message, kept over a reset, driven, recorded, stopped.

use control::gait::{Gait, Oscillator, RawGait, chain};
use control::machine::{Contact, Machine, all_joints};
use control::motion::MotionParams;
use control::robot::JointLimits;
use firmware::ports::ResetCause;
use hil_sim::robot::host::{AskError, SimHost};
use hil_sim::robot::ideal::{IdealMotors, Trouble};
use hil_sim::robot::{EmulatedRobot, Setup};
use protocol::link::{
    EndReason, EventKind, Fault, FromModule, GaitReject, ModuleState, Reject, RobotReject,
    SampleBlock, Tag, TelemetryRate, ToModule, WireContact, WireRobot,
};

fn wave(oscillators: usize) -> Gait {
    let mut raw = RawGait {
        frequency_hz: 0.4,
        rate_a_per_s: 2.0,
        duration_s: 10.0,
        links: chain(0.5, &vec![0.6; oscillators - 1]),
        ..RawGait::default()
    };
    raw.name.push_str("wave").expect("short");
    for joint in 0..oscillators {
        let oscillator = Oscillator {
            amplitude_rad: 0.2 + 0.02 * joint as f32,
            offset_rad: 0.05,
            initial_phase_rad: 0.0,
        };
        raw.oscillators.push(oscillator).expect("twelve fit");
    }
    raw.lock_phases();
    Gait::try_from(raw).expect("within the ranges")
}

fn machine(joints: usize, contact: Contact) -> Machine {
    let limits = [JointLimits {
        no_load_speed_rad_s: 2.0,
    }; 12];
    Machine::new(&limits[..joints], contact).expect("valid")
}

fn robot(joints: u8) -> WireRobot {
    let contact = match joints {
        3 => Contact::Module,
        _ => Contact::Unchecked,
    };
    WireRobot::from(&machine(usize::from(joints), contact))
}

/// A robot that was built as a meta-module on a bus of so many drivers.
fn on_a_bus_of(joints: u8) -> (EmulatedRobot, SimHost) {
    let setup = Setup {
        link_byte_ns: 0,
        ..Setup::default()
    };
    let mut robot = EmulatedRobot::with_motors(setup, IdealMotors::of(joints, false));
    let mut host = SimHost::new(robot.link());
    robot.run_for(200_000);
    host.hello(&mut robot).expect("answers");
    (robot, host)
}

fn tell(robot: &mut EmulatedRobot, host: &mut SimHost, told: &WireRobot) -> Result<(), AskError> {
    let order = ToModule::SetRobot {
        robot: told.clone(),
        tag: Tag::NONE,
    };
    host.ask(robot, &order)?;
    robot.run_for(200_000);
    Ok(())
}

fn state(robot: &mut EmulatedRobot, host: &mut SimHost) -> (ModuleState, u16, u16) {
    match host.ask(robot, &ToModule::GetInfo) {
        Ok(FromModule::Info(info)) => (info.state, info.homed_mask, info.motor_mask),
        other => panic!("{other:?}"),
    }
}

#[test]
fn robots_of_any_size_run_record_every_joint_and_stop() {
    for joints in 1..=12_u8 {
        let (mut robot, mut host) = on_a_bus_of(joints);
        tell(&mut robot, &mut host, &self::robot(joints)).expect("told");
        let all = all_joints(joints);
        let now = state(&mut robot, &mut host);
        assert_eq!(now, (ModuleState::Unhomed, 0, all));
        host.home(&mut robot).expect("all answer");
        let gait = wave(usize::from(joints));
        let digest = host.upload(&mut robot, 0, &gait).expect("it fits");
        let run = |host: &mut SimHost, robot: &mut EmulatedRobot| {
            host.start(robot, 0, digest, 4_000, TelemetryRate::Cycle)
                .expect("starts");
        };
        run(&mut host, &mut robot);
        let end = host.wait_for_end(&mut robot, 12_000_000).expect("ends");
        assert_eq!(
            (end.reason, end.cycles, end.holds),
            (EndReason::Completed, 80, 0)
        );
        assert_eq!((end.dropped, end.setpoint_crc32c), (0, crc(&gait, 80)));
        let samples: Vec<_> = host
            .blocks
            .iter()
            .flat_map(SampleBlock::samples)
            .map(|sample| sample.expect("whole"))
            .collect();
        assert_eq!(samples.len(), end.samples as usize);
        for (joint, amplitude) in gait.oscillators().iter().enumerate() {
            let of = |sample: &protocol::link::Sample| sample.motors[joint].feedback.position_urad;
            let travel = samples.iter().map(of).max().unwrap_or(0)
                - samples.iter().map(of).min().unwrap_or(0);
            let expected = amplitude.amplitude_rad * 2e6;
            assert!(
                f64::from(travel) > f64::from(expected) * 0.8,
                "{joint} of {joints}"
            );
        }
        assert!(samples.iter().all(|sample| {
            sample.valid_mask == all && sample.motors.len() == usize::from(joints)
        }));
        host.blocks.clear();

        run(&mut host, &mut robot);
        robot.run_for(2_000_000);
        host.ask(&mut robot, &ToModule::Stop).expect("always");
        let end = host.wait_for_end(&mut robot, 6_000_000).expect("ends");
        assert_eq!(end.reason, EndReason::Stopped);
        let motors = robot.motors().borrow();
        assert!((0..usize::from(joints)).all(|joint| !motors.torque(joint)));
    }
}

/// CRC-32C over the set-points as the law gives them.
fn crc(gait: &Gait, cycles: u32) -> u32 {
    let mut crc = protocol::crc::Crc32c::new();
    let mut state = control::cpg::start(gait);
    for _ in 0..cycles {
        for angle in control::cpg::step(gait, &mut state, control::CYCLE_S).as_slice() {
            crc.update(&angle.to_le_bytes());
        }
    }
    crc.value()
}

#[test]
fn the_last_of_twelve_motors_is_missed_and_named() {
    let (mut robot, mut host) = on_a_bus_of(12);
    tell(&mut robot, &mut host, &self::robot(12)).expect("told");
    host.home(&mut robot).expect("all answer");
    let digest = host.upload(&mut robot, 0, &wave(12)).expect("it fits");
    // Five readings a cycle fit in as long as all answer.
    host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Fast)
        .expect("starts");
    let end = host.wait_for_end(&mut robot, 9_000_000).expect("ends");
    assert_eq!((end.reason, end.dropped), (EndReason::Completed, 0));
    host.start(&mut robot, 0, digest, 4_000, TelemetryRate::Cycle)
        .expect("starts");
    robot.run_for(3_000_000);
    robot.motors().borrow_mut().trouble(11, Trouble::Missing);
    let end = host.wait_for_end(&mut robot, 6_000_000).expect("ends");
    assert_eq!(
        end.reason,
        EndReason::Fault(Fault::DriverLost { joint: 11 })
    );
    assert!(host.saw(|kind| *kind == EventKind::MotorLost { joint: 11 }));
    assert!(!host.saw(|kind| matches!(kind, EventKind::Overrun { .. })));
    let refused = host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off);
    assert!(refused.is_err());
    host.ask(&mut robot, &ToModule::ClearFault { tag: Tag::NONE })
        .expect("the cause is gone");
    let refused = host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off);
    let missing_mask = 1 << 11;
    assert_eq!(
        refused,
        Err(AskError::Rejected(Reject::MotorsMissing { missing_mask }))
    );
}

#[test]
fn twelve_silent_motors_leave_the_cycle_its_time() {
    let (mut robot, mut host) = on_a_bus_of(12);
    tell(&mut robot, &mut host, &self::robot(12)).expect("told");
    robot.run_for(200_000);
    for joint in 0..12 {
        robot.motors().borrow_mut().trouble(joint, Trouble::Missing);
    }
    robot.run_for(2_000_000);
    host.receive(None);
    let lost = |joint| host.saw(|kind| *kind == EventKind::MotorLost { joint });
    assert!((0..12).all(lost));
    assert!(!host.saw(|kind| matches!(kind, EventKind::Overrun { .. })));
}

#[test]
fn what_cannot_be_and_what_does_not_fit_is_refused_and_changes_nothing() {
    let (mut robot, mut host) = on_a_bus_of(6);
    let before = host.ask(&mut robot, &ToModule::GetRobot);
    let wrong = |contact, speeds: &[f32]| WireRobot {
        contact,
        speeds_rad_s: heapless::Vec::from_slice(speeds).expect("at most twelve"),
    };
    for (told, reason) in [
        (
            wrong(WireContact::Unchecked, &[]),
            RobotReject::JointCount { joints: 0 },
        ),
        (
            wrong(WireContact::MetaModule, &[2.0; 5]),
            RobotReject::WrongCount {
                joints: 5,
                expected: 6,
            },
        ),
        (
            wrong(WireContact::Module, &[2.0; 6]),
            RobotReject::WrongCount {
                joints: 6,
                expected: 3,
            },
        ),
        (
            wrong(WireContact::Unchecked, &[2.0, 0.0]),
            RobotReject::Speed {
                joint: 1,
                value_rad_s: 0.0,
            },
        ),
    ] {
        let refused = tell(&mut robot, &mut host, &told);
        assert_eq!(refused, Err(AskError::Rejected(Reject::Robot(reason))));
        assert_eq!(host.ask(&mut robot, &ToModule::GetRobot), before);
    }
    host.home(&mut robot).expect("still a meta-module");
    let refused = host.upload(&mut robot, 0, &wave(4));
    let count = GaitReject::JointCount {
        oscillators: 4,
        joints: 6,
    };
    assert_eq!(refused, Err(AskError::Rejected(Reject::Gait(count))));
}

#[test]
fn a_robot_that_nobody_checks_runs_only_when_its_user_has_said_so() {
    let (mut robot, mut host) = on_a_bus_of(2);
    let mut told = self::robot(2);
    told.contact = WireContact::Unstated;
    tell(&mut robot, &mut host, &told).expect("told");
    host.home(&mut robot).expect("both answer");
    let digest = host.upload(&mut robot, 0, &wave(2)).expect("it fits");
    let refused = host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off);
    assert_eq!(refused, Err(AskError::Rejected(Reject::ContactUnstated)));

    told.contact = WireContact::Unchecked;
    tell(&mut robot, &mut host, &told).expect("told");
    assert_eq!(state(&mut robot, &mut host), (ModuleState::Unhomed, 0, 3));
    host.home(&mut robot).expect("both answer");
    host.start(&mut robot, 0, digest, 1_000, TelemetryRate::Off)
        .expect("starts");
}

#[test]
fn what_was_told_outlives_a_reset_and_a_stored_gait_of_another_size_does_not_start() {
    let (mut robot, mut host) = on_a_bus_of(12);
    host.home(&mut robot)
        .expect("six of twelve drivers are enough");
    let digest = host.upload(&mut robot, 1, &wave(6)).expect("it fits");
    let told = self::robot(12);
    tell(&mut robot, &mut host, &told).expect("told");
    let changed = EventKind::RobotChanged {
        joints: 12,
        contact: WireContact::Unchecked,
    };
    host.receive(None);
    assert!(host.saw(|kind| *kind == changed));
    assert!(host.saw(|kind| *kind == EventKind::Unhomed { mask: 1 << 5 }));
    robot.reset(ResetCause::Pin);
    robot.run_for(300_000);
    host.home(&mut robot).expect("all twelve answer");
    assert_eq!(
        host.ask(&mut robot, &ToModule::GetRobot),
        Ok(FromModule::Robot(told))
    );
    let refused = host.start(&mut robot, 1, digest, 1_000, TelemetryRate::Off);
    let count = GaitReject::JointCount {
        oscillators: 6,
        joints: 12,
    };
    assert_eq!(refused, Err(AskError::Rejected(Reject::Gait(count))));
}

#[test]
fn the_order_needs_a_robot_at_rest_and_its_key() {
    let setup = Setup {
        link_byte_ns: 0,
        motion: MotionParams::default().with_machine(machine(2, Contact::Unchecked)),
        ..Setup::default()
    };
    let mut robot = EmulatedRobot::ideal(setup);
    let mut host = SimHost::new(robot.link());
    host.home(&mut robot).expect("both answer");
    let digest = host.upload(&mut robot, 0, &wave(2)).expect("it fits");
    host.start(&mut robot, 0, digest, 2_000, TelemetryRate::Off)
        .expect("starts");
    robot.run_for(1_500_000);
    let refused = tell(&mut robot, &mut host, &self::robot(3));
    assert!(matches!(
        refused,
        Err(AskError::Rejected(Reject::State { .. }))
    ));
}
