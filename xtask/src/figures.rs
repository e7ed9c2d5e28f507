//! `cargo xtask figures`: every figure the documentation quotes, from one fresh run.

use crate::{sh, test};
use anyhow::Result;

/// Each table with the command that prints it.
const TABLES: &[(&str, &[&str])] = &[];

/// Print all tables; each command can also be run alone.
pub(crate) fn run() -> Result<()> {
    test::firmware_image()?;
    for (title, arguments) in TABLES {
        println!("\n## {title}\n");
        sh::run("cargo", arguments)?;
    }
    Ok(())
}
