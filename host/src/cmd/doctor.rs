//! `rb-host doctor`

use std::time::Duration;

use serde_json::{Value, json};

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::link::{PortUri, Robot, find, text};

/// Check ports, permissions, versions, round trip, clock and motors, with hints for what is wrong
#[derive(Debug, clap::Args)]
pub struct Args {}

/// Pings for the round trip and the clock.
const PINGS: usize = 20;

/// How a check went.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mark {
    Good,
    Note,
    Bad,
}

/// One line of the report.
struct Line {
    mark: Mark,
    what: &'static str,
    found: String,
    hint: Option<String>,
}

impl Line {
    fn good(what: &'static str, found: impl Into<String>) -> Self {
        Self {
            mark: Mark::Good,
            what,
            found: found.into(),
            hint: None,
        }
    }

    fn note(what: &'static str, found: impl Into<String>, hint: impl Into<String>) -> Self {
        Self {
            mark: Mark::Note,
            what,
            found: found.into(),
            hint: Some(hint.into()),
        }
    }

    fn bad(what: &'static str, found: impl Into<String>, hint: impl Into<String>) -> Self {
        Self {
            mark: Mark::Bad,
            what,
            found: found.into(),
            hint: Some(hint.into()),
        }
    }
}

/// Checks and reports.
///
/// # Errors
/// Exit code 8 when something is wrong.
pub fn run(_args: &Args, context: &Context) -> Outcome {
    let mut lines = vec![ports()];
    let uri = context.port()?;
    lines.extend(permissions(&uri));
    match context.connect_to(&uri) {
        Ok(mut robot) => lines.extend(robot_lines(context, &mut robot)?),
        Err(failure) => {
            let hint = failure.hint_text().unwrap_or("is the robot on?").to_owned();
            lines.push(Line::bad("HELLO", failure.to_string(), hint));
        }
    }
    report(context, &uri, &lines)
}

fn ports() -> Line {
    let likely: Vec<String> = find::candidates()
        .iter()
        .filter(|c| c.is_likely())
        .map(|c| c.path.display().to_string())
        .collect();
    if likely.is_empty() {
        Line::note(
            "ports",
            "no USB or Bluetooth serial port",
            "plug in the USB cable, or bind Bluetooth: docs/how-to/bluetooth.md",
        )
    } else {
        Line::good("ports", likely.join(", "))
    }
}

/// A COM port is no file: whether it may be opened is told when it is.
#[cfg(not(unix))]
fn permissions(_uri: &PortUri) -> Option<Line> {
    None
}

/// What the operating system says about a serial port before it is opened.
#[cfg(unix)]
fn permissions(uri: &PortUri) -> Option<Line> {
    let PortUri::Serial(path) = uri else {
        return None;
    };
    if !path.exists() {
        let hint = if uri.is_rfcomm() {
            "bind it: sudo rfcomm bind 0 MAC 1 (docs/how-to/bluetooth.md)"
        } else {
            "`rb-host list` shows the ports of this computer"
        };
        return Some(Line::bad(
            "port",
            format!("{} does not exist", path.display()),
            hint,
        ));
    }
    Some(match may_open(path) {
        Ok(()) => Line::good("port", format!("{} may be opened", path.display())),
        Err(error) if error.kind() == std::io::ErrorKind::PermissionDenied => Line::bad(
            "port",
            format!("no permission for {}", path.display()),
            "sudo usermod -aG dialout $USER, then log out and in",
        ),
        Err(error) => Line::bad(
            "port",
            error.to_string(),
            "another program may hold it: `fuser -v PORT` names it",
        ),
    })
}

#[cfg(unix)]
fn may_open(path: &std::path::Path) -> std::io::Result<()> {
    // Opening to read only, without waiting for a carrier, is enough to see permission and lock.
    use std::os::unix::fs::OpenOptionsExt;
    std::fs::OpenOptions::new()
        .read(true)
        .custom_flags(libc::O_NONBLOCK)
        .open(path)
        .map(drop)
}

fn robot_lines(context: &Context, robot: &mut Robot) -> Outcome<Vec<Line>> {
    let hello = robot.hello().clone();
    let mut lines = vec![Line::good(
        "HELLO",
        format!(
            "robot {}, firmware {}, protocol {}",
            hello.robot_id, hello.firmware, hello.protocol
        ),
    )];
    let mut trips = Vec::new();
    let mut offsets_us = Vec::new();
    for _ in 0..PINGS {
        let pong = robot.ping()?;
        trips.push(pong.round_trip);
        offsets_us.push(pong.host.as_micros() as f64 - pong.module_us as f64);
    }
    lines.push(round_trip(&mut trips));
    let spread = offsets_us.iter().fold(f64::MIN, |a, b| a.max(*b))
        - offsets_us.iter().fold(f64::MAX, |a, b| a.min(*b));
    lines.push(Line::good(
        "clock",
        format!("offset known to {:.1} ms", spread / 2e3),
    ));
    let info = robot.info()?;
    let machine = robot.machine()?;
    let all = machine.all_joints();
    lines.push(if info.motor_mask == all {
        Line::good("motors", format!("all {} answer", machine.joints()))
    } else {
        let missing = text::joints(all & !info.motor_mask);
        Line::bad(
            "motors",
            format!("no answer from {missing}"),
            "check bus cable and motor power; `rb-host bus scan`",
        )
    });
    lines.push(if info.homed_mask == all {
        Line::good("homing", "all joints have their zero")
    } else {
        Line::note(
            "homing",
            "not homed",
            "place the home pose by hand, then `rb-host zero`",
        )
    });
    if let Some(fault) = &info.fault {
        lines.push(Line::bad(
            "fault",
            text::fault(&fault.fault),
            "remove the cause, then `rb-host reset --fault`",
        ));
    }
    let bad = info.counters.link.bad_crc + info.counters.link.bad_framing;
    lines.push(if bad == 0 {
        Line::good(
            "link",
            format!("{} frames, none damaged", info.counters.link.frames),
        )
    } else {
        Line::note(
            "link",
            format!("{bad} damaged of {} frames", info.counters.link.frames),
            "check cable, range and baud rate",
        )
    });
    lines.push(match (hello.keyed, robot.has_key()) {
        (true, true) => Line::good("key", "set, and known here"),
        (true, false) => Line::bad(
            "key",
            "the robot has a key that this host does not know",
            "copy its key file, or set a new one over USB: `rb-host config key set`",
        ),
        (false, _) => Line::note(
            "key",
            "not set: orders are taken over the wire port only",
            "`rb-host config key set`",
        ),
    });
    context
        .out
        .detail(format_args!("state {}", text::state(info.state)));
    Ok(lines)
}

fn round_trip(trips: &mut [Duration]) -> Line {
    trips.sort_unstable();
    let median = trips.get(trips.len() / 2).copied().unwrap_or_default();
    let worst = trips.last().copied().unwrap_or_default();
    let found = format!(
        "median {:.1} ms, worst {:.1} ms",
        median.as_secs_f64() * 1e3,
        worst.as_secs_f64() * 1e3
    );
    // A run needs no fast link; above this the live view lags visibly.
    if worst > Duration::from_millis(300) {
        Line::note(
            "round trip",
            found,
            "slow link: recordings stay complete, the live view lags",
        )
    } else {
        Line::good("round trip", found)
    }
}

fn report(context: &Context, uri: &PortUri, lines: &[Line]) -> Outcome {
    let word = |mark| match mark {
        Mark::Good => "ok",
        Mark::Note => "note",
        Mark::Bad => "BAD",
    };
    let values: Vec<Value> = lines
        .iter()
        .map(|l| json!({ "check": l.what, "result": word(l.mark).to_lowercase(), "found": l.found, "hint": l.hint }))
        .collect();
    context.out.result(
        "rb.doctor/1",
        json!({ "port": uri.to_string(), "checks": values }),
        || {
            let mut out = String::new();
            for l in lines {
                out.push_str(&format!("{:5} {:11} {}\n", word(l.mark), l.what, l.found));
                if let Some(hint) = &l.hint {
                    out.push_str(&format!("      {:11} -> {hint}\n", ""));
                }
            }
            out
        },
    );
    match lines.iter().filter(|l| l.mark == Mark::Bad).count() {
        0 => Ok(()),
        n => Err(Failure::say(Exit::Check, format!("{n} checks failed"))),
    }
}
