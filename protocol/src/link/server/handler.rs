//! What a module can do for its host, and what comes of it.

use heapless::Vec;

use crate::bus::Profile;
use crate::bus::master::MAX_DRIVERS;
use crate::link::MAX_SLOTS;
use crate::link::auth::{Key, Nonce};
use crate::link::event::Event;
use crate::link::gait::{Digest, WireGait};
use crate::link::message::{
    BusStatus, FromModule, MAX_BUS_BYTES, MAX_EVENTS, TelemetryRate, WrongDriver,
};
use crate::link::reject::Reject;
use crate::link::robot::WireRobot;
use crate::link::status::{CrashRecord, Hello, Info, SlotInfo};
use crate::link::telemetry::SampleBlock;

/// How far an order got.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome<T = ()> {
    /// Carried out.
    Done(T),
    /// Begun. The implementer calls [`super::Server::complete`] later; until then other orders are refused as busy.
    Pending,
}

/// A start order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StartOrder {
    /// Slot to run.
    pub slot: u8,
    /// What the host believes is in it.
    pub digest: Digest,
    /// Length, ms.
    pub duration_ms: u32,
    /// Telemetry of the run.
    pub rate: TelemetryRate,
    /// Wait before the first movement, ms.
    pub countdown_ms: u16,
    /// Tethered: the longest time between two heartbeats, ms. `None`: the run needs no host.
    pub lease_ms: Option<u16>,
}

/// A committed gait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StoredGait {
    /// Slot.
    pub slot: u8,
    /// Fingerprint of what was read back.
    pub digest: Digest,
    /// Whether it is now the active slot.
    pub active: bool,
}

/// What a module can do. Every `Err` must mean that nothing has changed.
pub trait ModuleHandler {
    /// Who this is.
    fn hello(&mut self) -> Hello;
    /// State now. `counters.link` is filled in by the server.
    fn info(&mut self) -> Info;
    /// 16 bytes that nobody can foresee; never the same twice.
    fn fresh_nonce(&mut self) -> Result<Nonce, Reject>;
    /// The key, if one is set.
    fn key(&self) -> Option<Key>;
    /// An order with a wrong tag came.
    fn bad_tag(&mut self, request: u8);
    /// Stop, in any state. Must not fail.
    fn stop(&mut self);
    /// Validate, store, read back.
    fn put_gait(
        &mut self,
        slot: u8,
        activate: bool,
        gait: &WireGait,
    ) -> Result<Outcome<StoredGait>, Reject>;
    /// What a slot holds.
    fn get_gait(&mut self, slot: u8) -> Result<(Digest, WireGait), Reject>;
    /// The active slot, and every slot.
    fn slots(&mut self) -> (Option<u8>, Vec<Option<SlotInfo>, MAX_SLOTS>);
    /// Make a slot the active one.
    fn activate_slot(&mut self, slot: u8) -> Result<Outcome, Reject>;
    /// Erase a slot.
    fn erase_slot(&mut self, slot: u8) -> Result<Outcome, Reject>;
    /// Arm and run.
    fn start(&mut self, order: &StartOrder) -> Result<Outcome, Reject>;
    /// The host of a tethered run is still there.
    fn heartbeat(&mut self) -> Result<Outcome, Reject>;
    /// Go over to another stored gait in a run.
    fn change_gait(&mut self, slot: u8, digest: Digest) -> Result<Outcome, Reject>;
    /// Leave Fault or EStop.
    fn clear_fault(&mut self) -> Result<Outcome, Reject>;
    /// These joints are in the home pose.
    fn zero(&mut self, joint_mask: u16) -> Result<Outcome, Reject>;
    /// Change the live telemetry.
    fn subscribe(&mut self, rate: TelemetryRate) -> Result<(), Reject>;
    /// Appends events from number `since` on; returns the number to ask for next and how many of those asked for are lost.
    fn events(&mut self, since: u32, into: &mut Vec<Event, MAX_EVENTS>) -> (u32, u32);
    /// The block that holds sample `from` or the next one kept after it; an empty one at the end. Changes nothing that is kept.
    fn drain(&mut self, from: u32) -> Result<SampleBlock, Reject>;
    /// Send on the bus, listen.
    fn bus_raw(&mut self, bytes: &[u8], listen_ms: u16) -> Result<Outcome<BusAnswer>, Reject>;
    /// Store a key.
    fn set_key(&mut self, key: &Key) -> Result<Outcome, Reject>;
    /// Restart soon; the answer is still to be sent.
    fn reset(&mut self) -> Result<Outcome, Reject>;
    /// What survived the last crash.
    fn crash(&mut self) -> Option<CrashRecord>;
    /// Drive another table profile.
    fn set_drivers(&mut self, _profile: Profile) -> Result<Outcome, Reject> {
        Err(Reject::Unsupported)
    }
    /// Be another robot.
    fn set_robot(&mut self, _robot: &WireRobot) -> Result<Outcome, Reject> {
        Err(Reject::Unsupported)
    }
    /// Which robot it is.
    fn robot(&mut self) -> Result<WireRobot, Reject> {
        Err(Reject::Unsupported)
    }
    /// What is driven, and what is on the bus that is not.
    fn drivers(&mut self) -> Drivers {
        (Profile::Packed, Vec::new())
    }
}

/// Table profile that is driven, and drivers of another one.
pub type Drivers = (Profile, Vec<WrongDriver, MAX_DRIVERS>);

/// What was heard on the bus.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BusAnswer {
    /// How listening ended.
    pub status: BusStatus,
    /// Bytes heard.
    pub bytes: Vec<u8, MAX_BUS_BYTES>,
}

/// The result of an order that was [`Outcome::Pending`].
#[derive(Debug, Clone, PartialEq, Eq)]
#[allow(
    clippy::large_enum_variant,
    reason = "no heap to box into; one lives at a time"
)]
pub enum Completed {
    /// Done, nothing to tell.
    Ack,
    /// A gait is stored.
    GaitStored(StoredGait),
    /// The bus answered.
    Bus(BusAnswer),
}

impl Completed {
    pub(super) fn into_message(self, request: u8) -> FromModule {
        match self {
            Self::Ack => FromModule::Ack { request },
            Self::GaitStored(StoredGait {
                slot,
                digest,
                active,
            }) => FromModule::GaitStored {
                slot,
                digest,
                active,
            },
            Self::Bus(BusAnswer { status, bytes }) => FromModule::BusReply { status, bytes },
        }
    }
}

impl From<Outcome> for Option<Completed> {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Done(()) => Some(Completed::Ack),
            Outcome::Pending => None,
        }
    }
}
