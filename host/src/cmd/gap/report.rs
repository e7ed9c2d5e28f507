//! `rb-host gap report` and `rb-host gap predict`.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use gap::bench::{self, Diagnosis, Settings};
use gap::decide::Calibration;
use gap::locate::State;
use gap::report::Subject;
use gap::verdict::Verdict;
use gap::vocabulary::Effect;
use gap::watch::Watch;

use super::input::{self, Input};
use super::{causes, next};
use crate::cli::parse_duration;
use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;

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
    #[arg(long = "markdown-file", alias = "markdown", value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Write the found effects as a patch for `gap predict`
    #[arg(long, value_name = "FILE")]
    patch: Option<PathBuf>,
    /// Seed of global starts and bootstraps
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// One joint: stop the search after this time and write what is there, marked as partial
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    time_limit: Option<Duration>,
    /// Leave an effect out of the library (to check that the diagnosis then says "unknown")
    #[arg(long, value_name = "EFFECT", value_parser = effect)]
    withhold: Vec<Effect>,
    /// Replace existing files
    #[arg(long)]
    force: bool,
    /// Start from an earlier diagnosis of the same joint (file written by --patch) and name only what came on top
    #[arg(long, value_name = "FILE")]
    baseline: Option<PathBuf>,
    /// Nulls of your own robots, written by `gap calibrate`, instead of the shipped ones
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
}

/// Options of `gap predict`.
#[derive(Debug, clap::Args)]
pub(super) struct PredictArgs {
    /// Folder with dataset.toml
    data: PathBuf,
    /// Patch written by `gap report --patch`; without it the data set is diagnosed first
    #[arg(long, alias = "model", value_name = "FILE")]
    patch: Option<PathBuf>,
    /// Folder for the predicted CSV files
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace files in a folder that is not empty
    #[arg(long)]
    force: bool,
}

pub(super) fn effect(name: &str) -> Result<Effect, String> {
    Effect::from_name(name).ok_or_else(|| {
        format!("`{name}` is not in the effect vocabulary; see docs/reference/effects.md")
    })
}

fn diagnose(
    input: &Input,
    (settings, calibration): (&Settings, &Calibration),
    limit: Option<Duration>,
    context: &Context,
) -> Outcome<Diagnosis> {
    let start = Instant::now();
    let phases = context.out.phases("calibrating");
    // Before the search there is nothing yet that a verdict could be made of.
    let calibrating = Mutex::new(Some(interrupt::at_once("stopped; nothing was written")));
    let next = |next: &str| {
        calibrating
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        context.out.detail(next);
        phases.begin(next, share(next));
    };
    let late = || limit.is_some_and(|l| start.elapsed() > l);
    let watch = Watch {
        next: &next,
        stop: &|| interrupt::pressed() || late(),
    };
    let (manifest, recordings) = (&input.manifest, &input.recordings);
    let diagnosed = bench::diagnose(manifest, recordings, settings, calibration, watch);
    drop(phases);
    let mut d = diagnosed.map_err(|e| Failure::new(Exit::BadFile, anyhow::Error::new(e)))?;
    let provenance = &mut d.verdict.provenance;
    provenance.data_sha256.clone_from(&input.sha256);
    provenance.warnings.clone_from(&input.warnings);
    provenance.commit = option_env!("RB_COMMIT").map(str::to_string);
    provenance.wall_time_s = start.elapsed().as_secs_f64();
    Ok(d)
}

/// Share of the diagnosis of a joint that is usually done when a phase begins, as measured on recordings of one cause and of three.
fn share(phase: &str) -> f64 {
    let number = phase.strip_prefix("searching effect ");
    match number.and_then(|number| number.parse::<i32>().ok()) {
        Some(k) => 0.75 - 0.7 * 0.7f64.powi(k - 1),
        None if phase == "trying rivals" => 0.7,
        None => 0.99,
    }
}

pub(super) fn write(path: &Path, text: &str) -> Outcome {
    disk::write(path, text.as_bytes())
}

/// The files that were asked for.
struct Targets<'a> {
    html: Option<&'a Path>,
    json: Option<PathBuf>,
    markdown: Option<&'a Path>,
    patch: Option<&'a Path>,
}

/// What stands in them.
struct Texts<'a> {
    subject: &'a Subject,
    html: &'a dyn Fn() -> String,
    patch: &'a dyn Fn() -> String,
}

impl<'a> Targets<'a> {
    /// The data folder, and the files; the one after `--json` in whichever order they stand.
    fn of(args: &'a Args, context: &Context) -> Outcome<(PathBuf, Self)> {
        let (data, json) = match args.paths.as_slice() {
            [data] => (data, args.json_file.clone()),
            [a, b] if context.out.json && b.is_dir() && !a.is_dir() => (b, Some(a.clone())),
            [a, b, ..] if context.out.json => (a, Some(b.clone())),
            _ => {
                return Err(Failure::say(
                    Exit::Usage,
                    "give one data set folder, or DATA --json FILE",
                ));
            }
        };
        let targets = Self {
            html: args.output.as_deref(),
            json,
            markdown: args.markdown.as_deref(),
            patch: args.patch.as_deref(),
        };
        Ok((data.clone(), targets))
    }

    /// Told before a search of minutes, not after it.
    fn must_be_free(&self, force: bool) -> Outcome {
        let asked = [self.html, self.json.as_deref(), self.markdown, self.patch];
        for path in asked.into_iter().flatten() {
            disk::must_be_free(path, force)?;
        }
        Ok(())
    }

    /// The first of the report files: what stands beside the report gets its name.
    fn beside(&self) -> Option<PathBuf> {
        let report = self.html.or(self.json.as_deref()).or(self.markdown);
        report.map(Path::to_owned)
    }

    /// Writes the files, prints the verdict, and tells a script when it is that of a stopped search.
    fn write(&self, verdict: &Verdict, texts: &Texts<'_>, context: &Context) -> Outcome {
        let other = |e| Failure::new(Exit::Other, anyhow::Error::new(e));
        let markdown = gap::report::markdown(verdict, texts.subject);
        let put = |path: Option<&Path>, text: &dyn Fn() -> String| -> Outcome {
            let Some(path) = path else { return Ok(()) };
            write(path, &text())?;
            context.out.wrote(path);
            Ok(())
        };
        let json = serde_json::to_string_pretty(verdict).map_err(other)?;
        put(self.html, texts.html)?;
        put(self.json.as_deref(), &|| json.clone())?;
        put(self.markdown, &|| markdown.clone())?;
        put(self.patch, texts.patch)?;
        if let (Some(report), Some(next)) = (self.beside(), &verdict.next_experiment)
            && let Some(file) = &next.gait
        {
            context.out.wrote(&report.with_file_name(file));
        }
        let value = serde_json::to_value(verdict).map_err(other)?;
        context.out.result("rb.gap/1", value, || markdown);
        if interrupt::pressed() {
            let message = match verdict.partial {
                true => "Ctrl-C: the search was stopped, the verdict is partial",
                false => "Ctrl-C came at the end of the search: the verdict is whole",
            };
            return Err(Failure::say(Exit::Interrupted, message));
        }
        Ok(())
    }
}

/// Reads a patch of `gap report --patch`.
fn patch(path: &Path) -> Outcome<State> {
    let text = disk::read_text(path, disk::MAX_TEXT).map_err(|e| {
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
    targets: &Targets<'_>,
    context: &Context,
) -> Outcome {
    let instead = [
        (
            args.baseline.is_some(),
            "--baseline",
            "a whole robot starts from its model.toml",
        ),
        (
            args.time_limit.is_some(),
            "--time-limit",
            "Ctrl-C ends a whole robot's diagnosis, and nothing is written",
        ),
    ];
    if let Some((_, option, instead)) = instead.into_iter().find(|(given, ..)| *given) {
        let message = format!("{option} is for one joint on a bench; {instead}");
        return Err(Failure::say(Exit::Usage, message));
    }
    let settings = gap::whole::Settings {
        seed: args.seed,
        withhold: args.withhold.clone(),
    };
    let calibration = causes::calibration(args.calibration.as_deref(), input.manifest.robot)?;
    let mut d = super::whole::run(data, input, (&settings, &calibration), context)?;
    next::robot(&mut d, targets.beside())?;
    let texts = Texts {
        subject: &input.subject,
        html: &|| d.html(&input.subject),
        patch: &|| d.patch().to_toml(),
    };
    targets.write(d.verdict(), &texts, context)
}

pub(super) fn run(args: &Args, context: &Context) -> Outcome {
    let (data, targets) = Targets::of(args, context)?;
    targets.must_be_free(args.force)?;
    let input = input::read(&data, context)?;
    if input.manifest.joints() > 1 {
        return run_whole(args, &data, &input, &targets, context);
    }
    let calibration = causes::calibration(args.calibration.as_deref(), input.manifest.robot)?;
    let settings = Settings {
        seed: args.seed,
        withhold: args.withhold.clone(),
        baseline: args.baseline.as_deref().map(patch).transpose()?,
    };
    let mut d = {
        let _grace = interrupt::grace("stopping: the verdict so far is written, marked as partial");
        diagnose(&input, (&settings, &calibration), args.time_limit, context)?
    };
    next::bench(&mut d, targets.beside())?;
    let texts = Texts {
        subject: &input.subject,
        html: &|| gap::report::html(&d, &input.subject),
        patch: &|| gap::patch::to_toml(&d),
    };
    targets.write(&d.verdict, &texts, context)
}

fn predict_whole(args: &PredictArgs, input: &Input, context: &Context) -> Outcome {
    let runs = super::whole::predict(&args.data, input, args.patch.as_deref(), context)?;
    write_predicted(args, runs, context)
}

/// Writes the runs below the last names of their files.
fn write_predicted(args: &PredictArgs, runs: Vec<(String, String)>, context: &Context) -> Outcome {
    let own = |(k, (name, text)): (usize, (String, String))| {
        let last = Path::new(&name).file_name();
        let name = last.map_or_else(
            || format!("run{k}.csv"),
            |n| n.to_string_lossy().into_owned(),
        );
        (name, text)
    };
    let files: Vec<(String, String)> = runs.into_iter().enumerate().map(own).collect();
    let written = disk::write_folder(&args.output, &files, args.force)?;
    let written: Vec<String> = written.iter().map(|p| p.display().to_string()).collect();
    let value = serde_json::json!({ "files": written });
    context
        .out
        .result("rb.gap_predict/1", value, || written.join("\n"));
    Ok(())
}

pub(super) fn predict(args: &PredictArgs, context: &Context) -> Outcome {
    if !args.force {
        disk::must_be_empty(&args.output)?;
    }
    let input = input::read(&args.data, context)?;
    if input.manifest.joints() > 1 {
        return predict_whole(args, &input, context);
    }
    let state = match &args.patch {
        Some(path) => patch(path)?,
        None => {
            // A part of a diagnosis predicts nothing.
            let _end = interrupt::at_once("stopped; nothing was written");
            let calibration = causes::calibration(None, input.manifest.robot)?;
            let settings = Settings::default();
            diagnose(&input, (&settings, &calibration), None, context)?.found
        }
    };
    let runs = bench::predicted(&input.manifest, &input.recordings, &state)
        .map_err(|e| Failure::new(Exit::BadFile, anyhow::Error::new(e)))?;
    write_predicted(args, runs, context)
}
