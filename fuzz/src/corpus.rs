//! The corpus of a target is one file in the tree: inputs, each after its length as u32, little end first.

use std::path::{Path, PathBuf};

/// Folder of this crate.
fn home() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The packed corpus of a target.
#[must_use]
pub fn file(target: &str) -> PathBuf {
    home().join("corpus").join(format!("{target}.bin"))
}

/// Inputs that once failed, one file each.
#[must_use]
pub fn regressions(target: &str) -> PathBuf {
    home().join("regressions").join(target)
}

/// Inputs of a packed corpus; a file that is not there holds none.
#[must_use]
pub fn read(target: &str) -> Vec<Vec<u8>> {
    unpack(&std::fs::read(file(target)).unwrap_or_default())
}

fn unpack(mut bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut inputs = Vec::new();
    while let Some((length, rest)) = bytes.split_first_chunk::<4>() {
        let length = (u32::from_le_bytes(*length) as usize).min(rest.len());
        let (input, rest) = rest.split_at(length);
        inputs.push(input.to_vec());
        bytes = rest;
    }
    inputs
}

/// The bytes of a packed corpus: each input once, in their order.
#[must_use]
pub fn pack(mut inputs: Vec<Vec<u8>>) -> Vec<u8> {
    inputs.sort();
    inputs.dedup();
    let mut out = Vec::new();
    for input in inputs {
        out.extend((input.len() as u32).to_le_bytes());
        out.extend(input);
    }
    out
}

/// Every file of a folder.
#[must_use]
pub fn folder(path: &Path) -> Vec<Vec<u8>> {
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    let read = |path: PathBuf| std::fs::read(path).ok();
    paths.into_iter().filter_map(read).collect()
}
