//! `rb-host gap report` and `rb-host gap predict`.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use gap::vocabulary::Effect;
use gap::{Diagnosis, Settings};

use super::input::{self, Input};
use super::next;
use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};

/// Options of `gap report`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder with dataset.toml; with --json also the file for the verdict (`DATA --json out.json`)
    #[arg(required = true, num_args = 1..=2, value_name = "DATA")]
    paths: Vec<PathBuf>,
    /// Write the report as one HTML file
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Write the verdict as JSON (schema rb.gap/1)
    #[arg(long = "json-file", value_name = "FILE")]
    json_file: Option<PathBuf>,
    /// Write the verdict as Markdown
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Write the found effects as a patch for `gap predict`
    #[arg(long, value_name = "FILE")]
    patch: Option<PathBuf>,
    /// Seed of global starts and bootstraps
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Stop the search after this many seconds and write what is there, marked as partial
    #[arg(long, value_name = "S")]
    time_limit: Option<f64>,
    /// Leave an effect out of the library (to check that the diagnosis then says "unknown")
    #[arg(long, value_name = "EFFECT", value_parser = effect)]
    withhold: Vec<Effect>,
    /// Start from an earlier diagnosis of the same joint (file written by --patch) and name only what came on top
    #[arg(long, value_name = "FILE")]
    baseline: Option<PathBuf>,
}

/// Options of `gap predict`.
#[derive(Debug, clap::Args)]
pub(super) struct PredictArgs {
    /// Folder with dataset.toml
    data: PathBuf,
    /// Patch written by `gap report --patch`; without it the data set is diagnosed first
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Folder for the predicted CSV files
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

fn effect(name: &str) -> Result<Effect, String> {
    Effect::from_name(name)
        .ok_or_else(|| format!("`{name}` is not in the effect vocabulary; see docs/reference/effects.md"))
}

fn diagnose(
    input: &Input,
    settings: &Settings,
    limit_s: Option<f64>,
    context: &Context,
) -> Outcome<Diagnosis> {
    let start = Instant::now();
    let watch = |next: &str| {
        context.out.detail(next);
        let late = limit_s.is_some_and(|l| start.elapsed().as_secs_f64() > l);
        !late && !crate::interrupt::pressed()
    };
    let mut d = gap::diagnose_watched(&input.manifest, &input.recordings, 0, settings, &watch)
        .map_err(|e| Failure::new(Exit::BadFile, anyhow::Error::new(e)))?;
    d.verdict.provenance.data_sha256.clone_from(&input.sha256);
    d.verdict.provenance.commit = option_env!("RB_COMMIT").map(str::to_string);
    d.verdict.provenance.wall_time_s = start.elapsed().as_secs_f64();
    Ok(d)
}

pub(super) fn write(path: &Path, text: &str) -> Outcome {
    fs::write(path, text)
        .map_err(|e| Failure::say(Exit::Other, format!("cannot write {}: {e}", path.display())))
}

/// The data folder, and the file after `--json`, in whichever order they stand.
fn places(args: &Args, context: &Context) -> Outcome<(PathBuf, Option<PathBuf>)> {
    match args.paths.as_slice() {
        [data] => Ok((data.clone(), args.json_file.clone())),
        [a, b] if context.out.json && b.is_dir() && !a.is_dir() => Ok((b.clone(), Some(a.clone()))),
        [a, b, ..] if context.out.json => Ok((a.clone(), Some(b.clone()))),
        _ => Err(Failure::say(
            Exit::Usage,
            "give one data set folder, or DATA --json FILE",
        )),
    }
}

/// Reads a patch of `gap report --patch`.
fn patch(path: &Path) -> Outcome<gap::joint::Params> {
    let text = fs::read_to_string(path).map_err(|e| {
        Failure::say(
            Exit::BadFile,
            format!("cannot read {}: {e}", path.display()),
        )
    })?;
    gap::patch::parse(&text)
        .map_err(|e| Failure::say(Exit::BadFile, format!("{}: {e}", path.display())))
}

fn run_whole(
    args: &Args,
    data: &Path,
    input: &Input,
    json_file: Option<&Path>,
    context: &Context,
) -> Outcome {
    if args.baseline.is_some() {
        return Err(Failure::say(
            Exit::Usage,
            "--baseline is for one joint on a bench; a whole robot starts from its model.toml",
        ));
    }
    let settings = gap::whole::Settings {
        seed: args.seed,
        withhold: args.withhold.clone(),
    };
    let mut d = super::whole::run(data, input, &settings)?;
    next::robot(
        &mut d,
        next::beside(&[&args.output, &json_file.map(Path::to_owned), &args.markdown]),
    )?;
    let v = d.verdict();
    let json = serde_json::to_string_pretty(v).map_err(|e| Failure::new(Exit::Other, e))?;
    let markdown = gap::report::markdown(v);
    if let Some(path) = &args.output {
        write(path, &d.html())?;
    }
    if let Some(path) = json_file {
        write(path, &json)?;
    }
    if let Some(path) = &args.markdown {
        write(path, &markdown)?;
    }
    if let Some(path) = &args.patch {
        write(path, &d.patch().to_toml())?;
    }
    let value = serde_json::to_value(v).map_err(|e| Failure::new(Exit::Other, e))?;
    context.out.result("rb.gap/1", value, || markdown);
    Ok(())
}

pub(super) fn run(args: &Args, context: &Context) -> Outcome {
    let (data, json_file) = places(args, context)?;
    let input = input::read(&data, context)?;
    if input.manifest.joints() > 1 {
        return run_whole(args, &data, &input, json_file.as_deref(), context);
    }
    let settings = Settings {
        seed: args.seed,
        withhold: args.withhold.clone(),
        baseline: args.baseline.as_deref().map(patch).transpose()?,
        ..Settings::default()
    };
    let mut d = diagnose(&input, &settings, args.time_limit, context)?;
    next::bench(
        &mut d,
        next::beside(&[&args.output, &json_file, &args.markdown]),
    )?;
    let json =
        serde_json::to_string_pretty(&d.verdict).map_err(|e| Failure::new(Exit::Other, e))?;
    let markdown = gap::report::markdown(&d.verdict);
    if let Some(path) = &args.output {
        write(path, &gap::report::html(&d))?;
    }
    if let Some(path) = &json_file {
        write(path, &json)?;
    }
    if let Some(path) = &args.markdown {
        write(path, &markdown)?;
    }
    if let Some(path) = &args.patch {
        write(path, &gap::patch::to_toml(&d))?;
    }
    let value = serde_json::to_value(&d.verdict).map_err(|e| Failure::new(Exit::Other, e))?;
    context.out.result("rb.gap/1", value, || markdown);
    Ok(())
}

fn predict_whole(args: &PredictArgs, input: &Input, context: &Context) -> Outcome {
    let runs = super::whole::predict(&args.data, input, args.model.as_deref())?;
    fs::create_dir_all(&args.output).map_err(|e| {
        Failure::say(
            Exit::Other,
            format!("cannot make {}: {e}", args.output.display()),
        )
    })?;
    let mut written = Vec::new();
    for (name, text) in runs {
        let name = Path::new(&name)
            .file_name()
            .map_or_else(|| PathBuf::from("run.csv"), PathBuf::from);
        let path = args.output.join(name);
        write(&path, &text)?;
        written.push(path.display().to_string());
    }
    let value = serde_json::json!({ "files": written });
    context
        .out
        .result("rb.gap_predict/1", value, || written.join("\n"));
    Ok(())
}

pub(super) fn predict(args: &PredictArgs, context: &Context) -> Outcome {
    let input = input::read(&args.data, context)?;
    if input.manifest.joints() > 1 {
        return predict_whole(args, &input, context);
    }
    let (problem, params) = match &args.model {
        Some(path) => {
            let params = patch(path)?;
            let problem = gap::joint::Problem::new(&input.manifest, &input.recordings, 0)
                .ok_or_else(|| Failure::say(Exit::BadFile, "no run measured position"))?;
            (problem, params)
        }
        None => {
            let d = diagnose(&input, &Settings::default(), None, context)?;
            let params = d.selection.model.params;
            (d.problem, params)
        }
    };
    fs::create_dir_all(&args.output).map_err(|e| {
        Failure::say(
            Exit::Other,
            format!("cannot make {}: {e}", args.output.display()),
        )
    })?;
    let mut written = Vec::new();
    for (i, run) in problem.runs.iter().enumerate() {
        let name = Path::new(&run.name)
            .file_name()
            .map_or_else(|| PathBuf::from(format!("run{i}.csv")), PathBuf::from);
        let path = args.output.join(name);
        write(&path, &gap::predict::csv(&problem, i, &params))?;
        written.push(path.display().to_string());
    }
    let value = serde_json::json!({ "files": written });
    context
        .out
        .result("rb.gap_predict/1", value, || written.join("\n"));
    Ok(())
}
