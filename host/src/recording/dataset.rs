//! A recording as a data set folder: `dataset.toml`, one CSV per run, the attached gait and model.

use std::fmt::Write as _;

use control::robot::JOINTS;

use super::csv;
use super::reader::Recording;

/// Why the folder was not written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The recording has no run with samples.
    #[error("the recording holds no samples")]
    NoSamples,
    /// The recording is of another robot than a meta-module.
    #[error(
        "the recording is of a robot with {joints} joints, a data set of this form is of a meta-module with six; `rb-host rec convert --to csv` writes any robot"
    )]
    OtherRobot {
        /// Joints of the robot.
        joints: usize,
    },
}

/// Name and text of each file of the folder, `dataset.toml` last.
///
/// # Errors
/// [`ExportError`]
pub fn export(recording: &Recording, name: &str) -> Result<Vec<(String, String)>, ExportError> {
    let runs: Vec<_> = recording
        .runs
        .iter()
        .filter(|r| !r.samples.is_empty())
        .collect();
    if runs.is_empty() {
        return Err(ExportError::NoSamples);
    }
    let joints = runs
        .iter()
        .flat_map(|r| r.samples.first())
        .map(|s| s.joints.len());
    if let Some(joints) = joints.into_iter().find(|joints| *joints != JOINTS) {
        return Err(ExportError::OtherRobot { joints });
    }
    let mut files: Vec<(String, String)> = Vec::new();
    let mut manifest = format!(
        "format = 1\nrobot = \"metamodule\"\nname = {}\n",
        quoted(name)
    );
    if let Some(model) = recording.text("model.toml") {
        manifest.push_str("\n[metamodule]\nmodel = \"model.toml\"\n");
        files.push(("model.toml".to_owned(), model.to_owned()));
    }
    if let Some(gait) = recording.text("gait.toml") {
        files.push(("gait.toml".to_owned(), gait.to_owned()));
    }
    for run in runs {
        let file = format!("run{:02}.csv", run.run + 1);
        let gait = run.start.as_ref().map_or("unknown", |s| s.gait.as_str());
        let _ = write!(
            manifest,
            "\n[[run]]\nfile = \"{file}\"\ngait = {}\n",
            quoted(gait)
        );
        files.push((file, csv::to_csv(run)));
    }
    files.push(("dataset.toml".to_owned(), manifest));
    Ok(files)
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}
