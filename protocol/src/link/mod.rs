//! Host link: `0x00 COBS(version, source, sequence, boot id, type, payload, CRC-32C) 0x00`.
//!
//! * [`frame`]: bytes to frames and back. [`Decoder`] takes one byte at a time and finds the next frame after any damage.
//! * [`message`]: [`ToModule`], [`FromModule`], [`Reject`]. The enums grow at the end only; a message is never edited.
//! * [`auth`]: challenge, tag, key.
//! * [`robot`]: which robot a module is.
//! * [`telemetry`]: [`Sample`], the delta-coded [`SampleBlock`], the log that holds blocks until they are drained.
//! * [`server`]: module side; one dispatch over [`ModuleHandler`] for real firmware and emulators.
//! * [`client`]: host side; sequence numbers, signing, decoding.

pub mod auth;
pub mod client;
mod delta;
pub mod event;
pub mod frame;
pub mod gait;
pub mod message;
pub mod reject;
pub mod robot;
pub mod server;
pub mod status;
pub mod telemetry;

pub use auth::{KEY_LEN, Key, NONCE_LEN, Nonce, TAG_LEN, Tag};
pub use client::{Client, Received};
pub use event::{EndReason, Event, EventKind, PortFault, RunEnd};
pub use frame::{
    DecodeError, Decoder, EncodeError, Frame, Header, LinkCounters, MAX_FRAME, MAX_PAYLOAD,
    Message, SOURCE_HOST, UNASKED, VERSION, encode, encode_proof, encode_signed,
};
pub use gait::{Digest, WireGait, WireLink, WireOscillator};
pub use message::{BusStatus, FromModule, TelemetryRate, ToModule, WrongDriver};
pub use reject::{GaitField, GaitReject, Reject, RobotReject, StorageFault};
pub use robot::{WireContact, WireRobot};
pub use server::{
    BusAnswer, Completed, Drivers, ModuleHandler, Outcome, Port, Server, StartOrder, StoredGait,
};
pub use status::{
    Counters, CrashKind, CrashRecord, Fault, FaultInfo, Hello, Info, ModuleState, ResetCause,
    SlotInfo,
};
pub use telemetry::{MotorSample, Sample, SampleBlock, SampleLog};

/// Joints of a meta-module.
pub const JOINTS: usize = control::robot::JOINTS;
/// Bit mask of all joints of a meta-module.
pub const ALL_JOINTS: u16 = control::machine::all_joints(JOINTS as u8);
/// Joints a robot may have.
pub const MAX_JOINTS: usize = control::machine::MAX_JOINTS;
/// Gait slots a module may have at most.
pub const MAX_SLOTS: usize = 8;
