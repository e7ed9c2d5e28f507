//! `model.toml` from disk, or the shipped model.

use std::path::Path;

use files::model::Model;

use crate::disk;
use crate::failure::{Exit, Failure, Outcome};

/// Reads a model; `None` is the shipped hand-tuned one.
///
/// # Errors
/// Exit code 3 with file, line and range.
pub fn load(path: Option<&Path>) -> Outcome<Model> {
    let Some(path) = path else {
        return Ok(Model::hand_tuned());
    };
    let shown = path.display().to_string();
    let text = disk::read_text(path, disk::MAX_TEXT)
        .map_err(|e| Failure::say(Exit::BadFile, format!("{shown}: {e}")))?;
    Model::parse(&shown, &text).map_err(|error| Failure::new(Exit::BadFile, error))
}
