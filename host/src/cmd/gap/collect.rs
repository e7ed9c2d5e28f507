//! `rb-host gap collect`: records on the robot what a diagnosis needs.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use serde_json::json;

use super::programme::{self, Item, Place, Wanted};
use super::shipped;
use crate::cli::parse_duration;
use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::gait_file;
use crate::link::{PortUri, Robot};
use crate::recording::set::SetFolder;
use crate::takes::{self, Take};
use crate::upload;

/// Options of `gap collect`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Gait files; default: six of the shipped searched gaits
    #[arg(value_name = "GAIT")]
    gaits: Vec<PathBuf>,
    /// Folder for the data set; a second run there records what is still missing
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Recordings of each gait: what repeats badly cannot be diagnosed
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    repeat: u32,
    /// Length of each gait run; default: the gait's own
    #[arg(short, long, value_name = "TIME", value_parser = parse_duration)]
    duration: Option<Duration>,
    /// Length of the warm hold; 0s leaves it out
    #[arg(long, value_name = "TIME", value_parser = parse_duration, default_value = "600s")]
    warm: Duration,
    /// Leave out the runs of single joints in the air
    #[arg(long)]
    no_joints: bool,
    /// Robot model to store with the data set; default: the shipped one
    #[arg(short, long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Slot that the gaits go through; default: the first empty one
    #[arg(short, long)]
    slot: Option<u8>,
    /// Tell what would be recorded and how long it takes, and stop
    #[arg(long)]
    dry_run: bool,
}

fn minutes(s: f64) -> String {
    format!("{:.0} min {:.0} s", (s / 60.0).floor(), s % 60.0)
}

/// What will be recorded, as a table.
fn told(items: &[Item], missing: &[&Item]) -> String {
    let cost = |of: &mut dyn Iterator<Item = &Item>| of.map(Item::cost_s).sum::<f64>();
    let mut text = String::new();
    for (place, words) in [
        (Place::Ground, "on the ground"),
        (Place::Air, "held off the ground, joint by joint"),
    ] {
        let count = items.iter().filter(|i| i.place == place).count();
        let time = cost(&mut items.iter().filter(|i| i.place == place));
        if count > 0 {
            let _ = writeln!(text, "{count} recordings {words}: {}", minutes(time));
        }
    }
    let left = cost(&mut missing.iter().copied());
    let _ = write!(
        text,
        "{} of {} are still to be made: {} of robot time",
        missing.len(),
        items.len(),
        minutes(left)
    );
    text
}

pub(super) fn run(args: &Args, context: &Context) -> Outcome {
    let gaits = if args.gaits.is_empty() {
        shipped::gaits(6)?
    } else {
        let load = |p: &PathBuf| gait_file::load(p);
        args.gaits.iter().map(load).collect::<Outcome<Vec<_>>>()?
    };
    let model = match &args.model {
        Some(path) => crate::cmd::run::load_model(path)?,
        None => files::model::Model::hand_tuned().to_toml(),
    };
    let wanted = Wanted {
        gaits: &gaits,
        repeats: args.repeat,
        duration_s: args.duration.map(|d| d.as_secs_f64()),
        joints: !args.no_joints,
        warm_s: args.warm.as_secs_f64(),
    };
    let items = programme::items(&wanted, &context.robot_model())?;
    let uri = context.port()?;
    let name = "collected by rb-host gap collect";
    let mut known = Vec::new();
    if args.output.join("dataset.toml").exists() {
        known = takes::open_set(&args.output, name, &model, &uri)?.runs()?;
    }
    let missing: Vec<&Item> = items.iter().filter(|i| !known.contains(&i.name)).collect();
    context.out.say(told(&items, &missing));
    let mut recorded = 0;
    if !args.dry_run && !missing.is_empty() {
        let set = takes::open_set(&args.output, name, &model, &uri)?;
        let slot = match args.slot {
            // An emulated robot is new every time.
            None if !uri.is_sim() => Some(empty_slot(&mut context.connect_to(&uri)?)?),
            slot => slot,
        };
        for item in &missing {
            record(context, &uri, &set, slot, item)?;
            recorded += 1;
        }
    }
    let value = json!({
        "folder": args.output, "recordings": items.len(), "recorded_now": recorded,
        "missing": missing.len() - recorded, "robot_time_s": missing.iter().map(|i| i.cost_s()).sum::<f64>(),
    });
    context.out.result("rb.gap_collect/1", value, || {
        let folder = args.output.display();
        if args.dry_run {
            return String::from("nothing was recorded");
        }
        format!("{recorded} recordings made in {folder}; next: rb-host gap report {folder}")
    });
    Ok(())
}

/// Uploads, runs, records and adds to the set.
fn record(
    context: &Context,
    uri: &PortUri,
    set: &SetFolder,
    slot: Option<u8>,
    item: &Item,
) -> Outcome {
    if !uri.is_sim() {
        let place = match item.place {
            Place::Ground => "flat on the ground",
            Place::Air => "held off the ground",
        };
        let question = format!("Home pose, {place}? Run {}?", item.name);
        crate::cmd::confirm(context, &question)?;
    }
    let take = Take {
        name: item.name.clone(),
        gait: item.gait.clone(),
        role: None,
        duration: Duration::from_secs_f64(item.duration_s),
        autonomous: false,
        rate_hz: 100,
        slot,
        start_m: [0.0; 2],
    };
    let taken = takes::take(context, uri, set, &take)?;
    context.out.say(takes::line(&take, &taken));
    let again = "the same command goes on from here";
    if taken.report.interrupted {
        let text = format!("Ctrl-C: the robot was stopped; {again}");
        return Err(Failure::say(Exit::Interrupted, text));
    }
    if !taken.is_kept() {
        let text = format!("the run of {} ended early", item.name);
        return Err(Failure::say(Exit::Refused, text)
            .hint(format!("`rb-host log` tells what happened; {again}")));
    }
    Ok(())
}

/// The first empty slot.
fn empty_slot(robot: &mut Robot) -> Outcome<u8> {
    let (_, slots) = upload::slots(robot)?;
    let empty = slots.iter().position(Option::is_none);
    empty.and_then(|k| u8::try_from(k).ok()).ok_or_else(|| {
        Failure::say(Exit::Refused, "no slot is empty")
            .hint("name one whose gait may be replaced with --slot")
    })
}
