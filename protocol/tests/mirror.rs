//! The wire's enums say what the law's enums say: same variants, same numbers.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::*;
use control::gait::{Gait, GaitError, RawGait, RobotMismatch};
use control::supervisor;
use protocol::link::*;

#[test]
fn faults_and_states() {
    let law = [
        supervisor::Fault::DriverLost { joint: 0 },
        supervisor::Fault::DriverReset { joint: 1 },
        supervisor::Fault::DriverError { joint: 2, bits: 4 },
        supervisor::Fault::EncoderJump { joint: 3 },
        supervisor::Fault::Stall { joint: 4 },
        supervisor::Fault::EchoMismatch { joint: 5 },
        supervisor::Fault::BusLost,
        supervisor::Fault::Overrun,
        supervisor::Fault::LowBattery,
        supervisor::Fault::GaitCorrupt,
        supervisor::Fault::BadSetPoint,
        supervisor::Fault::Internal,
    ];
    assert_eq!(law.map(Fault::from).to_vec(), faults());
    for fault in law {
        assert_eq!(format!("{fault:?}"), format!("{:?}", Fault::from(fault)));
    }
    for state in [
        supervisor::State::Boot,
        supervisor::State::Unhomed,
        supervisor::State::Idle,
        supervisor::State::Armed {
            duration_us: 1,
            run_at_us: 2,
            give_up_us: 3,
        },
        supervisor::State::Run { until_us: 1 },
        supervisor::State::Stopping {
            reason: supervisor::StopReason::Ordered,
            phase: supervisor::StopPhase::Hold { until_us: 1 },
        },
        supervisor::State::Fault {
            fault: supervisor::Fault::BusLost,
            hold_until_us: None,
        },
        supervisor::State::EStop,
    ] {
        let name = format!("{state:?}");
        let wire = format!("{:?}", ModuleState::from(&state));
        assert!(name.starts_with(&wire), "{name} {wire}");
    }
}

/// What is wrong with this gait, in the law's words and in the wire's.
fn refused(change: impl Fn(&mut WireGait)) -> (String, String) {
    let mut wire = gait();
    change(&mut wire);
    let error: GaitError = Gait::try_from(&wire).unwrap_err();
    (
        format!("{error:?}"),
        format!("{:?}", GaitReject::from(error)),
    )
}

#[test]
fn gait_errors_keep_their_numbers() {
    for bad in [f32::NAN, f32::INFINITY, -1.0e9] {
        let cases = [
            refused(|gait| gait.frequency_hz = bad),
            refused(|gait| gait.rate_a_per_s = bad),
            refused(|gait| gait.duration_s = bad),
            refused(|gait| gait.oscillators[3].amplitude_rad = bad),
            refused(|gait| gait.oscillators[3].offset_rad = bad),
            refused(|gait| gait.oscillators[3].initial_phase_rad = bad),
            refused(|gait| gait.links[4].weight = bad),
            refused(|gait| gait.links[4].phase_lag_rad = bad),
        ];
        for (law, wire) in cases {
            assert_eq!(law, wire);
        }
    }
    for mismatch in [
        RobotMismatch::JointCount {
            oscillators: 5,
            joints: 6,
        },
        RobotMismatch::TooFast {
            joint: 1,
            needed_rad_s: 3.0,
            limit_rad_s: 2.0,
        },
    ] {
        assert_eq!(
            format!("{mismatch:?}"),
            format!("{:?}", GaitReject::from(mismatch))
        );
    }
    for (law, wire) in [
        refused(|gait| gait.name.clear()),
        refused(|gait| gait.oscillators.clear()),
        refused(|gait| gait.links[2].to = gait.links[2].from),
        refused(|gait| gait.links[2].to = 200),
        refused(|gait| gait.links[2] = gait.links[1]),
    ] {
        assert_eq!(law, wire);
    }
}

#[test]
fn a_valid_gait_survives_the_wire_with_every_bit() {
    let gait = Gait::try_from(&gait()).unwrap();
    let wire = WireGait::from(&gait);
    assert_eq!(RawGait::from(&wire), gait.raw());
    assert_eq!(Gait::try_from(&wire).unwrap(), gait);
    let mut buffer = [0; protocol::link::gait::MAX_GAIT];
    assert_eq!(
        WireGait::from_bytes(wire.to_bytes(&mut buffer)),
        Some(wire.clone())
    );
    let used = wire.to_bytes(&mut buffer).len();
    for cut in 0..used {
        assert_eq!(WireGait::from_bytes(&buffer[..cut]), None);
    }
    assert_eq!(WireGait::from_bytes(&buffer[..used + 1]), None);
}

#[test]
fn refusals_of_the_supervisor_become_rejects() {
    use supervisor::Refusal;
    let state = ModuleState::Armed;
    let cases = [
        (Refusal::Booting, Reject::State { state }),
        (Refusal::Busy, Reject::State { state }),
        (
            Refusal::NotHomed { missing_mask: 5 },
            Reject::NotHomed { missing_mask: 5 },
        ),
        (
            Refusal::FaultLatched(supervisor::Fault::BusLost),
            Reject::Latched(Fault::BusLost),
        ),
        (Refusal::EStopLatched, Reject::EStopLatched),
        (Refusal::StopInputPressed, Reject::StopInputActive),
        (Refusal::NoFault, Reject::NoFault),
        (Refusal::BadJointMask { joint_mask: 0 }, Reject::JointMask),
        (
            Refusal::BadDuration {
                duration_us: 0,
                max_us: 3_600_000_000,
            },
            Reject::Duration { max_ms: 3_600_000 },
        ),
        (
            Refusal::BadDuration {
                duration_us: 0,
                max_us: u64::MAX,
            },
            Reject::Duration { max_ms: u32::MAX },
        ),
        (
            Refusal::BadCountdown {
                countdown_us: 9,
                max_us: 30_000_000,
            },
            Reject::Countdown { max_ms: 30_000 },
        ),
        (
            Refusal::BadCountdown {
                countdown_us: 9,
                max_us: 90_000_000,
            },
            Reject::Countdown { max_ms: u16::MAX },
        ),
        (
            Refusal::BadLease {
                lease_us: 9,
                min_us: 100_000,
                max_us: 60_000_000,
            },
            Reject::Lease {
                min_ms: 100,
                max_ms: 60_000,
            },
        ),
        (Refusal::NotTethered, Reject::NotTethered),
    ];
    for (refusal, reject) in cases {
        assert_eq!(Reject::from_refusal(refusal, state), reject);
    }
}
