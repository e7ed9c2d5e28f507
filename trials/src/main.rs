//! `rb-trials`.

use clap::Parser;

fn main() -> anyhow::Result<()> {
    trials::cli::run(&trials::cli::Cli::parse())
}
