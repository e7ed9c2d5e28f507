//! A recording as a data set folder: `dataset.toml`, one CSV per run, the attached gait and model.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use control::robot::JOINTS;

use super::csv;
use super::reader::Recording;

/// Why the folder was not written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The folder exists and is not empty.
    #[error("{path} exists and is not empty")]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
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
    /// Writing failed.
    #[error("cannot write {path}")]
    Write {
        /// File or folder.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// Writes the folder and returns the files in it.
///
/// # Errors
/// [`ExportError`]
pub fn export(
    recording: &Recording,
    name: &str,
    folder: &Path,
) -> Result<Vec<PathBuf>, ExportError> {
    let write_error = |path: &Path| {
        let path = path.to_owned();
        move |source| ExportError::Write { path, source }
    };
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
    if fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(ExportError::NotEmpty {
            path: folder.to_owned(),
        });
    }
    fs::create_dir_all(folder).map_err(write_error(folder))?;
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
    files
        .into_iter()
        .map(|(file, text)| {
            let path = folder.join(file);
            fs::write(&path, text).map_err(write_error(&path))?;
            Ok(path)
        })
        .collect()
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}
