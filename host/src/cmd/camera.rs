//! `rb-host camera`

mod compare;
mod depth;
mod pair;
mod simulate;

use crate::context::Context;
use crate::failure::Outcome;

/// Films of the overhead camera: import, background, silhouettes, likeness to a simulation, pictures
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Read a fakenect-record dump or a folder of pictures: depth frames (PGM, 16-bit PNG) or silhouettes (1- and 8-bit PNG)
    Import(depth::ImportArgs),
    /// The empty scene: the median of depth frames without the robot, or of a run in which it moves
    Background(depth::BackgroundArgs),
    /// Cut the robot out of depth frames: the largest region closer than the background
    Silhouette(depth::SilhouetteArgs),
    /// Film a simulated run as the camera of a data set sees it
    Simulate(simulate::SimulateArgs),
    /// Likeness R of two films frame by frame, or of a data set to a model: R, R_H, W_gait and F_meta (paper, equations 6 to 8)
    Compare(compare::CompareArgs),
    /// One frame of robot and simulation laid over each other: robot red, simulation blue, both green
    Overlay(pair::OverlayArgs),
    /// Film strip: the robot's frames above the simulation's, time from left to right
    Strip(pair::StripArgs),
    /// The whole overlay as an animated PNG, or as an HTML page with a slider
    Animate(pair::AnimateArgs),
}

/// Works on films.
///
/// # Errors
/// Exit code 2 for arguments, 3 for files, 1 when the disk refuses.
pub fn run(args: &Args, context: &Context) -> Outcome {
    match &args.action {
        Action::Import(args) => depth::import(args, context),
        Action::Background(args) => depth::background(args, context),
        Action::Silhouette(args) => depth::silhouette(args, context),
        Action::Simulate(args) => simulate::run(args, context),
        Action::Compare(args) => compare::run(args, context),
        Action::Overlay(args) => pair::overlay(args, context),
        Action::Strip(args) => pair::strip(args, context),
        Action::Animate(args) => pair::animate(args, context),
    }
}
