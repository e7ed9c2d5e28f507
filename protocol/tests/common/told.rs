//! Every refusal, fault and event that a module tells.

use super::WRONG_DRIVER;
use protocol::bus::Profile;
use protocol::link::*;

/// Every refusal.
pub fn rejects() -> std::vec::Vec<Reject> {
    let field = GaitField::PhaseLag;
    let mut rejects = vec![
        Reject::Version { theirs: 2, ours: 1 },
        Reject::UnknownType { kind: 99 },
        Reject::Malformed,
        Reject::TrailingBytes,
        Reject::OtherSession,
        Reject::BadTag,
        Reject::NoChallenge,
        Reject::NoKey,
        Reject::WirePortOnly,
        Reject::Busy,
        Reject::State {
            state: ModuleState::Run,
        },
        Reject::NoSuchSlot { slots: 4 },
        Reject::SlotEmpty,
        Reject::SlotActive,
        Reject::OtherGait {
            stored: Digest([1; 8]),
        },
        Reject::Gait(GaitReject::OutOfRange {
            field,
            index: 3,
            value: 9.0,
            min: -6.25,
            max: 6.25,
        }),
        Reject::Gait(GaitReject::NoOscillators),
        Reject::Gait(GaitReject::Name),
        Reject::Gait(GaitReject::SelfLink { link: 1 }),
        Reject::Gait(GaitReject::LinkOutOfRange {
            link: 1,
            oscillator: 7,
            count: 6,
        }),
        Reject::Gait(GaitReject::DuplicateLink {
            link: 2,
            earlier: 1,
        }),
        Reject::Gait(GaitReject::JointCount {
            oscillators: 5,
            joints: 6,
        }),
        Reject::Gait(GaitReject::TooFast {
            joint: 1,
            needed_rad_s: 3.0,
            limit_rad_s: 2.0,
        }),
        Reject::Duration { max_ms: 3_600_000 },
        Reject::Countdown { max_ms: 30_000 },
        Reject::NotHomed { missing_mask: 0x3F },
        Reject::MotorsMissing { missing_mask: 1 },
        Reject::Collision {
            body_a: 0,
            body_b: 6,
            clearance_um: -1500,
        },
        Reject::Battery {
            battery_mv: 6000,
            needed_mv: 6600,
        },
        Reject::Storage {
            fault: StorageFault::Write,
        },
        Reject::Storage {
            fault: StorageFault::ReadBack,
        },
        Reject::Storage {
            fault: StorageFault::Damaged,
        },
    ];
    rejects.extend(faults().into_iter().map(Reject::Latched));
    rejects.extend([
        Reject::EStopLatched,
        Reject::NoFault,
        Reject::StopInputActive,
        Reject::JointMask,
        Reject::NoSamples,
        Reject::BusOrder,
        Reject::Unsupported,
        Reject::Lease {
            min_ms: 100,
            max_ms: 60_000,
        },
        Reject::NotTethered,
        Reject::NoEntropy,
        Reject::WrongDriver(WRONG_DRIVER),
        Reject::TooManyTags { wait_ms: 125 },
        Reject::Held { link: 1 },
        Reject::Robot(RobotReject::JointCount { joints: 0 }),
        Reject::Robot(RobotReject::WrongCount {
            joints: 5,
            expected: 6,
        }),
        Reject::Robot(RobotReject::Speed {
            joint: 11,
            value_rad_s: 0.0,
        }),
        Reject::ContactUnstated,
        Reject::NotHomed {
            missing_mask: 0xFFF,
        },
    ]);
    rejects
}

pub fn faults() -> std::vec::Vec<Fault> {
    vec![
        Fault::DriverLost { joint: 0 },
        Fault::DriverReset { joint: 1 },
        Fault::DriverError { joint: 2, bits: 4 },
        Fault::EncoderJump { joint: 3 },
        Fault::Stall { joint: 4 },
        Fault::EchoMismatch { joint: 5 },
        Fault::BusLost,
        Fault::Overrun,
        Fault::LowBattery,
        Fault::GaitCorrupt,
        Fault::BadSetPoint,
        Fault::Internal,
    ]
}

/// Every kind of event; states, causes and reasons in turn.
pub fn event_kinds() -> std::vec::Vec<EventKind> {
    let digest = Digest([2; 8]);
    use ModuleState::*;
    let states = [
        Boot,
        Unhomed,
        Idle,
        Armed,
        Run,
        Stopping,
        ModuleState::Fault,
        EStop,
    ];
    let mut kinds: std::vec::Vec<_> = [
        ResetCause::PowerOn,
        ResetCause::BrownOut,
        ResetCause::Pin,
        ResetCause::Watchdog,
        ResetCause::Software,
        ResetCause::Crash,
        ResetCause::Unknown,
    ]
    .map(|cause| EventKind::Boot { cause })
    .to_vec();
    kinds.extend(states.map(|to| EventKind::State { from: Boot, to }));
    kinds.extend([
        EventKind::GaitStored { slot: 1, digest },
        EventKind::SlotActivated { slot: 1 },
        EventKind::SlotErased { slot: 1 },
        EventKind::RunStarted { slot: 1, digest },
    ]);
    kinds.extend(
        [
            EndReason::Completed,
            EndReason::Stopped,
            EndReason::StopInput,
            EndReason::ApproachBlocked,
            EndReason::ArmTimeout,
            EndReason::Fault(protocol::link::Fault::Overrun),
        ]
        .map(|reason| EventKind::RunEnded { reason }),
    );
    kinds.extend([
        EventKind::Fault(FaultInfo {
            fault: protocol::link::Fault::BusLost,
            first_us: 300,
            count: 1,
        }),
        EventKind::FaultCleared,
        EventKind::Hold {
            body_a: 1,
            body_b: 5,
            clearance_um: 3000,
            ahead_ms: 950,
        },
        EventKind::HoldEnded { cycles: 12 },
        EventKind::MotorLost { joint: 1 },
        EventKind::MotorFound { joint: 1 },
        EventKind::MotorReset { joint: 1 },
        EventKind::MotorError { joint: 1, bits: 32 },
        EventKind::Homed { mask: 0x3F },
        EventKind::Unhomed { mask: 1 },
        EventKind::Overrun { cycle_us: 61_000 },
        EventKind::LinkSilent,
        EventKind::LinkBack,
        EventKind::BadTag { request: 3 },
        EventKind::KeySet,
        EventKind::BatteryLow { battery_mv: 6500 },
        EventKind::SetpointMismatch {
            joint: 1,
            sent_urad: 5,
            applied_urad: -5,
        },
        EventKind::Stop { input: true },
        EventKind::RunEnded {
            reason: EndReason::HostLost,
        },
        EventKind::Repeated {
            count: 40,
            first: 300,
        },
        EventKind::GaitChanged { slot: 1, digest },
    ]);
    kinds.extend(
        [PortFault::Overrun, PortFault::Noise, PortFault::Closed]
            .map(|fault| EventKind::PortError { port: 2, fault }),
    );
    kinds.extend([
        EventKind::WrongDriver(WRONG_DRIVER),
        EventKind::DriversChanged {
            profile: Profile::Scs,
        },
        EventKind::KeyReadable,
        EventKind::RobotChanged {
            joints: 12,
            contact: WireContact::Unstated,
        },
        EventKind::Homed { mask: 0xFFF },
    ]);
    kinds
}
