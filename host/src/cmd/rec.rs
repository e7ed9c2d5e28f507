//! `rb-host rec`

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::plot;
use crate::recording::beside::{self, Seen};
use crate::recording::check::{self, Severity};
use crate::recording::set::SetFolder;
use crate::recording::{Recording, csv, dataset, folder, joint_names, read};
use crate::searching::frames::Frames;

/// Look into recordings, check them, convert them, draw them
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Show what a recording holds
    Info {
        /// Recording
        file: PathBuf,
    },
    /// Check a recording (damage, gaps, set-points of the attached gait) or a data set folder (every file it names). Exit 8 when something is wrong
    Check {
        /// Recordings, or folders with a dataset.toml
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
    /// Print samples and events as text, or with --json one object per line
    Cat {
        /// Recording
        file: PathBuf,
        /// Only this run, from 1
        #[arg(long, value_name = "N")]
        run: Option<u32>,
        /// Only events
        #[arg(long)]
        events: bool,
    },
    /// Convert to CSV, to a data set folder, or take the attached files out
    Convert {
        /// Recording
        file: PathBuf,
        /// Form
        #[arg(long, value_enum)]
        to: Form,
        /// File (csv: one run) or folder (dataset, attachments)
        #[arg(short, long, value_name = "PATH")]
        output: PathBuf,
        /// The run for csv, from 1
        #[arg(long, value_name = "N", default_value_t = 1)]
        run: u32,
        /// Replace an existing file
        #[arg(long)]
        force: bool,
    },
    /// Give a run of a data set its film: laid on the robot's clock by the first motion, base poses with it
    Film {
        /// Data set folder, as `run --dataset` writes it
        dataset: PathBuf,
        /// Name of the run
        run: String,
        /// Folder of silhouettes with index.csv (`t_s,file`), times on the camera's clock
        film: PathBuf,
        /// Base poses on the camera's clock: a CSV with the columns t_s,base_x_m,...,base_qz
        #[arg(long, value_name = "CSV")]
        track: Option<PathBuf>,
    },
    /// Draw a run: film strip, set-points against positions, currents, voltage (SVG)
    Plot {
        /// Recording
        file: PathBuf,
        /// Picture to write; default: the recording's name with .svg
        #[arg(short, long, value_name = "FILE")]
        output: Option<PathBuf>,
        /// The run, from 1
        #[arg(long, value_name = "N", default_value_t = 1)]
        run: u32,
        /// Replace an existing picture
        #[arg(long)]
        force: bool,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Form {
    Csv,
    Dataset,
    Attachments,
}

/// Works on recordings.
///
/// # Errors
/// Exit codes 1, 3, 8.
pub fn run(args: &Args, context: &Context) -> Outcome {
    match &args.action {
        Action::Info { file } => info(context, file),
        Action::Check { files } => check_all(context, files),
        Action::Cat { file, run, events } => cat(context, file, *run, *events),
        Action::Convert {
            file,
            to,
            output,
            run,
            force,
        } => convert(context, file, *to, output, *run, *force),
        Action::Film {
            dataset,
            run,
            film,
            track,
        } => add_film(context, dataset, run, film, track.as_deref()),
        Action::Plot {
            file,
            output,
            run,
            force,
        } => draw(context, file, output.as_deref(), *run, *force),
    }
}

fn add_film(
    context: &Context,
    dataset: &Path,
    run: &str,
    film: &Path,
    track: Option<&Path>,
) -> Outcome {
    if !dataset.join("dataset.toml").exists() {
        let message = format!("{} holds no dataset.toml", dataset.display());
        return Err(Failure::say(Exit::BadFile, message)
            .hint("record it with `rb-host run GAIT.toml --dataset DIR`"));
    }
    let set = SetFolder::open(dataset, "", "", "")?;
    let seen = Seen {
        film: Frames::read(film)?,
        base: track
            .map(beside::read_track)
            .transpose()?
            .unwrap_or_default(),
        imu: Vec::new(),
    };
    let laid = set.add_film(run, seen)?;
    let alignment = laid.alignment.as_ref().map(beside::alignment_json);
    let value = json!({ "run": run, "frames": laid.film.frames.len(), "poses": laid.base.len(), "sync": alignment });
    context.out.result("rb.rec_film/1", value, || {
        let shift = laid.alignment.map_or(0.0, |a| a.offset_s);
        let likeness = laid.alignment.map_or(0.0, |a| a.correlation);
        format!(
            "{run}: {} frames, {} poses; clock shift {shift:.3} s by the first motion (likeness {likeness:.2})",
            laid.film.frames.len(),
            laid.base.len()
        )
    });
    Ok(())
}

fn load(context: &Context, path: &Path) -> Outcome<Recording> {
    let recording = read(path).map_err(|e| Failure::new(Exit::BadFile, e))?;
    for damage in &recording.damage {
        context.out.warn(format_args!(
            "{}: offset {}: {}",
            path.display(),
            damage.offset,
            damage.kind
        ));
    }
    Ok(recording)
}

fn info(context: &Context, path: &Path) -> Outcome {
    let recording = load(context, path)?;
    let runs: Vec<Value> = recording
        .runs
        .iter()
        .map(|r| {
            json!({
                "run": r.run, "gait": r.start.as_ref().map(|s| &s.gait), "samples": r.samples.len(), "events": r.events.len(),
                "end": r.end.as_ref().map(|e| json!({
                    "reason": e.reason, "cycles": e.cycles, "holds": e.holds, "samples": e.samples, "recorded": e.recorded,
                    "dropped_by_module": e.dropped_by_module, "lost_on_link": e.lost_on_link, "reconnects": e.reconnects,
                    "setpoint_crc32c": format!("{:08x}", e.setpoint_crc32c) })),
            })
        })
        .collect();
    let channels: Vec<Value> = recording
        .channels
        .iter()
        .map(|c| json!({ "topic": c.topic, "schema": c.schema, "encoding": c.encoding, "messages": c.messages }))
        .collect();
    let attachments: Vec<Value> = recording
        .attachments
        .iter()
        .map(|a| json!({ "name": a.name, "bytes": a.data.len() }))
        .collect();
    let damage: Vec<Value> = recording
        .damage
        .iter()
        .map(|d| json!({ "offset": d.offset, "what": d.kind.to_string() }))
        .collect();
    let value = json!({
        "profile": recording.profile, "library": recording.library, "about": recording.about, "channels": channels,
        "attachments": attachments, "runs": runs, "damage": damage,
    });
    context
        .out
        .result("rb.rec_info/1", value, || info_words(&recording));
    Ok(())
}

fn info_words(recording: &Recording) -> String {
    let mut out = format!(
        "profile {}, written by {}\n",
        recording.profile, recording.library
    );
    for (key, value) in &recording.about {
        out.push_str(&format!("{key:16} {value}\n"));
    }
    for c in &recording.channels {
        let span = c.span_ns.map_or(String::new(), |(a, b)| {
            format!(", {:.2} s", (b - a) as f64 / 1e9)
        });
        out.push_str(&format!(
            "{:16} {} messages of {} ({}){span}\n",
            c.topic, c.messages, c.schema, c.encoding
        ));
    }
    for a in &recording.attachments {
        out.push_str(&format!(
            "attached         {} ({} bytes)\n",
            a.name,
            a.data.len()
        ));
    }
    for run in &recording.runs {
        let gait = run.start.as_ref().map_or("?", |s| s.gait.as_str());
        let end = run.end.as_ref().map_or_else(
            || "end not recorded".to_owned(),
            |e| {
                format!(
                    "{}, {} holds, {} dropped, {} lost, {} reconnects",
                    e.reason, e.holds, e.dropped_by_module, e.lost_on_link, e.reconnects
                )
            },
        );
        out.push_str(&format!(
            "run {:<12} {gait}: {} samples, {} events, {end}\n",
            run.run + 1,
            run.samples.len(),
            run.events.len()
        ));
    }
    out
}

fn check_all(context: &Context, paths: &[PathBuf]) -> Outcome {
    let mut problems = 0;
    for path in paths {
        if path.is_dir() {
            problems += check_folder(context, path);
            continue;
        }
        let recording = read(path).map_err(|e| Failure::new(Exit::BadFile, e))?;
        let gait = recording
            .text("gait.toml")
            .and_then(|text| files::gait::parse("gait.toml", text).ok());
        let findings = check::check(&recording, gait.as_ref());
        problems += findings
            .iter()
            .filter(|f| f.severity == Severity::Problem)
            .count();
        let rows: Vec<Value> = findings
            .iter()
            .map(|f| json!({ "problem": f.severity == Severity::Problem, "run": f.run, "text": f.kind.to_string() }))
            .collect();
        let samples: usize = recording.runs.iter().map(|r| r.samples.len()).sum();
        let value = json!({ "file": path, "samples": samples, "findings": rows });
        context.out.result("rb.rec_check/1", value, || {
            let mut out = format!("{}: {samples} samples", path.display());
            if recording.is_emulated() {
                out.push_str(" of an emulated robot");
            }
            for f in &findings {
                let word = if f.severity == Severity::Problem {
                    "PROBLEM"
                } else {
                    "note"
                };
                let run = f.run.map_or(String::new(), |r| format!("run {}: ", r + 1));
                out.push_str(&format!("\n  {word}: {run}{}", f.kind));
            }
            if findings.is_empty() {
                out.push_str(", whole and complete");
            }
            out
        });
    }
    match problems {
        0 => Ok(()),
        n => Err(Failure::say(Exit::Check, format!("{n} problems"))),
    }
}

/// Problems in a data set folder.
fn check_folder(context: &Context, path: &Path) -> usize {
    let report = folder::check(path);
    let row = |problem: bool| move |text: &String| json!({ "problem": problem, "run": null, "text": text });
    let rows: Vec<Value> = (report.problems.iter().map(row(true)))
        .chain(report.notes.iter().map(row(false)))
        .collect();
    let value = json!({ "file": path, "runs": report.runs, "rows": report.rows, "findings": rows });
    context.out.result("rb.rec_check/1", value, || {
        let mut out = format!(
            "{}: {} runs, {} rows",
            path.display(),
            report.runs,
            report.rows
        );
        let lines = (report.problems.iter().map(|t| ("PROBLEM", t)))
            .chain(report.notes.iter().map(|t| ("note", t)));
        for (word, text) in lines {
            out.push_str(&format!("\n  {word}: {text}"));
        }
        if report.problems.is_empty() && report.notes.is_empty() {
            out.push_str(", whole");
        }
        out
    });
    report.problems.len()
}

fn cat(context: &Context, path: &Path, only: Option<u32>, events: bool) -> Outcome {
    let recording = load(context, path)?;
    if !events {
        let first = recording.runs.iter().find_map(|run| run.samples.first());
        let names = joint_names(first.map_or(0, |sample| sample.joints.len())).join(", ");
        context.out.say(format_args!(
            "device time, cycle, then set-point/position in rad of {names}"
        ));
    }
    for run in recording
        .runs
        .iter()
        .filter(|r| only.is_none_or(|n| n == r.run + 1))
    {
        for e in &run.events {
            let value = json!({ "run": run.run, "t_s": e.t_us as f64 / 1e6, "source": e.source, "kind": e.kind, "text": e.text });
            context.out.result("rb.event/1", value, || {
                format!(
                    "{:12.6} s  {} {:16} {}",
                    e.t_us as f64 / 1e6,
                    e.source,
                    e.kind,
                    e.text
                )
            });
        }
        for s in run.samples.iter().filter(|_| !events) {
            let positions: Vec<Option<f64>> = s
                .joints
                .iter()
                .map(|j| j.feedback.map(|f| f.position_rad))
                .collect();
            let setpoints: Vec<f64> = s.joints.iter().map(|j| j.setpoint_rad).collect();
            let value = json!({
                "run": run.run, "t_s": s.t_us as f64 / 1e6, "cycle": s.cycle, "hold": s.hold, "approach": s.approach,
                "setpoint_rad": setpoints, "position_rad": positions,
            });
            context.out.result("rb.sample/1", value, || {
                let cells = s.joints.iter().map(|j| {
                    let position = j
                        .feedback
                        .map_or("none".to_owned(), |f| format!("{:.6}", f.position_rad));
                    format!("{:.6}/{position}", j.setpoint_rad)
                });
                format!(
                    "{:12.6} s  {:5} {}",
                    s.t_us as f64 / 1e6,
                    s.cycle,
                    cells.collect::<Vec<_>>().join(" ")
                )
            });
        }
    }
    Ok(())
}

fn pick(recording: &Recording, run: u32) -> Outcome<&crate::recording::RunData> {
    let found = recording
        .runs
        .iter()
        .find(|r| r.run + 1 == run && !r.samples.is_empty());
    found.ok_or_else(|| {
        let runs: Vec<String> = recording
            .runs
            .iter()
            .map(|r| (r.run + 1).to_string())
            .collect();
        let message = match recording.foreign_topics() {
            Some(topics) => format!(
                "this is an MCAP file of another program (topics: {topics}); only recordings of rb-host are read"
            ),
            None if runs.is_empty() => "the recording holds no run".to_owned(),
            None => format!(
                "no samples of run {run}; runs in the file: {}",
                runs.join(", ")
            ),
        };
        Failure::say(Exit::BadFile, message)
    })
}

fn convert(
    context: &Context,
    path: &Path,
    to: Form,
    output: &Path,
    run: u32,
    force: bool,
) -> Outcome {
    let recording = load(context, path)?;
    let written = match to {
        Form::Csv => {
            disk::write_new(
                output,
                csv::to_csv(pick(&recording, run)?).as_bytes(),
                force,
            )?;
            vec![output.to_owned()]
        }
        Form::Dataset => {
            let name = path
                .file_stem()
                .and_then(|s| s.to_str())
                .unwrap_or("recording");
            disk::must_be_empty(output)?;
            let files = dataset::export(&recording, name);
            let files = files.map_err(|error| Failure::new(Exit::Other, error))?;
            disk::write_folder(output, &files, false)?
        }
        Form::Attachments => attachments(&recording, output, force)?,
    };
    context
        .out
        .result("rb.rec_convert/1", json!({ "files": written }), || {
            written
                .iter()
                .map(|p| p.display().to_string())
                .collect::<Vec<_>>()
                .join("\n")
        });
    Ok(())
}

/// Writes the attached files under their own last name, whatever path they claim.
fn attachments(recording: &Recording, folder: &Path, force: bool) -> Outcome<Vec<PathBuf>> {
    disk::make_folder(folder)?;
    let mut written = Vec::new();
    for attachment in &recording.attachments {
        let Some(name) = Path::new(&attachment.name).file_name() else {
            continue;
        };
        let path = folder.join(name);
        disk::write_new(&path, &attachment.data, force)?;
        written.push(path);
    }
    Ok(written)
}

fn draw(context: &Context, path: &Path, output: Option<&Path>, run: u32, force: bool) -> Outcome {
    let recording = load(context, path)?;
    let output = output.map_or_else(|| path.with_extension("svg"), Path::to_owned);
    disk::must_be_free(&output, force)?;
    let svg = plot::run_svg(
        pick(&recording, run)?,
        &context.robot_model(),
        recording.is_emulated(),
    );
    disk::write_new(&output, svg.as_bytes(), force)?;
    context
        .out
        .result("rb.rec_plot/1", json!({ "file": output }), || {
            format!("wrote {}", output.display())
        });
    Ok(())
}
