//! `rb-trials run`: a verdict on every folder of a suite.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, bail};

use super::{Judged, diagnose_by, each, host};
use crate::label;

/// Options of `run`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder whose folders are data sets
    #[arg(value_name = "CASES")]
    cases: PathBuf,
    /// Folder for verdicts; a second run there goes on where the first one stopped
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// The program that diagnoses; absent = rb-host beside this one
    #[arg(long, value_name = "FILE")]
    host: Option<PathBuf>,
    /// Withhold the planted effect of every single of these labels: the diagnosis must then say "unknown"; nothing
    /// else is diagnosed
    #[arg(long, value_name = "LABELS")]
    leave_one_out: Option<PathBuf>,
    /// Command of rb-host that is judged
    #[arg(long, value_enum, default_value_t)]
    command: Judged,
    /// Calibration that `gap causes` decides by
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Processes at once; 0 = one per core
    #[arg(long, default_value_t = 0)]
    jobs: usize,
}

/// Diagnoses.
pub(super) fn run(args: &Args) -> Result<()> {
    if args.calibration.is_some() && args.command == Judged::Report {
        bail!("--calibration is for --command causes; `gap report` takes none");
    }
    let host = host(args.host.as_ref())?;
    let withheld: Option<BTreeMap<String, String>> = args
        .leave_one_out
        .as_ref()
        .map(|path| -> Result<_> {
            let singles = label::open(path)?
                .0
                .cases
                .into_iter()
                .filter(|l| l.kind == "single");
            let effects = singles.filter_map(|l| Some((l.name, l.causes.first()?.effect.clone())));
            Ok(effects.collect())
        })
        .transpose()?;
    let entries = std::fs::read_dir(&args.cases)
        .with_context(|| format!("cannot read {}", args.cases.display()))?;
    let mut folders: Vec<PathBuf> = entries
        .filter_map(|e| Some(e.ok()?.path()))
        .filter(|p| p.join("dataset.toml").is_file())
        .collect();
    folders.sort();
    std::fs::create_dir_all(&args.output)
        .with_context(|| format!("cannot make {}", args.output.display()))?;
    let failed = AtomicUsize::new(0);
    let calibration = args.calibration.as_ref().map(|f| f.to_string_lossy());
    each(folders.len(), args.jobs, |k| {
        let name = folders[k].file_name().unwrap_or_default().to_string_lossy();
        let effect = withheld.as_ref().map(|w| w.get(name.as_ref()));
        let mut more = match effect {
            Some(None) => return Ok(()),
            Some(Some(effect)) => vec!["--withhold", effect.as_str()],
            None => Vec::new(),
        };
        if let Some(file) = &calibration {
            more.extend(["--calibration", file]);
        }
        let verdict = args.output.join(format!("{name}.json"));
        if !diagnose_by(args.command, &host, &folders[k], &verdict, &more)? {
            eprintln!(
                "no verdict on {name}: run `rb-host gap {}` on its folder",
                args.command.word()
            );
            failed.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    })?;
    let failed = failed.into_inner();
    println!("{} folders, {failed} without a verdict", folders.len());
    Ok(())
}
