//! The commands of `rb-trials`.

mod close;
mod graft;
mod make;
mod run;
mod score;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, anyhow, bail};
use clap::Parser;

/// Robots and joints with known causes, and how right the diagnosis is about them
#[derive(Debug, Parser)]
#[command(name = "rb-trials", version)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    command: Sub,
}

#[derive(Debug, clap::Subcommand)]
enum Sub {
    /// Write one data set of the emulated robot with these causes
    MakeCase(make::CaseArgs),
    /// Write a suite of emulated robots with sealed labels
    Robots(make::RobotsArgs),
    /// Write a suite of emulated joints with sealed labels
    Joints(make::JointsArgs),
    /// Diagnose every folder of a suite, each in a process that is given nothing else
    Run(run::Args),
    /// Weigh verdicts against labels
    Score(score::Args),
    /// Put exact faults onto real recordings and check that the diagnosis finds them
    Graft(graft::Args),
    /// Search, run on the emulated robot, diagnose, patch, search again: predicted against achieved speed
    Close(close::Args),
}

/// Runs a command.
///
/// # Errors
/// Files that cannot be read or written, arguments that name nothing, a diagnosis that fails.
pub fn run(cli: &Cli) -> Result<()> {
    match &cli.command {
        Sub::MakeCase(a) => make::case(a),
        Sub::Robots(a) => make::robots(a),
        Sub::Joints(a) => make::joints(a),
        Sub::Run(a) => run::run(a),
        Sub::Score(a) => score::run(a),
        Sub::Graft(a) => graft::run(a),
        Sub::Close(a) => close::run(a),
    }
}

fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).with_context(|| format!("cannot make {}", parent.display()))?;
    }
    fs::write(path, content).with_context(|| format!("cannot write {}", path.display()))
}

/// `rb-host`: the path given, else the program beside this one.
fn host(given: Option<&PathBuf>) -> Result<PathBuf> {
    if let Some(path) = given {
        return Ok(path.clone());
    }
    let own = std::env::current_exe().context("cannot find this program")?;
    let beside = own.with_file_name("rb-host");
    if !beside.is_file() {
        bail!(
            "no rb-host beside {}; build it, or give --host PATH",
            own.display()
        );
    }
    Ok(beside)
}

/// Command of `rb-host` that is judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
enum Judged {
    /// `gap report`
    #[default]
    Report,
    /// `gap causes`
    Causes,
}

impl Judged {
    fn word(self) -> &'static str {
        match self {
            Self::Report => "report",
            Self::Causes => "causes",
        }
    }
}

/// Diagnoses a folder in a process of its own; the verdict comes into being complete or not at all. False where the
/// diagnosis failed.
fn diagnose(host: &Path, folder: &Path, verdict: &Path, more: &[&str]) -> Result<bool> {
    diagnose_by(Judged::Report, host, folder, verdict, more)
}

/// The same by either command.
fn diagnose_by(
    judged: Judged,
    host: &Path,
    folder: &Path,
    verdict: &Path,
    more: &[&str],
) -> Result<bool> {
    if verdict.exists() {
        return Ok(true);
    }
    let part = verdict.with_extension("part");
    if part.exists() {
        fs::remove_file(&part).with_context(|| format!("cannot remove {}", part.display()))?;
    }
    let mut command = Command::new(host);
    match judged {
        Judged::Report => {
            let report = command.args(["--quiet", "gap", "report"]).arg(folder);
            report.arg("--json-file").arg(&part).stdout(Stdio::null());
        }
        Judged::Causes => {
            let causes = command.args(["--quiet", "--json", "gap", "causes"]);
            let file = fs::File::create(&part)
                .with_context(|| format!("cannot write {}", part.display()))?;
            causes.arg(folder).stdout(file);
        }
    }
    let status = command
        .args(more)
        .env("RAYON_NUM_THREADS", "1")
        .stderr(Stdio::null())
        .status()
        .with_context(|| format!("cannot start {}", host.display()))?;
    if status.success() {
        fs::rename(&part, verdict).with_context(|| format!("cannot move {}", part.display()))?;
    }
    Ok(status.success())
}

/// Runs `work` on every index with `jobs` threads, 0 for one per core; the first failure is returned.
fn each(count: usize, jobs: usize, work: impl Fn(usize) -> Result<()> + Sync) -> Result<()> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let jobs = if jobs == 0 { cores } else { jobs };
    let next = AtomicUsize::new(0);
    let worker = || -> Result<()> {
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            if i >= count {
                return Ok(());
            }
            work(i)?;
        }
    };
    std::thread::scope(|s| {
        let handles: Vec<_> = (0..jobs).map(|_| s.spawn(worker)).collect();
        let joined = handles.into_iter().map(|h| {
            h.join()
                .unwrap_or_else(|_| Err(anyhow!("a worker stopped")))
        });
        joined.fold(Ok(()), Result::and)
    })
}
