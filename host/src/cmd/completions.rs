//! `rb-host completions`

use clap::CommandFactory;
use clap_complete::Shell;

use crate::cli::Cli;
use crate::context::Context;
use crate::failure::Outcome;

/// Write a shell completion script to standard output
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Shell
    shell: Shell,
}

/// Writes the script.
///
/// # Errors
/// None.
pub fn run(args: &Args, _context: &Context) -> Outcome {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "rb-host", &mut script);
    super::print_bytes(&script)
}
