//! The command tree. A new command is one file here, its `mod` line and its row in [`commands!`].
//!
//! The file holds `pub struct Args` (clap derive) and `pub fn run(args: &Args, context: &Context) -> Outcome`.

use crate::context::Context;
use crate::failure::Outcome;

pub mod version;

macro_rules! commands {
    ($($(#[$doc:meta])* $variant:ident => $module:ident,)*) => {
        /// What to do.
        #[derive(Debug, clap::Subcommand)]
        pub enum Command {
            $($(#[$doc])* $variant($module::Args),)*
        }

        impl Command {
            /// Does it.
            ///
            /// # Errors
            /// [`crate::failure::Failure`] with its exit code.
            pub fn run(&self, context: &Context) -> Outcome {
                match self {
                    $(Self::$variant(args) => $module::run(args, context),)*
                }
            }
        }
    };
}

commands! {
    /// Show versions
    Version => version,
}
