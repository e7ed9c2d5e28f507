//! `rb-host list`

use serde_json::{Value, json};

use crate::context::Context;
use crate::failure::Outcome;
use crate::link::find::{self, Candidate};

/// List the ports of this computer and which of them answer as a robot
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Show built-in ports too
    #[arg(long)]
    all: bool,
    /// Do not open the ports, only list them
    #[arg(long)]
    no_probe: bool,
}

/// Lists ports.
///
/// # Errors
/// None.
pub fn run(args: &Args, context: &Context) -> Outcome {
    let shown = find::candidates()
        .into_iter()
        .filter(|c| args.all || c.is_likely());
    let rows: Vec<(Value, String)> = shown.map(|c| row(&c, args, context)).collect();
    let (values, lines): (Vec<Value>, Vec<String>) = rows.into_iter().unzip();
    context
        .out
        .result("rb.list/1", json!({ "ports": values }), || {
            if lines.is_empty() {
                String::from("no serial ports")
            } else {
                lines.join("\n")
            }
        });
    if values.is_empty() {
        context
            .out
            .say("without a robot, --port sim: talks to the emulated one");
    }
    Ok(())
}

fn row(candidate: &Candidate, args: &Args, context: &Context) -> (Value, String) {
    let ids = candidate
        .usb_ids
        .map(|(vid, pid)| format!("{vid:04x}:{pid:04x}"));
    let answer = if args.no_probe || !candidate.is_likely() {
        None
    } else {
        Some(find::probe(candidate, context.baud()).map_err(|e| e.to_string()))
    };
    let (robot, words) = match &answer {
        None => (Value::Null, "not asked".to_owned()),
        Some(Ok(hello)) => (
            json!({ "id": hello.robot_id, "firmware": hello.firmware.as_str(), "protocol": hello.protocol }),
            format!("robot {}, firmware {}", hello.robot_id, hello.firmware),
        ),
        Some(Err(error)) => (json!({ "error": error }), error.clone()),
    };
    let value = json!({
        "uri": candidate.uri().to_string(), "kind": candidate.kind, "usb": ids, "serial": candidate.serial,
        "product": candidate.product, "robot": robot,
    });
    let line = format!(
        "{:20} {:10} {:10} {:20} {words}",
        candidate.uri().to_string(),
        candidate.kind,
        ids.unwrap_or_default(),
        candidate.product.clone().unwrap_or_default(),
    );
    (value, line)
}
