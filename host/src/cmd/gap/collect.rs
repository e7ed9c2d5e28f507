//! `rb-host gap collect`: records on the robot what a diagnosis needs.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use indicatif::ProgressBar;
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
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
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
    #[arg(short, long, value_name = "SLOT")]
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
    let uri = if args.dry_run {
        context.port()?
    } else {
        context.port_to_move()?
    };
    let name = "collected by rb-host gap collect";
    let mut known = Vec::new();
    if args.output.join("dataset.toml").exists() {
        known = takes::open_set(&args.output, name, &model, &uri)?.runs()?;
    }
    let missing: Vec<&Item> = items.iter().filter(|i| !known.contains(&i.name)).collect();
    context.out.say(told(&items, &missing));
    let mut failed = Vec::new();
    let mut recorded = 0;
    let mut ended = Ok(());
    if !args.dry_run && !missing.is_empty() {
        let set = takes::open_set(&args.output, name, &model, &uri)?;
        let slot = match args.slot {
            // An emulated robot is new every time.
            None if !uri.is_sim() => Some(empty_slot(&mut context.connect_to(&uri)?)?),
            slot => slot,
        };
        let bar = context.out.progress(missing.len() as u64, "recordings");
        let maker = Maker {
            context,
            uri: &uri,
            set: &set,
            slot,
        };
        ended = maker.all(&missing, &mut recorded, &mut failed, &bar);
        bar.finish_and_clear();
    }
    let left: Vec<&str> = match args.dry_run {
        true => missing.iter().map(|i| i.name.as_str()).collect(),
        false => left(&missing, recorded, &failed),
    };
    let value = json!({
        "folder": args.output, "recordings": items.len(), "recorded_now": recorded, "missing": left.len(),
        "missing_names": left, "failed": failed.iter().map(|f| json!({ "name": f.name, "why": f.why })).collect::<Vec<_>>(),
        "robot_time_s": missing.iter().map(|i| i.cost_s()).sum::<f64>(),
    });
    context.out.result("rb.gap_collect/1", value, || {
        summary(args, recorded, &failed, &left)
    });
    ended?;
    if failed.is_empty() {
        return Ok(());
    }
    let message = format!("{} recordings could not be made", failed.len());
    Err(Failure::say(Exit::Refused, message)
        .hint(format!("{}; {AGAIN}", takes::what_happened(&uri))))
}

const AGAIN: &str = "the same command goes on from here";

/// A recording that could not be made, and why.
struct Failed {
    name: String,
    why: String,
}

/// Names of what is not recorded: what failed, then what was not tried.
fn left<'a>(missing: &[&'a Item], recorded: usize, failed: &[Failed]) -> Vec<&'a str> {
    let tried = recorded + failed.len();
    let is_left =
        |(k, item): &(usize, &&'a Item)| *k >= tried || failed.iter().any(|f| f.name == item.name);
    let left = missing.iter().enumerate().filter(is_left);
    left.map(|(_, item)| item.name.as_str()).collect()
}

fn summary(args: &Args, recorded: usize, failed: &[Failed], left: &[&str]) -> String {
    let folder = args.output.display();
    if args.dry_run {
        return String::from("nothing was recorded");
    }
    let mut text = format!("{recorded} recordings made in {folder}");
    for f in failed {
        let _ = write!(text, "\nnot recorded: {}: {}", f.name, f.why);
    }
    if left.is_empty() {
        let _ = write!(text, "; next: rb-host gap report {folder}");
    } else {
        let _ = write!(text, "\nmissing: {} ({})", left.len(), left.join(", "));
    }
    text
}

/// Makes recordings, one after the other.
struct Maker<'a> {
    context: &'a Context,
    uri: &'a PortUri,
    set: &'a SetFolder,
    slot: Option<u8>,
}

/// So many recordings that fail one after the other have one cause, and it will not go away by itself.
const IN_A_ROW: usize = 3;

impl Maker<'_> {
    /// Goes on past a recording that fails; ends when the robot is gone, the disk is full, Ctrl-C is pressed or all fail.
    fn all(
        &self,
        missing: &[&Item],
        recorded: &mut usize,
        failed: &mut Vec<Failed>,
        bar: &ProgressBar,
    ) -> Outcome {
        let mut in_a_row = 0;
        for item in missing {
            match self.record(item) {
                Ok(()) => {
                    *recorded += 1;
                    in_a_row = 0;
                }
                Err(failure) if matches!(failure.exit(), Exit::Refused | Exit::BadFile) => {
                    self.context.out.warn(format_args!(
                        "{} was not recorded: {failure}; going on with the next one",
                        item.name
                    ));
                    in_a_row += 1;
                    failed.push(Failed {
                        name: item.name.clone(),
                        why: failure.to_string(),
                    });
                    if in_a_row == IN_A_ROW {
                        return Err(failure.hint(format!(
                            "{IN_A_ROW} recordings failed one after the other; {AGAIN}"
                        )));
                    }
                }
                Err(failure) => return Err(failure),
            }
            bar.inc(1);
        }
        Ok(())
    }

    /// Uploads, runs, records and adds to the set.
    fn record(&self, item: &Item) -> Outcome {
        let Self {
            context,
            uri,
            set,
            slot,
        } = *self;
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
            filmed: item.place == Place::Ground,
        };
        let taken = takes::take(context, uri, set, &take)?;
        if taken.report.interrupted {
            let text = format!("Ctrl-C: the robot was stopped; {AGAIN}");
            return Err(Failure::say(Exit::Interrupted, text));
        }
        if let Some(misfit) = taken.misfit {
            return Err(Failure::say(Exit::BadFile, misfit));
        }
        if !taken.is_kept() {
            let text = format!("the run ended early: {}", taken.report.end.reason);
            return Err(Failure::say(Exit::Refused, text));
        }
        context.out.say(takes::line(&take, &taken));
        Ok(())
    }
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
