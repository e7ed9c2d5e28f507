//! Licences, sources and known faults of all dependencies, where the tools and their index are there.

use crate::sh;
use anyhow::{Result, bail};

/// Licences, sources and bans need no index. Known faults do.
const CHECKS: [&[&str]; 3] = [
    &["deny", "check", "licenses", "bans", "sources"],
    &["deny", "check", "advisories"],
    &["audit"],
];

/// `cargo deny check` and `cargo audit`. A tool that is missing and an index that cannot be reached are skipped aloud.
pub(crate) fn run() -> Result<()> {
    for arguments in CHECKS {
        let (tool, words) = (arguments[0], arguments.join(" "));
        if sh::output("cargo", &[tool, "--version"]).is_err() {
            eprintln!(
                "SKIPPED  cargo {words}: not installed (`cargo install cargo-{tool} --locked`)"
            );
            continue;
        }
        let output = sh::command("cargo", arguments).output()?;
        let said = String::from_utf8_lossy(&output.stderr);
        // Words of cargo-deny and cargo-audit for an index that they could not get.
        let unreachable = ["failed to fetch", "couldn't fetch"];
        if output.status.success() {
            eprintln!("cargo {words}: passed");
            continue;
        }
        if unreachable.iter().any(|words| said.contains(words)) {
            eprintln!("SKIPPED  cargo {words}: its index cannot be reached");
        } else {
            bail!("cargo {words} failed:\n{said}");
        }
    }
    Ok(())
}
