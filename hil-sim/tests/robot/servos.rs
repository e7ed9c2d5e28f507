//! The module on off-the-shelf servos: every profile runs a gait, and a bus of two kinds does not move.

use crate::common::gait;
use firmware::ports::ResetCause;
use hil_sim::fault::{Fault as Struck, FaultKind};
use hil_sim::motor::JointKind;
use hil_sim::robot::host::{AskError, SimHost};
use hil_sim::robot::{EmulatedRobot, Setup};
use hil_sim::world::{World, WorldParams};
use protocol::bus::Profile;
use protocol::link::{
    EndReason, EventKind, Fault, FromModule, Reject, RunEnd, Tag, TelemetryRate, ToModule,
    WrongDriver,
};

const SERVOS: [Profile; 5] = [
    Profile::Xl330,
    Profile::Xc330,
    Profile::Xm430,
    Profile::Sts,
    Profile::Scs,
];

const ZERO: ToModule = ToModule::Zero {
    joint_mask: 63,
    tag: Tag::NONE,
};

fn set(profile: Profile) -> ToModule {
    ToModule::SetDrivers {
        profile,
        tag: Tag::NONE,
    }
}

/// A robot whose drivers are of these profiles, its host, and HELLO said. The module believes that they are ours.
fn robot(profiles: [Profile; 6], faults: Vec<Struck>) -> (EmulatedRobot<World>, SimHost) {
    let mut params = WorldParams::metamodule(5, JointKind::catalogue_joint);
    params.faults = faults;
    for (joint, profile) in params.joints.iter_mut().zip(profiles) {
        joint.driver.profile = profile;
    }
    let world = World::on_stand(&params).expect("catalogue joints");
    let setup = Setup {
        link_byte_ns: 0,
        ..Setup::default()
    };
    let mut robot = EmulatedRobot::with_motors(setup, world);
    let mut host = SimHost::new(robot.link());
    robot.run_for(200_000);
    host.hello(&mut robot).expect("a module");
    (robot, host)
}

fn drivers(robot: &mut EmulatedRobot<World>, host: &mut SimHost) -> (Profile, Vec<WrongDriver>) {
    match host.ask(robot, &ToModule::GetDrivers) {
        Ok(FromModule::Drivers { profile, wrong }) => (profile, wrong.to_vec()),
        other => panic!("{other:?}"),
    }
}

/// A run of 4 s on drivers of this profile; the module has been told which.
fn run(profile: Profile, faults: Vec<Struck>) -> (EmulatedRobot<World>, SimHost, RunEnd) {
    let (mut robot, mut host) = robot([profile; 6], faults);
    host.ask(&mut robot, &set(profile)).expect("stored");
    // Each driver comes into use step by step.
    robot.run_for(1_800_000);
    assert_eq!(drivers(&mut robot, &mut host), (profile, vec![]));
    host.ask(&mut robot, &ZERO).expect("all answer");
    let digest = host.upload(&mut robot, 0, &gait(1)).expect("clear");
    host.start(&mut robot, 0, digest, 4_000, TelemetryRate::Cycle)
        .expect("ready");
    let end = host
        .wait_for_end(&mut robot, 20_000_000)
        .expect("the run ends");
    (robot, host, end)
}

fn angles(robot: &EmulatedRobot<World>) -> Vec<f64> {
    let world = robot.motors().borrow();
    (0..6)
        .map(|joint| world.joint(joint).expect("six").gear_rad)
        .collect()
}

#[test]
fn every_profile_runs_a_gait_as_our_drivers_do() {
    let (ours, _, want) = run(Profile::Packed, vec![]);
    assert_eq!(want.reason, EndReason::Completed);
    for profile in SERVOS {
        let (mut robot, mut host, end) = run(profile, vec![]);
        assert_eq!(end.reason, EndReason::Completed, "{profile:?}");
        assert_eq!(end.cycles, want.cycles, "{profile:?}");
        // The law does not know what hangs on the bus.
        assert_eq!(end.setpoint_crc32c, want.setpoint_crc32c, "{profile:?}");
        // The end pose: within a count of an SCS (5.1 mrad) and what the loop leaves.
        for (joint, (got, want)) in angles(&robot).iter().zip(angles(&ours)).enumerate() {
            assert!(
                (got - want).abs() < 0.03,
                "{profile:?} joint {joint}: {got} for {want} rad"
            );
        }
        assert!(!host.saw(|kind| matches!(kind, EventKind::SetpointMismatch { .. })));
        // The setting outlives a reset of the module.
        robot.reset(ResetCause::PowerOn);
        robot.run_for(2_000_000);
        host.restart();
        host.hello(&mut robot).expect("a module");
        assert_eq!(drivers(&mut robot, &mut host), (profile, vec![]));
    }
}

#[test]
fn a_module_on_drivers_of_another_kind_says_so_and_moves_nothing() {
    for believed in Profile::ALL {
        for profile in SERVOS.into_iter().filter(|profile| *profile != believed) {
            let (mut robot, mut host) = robot([profile; 6], vec![]);
            host.ask(&mut robot, &set(believed)).expect("stored");
            robot.run_for(1_000_000);
            let refused = host.ask(&mut robot, &ZERO);
            let (a, b) = (believed.info(), profile.info());
            // Frames of another protocol are silence. STS and SCS hear each other's, with the bytes turned round.
            if a.framing != b.framing {
                let missing_mask = 63;
                let silent = Reject::MotorsMissing { missing_mask };
                assert_eq!(
                    refused,
                    Err(AskError::Rejected(silent)),
                    "{believed:?} {profile:?}"
                );
                continue;
            }
            let Err(AskError::Rejected(Reject::WrongDriver(wrong))) = refused else {
                panic!("{believed:?} on {profile:?}: {refused:?}")
            };
            assert_eq!((wrong.joint, wrong.address), (0, 0));
            assert!(!a.models.contains(&wrong.model));
            assert_eq!(drivers(&mut robot, &mut host).1.len(), 6);
        }
    }
}

#[test]
fn a_mixed_bus_is_refused_by_the_driver_that_does_not_fit() {
    for (bus, stranger) in [
        (Profile::Packed, Profile::Xl330),
        (Profile::Xl330, Profile::Xm430),
        (Profile::Xm430, Profile::Packed),
        (Profile::Sts, Profile::Scs),
    ] {
        let mut profiles = [bus; 6];
        profiles[3] = stranger;
        let (mut robot, mut host) = robot(profiles, vec![]);
        host.ask(&mut robot, &set(bus)).expect("stored");
        robot.run_for(2_000_000);
        let (profile, wrong) = drivers(&mut robot, &mut host);
        assert_eq!((profile, wrong.len()), (bus, 1));
        let [only] = wrong.as_slice() else { panic!() };
        assert_eq!(only.joint, 3);
        // Ours is found out at the first cycle, before the host came.
        let events = match host.ask(&mut robot, &ToModule::GetEvents { since: 0 }) {
            Ok(FromModule::Events { events, .. }) => events,
            other => panic!("{other:?}"),
        };
        let said = EventKind::WrongDriver(*only);
        let early = events.iter().any(|event| event.kind == said);
        assert!(early || host.saw(|kind| *kind == said), "{bus:?}");
        let refused = Err(AskError::Rejected(Reject::WrongDriver(*only)));
        assert_eq!(host.ask(&mut robot, &ZERO), refused, "{bus:?}");
        let digest = host.upload(&mut robot, 0, &gait(1)).expect("clear");
        let start = host.start(&mut robot, 0, digest, 4_000, TelemetryRate::Off);
        assert_eq!(start, refused, "{bus:?}");
        let world = robot.motors().borrow();
        assert!((0..6).all(|joint| !world.driver(joint).expect("six").torque_on()));
    }
}

#[test]
fn a_servo_that_restarts_in_a_run_stops_it_and_needs_a_new_zero() {
    for profile in SERVOS {
        let strike = Struck {
            joint: Some(2),
            from_s: 4.5,
            to_s: 4.6,
            probability: 0.0,
            ..Struck::always(FaultKind::Reset)
        };
        let (mut robot, mut host, end) = run(profile, vec![strike]);
        // An SCS keeps its one turn over a restart; all that shows is that it let go.
        let want = match profile {
            Profile::Scs => Fault::DriverError { joint: 2, bits: 0 },
            _ => Fault::DriverReset { joint: 2 },
        };
        assert_eq!(end.reason, EndReason::Fault(want), "{profile:?}");
        let stood = angles(&robot);
        robot.run_for(3_000_000);
        for (before, after) in stood.iter().zip(angles(&robot)) {
            assert!((before - after).abs() < 0.2, "{profile:?} moved");
        }
        let homed = match host.ask(&mut robot, &ToModule::GetInfo) {
            Ok(FromModule::Info(info)) => info.homed_mask,
            other => panic!("{other:?}"),
        };
        let kept = if profile == Profile::Scs { 63 } else { 63 - 4 };
        assert_eq!(homed, kept, "{profile:?}");
        // It has its settings again.
        assert_eq!(drivers(&mut robot, &mut host), (profile, vec![]));
    }
}
