//! `rb-host version`

use serde_json::json;

use crate::context::Context;
use crate::failure::Outcome;

/// Show versions of this program, its link protocol and its file formats
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Prints versions.
///
/// # Errors
/// None.
pub fn run(_args: &Args, context: &Context) -> Outcome {
    let version = env!("CARGO_PKG_VERSION");
    let protocol = protocol::link::VERSION;
    let gait = files::gait::FORMAT;
    let recording = crate::recording::FORMAT;
    let value = json!({ "version": version, "protocol": protocol, "gait_format": gait, "recording_format": recording });
    context.out.result("rb.version/1", value, || {
        format!("rb-host {version}\nlink protocol {protocol}\ngait.toml format {gait}\nrecording format {recording}")
    });
    Ok(())
}
