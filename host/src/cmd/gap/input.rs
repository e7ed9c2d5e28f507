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
}

/// Hexadecimal SHA-256.
pub(super) fn hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes)
        .iter()
        .map(|b| format!("{b:02x}"))
        .collect()
}

/// Reads manifest and runs, CSV or MCAP; warnings go to the user.
pub(super) fn read(path: &Path, context: &Context) -> Outcome<Input> {
    let loaded =
        recording::load(path).map_err(|e| Failure::new(Exit::BadFile, anyhow::Error::new(e)))?;
    for w in &loaded.warnings {
        context.out.detail(w);
    }
    Ok(Input {
        manifest: loaded.manifest,
        recordings: loaded.recordings,
        sha256: hex(&loaded.bytes),
    })
}
