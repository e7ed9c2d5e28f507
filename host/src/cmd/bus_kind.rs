//! Which kind of drivers a bus carries: `rb-host bus scan` proposes it, `rb-host bus use` tells the robot.

use std::path::Path;
use std::time::{Duration, Instant};

use control::machine::{Contact, Machine};
use protocol::bus::master::Request;
use protocol::bus::packet::BROADCAST;
use protocol::bus::{Framing, Profile};
use protocol::link::{FromModule, Tag, ToModule, WireContact, WireRobot};
use serde_json::{Value, json};

use super::bus::{driver_row, too_long};
use crate::bus_way::BusWay;
use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::link::{LinkError, Robot, text};
use crate::robot_file;

/// Ids of a robot's drivers, twelve at most, asked one by one: Feetech servos have no broadcast ping, and Dynamixel ones with different return
/// delays talk at once after it.
const ROBOT_IDS: std::ops::RangeInclusive<u8> = 1..=12;
/// A driver takes its settings one by one: this long at most.
const SETTLED: Duration = Duration::from_secs(4);

/// A driver found on the bus.
struct Found {
    id: u8,
    profile: Option<Profile>,
    value: Value,
    line: String,
}

/// Finds drivers of every framing and proposes their kind.
pub(super) fn scan(context: &Context, way: &mut BusWay) -> Outcome {
    let mut found = dynamixel(way)?;
    found.extend(feetech(way)?);
    let kind = kind_of(&found);
    let values: Vec<&Value> = found.iter().map(|driver| &driver.value).collect();
    let name = kind.as_ref().ok().map(|profile| profile.info().name);
    let result = json!({ "drivers": values, "driver": name });
    context.out.result("rb.bus_scan/1", result, || {
        let mut lines: Vec<String> = found.iter().map(|driver| driver.line.clone()).collect();
        lines.extend(name.map(proposal));
        if lines.is_empty() {
            "no driver answers".to_owned()
        } else {
            lines.join("\n")
        }
    });
    if found.is_empty() {
        return Err(Failure::say(Exit::Link, "no driver answers")
            .hint("check motor power, A/B wires and termination"));
    }
    kind.map(|_| ())
}

fn proposal(name: &str) -> String {
    format!("robot.toml:\n[bus]\ndriver = \"{name}\"\ntell the robot: rb-host bus use {name}")
}

/// The one kind of all drivers.
fn kind_of(found: &[Found]) -> Outcome<Profile> {
    if let Some(stranger) = found.iter().find(|driver| driver.profile.is_none()) {
        let message = format!(
            "driver {} is of a kind that the robot does not drive",
            stranger.id
        );
        return Err(Failure::say(Exit::Check, message));
    }
    let mut kinds: Vec<(Profile, Vec<String>)> = Vec::new();
    for driver in found {
        let Some(profile) = driver.profile else {
            continue;
        };
        match kinds.iter_mut().find(|(kind, _)| *kind == profile) {
            Some((_, ids)) => ids.push(driver.id.to_string()),
            None => kinds.push((profile, vec![driver.id.to_string()])),
        }
    }
    match kinds.as_slice() {
        [(only, _)] => Ok(*only),
        several => {
            let kinds: Vec<String> = several
                .iter()
                .map(|(kind, ids)| format!("{} ({})", kind.info().name, ids.join(", ")))
                .collect();
            let message = format!("the bus is mixed: {}", kinds.join(", "));
            Err(Failure::say(Exit::Check, message)
                .hint("a robot drives one kind; exchange the others"))
        }
    }
}

fn dynamixel(way: &mut BusWay) -> Outcome<Vec<Found>> {
    let mut answers = way.exchange(Request::ping(BROADCAST).map_err(too_long)?)?;
    for id in ROBOT_IDS {
        if answers.iter().all(|answer| answer.id != id) {
            answers.extend(way.exchange(Request::ping(id).map_err(too_long)?)?);
        }
    }
    answers.sort_by_key(|answer| answer.id);
    let found = answers.iter().map(|answer| {
        let model = answer
            .data
            .first_chunk::<2>()
            .map_or(0, |bytes| u16::from_le_bytes(*bytes));
        let profile = Profile::of_model(Framing::Dynamixel2, model);
        let (mut value, line) = driver_row(answer);
        value["driver"] = json!(profile.map(|profile| profile.info().name));
        Found {
            id: answer.id,
            profile,
            value,
            line: with_kind(line, profile),
        }
    });
    Ok(found.collect())
}

fn feetech(way: &mut BusWay) -> Outcome<Vec<Found>> {
    let mut found = Vec::new();
    for id in ROBOT_IDS {
        // The same place in both series; only the order of the bytes differs.
        let info = Profile::Sts.info();
        let request = info.read_field(id, &info.model).map_err(too_long)?;
        let answers = way.exchange(request)?;
        let Some(answer) = answers.first() else {
            continue;
        };
        let models = [Profile::Sts, Profile::Scs].map(|profile| {
            let info = profile.info();
            let model = info.model.value_of(&answer.data) as u16;
            (model, info.models.contains(&model).then_some(profile))
        });
        let known = models.iter().find(|(_, profile)| profile.is_some());
        let (model, profile) = known.copied().unwrap_or(models[0]);
        found.push(Found {
            id,
            profile,
            value: json!({
                "id": id, "model": model, "alert": answer.alert,
                "driver": profile.map(|profile| profile.info().name),
            }),
            line: with_kind(format!("id {id:3}  model {model:#06x}"), profile),
        });
    }
    Ok(found)
}

fn with_kind(line: String, profile: Option<Profile>) -> String {
    let title = profile.map_or("unknown", |profile| profile.info().title);
    format!("{line}  {title}")
}

/// What the robot is told.
struct Told {
    profile: Profile,
    /// Without one the robot stays the one it is.
    machine: Option<Machine>,
}

/// Tells the robot what it is and the kind of its drivers, and waits until they have their settings.
pub(super) fn tell(context: &Context, kind: &str) -> Outcome {
    let told = read_kind(kind)?;
    let mut robot = context.connect_to_change()?;
    let tag = Tag::NONE;
    if let Some(machine) = &told.machine {
        let robot_told = WireRobot::from(machine);
        robot.order(&ToModule::SetRobot {
            robot: robot_told,
            tag,
        })?;
        if *machine.contact() == Contact::Unstated {
            context.out.warn(text::CONTACT_UNSTATED);
        }
    }
    let profile = told.profile;
    robot.order(&ToModule::SetDrivers { profile, tag })?;
    let machine = robot.machine()?;
    let mut wrong = drivers(&mut robot)?;
    let begin = Instant::now();
    let mut present = 0;
    let joints = machine.joints();
    while wrong.is_empty() && present != machine.all_joints() && begin.elapsed() < SETTLED {
        std::thread::sleep(Duration::from_millis(200));
        present = robot.info()?.motor_mask;
        wrong = drivers(&mut robot)?;
    }
    let contact = WireContact::from(machine.contact());
    let value = json!({
        "driver": profile.info().name, "joints": joints, "contact": text::contact_name(contact), "motor_mask": present,
        "wrong": wrong,
    });
    context.out.result("rb.bus_use/1", value, || {
        let answering = text::joints(present);
        format!(
            "robot: {joints} joints, {}\ndrivers: {}\nanswering: {answering}\nzero them: rb-host zero",
            text::contact_words(contact),
            profile.info().title
        )
    });
    match wrong.first() {
        None => Ok(()),
        Some(first) => Err(Failure::say(Exit::Check, first.clone())
            .hint("`rb-host bus scan` shows every driver; all of a bus must be of one kind")),
    }
}

/// What is wrong with the drivers, a line each.
fn drivers(robot: &mut Robot) -> Outcome<Vec<String>> {
    match robot.ask(&ToModule::GetDrivers)? {
        FromModule::Drivers { wrong, .. } => Ok(wrong.iter().map(text::wrong_driver).collect()),
        _ => Err(LinkError::WrongAnswer { request: "drivers" }.into()),
    }
}

/// A kind by its name, or robot and kind from a robot.toml.
fn read_kind(kind: &str) -> Outcome<Told> {
    if let Some(profile) = Profile::from_name(kind) {
        return Ok(Told {
            profile,
            machine: None,
        });
    }
    let names = Profile::ALL.map(|profile| profile.info().name).join(", ");
    if !kind.contains('.') && !Path::new(kind).exists() {
        return Err(Failure::say(
            Exit::Usage,
            format!("{kind:?} is no kind of driver; known: {names}, or a robot.toml"),
        ));
    }
    let structure = robot_file::structure(Path::new(kind))?;
    let profile = structure.driver.ok_or_else(|| {
        Failure::say(Exit::BadFile, format!("{kind} does not name its drivers"))
            .hint(format!("add [bus] driver = \"...\", one of {names}"))
    })?;
    Ok(Told {
        profile,
        machine: Some(robot_file::machine_of(Path::new(kind), &structure)?),
    })
}
