//! The motion to record next, as a file beside the report.

use std::path::{Path, PathBuf};

use control::gait::Gait;
use control::machine::Machine;
use control::robot::RobotModel;
use gap::bench::Diagnosis;
use gap::verdict::Verdict;
use gap::vocabulary::{Effect, Stage};
use gap::whole::Diagnosis as WholeDiagnosis;

use super::{programme, report, shipped};
use crate::failure::Outcome;
use crate::gait_file;

/// Writes `text` beside `report` and returns the name of the file, without its folder: both move together.
fn write(report: &Path, end: &str, text: &str) -> Outcome<Option<String>> {
    let path = report.with_extension(end);
    report::write(&path, text)?;
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned());
    Ok(name)
}

/// Motion of a joint on a bench: set-points as CSV. `report` is `None` when no file was asked for.
pub(super) fn bench(d: &mut Diagnosis, report: Option<PathBuf>) -> Outcome {
    let (Some(report), Some(experiment)) = (report, &d.experiment) else {
        return Ok(());
    };
    let text = experiment.motion.to_csv(d.problem.linear);
    let name = write(&report, "next.csv", &text)?;
    if let Some(next) = &mut d.verdict.next_experiment {
        next.gait = name;
    }
    Ok(())
}

/// Which motion of the programme shows what the members of a class differ by; `None` where a joint alone shows nothing.
fn motion(effects: &[Effect]) -> Option<&'static str> {
    let stage = |s: Stage| effects.iter().any(|e| e.stage() == s);
    let has = |list: &[Effect]| effects.iter().any(|e| list.contains(e));
    if stage(Stage::Body) || stage(Stage::Camera) {
        return None;
    }
    // Delays and lags show in fast sines, limits in steps, all that sticks or has play in slow reversals.
    if stage(Stage::Transport) || has(&[Effect::FeedbackDelay, Effect::MotorLag, Effect::LoopGain])
    {
        return Some("sweep3");
    }
    if has(&[Effect::VelocityLimit]) {
        return Some("step");
    }
    Some("slow")
}

/// Gait for the robot: one joint in the air, or on the ground where the body holds what is open; the robot's own check lets it pass.
pub(super) fn robot(d: &mut WholeDiagnosis, report: Option<PathBuf>) -> Outcome {
    let Some(report) = report else {
        return Ok(());
    };
    let machine = Machine::default();
    let accepts = |gait: &Gait| gait_file::check(gait, &machine).is_ok();
    if let Some(e) = d.experiment(&shipped::menu()?, &accepts) {
        let v = d.verdict_mut();
        if let Some(next) = v.next_experiment.as_mut().filter(|_| e.look.is_none()) {
            // Joints one by one would not show what the ground does.
            next.text.clear();
        }
        return add(v, &report, &e.gait, &e.text);
    }
    let v = d.verdict_mut();
    let class = v.ambiguous.first();
    let (joint, name) = match class {
        Some(c) => (c.members.first().and_then(|m| m.joint), motion(&c.effects)),
        None if v.next_experiment.is_some() => {
            (v.place.first().and_then(|p| p.joint), Some("slow"))
        }
        None => (None, None),
    };
    let (Some(joint), Some(name)) = (joint, name) else {
        return Ok(());
    };
    let Some(item) = programme::motion(joint, name, &RobotModel::default()) else {
        return Ok(());
    };
    let item = item?;
    let text = format!(
        "Hold the robot off the ground and play the gait file ({}, {:.0} s) three times.",
        item.name, item.duration_s
    );
    add(v, &report, &item.gait, &text)
}

/// Writes `gait` beside `report` and says in the verdict what to do with it.
fn add(v: &mut Verdict, report: &Path, gait: &Gait, text: &str) -> Outcome {
    if let Some(next) = &mut v.next_experiment {
        next.gait = write(report, "next.toml", &files::gait::to_toml(gait))?;
        if !next.text.is_empty() {
            next.text.push(' ');
        }
        next.text.push_str(text);
    }
    Ok(())
}
