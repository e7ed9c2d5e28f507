//! Checks a data set folder as its readers will see it: every file it names, not only the first that fails.

use std::path::Path;

use files::dataset::{Manifest, Recording, Warning, is_inside};
use files::model::Model;

use crate::data_folder::DataFolder;
use crate::disk;

/// What a check found.
#[derive(Debug, Default)]
pub struct Report {
    /// Runs that could be read.
    pub runs: usize,
    /// Rows of all their CSV files.
    pub rows: usize,
    /// What stops a reader: file, line, column and reason.
    pub problems: Vec<String>,
    /// What a reader leaves out or assumes.
    pub notes: Vec<String>,
}

/// Reads manifest, model, gaits, CSV files and film indices of a folder.
#[must_use]
pub fn check(path: &Path) -> Report {
    let mut report = Report::default();
    let folder = match DataFolder::open(path) {
        Ok(folder) => folder,
        Err(error) => {
            report.problems.push(format!("{}: {error}", path.display()));
            return report;
        }
    };
    let folder = &folder;
    let Some(text) = read(folder, "dataset.toml", &mut report) else {
        return report;
    };
    let manifest = match Manifest::parse("dataset.toml", &text) {
        Ok((manifest, warnings)) => {
            // A key that nobody reads is a value that nobody uses: most of them are misspelt.
            for warning in &warnings {
                let list = match warning {
                    Warning::UnknownKey { .. } => &mut report.problems,
                    _ => &mut report.notes,
                };
                list.push(warning.to_string());
            }
            manifest
        }
        Err(error) => {
            report.problems.push(error.to_string());
            return report;
        }
    };
    if let Some(name) = &manifest.model
        && let Some(text) = read(folder, name, &mut report)
        && let Err(error) = Model::parse(name, &text)
    {
        report.problems.push(error.to_string());
    }
    let mut gaits: Vec<&str> = manifest.runs.iter().map(|run| run.gait.as_str()).collect();
    gaits.sort_unstable();
    gaits.dedup();
    for gait in gaits {
        let name = format!("gaits/{gait}.toml");
        // Bench motions have no gait file.
        if is_inside(&name)
            && folder.has(&name)
            && let Some(text) = read(folder, &name, &mut report)
            && let Err(error) = files::gait::parse(&name, &text)
        {
            report.problems.push(error.to_string());
        }
    }
    for run in &manifest.runs {
        if let Some(text) = run_text(folder, &run.file, &mut report) {
            match Recording::parse(&run.file, &text, &manifest) {
                Ok((recording, warnings)) => {
                    report.runs += 1;
                    report.rows += recording.len();
                    let notes = warnings.iter().map(ToString::to_string);
                    report.notes.extend(notes);
                }
                Err(error) => report.problems.push(error.to_string()),
            }
        }
        if let Some(frames) = &run.frames {
            film(folder, frames, &mut report);
        }
    }
    report
}

fn read(folder: &DataFolder, name: &str, report: &mut Report) -> Option<String> {
    match folder.text(name, disk::MAX_TEXT) {
        Ok(text) => Some(text),
        Err(error) => {
            report.problems.push(format!("{name}: {error}"));
            None
        }
    }
}

/// CSV of a run, from a CSV file or a recording.
fn run_text(folder: &DataFolder, name: &str, report: &mut Report) -> Option<String> {
    match super::load::run_text(folder, name) {
        Ok(text) => Some(text),
        Err(error) => {
            report.problems.push(error.to_string());
            None
        }
    }
}

/// Every row of `index.csv` has a time after the one before, and a picture.
fn film(folder: &DataFolder, frames: &str, report: &mut Report) {
    let name = format!("{frames}/index.csv");
    let Some(text) = read(folder, &name, report) else {
        return;
    };
    let mut lines = text.lines().enumerate();
    if lines
        .next()
        .is_none_or(|(_, head)| head.trim() != "t_s,file")
    {
        let problem = format!("{name}:1: the columns must be `t_s,file`");
        report.problems.push(problem);
        return;
    }
    let mut before_s = f64::NEG_INFINITY;
    for (at, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let number = at + 1;
        let (time, file) = line.split_once(',').unwrap_or((line, ""));
        match time.trim().parse::<f64>() {
            Ok(t_s) if t_s.is_finite() && t_s > before_s => before_s = t_s,
            Ok(t_s) => report.problems.push(format!(
                "{name}:{number}: column `t_s`: {t_s} comes after {before_s}; rows must be in order of time"
            )),
            Err(_) => report.problems.push(format!(
                "{name}:{number}: column `t_s`: `{time}` is not a number"
            )),
        }
        let file = file.trim();
        if !is_inside(file) || !folder.has_file(&format!("{frames}/{file}")) {
            report.problems.push(format!(
                "{name}:{number}: column `file`: there is no picture `{file}` in {frames}"
            ));
        }
    }
}
