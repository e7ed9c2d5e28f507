//! `rb-host slots`

use protocol::link::{Tag, ToModule};
use serde_json::json;

use crate::context::Context;
use crate::failure::Outcome;
use crate::link::text;
use crate::upload;

/// List, activate or erase the gait slots of the robot
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Option<Action>,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Show what the slots hold
    List,
    /// Make a slot the active one
    Activate {
        /// Slot
        slot: u8,
    },
    /// Erase a slot; not the active one
    Erase {
        /// Slot
        slot: u8,
    },
}

/// Manages slots.
///
/// # Errors
/// Exit codes 4, 5, 6, 7.
pub fn run(args: &Args, context: &Context) -> Outcome {
    let mut robot = match args.action {
        Some(Action::List) | None => context.connect()?,
        Some(_) => context.connect_to_change()?,
    };
    match args.action {
        Some(Action::Activate { slot }) => robot.order(&ToModule::ActivateSlot {
            slot,
            tag: Tag::NONE,
        })?,
        Some(Action::Erase { slot }) => robot.order(&ToModule::EraseSlot {
            slot,
            tag: Tag::NONE,
        })?,
        Some(Action::List) | None => {}
    }
    let (active, slots) = upload::slots(&mut robot)?;
    let values: Vec<_> = slots
        .iter()
        .enumerate()
        .map(|(k, slot)| match slot {
            Some(s) => json!({ "slot": k, "name": s.name.as_str(), "digest": text::hex(&s.digest.0), "generation": s.generation }),
            None => json!({ "slot": k, "name": null }),
        })
        .collect();
    context.out.result(
        "rb.slots/1",
        json!({ "active": active, "slots": values }),
        || {
            let line = |(k, slot): (usize, &Option<protocol::link::SlotInfo>)| {
                let mark = if active.map(usize::from) == Some(k) {
                    "*"
                } else {
                    " "
                };
                match slot {
                    Some(s) => format!("{mark} {k}  {:32} {}", s.name, text::hex(&s.digest.0)),
                    None => format!("{mark} {k}  empty"),
                }
            };
            slots
                .iter()
                .enumerate()
                .map(line)
                .collect::<Vec<_>>()
                .join("\n")
        },
    );
    Ok(())
}
