//! `rb-host gap causes` and `rb-host gap calibrate`: the causes of the gap of a robot or of a joint on a bench; those that
//! joints share as one.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use files::dataset::Robot;
use files::model::Model;
use gap::bench::{self, Differ};
use gap::decide::Calibration;
use gap::evidence::block::White;
use gap::evidence::kept;
use gap::vocabulary::{Effect, Stage};
use gap::whole::{
    Causes, DataSet, FOLDS, Film, Left, Place, Row, Shrink, calibrated, name_causes, null_blocks,
};

use super::input;
use super::report::effect;
use super::whole::{films, model};
use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;

/// Options of `gap causes`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder with dataset.toml of a whole robot or of a joint on a bench
    data: PathBuf,
    /// Nulls of your own, written by `gap calibrate`, instead of the shipped ones
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Leave an effect out of the library
    #[arg(long, value_name = "EFFECT", value_parser = effect)]
    withhold: Vec<Effect>,
    /// Write the causes of a robot as a patch of its model, for `gap predict`, `sim` and `optimise`
    #[arg(long, value_name = "FILE")]
    patch: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long, requires = "patch")]
    force: bool,
}

/// Options of `gap calibrate`.
#[derive(Debug, clap::Args)]
pub(super) struct CalibrateArgs {
    /// Folder of data sets, one a folder, of robots or of joints without a cause
    #[arg(long, value_name = "DIR", required = true)]
    nulls: Vec<PathBuf>,
    /// File for the calibration
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Folder for what each robot showed: a calibration that was stopped goes on from there
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// How far sizes are off by stage, as `rb-trials score --laws` writes it: widens the intervals of causes
    #[arg(long, value_name = "FILE")]
    laws: Option<PathBuf>,
    /// What they are, for the file's header
    #[arg(long, default_value = "own")]
    source: String,
    /// Replace an existing file
    #[arg(long)]
    force: bool,
}

fn bad(e: impl Into<anyhow::Error>) -> Failure {
    Failure::new(Exit::BadFile, e.into())
}

/// The calibration in a file, or the shipped one of this kind.
pub(super) fn calibration(path: Option<&Path>, robot: Robot) -> Outcome<Calibration> {
    match path {
        None if robot == Robot::Bench => Ok(Calibration::shipped_joint()),
        None => Ok(Calibration::shipped()),
        Some(path) => Calibration::parse(&disk::text(path)?)
            .map_err(|e| Failure::say(Exit::BadFile, format!("{}: {e}", path.display()))),
    }
}

/// Share of the work that is usually done when the recordings of a joint and of a robot were read, as measured on the example joint and on
/// four robots.
const JOINT_READ: f64 = 0.002;
const ROBOT_READ: f64 = 0.01;

/// Names the causes of a data set.
pub(super) fn run(args: &Args, context: &Context) -> Outcome {
    if let Some(path) = &args.patch {
        disk::must_be_free(path, args.force)?;
    }
    let phases = context.out.phases("reading the recordings");
    let input = input::read(&args.data, context)?;
    if args.patch.is_some() && input.manifest.robot == Robot::Bench {
        let message = "a joint on a bench has no model of a robot to patch";
        return Err(
            Failure::say(Exit::Usage, message).hint("`rb-host gap report DATA --patch FILE`")
        );
    }
    let calibration = calibration(args.calibration.as_deref(), input.manifest.robot)?;
    let _now = interrupt::at_once("stopping: nothing is written");
    let read = match input.manifest.robot {
        Robot::Bench => JOINT_READ,
        _ => ROBOT_READ,
    };
    phases.begin("searching causes", read);
    let (manifest, recordings) = (&input.manifest, &input.recordings);
    let found = if manifest.robot == Robot::Bench {
        bench::name_causes(manifest, recordings, &args.withhold, &calibration)
            .map(|found| Answer::Joint(Box::new(found)))
            .map_err(bad)
    } else {
        Whole::read(&args.data, &input).and_then(|robot| {
            let found =
                name_causes(robot.set(&input), &args.withhold, &calibration).map_err(bad)?;
            Ok(Answer::Robot(Box::new((found, robot.model))))
        })
    };
    drop(phases);
    let found = found?;
    if let (Some(path), Answer::Robot(robot)) = (&args.patch, &found) {
        disk::write(
            path,
            robot.0.patch(&robot.1, "gap causes").to_toml().as_bytes(),
        )?;
        context.out.wrote(path);
    }
    let mut json = found
        .json()
        .map_err(|e| Failure::new(Exit::Other, anyhow::Error::new(e)))?;
    json["provenance"] = serde_json::json!({
        "tool": concat!("rb-host ", env!("CARGO_PKG_VERSION")),
        "data_sha256": input.sha256,
        "warnings": input.warnings,
        "calibration": calibration.source,
    });
    context.out.result("rb.gap/2", json, || found.text());
    Ok(())
}

/// What a data set of a robot holds beside its runs.
struct Whole {
    films: Vec<Film>,
    model: Model,
}

impl Whole {
    fn read(data: &Path, input: &input::Input) -> Outcome<Self> {
        Ok(Self {
            films: films(data, input)?,
            model: model(data, input)?,
        })
    }

    fn set<'a>(&'a self, input: &'a input::Input) -> DataSet<'a> {
        DataSet {
            manifest: &input.manifest,
            recordings: &input.recordings,
            films: &self.films,
            model: &self.model,
        }
    }
}

/// What was found, of either kind.
enum Answer {
    Joint(Box<bench::Causes>),
    /// With the nominal model.
    Robot(Box<(Causes, Model)>),
}

impl Answer {
    fn json(&self) -> serde_json::Result<serde_json::Value> {
        match self {
            Self::Joint(found) => serde_json::to_value(found.as_ref()),
            Self::Robot(found) => serde_json::to_value(&found.0),
        }
    }

    fn text(&self) -> String {
        match self {
            Self::Joint(f) => {
                let mut out = text(&f.sentence, &f.causes);
                if let Some(h) = &f.held_out {
                    out.push_str(&shrinks(&h.runs, &h.split, &h.errors));
                }
                let _ = writeln!(
                    out,
                    "\nA cause is named from an evidence of {:.1} on, each effect from its own: {} joints without a cause say so.",
                    f.least_evidence, f.null_joints
                );
                out
            }
            Self::Robot(found) => {
                let f = &found.0;
                let mut out = text(&f.sentence, &f.causes);
                out.push_str(&places(&f.places));
                out.push_str(&left(&f.left));
                let h = &f.held_out;
                out.push_str(&shrinks(&h.runs, &h.split, &h.errors));
                if let Some(near) = &f.nearest {
                    let what = name(near.effect);
                    let _ = writeln!(
                        out,
                        "\nNearest of what is not named: {what} ({}), evidence {:.1} of {:.1}.",
                        joints(&near.joints),
                        near.evidence,
                        near.asked
                    );
                }
                let _ = writeln!(
                    out,
                    "{} robots without a cause say how much evidence a cause of each effect needs.",
                    f.null_robots
                );
                out
            }
        }
    }
}

/// Places below this share of the gap are left out of the text.
const SMALL: f64 = 0.01;

/// Where the gap lies.
fn places(all: &[Place]) -> String {
    let large = all.iter().filter(|p| p.share >= SMALL);
    let list: Vec<String> = large
        .map(|p| format!("{} {:.0} %", p.plain, 100.0 * p.share))
        .collect();
    if list.is_empty() {
        return String::new();
    }
    format!("\nWhere the gap lies: {}.\n", list.join(", "))
}

/// What is left beyond what robots without a cause leave.
fn left(all: &[Left]) -> String {
    let one = |l: &Left| format!("{} ({:.1} times the usual)", l.plain, l.left / l.usual);
    let list: Vec<String> = all.iter().map(one).collect();
    if list.is_empty() {
        return String::new();
    }
    format!(
        "More is left than robots without a cause leave: {}.\n",
        list.join(", ")
    )
}

/// How far the gap shrinks, signal by signal.
fn shrinks(runs: &[String], split: &str, errors: &BTreeMap<&'static str, Shrink>) -> String {
    let mut out = format!("\nErrors of {} runs ({split}):\n", runs.len());
    for (signal, e) in errors {
        let _ = writeln!(
            out,
            "  {signal:<18} {:.4} nominal, {:.4} calibrated, {:.4} with the causes",
            e.before, e.calibrated, e.after
        );
    }
    out
}

/// The data sets below a folder, in order of their names.
fn sets(folder: &Path) -> Outcome<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| disk::bad_file(folder, &e))?;
    let mut out: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
    out.retain(|p| p.join("dataset.toml").is_file());
    if out.is_empty() {
        let message = format!("{}: no folder in it has a dataset.toml", folder.display());
        return Err(Failure::say(Exit::BadFile, message)
            .hint("`--nulls` takes the folder that holds the data sets"));
    }
    out.sort();
    Ok(out)
}

/// The file in `folder` for what a data set shows to this version of the program, around the model that it states.
fn file_of(folder: &Path, input: &input::Input, model: &Model) -> PathBuf {
    let both = [input.sha256.as_str(), &model.to_toml()].concat();
    let sha256 = input::hex(both.as_bytes());
    folder.join(format!("{}-{sha256}.blocks", env!("CARGO_PKG_VERSION")))
}

/// What a calibration is made of: joints or robots without a cause.
#[derive(Default)]
struct Healthy {
    /// Data sets of joints.
    sets: Vec<PathBuf>,
    /// What the controller of each puts out, and each as a block.
    joints: Vec<(&'static str, Vec<White>)>,
    /// Blocks of a robot.
    robots: Vec<Vec<White>>,
}

impl Healthy {
    /// Adds a data set and says of what it is; what a robot showed is kept in the folder `keep`.
    fn add(&mut self, set: &Path, keep: Option<&Path>, context: &Context) -> Outcome<Robot> {
        let input = input::read(set, context)?;
        let (manifest, recordings) = (&input.manifest, &input.recordings);
        if manifest.robot == Robot::Bench {
            let block = bench::null_block(manifest, recordings).map_err(bad)?;
            context.out.detail(set.display().to_string());
            self.sets.push(set.into());
            self.joints.push((bench::drive(manifest), vec![block]));
            return Ok(manifest.robot);
        }
        let robot = Whole::read(set, &input)?;
        let file = keep.map(|folder| file_of(folder, &input, &robot.model));
        let before = file.as_ref().and_then(|f| std::fs::read(f).ok());
        let before = before.and_then(|bytes| kept::from_bytes(&bytes).ok());
        let blocks = if let Some(blocks) = before {
            blocks
        } else {
            let blocks = null_blocks(robot.set(&input)).map_err(bad)?;
            if let Some(file) = &file {
                disk::write(file, &kept::to_bytes(&blocks))?;
            }
            blocks
        };
        context.out.detail(set.display().to_string());
        self.robots.push(blocks);
        Ok(manifest.robot)
    }

    fn calibration(&self, command: &str, source: &str, context: &Context) -> Outcome<Calibration> {
        if !self.robots.is_empty() {
            return calibrated(&self.robots, command, source).map_err(bad);
        }
        let differ = Differ::learned(&self.joints);
        let without = |fold| differ.without_fold(&self.joints, fold, FOLDS);
        let folds: Vec<Differ> = (0..FOLDS).map(without).collect();
        let bar = context
            .out
            .progress(self.joints.len() as u64, "joints weighed");
        let (mut evidence, mut left) = (Vec::new(), Vec::new());
        for (i, set) in self.sets.iter().enumerate() {
            if interrupt::pressed() {
                return Err(stopped());
            }
            let input = input::read(set, context)?;
            let (manifest, recordings) = (&input.manifest, &input.recordings);
            let spreads = folds[i % FOLDS].of(bench::drive(manifest));
            let healthy = bench::strongest(manifest, recordings, spreads).map_err(bad)?;
            let (own, remains) = (healthy.evidence, healthy.left_db);
            let most = own.iter().max_by(|a, b| a.1.total_cmp(b.1));
            let most = most.map_or(String::new(), |(shown, x)| format!("{x:.2} of {shown}, "));
            let most_left = remains.iter().max_by(|a, b| a.1.total_cmp(&b.1));
            let text = most_left.map_or(String::new(), |(column, db)| {
                format!("{db:.1} dB left of {column}")
            });
            let text = format!("{}: {most}{text}", set.display());
            context.out.detail(text);
            evidence.push(own);
            left.push(remains);
            bar.inc(1);
        }
        bar.finish_and_clear();
        let mut out = Calibration::by_effect(&evidence, command, source)
            .map_err(bad)?
            .with_lefts(&left);
        (out.spreads, out.drives) = (differ.all, differ.drives);
        Ok(out)
    }
}

/// How far sizes are off by stage, from a file.
fn laws(path: &Path) -> Outcome<BTreeMap<String, f64>> {
    let say = |e: String| Failure::say(Exit::BadFile, format!("{}: {e}", path.display()));
    let all: BTreeMap<String, f64> =
        serde_json::from_str(&disk::text(path)?).map_err(|e| say(e.to_string()))?;
    for (stage, share) in &all {
        if !Stage::ALL.iter().any(|s| s.name() == stage) {
            return Err(say(format!("no stage is called `{stage}`")));
        }
        if !(0.0..=1.0).contains(share) {
            return Err(say(format!(
                "`{stage}` is {share}, not a share from 0 to 1"
            )));
        }
    }
    Ok(all)
}

fn stopped() -> Failure {
    Failure::say(Exit::Interrupted, "stopped; no calibration was written")
}

/// Writes the null distribution of folders of robots or of joints without a cause.
pub(super) fn calibrate(args: &CalibrateArgs, context: &Context) -> Outcome {
    disk::must_be_free(&args.output, args.force)?;
    let laws = args
        .laws
        .as_deref()
        .map_or_else(|| Ok(BTreeMap::new()), laws)?;
    let mut all = Vec::new();
    for folder in &args.nulls {
        all.extend(sets(folder)?);
    }
    if let Some(folder) = &args.keep {
        disk::make_folder(folder)?;
    }
    let bar = context.out.progress(all.len() as u64, "data sets");
    let _grace = interrupt::grace("stopping after this data set");
    let (mut healthy, mut kinds) = (Healthy::default(), Vec::new());
    for set in &all {
        if interrupt::pressed() {
            return Err(match &args.keep {
                Some(_) => stopped().hint("the same command goes on where this one ended"),
                None => stopped().hint("with `--keep DIR` robots would go on where they ended"),
            });
        }
        let robot = healthy.add(set, args.keep.as_deref(), context)?;
        kinds.push(robot);
        if kinds.iter().any(|k| *k != robot) {
            return Err(Failure::say(
                Exit::Usage,
                format!("{}: joints and robots are calibrated apart", set.display()),
            ));
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let folders: Vec<String> = args.nulls.iter().map(|n| n.display().to_string()).collect();
    let command = format!(
        "rb-host gap calibrate --nulls {}",
        folders.join(" --nulls ")
    );
    let mut made = healthy.calibration(&command, &args.source, context)?;
    made.laws = laws;
    let text = made
        .to_json()
        .map_err(|e| Failure::new(Exit::Other, anyhow::Error::new(e)))?;
    disk::write(&args.output, text.as_bytes())?;
    context.out.wrote(&args.output);
    Ok(())
}

fn name(effect: Option<&str>) -> String {
    let other = effect.unwrap_or("a shape that no effect of the library has");
    let effect = effect.and_then(Effect::from_name);
    effect.map_or_else(|| other.replace('_', " "), |e| e.plain().to_owned())
}

fn joints(of: &[usize]) -> String {
    if of.is_empty() {
        return "the robot".into();
    }
    let list: Vec<String> = of.iter().map(ToString::to_string).collect();
    format!("joint {}", list.join(", "))
}

/// The answer for a terminal.
fn text(sentence: &str, rows: &[Row]) -> String {
    let mut out = format!("{sentence}\n");
    for row in rows {
        let _ = write!(
            out,
            "\n{} ({})\n  probability {:.2}, by chance {:.3}, evidence {:.1} of {:.1}\n",
            name(row.effect),
            joints(&row.joints),
            row.probability,
            row.p_value,
            row.evidence,
            row.asked
        );
        for (key, value) in &row.values {
            let [low, high] = value.ci95;
            let _ = write!(out, "  {key} {:.4} ({low:.4} to {high:.4})", value.value);
            if value.by_joint.len() > 1 {
                let each: Vec<String> = value
                    .by_joint
                    .iter()
                    .map(|(k, v)| format!("{k}: {v:.4}"))
                    .collect();
                let _ = write!(out, "; by joint {}", each.join(", "));
            }
            out.push('\n');
        }
        for other in row.alternatives.iter().filter(|a| !a.distinguishable) {
            let _ = writeln!(
                out,
                "  cannot be told from {} at {:?}",
                other.effect.unwrap_or("a shape of no effect"),
                other.joints
            );
        }
    }
    out
}
