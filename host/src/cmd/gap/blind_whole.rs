//! The whole-robot part of `rb-host gap blind`: cases of `hil_sim::robot_cases`, one by name for development, or a sealed suite.

use std::fs;
use std::path::Path;

use hil_sim::robot_cases::{self, Label, Plan, Planted, RobotCaseError};
use serde_json::{Value, json};

use super::shipped;
use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};

/// Seed of tolerances and noise of a case made by name.
const DEVELOPMENT_SEED: u64 = 11;

fn refused(e: RobotCaseError) -> Failure {
    Failure::new(Exit::Usage, anyhow::Error::new(e))
}

/// `EFFECT[@JOINT][:VALUE[,VALUE...]]`, several joined by `+`; `none` for none.
fn parse(text: &str, seed: u64) -> Outcome<Vec<Planted>> {
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
pub(super) fn write_case(plan: &Plan, gaits: usize, folder: &Path) -> Outcome<Label> {
    let gaits = shipped::gaits(gaits)?;
    let case = robot_cases::case(plan, &gaits).map_err(refused)?;
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
    Ok(case.label)
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

/// `--make-case`: one data set folder whose causes everybody may know; the label stands in it.
pub(super) fn make_case(
    causes: &str,
    gaits: usize,
    seed: u64,
    filmed: bool,
    folder: &Path,
    context: &Context,
) -> Outcome {
    let seed = DEVELOPMENT_SEED.wrapping_mul(seed);
    let planted = parse(causes, seed)?;
    let camera = planted
        .iter()
        .any(|p| p.effect.starts_with("camera") || p.effect == "frame_drop");
    let plan = Plan {
        name: causes.to_owned(),
        kind: "by name",
        seed,
        filmed: filmed || camera,
        planted,
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
