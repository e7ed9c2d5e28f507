//! `rb-host zero`

use control::machine::Machine;
use control::robot::JOINT_NAMES;
use protocol::link::{Tag, ToModule};
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
    /// Only this joint, counted from 0, or A.M0 to B.M2 of a meta-module; may be repeated
    #[arg(long, short_alias = 'j', value_name = "JOINT")]
    joint: Vec<String>,
}

/// A joint by its number, or by its name in a meta-module.
fn joint_number(text: &str, machine: &Machine) -> Outcome<usize> {
    let joints = usize::from(machine.joints());
    let named = machine.model().map_or(&[][..], |_| &JOINT_NAMES[..]);
    let by_name = named.iter().position(|name| *name == text);
    let by_number = || text.parse().ok().filter(|joint| *joint < joints);
    by_name.or_else(by_number).ok_or_else(|| {
        let names: String = named.iter().map(|name| format!(", {name}")).collect();
        let last = joints - 1;
        Failure::say(
            Exit::Usage,
            format!("--joint {text}: joints are 0 to {last}{names}"),
        )
    })
}

/// Stores the zero.
///
/// # Errors
/// Exit codes 2, 4, 5, 6, 7.
pub fn run(args: &Args, context: &Context) -> Outcome {
    let mut robot = context.connect_to_change()?;
    let machine = robot.machine()?;
    let mut joint_mask = 0;
    for joint in &args.joint {
        joint_mask |= 1 << joint_number(joint, &machine)?;
    }
    if args.joint.is_empty() {
        joint_mask = machine.all_joints();
    }
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
