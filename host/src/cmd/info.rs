//! `rb-host info`

use protocol::link::{CrashRecord, FromModule, Info, ToModule};
use serde_json::{Value, json};

use crate::context::Context;
use crate::failure::Outcome;
use crate::link::{LinkError, Robot, text};

/// Show firmware, state, battery, homing, counters and the last crash of the robot
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Prints what the robot says about itself.
///
/// # Errors
/// Exit codes 4, 5, 6.
pub fn run(_args: &Args, context: &Context) -> Outcome {
    let mut robot = context.connect()?;
    let info = robot.info()?;
    let crash = match robot.ask(&ToModule::GetCrash)? {
        FromModule::Crash(crash) => crash,
        _ => {
            return Err(LinkError::WrongAnswer {
                request: "crash record",
            }
            .into());
        }
    };
    let value = json(&robot, &info, crash.as_ref());
    context
        .out
        .result("rb.info/1", value, || words(&robot, &info, crash.as_ref()));
    Ok(())
}

fn json(robot: &Robot, info: &Info, crash: Option<&CrashRecord>) -> Value {
    let hello = robot.hello();
    let counters = &info.counters;
    json!({
        "port": robot.link().uri().to_string(),
        "robot_id": hello.robot_id, "emulated": hello.is_emulated(), "firmware": hello.firmware.as_str(), "protocol": hello.protocol,
        "boot_id": hello.boot_id, "model_digest": text::hex(&hello.model_digest.0), "keyed": hello.keyed,
        "state": text::state(info.state),
        "fault": info.fault.map(|f| json!({
            "text": text::fault(&f.fault), "first_s": f.first_us as f64 / 1e6, "count": f.count })),
        "reset_cause": text::reset_cause(info.reset_cause), "uptime_s": info.uptime_us as f64 / 1e6, "cycles": info.cycles,
        "slots": info.slots, "active_slot": info.active_slot,
        "battery_v": (info.battery_mv > 0).then(|| f64::from(info.battery_mv) / 1e3),
        "homed_mask": info.homed_mask, "motor_mask": info.motor_mask,
        "counters": {
            "frames": counters.link.frames, "bad_crc": counters.link.bad_crc, "bad_framing": counters.link.bad_framing,
            "bad_tags": counters.bad_tags, "bus_timeouts": counters.bus_timeouts, "bus_bad_crc": counters.bus_bad_crc,
            "bus_stray": counters.bus_stray, "overruns": counters.overruns, "holds": counters.holds,
            "samples_dropped": counters.samples_dropped, "events_dropped": counters.events_dropped,
        },
        "crash": crash.map(|c| json!({
            "kind": format!("{:?}", c.kind), "uptime_s": c.uptime_us as f64 / 1e6, "pc": c.pc, "lr": c.lr,
            "detail": c.detail, "place": c.place.as_str() })),
    })
}

fn words(robot: &Robot, info: &Info, crash: Option<&CrashRecord>) -> String {
    let hello = robot.hello();
    let c = &info.counters;
    let emulated = if hello.is_emulated() {
        ", EMULATED: nothing real moves"
    } else {
        ""
    };
    let mut lines = vec![
        format!(
            "robot        {} on {}{emulated}",
            hello.robot_id,
            robot.link().uri()
        ),
        format!(
            "firmware     {} (protocol {})",
            hello.firmware, hello.protocol
        ),
        format!("model        {}", text::hex(&hello.model_digest.0)),
        format!("state        {}", text::state(info.state)),
    ];
    if let Some(fault) = &info.fault {
        let first_s = fault.first_us as f64 / 1e6;
        lines.push(format!(
            "FAULT        {} (first at {first_s:.3} s, {} times)",
            text::fault(&fault.fault),
            fault.count
        ));
    }
    let active = info
        .active_slot
        .map_or_else(|| "none".to_owned(), |s| s.to_string());
    let battery = if info.battery_mv == 0 {
        "not measured".to_owned()
    } else {
        format!("{:.2} V", f64::from(info.battery_mv) / 1e3)
    };
    lines.extend([
        format!("up           {:.1} s since {} (boot id {:08x})", info.uptime_us as f64 / 1e6, text::reset_cause(info.reset_cause), hello.boot_id),
        format!("slots        {}, active {active}", info.slots),
        format!("battery      {battery}"),
        format!("motors       {}", text::joints(info.motor_mask)),
        format!("homed        {}", text::joints(info.homed_mask)),
        format!("key          {}", if hello.keyed { "set" } else { "not set: orders are taken on the wire port only" }),
        format!(
            "counters     link {} frames, {} bad; bus {} timeouts, {} bad; {} overruns, {} holds, {} samples dropped",
            c.link.frames, c.link.bad_crc + c.link.bad_framing, c.bus_timeouts, c.bus_bad_crc, c.overruns, c.holds, c.samples_dropped
        ),
    ]);
    if let Some(crash) = crash {
        lines.push(format!(
            "last crash   {:?} after {:.3} s at pc {:#010x}, lr {:#010x}, detail {:#x} {}",
            crash.kind,
            crash.uptime_us as f64 / 1e6,
            crash.pc,
            crash.lr,
            crash.detail,
            crash.place
        ));
    }
    lines.join("\n")
}
