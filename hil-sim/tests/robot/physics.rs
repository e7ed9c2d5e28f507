//! The module on motors with physics: seeded faults of wire, drivers, joints and supply.

use crate::common::gait;
use hil_sim::fault::{Fault as Struck, FaultKind};
use hil_sim::motor::JointKind;
use hil_sim::robot::host::SimHost;
use hil_sim::robot::{EmulatedRobot, Setup};
use hil_sim::world::{World, WorldParams};
use protocol::link::{EndReason, Fault, FromModule, Info, RunEnd, TelemetryRate, ToModule};

/// The run begins before this, s of virtual time.
const RUNNING_S: f64 = 2.5;

/// A run of 4 s under faults.
fn run(faults: Vec<Struck>) -> (EmulatedRobot<World>, Info, RunEnd) {
    let mut params = WorldParams::metamodule(5, JointKind::catalogue_joint);
    params.faults = faults;
    let world = World::on_stand(&params).expect("catalogue joints");
    let mut robot = EmulatedRobot::with_motors(
        Setup {
            link_byte_ns: 0,
            ..Setup::default()
        },
        world,
    );
    let mut host = SimHost::new(robot.link());
    host.home(&mut robot).expect("drivers answer");
    let digest = host.upload(&mut robot, 0, &gait(1)).expect("clear");
    host.start(&mut robot, 0, digest, 4_000, TelemetryRate::Off)
        .expect("ready");
    robot.run_until((RUNNING_S * 1e6) as u64);
    let end = host
        .wait_for_end(&mut robot, 20_000_000)
        .expect("the run ends");
    robot.run_for(500_000);
    let Ok(FromModule::Info(info)) = host.ask(&mut robot, &ToModule::GetInfo) else {
        panic!()
    };
    (robot, info, end)
}

#[test]
fn every_fault_of_a_driver_or_joint_ends_the_run_by_its_name() {
    type Expected = fn(Fault) -> bool;
    let cases: [(FaultKind, Expected); 6] = [
        (FaultKind::Missing, |fault| {
            fault == Fault::DriverLost { joint: 2 }
        }),
        (FaultKind::EncoderJump { jump_rad: 0.5 }, |fault| {
            fault == Fault::EncoderJump { joint: 2 }
        }),
        // Blind, the driver drives on until its own guard notices.
        (
            FaultKind::StuckEncoder,
            |fault| matches!(fault, Fault::DriverError { joint: 2, bits } if bits & 8 != 0),
        ),
        (FaultKind::Stall, |fault| {
            matches!(
                fault,
                Fault::DriverError { joint: 2, .. } | Fault::Stall { joint: 2 }
            )
        }),
        (FaultKind::Reset, |fault| {
            fault == Fault::DriverReset { joint: 2 }
        }),
        (FaultKind::Babble, |fault| {
            matches!(fault, Fault::BusLost | Fault::DriverLost { .. })
        }),
    ];
    for (kind, expected) in cases {
        let (robot, info, end) = run(vec![Struck::always(kind).on(2).during(RUNNING_S, 5.5)]);
        let EndReason::Fault(fault) = end.reason else {
            panic!("{kind:?}: {end:?}")
        };
        assert!(expected(fault), "{kind:?}: {fault:?}");
        assert_eq!(
            info.homed_mask & 4 == 0,
            matches!(kind, FaultKind::EncoderJump { .. } | FaultKind::Reset),
            "{kind:?}"
        );
        let motors = robot.motors().borrow();
        let driving = (0..6).any(|joint| {
            motors
                .driver(joint)
                .is_some_and(|driver| driver.bridge().duty != 0.0)
        });
        assert!(!driving, "{kind:?}: a bridge still drives");
    }
}

#[test]
fn a_brown_out_of_the_motors_loses_every_zero() {
    // 12 V x 0.3 is below the 4.5 V at which the drivers reset.
    let (_, info, end) = run(vec![
        Struck::always(FaultKind::BrownOut { ratio: 0.3 }).during(RUNNING_S, 2.7),
    ]);
    assert!(matches!(end.reason, EndReason::Fault(_)), "{end:?}");
    assert_eq!(info.homed_mask, 0);
}

#[test]
fn late_answers_are_never_taken_for_another_motors() {
    let mut completed = 0;
    for step in 0..20 {
        let delay_s = f64::from(step) * 3e-3;
        let late = Struck::always(FaultKind::ReplyDelay { delay_s })
            .on(3)
            .during(RUNNING_S, 60.0);
        let (_, _, end) = run(vec![late]);
        match end.reason {
            EndReason::Completed => completed += 1,
            // Too late to be of use is lost, whoever's slot the answer spoils.
            EndReason::Fault(Fault::DriverLost { .. } | Fault::BusLost) => {}
            other => panic!("{delay_s} s late: {other:?}"),
        }
    }
    assert!(
        (1..20).contains(&completed),
        "{completed} of 20 delays are harmless"
    );
}

#[test]
fn noise_on_the_wire_costs_retries_not_the_run() {
    let noise = vec![
        Struck::always(FaultKind::ByteLoss).chance(2e-4),
        Struck::always(FaultKind::Corruption).chance(2e-4),
    ];
    let (_, info, end) = run(noise);
    assert_eq!(
        (end.reason, end.cycles, end.holds),
        (EndReason::Completed, 80, 0)
    );
    assert!(
        info.counters.bus_timeouts > 5 && info.counters.overruns == 0,
        "{:?}",
        info.counters
    );
}
