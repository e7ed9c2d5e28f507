//! What instruments beside the robot saw of a run, and how it is laid on the robot's clock.
//!
//! A camera knows nothing of the robot's clock. The mark is the first motion: the robot rests, then moves. See
//! [`camera::sync`].

use std::path::Path;

use camera::Silhouette;
use camera::sync::{Alignment, SyncError, Travel, align};
use serde_json::{Value, json};

use super::reader::RunData;
use super::timing::Timing;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::searching::frames::Frames;

/// A pose of body 3.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BaseRow {
    /// Instant, s of the instrument's clock.
    pub t_s: f64,
    /// Position in the world, m.
    pub position_m: [f64; 3],
    /// Rotation, Hamilton, w first.
    pub quaternion: [f64; 4],
}

/// An inertial reading at the origin of body 3.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuRow {
    /// Instant, s of the robot's clock.
    pub t_s: f64,
    /// Angular velocity, rad/s.
    pub gyro_rad_s: [f64; 3],
    /// Specific force, m/s2.
    pub accel_m_s2: [f64; 3],
}

/// Everything seen from before the first motion to after the last, on the instruments' own clocks.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Seen {
    /// Film, times on the camera's clock.
    pub film: Frames,
    /// Base poses on the camera's clock.
    pub base: Vec<BaseRow>,
    /// Inertial readings on the robot's clock.
    pub imu: Vec<ImuRow>,
}

impl Seen {
    /// Without the film and the poses that are laid in time by it.
    #[must_use]
    pub fn without_film(self) -> Self {
        Self {
            imu: self.imu,
            ..Self::default()
        }
    }
}

/// The same on the run's time, from its t = 0 to its end.
#[derive(Debug, Clone, PartialEq)]
pub struct Laid {
    /// Film; one frame of lead is kept.
    pub film: Frames,
    /// Base poses.
    pub base: Vec<BaseRow>,
    /// Inertial readings.
    pub imu: Vec<ImuRow>,
    /// How the camera's clock was found; `None` without a film.
    pub alignment: Option<Alignment>,
}

/// Why what was seen does not fit the run.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LayError {
    /// The recording holds no gait.
    #[error("the recording holds no set-point of the gait")]
    NoGait,
    /// Poses without a film have no mark.
    #[error("poses of the base without a film: there is no mark to lay them in time by")]
    NoFilm,
    /// No mark was found.
    #[error(transparent)]
    Sync(#[from] SyncError),
}

/// Lays what was seen on the time of a run by the first motion.
///
/// # Errors
/// [`LayError`]
pub fn lay(seen: Seen, run: &RunData) -> Result<Laid, LayError> {
    let timing = Timing::of(run).ok_or(LayError::NoGait)?;
    let start_s = timing.start_us as f64 * 1e-6;
    let length_s = (timing.end_us - timing.start_us) as f64 * 1e-6;
    let alignment = if seen.film.frames.is_empty() {
        None
    } else {
        Some(align(&change(&seen.film), &way(run))?)
    };
    if alignment.is_none() && !seen.base.is_empty() {
        return Err(LayError::NoFilm);
    }
    let camera_s = alignment.map_or(0.0, |a| a.offset_s) - start_s;
    let half_frame_s = 0.5 * frame_period_s(&seen.film);
    let inside = |t_s: f64, early_s: f64| t_s >= -early_s && t_s <= length_s;
    let (t_s, frames) = seen
        .film
        .t_s
        .iter()
        .map(|t_s| t_s + camera_s)
        .zip(seen.film.frames)
        .filter(|(t_s, _)| inside(*t_s, half_frame_s))
        .unzip();
    let base = seen.base.into_iter().map(|row| BaseRow {
        t_s: row.t_s + camera_s,
        ..row
    });
    let imu = seen.imu.into_iter().map(|row| ImuRow {
        t_s: row.t_s - start_s,
        ..row
    });
    Ok(Laid {
        film: Frames { t_s, frames },
        base: base.filter(|row| inside(row.t_s, 0.0)).collect(),
        imu: imu.filter(|row| inside(row.t_s, 0.0)).collect(),
        alignment,
    })
}

/// Mean time between frames, s.
fn frame_period_s(film: &Frames) -> f64 {
    match film.t_s.as_slice() {
        [first, .., last] => (last - first) / (film.t_s.len() - 1) as f64,
        _ => 0.0,
    }
}

/// How much the outline changes from frame to frame, px.
fn change(film: &Frames) -> Travel {
    let mut travel = Travel::new();
    let mut before: Option<&Silhouette> = None;
    for (t_s, frame) in film.t_s.iter().zip(&film.frames) {
        let parts = before.and_then(|b| b.overlap_and_union_px(frame));
        let changed = parts.map_or(0, |(overlap, union)| union - overlap);
        travel.push(*t_s, f64::from(changed));
        before = Some(frame);
    }
    travel
}

/// How far the joints turn from sample to sample, rad, root of the sum of squares; the way to the start pose included.
fn way(run: &RunData) -> Travel {
    let mut travel = Travel::new();
    let mut before = None;
    for sample in &run.samples {
        let measured: Vec<_> = sample.joints.iter().flat_map(|j| j.feedback).collect();
        if measured.len() != sample.joints.len() {
            continue;
        }
        let t_us = measured.iter().map(|f| f.t_us).sum::<u64>() as f64 / measured.len() as f64;
        let angles: Vec<f64> = measured.iter().map(|f| f.position_rad).collect();
        let squares = before.as_ref().map_or(0.0, |b: &Vec<f64>| {
            b.iter().zip(&angles).map(|(b, a)| (a - b) * (a - b)).sum()
        });
        travel.push(t_us * 1e-6, squares.sqrt());
        before = Some(angles);
    }
    travel
}

/// What a data set keeps beside a film about its place in time.
#[must_use]
pub fn alignment_json(alignment: &Alignment) -> Value {
    json!({
        "schema": "rb.sync/1", "mark": "first motion", "offset_s": alignment.offset_s,
        "edge_offset_s": alignment.edge_offset_s, "correlation": alignment.correlation, "rest_s": alignment.rest_s,
    })
}

/// Header of a track: times of the camera's clock and the base columns of the data set format.
const TRACK: [&str; 8] = [
    "t_s", "base_x_m", "base_y_m", "base_z_m", "base_qw", "base_qx", "base_qy", "base_qz",
];

/// Base poses on the camera's clock as a CSV.
#[must_use]
pub fn track_csv(base: &[BaseRow]) -> String {
    let mut text = TRACK.join(",") + "\n";
    for row in base {
        let numbers = row.position_m.iter().chain(&row.quaternion);
        let cells: Vec<String> = numbers.map(|v| format!("{v:.6}")).collect();
        text.push_str(&format!("{:.6},{}\n", row.t_s, cells.join(",")));
    }
    text
}

/// Reads base poses on the camera's clock from a CSV with the columns `t_s,base_x_m,...,base_qz`.
///
/// # Errors
/// Exit code 3 with file and line.
pub fn read_track(path: &Path) -> Outcome<Vec<BaseRow>> {
    let shown = path.display().to_string();
    let bad = |line: usize, why: &str| {
        Failure::say(Exit::BadFile, format!("{shown}:{line}: {why}"))
            .hint(format!("the first line is {}", TRACK.join(",")))
    };
    let text = disk::read_text(path, disk::MAX_TEXT)
        .map_err(|e| Failure::say(Exit::BadFile, format!("{shown}: {e}")))?;
    let mut lines = text.lines().enumerate();
    if lines.next().map(|(_, header)| header.trim()) != Some(TRACK.join(",").as_str()) {
        return Err(bad(1, "another header"));
    }
    let row = |(k, line): (usize, &str)| {
        let cells: Vec<f64> = line
            .split(',')
            .map(|cell| cell.trim().parse().ok().filter(|v: &f64| v.is_finite()))
            .collect::<Option<_>>()
            .ok_or_else(|| bad(k + 1, "a cell is no number"))?;
        match cells.as_slice() {
            &[t_s, x, y, z, qw, qx, qy, qz] => Ok(BaseRow {
                t_s,
                position_m: [x, y, z],
                quaternion: [qw, qx, qy, qz],
            }),
            other => Err(bad(k + 1, &format!("{} cells, not 8", other.len()))),
        }
    };
    lines
        .filter(|(_, line)| !line.trim().is_empty())
        .map(row)
        .collect()
}
