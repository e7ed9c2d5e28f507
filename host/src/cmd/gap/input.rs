//! Reads a data set folder.

use std::fs;
use std::path::Path;

use files::dataset::{Manifest, Recording};
use sha2::{Digest, Sha256};

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};

/// A data set in memory.
pub(super) struct Input {
    pub(super) manifest: Manifest,
    pub(super) recordings: Vec<Recording>,
    pub(super) sha256: String,
}

fn text(path: &Path) -> Outcome<String> {
    fs::read_to_string(path).map_err(|e| {
        Failure::say(
            Exit::BadFile,
            format!("cannot read {}: {e}", path.display()),
        )
        .hint("give the folder that holds dataset.toml")
    })
}

/// Hexadecimal SHA-256.
pub(super) fn hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes)
        .iter()
        .map(|b| format!("{b:02x}"))
        .collect()
}

/// Reads manifest and runs; warnings go to the user.
pub(super) fn read(folder: &Path, context: &Context) -> Outcome<Input> {
    let bad = |e| Failure::new(Exit::BadFile, anyhow::Error::new(e));
    let manifest_text = text(&folder.join("dataset.toml"))?;
    let (manifest, warnings) = Manifest::parse("dataset.toml", &manifest_text).map_err(bad)?;
    let mut all = manifest_text.into_bytes();
    for w in &warnings {
        context.out.warn(w);
    }
    let mut recordings = Vec::new();
    for run in &manifest.runs {
        let csv = text(&folder.join(&run.file))?;
        let (recording, warnings) = Recording::parse(&run.file, &csv, &manifest).map_err(bad)?;
        for w in &warnings {
            context.out.detail(w);
        }
        all.extend_from_slice(csv.as_bytes());
        recordings.push(recording);
    }
    Ok(Input {
        manifest,
        recordings,
        sha256: hex(&all),
    })
}
