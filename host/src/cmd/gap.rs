//! `rb-host gap`: the diagnosis of the gap between simulation and robot.

mod blind;
mod blind_whole;
mod close;
mod collect;
mod graft;
mod grafts;
mod input;
mod next;
mod programme;
mod report;
mod score;
mod score_joint;
mod score_whole;
mod shipped;
mod whole;

use crate::context::Context;
use crate::failure::Outcome;

/// Find where the gap between simulation and robot is, which effect causes it and how far it shrinks
#[derive(Debug, clap::Args)]
pub struct Args {
    /// What to do.
    #[command(subcommand)]
    command: Sub,
}

#[derive(Debug, clap::Subcommand)]
enum Sub {
    /// Diagnose a data set folder
    Report(report::Args),
    /// Write what the model predicts for every run, as CSV
    Predict(report::PredictArgs),
    /// Check the diagnosis on emulated joints whose planted cause it does not see
    Blind(blind::Args),
    /// Search, run on the emulated robot, diagnose, patch, search again: predicted against achieved speed
    Close(close::Args),
    /// Record on the robot what a diagnosis needs; tells the robot time first
    Collect(collect::Args),
    /// Put exact faults onto real recordings and check that the diagnosis finds them
    Graft(graft::Args),
}

/// Runs it.
///
/// # Errors
/// A data set that cannot be read (3), a folder that cannot be written (1), a blind check below its limits (8).
pub fn run(args: &Args, context: &Context) -> Outcome {
    match &args.command {
        Sub::Report(a) => report::run(a, context),
        Sub::Predict(a) => report::predict(a, context),
        Sub::Blind(a) => blind::run(a, context),
        Sub::Close(a) => close::run(a, context),
        Sub::Collect(a) => collect::run(a, context),
        Sub::Graft(a) => graft::run(a, context),
    }
}
