//! `rb-host camera simulate`

use std::path::PathBuf;

use files::model::Key;
use optimise::meta::{FilmMaker, MotionJob, MotionTrials, rows_of};
use optimise::simulated::SimulatedMotions;
use serde_json::json;

use crate::context::Context;
use crate::failure::{Exit, Failure, Outcome};
use crate::searching::films;
use crate::searching::frames::{Frames, index_in, instants};

#[derive(Debug, clap::Args)]
pub(super) struct SimulateArgs {
    /// Data set folder with films
    data: PathBuf,
    /// Run to simulate: the name of its film folder, such as g01_1
    #[arg(long, short_alias = 'r', value_name = "NAME")]
    run: String,
    /// Robot model and effects, such as what `optimise model` left; the shipped hand-tuned model when absent
    #[arg(short, long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Folder to write: 1-bit PNG and index.csv
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

/// Shares of the work that are usually done when the robot was simulated and when it was filmed, as measured on films of 5 s and 30 s.
const SIMULATED: f64 = 0.1;
const FILMED: f64 = 0.12;

/// Films the simulation of a run: same gait, same start, same camera, shifted in time as the model says.
pub(super) fn run(args: &SimulateArgs, context: &Context) -> Outcome {
    crate::disk::must_be_empty(&args.output)?;
    let model = crate::model_file::load(args.model.as_deref())?;
    let (data, manifest) = films::read_manifest(&args.data)?;
    let filmed = manifest.runs.iter().filter(|run| run.frames.is_some());
    let named = |run: &&files::dataset::Run| run.frames.as_deref() == Some(args.run.as_str());
    let Some(run) = filmed.clone().find(named) else {
        let names: Vec<&str> = filmed.filter_map(|run| run.frames.as_deref()).collect();
        let message = format!("--run {}: the data set has no such film", args.run);
        return Err(Failure::say(Exit::Usage, message).hint(format!("it has {}", names.join(", "))));
    };
    let settings = films::settings_of(manifest.camera.as_ref(), 1);
    let last_s = index_in(&data, &args.run)?.last().map_or(0.0, |l| l.1);
    let frames = instants(&[last_s], settings.rate_hz)?;
    let gait = films::read_gait(&data, &run.gait)?;
    let start = films::start(&data, &manifest, run)?;
    let rows = rows_of(&model);
    let maker = FilmMaker::new(settings, &context.robot_model());
    let duration_s = last_s + model.value(Key::CameraTimeShift).max(0.0) + 1.0 / settings.rate_hz;
    let phases = context.out.phases("simulating");
    let trials = SimulatedMotions::new(&model, context.robot_model(), duration_s);
    let job = MotionJob {
        gait: &gait,
        parameters: &rows,
        times: maker.times(&rows, frames, 1),
    };
    let motion = trials.run(&[job]).into_iter().next().flatten();
    let motion = motion
        .ok_or_else(|| Failure::say(Exit::Other, "the simulator lost a number with this model"))?;
    phases.begin("filming", SIMULATED);
    let frames = maker
        .film_of(&motion, &rows, start.as_ref())
        .map_err(|e| Failure::new(Exit::BadFile, e))?;
    let t_s = (0..frames.len()).map(|k| k as f64 / settings.rate_hz);
    let film = Frames {
        t_s: t_s.collect(),
        frames,
    };
    phases.begin("writing", FILMED);
    film.write(&args.output)?;
    drop(phases);
    let count = film.frames.len();
    let value = json!({ "folder": args.output, "frames": count, "gait": run.gait });
    context.out.result("rb.camera_simulate/1", value, || {
        format!(
            "{count} frames of {} in {}",
            run.gait,
            args.output.display()
        )
    });
    Ok(())
}
