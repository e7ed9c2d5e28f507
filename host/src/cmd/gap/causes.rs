//! `rb-host gap causes` and `rb-host gap calibrate`: the causes of a robot's gap, those that joints share as one.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use files::dataset::Robot;
use gap::decide::Calibration;
use gap::vocabulary::Effect;
use gap::whole::{Causes, Row, name_causes, strongest_evidence};

use super::input;
use super::report::effect;
use super::whole::model;
use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;

/// Options of `gap causes`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder with dataset.toml of a whole robot
    data: PathBuf,
    /// Null robots of your own, written by `gap calibrate`, instead of the shipped ones
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Leave an effect out of the library
    #[arg(long, value_name = "EFFECT", value_parser = effect)]
    withhold: Vec<Effect>,
}

/// Options of `gap calibrate`.
#[derive(Debug, clap::Args)]
pub(super) struct CalibrateArgs {
    /// Folder of data sets, one a folder, of robots without a cause
    #[arg(long, value_name = "DIR")]
    nulls: PathBuf,
    /// File for the calibration
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// What the robots are, for the file's header
    #[arg(long, default_value = "own robots")]
    source: String,
    /// Replace an existing file
    #[arg(long)]
    force: bool,
}

fn bad(e: impl Into<anyhow::Error>) -> Failure {
    Failure::new(Exit::BadFile, e.into())
}

fn calibration(path: Option<&Path>) -> Outcome<Calibration> {
    match path {
        None => Ok(Calibration::shipped()),
        Some(path) => Calibration::parse(&disk::text(path)?)
            .map_err(|e| Failure::say(Exit::BadFile, format!("{}: {e}", path.display()))),
    }
}

fn whole(data: &Path, context: &Context) -> Outcome<input::Input> {
    let input = input::read(data, context)?;
    if input.manifest.robot == Robot::Bench {
        return Err(Failure::say(
            Exit::Usage,
            format!(
                "{}: a joint on a bench shares nothing; use `rb-host gap report`",
                data.display()
            ),
        ));
    }
    Ok(input)
}

/// Names the causes of a data set.
pub(super) fn run(args: &Args, context: &Context) -> Outcome {
    let calibration = calibration(args.calibration.as_deref())?;
    let input = whole(&args.data, context)?;
    let model = model(&args.data, &input)?;
    let _now = interrupt::at_once("stopping: nothing is written");
    let phase = context.out.phase("searching causes");
    let found = name_causes(
        &input.manifest,
        &input.recordings,
        &model,
        &args.withhold,
        &calibration,
    );
    phase.finish_and_clear();
    let found = found.map_err(bad)?;
    let mut json = serde_json::to_value(&found)
        .map_err(|e| Failure::new(Exit::Other, anyhow::Error::new(e)))?;
    json["provenance"] = serde_json::json!({
        "tool": concat!("rb-host ", env!("CARGO_PKG_VERSION")),
        "data_sha256": input.sha256,
        "warnings": input.warnings,
        "calibration": calibration.source,
    });
    context.out.result(found.schema, json, || text(&found));
    Ok(())
}

/// The data sets below a folder, in order of their names.
fn sets(folder: &Path) -> Outcome<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| disk::bad_file(folder, &e))?;
    let mut out: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
    out.retain(|p| p.join("dataset.toml").is_file());
    out.sort();
    Ok(out)
}

/// Writes the null distribution of a folder of robots without a cause.
pub(super) fn calibrate(args: &CalibrateArgs, context: &Context) -> Outcome {
    disk::must_be_free(&args.output, args.force)?;
    let sets = sets(&args.nulls)?;
    let bar = context.out.progress(sets.len() as u64, "robots");
    let _grace = interrupt::grace("stopping: nothing is written");
    let mut strongest = Vec::new();
    for set in &sets {
        if interrupt::pressed() {
            return Err(Failure::say(
                Exit::Interrupted,
                "stopped; nothing was written",
            ));
        }
        let input = whole(set, context)?;
        let model = model(set, &input)?;
        let own = strongest_evidence(&input.manifest, &input.recordings, &model).map_err(bad)?;
        context.out.detail(format!("{}: {own:.2}", set.display()));
        strongest.push(own);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let command = format!("rb-host gap calibrate --nulls {}", args.nulls.display());
    let made = Calibration::new(strongest, &command, &args.source).map_err(bad)?;
    let text = made
        .to_json()
        .map_err(|e| Failure::new(Exit::Other, anyhow::Error::new(e)))?;
    disk::write(&args.output, text.as_bytes())?;
    context.out.wrote(&args.output);
    Ok(())
}

fn name(row: &Row) -> String {
    let effect = row.effect.and_then(Effect::from_name);
    effect.map_or_else(
        || "no effect of the library".into(),
        |e| e.plain().to_owned(),
    )
}

fn joints(row: &Row) -> String {
    if row.joints.is_empty() {
        return "the robot".into();
    }
    let list: Vec<String> = row.joints.iter().map(ToString::to_string).collect();
    format!("joint {}", list.join(", "))
}

/// The answer for a terminal.
fn text(found: &Causes) -> String {
    let mut out = format!("{}\n", found.sentence);
    for row in &found.causes {
        let _ = write!(
            out,
            "\n{} ({})\n  probability {:.2}, by chance {:.3}, evidence {:.1}\n",
            name(row),
            joints(row),
            row.probability,
            row.p_value,
            row.evidence
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
    let _ = writeln!(
        out,
        "\nA cause is named from an evidence of {:.1}, which {} robots without a cause do not reach.",
        found.least_evidence, found.null_robots
    );
    out
}
