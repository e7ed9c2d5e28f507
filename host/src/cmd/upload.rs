//! `rb-host upload`

use std::path::PathBuf;

use control::machine::Machine;
use serde_json::json;

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::gait_file;
use crate::link::PortUri;
use crate::link::text;
use crate::upload::{self, Options};

/// Check a gait, store it in a slot of the robot and read it back; nothing moves
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Gait file
    gait: PathBuf,
    /// Slot; default: the slot with a gait of the same name, else the first empty one
    #[arg(short, long, value_name = "SLOT")]
    slot: Option<u8>,
    /// Store it under another name
    #[arg(long)]
    name: Option<String>,
    /// Make it the active slot
    #[arg(long)]
    activate: bool,
    /// Do not read it back
    #[arg(long)]
    no_verify: bool,
    /// Check only, send nothing
    #[arg(long)]
    dry_run: bool,
    /// Leave the check to the robot
    #[arg(long, conflicts_with = "dry_run")]
    skip_host_check: bool,
}

/// Uploads.
///
/// # Errors
/// Exit codes 3, 4, 5, 6, 7.
pub fn run(args: &Args, context: &Context) -> Outcome {
    let mut gait = gait_file::load(&args.gait)?;
    if let Some(name) = &args.name {
        gait = renamed(gait, name)?;
    }
    let digest = protocol::link::WireGait::from(&gait).digest();
    if args.dry_run {
        upload::host_check(context, &gait, &args.gait, &Machine::default())?;
        let value =
            json!({ "name": gait.name(), "digest": text::hex(&digest.0), "uploaded": false });
        context.out.result("rb.upload/1", value, || {
            format!(
                "{}: the robot would take it; nothing was sent",
                args.gait.display()
            )
        });
        return Ok(());
    }
    let mut robot = context.connect_to_change();
    if !args.skip_host_check {
        let machine = upload::machine_of(&mut robot)?;
        upload::host_check(context, &gait, &args.gait, &machine)?;
    }
    let mut robot = robot?;
    let options = Options {
        slot: args.slot,
        activate: args.activate,
        verify: !args.no_verify,
    };
    let stored = upload::upload(&mut robot, &gait, options)?;
    if matches!(robot.link().uri(), PortUri::Sim(_)) {
        context.out.say(format_args!(
            "The emulated robot in this process forgets the gait when this command ends: `rb-host run {}` uploads and runs; \
             `rb-host emulate robot --tcp 127.0.0.1:7000` gives one that stays.",
            args.gait.display()
        ));
    }
    let value = json!({
        "name": gait.name(), "slot": stored.slot, "digest": text::hex(&stored.digest.0), "active": stored.active,
        "verified": options.verify, "uploaded": true,
    });
    context.out.result("rb.upload/1", value, || {
        let active = if stored.active { ", active" } else { "" };
        format!(
            "{} in slot {}, digest {}{active}",
            gait.name(),
            stored.slot,
            text::hex(&stored.digest.0)
        )
    });
    Ok(())
}

fn renamed(gait: control::gait::Gait, name: &str) -> Outcome<control::gait::Gait> {
    let bad = |why: String| Failure::say(Exit::Usage, format!("--name {name:?}: {why}"));
    let mut raw = gait.raw();
    raw.name = heapless::String::try_from(name)
        .map_err(|_| bad(format!("at most {} bytes", control::gait::MAX_NAME)))?;
    control::gait::Gait::try_from(raw).map_err(|e| bad(e.to_string()))
}
