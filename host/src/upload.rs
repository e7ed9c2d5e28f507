//! Gaits to the robot and back: check here, send, compare digests, read back.

use std::path::Path;

use control::gait::Gait;
use control::machine::Machine;
use protocol::link::{Digest, FromModule, SlotInfo, Tag, ToModule, WireGait};

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::gait_file::{self, GaitCheck};
use crate::link::{LinkError, Robot};

/// A gait in a slot of the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Stored {
    /// Slot.
    pub slot: u8,
    /// Digest of what the robot read back.
    pub digest: Digest,
    /// Whether it is the active slot.
    pub active: bool,
}

/// How to upload.
#[derive(Debug, Clone, Copy, Default)]
pub struct Options {
    /// Slot; `None` = the one with the same name, else the first empty one.
    pub slot: Option<u8>,
    /// Make it the active slot.
    pub activate: bool,
    /// Read the gait back and compare every bit.
    pub verify: bool,
}

/// The robot that a gait is checked for: the one that answered, else a meta-module, so that a gait is refused without a robot too.
///
/// # Errors
/// Exit code 5.
pub fn machine_of(robot: &mut Outcome<Robot>) -> Outcome<Machine> {
    match robot {
        Ok(robot) => Ok(robot.machine()?),
        Err(_) => Ok(Machine::default()),
    }
}

/// The host check for the robot `machine` with its verdict as an exit code.
///
/// # Errors
/// Exit code 7: the robot would refuse.
pub fn host_check(
    context: &Context,
    gait: &Gait,
    path: &Path,
    machine: &Machine,
) -> Outcome<GaitCheck> {
    let check = gait_file::check(gait, machine).map_err(|unfit| {
        Failure::say(Exit::Refused, format!("{}: {unfit}", path.display()))
            .hint("this is the robot's own check, made before sending; `rb-host gait show --plot` draws the gait")
    })?;
    context
        .out
        .detail(format_args!("host check: {}", check.words()));
    Ok(check)
}

/// Sends a gait, compares the digest of what the robot stored, and reads it back.
///
/// # Errors
/// Exit codes 5 and 7.
pub fn upload(robot: &mut Robot, gait: &Gait, options: Options) -> Outcome<Stored> {
    let wire = WireGait::from(gait);
    let slot = match options.slot {
        Some(slot) => slot,
        None => choose_slot(robot, gait.name())?,
    };
    let order = ToModule::PutGait {
        slot,
        activate: options.activate,
        gait: wire.clone(),
        tag: Tag::NONE,
    };
    let stored = match robot.ask(&order)? {
        FromModule::GaitStored {
            slot,
            digest,
            active,
        } => Stored {
            slot,
            digest,
            active,
        },
        _ => return Err(LinkError::WrongAnswer { request: "upload" }.into()),
    };
    if stored.digest != wire.digest() {
        return Err(mismatch("the robot stored another gait than was sent"));
    }
    if options.verify {
        let (back, digest) = download(robot, slot)?;
        if WireGait::from(&back) != wire || digest != stored.digest {
            return Err(mismatch("the gait read back differs from the one sent"));
        }
    }
    Ok(stored)
}

fn mismatch(what: &'static str) -> Failure {
    Failure::say(Exit::Link, what)
        .hint("upload again; if it repeats, read `rb-host info` and report it")
}

/// Reads a gait from a slot.
///
/// # Errors
/// Exit codes 5 and 7.
pub fn download(robot: &mut Robot, slot: u8) -> Outcome<(Gait, Digest)> {
    match robot.ask(&ToModule::GetGait { slot })? {
        FromModule::GaitData { digest, gait, .. } => {
            if gait.digest() != digest {
                return Err(mismatch("the gait does not match its digest"));
            }
            let gait = Gait::try_from(&gait).map_err(|e| {
                Failure::say(
                    Exit::Link,
                    format!("the robot holds a gait this host does not accept: {e}"),
                )
            })?;
            Ok((gait, digest))
        }
        _ => Err(LinkError::WrongAnswer {
            request: "download",
        }
        .into()),
    }
}

/// Active slot and content of all slots.
///
/// # Errors
/// Exit codes 5 and 7.
pub fn slots(robot: &mut Robot) -> Outcome<(Option<u8>, Vec<Option<SlotInfo>>)> {
    match robot.ask(&ToModule::ListSlots)? {
        FromModule::Slots { active, slots } => Ok((active, slots.into_iter().collect())),
        _ => Err(LinkError::WrongAnswer { request: "slots" }.into()),
    }
}

/// The slot that holds a gait of this name, else the first empty one.
fn choose_slot(robot: &mut Robot, name: &str) -> Outcome<u8> {
    let (_, slots) = slots(robot)?;
    let same = slots
        .iter()
        .position(|s| s.as_ref().is_some_and(|s| s.name.as_str() == name));
    let free = slots.iter().position(Option::is_none);
    same.or(free)
        .and_then(|slot| u8::try_from(slot).ok())
        .ok_or_else(|| {
            Failure::say(Exit::Refused, format!("all {} slots are full", slots.len()))
                .hint("choose one to replace with --slot, or `rb-host slots erase SLOT`")
        })
}
