//! Licences, sources and known faults of all dependencies, where the tools and their index are there.

use crate::sh;
use anyhow::{Result, bail};

/// `cargo deny check` and `cargo audit`. A tool that is missing and an index that cannot be reached are skipped aloud.
pub(crate) fn run() -> Result<()> {
    for (tool, arguments) in [("deny", &["deny", "check"][..]), ("audit", &["audit"])] {
        if sh::output("cargo", &[tool, "--version"]).is_err() {
            eprintln!(
                "SKIPPED  cargo {tool}: not installed (`cargo install cargo-{tool} --locked`)"
            );
            continue;
        }
        let output = sh::command("cargo", arguments).output()?;
        let said = String::from_utf8_lossy(&output.stderr);
        // Words of cargo-deny and cargo-audit for an index that they could not get.
        let unreachable = ["failed to fetch", "couldn't fetch"];
        if output.status.success() {
            continue;
        }
        if unreachable.iter().any(|words| said.contains(words)) {
            eprintln!("SKIPPED  cargo {tool}: its index cannot be reached");
        } else {
            bail!("cargo {} failed:\n{said}", arguments.join(" "));
        }
    }
    Ok(())
}
