//! `rb-host man`

use std::path::PathBuf;

use crate::cli;
use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};

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
            disk::make_folder(folder)?;
            clap_mangen::generate_to(cli::command(), folder).map_err(|error| {
                let message = format!("cannot write into {}: {error}", folder.display());
                Failure::say(Exit::Other, message)
            })?;
            context
                .out
                .say(format_args!("manual pages in {}", folder.display()));
            Ok(())
        }
        None => {
            let mut page = Vec::new();
            clap_mangen::Man::new(cli::command()).render(&mut page)?;
            context.out.document(&String::from_utf8_lossy(&page));
            Ok(())
        }
    }
}
