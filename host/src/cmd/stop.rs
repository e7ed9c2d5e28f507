//! `rb-host stop`

use protocol::link::ToModule;
use serde_json::json;

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};

/// Stop the robot, whatever it does; needs no key. Exit 0 only when it acknowledged
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Stops.
///
/// # Errors
/// Exit codes 4, 5, 6.
pub fn run(_args: &Args, context: &Context) -> Outcome {
    let mut robot = context.connect()?;
    robot.finish_in_peace();
    robot.order(&ToModule::Stop).map_err(|error| {
        Failure::new(Exit::Link, error)
            .hint("the STOP was NOT acknowledged: use the STOP button on the robot")
    })?;
    context
        .out
        .result("rb.stop/1", json!({ "acknowledged": true }), || {
            "stopped (acknowledged)".to_owned()
        });
    Ok(())
}
