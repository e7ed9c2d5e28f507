//! Reads a data set folder.

use std::path::Path;

use files::dataset::{Manifest, Recording};
use sha2::{Digest, Sha256};

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::recording;

/// A data set in memory.
pub(super) struct Input {
    pub(super) manifest: Manifest,
    pub(super) recordings: Vec<Recording>,
    pub(super) sha256: String,
    /// What the reader left out or assumed.
    pub(super) warnings: Vec<String>,
}

/// Hexadecimal SHA-256.
pub(super) fn hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes)
        .iter()
        .map(|b| format!("{b:02x}"))
        .collect()
}

/// Reads manifest and runs, CSV or MCAP; warnings go to the user, each once.
pub(super) fn read(path: &Path, context: &Context) -> Outcome<Input> {
    let loaded =
        recording::load(path).map_err(|e| Failure::new(Exit::BadFile, anyhow::Error::new(e)))?;
    let mut warnings: Vec<String> = Vec::new();
    for warning in loaded.warnings.iter().map(ToString::to_string) {
        if !warnings.contains(&warning) {
            context.out.warn(&warning);
            warnings.push(warning);
        }
    }
    Ok(Input {
        manifest: loaded.manifest,
        recordings: loaded.recordings,
        sha256: hex(&loaded.bytes),
        warnings,
    })
}
