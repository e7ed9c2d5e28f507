//! `rb-host run`

use std::path::{Path, PathBuf};
use std::time::Duration;

use control::gait::Gait;
use control::machine::Machine;
use files::dataset::Role;
use files::model::Model;
use protocol::link::{Digest, EndReason, ModuleState};
use serde_json::{Value, json};

use crate::cli::parse_duration;
use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::gait_file;
use crate::link::{PortUri, Robot, text};
use crate::runner::{self, Change, Order, RunReport};
use crate::settings::Key;
use crate::takes::{self, Take, open_recording};
use crate::upload::{self, Options};

/// Run a gait on the robot and record it; Ctrl-C stops the robot
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Gait file, uploaded first
    gait: Option<PathBuf>,
    /// Slot: with a gait file where to store it, alone what to run
    #[arg(short, long, value_name = "SLOT")]
    slot: Option<u8>,
    /// Length of each run, such as 30s; default: the gait's own
    #[arg(short, long, value_name = "TIME", value_parser = parse_duration)]
    duration: Option<Duration>,
    /// Number of runs
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeat: u32,
    /// Recording to write (MCAP)
    #[arg(short, long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Replace an existing recording
    #[arg(long)]
    force: bool,
    /// Add each run to this data set folder: gait, recording, CSV, and the film and base pose of an emulated camera
    #[arg(long, value_name = "DIR", conflicts_with_all = ["record", "countdown"], requires = "gait")]
    dataset: Option<PathBuf>,
    /// Use of the runs in the data set
    #[arg(long, value_enum, requires = "dataset")]
    role: Option<RoleArg>,
    /// Samples per second, 20 or 100 [default: setting telemetry_hz]
    #[arg(long, value_name = "HZ", value_parser = ["20", "100"])]
    rate: Option<String>,
    /// Wait before the first movement
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    countdown: Option<Duration>,
    /// Let the robot run to its end when this computer or the link is gone; else it stops within a second. `sim:` always does
    #[arg(long)]
    autonomous: bool,
    /// Gait file that takes over in mid-run, smoothly; uploaded first
    #[arg(
        long,
        value_name = "GAIT",
        requires = "after",
        conflicts_with = "dataset"
    )]
    then: Option<PathBuf>,
    /// When it takes over, from the first step of the gait; the robot plans one second ahead
    #[arg(long, value_name = "TIME", requires = "then", value_parser = parse_duration)]
    after: Option<Duration>,
    /// Attach this model file to the recording
    #[arg(short, long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Leave the check of the gait to the robot
    #[arg(long)]
    skip_host_check: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum RoleArg {
    /// May be fitted
    Fit,
    /// Held out
    Check,
}

const NO_GAIT: &str = "give a gait file to run, or with --slot (-s) a slot of the robot";
/// Longest wait for the robot to come to rest between two runs.
const REST: Duration = Duration::from_secs(10);

/// Runs and records.
///
/// # Errors
/// Exit codes 1, 3, 4, 5, 6, 7, 130.
pub fn run(args: &Args, context: &Context) -> Outcome {
    if args.gait.is_none() && args.slot.is_none() {
        return Err(Failure::say(Exit::Usage, NO_GAIT).hint(
            "`rb-host run GAIT.toml`, or `rb-host run -s 3`; `rb-host slots` shows what is stored",
        ));
    }
    let gait = args.gait.as_deref().map(gait_file::load).transpose()?;
    let model = args.model.as_deref().map(load_model).transpose()?;
    if let (Some(folder), Some(gait), Some(path)) = (&args.dataset, &gait, &args.gait) {
        // A data set is of a meta-module.
        host_check(args, context, gait, path, &Machine::default())?;
        return run_takes(args, context, folder, gait, model);
    }
    if let Some(path) = &args.record {
        disk::must_be_free(path, args.force)?;
    }
    let second = args.then.as_deref();
    let second = second.map(gait_file::load).transpose()?;
    let port = context.port_to_move();
    let mut robot = port.and_then(|port| context.connect_to(&port));
    let machine = upload::machine_of(&mut robot)?;
    for (gait, path) in [(&gait, &args.gait), (&second, &args.then)] {
        if let (Some(gait), Some(path)) = (gait, path) {
            host_check(args, context, gait, path, &machine)?;
        }
    }
    let mut robot = robot?;
    let (slot, digest, gait) = place(args, &mut robot, gait)?;
    let mut order = order(args, context, slot, digest, gait)?;
    order.then = place_second(args, &mut robot, second, slot)?;
    let mut recorder = match &args.record {
        Some(path) => Some(open_recording(
            path,
            args.force,
            &mut robot,
            &order.gait,
            model.as_deref(),
        )?),
        None => None,
    };
    let mut reports = Vec::new();
    for number in 0..args.repeat {
        let report = runner::run(context, &mut robot, recorder.as_mut(), number, &order)?;
        context.out.say(line(&report));
        let last = report.interrupted || report.reason != Some(EndReason::Completed);
        reports.push(report);
        if last {
            break;
        }
        if number + 1 < args.repeat {
            wait_for_rest(&mut robot)?;
        }
    }
    if let Some(recorder) = recorder {
        recorder
            .finish()
            .map_err(|e| Failure::new(Exit::Other, e))?;
    }
    let value = json!({
        "gait": order.gait.name(), "slot": slot, "digest": text::hex(&digest.0), "recording": args.record,
        "port": robot.link().uri().to_string(), "runs": reports.iter().map(report_json).collect::<Vec<_>>(),
    });
    context
        .out
        .result("rb.run/1", value, || match &args.record {
            Some(path) => format!("recorded {}", path.display()),
            None => String::new(),
        });
    verdict(&reports, robot.link().uri())
}

/// Runs that become runs of a data set.
fn run_takes(
    args: &Args,
    context: &Context,
    folder: &Path,
    gait: &Gait,
    model: Option<String>,
) -> Outcome {
    let uri = context.port_to_move()?;
    let model = model.unwrap_or_else(|| Model::hand_tuned().to_toml());
    let set = takes::open_set(folder, gait.name(), &model, &uri)?;
    let known = set.runs()?;
    let mut number = 0;
    let mut reports = Vec::new();
    let mut names = Vec::new();
    for _ in 0..args.repeat {
        number += 1;
        while known.contains(&takes::name(gait, number)) {
            number += 1;
        }
        let take = Take {
            name: takes::name(gait, number),
            gait: gait.clone(),
            role: args.role.map(|role| match role {
                RoleArg::Fit => Role::Fit,
                RoleArg::Check => Role::Check,
            }),
            duration: args
                .duration
                .unwrap_or_else(|| Duration::from_secs_f32(gait.duration_s())),
            rate_hz: rate_hz(args, context)?,
            autonomous: args.autonomous,
            slot: args.slot,
            start_m: [0.0; 2],
            filmed: true,
        };
        if !uri.is_sim() {
            let question = format!(
                "Home pose, flat on the ground, camera on? Run {}?",
                take.name
            );
            super::confirm(context, &question)?;
        }
        let taken = takes::take(context, &uri, &set, &take)?;
        context.out.say(takes::line(&take, &taken));
        if let Some(misfit) = taken.misfit.clone() {
            return Err(Failure::say(Exit::BadFile, misfit).hint(
                "the recording is kept; is the robot in the picture when it begins to move?",
            ));
        }
        let kept = taken.is_kept();
        reports.push(taken.report);
        names.push(take.name);
        if !kept {
            break;
        }
    }
    let runs: Vec<Value> = reports
        .iter()
        .zip(&names)
        .map(|(report, name)| {
            let mut value = report_json(report);
            value["name"] = json!(name);
            value
        })
        .collect();
    let value =
        json!({ "gait": gait.name(), "dataset": folder, "port": uri.to_string(), "runs": runs });
    let filmed = set
        .manifest()
        .is_ok_and(|set| set.runs.iter().all(|run| run.frames.is_some()));
    context.out.result("rb.run/1", value, || {
        let shown = folder.display();
        if filmed
            || reports
                .iter()
                .all(|r| r.reason != Some(EndReason::Completed))
        {
            format!("data set {shown}")
        } else {
            format!(
                "data set {shown}; give a run its film with `rb-host rec film {shown} RUN FOLDER`"
            )
        }
    });
    verdict(&reports, &uri)
}

fn rate_hz(args: &Args, context: &Context) -> Outcome<u32> {
    let rate = args
        .rate
        .clone()
        .unwrap_or_else(|| context.settings.get(Key::TelemetryHz).value);
    rate.parse()
        .map_err(|_| Failure::say(Exit::Usage, "--rate is 20 or 100"))
}

fn host_check(
    args: &Args,
    context: &Context,
    gait: &Gait,
    path: &Path,
    machine: &Machine,
) -> Outcome {
    if args.skip_host_check {
        return Ok(());
    }
    upload::host_check(context, gait, path, machine).map(drop)
}

pub(super) fn load_model(path: &Path) -> Outcome<String> {
    /// A model file with every key and a source for each is under 64 KiB.
    const MAX_MODEL: usize = 1 << 20;
    let bad = |e: anyhow::Error| Failure::new(Exit::BadFile, e);
    let text = gait_file::read_text(path, MAX_MODEL).map_err(|e| bad(e.into()))?;
    Model::parse(&path.display().to_string(), &text).map_err(|e| bad(anyhow::Error::new(e)))?;
    Ok(text)
}

/// Slot, digest and gait: uploaded now, or found in the slot.
fn place(args: &Args, robot: &mut Robot, gait: Option<Gait>) -> Outcome<(u8, Digest, Gait)> {
    match (gait, args.slot) {
        (Some(gait), slot) => {
            let options = Options {
                slot,
                activate: false,
                verify: true,
            };
            let stored = upload::upload(robot, &gait, options)?;
            Ok((stored.slot, stored.digest, gait))
        }
        (None, Some(slot)) => {
            let (gait, digest) = upload::download(robot, slot)?;
            Ok((slot, digest, gait))
        }
        (None, None) => Err(Failure::say(Exit::Usage, NO_GAIT)),
    }
}

/// Uploads the gait that takes over, into another slot than the first one's.
fn place_second(
    args: &Args,
    robot: &mut Robot,
    gait: Option<Gait>,
    first: u8,
) -> Outcome<Option<Change>> {
    let (Some(gait), Some(after)) = (gait, args.after) else {
        return Ok(None);
    };
    let options = Options {
        slot: None,
        activate: false,
        verify: true,
    };
    let stored = upload::upload(robot, &gait, options)?;
    if stored.slot == first {
        return Err(Failure::say(
            Exit::Usage,
            format!(
                "both gaits are called `{}`, and a name has one slot",
                gait.name()
            ),
        )
        .hint("rename one of them, or give the first one its --slot"));
    }
    Ok(Some(Change {
        slot: stored.slot,
        digest: stored.digest,
        after,
    }))
}

fn order(args: &Args, context: &Context, slot: u8, digest: Digest, gait: Gait) -> Outcome<Order> {
    Ok(Order {
        slot,
        digest,
        duration: args
            .duration
            .unwrap_or_else(|| Duration::from_secs_f32(gait.duration_s())),
        rate_hz: rate_hz(args, context)?,
        lease: runner::lease(&context.port()?, args.autonomous),
        countdown: args.countdown.unwrap_or_default(),
        then: None,
        gait,
    })
}

fn wait_for_rest(robot: &mut Robot) -> Outcome {
    let until = robot.link().now() + REST;
    while robot.link().now() < until {
        if robot.info()?.state == ModuleState::Idle {
            return Ok(());
        }
        robot.next(Duration::from_millis(100))?;
    }
    Err(Failure::say(
        Exit::Refused,
        "the robot did not come to rest after the run",
    )
    .hint("`rb-host info` shows its state"))
}

fn line(report: &RunReport) -> String {
    let end = &report.end;
    let mut text = format!(
        "run {}: {}, {} cycles, {} samples, tracking error {:.2} deg rms",
        end.run + 1,
        end.reason,
        end.cycles,
        end.recorded,
        report.tracking_rms_rad.to_degrees()
    );
    for (count, what) in [
        (end.holds, "cycles held by the pre-check"),
        (end.dropped_by_module, "samples dropped by the robot"),
        (end.lost_on_link, "samples lost on the link"),
        (end.reconnects, "reconnects"),
    ] {
        if count > 0 {
            text.push_str(&format!(", {count} {what}"));
        }
    }
    text
}

fn report_json(report: &RunReport) -> Value {
    let end = &report.end;
    json!({
        "run": end.run, "reason": end.reason, "cycles": end.cycles, "holds": end.holds, "samples": end.samples,
        "recorded": end.recorded, "dropped_by_module": end.dropped_by_module, "lost_on_link": end.lost_on_link,
        "reconnects": end.reconnects, "setpoint_crc32c": format!("{:08x}", end.setpoint_crc32c),
        "tracking_rms_rad": report.tracking_rms_rad,
    })
}

/// The exit code of the last run.
fn verdict(reports: &[RunReport], uri: &PortUri) -> Outcome {
    let Some(last) = reports.last() else {
        return Ok(());
    };
    if last.interrupted {
        return Err(Failure::say(
            Exit::Interrupted,
            "Ctrl-C: the robot was stopped",
        ));
    }
    match &last.reason {
        Some(EndReason::Completed) => Ok(()),
        Some(reason) => {
            let failure = Failure::say(
                Exit::Refused,
                format!("the run ended early: {}", text::end_reason(reason)),
            );
            Err(failure.hint(match reason {
                EndReason::HostLost => {
                    "the robot heard no heartbeat of this computer for its lease; `--autonomous` lets it run on".to_owned()
                }
                _ => takes::what_happened(uri),
            }))
        }
        None => Err(Failure::say(
            Exit::Link,
            "the end of the run was not heard; the recording holds what came",
        )),
    }
}
