//! The command tree. A new command is one file here, its `mod` line and its row in [`commands!`].
//!
//! The file holds `pub struct Args` (clap derive) and `pub fn run(args: &Args, context: &Context) -> Outcome`.

use std::io::IsTerminal;

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;

pub mod bench;
pub mod bus;
mod bus_kind;
pub mod camera;
pub mod completions;
pub mod config;
pub mod doctor;
pub mod download;
pub mod emulate;
pub mod gait;
pub mod gap;
pub mod hybrid;
pub mod info;
pub mod list;
pub mod log;
pub mod man;
pub mod model;
pub mod monitor;
pub mod optimise;
pub mod rec;
pub mod reset;
pub mod run;
pub mod sim;
pub mod slots;
pub mod stop;
pub mod upload;
pub mod version;
pub mod zero;

macro_rules! commands {
    ($($(#[$attribute:meta])* $variant:ident => $module:ident,)*) => {
        /// What to do.
        #[derive(Debug, clap::Subcommand)]
        #[allow(clippy::large_enum_variant, reason = "one command line lives once")]
        pub enum Command {
            $(
                #[allow(missing_docs, reason = "the module's Args say what it does")]
                $(#[$attribute])*
                $variant($module::Args),
            )*
        }

        impl Command {
            /// Does it.
            ///
            /// # Errors
            /// [`Failure`] with its exit code.
            pub fn run(&self, context: &Context) -> Outcome {
                match self {
                    $(Self::$variant(args) => $module::run(args, context),)*
                }
            }
        }
    };
}

commands! {
    List => list,
    Info => info,
    Doctor => doctor,
    Upload => upload,
    Download => download,
    Slots => slots,
    Run => run,
    Stop => stop,
    Monitor => monitor,
    Log => log,
    Zero => zero,
    Reset => reset,
    Bus => bus,
    Gait => gait,
    Emulate => emulate,
    Rec => rec,
    Sim => sim,
    Camera => camera,
    #[command(alias = "optimize")]
    Optimise => optimise,
    Model => model,
    Hybrid => hybrid,
    Gap => gap,
    Bench => bench,
    Completions => completions,
    Man => man,
    Config => config,
    Version => version,
}

/// Asks a question at a terminal; without one `--yes` is needed.
pub(crate) fn confirm(context: &Context, question: &str) -> Outcome {
    if context.yes {
        return Ok(());
    }
    if !std::io::stdin().is_terminal() {
        return Err(
            Failure::say(Exit::Usage, format!("{question} No terminal to ask at"))
                .hint("give --yes"),
        );
    }
    context.out.ask(&format!("{question} [y/N]"));
    let _guard = interrupt::at_once("not confirmed, nothing was changed");
    let mut answer = String::new();
    std::io::stdin()
        .read_line(&mut answer)
        .map_err(|error| Failure::say(Exit::Other, format!("cannot read the answer: {error}")))?;
    if matches!(answer.trim(), "y" | "Y" | "yes") {
        return Ok(());
    }
    Err(Failure::say(
        Exit::Interrupted,
        "not confirmed, nothing was changed",
    ))
}
