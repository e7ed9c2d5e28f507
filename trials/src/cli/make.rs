//! Suites of the emulated robot and joint, and one robot by name.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context, Result, anyhow, bail};
use clap::builder::{PossibleValuesParser, TypedValueParser};

use super::{each, write};
use crate::label::{Label, Labels, seal};
use crate::robot::{self, Plan, Planted, RobotCaseError, SeenBy, Signal};
use crate::{gaits, joint};

/// Most draws of one robot: of 180 one flew apart.
const DRAWS: u32 = 8;
/// Seed of tolerances and noise of a case made by name.
const DEVELOPMENT_SEED: u64 = 11;
/// Number of the first of the further nulls.
const NULLS_FROM: usize = 1000;

/// Options of `make-case`.
#[derive(Debug, clap::Args)]
pub(super) struct CaseArgs {
    /// EFFECT[@JOINT][:VALUE,...] joined by +, or none
    causes: String,
    /// Folder of the data set; the label stands in it
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Seed of tolerances and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Gaits, 1 to 17
    #[arg(long, default_value_t = 17)]
    gaits: usize,
    /// Gait files instead of the shipped ones
    #[arg(long, value_name = "FILE", num_args = 1..)]
    gait: Vec<PathBuf>,
    /// Leave these signals out
    #[arg(long, value_parser = signals(), value_name = "SIGNAL", value_delimiter = ',')]
    without: Vec<Signal>,
    /// Record the motors' torques too
    #[arg(long)]
    effort: bool,
    /// Add silhouettes
    #[arg(long)]
    filmed: bool,
    /// Leave base pose and inertial sensor out: the silhouettes alone show where the robot is
    #[arg(long, requires = "filmed")]
    untracked: bool,
}

/// Options of `robots`.
#[derive(Debug, clap::Args)]
pub(super) struct RobotsArgs {
    /// Folder for cases and labels; a second run there goes on where the first one stopped
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Robots: 25 % without a cause, 41 % one, 26 % two or three, 8 % outside the library
    #[arg(long, default_value_t = 60)]
    cases: usize,
    /// Further robots without a cause
    #[arg(long, default_value_t = 0)]
    nulls: usize,
    /// Gaits of a robot, 1 to 17
    #[arg(long, default_value_t = 8)]
    gaits: usize,
    /// Seed of the suite
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Leave these signals out of all robots, beside those that each does not have
    #[arg(long, value_parser = signals(), value_name = "SIGNAL", value_delimiter = ',')]
    without: Vec<Signal>,
    /// Threads; 0 = one per core
    #[arg(long, default_value_t = 0)]
    jobs: usize,
}

/// Options of `joints`.
#[derive(Debug, clap::Args)]
pub(super) struct JointsArgs {
    /// Folder for cases and labels; a second run there goes on where the first one stopped
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Joints: 25 % without a cause, 41 % one, 26 % two or three, 8 % outside the library
    #[arg(long, default_value_t = 400)]
    cases: usize,
    /// Further joints without a cause
    #[arg(long, default_value_t = 400)]
    nulls: usize,
    /// Seed of the suite
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Threads; 0 = one per core
    #[arg(long, default_value_t = 0)]
    jobs: usize,
}

/// Signals by their names, with the names in the help.
fn signals() -> impl TypedValueParser<Value = Signal> {
    PossibleValuesParser::new(Signal::ALL.map(Signal::name))
        .try_map(|name| Signal::named(&name).ok_or("no such signal"))
}

/// `EFFECT[@JOINT][:VALUE[,VALUE...]]`, several joined by `+`; `none` for none.
pub(super) fn parse(text: &str, seed: u64) -> Result<Vec<Planted>> {
    if text == "none" {
        return Ok(Vec::new());
    }
    let one = |(cause, text)| {
        let planted = parse_one(text, seed)?;
        Ok(Planted { cause, ..planted })
    };
    text.split('+').enumerate().map(one).collect()
}

fn parse_one(text: &str, seed: u64) -> Result<Planted> {
    let usage = |what: &str| {
        anyhow!(
            "`{text}`: {what}; write EFFECT[@JOINT][:VALUE,...], for example coulomb_friction@2:0.5"
        )
    };
    let (head, values) = text.split_once(':').unwrap_or((text, ""));
    let (effect, joint) = match head.split_once('@') {
        Some((effect, joint)) => {
            let joint = joint.parse().map_err(|_| usage("the joint is no number"))?;
            (effect, Some(joint))
        }
        None => (head, None),
    };
    let values = values
        .split(',')
        .filter(|v| !v.is_empty())
        .map(|v| v.parse::<f64>().map_err(|_| usage("a value is no number")))
        .collect::<Result<Vec<f64>>>()?;
    Ok(robot::planted(effect, joint, &values, seed)?)
}

/// Writes the files of a case.
pub(super) fn write_files<T: AsRef<[u8]>>(files: &[(String, T)], folder: &Path) -> Result<()> {
    let mut files = files.iter();
    files.try_for_each(|(name, content)| write(&folder.join(name), content))
}

/// One data set folder whose causes everybody may know; the label stands in it.
pub(super) fn case(args: &CaseArgs) -> Result<()> {
    let gaits = if args.gait.is_empty() {
        gaits::shipped(args.gaits)?
    } else {
        let load = |p: &PathBuf| {
            let text = std::fs::read_to_string(p)
                .with_context(|| format!("cannot read {}", p.display()))?;
            Ok(files::gait::parse(&p.display().to_string(), &text)?)
        };
        args.gait.iter().map(load).collect::<Result<Vec<_>>>()?
    };
    let seed = DEVELOPMENT_SEED.wrapping_mul(args.seed);
    let planted = parse(&args.causes, seed)?;
    let camera = |p: &Planted| p.effect.starts_with("camera") || p.effect == "frame_drop";
    let seen_by = match (args.filmed, args.untracked) {
        (_, true) => SeenBy::Camera,
        (true, false) => SeenBy::TrackerAndCamera,
        (false, false) if planted.iter().any(camera) => SeenBy::TrackerAndCamera,
        (false, false) => SeenBy::Tracker,
    };
    let mut without = args.without.clone();
    if !args.effort {
        without.push(Signal::Effort);
    }
    let plan = Plan {
        name: args.causes.clone(),
        kind: "by name",
        seed,
        seen_by,
        planted,
        without,
        ..robot::plan(seed, NULLS_FROM)
    };
    let made = robot::case(&plan, &gaits)?;
    write_files(&made.files, &args.output)?;
    let label = serde_json::to_string(&made.label)?;
    println!("{label}");
    write(&args.output.join("label.json"), label + "\n")
}

/// A folder holds one suite: another seed or size than those noted there would mix two.
fn same_suite(folder: &Path, mine: &str) -> Result<()> {
    let path = folder.join("suite.txt");
    match std::fs::read_to_string(&path) {
        Ok(there) if there.trim() != mine => bail!(
            "{} holds another suite ({}); give a new folder",
            folder.display(),
            there.trim()
        ),
        Ok(_) => Ok(()),
        Err(_) => write(&path, format!("{mine}\n")),
    }
}

/// Makes what is not there yet of a suite, and seals all labels.
fn suite(
    output: &Path,
    mine: &impl std::fmt::Debug,
    numbers: &[usize],
    jobs: usize,
    make: impl Fn(usize) -> Result<Label> + Sync,
) -> Result<()> {
    same_suite(output, &format!("{mine:?}"))?;
    let labels: Mutex<Vec<(usize, Label)>> = Mutex::new(Vec::new());
    let parts = output.join("parts");
    each(numbers.len(), jobs, |k| {
        let number = numbers[k];
        let part = parts.join(format!("{number:04}.json"));
        let label = match std::fs::read_to_string(&part) {
            Ok(text) => serde_json::from_str(&text)
                .with_context(|| format!("{} is no label", part.display()))?,
            Err(_) => {
                let label = make(number)?;
                // The label comes last: a case with a label is complete.
                write(&part, serde_json::to_string(&label)?)?;
                label
            }
        };
        let mut all = labels.lock().map_err(|_| anyhow!("a worker stopped"))?;
        all.push((number, label));
        Ok(())
    })?;
    let mut all = labels
        .into_inner()
        .map_err(|_| anyhow!("a worker stopped"))?;
    all.sort_by_key(|x| x.0);
    let cases = all.into_iter().map(|x| x.1).collect();
    let hash = seal(&output.join("labels.json"), &Labels { format: 1, cases })?;
    println!("{} cases, labels sealed: sha256 {hash}", numbers.len());
    Ok(())
}

fn numbers(cases: usize, nulls: usize) -> Vec<usize> {
    (0..cases).chain(NULLS_FROM..NULLS_FROM + nulls).collect()
}

/// A suite of robots.
pub(super) fn robots(args: &RobotsArgs) -> Result<()> {
    let gaits = gaits::shipped(args.gaits)?;
    let mine = (
        "robots",
        args.seed,
        args.cases,
        args.nulls,
        args.gaits,
        &args.without,
    );
    let numbers = numbers(args.cases, args.nulls);
    suite(&args.output, &mine, &numbers, args.jobs, |number| {
        let draw = |times: u32| {
            let mut plan = robot::plan_anew(args.seed, number, times);
            plan.without.extend(&args.without);
            robot::case(&plan, &gaits)
        };
        // A robot that flies apart is drawn anew.
        let possible = (0..DRAWS)
            .map(draw)
            .find(|c| !matches!(c, Err(RobotCaseError::Impossible)));
        let made = possible.unwrap_or(Err(RobotCaseError::Impossible))?;
        write_files(
            &made.files,
            &args.output.join("cases").join(&made.label.name),
        )?;
        Ok(made.label)
    })
}

/// A suite of joints.
pub(super) fn joints(args: &JointsArgs) -> Result<()> {
    let mine = ("joints", args.seed, args.cases, args.nulls);
    let numbers = numbers(args.cases, args.nulls);
    suite(&args.output, &mine, &numbers, args.jobs, |number| {
        let made = joint::case(args.seed, number);
        write_files(
            &made.files,
            &args.output.join("cases").join(&made.label.name),
        )?;
        Ok(made.label)
    })
}
