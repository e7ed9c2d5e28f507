//! `rb-host download`

use std::path::PathBuf;

use serde_json::json;

use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::link::text;
use crate::upload;

/// Read a gait back from a slot of the robot
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Slot; default: the active one
    #[arg(short, long, value_name = "SLOT")]
    slot: Option<u8>,
    /// File to write; default: standard output
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long)]
    force: bool,
}

/// Downloads.
///
/// # Errors
/// Exit codes 1, 4, 5, 6, 7.
pub fn run(args: &Args, context: &Context) -> Outcome {
    if let Some(path) = &args.output {
        disk::must_be_free(path, args.force)?;
    }
    let mut robot = context.connect()?;
    let slot = match args.slot {
        Some(slot) => slot,
        None => upload::slots(&mut robot)?.0.ok_or_else(|| {
            Failure::say(Exit::Refused, "no slot is active")
                .hint("choose one with --slot; `rb-host slots list` shows them")
        })?,
    };
    let (gait, digest) = upload::download(&mut robot, slot)?;
    let toml = files::gait::to_toml(&gait);
    if let Some(path) = &args.output {
        disk::write_new(path, toml.as_bytes(), args.force)?;
    }
    let value = json!({ "slot": slot, "name": gait.name(), "digest": text::hex(&digest.0), "file": args.output, "gait_toml": toml });
    context
        .out
        .result("rb.download/1", value, || match &args.output {
            Some(path) => format!("{} from slot {slot} in {}", gait.name(), path.display()),
            None => toml.clone(),
        });
    Ok(())
}
