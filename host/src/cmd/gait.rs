//! `rb-host gait`

use std::path::{Path, PathBuf};

use control::gait::Gait;
use control::machine::Machine;
use protocol::link::WireGait;
use serde_json::{Value, json};

use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::gait_file::{self, GaitCheck};
use crate::link::text;
use crate::plot;
use crate::robot_file;
use crate::upload;

/// Make, check, show, convert and compare gait files
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Write a small gait to start from
    New {
        /// File to write
        file: PathBuf,
        /// Name of the gait; default: the file's name
        #[arg(long)]
        name: Option<String>,
        /// Replace an existing file
        #[arg(long)]
        force: bool,
    },
    /// Check files as the robot would: values, joint speeds, self-collision over the whole run
    Check {
        /// Robot to check for, a robot.toml; default: the meta-module
        #[arg(long, value_name = "FILE")]
        robot: Option<PathBuf>,
        /// Gait files; - is standard input
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
    /// Show a gait, its check, and with --plot its set-points
    Show {
        /// Gait file
        file: PathBuf,
        /// Write the set-points of the run as a picture (SVG)
        #[arg(long, value_name = "FILE.svg")]
        plot: Option<PathBuf>,
        /// Replace an existing picture
        #[arg(long)]
        force: bool,
    },
    /// Write a gait in another form
    Convert {
        /// Gait file
        file: PathBuf,
        /// Form: toml (canonical), json, or hex (the bytes on the wire)
        #[arg(long, value_enum)]
        to: Form,
        /// File to write; default: standard output
        #[arg(short, long, value_name = "FILE")]
        output: Option<PathBuf>,
        /// Replace an existing file
        #[arg(long)]
        force: bool,
    },
    /// Compare two gaits; exit 8 if they differ
    Diff {
        /// One gait file
        a: PathBuf,
        /// The other
        b: PathBuf,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Form {
    Toml,
    Json,
    Hex,
}

/// Works on gait files.
///
/// # Errors
/// Exit codes 1, 3, 7, 8.
pub fn run(args: &Args, context: &Context) -> Outcome {
    match &args.action {
        Action::New { file, name, force } => new(context, file, name.as_deref(), *force),
        Action::Check { files, robot } => check(context, files, robot.as_deref()),
        Action::Show { file, plot, force } => show(context, file, plot.as_deref(), *force),
        Action::Convert {
            file,
            to,
            output,
            force,
        } => convert(context, file, *to, output.as_deref(), *force),
        Action::Diff { a, b } => diff(context, a, b),
    }
}

const TEMPLATE: &str = include_str!("gait/new.toml");

fn new(context: &Context, file: &Path, name: Option<&str>, force: bool) -> Outcome {
    let stem = file.file_stem().and_then(|s| s.to_str()).unwrap_or("gait");
    let quoted = toml::Value::String(name.unwrap_or(stem).to_owned()).to_string();
    let text = TEMPLATE.replacen("\"NAME\"", &quoted, 1);
    files::gait::parse(&file.display().to_string(), &text)?;
    disk::write_new(file, text.as_bytes(), force)?;
    context.out.say(format_args!(
        "wrote {}; check it with `rb-host gait check {}`",
        file.display(),
        file.display()
    ));
    Ok(())
}

fn check(context: &Context, paths: &[PathBuf], robot: Option<&Path>) -> Outcome {
    let machine = robot
        .map(robot_file::machine)
        .transpose()?
        .unwrap_or_default();
    let mut worst: Option<Failure> = None;
    for path in paths {
        let result = gait_file::load(path).and_then(|gait| {
            upload::host_check(context, &gait, path, &machine).map(|check| (gait, check))
        });
        match result {
            Ok((gait, check)) => {
                let value = json!({ "file": path, "ok": true, "name": gait.name(), "check": check_json(&check) });
                context.out.result("rb.gait_check/1", value, || {
                    format!("{}: ok, {}", path.display(), check.words())
                });
            }
            Err(failure) => {
                if context.out.json {
                    let value =
                        json!({ "file": path, "ok": false, "message": failure.to_string() });
                    context.out.result("rb.gait_check/1", value, String::new);
                }
                if let Some(earlier) = worst.replace(failure) {
                    context.out.error(&earlier);
                }
            }
        }
    }
    worst.map_or(Ok(()), Err)
}

fn check_json(check: &GaitCheck) -> Value {
    json!({
        "moves": check.moves, "clearance_m": check.clearance_m, "speed_share": check.speed_share,
        "fastest_joint": check.fastest_joint,
    })
}

fn show(context: &Context, path: &Path, plot: Option<&Path>, force: bool) -> Outcome {
    let gait = gait_file::load(path)?;
    let verdict = gait_file::check(&gait, &Machine::default());
    if let Some(picture) = plot {
        disk::write_new(picture, plot::gait_svg(&gait).as_bytes(), force)?;
        context.out.say(format_args!("wrote {}", picture.display()));
    }
    let digest = text::hex(&WireGait::from(&gait).digest().0);
    let value = json!({
        "name": gait.name(), "digest": digest, "gait": gait_json(&gait),
        "check": match &verdict { Ok(c) => check_json(c), Err(unfit) => json!({ "unfit": unfit.to_string() }) },
    });
    context.out.result("rb.gait/1", value, || {
        let mut out = format!(
            "{} (digest {digest})\n{} Hz, {} s, rate {} 1/s, {} links\n\n{:8} {:>10} {:>10} {:>10}\n",
            gait.name(), gait.frequency_hz(), gait.duration_s(), gait.rate_a_per_s(), gait.links().len(),
            "joint", "R deg", "X deg", "phase deg"
        );
        for (k, o) in gait.oscillators().iter().enumerate() {
            let name = control::robot::JOINT_NAMES.get(k).copied().unwrap_or("?");
            let deg = [o.amplitude_rad, o.offset_rad, o.initial_phase_rad].map(f32::to_degrees);
            out.push_str(&format!("{name:8} {:>10.2} {:>10.2} {:>10.2}\n", deg[0], deg[1], deg[2]));
        }
        out.push('\n');
        out.push_str(&match &verdict {
            Ok(check) => check.words(),
            Err(unfit) => format!("the robot would refuse it: {unfit}"),
        });
        out
    });
    Ok(())
}

/// The shortest decimal of a single-precision number, without the tail that double precision would print.
fn plain(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}

fn gait_json(gait: &Gait) -> Value {
    let oscillators: Vec<Value> = gait
        .oscillators()
        .iter()
        .map(|o| json!({ "amplitude_rad": plain(o.amplitude_rad), "offset_rad": plain(o.offset_rad), "initial_phase_rad": plain(o.initial_phase_rad) }))
        .collect();
    let links: Vec<Value> = gait
        .links()
        .iter()
        .map(|l| json!({ "from": l.from, "to": l.to, "weight": plain(l.weight), "phase_lag_rad": plain(l.phase_lag_rad) }))
        .collect();
    json!({
        "format": files::gait::FORMAT, "name": gait.name(), "frequency_hz": plain(gait.frequency_hz()),
        "duration_s": plain(gait.duration_s()), "rate_a_per_s": plain(gait.rate_a_per_s()), "oscillator": oscillators, "link": links,
    })
}

fn convert(
    context: &Context,
    path: &Path,
    to: Form,
    output: Option<&Path>,
    force: bool,
) -> Outcome {
    let gait = gait_file::load(path)?;
    let mut text = match to {
        Form::Toml => files::gait::to_toml(&gait),
        Form::Json => gait_json(&gait).to_string(),
        Form::Hex => {
            let mut buffer = [0; protocol::link::gait::MAX_GAIT];
            text::hex(WireGait::from(&gait).to_bytes(&mut buffer))
        }
    };
    if !text.ends_with('\n') {
        text.push('\n');
    }
    match output {
        Some(file) => {
            disk::write_new(file, text.as_bytes(), force)?;
            context.out.say(format_args!("wrote {}", file.display()));
            Ok(())
        }
        None => {
            context.out.document(&text);
            Ok(())
        }
    }
}

fn diff(context: &Context, a: &Path, b: &Path) -> Outcome {
    let (left, right) = (gait_file::load(a)?, gait_file::load(b)?);
    let (left_text, right_text) = (files::gait::to_toml(&left), files::gait::to_toml(&right));
    let keys: Vec<&str> = left_text.lines().filter(|l| !l.is_empty()).collect();
    let others: Vec<&str> = right_text.lines().filter(|l| !l.is_empty()).collect();
    let pairs: Vec<(&str, &str)> = (0..keys.len().max(others.len()))
        .map(|i| {
            (
                keys.get(i).copied().unwrap_or(""),
                others.get(i).copied().unwrap_or(""),
            )
        })
        .filter(|(l, r)| l != r)
        .collect();
    let value = json!({ "equal": left == right, "differences": pairs });
    context.out.result("rb.gait_diff/1", value, || {
        let lines: Vec<String> = pairs.iter().map(|(l, r)| format!("- {l}\n+ {r}")).collect();
        if left == right {
            "equal, bit for bit".to_owned()
        } else {
            lines.join("\n")
        }
    });
    if left == right {
        return Ok(());
    }
    Err(Failure::say(
        Exit::Check,
        format!("the gaits differ in {} lines", pairs.len()),
    ))
}
