//! `rb-host zero`

use control::robot::{JOINT_NAMES, JOINTS};
use protocol::link::{ALL_JOINTS, Tag, ToModule};
use serde_json::json;

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::link::text;

/// Take the pose that the robot stands in now as its home pose
///
/// The encoders are relative and the joints have no end stops: place the robot by hand with its four cubes in one line and
/// the marks aligned, then give this order. Every restart of a driver needs it again.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Only this joint, 0 to 5 or A.M0 to B.M2; may be repeated
    #[arg(long, short_alias = 'j', value_name = "JOINT")]
    joint: Vec<String>,
}

/// A joint by its number or its name.
fn joint_number(text: &str) -> Outcome<usize> {
    let by_name = JOINT_NAMES.iter().position(|name| *name == text);
    let by_number = || text.parse().ok().filter(|joint| *joint < JOINTS);
    by_name.or_else(by_number).ok_or_else(|| {
        let names = JOINT_NAMES.join(", ");
        let last = JOINTS - 1;
        Failure::say(
            Exit::Usage,
            format!("--joint {text}: joints are 0 to {last}, or {names}"),
        )
    })
}

/// Stores the zero.
///
/// # Errors
/// Exit codes 2, 4, 5, 6, 7.
pub fn run(args: &Args, context: &Context) -> Outcome {
    let mut joint_mask = if args.joint.is_empty() { ALL_JOINTS } else { 0 };
    for joint in &args.joint {
        joint_mask |= 1 << joint_number(joint)?;
    }
    let mut robot = context.connect()?;
    let question = format!(
        "take the present pose as home for joints {}?",
        text::joints(joint_mask)
    );
    if !robot.link().uri().is_sim() {
        super::confirm(context, &question)?;
    }
    robot.order(&ToModule::Zero {
        joint_mask,
        tag: Tag::NONE,
    })?;
    let info = robot.info()?;
    let value = json!({ "zeroed_mask": joint_mask, "homed_mask": info.homed_mask, "state": text::state(info.state) });
    context.out.result("rb.zero/1", value, || {
        format!(
            "homed: {}\nstate: {}",
            text::joints(info.homed_mask),
            text::state(info.state)
        )
    });
    Ok(())
}
