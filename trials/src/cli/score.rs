//! `rb-trials score`: verdicts against labels.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

use super::write;
use crate::label;
use crate::score::{Case, Figure, failures, laws, left_out, table};

/// Options of `score`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Sealed labels of one or more suites
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    labels: Vec<PathBuf>,
    /// Verdicts of each of these suites, in the same order
    #[arg(long, required = true, num_args = 1.., value_name = "DIR")]
    verdicts: Vec<PathBuf>,
    /// Chi-square beyond nominal numbers from which on a cause can be named
    #[arg(long, default_value_t = 25.0)]
    least: f64,
    /// The planted effects were withheld
    #[arg(long)]
    left_out: bool,
    /// Also write the figures here, as JSON
    #[arg(long, value_name = "FILE")]
    json_file: Option<PathBuf>,
    /// Write how far sizes are off by stage here, for `rb-host gap calibrate --laws`
    #[arg(long, value_name = "FILE")]
    laws: Option<PathBuf>,
    /// Leave out the list of cases that failed
    #[arg(long)]
    short: bool,
}

/// Cases that have a verdict, and how many have none.
fn opened(args: &Args) -> Result<(Vec<Case>, Vec<String>, usize)> {
    if args.labels.len() != args.verdicts.len() {
        bail!(
            "{} files of labels and {} folders of verdicts; give one folder a file",
            args.labels.len(),
            args.verdicts.len()
        );
    }
    let (mut cases, mut seals, mut missing) = (Vec::new(), Vec::new(), 0);
    for (labels, verdicts) in args.labels.iter().zip(&args.verdicts) {
        let (labels, seal) = label::open(labels)?;
        seals.push(seal);
        for label in labels.cases {
            let path = verdicts.join(format!("{}.json", label.name));
            let Ok(text) = std::fs::read_to_string(&path) else {
                missing += usize::from(!args.left_out || label.kind == "single");
                continue;
            };
            let verdict: Value = serde_json::from_str(&text)
                .with_context(|| format!("{} is no verdict", path.display()))?;
            cases.push(Case::new(label, verdict));
        }
    }
    Ok((cases, seals, missing))
}

/// Scores.
pub(super) fn run(args: &Args) -> Result<()> {
    let (cases, seals, missing) = opened(args)?;
    let mut sides: BTreeMap<&str, Vec<&Case>> = BTreeMap::new();
    for case in &cases {
        sides
            .entry(case.label.engine.as_str())
            .or_default()
            .push(case);
        let foreign = case.label.engine != "emulator";
        if foreign {
            sides.entry("other engines").or_default().push(case);
        }
    }
    if sides.len() == 2 {
        sides.remove("other engines");
    }
    println!(
        "{} cases, {missing} without a verdict; labels sealed as {}",
        cases.len(),
        seals.join(", ")
    );
    let mut all =
        json!({ "labels_sha256": seals, "cases": cases.len(), "without_verdict": missing });
    for (side, cases) in &sides {
        let own = *side == "emulator";
        let figures = if args.left_out {
            left_out(cases, own, args.least)
        } else {
            table(cases, own, args.least)
        };
        println!(
            "\n## {side}: {} cases\n\n{}{}",
            cases.len(),
            Figure::HEAD,
            text(&figures)
        );
        let rows = figures.iter().map(|f| {
            json!({ "figure": f.name, "value": f.value, "count": f.count, "ci95": f.interval, "target": f.target })
        });
        all["engines"][side] = rows.collect();
    }
    if !args.short && !args.left_out {
        let cases: Vec<&Case> = cases.iter().collect();
        println!("\nFailed:\n");
        for line in failures(&cases, args.least) {
            println!("- {line}");
        }
    }
    if let Some(path) = &args.laws {
        let all: Vec<_> = cases.iter().flat_map(Case::sized).collect();
        write(path, serde_json::to_string_pretty(&laws(&all))? + "\n")?;
    }
    match &args.json_file {
        Some(path) => write(path, all.to_string() + "\n"),
        None => Ok(()),
    }
}

fn text(figures: &[Figure]) -> String {
    figures.iter().map(Figure::line).collect()
}
