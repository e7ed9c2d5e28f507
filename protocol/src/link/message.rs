//! Every message of the host link.
//!
//! The type byte is the variant's place in its enum, the payload is postcard of the variant's fields. Add variants at the end, never edit one:
//! A mask of joints is a u16; postcard writes one of up to seven joints in the one byte that a u8 took.
//! `tests/versioning/v01.rs` holds the bytes. `docs/reference/protocol.md` has the table for people.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::auth::{Key, Nonce, Tag};
use super::event::{Event, RunEnd};
use super::frame::Message;
use super::gait::{Digest, WireGait};
use super::reject::Reject;
use super::robot::WireRobot;
use super::status::{CrashRecord, Hello, Info, ModuleState, SlotInfo};
use super::telemetry::{Sample, SampleBlock};
use super::{JOINTS, MAX_SLOTS};
use crate::bus::Profile;
use crate::bus::master::MAX_DRIVERS;

/// Bytes of a bus packet that [`ToModule::BusRaw`] and [`FromModule::BusReply`] carry.
pub const MAX_BUS_BYTES: usize = 256;
/// Events in one [`FromModule::Events`].
pub const MAX_EVENTS: usize = 8;

/// Host to module.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(
    clippy::large_enum_variant,
    reason = "no heap to box into; one lives at a time"
)]
pub enum ToModule {
    /// First message of a host; changes nothing in the module. -> [`FromModule::Hello`].
    Hello {
        /// Protocol version of the host.
        protocol: u8,
    },
    /// -> [`FromModule::Info`].
    GetInfo,
    /// -> [`FromModule::Challenge`]. The same nonce is repeated until an accepted order used it, it is too old
    /// ([`super::server::CHALLENGE_LIFE_US`]), or a STOP, a HELLO, the end of a run or the loss of the link voided it.
    GetChallenge,
    /// Checks and stores a gait. Refused in Run. Signed. -> [`FromModule::GaitStored`].
    PutGait {
        /// Slot to write.
        slot: u8,
        /// Makes it the active slot after the read-back.
        activate: bool,
        /// The gait.
        gait: WireGait,
        /// Proof.
        tag: Tag,
    },
    /// -> [`FromModule::GaitData`].
    GetGait {
        /// Slot to read.
        slot: u8,
    },
    /// -> [`FromModule::Slots`].
    ListSlots,
    /// Signed. -> [`FromModule::Ack`].
    ActivateSlot {
        /// Slot that is run where nobody names one.
        slot: u8,
        /// Proof.
        tag: Tag,
    },
    /// Signed. -> [`FromModule::Ack`].
    EraseSlot {
        /// Slot to erase; not the active one.
        slot: u8,
        /// Proof.
        tag: Tag,
    },
    /// Runs a gait once, then holds and releases. The robot is autonomous: it needs no host for `duration_ms` and stops by itself. Signed. -> [`FromModule::Ack`].
    Start {
        /// Slot to run.
        slot: u8,
        /// What the host believes is in the slot; anything else is refused.
        digest: Digest,
        /// Length of the run from the first CPG tick, ms.
        duration_ms: u32,
        /// Telemetry of this run.
        rate: TelemetryRate,
        /// Wait before the first movement, ms.
        countdown_ms: u16,
        /// Proof.
        tag: Tag,
    },
    /// Stops. In any state, from any host, with any boot id, without proof. -> [`FromModule::Ack`].
    Stop,
    /// Leaves Fault or EStop when the cause is gone. Signed. -> [`FromModule::Ack`].
    ClearFault {
        /// Proof.
        tag: Tag,
    },
    /// The user has placed these joints in the home pose: store it as zero. Signed. -> [`FromModule::Ack`].
    Zero {
        /// Bit k = joint k.
        joint_mask: u16,
        /// Proof.
        tag: Tag,
    },
    /// Keep-alive and time synchronisation. -> [`FromModule::Pong`].
    Ping {
        /// Host clock, us; comes back unchanged.
        host_t_us: u64,
    },
    /// Live telemetry of this link, in a run and outside. The record of a run is not changed. -> [`FromModule::Ack`].
    Subscribe {
        /// New rate.
        rate: TelemetryRate,
    },
    /// -> [`FromModule::Events`].
    GetEvents {
        /// First event number wanted.
        since: u32,
    },
    /// Asks for buffered telemetry of the last run, one block per request. -> [`FromModule::SampleBlock`], empty at the end.
    Drain {
        /// First sample wanted.
        from_sample: u32,
    },
    /// Sends one packet on the motor bus and returns what answers. Not in Run. Signed. -> [`FromModule::BusReply`].
    BusRaw {
        /// The packet as it goes on the wire.
        bytes: Vec<u8, MAX_BUS_BYTES>,
        /// How long to listen, ms, 0..=1000.
        listen_ms: u16,
        /// Proof.
        tag: Tag,
    },
    /// Sets the key. Wire port only. -> [`FromModule::Ack`].
    SetKey {
        /// New key.
        key: Key,
    },
    /// Restarts the module. Signed. -> [`FromModule::Ack`], then silence.
    Reset {
        /// Proof.
        tag: Tag,
    },
    /// -> [`FromModule::Crash`].
    GetCrash,
    /// As [`ToModule::Start`], but the run goes on only while it hears a heartbeat: `lease_ms` after the last one, or after this order, the
    /// robot stops. Signed. -> [`FromModule::Ack`].
    StartTethered {
        /// Slot to run.
        slot: u8,
        /// What the host believes is in the slot; anything else is refused.
        digest: Digest,
        /// Length of the run from the first CPG tick, ms.
        duration_ms: u32,
        /// Telemetry of this run.
        rate: TelemetryRate,
        /// Wait before the first movement, ms.
        countdown_ms: u16,
        /// Longest time between two heartbeats, ms, 100..=60000.
        lease_ms: u16,
        /// Proof.
        tag: Tag,
    },
    /// The host that watches a tethered run is still there. Signed. -> [`FromModule::Ack`].
    Heartbeat {
        /// Proof.
        tag: Tag,
    },
    /// What is the module's state, with proof that the answer is the module's. -> [`FromModule::State`].
    ProveState {
        /// Random number of the host.
        nonce: Nonce,
    },
    /// Goes over from the gait that runs to another stored one, smoothly, by the law's own filters. Signed. -> [`FromModule::Ack`].
    ChangeGait {
        /// Slot to run from now on.
        slot: u8,
        /// What the host believes is in the slot; anything else is refused.
        digest: Digest,
        /// Proof.
        tag: Tag,
    },
    /// Which drivers the bus carries; kept over a reset. Every zero is lost. Refused in Run. Signed. -> [`FromModule::Ack`].
    SetDrivers {
        /// Table profile of all of them.
        profile: Profile,
        /// Proof.
        tag: Tag,
    },
    /// -> [`FromModule::Drivers`].
    GetDrivers,
    /// Which robot this is: its joints and what of it may meet; kept over a reset. Every zero is lost. Refused in Run. Signed. -> [`FromModule::Ack`].
    SetRobot {
        /// The robot.
        robot: WireRobot,
        /// Proof.
        tag: Tag,
    },
    /// -> [`FromModule::Robot`].
    GetRobot,
}

/// Module to host. Answers carry the request's sequence number; `Sample`, `SampleBlock`, `Event` and `RunEnd` also come unasked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(
    clippy::large_enum_variant,
    reason = "no heap to box into; one lives at a time"
)]
pub enum FromModule {
    /// Answer to `Hello`.
    Hello(Hello),
    /// Answer to `GetInfo`.
    Info(Info),
    /// Answer to `GetChallenge`.
    Challenge {
        /// To be signed into the next order.
        nonce: Nonce,
    },
    /// Done.
    Ack {
        /// Type byte of the request.
        request: u8,
    },
    /// Not done, nothing changed.
    Nack {
        /// Type byte of the request.
        request: u8,
        /// Why.
        reason: Reject,
    },
    /// Answer to `PutGait`: committed and read back.
    GaitStored {
        /// Slot.
        slot: u8,
        /// Fingerprint of what was read back.
        digest: Digest,
        /// Whether it is now the active slot.
        active: bool,
    },
    /// Answer to `GetGait`.
    GaitData {
        /// Slot.
        slot: u8,
        /// Fingerprint as stored.
        digest: Digest,
        /// The gait.
        gait: WireGait,
    },
    /// Answer to `ListSlots`.
    Slots {
        /// The active slot, if any.
        active: Option<u8>,
        /// One entry per slot the module has, in order; `None` is empty.
        slots: Vec<Option<SlotInfo>, MAX_SLOTS>,
    },
    /// One cycle, as it happens.
    Sample(#[serde(with = "super::telemetry::six_sample")] Sample),
    /// Several cycles, delta-coded.
    SampleBlock(#[serde(with = "super::telemetry::six_block")] SampleBlock),
    /// Something happened.
    Event(Event),
    /// A run is over.
    RunEnd(RunEnd),
    /// Answer to `Ping`.
    Pong {
        /// As received.
        host_t_us: u64,
        /// Module clock at the reception of the ping, us since boot.
        module_t_us: u64,
    },
    /// Answer to `BusRaw`.
    BusReply {
        /// How listening ended.
        status: BusStatus,
        /// What was heard, own echo removed.
        bytes: Vec<u8, MAX_BUS_BYTES>,
    },
    /// Answer to `GetCrash`: what survived the last reset, if anything.
    Crash(Option<CrashRecord>),
    /// Answer to `GetEvents`.
    Events {
        /// Number of the next event to ask for.
        next: u32,
        /// Events asked for that are no longer kept.
        lost: u32,
        /// In order.
        events: Vec<Event, MAX_EVENTS>,
    },
    /// Answer to `ProveState`.
    State {
        /// State of the module.
        state: ModuleState,
        /// Time since boot, us.
        uptime_us: u64,
        /// Tag over the host's nonce and these fields; [`Tag::NONE`] of a module without a key.
        tag: Tag,
    },
    /// Answer to `GetDrivers`.
    Drivers {
        /// Table profile that the module drives.
        profile: Profile,
        /// Drivers that are of another one, or do not take their settings; they do not move.
        wrong: Vec<WrongDriver, MAX_DRIVERS>,
    },
    /// As [`FromModule::Sample`], of a robot that has not six joints.
    SampleOf(Sample),
    /// As [`FromModule::SampleBlock`], of a robot that has not six joints.
    SampleBlockOf(SampleBlock),
    /// Answer to `GetRobot`.
    Robot(WireRobot),
}

impl From<Sample> for FromModule {
    fn from(sample: Sample) -> Self {
        if sample.motors.len() == JOINTS {
            Self::Sample(sample)
        } else {
            Self::SampleOf(sample)
        }
    }
}

impl From<SampleBlock> for FromModule {
    fn from(block: SampleBlock) -> Self {
        // One of no robot is empty.
        if [0, JOINTS].contains(&usize::from(block.motors)) {
            Self::SampleBlock(block)
        } else {
            Self::SampleBlockOf(block)
        }
    }
}

/// A driver that the module does not drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WrongDriver {
    /// Joint.
    pub joint: u8,
    /// Model number that it answers; 0: it answers none.
    pub model: u16,
    /// Address of the setting that it does not take; 0: its model is not of the profile.
    pub address: u16,
}

/// How often a [`Sample`] is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TelemetryRate {
    /// None are sent.
    Off,
    /// Every CPG cycle, 20 Hz.
    Cycle,
    /// Five per CPG cycle, 100 Hz.
    Fast,
}

/// How listening on the bus ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BusStatus {
    /// Bytes came.
    Heard,
    /// Nothing came in time.
    Silent,
    /// More came than fits.
    Overflow,
}

impl Message for ToModule {
    const COUNT: u8 = 28;

    fn kind(&self) -> u8 {
        match self {
            Self::Hello { .. } => 0,
            Self::GetInfo => 1,
            Self::GetChallenge => 2,
            Self::PutGait { .. } => 3,
            Self::GetGait { .. } => 4,
            Self::ListSlots => 5,
            Self::ActivateSlot { .. } => 6,
            Self::EraseSlot { .. } => 7,
            Self::Start { .. } => 8,
            Self::Stop => 9,
            Self::ClearFault { .. } => 10,
            Self::Zero { .. } => 11,
            Self::Ping { .. } => 12,
            Self::Subscribe { .. } => 13,
            Self::GetEvents { .. } => 14,
            Self::Drain { .. } => 15,
            Self::BusRaw { .. } => 16,
            Self::SetKey { .. } => 17,
            Self::Reset { .. } => 18,
            Self::GetCrash => 19,
            Self::StartTethered { .. } => 20,
            Self::Heartbeat { .. } => 21,
            Self::ProveState { .. } => 22,
            Self::ChangeGait { .. } => 23,
            Self::SetDrivers { .. } => 24,
            Self::GetDrivers => 25,
            Self::SetRobot { .. } => 26,
            Self::GetRobot => 27,
        }
    }
}

impl ToModule {
    /// The proof an order carries, `None` for messages that need none.
    #[must_use]
    pub fn tag(&self) -> Option<&Tag> {
        match self {
            Self::PutGait { tag, .. }
            | Self::ActivateSlot { tag, .. }
            | Self::EraseSlot { tag, .. }
            | Self::Start { tag, .. }
            | Self::ClearFault { tag }
            | Self::Zero { tag, .. }
            | Self::BusRaw { tag, .. }
            | Self::Reset { tag }
            | Self::StartTethered { tag, .. }
            | Self::Heartbeat { tag }
            | Self::ChangeGait { tag, .. }
            | Self::SetDrivers { tag, .. }
            | Self::SetRobot { tag, .. } => Some(tag),
            Self::Hello { .. }
            | Self::GetInfo
            | Self::GetChallenge
            | Self::GetGait { .. }
            | Self::ListSlots
            | Self::Stop
            | Self::Ping { .. }
            | Self::Subscribe { .. }
            | Self::GetEvents { .. }
            | Self::Drain { .. }
            | Self::SetKey { .. }
            | Self::GetCrash
            | Self::ProveState { .. }
            | Self::GetDrivers
            | Self::GetRobot => None,
        }
    }

    /// Whether doing it twice differs from doing it once. Only these answers are kept for repeated requests.
    #[must_use]
    pub fn changes_state(&self) -> bool {
        self.tag().is_some() || matches!(self, Self::SetKey { .. })
    }
}

impl Message for FromModule {
    const COUNT: u8 = 21;

    fn kind(&self) -> u8 {
        match self {
            Self::Hello(_) => 0,
            Self::Info(_) => 1,
            Self::Challenge { .. } => 2,
            Self::Ack { .. } => 3,
            Self::Nack { .. } => 4,
            Self::GaitStored { .. } => 5,
            Self::GaitData { .. } => 6,
            Self::Slots { .. } => 7,
            Self::Sample(_) => 8,
            Self::SampleBlock(_) => 9,
            Self::Event(_) => 10,
            Self::RunEnd(_) => 11,
            Self::Pong { .. } => 12,
            Self::BusReply { .. } => 13,
            Self::Crash(_) => 14,
            Self::Events { .. } => 15,
            Self::State { .. } => 16,
            Self::Drivers { .. } => 17,
            Self::SampleOf(_) => 18,
            Self::SampleBlockOf(_) => 19,
            Self::Robot(_) => 20,
        }
    }
}
