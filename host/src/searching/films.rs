//! Films of a data set: the camera table, folders of silhouettes, and the gaits they show.

use std::path::Path;

use camera::Silhouette;
use control::gait::Gait;
use control::linalg::Pose;
use files::dataset::{Camera, Manifest, Recording, Role, Run};
use files::model::Key;
use optimise::meta::{FilmSettings, FilmedGait};
use optimise::simulated::base_pose;

use crate::data_folder::DataFolder;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::recording;
use crate::searching::frames::Frames;

/// Frames per second of the paper's Kinect.
pub const RATE_HZ: f64 = 30.0;
/// Frame of the Kinect's depth camera, px.
const WIDTH_PX: usize = 640;
const HEIGHT_PX: usize = 480;
/// Focal length at that size for the Kinect's nominal field of view of 57 degrees, px.
const FOCAL_PX: f32 = 580.0;

/// A Kinect above the origin; the search looks at every `stride`-th frame.
#[must_use]
pub fn settings(stride: usize) -> FilmSettings {
    FilmSettings {
        rate_hz: RATE_HZ,
        x_m: 0.0,
        y_m: 0.0,
        yaw_rad: 0.0,
        width_px: WIDTH_PX,
        height_px: HEIGHT_PX,
        focal_px: FOCAL_PX,
        stride,
    }
}

/// The `[camera]` table of a data set filmed by a virtual camera. Its height is written as the search range of Table II knows it: uncertain.
#[must_use]
pub fn camera_toml(settings: &FilmSettings) -> String {
    let (low, high) = Key::CameraHeight.info().search;
    format!(
        "\n[camera]\nheight_m = {{ value = {}, tolerance = {} }}\nx_m = {:?}\ny_m = {:?}\nyaw_rad = {:?}\n\
         width_px = {}\nheight_px = {}\nfocal_px = {:?}\nrate_hz = {:?}\n",
        0.5 * (low + high),
        0.5 * (high - low),
        settings.x_m,
        settings.y_m,
        settings.yaw_rad,
        settings.width_px,
        settings.height_px,
        settings.focal_px,
        settings.rate_hz,
    )
}

/// Film settings from a data set's `[camera]`; what is absent is the Kinect above the origin.
#[must_use]
pub fn settings_of(camera: Option<&Camera>, stride: usize) -> FilmSettings {
    let mut s = settings(stride);
    let get = |key: &str| camera.and_then(|c| c.quantities.get(key)).map(|q| q.value);
    let number = |slot: &mut f32, key: &str| {
        if let Some(value) = get(key) {
            *slot = value as f32;
        }
    };
    number(&mut s.x_m, "x_m");
    number(&mut s.y_m, "y_m");
    number(&mut s.yaw_rad, "yaw_rad");
    number(&mut s.focal_px, "focal_px");
    s.rate_hz = get("rate_hz")
        .filter(|rate| *rate > 0.0)
        .unwrap_or(s.rate_hz);
    // The numbers are checked when the view is made.
    s.width_px = get("width_px").map_or(s.width_px, |w| w as usize);
    s.height_px = get("height_px").map_or(s.height_px, |h| h as usize);
    s
}

/// All gaits of a data set with their films, in the order of their first run. A gait is read from `gaits/NAME.toml` in the folder.
///
/// # Errors
/// Exit code 3 for files that are missing or wrong, and for films that show no robot.
pub fn load(
    folder: &DataFolder,
    manifest: &Manifest,
    training: &[String],
    height_m: f64,
) -> Outcome<Vec<FilmedGait>> {
    let settings = settings_of(manifest.camera.as_ref(), 1);
    let mut names: Vec<&str> = Vec::new();
    for run in manifest.runs.iter().filter(|run| run.frames.is_some()) {
        if !names.contains(&run.gait.as_str()) {
            names.push(&run.gait);
        }
    }
    if let Some(unknown) = training.iter().find(|t| !names.contains(&t.as_str())) {
        let message = format!("--training {unknown}: the data set has no film of that gait");
        return Err(Failure::say(Exit::Usage, message)
            .hint(format!("films are there of {}", names.join(", "))));
    }
    let gait = |name: &&str| load_gait(folder, manifest, name, training, (&settings, height_m));
    names.iter().map(gait).collect()
}

fn load_gait(
    folder: &DataFolder,
    manifest: &Manifest,
    name: &str,
    training: &[String],
    (settings, height_m): (&FilmSettings, f64),
) -> Outcome<FilmedGait> {
    let filmed_runs = manifest.runs.iter().filter(|run| run.gait == name);
    let mut runs: Vec<&Run> = Vec::new();
    let mut films = Vec::new();
    for run in filmed_runs {
        if let Some(frames) = &run.frames {
            let film = Frames::read_in(folder, frames)?.at_rate(settings.rate_hz)?;
            films.push(film);
            runs.push(run);
        }
    }
    let gait = read_gait(folder, name)?;
    let bad = |why: String| Failure::say(Exit::BadFile, format!("gait {name}: {why}"));
    let is_training = match training {
        [] => runs.iter().all(|run| run.role == Some(Role::Fit)),
        named => named.iter().any(|n| n == name),
    };
    let start = start(folder, manifest, runs[0])?;
    let speed_m_s = mean_speed_m_s(&films, settings, height_m);
    let filmed = FilmedGait::new(gait, films, start, speed_m_s.unwrap_or(0.0), is_training)
        .map_err(|error| bad(error.to_string()))?;
    if speed_m_s.is_none() {
        return Err(bad(
            "no film shows the robot in two frames, so it has no speed and no weight".to_owned(),
        )
        .hint("film it again, or take its films out of dataset.toml"));
    }
    Ok(filmed)
}

/// A data set folder and its manifest.
///
/// # Errors
/// Exit code 3 with file and line.
pub fn read_manifest(path: &Path) -> Outcome<(DataFolder, Manifest)> {
    let shown = path.join(MANIFEST).display().to_string();
    let bad = |e: std::io::Error| Failure::say(Exit::BadFile, format!("{shown}: {e}"));
    let folder = DataFolder::open(path).map_err(bad)?;
    let text = folder.text(MANIFEST, disk::MAX_TEXT).map_err(bad)?;
    let (manifest, _) =
        Manifest::parse(&shown, &text).map_err(|error| Failure::new(Exit::BadFile, error))?;
    Ok((folder, manifest))
}

/// The list of runs of a data set.
const MANIFEST: &str = "dataset.toml";

/// A gait of a data set folder.
///
/// # Errors
/// Exit code 3 with file and line.
pub fn read_gait(folder: &DataFolder, name: &str) -> Outcome<Gait> {
    let file = format!("gaits/{name}.toml");
    if !files::dataset::is_inside(&file) {
        let message =
            format!("gait `{name}` of dataset.toml: the name leads out of the data set folder");
        return Err(Failure::say(Exit::BadFile, message));
    }
    let path = folder.shown(&file);
    let text = folder
        .text(&file, disk::MAX_TEXT)
        .map_err(|e| disk::bad_file(&path, &e))?;
    crate::gait_file::parse(&path.display().to_string(), &text)
}

/// Body 3 at the start of the gait, by the first row of the run that has a base pose; `None` when it was not measured.
///
/// # Errors
/// Exit code 3 with file and line.
pub fn start(folder: &DataFolder, manifest: &Manifest, run: &Run) -> Outcome<Option<Pose>> {
    let shown = folder.shown(&run.file).display().to_string();
    let text =
        recording::run_text(folder, &run.file).map_err(|e| Failure::new(Exit::BadFile, e))?;
    let (recording, _) =
        Recording::parse(&shown, &text, manifest).map_err(|e| Failure::new(Exit::BadFile, e))?;
    let body = recording.body();
    let row = (0..recording.t_s().len())
        .filter(|&row| recording.t_s()[row] >= 0.0)
        .find_map(|row| {
            let at = |column: &Option<Vec<f64>>| {
                let value = column.as_ref().and_then(|c| c.get(row)).copied()?;
                value.is_finite().then_some(value as f32)
            };
            let [x, y, z] = &body.base_m;
            let [qw, qx, qy, qz] = &body.base_q;
            let turn = [at(qw), at(qx), at(qy), at(qz)];
            // A pose without a turn is a robot put down along x.
            let turn = match turn {
                [Some(w), Some(x), Some(y), Some(z)] => [w, x, y, z],
                _ => [1.0, 0.0, 0.0, 0.0],
            };
            Some(physics::Pose {
                position_m: [at(x)?, at(y)?, at(z).unwrap_or(0.0)],
                quaternion: turn,
            })
        });
    Ok(row.map(|pose| base_pose(&pose)))
}

/// Distance of the outline's centre between the first and the last frame that show the robot, over the time between, on the ground below
/// a camera at `height_m`; `None` when no film shows it twice.
fn mean_speed_m_s(
    films: &[Vec<Silhouette>],
    settings: &FilmSettings,
    height_m: f64,
) -> Option<f64> {
    let speed = |film: &Vec<Silhouette>| {
        let seen = |(k, frame): (usize, &Silhouette)| frame.centre_px().map(|centre| (k, centre));
        let (first, a) = film.iter().enumerate().find_map(seen)?;
        let (last, b) = film.iter().enumerate().rev().find_map(seen)?;
        let (dx, dy) = (b.0 - a.0, b.1 - a.1);
        let seconds = (last > first).then(|| (last - first) as f64 / settings.rate_hz)?;
        let metres = (dx * dx + dy * dy).sqrt() * height_m / f64::from(settings.focal_px);
        Some(metres / seconds)
    };
    let speeds: Vec<f64> = films.iter().filter_map(speed).collect();
    (!speeds.is_empty()).then(|| speeds.iter().sum::<f64>() / speeds.len() as f64)
}
