//! `rb-host camera import`, `background` and `silhouette`: from what a camera recorded to silhouettes.

use std::fmt::Write as _;
use std::fs::File;
use std::path::{Path, PathBuf};

use camera::depth::{self, DepthFrame, Samples};
use camera::{Silhouette, picture};
use rayon::prelude::*;
use serde_json::json;

use crate::context::Context;
use crate::data_folder::DataFolder;
use crate::disk;
use crate::disk::write_new;
use crate::failure::{Exit, Failure, Outcome};
use crate::searching::films;
use crate::searching::frames::{Frames, HEADER, Held, INDEX, index_in};

#[derive(Debug, clap::Args)]
pub(super) struct ImportArgs {
    /// Folder of fakenect-record (INDEX.txt), or of PGM or PNG pictures whose names sort in time
    source: PathBuf,
    /// Folder to write: frames and index.csv
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Frames per second of a folder without times
    #[arg(long, value_name = "HZ", default_value_t = films::RATE_HZ)]
    rate: f64,
}

#[derive(Debug, clap::Args)]
pub(super) struct BackgroundArgs {
    /// Imported folder of depth frames
    depth: PathBuf,
    /// PGM to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Overwrite an existing file
    #[arg(long)]
    force: bool,
}

#[derive(Debug, clap::Args)]
pub(super) struct SilhouetteArgs {
    /// Imported folder of depth frames
    depth: PathBuf,
    /// Empty scene from `camera background`; the median of these frames when absent
    #[arg(long, value_name = "FILE")]
    background: Option<PathBuf>,
    /// Folder to write: 1-bit PNG and index.csv
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// How much closer than the background the robot is at least, in raw units of the camera
    #[arg(long, alias = "step", value_name = "RAW", default_value_t = STEP_RAW)]
    closer: u16,
}

/// Depth frames that the background is taken from at most; enough for a median, few enough for memory.
const BACKGROUND_FRAMES: usize = 61;

/// 45 mm at 2.2 m, where one unit of a Kinect's 11-bit disparity is 15 mm (1/m = 3.33 - 0.00307 raw, libfreenect): above its noise of
/// about one unit, below the 110 mm of a robot that lies down.
const STEP_RAW: u16 = 3;

/// A picture of the source and its time.
struct Source {
    /// Name in the folder.
    name: String,
    t_s: f64,
    samples: Samples,
}

enum Picture {
    Depth(DepthFrame),
    Silhouette(Silhouette),
}

/// Reads foreign pictures and writes a folder of ours.
pub(super) fn import(args: &ImportArgs, context: &Context) -> Outcome {
    if !(args.rate.is_finite() && args.rate > 0.0) {
        let message = format!("--rate {}: it must be above 0", args.rate);
        return Err(Failure::say(Exit::Usage, message));
    }
    let folder = DataFolder::open(&args.source).map_err(|e| disk::bad_file(&args.source, &e))?;
    let sources = sources(&folder, &args.source, args.rate)?;
    disk::begin(&args.output)?;
    let either = |k: usize| ["pgm", "png"].map(|kind| picture_name(k, kind));
    let mut names: Vec<String> = (0..sources.len()).flat_map(either).collect();
    names.push(INDEX.to_owned());
    disk::claim(&args.output, &names)?;
    let bar = context.out.progress(sources.len() as u64, "importing");
    let names = sources
        .par_iter()
        .enumerate()
        .map(|(k, source)| convert(k, &folder, source, &args.output).inspect(|_| bar.inc(1)))
        .collect::<Outcome<Vec<(String, [usize; 2])>>>()?;
    bar.finish_and_clear();
    let (first, size) = &names[0];
    let extension = |name: &str| Path::new(name).extension().map(ToOwned::to_owned);
    for ((name, found), source) in names.iter().zip(&sources) {
        if found != size || extension(name) != extension(first) {
            let shown = folder.shown(&source.name);
            let shown = shown.display();
            let message = format!("{shown} is not of the size and kind of the first picture");
            return Err(Failure::say(Exit::BadFile, message)
                .hint("a film has pictures of one size, all depth or all silhouettes"));
        }
    }
    let mut text = format!("{HEADER}\n");
    for ((name, _), source) in names.iter().zip(&sources) {
        let _ = writeln!(text, "{:.6},{name}", source.t_s);
    }
    disk::write(&args.output.join(INDEX), text.as_bytes())?;
    disk::finish(&args.output)?;
    let kind = if first.ends_with("pgm") {
        "depth frames"
    } else {
        "silhouettes"
    };
    let length_s = sources.last().map_or(0.0, |last| last.t_s);
    let value = json!({
        "folder": args.output, "frames": names.len(), "kind": kind, "length_s": length_s, "width_px": size[0], "height_px": size[1],
    });
    context.out.result("rb.camera_import/1", value, || {
        format!(
            "{} {kind} of {} x {} pixels, {length_s:.2} s, in {}",
            names.len(),
            size[0],
            size[1],
            args.output.display()
        )
    });
    Ok(())
}

/// The list of pictures that fakenect-record writes.
const DUMP: &str = "INDEX.txt";

/// The pictures of a folder in the order of time, the first at 0 s.
fn sources(folder: &DataFolder, path: &Path, rate_hz: f64) -> Outcome<Vec<Source>> {
    let shown = path.display();
    let mut sources: Vec<Source> = if folder.has(DUMP) {
        let text = folder
            .text(DUMP, disk::MAX_TEXT)
            .map_err(|e| disk::bad_file(&path.join(DUMP), &e))?;
        let entries = depth::read_fakenect_index(&text).into_iter();
        let source = |entry: depth::IndexEntry| Source {
            name: entry.file,
            t_s: entry.t_s,
            samples: Samples::LittleEndian,
        };
        entries.map(source).collect()
    } else {
        let entries = std::fs::read_dir(path)
            .map_err(|e| Failure::say(Exit::BadFile, format!("{shown}: {e}")))?;
        let mut names = entries
            .map(|entry| entry.map(|entry| entry.file_name().to_string_lossy().into_owned()))
            .collect::<Result<Vec<String>, _>>()
            .map_err(|e| disk::bad_file(path, &e))?;
        names.retain(|name| name.ends_with(".pgm") || name.ends_with(".png"));
        names.sort();
        let source = |(k, name)| Source {
            name,
            t_s: k as f64 / rate_hz,
            samples: Samples::BigEndian,
        };
        names.into_iter().enumerate().map(source).collect()
    };
    let Some(first_s) = sources.first().map(|first| first.t_s) else {
        return Err(Failure::say(Exit::BadFile, format!("{shown} holds no depth frame")).hint(
            "give a folder of fakenect-record (INDEX.txt with d-*.pgm) or one of .pgm or .png pictures",
        ));
    };
    sources.iter_mut().for_each(|source| source.t_s -= first_s);
    // A dump can hold a frame twice with one time stamp.
    sources.dedup_by(|later, earlier| later.t_s <= earlier.t_s);
    Ok(sources)
}

/// Name of picture `k` of a film in our form.
fn picture_name(k: usize, kind: &str) -> String {
    format!("{k:05}.{kind}")
}

/// Writes one picture in our form; its name and size.
fn convert(
    k: usize,
    folder: &DataFolder,
    source: &Source,
    output: &Path,
) -> Outcome<(String, [usize; 2])> {
    let picture = read_picture(folder, source)?;
    let (name, size, bytes) = match picture {
        Picture::Depth(frame) => (
            picture_name(k, "pgm"),
            [frame.width, frame.height],
            depth::write_pgm(&frame),
        ),
        Picture::Silhouette(frame) => (
            picture_name(k, "png"),
            [frame.width(), frame.height()],
            picture::silhouette_png(&frame).map_err(|e| Failure::new(Exit::Other, e))?,
        ),
    };
    disk::write_part(&output.join(&name), &bytes)?;
    Ok((name, size))
}

fn read_picture(folder: &DataFolder, source: &Source) -> Outcome<Picture> {
    let path = folder.shown(&source.name);
    let bad =
        |e: &dyn std::fmt::Display| Failure::say(Exit::BadFile, format!("{}: {e}", path.display()));
    let bytes = folder
        .bytes(&source.name, disk::MAX_PICTURE)
        .map_err(|e| bad(&e))?;
    if source.name.ends_with(".pgm") {
        let frame = depth::read_pgm(&bytes, source.samples).map_err(|e| bad(&e))?;
        return Ok(Picture::Depth(frame));
    }
    match depth::read_png(&bytes) {
        Ok(frame) => Ok(Picture::Depth(frame)),
        Err(picture::PictureError::NoDepth { .. }) => picture::read_silhouette_png(&bytes)
            .map(Picture::Silhouette)
            .map_err(|e| bad(&e)),
        Err(error) => Err(bad(&error)),
    }
}

/// Writes the median of a recording.
pub(super) fn background(args: &BackgroundArgs, context: &Context) -> Outcome {
    let (folder, listed) = recorded(&args.depth)?;
    let ground = median(&folder, &args.depth, &listed)?;
    write_new(&args.output, &depth::write_pgm(&ground), args.force)?;
    let unknown = ground.raw.iter().filter(|&&r| r == depth::NO_READING);
    let share = unknown.count() as f64 / ground.raw.len().max(1) as f64;
    let value =
        json!({ "file": args.output, "frames": listed.len(), "share_without_reading": share });
    context.out.result("rb.camera_background/1", value, || {
        format!(
            "{}: median of {} frames, {:.1} % of the pixels without a reading",
            args.output.display(),
            listed.len().min(BACKGROUND_FRAMES),
            share * 100.0
        )
    });
    Ok(())
}

/// The median over frames spread evenly through a recording.
fn median(
    folder: &DataFolder,
    path: &Path,
    listed: &[(usize, f64, String)],
) -> Outcome<DepthFrame> {
    let every = listed.len().div_ceil(BACKGROUND_FRAMES).max(1);
    let frames = listed
        .iter()
        .step_by(every)
        .map(|(_, _, file)| read_depth(&folder.shown(file), folder.file(file)))
        .collect::<Outcome<Vec<_>>>()?;
    depth::background(&frames)
        .map_err(|e| Failure::say(Exit::BadFile, format!("{}: {e}", path.display())))
}

/// Pictures of a folder: line of the index, time in s, file name.
type Listed = Vec<(usize, f64, String)>;

/// A folder of depth frames and its index.
fn recorded(path: &Path) -> Outcome<(DataFolder, Listed)> {
    let folder = DataFolder::open(path).map_err(|e| disk::bad_file(path, &e))?;
    let listed = index_in(&folder, "")?;
    Ok((folder, listed))
}

fn read_depth(path: &Path, opened: std::io::Result<File>) -> Outcome<DepthFrame> {
    let bad = |e: &dyn std::fmt::Display| {
        Failure::say(Exit::BadFile, format!("{}: {e}", path.display()))
            .hint("depth frames are 16-bit PGM; `rb-host camera import` makes them")
    };
    let bytes = opened
        .and_then(|file| disk::read_opened(file, disk::MAX_PICTURE))
        .map_err(|e| bad(&e))?;
    depth::read_pgm(&bytes, Samples::BigEndian).map_err(|e| bad(&e))
}

/// Cuts the robot out of every frame.
pub(super) fn silhouette(args: &SilhouetteArgs, context: &Context) -> Outcome {
    disk::must_be_empty(&args.output)?;
    let (folder, listed) = recorded(&args.depth)?;
    let ground = match &args.background {
        Some(path) => read_depth(path, disk::open_regular(path))?,
        None => median(&folder, &args.depth, &listed)?,
    };
    let held = Held::default();
    let bar = context.out.progress(listed.len() as u64, "cutting out");
    let frames = listed
        .par_iter()
        .map(|(_, _, file)| {
            let path = folder.shown(file);
            let bad = |why: &dyn std::fmt::Display| {
                Failure::say(Exit::BadFile, format!("{}: {why}", path.display()))
            };
            let frame = read_depth(&path, folder.file(file))?;
            let cut = depth::silhouette(&frame, &ground, args.closer).map_err(|e| bad(&e))?;
            bar.inc(1);
            held.take(cut.cropped()).map_err(|e| bad(&e))
        })
        .collect::<Outcome<Vec<Silhouette>>>()?;
    bar.finish_and_clear();
    let t_s = listed.iter().map(|(_, t_s, _)| *t_s).collect();
    let empty = frames.iter().filter(|frame| frame.area_px() == 0).count();
    let total: u64 = frames.iter().map(|frame| u64::from(frame.area_px())).sum();
    let film = Frames { t_s, frames };
    film.write(&args.output)?;
    let (count, mean_px) = (film.frames.len(), total / film.frames.len().max(1) as u64);
    if empty > 0 {
        context.out.warn(format_args!(
            "{empty} of {count} frames show no robot: it left the picture, or --closer {} is too much",
            args.closer
        ));
    }
    let value =
        json!({ "folder": args.output, "frames": count, "empty": empty, "mean_area_px": mean_px });
    context.out.result("rb.camera_silhouette/1", value, || {
        format!(
            "{count} silhouettes, {mean_px} pixels on average, in {}",
            args.output.display()
        )
    });
    Ok(())
}
