//! The folder of a search: a checkpoint after every iteration, then the results.

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::disk;
use crate::failure::{Exit, Failure, Outcome};

/// Name of the checkpoint inside the folder.
const CHECKPOINT: &str = "checkpoint.json";

/// What a search writes before its first checkpoint: a cut-off search leaves it.
const OWN: [&str; 5] = [
    CHECKPOINT,
    "optimise.toml",
    "model.toml",
    "robot.toml",
    "start.toml",
];

/// The folder of one search.
#[derive(Debug, Clone)]
pub struct Folder {
    path: PathBuf,
}

impl Folder {
    /// Opens or creates the folder. A folder that holds a checkpoint is only taken with `resume`.
    ///
    /// # Errors
    /// Exit code 2 when a search would be overwritten or there is nothing to resume; 1 when the folder cannot be made.
    pub fn open(path: &Path, resume: bool) -> Outcome<Self> {
        let folder = Self {
            path: path.to_owned(),
        };
        let there = folder.path.join(CHECKPOINT).exists();
        let shown = path.display();
        if there && !resume {
            let message = format!("{shown} already holds a search");
            return Err(Failure::say(Exit::Usage, message)
                .hint("go on with --resume, or choose another folder"));
        }
        if resume && !there {
            let message = format!("{shown} holds no checkpoint to resume");
            return Err(Failure::say(Exit::Usage, message)
                .hint("leave --resume away to start a search there"));
        }
        let mut entries = std::fs::read_dir(path).into_iter().flatten().flatten();
        let foreign =
            |name: &str| !there && !OWN.contains(&name.strip_suffix(".new").unwrap_or(name));
        if let Some(entry) = entries.find(|e| foreign(&e.file_name().to_string_lossy())) {
            let message = format!(
                "{shown} holds {} and no search",
                entry.file_name().display()
            );
            return Err(Failure::say(Exit::Usage, message).hint("choose a new or an empty folder"));
        }
        disk::make_folder(path)?;
        Ok(folder)
    }

    /// A folder without a checkpoint, for its atomic writes.
    #[must_use]
    pub fn at(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
        }
    }

    /// A path inside the folder.
    #[must_use]
    pub fn join(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Writes a file in one step: a reader sees the old or the new one, never half.
    ///
    /// # Errors
    /// Exit code 1 when the disk refuses.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Outcome {
        let path = self.path.join(name);
        if let Some(parent) = path.parent() {
            disk::make_folder(parent)?;
        }
        disk::write(&path, bytes)
    }

    /// Stores the state of the search.
    ///
    /// # Errors
    /// Exit code 1 when the disk refuses.
    pub fn store(&self, state: &impl Serialize) -> Outcome {
        let text = serde_json::to_vec(state).map_err(anyhow::Error::from)?;
        self.write(CHECKPOINT, &text)
    }

    /// Reads the state back.
    ///
    /// # Errors
    /// Exit code 3 when the checkpoint is damaged or of another version.
    pub fn restore<T: DeserializeOwned>(&self) -> Outcome<T> {
        let path = self.path.join(CHECKPOINT);
        let text = std::fs::read(&path).map_err(|e| disk::bad_file(&path, &e))?;
        serde_json::from_slice(&text).map_err(|error| {
            Failure::say(Exit::BadFile, format!("{}: {error}", path.display()))
                .hint("the checkpoint is damaged or of another version; start the search again in a new folder")
        })
    }
}
