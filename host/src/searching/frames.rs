//! Folders of frames: PNG silhouettes with an `index.csv` (`t_s,file`), as a run of a data set names them by `frames = "folder"`.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use camera::{Silhouette, picture};
use rayon::prelude::*;

use crate::data_folder::DataFolder;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};

/// Name of the list inside the folder.
pub const INDEX: &str = "index.csv";
/// Its first line.
pub const HEADER: &str = "t_s,file";
/// Most frames of a film at the rate of its camera: over an hour at 30 a second.
pub const MAX_FRAMES: usize = 1 << 17;
/// Most memory for the robot's pixels in all frames of a film, bytes: an hour of a robot of 200 x 200 pixels is 0.6 of it.
const MAX_FILM: u64 = 256 << 20;
const TOO_LARGE: &str = "the robot in the frames of this film takes more than 256 MiB";

/// Silhouettes with their times, in rising order.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Frames {
    /// Time of each frame, s from the start of the gait.
    pub t_s: Vec<f64>,
    /// The frames, all of one size.
    pub frames: Vec<Silhouette>,
}

impl Frames {
    /// Reads a folder that a person named.
    ///
    /// # Errors
    /// Exit code 3 with file and line.
    pub fn read(folder: &Path) -> Outcome<Self> {
        let opened = DataFolder::open(folder).map_err(|e| no_film(&folder.join(INDEX), &e))?;
        Self::read_in(&opened, "")
    }

    /// Reads a folder that a data set names.
    ///
    /// # Errors
    /// Exit code 3 with file and line.
    pub fn read_in(set: &DataFolder, name: &str) -> Outcome<Self> {
        let listed = index_in(set, name)?;
        let folder = set.shown(name);
        let held = Held::default();
        let frames = listed
            .par_iter()
            .map(|(line, _, file)| {
                let frame = read_png(set, name, *line, file)?;
                let whole = |why| bad_line(&folder.join(INDEX), *line, why);
                held.take(frame).map_err(whole)
            })
            .collect::<Outcome<Vec<Silhouette>>>()?;
        let size = |frame: &Silhouette| (frame.width(), frame.height());
        if let Some(k) = frames.iter().position(|f| size(f) != size(&frames[0])) {
            let ((w, h), (w0, h0)) = (size(&frames[k]), size(&frames[0]));
            let why = format!("the frame is {w} x {h} pixels, the first is {w0} x {h0}");
            return Err(bad_line(&folder.join(INDEX), listed[k].0, &why));
        }
        let t_s = listed.iter().map(|(_, t_s, _)| *t_s).collect();
        Ok(Self { t_s, frames })
    }

    /// Writes a folder that does not exist or is empty.
    ///
    /// # Errors
    /// Exit code 2 when the folder holds something; 1 when the disk refuses.
    pub fn write(&self, folder: &Path) -> Outcome {
        disk::begin(folder)?;
        disk::claim(folder, &self.names(""))?;
        self.write_into(folder)?;
        disk::finish(folder)
    }

    /// Names of the files that [`Self::write_into`] writes, as a folder around that of the film `film` sees them.
    #[must_use]
    pub fn names(&self, film: &str) -> Vec<String> {
        let frames = (0..self.frames.len()).map(|k| within(film, &picture_name(k)));
        frames.chain([within(film, INDEX)]).collect()
    }

    /// Writes into a folder, over frames that it may hold.
    ///
    /// # Errors
    /// Exit code 1 when the disk refuses.
    pub fn write_into(&self, folder: &Path) -> Outcome {
        disk::make_folder(folder)?;
        let mut text = format!("{HEADER}\n");
        for (k, (t_s, frame)) in self.t_s.iter().zip(&self.frames).enumerate() {
            let file = picture_name(k);
            let png = picture::silhouette_png(frame).map_err(|e| Failure::new(Exit::Other, e))?;
            disk::write_part(&folder.join(&file), &png)?;
            let _ = writeln!(text, "{t_s:.6},{file}");
        }
        disk::write(&folder.join(INDEX), text.as_bytes())
    }

    /// The frame nearest in time to each instant 0, 1/rate, 2/rate, ... up to the last frame: lost frames are bridged, uneven ones
    /// put in their place.
    ///
    /// # Errors
    /// Exit code 3 when the film would be too long at this rate.
    pub fn at_rate(self, rate_hz: f64) -> Outcome<Vec<Silhouette>> {
        let nearest = nearest(&self.t_s, instants(&self.t_s, rate_hz)?, rate_hz);
        if nearest.iter().copied().eq(0..self.frames.len()) {
            return Ok(self.frames);
        }
        let bytes = nearest
            .iter()
            .map(|&k| self.frames[k].stored_bytes() as u64);
        if bytes.sum::<u64>() > MAX_FILM {
            return Err(Failure::say(Exit::BadFile, TOO_LARGE));
        }
        let frames = nearest.into_iter().map(|k| self.frames[k].clone());
        Ok(frames.collect())
    }
}

/// Name of the picture number `k` of a film.
fn picture_name(k: usize) -> String {
    format!("{k:05}.png")
}

/// The memory that the frames of a film take while they are read.
#[derive(Debug, Default)]
pub struct Held(AtomicU64);

impl Held {
    /// Counts a frame in.
    ///
    /// # Errors
    /// What is wrong when the film is too large.
    pub fn take(&self, frame: Silhouette) -> Result<Silhouette, &'static str> {
        let bytes = frame.stored_bytes() as u64;
        if self.0.fetch_add(bytes, Ordering::Relaxed) + bytes > MAX_FILM {
            return Err(TOO_LARGE);
        }
        Ok(frame)
    }
}

/// Number of the instants 0, 1/rate, 2/rate, ... up to the last frame.
///
/// # Errors
/// Exit code 3 when there are too many.
pub fn instants(t_s: &[f64], rate_hz: f64) -> Outcome<usize> {
    let Some(last_s) = t_s.last() else {
        return Ok(0);
    };
    let count = (last_s * rate_hz + 0.5).max(0.0);
    if count < MAX_FRAMES as f64 {
        return Ok(count as usize + 1);
    }
    let message = format!(
        "the film has frames until {last_s} s: at {rate_hz} frames a second these are more than {MAX_FRAMES}"
    );
    Err(Failure::say(Exit::BadFile, message)
        .hint("look at the times of index.csv and at camera.rate_hz"))
}

/// Index of the nearest of the rising times to each of the first instants of a rate.
fn nearest(t_s: &[f64], instants: usize, rate_hz: f64) -> Vec<usize> {
    let mut k = 0;
    let at = |instant: usize| {
        let t = instant as f64 / rate_hz;
        while k + 1 < t_s.len() && (t_s[k + 1] - t).abs() < (t_s[k] - t).abs() {
            k += 1;
        }
        k
    };
    (0..instants).map(at).collect()
}

/// Lines of a folder's index as (line number, time, file name).
///
/// # Errors
/// Exit code 3 with file and line.
pub fn index_in(set: &DataFolder, name: &str) -> Outcome<Vec<(usize, f64, String)>> {
    let path = set.shown(name).join(INDEX);
    let text = set
        .text(&within(name, INDEX), disk::MAX_TEXT)
        .map_err(|e| no_film(&path, &e))?;
    parse_index(&path, &text)
}

/// Lines of the text of an index as (line number, time, file name); `path` is for messages.
///
/// # Errors
/// Exit code 3 with file and line.
pub fn parse_index(path: &Path, text: &str) -> Outcome<Vec<(usize, f64, String)>> {
    let mut lines = text
        .lines()
        .enumerate()
        .map(|(k, line)| (k + 1, line.trim()));
    if lines.next().map(|(_, line)| line) != Some(HEADER) {
        return Err(bad_line(path, 1, "the first line is not `t_s,file`"));
    }
    let mut listed: Vec<(usize, f64, String)> = Vec::new();
    for (line, text) in lines.filter(|(_, line)| !line.is_empty()) {
        let bad = |why: &str| bad_line(path, line, why);
        let (t_s, file) = text.split_once(',').ok_or_else(|| bad("no comma"))?;
        let t_s: f64 = t_s
            .trim()
            .parse()
            .map_err(|_| bad("the time is no number"))?;
        let before = listed.last().map_or(f64::NEG_INFINITY, |last| last.1);
        if !(t_s.is_finite() && t_s > before) {
            return Err(bad("times must rise from line to line"));
        }
        if !files::dataset::is_inside(file.trim()) {
            return Err(bad("the picture must lie in the folder of the film"));
        }
        listed.push((line, t_s, file.trim().to_owned()));
    }
    if listed.is_empty() {
        return Err(bad_line(path, 1, "no frame is listed"));
    }
    if listed.len() > MAX_FRAMES {
        return Err(bad_line(path, MAX_FRAMES, "too many frames are listed"));
    }
    Ok(listed)
}

/// Name of a picture of a film as its data set would write it.
#[must_use]
pub fn within(film: &str, file: &str) -> String {
    match film {
        "" => file.to_owned(),
        film => format!("{film}/{file}"),
    }
}

fn read_png(set: &DataFolder, film: &str, line: usize, file: &str) -> Outcome<Silhouette> {
    let folder = set.shown(film);
    let bytes = set
        .bytes(&within(film, file), disk::MAX_TEXT)
        .map_err(|e| bad_line(&folder.join(INDEX), line, &format!("{file}: {e}")))?;
    let path = folder.join(file);
    picture::read_silhouette_png(&bytes)
        .map_err(|e| Failure::say(Exit::BadFile, format!("{}: {e}", path.display())))
}

fn no_film(path: &Path, error: &std::io::Error) -> Failure {
    Failure::say(Exit::BadFile, format!("{}: {error}", path.display())).hint(
        "a film is a folder of PNG silhouettes with an index.csv; `rb-host camera import` and `silhouette` make one",
    )
}

fn bad_line(path: &Path, line: usize, why: &str) -> Failure {
    Failure::say(Exit::BadFile, format!("{}:{line}: {why}", path.display()))
        .hint("the first line is `t_s,file`; each other line is a time in seconds and a file name")
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use super::{instants, nearest};

    #[test]
    fn instants_take_the_nearest_frame() {
        let even: Vec<f64> = (0..5).map(|k| f64::from(k) / 30.0).collect();
        let nearest = |t_s: &[f64], rate_hz| nearest(t_s, instants(t_s, rate_hz).unwrap(), rate_hz);
        assert_eq!(nearest(&even, 30.0), [0, 1, 2, 3, 4]);
        assert_eq!(nearest(&even, 15.0), [0, 2, 4]);
        // The third frame was lost, the last is a little late.
        assert_eq!(nearest(&[0.0, 0.034, 0.1, 0.14], 30.0), [0, 1, 1, 2, 3]);
        // The film begins 70 ms after the gait.
        assert_eq!(nearest(&[0.07, 0.1], 30.0), [0, 0, 0, 1]);
        assert!(nearest(&[], 30.0).is_empty());
        assert!(instants(&[1e300], 30.0).is_err() && instants(&[1.0], 1e300).is_err());
    }
}
