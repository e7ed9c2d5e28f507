//! `rb-host man`

use std::path::PathBuf;

use clap::CommandFactory;

use crate::cli::Cli;
use crate::context::Context;
use crate::failure::Outcome;

/// Write manual pages
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder for one page per command; default: the main page to standard output
    #[arg(short, long)]
    output: Option<PathBuf>,
}

/// Writes manual pages.
///
/// # Errors
/// The folder cannot be written.
pub fn run(args: &Args, context: &Context) -> Outcome {
    match &args.output {
        Some(folder) => {
            std::fs::create_dir_all(folder)?;
            clap_mangen::generate_to(Cli::command(), folder)?;
            context
                .out
                .say(format_args!("manual pages in {}", folder.display()));
            Ok(())
        }
        None => {
            let mut page = Vec::new();
            clap_mangen::Man::new(Cli::command()).render(&mut page)?;
            super::print_bytes(&page)
        }
    }
}
