//! `rb-host stop`

use serde_json::json;

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::link::{LinkError, Stopped};

/// Stop the robot, whatever it does; needs no key. Exit 0 only when it acknowledged, and, if this host has its key, proved it
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Stops.
///
/// # Errors
/// Exit codes 4, 5, 6.
pub fn run(_args: &Args, context: &Context) -> Outcome {
    let mut robot = context.connect_to_change()?;
    robot.finish_in_peace();
    let stopped = robot.stop().map_err(|error| match error {
        LinkError::Unproved | LinkError::StillMoving => Failure::from(error),
        error => Failure::new(Exit::Link, error)
            .hint("the STOP was NOT acknowledged: use the STOP button on the robot"),
    })?;
    let proved = stopped == Stopped::Proved;
    let value = json!({ "acknowledged": true, "proved": proved });
    context.out.result("rb.stop/1", value, || {
        if proved {
            "stopped (acknowledged, proved with the robot's key)".to_owned()
        } else {
            "stopped (acknowledged, not authenticated: this host has no key of the robot)"
                .to_owned()
        }
    });
    Ok(())
}
