//! A data set in memory: a folder with `dataset.toml` whose runs are CSV or MCAP, a folder of MCAP recordings, or one recording.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use files::dataset::{DatasetError, Manifest, Recording as Columns, Warning};

use super::{ReadError, csv, reader};
use crate::data_folder::DataFolder;
use crate::disk;

/// The list of runs.
const MANIFEST: &str = "dataset.toml";

/// What was read.
pub struct Loaded {
    /// The manifest, written or made up from the recordings.
    pub manifest: Manifest,
    /// One per run of the manifest.
    pub recordings: Vec<Columns>,
    /// Everything that was read, for a checksum.
    pub bytes: Vec<u8>,
    /// What may be wrong: of the manifest, then of the runs.
    pub warnings: Vec<Warning>,
}

/// Why a data set was not read.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// A file cannot be read.
    #[error("{path}: {source}; give the folder that holds dataset.toml, or MCAP recordings")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file of a run cannot be read.
    #[error("{file}: {source}; dataset.toml names it as the file of a run")]
    Run {
        /// Its name in the manifest.
        file: String,
        /// Why.
        source: io::Error,
    },
    /// Neither a manifest nor a recording.
    #[error("{path} holds neither dataset.toml nor a recording with samples")]
    Nothing {
        /// The folder.
        path: PathBuf,
    },
    /// An MCAP file of another program.
    #[error(
        "{path} is an MCAP file of another program (topics: {topics}); only recordings of rb-host are read"
    )]
    Foreign {
        /// The file.
        path: PathBuf,
        /// Its topics.
        topics: String,
    },
    /// Manifest or CSV is wrong.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A recording cannot be read.
    #[error(transparent)]
    Recording(#[from] ReadError),
    /// A recording has no such run.
    #[error("{path} has no run {run} with samples; `rb-host rec info` lists its runs")]
    NoRun {
        /// The recording.
        path: PathBuf,
        /// Run, counted from 1.
        run: usize,
    },
}

/// Reads a data set: `path` is a folder or one `.mcap` file.
///
/// # Errors
/// [`LoadError`]
pub fn load(path: &Path) -> Result<Loaded, LoadError> {
    let folder = DataFolder::of(path).map_err(|source| LoadError::Io {
        path: path.to_owned(),
        source,
    })?;
    let text = if !path.is_dir() {
        made_up(&folder, &[path.to_owned()], path)?
    } else if path.join(MANIFEST).exists() {
        let text = folder.text(MANIFEST, disk::MAX_TEXT);
        text.map_err(|source| LoadError::Io {
            path: path.join(MANIFEST),
            source,
        })?
    } else {
        made_up(&folder, &recordings_in(path)?, path)?
    };
    let (manifest, mut warnings) = Manifest::parse(MANIFEST, &text)?;
    let mut bytes = text.into_bytes();
    let mut recordings = Vec::new();
    for run in &manifest.runs {
        let csv = run_text(&folder, &run.file)?;
        let (recording, more) = Columns::parse(&run.file, &csv, &manifest)?;
        warnings.extend(more);
        bytes.extend_from_slice(csv.as_bytes());
        recordings.push(recording);
    }
    Ok(Loaded {
        manifest,
        recordings,
        bytes,
        warnings,
    })
}

/// MCAP files of a folder in the order of their names.
fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>, LoadError> {
    let io = |source| LoadError::Io {
        path: folder.to_owned(),
        source,
    };
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if path.extension().is_some_and(|e| e == "mcap") {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// Run number behind `#`, counted from 1; the first one without.
fn split(file: &str) -> (&str, usize) {
    let numbered = file
        .rsplit_once('#')
        .and_then(|(name, run)| Some((name, run.parse().ok()?)));
    numbered.unwrap_or((file, 1))
}

fn is_mcap(file: &str) -> bool {
    Path::new(split(file).0)
        .extension()
        .is_some_and(|e| e == "mcap")
}

/// CSV of one run of the manifest.
///
/// # Errors
/// [`LoadError`]
pub fn run_text(folder: &DataFolder, file: &str) -> Result<String, LoadError> {
    let bad = |source| LoadError::Run {
        file: file.to_owned(),
        source,
    };
    if !is_mcap(file) {
        return folder.text(file, disk::MAX_DATA).map_err(bad);
    }
    let (name, number) = split(file);
    let path = folder.shown(name);
    let opened = folder.file(name).map_err(bad)?;
    let recording = reader::read_opened(&path, Ok(opened))?;
    let mut runs = recording.runs.iter().filter(|r| !r.samples.is_empty());
    let run = number.checked_sub(1).and_then(|n| runs.nth(n));
    run.map(csv::to_csv)
        .ok_or_else(|| match recording.foreign_topics() {
            Some(topics) => LoadError::Foreign { path, topics },
            None => LoadError::NoRun { path, run: number },
        })
}

/// A manifest for recordings that have none: every run with samples, by the gait it names.
fn made_up(folder: &DataFolder, files: &[PathBuf], shown: &Path) -> Result<String, LoadError> {
    let mut text = String::from("format = 1\nrobot = \"metamodule\"\nname = \"recordings\"\n");
    if folder.has("model.toml") {
        text.push_str("\n[metamodule]\nmodel = \"model.toml\"\n");
    }
    let quoted = |s: &str| toml::Value::String(s.to_owned()).to_string();
    let mut any = false;
    let mut foreign = None;
    for path in files {
        let name = path
            .file_name()
            .map_or_else(String::new, |n| n.to_string_lossy().into());
        let recording = reader::read(path)?;
        foreign = foreign.or_else(|| Some((path.clone(), recording.foreign_topics()?)));
        let runs = recording.runs.iter().filter(|r| !r.samples.is_empty());
        for (k, run) in runs.enumerate() {
            let gait = run.start.as_ref().map_or("unknown", |s| s.gait.as_str());
            let file = quoted(&format!("{name}#{}", k + 1));
            text.push_str(&format!(
                "\n[[run]]\nfile = {file}\ngait = {}\n",
                quoted(gait)
            ));
            any = true;
        }
    }
    if any {
        return Ok(text);
    }
    Err(match foreign {
        Some((path, topics)) => LoadError::Foreign { path, topics },
        None => LoadError::Nothing {
            path: shown.to_owned(),
        },
    })
}
