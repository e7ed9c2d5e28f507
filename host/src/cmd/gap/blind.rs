//! `rb-host gap blind`: makes cases, seals their labels, diagnoses each in a process of its own, opens and scores.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};

use clap::builder::{PossibleValuesParser, TypedValueParser};
use hil_sim::bench_cases;
use hil_sim::robot_cases::{SeenBy, Signal};
use serde_json::{Value, json};

use super::{blind_whole, input, score_joint};
use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};

/// Options of `gap blind`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder for cases, labels and verdicts; a second run there goes on where the first one stopped
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Joints of the mixed suite: 25 % without effect, 40 % one, 25 % two or three, 10 % outside the library [default: 400]
    #[arg(long)]
    cases: Option<usize>,
    /// Further joints without effect, to count false alarms [default: 400]
    #[arg(long)]
    nulls: Option<usize>,
    /// Seed of the suite
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Processes at once; 0 = one per core
    #[arg(long, default_value_t = 0)]
    jobs: usize,
    /// Withhold the planted effect of every single: the diagnosis must then say "unknown"
    #[arg(long)]
    leave_one_out: bool,
    /// Check the diagnosis of the whole robot, on this many cases: instead of joints, or after them where --cases or --nulls is given
    #[arg(long, value_name = "CASES")]
    whole: Option<usize>,
    /// Write one whole-robot data set with these causes and stop: EFFECT[@JOINT][:VALUE,...] joined by +, or none
    #[arg(long, value_name = "CAUSES")]
    make_case: Option<String>,
    /// Gaits of a whole-robot case, 1 to 17
    #[arg(long, default_value_t = 17)]
    gaits: usize,
    /// Gait files for --make-case instead of the shipped ones
    #[arg(long, value_name = "FILE", num_args = 1.., requires = "make_case")]
    gait: Vec<PathBuf>,
    /// Leave these signals out of whole-robot cases, as on robots that do not have them
    #[arg(long, value_parser = signals(), value_name = "SIGNAL", value_delimiter = ',')]
    without: Vec<Signal>,
    /// Add silhouettes to the case of --make-case
    #[arg(long)]
    filmed: bool,
    /// Leave base pose and inertial sensor out of that case: the silhouettes alone show where the robot is
    #[arg(long, requires = "filmed")]
    untracked: bool,
}

/// Signals by their names, with the names in the help.
fn signals() -> impl TypedValueParser<Value = Signal> {
    PossibleValuesParser::new(Signal::ALL.map(Signal::name))
        .try_map(|name| Signal::named(&name).ok_or("no such signal"))
}

/// Number of the first of the further nulls.
const NULLS_FROM: usize = 1000;
/// Joints of the mixed suite, and further ones without effect, where nothing else is asked for.
const JOINTS: usize = 400;

impl Args {
    fn cases(&self) -> usize {
        self.cases.unwrap_or(JOINTS)
    }

    fn nulls(&self) -> usize {
        self.nulls.unwrap_or(JOINTS)
    }
}

pub(super) fn fail(what: &str, path: &Path, e: impl core::fmt::Display) -> Failure {
    Failure::say(
        Exit::Other,
        format!("cannot {what} {}: {e}", path.display()),
    )
}

pub(super) fn write(path: &Path, text: &str) -> Outcome {
    fs::write(path, text).map_err(|e| fail("write", path, e))
}

fn label_json(l: &bench_cases::Label) -> Value {
    let one = |((p, f), a): ((&bench_cases::Planted, &f64), &f64)| {
        let parameters: serde_json::Map<String, Value> = p
            .parameters
            .iter()
            .map(|(k, v)| ((*k).to_string(), json!(v)))
            .collect();
        json!({ "effect": p.effect, "parameters": parameters, "floors": f, "floors_any": a })
    };
    let planted: Vec<Value> = l
        .planted
        .iter()
        .zip(&l.floors)
        .zip(&l.floors_any)
        .map(one)
        .collect();
    json!({ "name": l.name, "kind": l.kind, "planted": planted })
}

/// Runs `work` on every index with a few threads; the first failure is returned.
pub(super) fn each(count: usize, jobs: usize, work: impl Fn(usize) -> Outcome + Sync) -> Outcome {
    let _grace = crate::interrupt::grace("stopping after the cases under way");
    let next = AtomicUsize::new(0);
    let worker = || -> Outcome {
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            if i >= count || crate::interrupt::pressed() {
                return Ok(());
            }
            work(i)?;
        }
    };
    std::thread::scope(|s| {
        let handles: Vec<_> = (0..jobs).map(|_| s.spawn(worker)).collect();
        let mut result: Outcome = Ok(());
        for h in handles {
            let one = h
                .join()
                .unwrap_or_else(|_| Err(Failure::say(Exit::Other, "a worker stopped")));
            result = result.and(one);
        }
        result
    })?;
    if crate::interrupt::pressed() {
        let text = "stopped; what is done is kept, and the same command goes on from there";
        return Err(Failure::say(Exit::Interrupted, text));
    }
    Ok(())
}

pub(super) fn run(args: &Args, context: &Context) -> Outcome {
    if let Some(causes) = &args.make_case {
        let gaits = if args.gait.is_empty() {
            super::shipped::gaits(args.gaits)?
        } else {
            let load = |p: &PathBuf| crate::gait_file::load(p);
            args.gait.iter().map(load).collect::<Outcome<Vec<_>>>()?
        };
        let seen_by = match (args.filmed, args.untracked) {
            (_, true) => SeenBy::Camera,
            (true, false) => SeenBy::TrackerAndCamera,
            (false, false) => SeenBy::Tracker,
        };
        let case = blind_whole::Named {
            causes,
            seed: args.seed,
            seen_by,
            without: args.without.clone(),
        };
        return blind_whole::make_case(case, &gaits, &args.output, context);
    }
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let jobs = if args.jobs == 0 { cores } else { args.jobs };
    let bench = args.whole.is_none() || args.cases.is_some() || args.nulls.is_some();
    if bench {
        joints(args, jobs, context)?;
    }
    if let Some(count) = args.whole {
        let suite = blind_whole::Suite {
            output: &args.output,
            count,
            gaits: args.gaits,
            seed: args.seed,
            jobs,
            leave_out: args.leave_one_out,
            without: args.without.clone(),
        };
        suite.run(context)?;
    }
    Ok(())
}

/// The folders of a suite of joints.
struct Folders {
    cases: PathBuf,
    labels: PathBuf,
    verdicts: PathBuf,
}

impl Folders {
    fn make(args: &Args) -> Outcome<Self> {
        let verdicts = if args.leave_one_out {
            "verdicts_left_out"
        } else {
            "verdicts"
        };
        let out = Self {
            cases: args.output.join("cases"),
            labels: args.output.join("labels"),
            verdicts: args.output.join(verdicts),
        };
        for d in [&out.cases, &out.labels, &out.verdicts] {
            fs::create_dir_all(d).map_err(|e| fail("make", d, e))?;
        }
        Ok(out)
    }
}

/// The suite of joints: makes and seals the cases, diagnoses and scores them.
fn joints(args: &Args, jobs: usize, context: &Context) -> Outcome {
    let indices: Vec<usize> = (0..args.cases())
        .chain(NULLS_FROM..NULLS_FROM + args.nulls())
        .collect();
    let folders = Folders::make(args)?;
    let Folders {
        cases,
        labels,
        verdicts,
    } = &folders;
    let mine = json!({ "seed": args.seed, "cases": args.cases(), "nulls": args.nulls() });
    same_suite(&args.output, "suite.json", &mine)?;
    context
        .out
        .say(format_args!("{} cases on {jobs} processes", indices.len()));
    each(indices.len(), jobs, |i| {
        make(cases, labels, args.seed, indices[i])
    })?;
    let seal = sealed(&args.output.join("labels.sha256"), seal(labels, &indices)?)?;
    context
        .out
        .say(format_args!("labels sealed: sha256 {seal}"));
    let bar = context.out.progress(indices.len() as u64, "diagnosing");
    each(indices.len(), jobs, |i| {
        let done = diagnose(cases, labels, verdicts, indices[i], args.leave_one_out);
        bar.inc(1);
        done
    })?;
    bar.finish_and_clear();
    if self::seal(labels, &indices)? != seal {
        return Err(Failure::say(
            Exit::Check,
            "the labels changed while the cases were diagnosed",
        ));
    }
    score_all(args, &folders, &indices, &seal, context)
}

/// Writes the `seal` of the labels once; labels that changed since are refused.
pub(super) fn sealed(path: &Path, seal: String) -> Outcome<String> {
    match fs::read_to_string(path) {
        Ok(before) if before.trim() != seal => {
            let text = format!(
                "the labels were changed after {} was written; begin again in a new folder",
                path.display()
            );
            Err(Failure::say(Exit::Check, text))
        }
        Ok(_) => Ok(seal),
        Err(_) => {
            write(path, &format!("{seal}\n"))?;
            Ok(seal)
        }
    }
}

/// Opens the labels and writes the table.
fn score_all(
    args: &Args,
    f: &Folders,
    indices: &[usize],
    seal: &str,
    context: &Context,
) -> Outcome {
    let read = |path: PathBuf| {
        fs::read_to_string(path)
            .ok()
            .and_then(|t| serde_json::from_str::<Value>(&t).ok())
    };
    let pair = |i: &usize| {
        Some((
            read(f.labels.join(file(*i)))?,
            read(f.verdicts.join(file(*i)))?,
        ))
    };
    let pairs: Vec<(Value, Value)> = indices.iter().filter_map(pair).collect();
    let lost = indices.len() - pairs.len();
    if lost > 0 && !args.leave_one_out {
        let text = format!(
            "{lost} of {} cases have no verdict and no figure counts them; give the same command again",
            indices.len()
        );
        return Err(Failure::say(Exit::Check, text));
    }
    let (table, name) = if args.leave_one_out {
        (score_joint::left_out(&pairs), "score_left_out.md")
    } else {
        (score_joint::table(&pairs), "score.md")
    };
    write(&args.output.join(name), &table.markdown())?;
    let value = json!({ "labels_sha256": seal, "seed": args.seed, "rows": table.json(), "failures": table.failures });
    context
        .out
        .result("rb.gap_blind/1", value, || table.markdown());
    Ok(())
}

/// A folder holds one suite: another seed or size than those noted in its `file` would mix two.
pub(super) fn same_suite(folder: &Path, file: &str, mine: &Value) -> Outcome {
    let path = folder.join(file);
    let mine = mine.to_string();
    match fs::read_to_string(&path) {
        Ok(there) if there.trim() != mine => {
            let text = format!(
                "{} holds another suite ({}); give a new folder",
                folder.display(),
                there.trim()
            );
            Err(Failure::say(Exit::Usage, text))
        }
        Ok(_) => Ok(()),
        Err(_) => write(&path, &format!("{mine}\n")),
    }
}

fn file(index: usize) -> String {
    format!("case_{index:04}.json")
}

fn make(cases: &Path, labels: &Path, seed: u64, index: usize) -> Outcome {
    let label = labels.join(file(index));
    if label.exists() {
        return Ok(());
    }
    let case = bench_cases::case(seed, index);
    let folder = cases.join(format!("case_{index:04}"));
    fs::create_dir_all(&folder).map_err(|e| fail("make", &folder, e))?;
    for (name, text) in &case.files {
        write(&folder.join(name), text)?;
    }
    // The label comes last: a case with a label is complete.
    write(&label, &format!("{}\n", label_json(&case.label)))
}

/// Hash over all labels in order.
fn seal(labels: &Path, indices: &[usize]) -> Outcome<String> {
    let mut all = Vec::new();
    for i in indices {
        let path = labels.join(file(*i));
        all.extend(fs::read(&path).map_err(|e| fail("read", &path, e))?);
    }
    Ok(input::hex(&all))
}

/// Diagnoses one case in a process that is given the case folder and nothing else.
fn diagnose(
    cases: &Path,
    labels: &Path,
    verdicts: &Path,
    index: usize,
    leave_out: bool,
) -> Outcome {
    let out = verdicts.join(file(index));
    if out.exists() {
        return Ok(());
    }
    let program =
        std::env::current_exe().map_err(|e| fail("find", Path::new("this program"), e))?;
    let mut command = Command::new(&program);
    let part = out.with_extension("part");
    command
        .arg("--quiet")
        .args(["gap", "report", "--force"])
        .arg(cases.join(format!("case_{index:04}")));
    command
        .arg("--json-file")
        .arg(&part)
        .env("RAYON_NUM_THREADS", "1");
    if leave_out {
        let text =
            fs::read_to_string(labels.join(file(index))).map_err(|e| fail("read", labels, e))?;
        let label: Value = serde_json::from_str(&text).map_err(|e| fail("read", labels, e))?;
        match (
            label["kind"].as_str(),
            label["planted"][0]["effect"].as_str(),
        ) {
            (Some("single"), Some(effect)) => command.args(["--withhold", effect]),
            _ => return Ok(()),
        };
    }
    let status = command
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .map_err(|e| fail("start", &program, e))?;
    if status.success() {
        fs::rename(&part, &out).map_err(|e| fail("move", &part, e))?;
    }
    Ok(())
}
