//! `rb-host reset`

use protocol::link::{Tag, ToModule};
use serde_json::json;

use crate::context::Context;
use crate::failure::Outcome;
use crate::link::text;

/// Restart the robot's controller, or clear a latched fault
///
/// After a restart nothing moves until the robot is homed again.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Clear a latched fault or STOP instead of restarting
    #[arg(long)]
    fault: bool,
}

/// Resets.
///
/// # Errors
/// Exit codes 4, 5, 6, 7.
pub fn run(args: &Args, context: &Context) -> Outcome {
    let mut robot = context.connect_to_change()?;
    if args.fault {
        robot.order(&ToModule::ClearFault { tag: Tag::NONE })?;
        let info = robot.info()?;
        let value = json!({ "cleared": true, "state": text::state(info.state) });
        context.out.result("rb.reset/1", value, || {
            format!("cleared, state: {}", text::state(info.state))
        });
        return Ok(());
    }
    robot.order(&ToModule::Reset { tag: Tag::NONE })?;
    context
        .out
        .result("rb.reset/1", json!({ "restarted": true }), || {
            "restarting; place the home pose and `rb-host zero` before the next run".to_owned()
        });
    Ok(())
}
