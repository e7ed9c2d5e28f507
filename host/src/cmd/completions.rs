//! `rb-host completions`

use clap_complete::Shell;

use crate::cli;
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
pub fn run(args: &Args, context: &Context) -> Outcome {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut cli::command(), "rb-host", &mut script);
    let mut script = String::from_utf8_lossy(&script).into_owned();
    if args.shell == Shell::Bash {
        // clap_complete 4.6 sets `rb__host__...` for a name with a hyphen and then asks for `rb__subcmd__host__...`.
        script = script.replace("rb__subcmd__host", "rb__host");
    }
    context.out.document(&script);
    Ok(())
}
