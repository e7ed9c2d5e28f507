//! `rb-host model`

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use files::model::{EffectEntry, Key, Model};
use files::schema::Format;
use physics::Params;
use serde_json::{Value, json};

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::model_file;

/// Show and check robot models; print the JSON Schemas of all files
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Print the JSON Schema of a file format
    Schema {
        /// Format
        #[arg(value_enum)]
        name: Name,
    },
    /// Check model files: keys, values, ranges, and whether the body simulator holds every effect
    Check {
        /// Model files
        #[arg(required = true, value_name = "MODEL.toml")]
        files: Vec<PathBuf>,
    },
    /// Show every value with tolerance and source, and the effects that are on
    Show {
        /// Model file; the shipped hand-tuned model when absent
        #[arg(value_name = "MODEL.toml")]
        file: Option<PathBuf>,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Name {
    /// gait.toml
    Gait,
    /// model.toml
    Model,
    /// robot.toml
    Robot,
    /// dataset.toml
    Dataset,
    /// The JSON of `gap report`
    Verdict,
    /// The JSON of `gap causes`
    Causes,
}

/// Schemas of what a diagnosis says, as published.
const VERDICT: &str = include_str!("../../../docs/schema/gap-1.json");
const CAUSES: &str = include_str!("../../../docs/schema/gap-2.json");

/// Works on model files.
///
/// # Errors
/// Exit code 3 for a file that is refused.
pub fn run(args: &Args, context: &Context) -> Outcome {
    match &args.action {
        Action::Schema { name } => {
            context.out.document(&schema(*name));
            Ok(())
        }
        Action::Check { files } => check(context, files),
        Action::Show { file } => show(context, file.as_deref()),
    }
}

fn schema(name: Name) -> String {
    let format = match name {
        Name::Gait => Format::Gait,
        Name::Model => Format::Model,
        Name::Robot => Format::Robot,
        Name::Dataset => Format::Dataset,
        Name::Verdict => return VERDICT.to_owned(),
        Name::Causes => return CAUSES.to_owned(),
    };
    format!("{:#}\n", format.schema())
}

fn check(context: &Context, paths: &[PathBuf]) -> Outcome {
    let mut worst: Option<Failure> = None;
    for path in paths {
        let checked = model_file::load(Some(path)).and_then(|model| {
            Params::try_from(&model)
                .map_err(|error| {
                    Failure::say(Exit::BadFile, format!("{}: {error}", path.display()))
                })
                .map(|_| model)
        });
        match checked {
            Ok(model) => {
                let changed = changed(&model).count();
                let value = json!({ "file": path, "ok": true, "name": model.name(), "changed": changed, "effects": model.effects().len() });
                context.out.result("rb.model_check/1", value, || {
                    format!(
                        "{}: ok, {changed} values differ from the hand-tuned model, {} effects on",
                        path.display(),
                        model.effects().len()
                    )
                });
            }
            Err(failure) => {
                if context.out.json {
                    let value =
                        json!({ "file": path, "ok": false, "message": failure.to_string() });
                    context.out.result("rb.model_check/1", value, String::new);
                }
                if let Some(earlier) = worst.replace(failure) {
                    context.out.error(&earlier);
                }
            }
        }
    }
    worst.map_or(Ok(()), Err)
}

/// Keys whose value is not the hand-tuned one.
fn changed(model: &Model) -> impl Iterator<Item = Key> {
    Key::ALL
        .into_iter()
        .filter(|key| model.value(*key).to_bits() != key.info().hand.to_bits())
}

fn show(context: &Context, path: Option<&Path>) -> Outcome {
    let model = model_file::load(path)?;
    let values: Vec<Value> = Key::ALL
        .iter()
        .map(|key| {
            let (info, p) = (key.info(), model.parameter(*key));
            json!({
                "key": info.path(), "value": p.value, "tolerance": p.tolerance, "source": p.source, "hand_tuned": info.hand,
                "min": info.min, "max": info.max, "table_ii": info.table_ii, "meaning": info.meaning,
            })
        })
        .collect();
    let effects: Vec<Value> = model.effects().iter().map(effect_json).collect();
    let value = json!({ "name": model.name(), "values": values, "effects": effects });
    context.out.result("rb.model/1", value, || text(&model));
    Ok(())
}

fn effect_json(entry: &EffectEntry) -> Value {
    let info = entry.effect.info();
    let parameters: Vec<Value> = info
        .parameters
        .iter()
        .zip(&entry.parameters)
        .map(|(d, p)| json!({ "key": d.key, "value": p.value, "tolerance": p.tolerance, "source": p.source, "off": d.neutral }))
        .collect();
    json!({ "effect": info.name, "stage": info.stage.name(), "joint": entry.joint, "parameters": parameters, "meaning": info.plain })
}

fn text(model: &Model) -> String {
    let mut out = format!("{}\n\n", model.name());
    let _ = writeln!(
        out,
        "{:29} {:>12} {:>10} {:>12}  II  source",
        "value (* not the hand-tuned)", "", "tolerance", "hand-tuned"
    );
    for key in Key::ALL {
        let (info, p) = (key.info(), model.parameter(key));
        let mark = if changed(model).any(|k| k == key) {
            "*"
        } else {
            " "
        };
        let row = info.table_ii.map_or(String::new(), |row| row.to_string());
        let _ = writeln!(
            out,
            "{mark} {:27} {:>12} {:>10} {:>12}  {row:2}  {}",
            info.path(),
            short(p.value),
            short(p.tolerance),
            short(info.hand),
            p.source
        );
    }
    if model.effects().is_empty() {
        out.push_str("\nno effects are on\n");
    } else {
        out.push_str("\neffects on\n");
    }
    for entry in model.effects() {
        let info = entry.effect.info();
        let joint = entry
            .joint
            .map_or(String::new(), |joint| format!(".joint_{joint}"));
        let _ = writeln!(
            out,
            "  {}{joint}: {} (stage {})",
            info.name,
            info.plain,
            info.stage.name()
        );
        for (d, p) in info.parameters.iter().zip(&entry.parameters) {
            let _ = writeln!(
                out,
                "    {:25} {:>12} {:>10} {:>12}      {}",
                d.key,
                short(p.value),
                short(p.tolerance),
                short(d.neutral),
                p.source
            );
        }
    }
    out
}

/// Six significant digits at most, without a tail.
fn short(value: f64) -> String {
    let rounded: f64 = format!("{value:.5e}").parse().unwrap_or(value);
    rounded.to_string()
}
