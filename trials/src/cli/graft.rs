//! `rb-trials graft`: exact faults of the measurement layer put onto real recordings, and whether the diagnosis finds
//! them.
//!
//! A real recording has a gap of its own. So the motions of a data set are split in two: the diagnosis of the first
//! half (`gap report --patch`) is the baseline. The second half gets the graft and is diagnosed on top of that
//! baseline (`gap report --baseline`), in a process that is given the two files and nothing else. A graft counts as
//! found when the first effect that the ungrafted second half does not have already is the grafted one. Ungrafted
//! halves count as right when nothing is named on top of the baseline, lost readings when nothing is named that the
//! ungrafted half has not.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use files::dataset::{Manifest, Recording};
use hil_sim::rng::Rng;
use serde_json::Value;

use super::{each, host, write};
use crate::graft::{self as grafts, Graft};
use crate::score::Figure;

/// Options of `gap graft`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folders with recordings of one joint each; one that does not exist is skipped and said so
    #[arg(required = true, value_name = "DATA")]
    data: Vec<PathBuf>,
    /// Folder for cases, labels and verdicts; a second run there goes on where the first one stopped
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Cases; every fourth has no graft or one that must not matter
    #[arg(long, default_value_t = 30)]
    cases: usize,
    /// Ways to split each data set into baseline and test motions
    #[arg(long, default_value_t = 2)]
    splits: usize,
    /// Longest part of a run that is used, s
    #[arg(long, default_value_t = 30.0)]
    longest_s: f64,
    /// Seed of splits, kinds and sizes
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Processes at once; 0 = one per core
    #[arg(long, default_value_t = 0)]
    jobs: usize,
    /// The program that diagnoses; absent = rb-host beside this one
    #[arg(long, value_name = "FILE")]
    host: Option<PathBuf>,
}

/// A data set with the text blocks of its manifest.
struct Source {
    head: String,
    /// Text of each `[[run]]` block, in order of the runs, without its role.
    blocks: Vec<String>,
    manifest: Manifest,
    recordings: Vec<Recording>,
    gaits: Vec<String>,
}

fn source(folder: &Path) -> Result<Source> {
    let path = folder.join("dataset.toml");
    let text =
        fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let (manifest, _) = Manifest::parse(&path.display().to_string(), &text)?;
    if manifest.joints() != 1 {
        bail!("{}: grafts want recordings of one joint", folder.display());
    }
    let recording = |run: &files::dataset::Run| {
        let csv = folder.join(&run.file);
        let rows =
            fs::read_to_string(&csv).with_context(|| format!("cannot read {}", csv.display()))?;
        Ok(Recording::parse(&run.file, &rows, &manifest)?.0)
    };
    let recordings = manifest.runs.iter().map(recording).collect::<Result<_>>()?;
    let mut parts = text.split("[[run]]");
    let head = parts.next().unwrap_or_default().to_owned();
    let without_role = |block: &str| {
        let kept = block
            .lines()
            .filter(|l| !l.trim_start().starts_with("role"));
        kept.collect::<Vec<_>>().join("\n")
    };
    let mut gaits: Vec<String> = manifest.runs.iter().map(|r| r.gait.clone()).collect();
    gaits.sort();
    gaits.dedup();
    if gaits.len() < 4 {
        bail!(
            "{}: fewer than four motions cannot be split",
            folder.display()
        );
    }
    Ok(Source {
        head,
        blocks: parts.map(without_role).collect(),
        manifest,
        recordings,
        gaits,
    })
}

/// One half of a data set: which gaits are in it.
struct Half<'a> {
    source: &'a Source,
    gaits: Vec<&'a str>,
    longest_s: f64,
}

impl Half<'_> {
    /// Root mean square of what a graft changes in the set-points.
    fn size(&self, graft: Graft) -> f64 {
        let runs = self.source.manifest.runs.iter();
        let (sum, count) = runs
            .zip(&self.source.recordings)
            .filter(|(run, _)| self.gaits.contains(&run.gait.as_str()))
            .map(|(_, recording)| grafts::change(recording, graft, self.longest_s))
            .fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        (sum / f64::max(count, 1.0)).sqrt()
    }

    /// Writes the half with a graft into `folder`.
    fn write(&self, folder: &Path, graft: Graft, seed: u64) -> Result<()> {
        let mut text = self.source.head.clone();
        let runs = self.source.manifest.runs.iter();
        for ((run, block), recording) in runs.zip(&self.source.blocks).zip(&self.source.recordings)
        {
            if !self.gaits.contains(&run.gait.as_str()) {
                continue;
            }
            text.push_str("[[run]]");
            text.push_str(block);
            text.push('\n');
            let motion = run.bench.motion;
            let csv = grafts::csv(recording, motion, graft, self.longest_s, seed);
            write(&folder.join(&run.file), &csv)?;
        }
        write(&folder.join("dataset.toml"), &text)
    }
}

/// A graft is large enough to be found when it changes the set-points by more than this many remaining errors.
const DETECTABLE: f64 = 2.0;

/// The two halves of split `split`: motions of the baseline, motions of the test.
fn halves(source: &Source, split: u64, longest_s: f64) -> [Half<'_>; 2] {
    let mut order: Vec<&str> = source.gaits.iter().map(String::as_str).collect();
    let mut rng = Rng::new(split, 0x6F, 0);
    for k in (1..order.len()).rev() {
        order.swap(k, (rng.uniform() * (k + 1) as f64) as usize % (k + 1));
    }
    let test = order.split_off(order.len() / 2);
    [order, test].map(|gaits| Half {
        source,
        gaits,
        longest_s,
    })
}

/// Diagnoses `folder` on top of a baseline, or makes one.
fn report(host: &Path, folder: &Path, verdict: &Path, more: Option<(&str, PathBuf)>) -> Result<()> {
    let file = more.as_ref().map(|m| m.1.to_string_lossy().into_owned());
    let more: Vec<&str> = more.iter().map(|m| m.0).chain(file.as_deref()).collect();
    if super::diagnose(host, folder, verdict, &more)? {
        return Ok(());
    }
    bail!(
        "the diagnosis of {} failed; run `rb-host gap report` on it",
        folder.display()
    )
}

/// One split of one data set on disk.
struct Split {
    name: String,
    folder: PathBuf,
}

impl Split {
    fn baseline(&self) -> PathBuf {
        self.folder.join("baseline.toml")
    }

    fn reference(&self) -> PathBuf {
        self.folder.join("ungrafted.json")
    }
}

fn read(path: &Path) -> Value {
    let text = fs::read_to_string(path).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or(Value::Null)
}

pub(super) fn run(args: &Args) -> Result<()> {
    let host = host(args.host.as_ref())?;
    let mut sources = Vec::new();
    for folder in &args.data {
        if folder.join("dataset.toml").is_file() {
            let name = folder
                .file_name()
                .map_or_else(String::new, |n| n.to_string_lossy().into());
            sources.push((name, source(folder)?));
        } else {
            eprintln!("SKIPPED: no data set at {}", folder.display());
        }
    }
    if sources.is_empty() {
        println!("no recordings, nothing to graft onto");
        return Ok(());
    }
    let halves: Vec<(Split, [Half<'_>; 2])> = sources
        .iter()
        .flat_map(|(name, source)| {
            (0..args.splits.max(1)).map(move |k| {
                let name = format!("{name}_{k}");
                let folder = args.output.join("splits").join(&name);
                let split = args.seed * 1000 + k as u64;
                (
                    Split { name, folder },
                    halves(source, split, args.longest_s),
                )
            })
        })
        .collect();
    println!(
        "{} cases over {} splits of {} data sets",
        args.cases,
        halves.len(),
        sources.len()
    );
    each(halves.len(), args.jobs, |k| {
        prepare(&host, &halves[k].0, &halves[k].1)
    })?;
    each(args.cases, args.jobs, |k| {
        let (split, parts) = &halves[place(k, halves.len())];
        diagnose(args, &host, k, split, &parts[1])
    })?;
    publish(args, &halves)
}

/// Baseline, and what the ungrafted test half has on top of it.
fn prepare(host: &Path, split: &Split, parts: &[Half<'_>; 2]) -> Result<()> {
    let first = split.folder.join("baseline");
    let second = split.folder.join("ungrafted");
    parts[0].write(&first, Graft::None, 0)?;
    parts[1].write(&second, Graft::None, 0)?;
    let verdict = split.folder.join("baseline.json");
    report(host, &first, &verdict, Some(("--patch", split.baseline())))?;
    let baseline = Some(("--baseline", split.baseline()));
    report(host, &second, &split.reference(), baseline)
}

/// Split of a case: every kind of graft comes to every split.
fn place(case: usize, splits: usize) -> usize {
    (case + case / grafts::KINDS) % splits
}

fn graft(args: &Args, case: usize) -> Graft {
    grafts::draw(&mut Rng::new(args.seed, 0x67, case as u64), case)
}

fn diagnose(args: &Args, host: &Path, case: usize, split: &Split, half: &Half<'_>) -> Result<()> {
    let folder = args.output.join("cases").join(format!("graft_{case:03}"));
    let verdict = args.output.join(format!("graft_{case:03}.json"));
    if verdict.exists() {
        return Ok(());
    }
    let seed = args.seed.wrapping_mul(7919).wrapping_add(case as u64);
    half.write(&folder, graft(args, case), seed)?;
    let baseline = Some(("--baseline", split.baseline()));
    report(host, &folder, &verdict, baseline)
}

/// Classes of effects named, in rank order.
fn said(verdict: &Value) -> Vec<Vec<String>> {
    let list = |v: &Value| v.as_array().cloned().unwrap_or_default();
    let text = |v: &Value| v.as_str().unwrap_or("").to_owned();
    list(&verdict["effects"])
        .iter()
        .map(|e| {
            let own = text(&e["effect"]);
            list(&verdict["ambiguous"])
                .iter()
                .map(|a| list(&a["effects"]).iter().map(text).collect::<Vec<_>>())
                .find(|c| c.contains(&own))
                .unwrap_or_else(|| vec![own])
        })
        .collect()
}

/// Whether the verdict names the graft on top of what the ungrafted half has.
fn right(graft: Graft, verdict: &Value, reference: &Value) -> bool {
    let own: Vec<String> = said(reference).into_iter().flatten().collect();
    let mut new = said(verdict)
        .into_iter()
        .filter(|class| !class.iter().any(|e| own.contains(e)));
    match graft.effect() {
        Some(effect) => {
            let whole = said(verdict);
            // An effect that the ungrafted half has too is found again when it now leads.
            let leads = whole.first().is_some_and(|c| c.iter().any(|e| e == effect));
            let known = own.iter().any(|e| e == effect);
            let first = new.next().is_some_and(|c| c.iter().any(|e| e == effect));
            first || (known && leads)
        }
        // What the ungrafted half has by itself is not the doing of lost readings.
        None if matches!(graft, Graft::Loss(_)) => new.next().is_none(),
        None => said(verdict).is_empty(),
    }
}

fn publish(args: &Args, halves: &[(Split, [Half<'_>; 2])]) -> Result<()> {
    let (mut counts, mut large) = ([(0usize, 0usize); 3], (0usize, 0usize));
    let mut rows = String::from(
        "| case | data, split | graft | size | named on top of the baseline | right |\n|---|---|---|---|---|---|\n",
    );
    let mut failures = Vec::new();
    for case in 0..args.cases {
        let (split, parts) = &halves[place(case, halves.len())];
        let verdict = read(&args.output.join(format!("graft_{case:03}.json")));
        if verdict.is_null() {
            continue;
        }
        let graft = graft(args, case);
        let ok = right(graft, &verdict, &read(&split.reference()));
        let group = match (graft, graft.effect()) {
            (_, Some(_)) => 0,
            (Graft::None, None) => 1,
            _ => 2,
        };
        counts[group].0 += usize::from(ok);
        counts[group].1 += 1;
        let left = read(&split.reference())["gap"]["after"].as_f64();
        let size = parts[1].size(graft) / left.unwrap_or(f64::NAN);
        if graft.effect().is_some() && size > DETECTABLE {
            large.0 += usize::from(ok);
            large.1 += 1;
        }
        let named: Vec<String> = said(&verdict).iter().map(|c| c.join("\\|")).collect();
        let line = format!(
            "| {case} | {} | {} | {size:.1} | {} | {} |\n",
            split.name,
            graft.told(),
            named.join(", "),
            if ok { "yes" } else { "no" }
        );
        rows.push_str(&line);
        if !ok {
            failures.push(format!(
                "{case} ({}): {}; said {}",
                split.name,
                graft.told(),
                named.join(", ")
            ));
        }
    }
    let figure = |name: &str, (right, all): (usize, usize), target| {
        Figure::share(name, right, all, target).line()
    };
    let lines = [
        figure("grafts named, larger than 2", large, ">= 0.90"),
        figure("grafts named, all", counts[0], ""),
        figure(
            "no graft, nothing named on top of the baseline",
            counts[1],
            "",
        ),
        figure(
            "lost readings, nothing named that the ungrafted half has not",
            counts[2],
            "",
        ),
    ];
    let note = "Size: root mean square of what the graft changes in the set-points, over the error that is left on the ungrafted half.";
    let text = format!(
        "{}{}\nFailed:\n\n- {}\n\n{note}\n\n{rows}",
        Figure::HEAD,
        lines.concat(),
        failures.join("\n- ")
    );
    println!("{text}");
    write(&args.output.join("score.md"), &text)
}
