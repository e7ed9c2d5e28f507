//! Protocol values in words.

use control::robot::JOINT_NAMES;
use protocol::link::{
    EndReason, Event, EventKind, Fault, GaitReject, MAX_JOINTS, ModuleState, PortFault, Reject,
    ResetCause, RobotReject, WireContact, WrongDriver,
};

/// A digest in hexadecimal.
#[must_use]
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// Name of a joint. Those of a meta-module have names; of other robots they are numbers.
#[must_use]
pub fn joint(index: u8) -> String {
    format!("joint {}", named(usize::from(index)))
}

fn named(index: usize) -> String {
    match JOINT_NAMES.get(index) {
        Some(name) => format!("{index} ({name})"),
        None => index.to_string(),
    }
}

/// Joints of a mask, such as `0 (A.M0), 3 (B.M0)`.
#[must_use]
pub fn joints(mask: u16) -> String {
    let list: Vec<String> = (0..16)
        .filter(|k| mask & (1 << k) != 0)
        .map(named)
        .collect();
    if list.is_empty() {
        "none".to_owned()
    } else {
        list.join(", ")
    }
}

/// What of a robot may meet, as in `--json`.
#[must_use]
pub fn contact_name(contact: WireContact) -> &'static str {
    match contact {
        WireContact::MetaModule => "metamodule",
        WireContact::Module => "module",
        WireContact::Unchecked => "unchecked",
        WireContact::Unstated => "unstated",
    }
}

/// What of a robot may meet, in words.
#[must_use]
pub fn contact_words(contact: WireContact) -> &'static str {
    match contact {
        WireContact::MetaModule => "a meta-module, every move checked",
        WireContact::Module => "one module, nothing of it can meet",
        WireContact::Unchecked => "self-collision unchecked",
        WireContact::Unstated => "self-collision unchecked and not said so: it does not run",
    }
}

/// A state as in `--json`.
#[must_use]
pub fn state(state: ModuleState) -> &'static str {
    match state {
        ModuleState::Boot => "boot",
        ModuleState::Unhomed => "unhomed",
        ModuleState::Idle => "idle",
        ModuleState::Armed => "armed",
        ModuleState::Run => "run",
        ModuleState::Stopping => "stopping",
        ModuleState::Fault => "fault",
        ModuleState::EStop => "estop",
    }
}

/// A reset cause as in `--json`.
#[must_use]
pub fn reset_cause(cause: ResetCause) -> &'static str {
    match cause {
        ResetCause::PowerOn => "power_on",
        ResetCause::BrownOut => "brown_out",
        ResetCause::Pin => "pin",
        ResetCause::Watchdog => "watchdog",
        ResetCause::Software => "software",
        ResetCause::Crash => "crash",
        ResetCause::Unknown => "unknown",
    }
}

/// A fault in words, with what to do.
#[must_use]
pub fn fault(fault: &Fault) -> String {
    match *fault {
        Fault::DriverLost { joint: j } => {
            format!("{} does not answer: check its cable and power", joint(j))
        }
        Fault::DriverReset { joint: j } => format!(
            "the driver of {} restarted: its zero is lost, home again",
            joint(j)
        ),
        Fault::DriverError { joint: j, bits } => {
            format!(
                "the driver of {} latched a hardware error (register 70 = {bits:#04x})",
                joint(j)
            )
        }
        Fault::EncoderJump { joint: j } => format!(
            "the encoder of {} jumped: check its plug, home again",
            joint(j)
        ),
        Fault::Stall { joint: j } => format!("{} is stalled: free it", joint(j)),
        Fault::EchoMismatch { joint: j } => format!(
            "the driver of {} applied another set-point than it was sent",
            joint(j)
        ),
        Fault::BusLost => {
            "the motor bus is unusable: a driver babbles or the line is stuck".to_owned()
        }
        Fault::Overrun => "control cycles were missed".to_owned(),
        Fault::LowBattery => "the battery is low: charge it".to_owned(),
        Fault::GaitCorrupt => "the running gait no longer matches its checksum".to_owned(),
        Fault::BadSetPoint => {
            "a set-point was not finite or left its limits; it was not sent".to_owned()
        }
        Fault::Internal => {
            "the module's own check failed: read `rb-host info` and report it".to_owned()
        }
    }
}

/// A refusal in words.
#[must_use]
pub fn reject(reason: &Reject) -> String {
    match reason {
        Reject::Version { theirs, ours } => {
            format!("it speaks protocol {ours}, this host {theirs}")
        }
        Reject::UnknownType { kind } => format!("it does not know message type {kind}"),
        Reject::Malformed => "the message was not readable".to_owned(),
        Reject::TrailingBytes => "the message was too long".to_owned(),
        Reject::OtherSession => {
            "the order belongs to an earlier boot or another session".to_owned()
        }
        Reject::BadTag => "the proof is wrong: this host has another key than the robot".to_owned(),
        Reject::NoChallenge => "no challenge was open".to_owned(),
        Reject::NoKey => "no key is set, so orders are taken on its wire port only".to_owned(),
        Reject::WirePortOnly => "this is taken on its wire port only".to_owned(),
        Reject::Busy => "it is still busy with an earlier order".to_owned(),
        Reject::State { state: s } => format!("not possible in state {}", state(*s)),
        Reject::NoSuchSlot { slots } => {
            format!("no such slot, it has 0 to {}", slots.saturating_sub(1))
        }
        Reject::SlotEmpty => "the slot is empty".to_owned(),
        Reject::SlotActive => "the slot is the active one".to_owned(),
        Reject::OtherGait { stored } => format!("the slot holds another gait ({})", hex(&stored.0)),
        Reject::Gait(gait) => gait_reject(gait),
        Reject::Duration { max_ms } => {
            format!("the run is too long or zero, at most {} s", max_ms / 1000)
        }
        Reject::Countdown { max_ms } => format!("the countdown is too long, at most {max_ms} ms"),
        Reject::NotHomed { missing_mask } => format!("not homed: joints {}", joints(*missing_mask)),
        Reject::MotorsMissing { missing_mask } => {
            format!("motors do not answer: joints {}", joints(*missing_mask))
        }
        Reject::Collision {
            body_a,
            body_b,
            clearance_um,
        } => format!(
            "bodies {body_a} and {body_b} would come within {:.1} mm",
            f64::from(*clearance_um) / 1000.0
        ),
        Reject::Battery {
            battery_mv,
            needed_mv,
        } => {
            format!(
                "battery at {:.2} V, {:.2} V needed",
                f64::from(*battery_mv) / 1e3,
                f64::from(*needed_mv) / 1e3
            )
        }
        Reject::Storage { fault } => format!("its flash failed ({fault:?})"),
        Reject::Latched(f) => format!("a fault is latched: {}", fault(f)),
        Reject::EStopLatched => "STOP is latched".to_owned(),
        Reject::NoFault => "there is no fault to clear".to_owned(),
        Reject::StopInputActive => "the STOP input is active".to_owned(),
        Reject::JointMask => "no joint chosen, or one that does not exist".to_owned(),
        Reject::NoSamples => "it keeps no samples from there on".to_owned(),
        Reject::BusOrder => "the bus order is empty or too long".to_owned(),
        Reject::Unsupported => "it cannot do that".to_owned(),
        Reject::Lease { min_ms, max_ms } => {
            format!("the lease is out of range, {min_ms} to {max_ms} ms")
        }
        Reject::NotTethered => "no tethered run is under way".to_owned(),
        Reject::NoEntropy => {
            "its random number generator failed the self-test, so it starts nothing".to_owned()
        }
        Reject::WrongDriver(wrong) => wrong_driver(wrong),
        Reject::TooManyTags { wait_ms } => {
            format!("too many wrong proofs came on this link; it looks at the next in {wait_ms} ms")
        }
        Reject::Held { link } => format!("another host holds it, on its link {link}"),
        Reject::Robot(RobotReject::JointCount { joints }) => {
            format!("a robot of {joints} motors; it drives 1 to {MAX_JOINTS}")
        }
        Reject::Robot(RobotReject::WrongCount { joints, expected }) => {
            format!("a robot of {joints} motors; one of this kind has {expected}")
        }
        Reject::Robot(RobotReject::Speed {
            joint: index,
            value_rad_s,
        }) => format!(
            "the no-load speed of {} is {value_rad_s} rad/s",
            joint(*index)
        ),
        Reject::ContactUnstated => CONTACT_UNSTATED.to_owned(),
    }
}

/// Why a robot that nobody checks for contact with itself does not run, and what to write.
pub const CONTACT_UNSTATED: &str = "nothing checks that the parts of this robot do not meet, and its robot.toml does not say that you know: \
     write `self_collision = \"unchecked\"` into it and tell the robot with `rb-host bus use robot.toml`";

/// What is wrong with a driver of another profile than the bus.
#[must_use]
pub fn wrong_driver(wrong: &WrongDriver) -> String {
    let who = joint(wrong.joint);
    match *wrong {
        WrongDriver {
            model, address: 0, ..
        } => format!("the driver of {who} is of another kind than the bus (model {model})"),
        WrongDriver { address, .. } => {
            format!("the driver of {who} does not take its setting at address {address}")
        }
    }
}

fn gait_reject(gait: &GaitReject) -> String {
    match *gait {
        GaitReject::OutOfRange {
            field,
            index,
            value,
            min,
            max,
        } => {
            format!("{field:?} of entry {index} is {value}, allowed {min} to {max}")
        }
        GaitReject::NoOscillators => "the gait has no oscillators".to_owned(),
        GaitReject::Name => "the gait's name is empty or not printable".to_owned(),
        GaitReject::SelfLink { link } => format!("link {link} joins an oscillator to itself"),
        GaitReject::LinkOutOfRange {
            link,
            oscillator,
            count,
        } => {
            format!("link {link} names oscillator {oscillator} of {count}")
        }
        GaitReject::DuplicateLink { link, earlier } => {
            format!("link {link} repeats link {earlier}")
        }
        GaitReject::JointCount {
            oscillators,
            joints,
        } => format!("{oscillators} oscillators for {joints} joints"),
        GaitReject::TooFast {
            joint: j,
            needed_rad_s,
            limit_rad_s,
        } => {
            format!(
                "{} would need {needed_rad_s:.3} rad/s of {limit_rad_s:.3}",
                joint(j)
            )
        }
    }
}

/// What to do about a refusal, where that is known.
#[must_use]
pub fn remedy(reason: &Reject) -> Option<&'static str> {
    Some(match reason {
        Reject::NotHomed { .. } => "place the robot in its home pose by hand, then `rb-host zero`",
        Reject::BadTag => {
            "copy the key file of this robot here, or set a new key over USB: `rb-host config key set`"
        }
        Reject::NoKey | Reject::WirePortOnly => {
            "connect by USB and set a key: `rb-host config key set`"
        }
        Reject::Latched(_) | Reject::EStopLatched => {
            "remove the cause, then `rb-host reset --fault`"
        }
        Reject::TooManyTags { .. } => {
            "somebody tries keys on this link: use the cable, or find out who is in radio range"
        }
        Reject::Held { .. } => "wait for it to end; `rb-host stop` stops the robot from here too",
        Reject::State { .. } | Reject::Busy => {
            "`rb-host stop` ends a run; `rb-host info` shows the state"
        }
        Reject::NoSuchSlot { .. } | Reject::SlotEmpty | Reject::SlotActive => {
            "`rb-host slots list` shows the slots; `sim:` forgets them between two commands (`rb-host run GAIT.toml` uploads and runs)"
        }
        Reject::MotorsMissing { .. } => "`rb-host bus scan` shows who answers",
        Reject::StopInputActive => "release the STOP button",
        Reject::WrongDriver(_) => {
            "`rb-host bus scan` shows the drivers; all of a bus are of one kind, set by `rb-host bus use`"
        }
        Reject::Battery { .. } => "charge the battery",
        Reject::Collision { .. } => {
            "move the robot by hand nearer to the start pose, or change the gait's offsets"
        }
        Reject::OtherGait { .. } => "upload the gait again",
        Reject::NoEntropy => "switch it off and on; if it stays, the chip is to be replaced",
        _ => return None,
    })
}

/// Why a run ended, as in `--json`.
#[must_use]
pub fn end_reason(reason: &EndReason) -> String {
    match reason {
        EndReason::Completed => "completed".to_owned(),
        EndReason::Stopped => "stopped".to_owned(),
        EndReason::StopInput => "stop_input".to_owned(),
        EndReason::ApproachBlocked => "approach_blocked".to_owned(),
        EndReason::ArmTimeout => "arm_timeout".to_owned(),
        EndReason::Fault(f) => format!("fault: {}", fault(f)),
        EndReason::HostLost => "host_lost".to_owned(),
    }
}

fn port_error(port: u8, fault: PortFault) -> String {
    let port = match port {
        2 => "motor bus".to_owned(),
        link => format!("host link {link}"),
    };
    let fault = match fault {
        PortFault::Overrun => "bytes were lost",
        PortFault::Noise => "framing, parity or noise error",
        PortFault::Closed => "the other side is gone",
    };
    format!("{port}: {fault}")
}

/// Stable short name of an event, and the event in words.
#[must_use]
pub fn event(event: &Event) -> (&'static str, String) {
    match &event.kind {
        EventKind::Boot { cause } => ("boot", format!("started, cause {}", reset_cause(*cause))),
        EventKind::State { from, to } => ("state", format!("{} -> {}", state(*from), state(*to))),
        EventKind::GaitStored { slot, digest } => (
            "gait_stored",
            format!("slot {slot}, digest {}", hex(&digest.0)),
        ),
        EventKind::SlotActivated { slot } => ("slot_activated", format!("slot {slot}")),
        EventKind::SlotErased { slot } => ("slot_erased", format!("slot {slot}")),
        EventKind::RunStarted { slot, digest } => (
            "run_started",
            format!("slot {slot}, digest {}", hex(&digest.0)),
        ),
        EventKind::RunEnded { reason } => ("run_ended", end_reason(reason)),
        EventKind::Fault(info) => (
            "fault",
            format!("{} (seen {} times)", fault(&info.fault), info.count),
        ),
        EventKind::FaultCleared => ("fault_cleared", String::new()),
        EventKind::Hold {
            body_a,
            body_b,
            clearance_um,
            ahead_ms,
        } => (
            "hold",
            format!(
                "bodies {body_a} and {body_b} would have {:.1} mm in {ahead_ms} ms",
                f64::from(*clearance_um) / 1000.0
            ),
        ),
        EventKind::HoldEnded { cycles } => ("hold_ended", format!("after {cycles} cycles")),
        EventKind::MotorLost { joint: j } => ("motor_lost", joint(*j)),
        EventKind::MotorFound { joint: j } => ("motor_found", joint(*j)),
        EventKind::MotorReset { joint: j } => ("motor_reset", joint(*j)),
        EventKind::MotorError { joint: j, bits } => {
            ("motor_error", format!("{}, bits {bits:#04x}", joint(*j)))
        }
        EventKind::Homed { mask } => ("homed", format!("joints {}", joints(*mask))),
        EventKind::Unhomed { mask } => ("unhomed", format!("joints {}", joints(*mask))),
        EventKind::Overrun { cycle_us } => ("overrun", format!("a cycle took {cycle_us} us")),
        EventKind::LinkSilent => (
            "link_silent",
            "the host is silent; the run goes on to its end".to_owned(),
        ),
        EventKind::LinkBack => ("link_back", "the host is back".to_owned()),
        EventKind::BadTag { request } => (
            "bad_tag",
            format!("an order of type {request} had a wrong proof"),
        ),
        EventKind::KeySet => ("key_set", String::new()),
        EventKind::BatteryLow { battery_mv } => (
            "battery_low",
            format!("{:.2} V", f64::from(*battery_mv) / 1e3),
        ),
        EventKind::SetpointMismatch {
            joint: j,
            sent_urad,
            applied_urad,
        } => (
            "setpoint_mismatch",
            format!(
                "{}: sent {:.6} rad, applied {:.6} rad",
                joint(*j),
                f64::from(*sent_urad) / 1e6,
                f64::from(*applied_urad) / 1e6
            ),
        ),
        EventKind::Stop { input } => (
            "stop",
            if *input { "STOP input" } else { "STOP order" }.to_owned(),
        ),
        EventKind::Repeated { count, first } => {
            ("repeated", format!("event {first} came {count} times more"))
        }
        EventKind::GaitChanged { slot, digest } => (
            "gait_changed",
            format!("slot {slot}, digest {}", hex(&digest.0)),
        ),
        EventKind::PortError { port, fault } => ("port_error", port_error(*port, *fault)),
        EventKind::WrongDriver(wrong) => ("wrong_driver", wrong_driver(wrong)),
        EventKind::DriversChanged { profile } => {
            ("drivers_changed", profile.info().title.to_owned())
        }
        EventKind::KeyReadable => (
            "key_readable",
            "a debug probe can read the key: set the readout protection".to_owned(),
        ),
        EventKind::RobotChanged { joints, contact } => (
            "robot_changed",
            format!("{joints} joints, {}", contact_words(*contact)),
        ),
    }
}
