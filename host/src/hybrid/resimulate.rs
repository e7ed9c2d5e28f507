//! Simulating the recorded gaits again: what the model predicted before and after the match, against what the robot did.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use camera::{Silhouette, Solid, picture};
use control::gait::Gait;
use files::dataset::Recording;
use files::model::{Key, Model};
use optimise::meta::{
    FilmMaker, FilmedGait, Likeness, MotionJob, MotionTrials, Placement, rows_of,
};
use optimise::simulated::SimulatedMotions;
use physics::{Drive, Options, Params, Start, Trial};
use serde::Serialize;
use serde_json::json;

use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::recording::{self, set::SetFolder};
use crate::searching::films;
use crate::searching::folder::Folder;

/// One gait before, after, and on the robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GaitRow {
    /// Gait.
    pub gait: String,
    /// Whether the match saw it.
    pub training: bool,
    /// Speed that the model of the search predicts, m/s.
    pub predicted_before_m_s: f64,
    /// Speed that the matched model predicts, m/s.
    pub predicted_after_m_s: f64,
    /// Mean speed on the robot, m/s; `None` when the base was not tracked.
    pub achieved_m_s: Option<f64>,
    /// Standard deviation over the runs, m/s.
    pub achieved_sigma_m_s: Option<f64>,
    /// Similarity to the films, before.
    pub r_before: f64,
    /// Similarity to the films, after.
    pub r_after: f64,
}

/// The films of a set with a camera over them.
struct Theatre {
    gaits: Vec<FilmedGait>,
    maker: FilmMaker,
    duration_s: f64,
}

/// Simulates, compares, draws, and writes `result.json`, `result.txt`, `overlay.png` and `strip.png` into `folder`.
///
/// # Errors
/// Exit code 3 for a damaged set, 1 when the disk refuses.
pub fn run(
    context: &Context,
    set: &SetFolder,
    (before, after): (&Model, &Model),
    folder: &Folder,
) -> Outcome<Vec<GaitRow>> {
    let (data, manifest) = films::read_manifest(set.path())?;
    let gaits = films::load(&data, &manifest, &[], after.value(Key::CameraHeight))?;
    let settings = films::settings_of(manifest.camera.as_ref(), 1);
    let longest = gaits.iter().map(FilmedGait::frames).max().unwrap_or(0);
    let theatre = Theatre {
        duration_s: longest as f64 / settings.rate_hz + Key::CameraTimeShift.info().search.1,
        maker: FilmMaker::new(settings, &context.robot_model()),
        gaits,
    };
    let steps = 2 + theatre.gaits.len() as u64;
    let bar = context.out.progress(steps, "simulating again");
    let ratios = |model| theatre.ratios(context, model).inspect(|_| bar.inc(1));
    let (r_before, r_after) = (ratios(before)?, ratios(after)?);
    let mut rows = Vec::new();
    for (k, filmed) in theatre.gaits.iter().enumerate() {
        let name = filmed.gait.name();
        let achieved = achieved_m_s(set, name)?;
        let mean = mean(&achieved);
        let spread = mean.filter(|_| achieved.len() > 1).map(|mean| {
            let squares = achieved
                .iter()
                .map(|v| (v - mean) * (v - mean))
                .sum::<f64>();
            (squares / (achieved.len() - 1) as f64).sqrt()
        });
        rows.push(GaitRow {
            gait: name.to_owned(),
            training: filmed.training,
            predicted_before_m_s: predicted_m_s(before, &filmed.gait)?,
            predicted_after_m_s: predicted_m_s(after, &filmed.gait)?,
            achieved_m_s: mean,
            achieved_sigma_m_s: spread,
            r_before: r_before[k],
            r_after: r_after[k],
        });
        bar.inc(1);
    }
    bar.finish_and_clear();
    theatre.draw(context, after, &r_after, folder)?;
    let result = json!({ "schema": "rb.hybrid_cycle/1", "gaits": rows, "speed_error_m_s": {
        "before": speed_error_m_s(&rows, |row| row.predicted_before_m_s),
        "after": speed_error_m_s(&rows, |row| row.predicted_after_m_s),
    } });
    folder.write("result.json", format!("{result:#}\n").as_bytes())?;
    folder.write("result.txt", text(&rows).as_bytes())?;
    Ok(rows)
}

/// Root mean square of predicted less achieved speed; `None` without a tracked gait.
#[must_use]
pub fn speed_error_m_s(rows: &[GaitRow], predicted: impl Fn(&GaitRow) -> f64) -> Option<f64> {
    let squares: Vec<f64> = rows
        .iter()
        .filter_map(|row| Some((predicted(row) - row.achieved_m_s?).powi(2)))
        .collect();
    mean(&squares).map(f64::sqrt)
}

/// The rows as a table.
#[must_use]
pub fn text(rows: &[GaitRow]) -> String {
    let mut out = String::from(
        "gait   set        speed [cm/s]: before   after   robot (sd)      R: before   after\n",
    );
    for row in rows {
        let set = if row.training { "training" } else { "test" };
        let robot = match (row.achieved_m_s, row.achieved_sigma_m_s) {
            (Some(v), Some(s)) => format!("{:.2} ({:.2})", v * 100.0, s * 100.0),
            (Some(v), None) => format!("{:.2}", v * 100.0),
            _ => "-".to_owned(),
        };
        let _ = writeln!(
            out,
            "{:6} {set:9} {:>21.2} {:>7.2} {robot:>14} {:>12.3} {:>7.3}",
            row.gait,
            row.predicted_before_m_s * 100.0,
            row.predicted_after_m_s * 100.0,
            row.r_before,
            row.r_after
        );
    }
    let show = |v: Option<f64>| v.map_or_else(|| "-".to_owned(), |v| format!("{:.2}", v * 100.0));
    let _ = writeln!(
        out,
        "speed error rms [cm/s]: {} before, {} after",
        show(speed_error_m_s(rows, |row| row.predicted_before_m_s)),
        show(speed_error_m_s(rows, |row| row.predicted_after_m_s))
    );
    out
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Speed of a noiseless simulated run of the gait's own length, m/s.
fn predicted_m_s(model: &Model, gait: &Gait) -> Outcome<f64> {
    let params = Params::try_from(model).map_err(|e| Failure::new(Exit::BadFile, e))?;
    let trial = Trial {
        params: Arc::new(params),
        start: Start::Home,
        drive: Drive::Gait {
            gait: Arc::new(gait.clone()),
            noise_rad: 0.0,
            seed: 0,
        },
        duration_s: gait.duration_s().into(),
    };
    let outcomes =
        physics::run(&[trial], &Options::default()).map_err(|e| Failure::new(Exit::BadFile, e))?;
    Ok(outcomes.first().map_or(0.0, |outcome| outcome.speed_m_s))
}

/// Speed of each tracked run of a gait: ground distance from the first base pose to the last, over the time between.
fn achieved_m_s(set: &SetFolder, gait: &str) -> Outcome<Vec<f64>> {
    let (data, manifest) = films::read_manifest(set.path())?;
    let mut speeds = Vec::new();
    for run in manifest.runs.iter().filter(|run| run.gait == gait) {
        let shown = data.shown(&run.file).display().to_string();
        let text =
            recording::run_text(&data, &run.file).map_err(|e| Failure::new(Exit::BadFile, e))?;
        let (recording, _) = Recording::parse(&shown, &text, &manifest)
            .map_err(|e| Failure::new(Exit::BadFile, e))?;
        let [Some(x), Some(y), _] = &recording.body().base_m else {
            continue;
        };
        let seen: Vec<(f64, f64, f64)> = recording
            .t_s()
            .iter()
            .zip(x.iter().zip(y))
            .filter(|(_, (x, y))| x.is_finite() && y.is_finite())
            .map(|(t, (x, y))| (*t, *x, *y))
            .collect();
        if let [(t0, x0, y0), .., (t1, x1, y1)] = seen.as_slice() {
            let (dx, dy) = (x1 - x0, y1 - y0);
            speeds.push((dx * dx + dy * dy).sqrt() / (t1 - t0));
        }
    }
    Ok(speeds)
}

/// Frames of the strip: the paper's figure 7 has about as many.
const STRIP: usize = 8;
/// Every so many frames of the overlay: 3 a second of a 30 Hz film.
const OVERLAY_STRIDE: usize = 10;

impl Theatre {
    fn ratios(&self, context: &Context, model: &Model) -> Outcome<Vec<f64>> {
        let likeness = Likeness::new(&self.gaits, self.maker.clone())
            .map_err(|e| Failure::new(Exit::BadFile, e))?;
        let trials = SimulatedMotions::new(model, context.robot_model(), self.duration_s);
        likeness
            .ratios(&rows_of(model), &trials)
            .map_err(|e| Failure::new(Exit::BadFile, e))
    }

    /// Overlay and strip of the gait that is matched best.
    fn draw(&self, context: &Context, model: &Model, ratios: &[f64], folder: &Folder) -> Outcome {
        let best = (0..ratios.len()).max_by(|a, b| ratios[*a].total_cmp(&ratios[*b]));
        let Some((filmed, film)) =
            best.and_then(|k| Some((&self.gaits[k], self.gaits[k].films.first()?)))
        else {
            return Ok(());
        };
        let rows = rows_of(model);
        let trials = SimulatedMotions::new(model, context.robot_model(), self.duration_s);
        let job = MotionJob {
            gait: &filmed.gait,
            parameters: &rows,
            times: self.maker.times(&rows, film.len(), OVERLAY_STRIDE),
        };
        let Some(motion) = trials.run(&[job]).into_iter().flatten().next() else {
            return Ok(());
        };
        let placement = filmed
            .start
            .map_or_else(Placement::default, |to| Placement::onto(&motion.start, &to));
        let view = self
            .maker
            .view(&rows, placement)
            .map_err(|e| Failure::new(Exit::BadFile, e))?;
        let solids = Solid::meta_module(&context.robot_model());
        let simulated: Vec<Silhouette> = motion
            .bodies
            .iter()
            .map(|poses| view.render(&solids, poses))
            .collect();
        let robot: Vec<&Silhouette> = film.iter().step_by(OVERLAY_STRIDE).collect();
        let pairs: Vec<_> = robot.iter().copied().zip(&simulated).collect();
        let rate_hz = (self.maker.settings().rate_hz as usize / OVERLAY_STRIDE).max(1);
        let other = |e| Failure::new(Exit::Other, anyhow::Error::new(e));
        let overlay = picture::animation_png(&pairs, rate_hz as u16).map_err(other)?;
        folder.write("overlay.png", &overlay)?;
        let every = pairs.len().div_ceil(STRIP).max(1);
        let (top, bottom): (Vec<_>, Vec<_>) = pairs.into_iter().step_by(every).unzip();
        let strip = picture::film_strip_png(&top, &bottom).map_err(other)?;
        folder.write("strip.png", &strip)
    }
}

/// The folder of a cycle's results.
///
/// # Errors
/// Exit code 1 when the disk refuses.
pub fn folder(path: &Path) -> Outcome<Folder> {
    disk::make_folder(path)?;
    Ok(Folder::at(path))
}
