//! `rb-host gap report` and `rb-host gap predict` for a whole robot.

use std::path::Path;
use std::time::Instant;

use files::model::Model;
use gap::decide::Calibration;
use gap::whole::{DataSet, Diagnosis, Film, PHASES, Settings, diagnose_watched};

use super::input::Input;
use crate::context::Context;
use crate::data_folder::DataFolder;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;
use crate::searching::frames::Frames;

fn text(path: &Path) -> Outcome<String> {
    disk::read_text(path, disk::MAX_TEXT).map_err(|e| {
        Failure::say(
            Exit::BadFile,
            format!("cannot read {}: {e}", path.display()),
        )
    })
}

/// The folder of a data set; a single recording lies in one.
fn folder(data: &Path) -> Outcome<DataFolder> {
    DataFolder::of(data).map_err(|e| disk::bad_file(data, &e))
}

/// The nominal model of a data set: its own, or the shipped one.
pub(super) fn model(data: &Path, input: &Input) -> Outcome<Model> {
    let Some(file) = &input.manifest.model else {
        return Ok(Model::hand_tuned());
    };
    let text = folder(data)?
        .text(file, disk::MAX_TEXT)
        .map_err(|e| disk::bad_file(Path::new(file), &e))?;
    Model::parse(file, &text).map_err(|e| Failure::new(Exit::BadFile, anyhow::Error::new(e)))
}

/// The films that the runs name.
pub(super) fn films(data: &Path, input: &Input) -> Outcome<Vec<Film>> {
    let mut out = Vec::new();
    for (run, r) in input.manifest.runs.iter().enumerate() {
        if let Some(folder) = &r.frames {
            let Frames { t_s, frames } = Frames::read_in(&self::folder(data)?, folder)?;
            let frames = t_s.into_iter().zip(frames).collect();
            out.push(Film { run, frames });
        }
    }
    Ok(out)
}

/// Share of the work that is usually done when each phase begins, as measured on robots with four gaits.
const SHARES: [f64; PHASES.len()] = [0.0, 0.1, 0.8, 0.9];

/// Diagnoses a data set and adds where the figures come from; says which phase it is in.
pub(super) fn run(
    data: &Path,
    input: &Input,
    (settings, calibration): (&Settings, &Calibration),
    context: &Context,
) -> Outcome<Diagnosis> {
    let start = Instant::now();
    // The search of a whole robot has no point yet at which it can be left with a verdict.
    let _end = interrupt::at_once("stopped; nothing was written");
    let phases = context.out.phases("diagnosing the robot");
    let begins = |number: usize| {
        let text = format!("{} ({} of {})", PHASES[number], number + 1, PHASES.len());
        context.out.detail(&text);
        phases.begin(&text, SHARES[number]);
    };
    let model = model(data, input)?;
    let films = films(data, input)?;
    let set = DataSet {
        manifest: &input.manifest,
        recordings: &input.recordings,
        films: &films,
        model: &model,
    };
    let mut d = diagnose_watched(set, settings, calibration, &begins)
        .map_err(|e| Failure::new(Exit::BadFile, anyhow::Error::new(e)))?;
    let provenance = &mut d.verdict_mut().provenance;
    provenance.data_sha256.clone_from(&input.sha256);
    provenance.warnings.clone_from(&input.warnings);
    provenance.commit = option_env!("RB_COMMIT").map(str::to_string);
    provenance.wall_time_s = start.elapsed().as_secs_f64();
    Ok(d)
}

/// Name and CSV text of every run as the patch predicts it; without a patch the data set is diagnosed first.
pub(super) fn predict(
    data: &Path,
    input: &Input,
    patch: Option<&Path>,
    context: &Context,
) -> Outcome<Vec<(String, String)>> {
    let model = match patch {
        Some(path) => {
            let text = text(path)?;
            Model::parse(&path.display().to_string(), &text)
                .map_err(|e| Failure::new(Exit::BadFile, anyhow::Error::new(e)))?
        }
        None => {
            let shipped = (&Settings::default(), &Calibration::shipped());
            run(data, input, shipped, context)?.patch()
        }
    };
    gap::whole::predict(&input.manifest, &input.recordings, &model)
        .map_err(|e| Failure::new(Exit::BadFile, anyhow::Error::new(e)))
}
