//! `rb-host hybrid`

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::hybrid::settings::HybridSettings;
use crate::hybrid::{Beginning, Hybrid, ROBOT, Step};
use crate::interrupt;
use crate::link::PortUri;
use crate::settings::Key;

/// The whole hybrid cycle: search gaits, run them on the robot, match the model to the films, simulate again, next cycle
///
/// The robot is an emulated one, drawn at random inside the ranges of Table II, unless --scenario or --port names another.
/// Every step can be interrupted and goes on with --resume to the same bytes. At the end: tables, overlays and the time account.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder for everything
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Settings (hybrid.toml); absent values are the paper's
    #[arg(
        long,
        short_alias = 's',
        value_name = "FILE",
        conflicts_with = "resume"
    )]
    settings: Option<PathBuf>,
    /// Nominal model; the shipped hand-tuned model when absent
    #[arg(short, long, value_name = "FILE", conflicts_with = "resume")]
    model: Option<PathBuf>,
    /// Emulated robot: a scenario with `body = "ground"`, a camera and a tracker
    #[arg(long, alias = "robot", value_name = "FILE", conflicts_with = "resume")]
    scenario: Option<PathBuf>,
    /// Emulated robot: drawn inside the ranges of Table II with this seed [default: 1]
    #[arg(long, value_name = "N", conflicts_with_all = ["resume", "scenario"])]
    robot_seed: Option<u64>,
    /// Real robot: file with the `[camera]` table of its camera; a Kinect over the origin when absent
    #[arg(
        long = "camera-file",
        alias = "camera",
        value_name = "FILE",
        conflicts_with = "resume"
    )]
    camera: Option<PathBuf>,
    /// Real robot: slot whose gait may be replaced
    #[arg(long, value_name = "SLOT", conflicts_with = "resume")]
    slot: Option<u8>,
    /// Cycles in all; with --resume more can be added
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    cycles: u32,
    /// Go on with what is in the folder
    #[arg(long)]
    resume: bool,
    /// Stop after this step of the present cycle
    #[arg(long, value_enum, value_name = "STEP")]
    until: Option<Step>,
    /// Threads; the result does not depend on it [default: all cores]
    #[arg(short = 'j', long, value_name = "N")]
    threads: Option<usize>,
}

/// Runs the cycles.
///
/// # Errors
/// Exit codes of its steps; 1 when films of a real robot are missing, 130 when interrupted.
pub fn run(args: &Args, context: &Context) -> Outcome {
    let port = context.settings.get(Key::Port).value;
    let _grace = interrupt::grace("stopping; what is done stays in the folder");
    let mut hybrid = if args.resume {
        let mut hybrid = Hybrid::resume(context, &args.output)?;
        if !port.is_empty() && port != "sim:" {
            hybrid.set_port(&port);
        }
        hybrid
    } else {
        Hybrid::begin(context, &args.output, &beginning(args, context, port)?)?
    };
    hybrid.set_threads(args.threads);
    hybrid.run(args.cycles, args.until)
}

fn beginning(args: &Args, context: &Context, port: String) -> Outcome<Beginning> {
    let settings = HybridSettings::load(args.settings.as_deref())?;
    let model = crate::model_file::load(args.model.as_deref())?;
    let camera = args.camera.as_deref().map(read_camera).transpose()?;
    let port = match &args.scenario {
        Some(scenario) => PortUri::Sim(Some(scenario.clone())).to_string(),
        None => port,
    };
    // The drawn robot is what `sim:` means here: the plain one has neither camera nor tracker.
    let drawn = port.is_empty() || port == "sim:";
    let named = !port.is_empty() || args.robot_seed.is_some();
    if drawn && !named && !std::io::stdin().is_terminal() {
        let message = "no robot was named, and a command that moves or records takes the emulated one only when it is named";
        return Err(Failure::say(Exit::Usage, message)
            .hint("give -p sim: (or --robot-seed 1) for an emulated robot, or name the robot's port with -p"));
    }
    let robot_seed = args.robot_seed.unwrap_or(1);
    let uri = if drawn {
        let scenario = super::emulate::films::draw(&args.output.join(ROBOT), robot_seed)?;
        context.out.say(format_args!(
            "the robot is an EMULATED one, drawn with seed {robot_seed}: {}",
            scenario.display()
        ));
        PortUri::Sim(Some(scenario))
    } else {
        port.parse()
            .map_err(|e| Failure::new(Exit::Usage, anyhow::Error::new(e)))?
    };
    if !uri.is_sim() && args.slot.is_none() {
        let message = format!("{port}: every gait of the cycle goes into one slot of the robot");
        return Err(Failure::say(Exit::Usage, message)
            .hint("name one whose gait may be replaced with --slot; `rb-host slots` shows them"));
    }
    if let PortUri::Sim(path) = &uri {
        let scenario = crate::link::sim::load_scenario(path.as_deref())?;
        if scenario.lab.camera.is_none() || scenario.lab.tracker.is_none() {
            let message = format!("{uri}: the emulated robot has no camera and tracker beside it");
            return Err(Failure::say(Exit::Usage, message)
                .hint("give a scenario with body = \"ground\", [camera] and [tracker], or leave --port and --scenario away"));
        }
    }
    Ok(Beginning {
        settings,
        model,
        port: if drawn { String::new() } else { port },
        camera: camera.unwrap_or_default(),
        slot: args.slot,
    })
}

/// A `[camera]` table, checked by the reader of data sets.
fn read_camera(path: &Path) -> Outcome<String> {
    let shown = path.display().to_string();
    let text = disk::read_text(path, disk::MAX_TEXT)
        .map_err(|e| Failure::say(Exit::BadFile, format!("{shown}: {e}")))?;
    let whole = format!("{text}\n[[run]]\nfile = \"x.csv\"\n");
    let head = "format = 1\nrobot = \"metamodule\"\n";
    files::dataset::Manifest::parse(&shown, &(head.to_owned() + &whole))
        .map_err(|e| Failure::new(Exit::BadFile, e))?;
    Ok(format!("\n{text}"))
}
