//! `rb-host emulate`

#[path = "emulate_films.rs"]
pub(crate) mod films;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

#[cfg(unix)]
use hil_sim::endpoint::Pty;
use hil_sim::endpoint::{Endpoint, EndpointError, Serial, Tcp};
use hil_sim::pace::{self, Pace, ServeEvent};
use hil_sim::robot::serve::{RobotEvent, serve};
use hil_sim::scenario::Scenario;
use hil_sim::world::JointSetup;
use protocol::bus::Profile;
use serde_json::json;

use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::faults;
use crate::interrupt;
use crate::link::{EmulatedLab, sim};
use crate::recording::beside;
use crate::robot_file;

/// Serve emulated hardware to other programs until Ctrl-C, or film a drawn robot
///
/// `motors` plays six drivers on the RS485 bus, for a real board on a USB-RS485 stick or a Dynamixel client.
/// `robot` plays the whole robot, for any other program that speaks the link protocol, rb-host included.
/// `board` runs the firmware image itself in QEMU with emulated motors on its bus; its cable is served like `robot`'s.
/// `films` records gaits on a robot drawn at random and ends by itself.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Args {
    #[command(subcommand)]
    films: Option<Films>,
    /// What to emulate
    #[arg(value_enum, required = true)]
    what: Option<What>,
    /// Pseudo terminal with a link to it at this path
    #[arg(long, value_name = "LINK", group = "endpoint")]
    pty: Option<PathBuf>,
    /// TCP address to listen on, such as 127.0.0.1:5000 (port 0: any free one)
    #[arg(long, value_name = "ADDRESS", group = "endpoint")]
    tcp: Option<String>,
    /// Real serial port, such as a USB-RS485 stick
    #[arg(long, value_name = "PORT", group = "endpoint")]
    serial: Option<String>,
    /// Scenario file: motors, effects, faults
    #[arg(long, value_name = "FILE")]
    scenario: Option<PathBuf>,
    /// Robot of one to twelve motors, a robot.toml, each joint on a stand; the drivers are of the kind it names
    #[arg(long, value_name = "FILE", conflicts_with = "scenario")]
    robot: Option<PathBuf>,
    /// Faults, such as drop=0.01,corrupt=1e-4,stall@4-6:joint2
    #[arg(long = "inject", alias = "fault", value_name = "LIST")]
    fault: Option<String>,
    /// Kind of the motor drivers, or one for each joint: packed, xl330, xc330, xm430, sts, scs
    #[arg(long, value_name = "KIND", value_delimiter = ',', value_parser = driver_kind)]
    drivers: Vec<Profile>,
    /// Seed of all chance
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Motors: answer after the time the wire takes, or at once
    #[arg(long, value_enum, default_value = "real")]
    pace: PaceArg,
    /// Robot: folder for the film and track.csv of the scenario's camera and tracker, on the camera's own clock, written at the end
    #[arg(long, value_name = "DIR")]
    film: Option<PathBuf>,
    /// Board: the firmware image [default: built, in the workspace]
    #[arg(long, value_name = "FILE", requires = "plugin")]
    elf: Option<PathBuf>,
    /// Board: the QEMU plugin [default: built, in the workspace]
    #[arg(long, value_name = "FILE", requires = "elf")]
    plugin: Option<PathBuf>,
}

#[derive(Debug, clap::Subcommand)]
enum Films {
    Films(films::FilmsArgs),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum What {
    Motors,
    Robot,
    Board,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum PaceArg {
    Real,
    Prompt,
}

/// Baud rates of the two wires on a real serial port.
const BUS_BAUD: u32 = 1_000_000;

/// Serves until Ctrl-C.
///
/// # Errors
/// Exit codes 2, 3, 4.
pub fn run(args: &Args, context: &Context) -> Outcome {
    if let Some(Films::Films(films)) = &args.films {
        return films::run(films, context);
    }
    let mut scenario = match &args.robot {
        Some(path) => of_robot(path)?,
        None => sim::load_scenario(args.scenario.as_deref())?,
    };
    if let Some(seed) = args.seed {
        scenario.world.seed = seed;
    }
    equip(&mut scenario.world.joints, &args.drivers)?;
    if let Some(list) = &args.fault {
        let faults =
            faults::parse(list).map_err(|e| Failure::new(Exit::Usage, anyhow::Error::new(e)))?;
        scenario.world.faults.extend(faults);
    }
    let mut endpoint = endpoint(args, context).map_err(endpoint_failed)?;
    let _grace = interrupt::grace("stopping");
    match args.what {
        Some(What::Motors) => motors(args, context, &scenario, endpoint.as_mut()),
        Some(What::Robot) | None => robot(args, context, &scenario, endpoint.as_mut()),
        Some(What::Board) => board(args, context, &scenario, endpoint.as_mut()),
    }
}

/// The robot of a file on drivers of the kind that it names.
fn of_robot(path: &Path) -> Outcome<Scenario> {
    let structure = robot_file::structure(path)?;
    let shown = path.display().to_string();
    let mut scenario = sim::robot_scenario(&shown, &structure)?;
    equip(&mut scenario.world.joints, structure.driver.as_slice())?;
    Ok(scenario)
}

fn driver_kind(name: &str) -> Result<Profile, String> {
    Profile::from_name(name).ok_or_else(|| {
        let known = Profile::ALL.map(|profile| profile.info().name).join(", ");
        format!("known: {known}")
    })
}

/// One kind for all joints, or one for each.
fn equip(joints: &mut [JointSetup], kinds: &[Profile]) -> Outcome {
    if kinds.len() > 1 && kinds.len() != joints.len() {
        let message = format!(
            "--drivers names {} kinds for {} joints",
            kinds.len(),
            joints.len()
        );
        return Err(Failure::say(Exit::Usage, message).hint("name one kind, or one for each joint"));
    }
    for (index, joint) in joints.iter_mut().enumerate() {
        if let Some(kind) = kinds.get(index).or(kinds.first()) {
            joint.driver.profile = *kind;
        }
    }
    Ok(())
}

fn endpoint(args: &Args, context: &Context) -> Result<Box<dyn Endpoint>, EndpointError> {
    if let Some(address) = &args.tcp {
        return Ok(Box::new(Tcp::listen(address)?));
    }
    if let Some(port) = &args.serial {
        let baud = if args.what == Some(What::Motors) {
            BUS_BAUD
        } else {
            context.baud()
        };
        return Ok(Box::new(Serial::open(port, baud)?));
    }
    pty(args)
}

#[cfg(unix)]
fn pty(args: &Args) -> Result<Box<dyn Endpoint>, EndpointError> {
    Ok(Box::new(Pty::open(args.pty.as_deref())?))
}

#[cfg(not(unix))]
fn pty(_args: &Args) -> Result<Box<dyn Endpoint>, EndpointError> {
    Err(EndpointError::NoPty)
}

fn endpoint_failed(error: EndpointError) -> Failure {
    Failure::new(Exit::Port, error)
}

fn ready(context: &Context, address: &str) {
    context
        .out
        .result("rb.emulate/1", json!({ "address": address }), || {
            format!("ready on {address}")
        });
    context.out.say("Ctrl-C ends it");
}

fn go_on() -> ControlFlow<()> {
    if interrupt::pressed() {
        ControlFlow::Break(())
    } else {
        ControlFlow::Continue(())
    }
}

fn motors(
    args: &Args,
    context: &Context,
    scenario: &Scenario,
    endpoint: &mut dyn Endpoint,
) -> Outcome {
    let mut world = scenario
        .build()
        .map_err(|e| Failure::new(Exit::BadFile, anyhow::Error::new(e)))?;
    let pace = match args.pace {
        PaceArg::Real => Pace::Real,
        PaceArg::Prompt => Pace::Prompt,
    };
    let mut last = None;
    pace::serve(&mut world, endpoint, pace, &mut |event| {
        match event {
            ServeEvent::Ready { address } => ready(context, address),
            ServeEvent::Status { .. } => last = Some(event.clone()),
        }
        go_on()
    })
    .map_err(endpoint_failed)?;
    if let Some(ServeEvent::Status {
        virtual_s,
        behind_s,
        faults,
        clients,
        ..
    }) = last
    {
        context.out.say(format_args!(
            "{virtual_s:.1} s served to {clients} clients, {behind_s:.1} s left out"
        ));
        for fault in faults {
            context.out.say(format_args!(
                "fault {} struck {} times",
                fault.name, fault.count
            ));
        }
    }
    Ok(())
}

fn robot(
    args: &Args,
    context: &Context,
    scenario: &Scenario,
    endpoint: &mut dyn Endpoint,
) -> Outcome {
    if args.film.is_some() && scenario.lab.camera.is_none() {
        return Err(
            Failure::say(Exit::Usage, "--film: no camera stands beside this robot")
                .hint("give a scenario with body = \"ground\" and a [camera] table"),
        );
    }
    if let Some(folder) = &args.film {
        // Before anyone works for an hour.
        disk::begin(folder)?;
    }
    let mut robot = sim::robot_of(scenario)?;
    let mut last = None;
    serve(&mut robot, endpoint, &mut |event| {
        match event {
            RobotEvent::Ready { address } => ready(context, address),
            RobotEvent::Status { .. } => last = Some(event.clone()),
        }
        go_on()
    })
    .map_err(endpoint_failed)?;
    if let (Some(folder), Some(lab)) = (&args.film, EmulatedLab::beside(&robot)) {
        let mut names = lab.seen.film.names("");
        names.push("track.csv".to_owned());
        disk::claim(folder, &names)?;
        lab.seen.film.write_into(folder)?;
        let track = beside::track_csv(&lab.seen.base);
        disk::write(&folder.join("track.csv"), track.as_bytes())?;
        disk::finish(folder)?;
        let (frames, folder) = (lab.seen.film.frames.len(), folder.display());
        context.out.say(format_args!(
            "{frames} frames in {folder}, on the camera's clock"
        ));
    }
    if let Some(RobotEvent::Status {
        virtual_s,
        behind_s,
        resets,
        lost_bytes,
        clients,
    }) = last
    {
        context.out.say(format_args!(
            "{virtual_s:.1} s served to {clients} clients, {behind_s:.1} s left out, {resets} resets"
        ));
        if lost_bytes > 0 {
            context.out.say(format_args!(
                "{lost_bytes} bytes of clients lost: they came faster than the line of the robot carries them"
            ));
        }
    }
    Ok(())
}

#[cfg(unix)]
fn board(
    args: &Args,
    context: &Context,
    scenario: &Scenario,
    endpoint: &mut dyn Endpoint,
) -> Outcome {
    use hil_sim::board::peer::Motors;
    use hil_sim::board::runner::BoardRunner;
    use hil_sim::board::serve::{BoardEvent, serve};
    use hil_sim::board::tools::{self, Built};

    let other = |error: anyhow::Error| Failure::new(Exit::Other, error);
    let built = match (&args.elf, &args.plugin) {
        (Some(elf), Some(plugin)) => Built {
            qemu: tools::find_qemu().map_err(|e| other(e.into()))?,
            elf: elf.clone(),
            plugin: plugin.clone(),
        },
        _ => {
            context
                .out
                .say("building the firmware image and the QEMU plugin");
            let here = std::env::current_dir().map_err(|e| other(e.into()))?;
            tools::build(&here).map_err(|e| other(e.into()))?
        }
    };
    let world = scenario
        .build()
        .map_err(|e| Failure::new(Exit::BadFile, anyhow::Error::new(e)))?;
    let mut config = built.config();
    config.seed = scenario.world.seed;
    let mut board = BoardRunner::start(&config, Motors::new(world)).map_err(|e| other(e.into()))?;
    let mut last = None;
    serve(&mut board, endpoint, &mut |event| {
        match event {
            BoardEvent::Ready { address } => ready(context, address),
            BoardEvent::Status { .. } => last = Some(event.clone()),
        }
        go_on()
    })
    .map_err(|e| other(e.into()))?;
    if let Some(BoardEvent::Status {
        guest_s,
        behind_s,
        clients,
    }) = last
    {
        context.out.say(format_args!(
            "{guest_s:.1} s of guest time served to {clients} clients, {behind_s:.1} s left out"
        ));
    }
    Ok(())
}

#[cfg(not(unix))]
fn board(
    _args: &Args,
    _context: &Context,
    _scenario: &Scenario,
    _endpoint: &mut dyn Endpoint,
) -> Outcome {
    Err(Failure::new(
        Exit::Other,
        anyhow::anyhow!("QEMU runs the board on Unix only"),
    ))
}
