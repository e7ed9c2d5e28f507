//! Why an order was not carried out.

use control::machine::MachineError;
use control::{gait, supervisor};
use serde::{Deserialize, Serialize};

use super::gait::Digest;
use super::message::WrongDriver;
use super::status::{Fault, ModuleState};

/// Why an order was not carried out. Nothing has changed then. Grows at the end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Reject {
    /// Another protocol version.
    Version {
        /// The host's.
        theirs: u8,
        /// The module's.
        ours: u8,
    },
    /// A type this version does not know.
    UnknownType {
        /// The type byte.
        kind: u8,
    },
    /// The payload is no value of its type.
    Malformed,
    /// The payload is longer than its message.
    TrailingBytes,
    /// The frame belongs to another boot of this module, or to another robot: say HELLO again.
    OtherSession,
    /// The tag is wrong.
    BadTag,
    /// No challenge is open: ask for one.
    NoChallenge,
    /// No key is set and this is not a wire port.
    NoKey,
    /// Only accepted on a wire port.
    WirePortOnly,
    /// An earlier order is still being carried out.
    Busy,
    /// Not in this state.
    State {
        /// State of the module.
        state: ModuleState,
    },
    /// No such slot.
    NoSuchSlot {
        /// Slots the module has.
        slots: u8,
    },
    /// The slot is empty.
    SlotEmpty,
    /// The slot is the active one.
    SlotActive,
    /// The slot holds another gait.
    OtherGait {
        /// What it holds.
        stored: Digest,
    },
    /// The gait is not acceptable.
    Gait(GaitReject),
    /// Run too long or zero.
    Duration {
        /// Longest run, ms.
        max_ms: u32,
    },
    /// Countdown too long.
    Countdown {
        /// Longest, ms.
        max_ms: u16,
    },
    /// Joints without zero.
    NotHomed {
        /// Bit k = joint k.
        missing_mask: u16,
    },
    /// Drivers that do not answer.
    MotorsMissing {
        /// Bit k = joint k.
        missing_mask: u16,
    },
    /// The way from here collides.
    Collision {
        /// Body on one side, 0..=6.
        body_a: u8,
        /// Body on the other.
        body_b: u8,
        /// Clearance, um; negative = penetration.
        clearance_um: i32,
    },
    /// Battery too low.
    Battery {
        /// Measured, mV.
        battery_mv: u16,
        /// Needed, mV.
        needed_mv: u16,
    },
    /// Flash.
    Storage {
        /// What failed.
        fault: StorageFault,
    },
    /// A fault is latched: clear it first.
    Latched(Fault),
    /// EStop is latched: clear it first.
    EStopLatched,
    /// There is no fault to clear.
    NoFault,
    /// The STOP input is active.
    StopInputActive,
    /// Joint mask empty or beyond the joints of the robot.
    JointMask,
    /// No telemetry kept from this sample on.
    NoSamples,
    /// Bus order too long, empty, or listening too long.
    BusOrder,
    /// This module cannot do that.
    Unsupported,
    /// Lease outside its range.
    Lease {
        /// Shortest, ms.
        min_ms: u16,
        /// Longest, ms.
        max_ms: u16,
    },
    /// No tethered run is under way.
    NotTethered,
    /// The random number generator failed its self-test: no challenge can be given and no run started.
    NoEntropy,
    /// A driver is of another profile than the bus, or does not take its settings: a mixed bus is not driven.
    WrongDriver(WrongDriver),
    /// Too many wrong tags came on this port: the order was not looked at.
    TooManyTags {
        /// Time until the next one is looked at, ms.
        wait_ms: u16,
    },
    /// The host of another link holds the robot: its run or its order is under way.
    Held {
        /// Number of that link, 0 or 1.
        link: u8,
    },
    /// The robot of the order cannot be.
    Robot(RobotReject),
    /// Nothing checks that the parts of this robot do not meet, and its user has not said that he knows.
    ContactUnstated,
}

impl Reject {
    /// The wire form of a supervisor's refusal; `state` is the state the order met.
    #[must_use]
    pub fn from_refusal(refusal: supervisor::Refusal, state: ModuleState) -> Self {
        match refusal {
            supervisor::Refusal::Booting | supervisor::Refusal::Busy => Self::State { state },
            supervisor::Refusal::NotHomed { missing_mask } => Self::NotHomed { missing_mask },
            supervisor::Refusal::FaultLatched(fault) => Self::Latched(fault.into()),
            supervisor::Refusal::EStopLatched => Self::EStopLatched,
            supervisor::Refusal::StopInputPressed => Self::StopInputActive,
            supervisor::Refusal::NoFault => Self::NoFault,
            supervisor::Refusal::BadJointMask { .. } => Self::JointMask,
            supervisor::Refusal::BadDuration { max_us, .. } => {
                Self::Duration { max_ms: ms(max_us) }
            }
            supervisor::Refusal::BadCountdown { max_us, .. } => Self::Countdown {
                max_ms: short_ms(max_us),
            },
            supervisor::Refusal::BadLease { min_us, max_us, .. } => Self::Lease {
                min_ms: short_ms(min_us),
                max_ms: short_ms(max_us),
            },
            supervisor::Refusal::NotTethered => Self::NotTethered,
        }
    }
}

fn short_ms(us: u64) -> u16 {
    ms(us).min(u32::from(u16::MAX)) as u16
}

fn ms(us: u64) -> u32 {
    (us / 1000).min(u64::from(u32::MAX)) as u32
}

/// What is wrong with a gait.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GaitReject {
    /// A number is NaN, infinite or outside its range.
    OutOfRange {
        /// Which number.
        field: GaitField,
        /// Of which oscillator or link; 0 for fields that exist once.
        index: u8,
        /// The number.
        value: f32,
        /// Smallest accepted.
        min: f32,
        /// Largest accepted.
        max: f32,
    },
    /// No oscillator at all.
    NoOscillators,
    /// The name is empty or holds a control character.
    Name,
    /// A link joins an oscillator to itself.
    SelfLink {
        /// Index of the link.
        link: u8,
    },
    /// A link names an oscillator that does not exist.
    LinkOutOfRange {
        /// Index of the link.
        link: u8,
        /// The oscillator it names.
        oscillator: u8,
        /// How many there are.
        count: u8,
    },
    /// Two links join the same pair.
    DuplicateLink {
        /// Index of the later link.
        link: u8,
        /// Index of the earlier one.
        earlier: u8,
    },
    /// The robot has another number of joints.
    JointCount {
        /// Oscillators of the gait.
        oscillators: u8,
        /// Joints of the robot.
        joints: u8,
    },
    /// A joint would have to turn faster than it can without load.
    TooFast {
        /// Joint.
        joint: u8,
        /// Peak speed of the gait.
        needed_rad_s: f32,
        /// No-load speed.
        limit_rad_s: f32,
    },
}

impl From<gait::GaitError> for GaitReject {
    fn from(error: gait::GaitError) -> Self {
        match error {
            gait::GaitError::OutOfRange {
                field,
                index,
                value,
                min,
                max,
            } => Self::OutOfRange {
                field: field.into(),
                index,
                value,
                min,
                max,
            },
            gait::GaitError::NoOscillators => Self::NoOscillators,
            gait::GaitError::Name => Self::Name,
            gait::GaitError::SelfLink { link } => Self::SelfLink { link },
            gait::GaitError::LinkOutOfRange {
                link,
                oscillator,
                count,
            } => Self::LinkOutOfRange {
                link,
                oscillator,
                count,
            },
            gait::GaitError::DuplicateLink { link, earlier } => {
                Self::DuplicateLink { link, earlier }
            }
        }
    }
}

impl From<gait::RobotMismatch> for GaitReject {
    fn from(error: gait::RobotMismatch) -> Self {
        match error {
            gait::RobotMismatch::JointCount {
                oscillators,
                joints,
            } => Self::JointCount {
                oscillators,
                joints,
            },
            gait::RobotMismatch::TooFast {
                joint,
                needed_rad_s,
                limit_rad_s,
            } => Self::TooFast {
                joint,
                needed_rad_s,
                limit_rad_s,
            },
        }
    }
}

/// What is wrong with a robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RobotReject {
    /// No joint, or too many.
    JointCount {
        /// Joints given.
        joints: u8,
    },
    /// A robot of this kind has another number.
    WrongCount {
        /// Joints given.
        joints: u8,
        /// Joints it has.
        expected: u8,
    },
    /// A no-load speed is not a number or outside its range.
    Speed {
        /// Joint.
        joint: u8,
        /// The speed.
        value_rad_s: f32,
    },
}

impl From<MachineError> for RobotReject {
    fn from(error: MachineError) -> Self {
        match error {
            MachineError::JointCount { joints } => Self::JointCount { joints },
            MachineError::WrongCount { joints, expected } => Self::WrongCount { joints, expected },
            MachineError::Speed { joint, value_rad_s } => Self::Speed { joint, value_rad_s },
        }
    }
}

/// Which number of a gait, as [`gait::GaitField`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GaitField {
    /// `frequency_hz`.
    Frequency,
    /// `rate_a_per_s`.
    RateA,
    /// `duration_s`.
    Duration,
    /// `oscillator.amplitude_rad`.
    Amplitude,
    /// `oscillator.offset_rad`.
    Offset,
    /// `oscillator.initial_phase_rad`.
    InitialPhase,
    /// `link.weight`.
    Weight,
    /// `link.phase_lag_rad`.
    PhaseLag,
}

impl From<gait::GaitField> for GaitField {
    fn from(field: gait::GaitField) -> Self {
        match field {
            gait::GaitField::Frequency => Self::Frequency,
            gait::GaitField::RateA => Self::RateA,
            gait::GaitField::Duration => Self::Duration,
            gait::GaitField::Amplitude => Self::Amplitude,
            gait::GaitField::Offset => Self::Offset,
            gait::GaitField::InitialPhase => Self::InitialPhase,
            gait::GaitField::Weight => Self::Weight,
            gait::GaitField::PhaseLag => Self::PhaseLag,
        }
    }
}

/// What failed in flash.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StorageFault {
    /// Writing or erasing.
    Write,
    /// The read-back differs.
    ReadBack,
    /// A stored record is damaged.
    Damaged,
}
