//! Films of a data set: the camera table, folders of silhouettes, and the gaits they show.

use std::path::Path;

use camera::{Silhouette, picture};
use files::dataset::{Camera, Manifest, Recording, Role, Run};
use files::model::Key;
use optimise::meta::{FilmSettings, FilmedGait};

use crate::failure::{Exit, Failure, Outcome};

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
/// Exit code 3 for files that are missing or wrong.
pub fn load(
    folder: &Path,
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
    let mut gaits = Vec::new();
    for name in names {
        let runs: Vec<&Run> = manifest
            .runs
            .iter()
            .filter(|run| run.gait == name && run.frames.is_some())
            .collect();
        let films = runs
            .iter()
            .map(|run| read_film(folder, run))
            .collect::<Outcome<Vec<_>>>()?;
        let gait = crate::gait_file::load(&folder.join("gaits").join(format!("{name}.toml")))?;
        let speed_m_s = mean_speed_m_s(&films, &settings, height_m);
        let is_training = match training {
            [] => runs.iter().all(|run| run.role == Some(Role::Fit)),
            named => named.iter().any(|n| n == name),
        };
        let start_m = start_m(folder, manifest, runs[0])?;
        let filmed = FilmedGait::new(gait, films, start_m, speed_m_s, is_training)
            .map_err(|error| Failure::say(Exit::BadFile, format!("gait {name}: {error}")))?;
        gaits.push(filmed);
    }
    Ok(gaits)
}

/// Where body 3 began by the first base row of the run; under the camera's origin when the pose was not measured.
fn start_m(folder: &Path, manifest: &Manifest, run: &Run) -> Outcome<[f32; 2]> {
    let path = folder.join(&run.file);
    let shown = path.display().to_string();
    let text = std::fs::read_to_string(&path)
        .map_err(|e| Failure::say(Exit::BadFile, format!("{shown}: {e}")))?;
    let (recording, _) =
        Recording::parse(&shown, &text, manifest).map_err(|e| Failure::new(Exit::BadFile, e))?;
    let first = |column: &Option<Vec<f64>>| {
        let measured = column
            .as_ref()
            .and_then(|c| c.iter().find(|v| v.is_finite()));
        measured.map_or(0.0, |v| *v as f32)
    };
    let [x, y, _] = &recording.body().base_m;
    Ok([first(x), first(y)])
}

/// The frames of one run, in the order of its `index.csv`.
fn read_film(folder: &Path, run: &Run) -> Outcome<Vec<Silhouette>> {
    let frames = folder.join(run.frames.as_deref().unwrap_or_default());
    let index = frames.join("index.csv");
    let shown = index.display().to_string();
    let bad = |line: usize, why: String| {
        Failure::say(Exit::BadFile, format!("{shown}:{line}: {why}"))
            .hint("each line is `t_s,file`, the first is that header")
    };
    let text = std::fs::read_to_string(&index)
        .map_err(|e| Failure::say(Exit::BadFile, format!("{shown}: {e}")))?;
    let mut film = Vec::new();
    for (k, line) in text.lines().enumerate().skip(1) {
        let (_, file) = line
            .split_once(',')
            .ok_or_else(|| bad(k + 1, "no comma".to_owned()))?;
        let bytes = std::fs::read(frames.join(file.trim()))
            .map_err(|e| bad(k + 1, format!("{file}: {e}")))?;
        film.push(
            picture::read_silhouette_png(&bytes).map_err(|e| bad(k + 1, format!("{file}: {e}")))?,
        );
    }
    Ok(film)
}

/// Distance of the outline's centre between the first and the last frame that show the robot, over the time between, on the ground below
/// a camera at `height_m`; 0 when it is never seen twice.
fn mean_speed_m_s(films: &[Vec<Silhouette>], settings: &FilmSettings, height_m: f64) -> f64 {
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
    speeds.iter().sum::<f64>() / speeds.len().max(1) as f64
}
