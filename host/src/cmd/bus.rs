//! `rb-host bus`

use std::path::PathBuf;
use std::time::{Duration, Instant};

use protocol::bus::StatusError;
use protocol::bus::master::Request;
use protocol::bus::packet::TooLong;
use protocol::bus::table::{Access, Register, TABLE};
use serde_json::{Value, json};

use crate::bus_way::{BusWay, DriverAnswer};
use crate::cli::parse_duration;
use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;

/// Talk to the motor drivers, through the robot or over a USB-RS485 stick
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Serial port wired to the motor bus, instead of going through the robot
    #[arg(long, global = true, value_name = "PORT")]
    direct: Option<PathBuf>,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Find the drivers on the bus, ours and off-the-shelf servos, and propose their kind for robot.toml
    Scan,
    /// Tell the robot what it is, or which kind of drivers its bus carries; it keeps that, and every zero is lost
    Use {
        /// robot.toml: joints, their speeds, what of it may meet, [bus] driver = "..."; or only the kind of drivers: packed, xl330, xc330, xm430, sts, scs
        kind: String,
    },
    /// Ask one driver for its model and firmware
    Ping {
        /// Bus id, 1 to 252
        #[arg(value_parser = clap::value_parser!(u8).range(0..=252))]
        id: u8,
    },
    /// Read a register, or with `all` every register
    Read {
        /// Bus id
        #[arg(value_parser = clap::value_parser!(u8).range(0..=252))]
        id: u8,
        /// Name such as present-position, or address
        register: String,
    },
    /// Write a register; this can move the motor
    Write {
        /// Bus id
        #[arg(value_parser = clap::value_parser!(u8).range(0..=252))]
        id: u8,
        /// Name such as led, or address
        register: String,
        /// Value
        #[arg(allow_negative_numbers = true)]
        value: i32,
    },
    /// Show the registers
    Table,
    /// Read the feedback of all drivers again and again and count what fails
    Bench {
        /// How long
        #[arg(short, long, default_value = "2s", value_name = "TIME", value_parser = parse_duration)]
        duration: Duration,
        /// Bus ids; when not given those of the robot, over a stick 1 to 6
        #[arg(long, value_name = "ID")]
        id: Vec<u8>,
    },
}

/// Works on the motor bus.
///
/// # Errors
/// Exit codes 2, 4, 5, 7, 8.
pub fn run(args: &Args, context: &Context) -> Outcome {
    if let Action::Table = args.action {
        return table(context);
    }
    if let Action::Use { kind } = &args.action {
        return super::bus_kind::tell(context, kind);
    }
    let mut way = match (&args.direct, &args.action) {
        (Some(path), _) => BusWay::direct(path)?,
        (None, Action::Write { .. } | Action::Bench { .. }) => {
            BusWay::Robot(Box::new(context.connect_to_change()?))
        }
        (None, _) => BusWay::Robot(Box::new(context.connect()?)),
    };
    match &args.action {
        Action::Scan => super::bus_kind::scan(context, &mut way),
        Action::Ping { id } => ping(context, &mut way, *id),
        Action::Read { id, register } => read(context, &mut way, *id, register),
        Action::Write {
            id,
            register,
            value,
        } => write(context, &mut way, *id, register, *value),
        Action::Bench { duration, id } => bench(context, &mut way, *duration, id),
        Action::Table | Action::Use { .. } => Ok(()),
    }
}

pub(super) fn too_long(_: TooLong) -> Failure {
    Failure::say(Exit::Usage, "the request does not fit a bus packet")
}

/// Name and address as people write them: `present-position`, `Present Position` or `132`.
fn find_register(text: &str) -> Outcome<Register> {
    let plain = |s: &str| {
        s.chars()
            .filter(char::is_ascii_alphanumeric)
            .collect::<String>()
            .to_ascii_lowercase()
    };
    let by_address = text.parse().ok().and_then(Register::at);
    let by_name = || {
        TABLE
            .iter()
            .find(|info| plain(info.name) == plain(text))
            .map(|info| info.register)
    };
    by_address.or_else(by_name).ok_or_else(|| {
        Failure::say(Exit::Usage, format!("no register {text:?}"))
            .hint("`rb-host bus table` shows names and addresses")
    })
}

fn answer_of(way: &mut BusWay, id: u8, request: Request) -> Outcome<DriverAnswer> {
    let answers = way.exchange(request)?;
    let answer = answers.into_iter().find(|a| a.id == id).ok_or_else(|| {
        Failure::say(Exit::Link, format!("driver {id} does not answer"))
            .hint("check its power and cable; `rb-host bus scan` shows who answers")
    })?;
    match answer.error {
        None => Ok(answer),
        Some(error) => Err(Failure::say(
            Exit::Refused,
            format!("driver {id} refused: {}", error_words(error)),
        )),
    }
}

fn error_words(error: StatusError) -> String {
    format!("{error:?}").to_lowercase()
}

/// Model number and firmware version as a ping tells them.
pub(super) fn driver_row(answer: &DriverAnswer) -> (Value, String) {
    let model = answer
        .data
        .first_chunk::<2>()
        .map_or(0, |b| u16::from_le_bytes(*b));
    let version = answer.data.get(2).copied().unwrap_or(0);
    let alert = if answer.alert {
        ", HARDWARE ERROR (register 70)"
    } else {
        ""
    };
    (
        json!({ "id": answer.id, "model": model, "version": version, "alert": answer.alert }),
        format!(
            "id {:3}  model {model:#06x}  version {version}{alert}",
            answer.id
        ),
    )
}

fn ping(context: &Context, way: &mut BusWay, id: u8) -> Outcome {
    let answer = answer_of(way, id, Request::ping(id).map_err(too_long)?)?;
    let (value, line) = driver_row(&answer);
    context.out.result("rb.bus_ping/1", value, || line);
    Ok(())
}

fn read(context: &Context, way: &mut BusWay, id: u8, register: &str) -> Outcome {
    let registers: Vec<Register> = if register == "all" {
        TABLE.iter().map(|info| info.register).collect()
    } else {
        vec![find_register(register)?]
    };
    for register in registers {
        let request = Request::read(id, register.address(), register.size()).map_err(too_long)?;
        let answer = answer_of(way, id, request)?;
        let number = register.value_of(&answer.data);
        let info = register.info();
        let value =
            json!({ "id": id, "register": info.name, "address": info.address, "number": number });
        context.out.result("rb.bus_read/1", value, || {
            format!("{:5} {:24} {number}", info.address, info.name)
        });
    }
    Ok(())
}

fn write(context: &Context, way: &mut BusWay, id: u8, register: &str, value: i32) -> Outcome {
    let register = find_register(register)?;
    let info = register.info();
    if info.access == Access::Read {
        return Err(Failure::say(
            Exit::Usage,
            format!("{} is read only", info.name),
        ));
    }
    if value < info.min || value > info.max {
        let message = format!(
            "{} = {value} is out of range; allowed: {} to {}",
            info.name, info.min, info.max
        );
        return Err(Failure::say(Exit::Usage, message));
    }
    answer_of(
        way,
        id,
        Request::write(id, register, value).map_err(too_long)?,
    )?;
    let result =
        json!({ "id": id, "register": info.name, "address": info.address, "number": value });
    context.out.result("rb.bus_write/1", result, || {
        format!("{:5} {:24} {value}", info.address, info.name)
    });
    Ok(())
}

fn table(context: &Context) -> Outcome {
    let access = |a| match a {
        Access::Read => "read",
        Access::Eeprom => "eeprom",
        Access::Ram => "ram",
    };
    let rows: Vec<Value> = TABLE
        .iter()
        .map(|i| {
            json!({ "name": i.name, "address": i.address, "bytes": i.len, "access": access(i.access), "min": i.min,
                    "max": i.max, "default": i.default })
        })
        .collect();
    context
        .out
        .result("rb.bus_table/1", json!({ "registers": rows }), || {
            let line = |i: &protocol::bus::table::RegisterInfo| {
                format!(
                    "{:5} {:1} {:6} {:24} {} to {}",
                    i.address,
                    i.len,
                    access(i.access),
                    i.name,
                    i.min,
                    i.max
                )
            };
            TABLE.iter().map(line).collect::<Vec<_>>().join("\n")
        });
    Ok(())
}

fn bench(context: &Context, way: &mut BusWay, duration: Duration, ids: &[u8]) -> Outcome {
    let all: Vec<u8> = match way {
        BusWay::Robot(robot) => (1..=robot.machine()?.joints()).collect(),
        BusWay::Direct(_) => (1..=6).collect(),
    };
    let ids = if ids.is_empty() { &all } else { ids };
    let start = Instant::now();
    let (mut cycles, mut missing) = (0u32, 0u32);
    let mut trips = Vec::new();
    let _grace = interrupt::grace("stopping");
    let bar = context.out.progress(duration.as_secs(), "measuring");
    while start.elapsed() < duration && !interrupt::pressed() {
        let begin = Instant::now();
        let answers = way.exchange(Request::feedback(ids).map_err(too_long)?)?;
        trips.push(begin.elapsed());
        cycles += 1;
        bar.set_position(start.elapsed().as_secs());
        missing += u32::try_from(ids.len().saturating_sub(answers.len())).unwrap_or(0);
    }
    bar.finish_and_clear();
    trips.sort_unstable();
    let at = |share: f64| {
        let index = (trips.len().saturating_sub(1) as f64 * share) as usize;
        trips.get(index).copied().unwrap_or_default().as_secs_f64() * 1e3
    };
    let (median, worst) = (at(0.5), at(1.0));
    let value = json!({
        "cycles": cycles, "drivers": ids.len(), "missing_answers": missing, "median_ms": median, "worst_ms": worst,
    });
    context.out.result("rb.bus_bench/1", value, || {
        format!("{cycles} cycles of {} drivers, {missing} answers missing, median {median:.2} ms, worst {worst:.2} ms", ids.len())
    });
    if missing > 0 {
        return Err(Failure::say(
            Exit::Check,
            format!("{missing} answers missing"),
        ));
    }
    Ok(())
}
