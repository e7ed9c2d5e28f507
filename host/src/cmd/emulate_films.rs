//! `rb-host emulate films`

use std::path::{Path, PathBuf};
use std::time::Duration;

use control::gait::Gait;
use files::dataset::Role;
use files::model::Model;
use hil_sim::drawn;
use serde_json::{Value, json};

use crate::cli::parse_duration;
use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;
use crate::link::PortUri;
use crate::takes::{self, Take};

/// Record gaits on a robot drawn at random inside the ranges of Table II, through firmware and link, with its films: a data set whose truth stands apart
#[derive(Debug, clap::Args)]
pub(super) struct FilmsArgs {
    /// Gait files
    #[arg(required = true, value_name = "GAIT.toml")]
    gaits: Vec<PathBuf>,
    /// Seed of the robot and of all chance
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// A robot of your own instead of a drawn one: a scenario with `body = "ground"` and a camera
    #[arg(long, alias = "robot", value_name = "FILE", conflicts_with = "seed")]
    scenario: Option<PathBuf>,
    /// Data set folder to write; one that holds runs already is completed
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Folder for the drawn robot, kept out of the data set [default: DIR-truth]
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,
    /// Runs per gait
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    repeat: u32,
    /// Length of each run [default: as the gait says]
    #[arg(short, long, value_name = "TIME", value_parser = parse_duration)]
    duration: Option<Duration>,
    /// Gaits whose runs get the role "fit"; the others get "check". Without it no run gets a role
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    training: Vec<String>,
}

/// Samples per second of the motors.
const TELEMETRY_HZ: u32 = 20;
/// Names in the folder of the truth.
pub(crate) const SCENARIO: &str = "scenario.toml";
/// See [`SCENARIO`].
const ROBOT: &str = "robot.toml";

/// Records.
pub(super) fn run(args: &FilmsArgs, context: &Context) -> Outcome {
    let gaits = args
        .gaits
        .iter()
        .map(|path| crate::gait_file::load(path))
        .collect::<Outcome<Vec<Gait>>>()?;
    let scenario = match &args.scenario {
        Some(path) => path.clone(),
        None => {
            let beside = || {
                let mut name = args.output.clone().into_os_string();
                name.push("-truth");
                PathBuf::from(name)
            };
            draw(&args.truth.clone().unwrap_or_else(beside), args.seed)?
        }
    };
    let uri = PortUri::Sim(Some(scenario.clone()));
    let model = Model::hand_tuned();
    let set = takes::open_set(&args.output, "emulated robot", &model.to_toml(), &uri)?;
    let known = set.runs()?;
    let _grace = interrupt::grace("stopping in this run; the runs before it are in the data set");
    let bar = context
        .out
        .progress(gaits.len() as u64 * u64::from(args.repeat), "recording");
    let mut rows = Vec::new();
    let (mut kept, mut robot_s) = (0, 0.0);
    for gait in &gaits {
        for number in 1..=args.repeat {
            bar.inc(1);
            let take = plan(args, gait, number);
            if known.contains(&take.name) {
                continue;
            }
            if interrupt::pressed() {
                bar.finish_and_clear();
                let message = "stopped; the runs recorded so far are in the data set";
                return Err(Failure::say(Exit::Interrupted, message)
                    .hint("the same command records the rest"));
            }
            let taken = takes::take(context, &uri, &set, &take)?;
            context.out.say(takes::line(&take, &taken));
            kept += u32::from(taken.is_kept());
            robot_s += taken.robot_time.as_secs_f64();
            rows.push(row(&take, &taken));
        }
    }
    bar.finish_and_clear();
    let value = json!({ "dataset": args.output, "robot": scenario, "robot_s": robot_s, "runs": Value::from(rows) });
    context.out.result("rb.emulate_films/1", value, || {
        format!(
            "{kept} runs, {robot_s:.0} s of robot time, in {}; the robot is {}",
            args.output.display(),
            scenario.display()
        )
    });
    Ok(())
}

/// Draws a robot and writes its model and scenario; returns the scenario. A folder that holds one already is left as it is.
///
/// # Errors
/// Exit code 1 when the disk refuses.
pub(crate) fn draw(folder: &Path, seed: u64) -> Outcome<PathBuf> {
    let path = folder.join(SCENARIO);
    if path.exists() {
        return Ok(path);
    }
    disk::make_folder(folder)?;
    let model = drawn::model(seed);
    disk::write(&folder.join(ROBOT), model.to_toml().as_bytes())?;
    let scenario = drawn::scenario_toml(&model, ROBOT, seed);
    disk::write(&path, scenario.as_bytes())?;
    Ok(path)
}

fn plan(args: &FilmsArgs, gait: &Gait, number: u32) -> Take {
    let role = match args.training.as_slice() {
        [] => None,
        names if names.iter().any(|name| name == gait.name()) => Some(Role::Fit),
        _ => Some(Role::Check),
    };
    Take {
        name: takes::name(gait, number),
        gait: gait.clone(),
        role,
        duration: args
            .duration
            .unwrap_or_else(|| Duration::from_secs_f32(gait.duration_s())),
        autonomous: false,
        rate_hz: TELEMETRY_HZ,
        slot: None,
        start_m: [0.0; 2],
        filmed: true,
    }
}

fn row(take: &Take, taken: &takes::Taken) -> Value {
    let alignment = taken.laid.as_ref().and_then(|laid| laid.alignment);
    json!({
        "name": take.name, "gait": take.gait.name(), "kept": taken.is_kept(), "reason": taken.report.end.reason,
        "holds": taken.report.end.holds, "frames": taken.laid.as_ref().map(|laid| laid.film.frames.len()),
        "tracking_rms_rad": taken.report.tracking_rms_rad,
        "clock_offset_s": alignment.map(|a| a.offset_s), "correlation": alignment.map(|a| a.correlation),
    })
}
