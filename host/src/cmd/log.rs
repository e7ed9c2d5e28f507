//! `rb-host log`

use std::time::Duration;

use protocol::link::{Event, FromModule, ToModule};
use serde_json::json;

use crate::context::Context;
use crate::failure::Outcome;
use crate::link::{LinkError, Robot, text};

/// Show what happened on the robot since it started
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Stay and show events as they happen, until Ctrl-C
    #[arg(short, long)]
    follow: bool,
    /// First event number
    #[arg(long, default_value_t = 0, value_name = "N")]
    since: u32,
}

/// Prints events.
///
/// # Errors
/// Exit codes 4, 5, 6.
pub fn run(args: &Args, context: &Context) -> Outcome {
    let mut robot = context.connect()?;
    let mut next = args.since;
    loop {
        next = show_from(&mut robot, context, next)?;
        if !args.follow {
            return Ok(());
        }
        match robot.next(Duration::from_millis(500)) {
            Ok(_) => {}
            Err(LinkError::Interrupted) => return Ok(()),
            Err(error) => return Err(error.into()),
        }
    }
}

/// Prints all events from number `next` on; returns the number after the last.
fn show_from(robot: &mut Robot, context: &Context, mut next: u32) -> Outcome<u32> {
    loop {
        let FromModule::Events {
            next: after,
            lost,
            events,
        } = robot.ask(&ToModule::GetEvents { since: next })?
        else {
            return Err(LinkError::WrongAnswer { request: "events" }.into());
        };
        if lost > 0 {
            context
                .out
                .warn(format_args!("{lost} older events are no longer kept"));
        }
        for event in &events {
            show(event, context);
        }
        if events.is_empty() || after <= next {
            return Ok(after.max(next));
        }
        next = after;
    }
}

fn show(event: &Event, context: &Context) {
    let (kind, words) = text::event(event);
    let t_s = event.t_us as f64 / 1e6;
    let value = json!({ "seq": event.seq, "t_s": t_s, "kind": kind, "text": words });
    context.out.result("rb.event/1", value, || {
        format!("{:6} {t_s:>12.6} s  {kind:18} {words}", event.seq)
    });
}
