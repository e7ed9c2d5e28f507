//! What a module says about itself.

use control::supervisor;
use heapless::String;
use serde::{Deserialize, Serialize};

use super::frame::LinkCounters;
use super::gait::Digest;

/// Bytes of the firmware's name in [`Hello`].
pub const MAX_FIRMWARE_ID: usize = 40;

/// Name of the emulated robot's board: the last word of [`Hello::firmware`] where nothing real moves.
pub const EMULATED: &str = "emulated";

/// Who answers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// Protocol version of the module.
    pub protocol: u8,
    /// Robot id, also `source` of its frames.
    pub robot_id: u8,
    /// Random number of this boot; every later frame of the session carries it.
    pub boot_id: u32,
    /// Firmware name, version and board.
    pub firmware: String<MAX_FIRMWARE_ID>,
    /// Fingerprint of the robot model the pre-check is built with.
    pub model_digest: Digest,
    /// Whether a key is set. Without one, orders are accepted on a wire port only.
    pub keyed: bool,
}

impl Hello {
    /// Whether an emulated robot answers.
    #[must_use]
    pub fn is_emulated(&self) -> bool {
        self.firmware.rsplit(' ').next() == Some(EMULATED)
    }
}

/// State of the module.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Info {
    /// Supervisor state.
    pub state: ModuleState,
    /// Latched fault, if any.
    pub fault: Option<FaultInfo>,
    /// Why the module last started.
    pub reset_cause: ResetCause,
    /// Slots the module has.
    pub slots: u8,
    /// The active one.
    pub active_slot: Option<u8>,
    /// Battery, mV; 0 when not measured.
    pub battery_mv: u16,
    /// Bit k: joint k has a zero.
    pub homed_mask: u16,
    /// Bit k: driver k answers.
    pub motor_mask: u16,
    /// Time since boot, us.
    pub uptime_us: u64,
    /// 20 Hz cycles since boot.
    pub cycles: u32,
    /// What went wrong so far.
    pub counters: Counters,
}

/// Counts since boot. They saturate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Host link.
    pub link: LinkCounters,
    /// Orders with a wrong tag.
    pub bad_tags: u32,
    /// Bus replies that did not come.
    pub bus_timeouts: u32,
    /// Bus packets with a wrong checksum.
    pub bus_bad_crc: u32,
    /// Bus packets that nobody asked for.
    pub bus_stray: u32,
    /// Cycles that took longer than their period.
    pub overruns: u32,
    /// Cycles held by the pre-check.
    pub holds: u32,
    /// Telemetry samples dropped.
    pub samples_dropped: u32,
    /// Events dropped.
    pub events_dropped: u32,
}

/// Supervisor state, as `control::supervisor::State`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ModuleState {
    /// Starting.
    Boot,
    /// At least one joint has no zero.
    Unhomed,
    /// Ready.
    Idle,
    /// Counting down, moving to the start pose.
    Armed,
    /// Running a gait.
    Run,
    /// Amplitudes run down.
    Stopping,
    /// Latched fault.
    Fault,
    /// STOP input or order during motion.
    EStop,
}

impl From<&supervisor::State> for ModuleState {
    fn from(state: &supervisor::State) -> Self {
        match state {
            supervisor::State::Boot => Self::Boot,
            supervisor::State::Unhomed => Self::Unhomed,
            supervisor::State::Idle => Self::Idle,
            supervisor::State::Armed { .. } => Self::Armed,
            supervisor::State::Run { .. } => Self::Run,
            supervisor::State::Stopping { .. } => Self::Stopping,
            supervisor::State::Fault { .. } => Self::Fault,
            supervisor::State::EStop => Self::EStop,
        }
    }
}

/// What can go wrong, as [`supervisor::Fault`]. The order of the variants is the fault's number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Fault {
    /// A driver did not answer for several cycles.
    DriverLost {
        /// Joint.
        joint: u8,
    },
    /// A driver restarted while its joint was in use.
    DriverReset {
        /// Joint.
        joint: u8,
    },
    /// A driver latched a hardware error.
    DriverError {
        /// Joint.
        joint: u8,
        /// Register 70.
        bits: u8,
    },
    /// A position jumped further than the joint can turn.
    EncoderJump {
        /// Joint.
        joint: u8,
    },
    /// A joint draws current and does not follow.
    Stall {
        /// Joint.
        joint: u8,
    },
    /// A driver applied another set-point than it was sent.
    EchoMismatch {
        /// Joint.
        joint: u8,
    },
    /// The bus is unusable.
    BusLost,
    /// Control cycles were missed in a row.
    Overrun,
    /// Battery too low.
    LowBattery,
    /// The running gait no longer matches its checksum.
    GaitCorrupt,
    /// A set-point was not finite or left its limits; it was not sent.
    BadSetPoint,
    /// The module's own check failed.
    Internal,
}

impl From<supervisor::Fault> for Fault {
    fn from(fault: supervisor::Fault) -> Self {
        match fault {
            supervisor::Fault::DriverLost { joint } => Self::DriverLost { joint },
            supervisor::Fault::DriverReset { joint } => Self::DriverReset { joint },
            supervisor::Fault::DriverError { joint, bits } => Self::DriverError { joint, bits },
            supervisor::Fault::EncoderJump { joint } => Self::EncoderJump { joint },
            supervisor::Fault::Stall { joint } => Self::Stall { joint },
            supervisor::Fault::EchoMismatch { joint } => Self::EchoMismatch { joint },
            supervisor::Fault::BusLost => Self::BusLost,
            supervisor::Fault::Overrun => Self::Overrun,
            supervisor::Fault::LowBattery => Self::LowBattery,
            supervisor::Fault::GaitCorrupt => Self::GaitCorrupt,
            supervisor::Fault::BadSetPoint => Self::BadSetPoint,
            supervisor::Fault::Internal => Self::Internal,
        }
    }
}

/// A latched fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FaultInfo {
    /// Which, and of which joint.
    pub fault: Fault,
    /// First seen, us since boot.
    pub first_us: u64,
    /// Times seen.
    pub count: u32,
}

/// Why the module last started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ResetCause {
    /// Power came up.
    PowerOn,
    /// Supply fell below the brown-out level.
    BrownOut,
    /// Reset pin.
    Pin,
    /// Watchdog.
    Watchdog,
    /// `Reset` order or an update.
    Software,
    /// After a panic or a hardware fault; see `GetCrash`.
    Crash,
    /// The board cannot tell.
    Unknown,
}

/// One used slot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SlotInfo {
    /// The gait's name.
    pub name: String<{ super::gait::MAX_NAME }>,
    /// Its fingerprint.
    pub digest: Digest,
    /// Times any slot was written before; the newest write has the highest number.
    pub generation: u32,
}

/// What kind of crash.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CrashKind {
    /// A Rust panic.
    Panic,
    /// A Cortex-M fault exception.
    HardFault,
    /// The watchdog bit.
    Watchdog,
    /// Non-maskable interrupt: flash ECC.
    Nmi,
    /// The stack ran out.
    StackOverflow,
}

/// What survived a crash.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CrashRecord {
    /// Kind.
    pub kind: CrashKind,
    /// Time since the boot that crashed, us.
    pub uptime_us: u64,
    /// Program counter.
    pub pc: u32,
    /// Link register.
    pub lr: u32,
    /// Fault status register (CFSR), or the line of a panic.
    pub detail: u32,
    /// File of a panic, cut from the left.
    pub place: String<48>,
}
