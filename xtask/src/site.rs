//! `cargo xtask site`: the pages as one web site, in `target/site/`.

use crate::sh;
use anyhow::Result;

/// Build it where mdBook is installed; else say so.
pub(crate) fn run() -> Result<()> {
    if sh::output("mdbook", &["--version"]).is_err() {
        eprintln!("SKIPPED  web site of the pages: needs mdBook (cargo install mdbook --locked)");
        return Ok(());
    }
    sh::run("mdbook", &["build"])
}
