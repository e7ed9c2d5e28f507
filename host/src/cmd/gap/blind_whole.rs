//! The whole-robot part of `rb-host gap blind`: cases of `hil_sim::robot_cases`, one by name for development, or a sealed suite.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use control::gait::Gait;
use hil_sim::robot_cases::{self, Case, Label, Plan, Planted, RobotCaseError, SeenBy, Signal};
use serde_json::{Value, json};

use super::{blind, input, score_whole, shipped};
use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};

/// Most draws of one case: of 180 one robot flew apart.
const DRAWS: u32 = 8;
/// Seed of tolerances and noise of a case made by name.
const DEVELOPMENT_SEED: u64 = 11;

fn refused(e: RobotCaseError) -> Failure {
    Failure::new(Exit::Usage, anyhow::Error::new(e))
}

/// `EFFECT[@JOINT][:VALUE[,VALUE...]]`, several joined by `+`; `none` for none.
pub(super) fn parse(text: &str, seed: u64) -> Outcome<Vec<Planted>> {
    if text == "none" {
        return Ok(Vec::new());
    }
    text.split('+').map(|one| parse_one(one, seed)).collect()
}

fn parse_one(text: &str, seed: u64) -> Outcome<Planted> {
    let usage = |what: &str| {
        Failure::say(
            Exit::Usage,
            format!(
                "`{text}`: {what}; write EFFECT[@JOINT][:VALUE,...], for example coulomb_friction@2:0.5"
            ),
        )
    };
    let (head, values) = text.split_once(':').unwrap_or((text, ""));
    let (effect, joint) = match head.split_once('@') {
        Some((effect, joint)) => {
            let joint = joint.parse().map_err(|_| usage("the joint is no number"))?;
            (effect, Some(joint))
        }
        None => (head, None),
    };
    let values = values
        .split(',')
        .filter(|v| !v.is_empty())
        .map(|v| v.parse::<f64>().map_err(|_| usage("a value is no number")))
        .collect::<Outcome<Vec<f64>>>()?;
    robot_cases::planted(effect, joint, &values, seed).map_err(refused)
}

/// Writes the case's folder and returns its label.
pub(super) fn write_case(plan: &Plan, gaits: &[Gait], folder: &Path) -> Outcome<Label> {
    let case = robot_cases::case(plan, gaits).map_err(refused)?;
    write_files(&case, folder)?;
    Ok(case.label)
}

/// Writes the files of a case.
pub(super) fn write_files(case: &Case, folder: &Path) -> Outcome {
    for (name, content) in &case.files {
        let path = folder.join(name);
        let fail = |e: std::io::Error| {
            Failure::say(Exit::Other, format!("cannot write {}: {e}", path.display()))
        };
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(fail)?;
        }
        fs::write(&path, content).map_err(fail)?;
    }
    Ok(())
}

/// A label as it is sealed.
pub(super) fn label_json(label: &Label) -> Value {
    let planted: Vec<Value> = label
        .planted
        .iter()
        .zip(label.floors.iter().zip(&label.floors_any))
        .map(|(p, (floors, any))| {
            let parameters: serde_json::Map<String, Value> = p
                .parameters
                .iter()
                .map(|(k, v)| ((*k).to_string(), json!(v)))
                .collect();
            json!({
                "effect": p.effect, "joint": p.joint, "parameters": parameters, "readings_too": p.readings_too,
                "floors": floors, "floors_any": any,
            })
        })
        .collect();
    json!({ "name": label.name, "kind": label.kind, "planted": planted })
}

/// A case by name.
pub(super) struct Named<'a> {
    /// Its causes, as [`parse`] reads them.
    pub(super) causes: &'a str,
    pub(super) seed: u64,
    pub(super) seen_by: SeenBy,
    /// What is not recorded.
    pub(super) without: Vec<Signal>,
}

/// `--make-case`: one data set folder whose causes everybody may know; the label stands in it.
pub(super) fn make_case(
    case: Named<'_>,
    gaits: &[Gait],
    folder: &Path,
    context: &Context,
) -> Outcome {
    let Named {
        causes,
        seed,
        seen_by,
        without,
    } = case;
    let seed = DEVELOPMENT_SEED.wrapping_mul(seed);
    let planted = parse(causes, seed)?;
    let camera = planted
        .iter()
        .any(|p| p.effect.starts_with("camera") || p.effect == "frame_drop");
    let plan = Plan {
        name: causes.to_owned(),
        kind: "by name",
        seed,
        seen_by: if camera && !seen_by.camera() {
            SeenBy::TrackerAndCamera
        } else {
            seen_by
        },
        planted,
        without,
        ..robot_cases::plan(seed, 1000)
    };
    let label = label_json(&write_case(&plan, gaits, folder)?);
    let path = folder.join("label.json");
    fs::write(&path, format!("{label}\n"))
        .map_err(|e| Failure::say(Exit::Other, format!("cannot write {}: {e}", path.display())))?;
    context
        .out
        .result("rb.gap_case/1", label.clone(), || label.to_string());
    Ok(())
}

/// Where a suite keeps its parts.
struct Places {
    cases: PathBuf,
    labels: PathBuf,
    verdicts: PathBuf,
}

impl Places {
    /// Verdicts with all of the library.
    const WHOLE: &str = "whole_verdicts";

    fn new(output: &Path, leave_out: bool) -> Outcome<Self> {
        let places = Self {
            cases: output.join("whole_cases"),
            labels: output.join("whole_labels"),
            verdicts: output.join(if leave_out {
                "whole_verdicts_left_out"
            } else {
                Self::WHOLE
            }),
        };
        for d in [&places.cases, &places.labels, &places.verdicts] {
            fs::create_dir_all(d).map_err(|e| blind::fail("make", d, e))?;
        }
        Ok(places)
    }

    fn file(folder: &Path, index: usize) -> PathBuf {
        folder.join(format!("{}.json", Self::name(index)))
    }

    fn name(index: usize) -> String {
        format!("robot_{index:04}")
    }

    fn seal(&self, count: usize) -> Outcome<String> {
        let mut all = Vec::new();
        for index in 0..count {
            let path = Self::file(&self.labels, index);
            all.extend(fs::read(&path).map_err(|e| blind::fail("read", &path, e))?);
        }
        Ok(input::hex(&all))
    }

    fn make(&self, suite: &Suite<'_>, index: usize) -> Outcome {
        let path = Self::file(&self.labels, index);
        if path.exists() {
            return Ok(());
        }
        let gaits = shipped::gaits(suite.gaits)?;
        let draw = |times: u32| {
            let plan = Plan {
                without: suite.without.clone(),
                ..robot_cases::plan_anew(suite.seed, index, times)
            };
            robot_cases::case(&plan, &gaits)
        };
        // A robot that flies apart is drawn anew.
        let possible = (0..DRAWS)
            .map(draw)
            .find(|c| !matches!(c, Err(RobotCaseError::Impossible)));
        let case = possible
            .unwrap_or(Err(RobotCaseError::Impossible))
            .map_err(refused)?;
        write_files(&case, &self.cases.join(Self::name(index)))?;
        let label = case.label;
        // The label comes last: a case with a label is complete.
        blind::write(&path, &format!("{}\n", label_json(&label)))
    }

    /// The effect to withhold from the diagnosis of a case: that of a single.
    fn single(&self, index: usize) -> Option<String> {
        let label = read(&Self::file(&self.labels, index))?;
        let effect = label["planted"][0]["effect"].as_str();
        effect
            .filter(|_| label["kind"] == "single")
            .map(str::to_owned)
    }

    /// Diagnoses one case in a process that is given the case folder, and where it is left out the effect that was planted; nothing else.
    fn diagnose(&self, index: usize, leave_out: bool) -> Outcome {
        let out = Self::file(&self.verdicts, index);
        let withheld = self.single(index).filter(|_| leave_out);
        if out.exists() || (leave_out && withheld.is_none()) {
            return Ok(());
        }
        let program =
            std::env::current_exe().map_err(|e| blind::fail("find", Path::new("rb-host"), e))?;
        let part = out.with_extension("part");
        let withhold = withheld.map(|effect| ["--withhold".to_owned(), effect]);
        let status = Command::new(&program)
            .arg("--quiet")
            .args(["gap", "report", "--force"])
            .arg(self.cases.join(Self::name(index)))
            .args(withhold.into_iter().flatten())
            .arg("--json-file")
            .arg(&part)
            .env("RAYON_NUM_THREADS", "1")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()
            .map_err(|e| blind::fail("start", &program, e))?;
        if status.success() {
            fs::rename(&part, &out).map_err(|e| blind::fail("move", &part, e))?;
        }
        Ok(())
    }
}

fn read(path: &Path) -> Option<Value> {
    serde_json::from_str(&fs::read_to_string(path).ok()?).ok()
}

/// A sealed suite of whole-robot cases.
pub(super) struct Suite<'a> {
    pub(super) output: &'a Path,
    pub(super) count: usize,
    pub(super) gaits: usize,
    pub(super) seed: u64,
    pub(super) jobs: usize,
    /// Withhold the planted effect of every single.
    pub(super) leave_out: bool,
    /// What is not recorded.
    pub(super) without: Vec<Signal>,
}

impl Suite<'_> {
    /// Makes, seals, diagnoses, opens and scores; goes on where it stopped.
    pub(super) fn run(&self, context: &Context) -> Outcome {
        let places = Places::new(self.output, self.leave_out)?;
        let without: Vec<&str> = self.without.iter().map(|s| s.name()).collect();
        let mine = json!({
            "seed": self.seed, "whole": self.count, "gaits": self.gaits, "without": without,
        });
        blind::same_suite(self.output, "whole_suite.json", &mine)?;
        context.out.say(format_args!(
            "{} whole-robot cases on {} processes",
            self.count, self.jobs
        ));
        blind::each(self.count, self.jobs, |k| places.make(self, k))?;
        let path = self.output.join("whole_labels.sha256");
        let seal = blind::sealed(&path, places.seal(self.count)?)?;
        context
            .out
            .say(format_args!("labels sealed: sha256 {seal}"));
        let bar = context.out.progress(self.count as u64, "diagnosing");
        blind::each(self.count, self.jobs, |k| {
            let done = places.diagnose(k, self.leave_out);
            bar.inc(1);
            done
        })?;
        bar.finish_and_clear();
        if places.seal(self.count)? != seal {
            return Err(Failure::say(
                Exit::Check,
                "the labels changed while the cases were diagnosed",
            ));
        }
        self.score(&places, &seal, context)
    }

    fn score(&self, places: &Places, seal: &str, context: &Context) -> Outcome {
        let whole = self.output.join(Places::WHOLE);
        let (pairs, whole): (Vec<(Value, Value)>, Vec<Option<Value>>) = (0..self.count)
            .filter_map(|k| {
                let label = read(&Places::file(&places.labels, k))?;
                let verdict = read(&Places::file(&places.verdicts, k))?;
                Some(((label, verdict), read(&Places::file(&whole, k))))
            })
            .unzip();
        let missing = self.count - pairs.len();
        let table = if self.leave_out {
            score_whole::left_out(&pairs, &whole)
        } else {
            score_whole::table(&pairs)
        };
        let mut text = table.markdown();
        // Only singles are left out.
        if missing > 0 && !self.leave_out {
            let note = format!(
                "\n{missing} of {} cases got no verdict: their diagnosis failed or was interrupted.\n",
                self.count
            );
            text.push_str(&note);
        }
        let name = if self.leave_out {
            "whole_score_left_out.md"
        } else {
            "whole_score.md"
        };
        blind::write(&self.output.join(name), &text)?;
        let value = json!({
            "labels_sha256": seal, "seed": self.seed, "cases": self.count, "without_verdict": missing,
            "rows": table.json(), "failures": table.failures,
        });
        context.out.result("rb.gap_blind_whole/1", value, || text);
        Ok(())
    }
}
