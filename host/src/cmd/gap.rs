//! `rb-host gap`: the diagnosis of the gap between simulation and robot.

mod causes;
mod collect;
mod input;
mod next;
mod programme;
mod report;
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
    /// Name the causes of a robot's gap, those that joints share as one (schema rb.gap/2)
    Causes(causes::Args),
    /// Read from robots without a cause how strong a cause must show
    Calibrate(causes::CalibrateArgs),
    /// Write what the model predicts for every run, as CSV
    Predict(report::PredictArgs),
    /// Record on the robot what a diagnosis needs; tells the robot time first
    Collect(collect::Args),
}

/// Runs it.
///
/// # Errors
/// A data set that cannot be read (3), a folder that cannot be written (1).
pub fn run(args: &Args, context: &Context) -> Outcome {
    match &args.command {
        Sub::Report(a) => report::run(a, context),
        Sub::Causes(a) => causes::run(a, context),
        Sub::Calibrate(a) => causes::calibrate(a, context),
        Sub::Predict(a) => report::predict(a, context),
        Sub::Collect(a) => collect::run(a, context),
    }
}
