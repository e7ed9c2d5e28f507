//! What happened, as numbers: events, and the end of a run.

use serde::{Deserialize, Serialize};

use super::gait::Digest;
use super::message::WrongDriver;
use super::robot::WireContact;
use crate::bus::Profile;

use super::status::{Fault, FaultInfo, ModuleState, ResetCause};

/// A numbered note of what happened.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Running number since boot.
    pub seq: u32,
    /// Module clock, us since boot.
    pub t_us: u64,
    /// What.
    pub kind: EventKind,
}

/// What happened. Grows at the end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum EventKind {
    /// The module started.
    Boot {
        /// Why.
        cause: ResetCause,
    },
    /// The supervisor changed state.
    State {
        /// Before.
        from: ModuleState,
        /// After.
        to: ModuleState,
    },
    /// A gait was committed.
    GaitStored {
        /// Slot.
        slot: u8,
        /// Fingerprint.
        digest: Digest,
    },
    /// A slot became the active one.
    SlotActivated {
        /// Slot.
        slot: u8,
    },
    /// A slot was erased.
    SlotErased {
        /// Slot.
        slot: u8,
    },
    /// A run began: first CPG tick.
    RunStarted {
        /// Slot.
        slot: u8,
        /// Fingerprint.
        digest: Digest,
    },
    /// A run ended.
    RunEnded {
        /// Why.
        reason: EndReason,
    },
    /// A fault was latched.
    Fault(FaultInfo),
    /// Faults were cleared.
    FaultCleared,
    /// The pre-check held all joints.
    Hold {
        /// Body on one side, 0..=6.
        body_a: u8,
        /// Body on the other.
        body_b: u8,
        /// Clearance that the move would have had, um; negative = penetration.
        clearance_um: i32,
        /// How far ahead, ms.
        ahead_ms: u16,
    },
    /// Motion goes on after a hold.
    HoldEnded {
        /// Cycles held.
        cycles: u32,
    },
    /// A driver stopped answering.
    MotorLost {
        /// Joint.
        joint: u8,
    },
    /// A driver answers again.
    MotorFound {
        /// Joint.
        joint: u8,
    },
    /// A driver restarted: its zero is gone.
    MotorReset {
        /// Joint.
        joint: u8,
    },
    /// A driver reports hardware errors.
    MotorError {
        /// Joint.
        joint: u8,
        /// Register 70.
        bits: u8,
    },
    /// Joints got their zero.
    Homed {
        /// Bit k = joint k.
        mask: u16,
    },
    /// Zero lost.
    Unhomed {
        /// Bit k = joint k.
        mask: u16,
    },
    /// A cycle took longer than its period.
    Overrun {
        /// Length of the cycle, us.
        cycle_us: u32,
    },
    /// The host of an autonomous run fell silent; the run goes on to its end.
    LinkSilent,
    /// The host is back.
    LinkBack,
    /// An order had a wrong tag.
    BadTag {
        /// Type byte of the order.
        request: u8,
    },
    /// A key was set.
    KeySet,
    /// Battery below a limit.
    BatteryLow {
        /// Battery, mV.
        battery_mv: u16,
    },
    /// The applied set-point of a driver differs from the one sent.
    SetpointMismatch {
        /// Joint.
        joint: u8,
        /// Sent, urad.
        sent_urad: i32,
        /// Applied, urad.
        applied_urad: i32,
    },
    /// STOP: by message, or by the input.
    Stop {
        /// True = STOP input.
        input: bool,
    },
    /// The event before this one of the same kind came again.
    Repeated {
        /// Times, since that event or the last note of this kind.
        count: u32,
        /// Number of that event.
        first: u32,
    },
    /// The run goes over to another gait.
    GaitChanged {
        /// Slot.
        slot: u8,
        /// Fingerprint.
        digest: Digest,
    },
    /// The receiver of a port reported an error.
    PortError {
        /// 0 = first host link, 1 = second host link, 2 = motor bus.
        port: u8,
        /// What.
        fault: PortFault,
    },
    /// A driver is not of the profile that the module drives, or does not take its settings.
    WrongDriver(WrongDriver),
    /// The module drives another table profile from now on.
    DriversChanged {
        /// Profile.
        profile: Profile,
    },
    /// A key is set, and a debug probe can read it: the readout protection of the flash is off.
    KeyReadable,
    /// The module is another robot from now on.
    RobotChanged {
        /// Joints.
        joints: u8,
        /// What of it may meet.
        contact: WireContact,
    },
}

/// What a receiver can report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PortFault {
    /// Bytes were lost.
    Overrun,
    /// Framing, parity or noise error.
    Noise,
    /// The other side is gone.
    Closed,
}

/// The end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RunEnd {
    /// Number of the run since boot, also in its sample blocks.
    pub run: u16,
    /// Why.
    pub reason: EndReason,
    /// CPG cycles of the run.
    pub cycles: u32,
    /// Cycles held by the pre-check.
    pub holds: u32,
    /// Samples taken.
    pub samples: u32,
    /// Of these, dropped because neither link nor memory had room.
    pub dropped: u32,
    /// CRC-32C over the little-endian f32 bits of every CPG set-point of the run, in cycle then joint order: equal runs are equal to the bit.
    pub setpoint_crc32c: u32,
}

/// Why a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EndReason {
    /// It had its length.
    Completed,
    /// STOP by message.
    Stopped,
    /// STOP input.
    StopInput,
    /// The way to the start pose would collide.
    ApproachBlocked,
    /// The start pose was not reached in time.
    ArmTimeout,
    /// A fault.
    Fault(Fault),
    /// A tethered run heard no heartbeat for the length of its lease.
    HostLost,
}
