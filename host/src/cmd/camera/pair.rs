//! `rb-host camera overlay`, `strip` and `animate`: a film of the robot beside one of the simulation.

use std::path::{Path, PathBuf};
use std::time::Duration;

use camera::{Silhouette, picture, viewer};
use serde_json::json;

use crate::cli::parse_duration;
use crate::context::Context;
use crate::disk::write_new;
use crate::failure::{Exit, Failure, Outcome};
use crate::searching::films;
use crate::searching::frames::Frames;

/// Two films and how they are laid on each other in time.
#[derive(Debug, clap::Args)]
pub(super) struct Films {
    /// Film folder of the robot
    pub(super) robot: PathBuf,
    /// Film folder of the simulation
    pub(super) simulated: PathBuf,
    /// Compare the robot at t with the simulation at t plus this time, such as 400ms
    #[arg(long, value_name = "TIME", value_parser = parse_duration, default_value = "0")]
    pub(super) shift: Duration,
    /// Frames per second at which both are looked at
    #[arg(long, value_name = "HZ", default_value_t = films::RATE_HZ)]
    pub(super) rate: f64,
}

impl Films {
    /// Frames of both at the same instants, as long as both last.
    pub(super) fn read(&self) -> Outcome<Pair> {
        if !(self.rate.is_finite() && self.rate > 0.0) {
            let message = format!("--rate {}: it must be above 0", self.rate);
            return Err(Failure::say(Exit::Usage, message));
        }
        let robot = Frames::read(&self.robot)?;
        let mut simulated = Frames::read(&self.simulated)?;
        let size = |frames: &Frames| (frames.frames[0].width(), frames.frames[0].height());
        let ((w, h), (ws, hs)) = (size(&robot), size(&simulated));
        if (w, h) != (ws, hs) {
            let message = format!(
                "{} has frames of {w} x {h} pixels, {} of {ws} x {hs}",
                self.robot.display(),
                self.simulated.display()
            );
            return Err(Failure::say(Exit::BadFile, message)
                .hint("`rb-host camera simulate` films with the camera of the data set"));
        }
        let shift_s = self.shift.as_secs_f64();
        simulated.t_s.iter_mut().for_each(|t_s| *t_s -= shift_s);
        let frames: Vec<_> = robot
            .at_rate(self.rate)?
            .into_iter()
            .zip(simulated.at_rate(self.rate)?)
            .collect();
        if frames.is_empty() {
            let message = "the shift leaves no common time of both films";
            return Err(Failure::say(Exit::Usage, message).hint("give a smaller --shift"));
        }
        let t_s = (0..frames.len()).map(|k| k as f64 / self.rate).collect();
        Ok(Pair { t_s, frames })
    }
}

/// Frames of robot and simulation at the same instants.
pub(super) struct Pair {
    pub(super) t_s: Vec<f64>,
    pub(super) frames: Vec<(Silhouette, Silhouette)>,
}

impl Pair {
    fn refs(&self) -> Vec<(&Silhouette, &Silhouette)> {
        self.frames.iter().map(|(a, b)| (a, b)).collect()
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct OverlayArgs {
    #[command(flatten)]
    films: Films,
    /// Instant of the frame
    #[arg(long, value_name = "TIME", value_parser = parse_duration, default_value = "0")]
    at: Duration,
    /// PNG to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Overwrite an existing file
    #[arg(long)]
    force: bool,
}

#[derive(Debug, clap::Args)]
pub(super) struct StripArgs {
    #[command(flatten)]
    films: Films,
    /// Frames in a row, from the first to the last that shows the robot or its simulation
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=100))]
    frames: u16,
    /// PNG to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Overwrite an existing file
    #[arg(long)]
    force: bool,
}

#[derive(Debug, clap::Args)]
pub(super) struct AnimateArgs {
    #[command(flatten)]
    films: Films,
    /// File to write: .png for an animated PNG, .html for a page with a slider
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Overwrite an existing file
    #[arg(long)]
    force: bool,
}

/// Writes one overlaid frame.
pub(super) fn overlay(args: &OverlayArgs, context: &Context) -> Outcome {
    let pair = args.films.read()?;
    let at_s = args.at.as_secs_f64();
    let k = (at_s * args.films.rate + 0.5) as usize;
    let Some((robot, simulated)) = pair.frames.get(k) else {
        let last_s = pair.t_s.last().copied().unwrap_or(0.0);
        let message = format!("--at {at_s} s: the films have {last_s:.2} s in common");
        return Err(Failure::say(Exit::Usage, message).hint("name an earlier instant"));
    };
    let png = picture::overlay_png(robot, simulated).map_err(|e| Failure::new(Exit::Other, e))?;
    write_new(&args.output, &png, args.force)?;
    let (overlap, union) = robot.overlap_and_union_px(simulated).unwrap_or((0, 0));
    let r = (union > 0).then(|| f64::from(overlap) / f64::from(union));
    let value = json!({ "file": args.output, "t_s": pair.t_s[k], "r": r });
    context.out.result("rb.camera_overlay/1", value, || {
        let r = r.map_or_else(
            || "no robot in either frame".to_owned(),
            |r| format!("R {r:.3}"),
        );
        format!("{}: {r} at {:.2} s", args.output.display(), pair.t_s[k])
    });
    Ok(())
}

/// Writes the film strip.
pub(super) fn strip(args: &StripArgs, context: &Context) -> Outcome {
    let pair = args.films.read()?;
    let shown =
        |(robot, simulated): &(Silhouette, Silhouette)| robot.area_px() + simulated.area_px() > 0;
    let first = pair.frames.iter().position(shown).unwrap_or(0);
    let last = pair.frames.iter().rposition(shown).unwrap_or(0);
    let count = usize::from(args.frames);
    let at = |i: usize| {
        let further = i * (last - first);
        first + further.checked_div(count - 1).unwrap_or(0)
    };
    let picked: Vec<usize> = (0..count).map(at).collect();
    let robot: Vec<&Silhouette> = picked.iter().map(|&k| &pair.frames[k].0).collect();
    let simulated: Vec<&Silhouette> = picked.iter().map(|&k| &pair.frames[k].1).collect();
    let png =
        picture::film_strip_png(&robot, &simulated).map_err(|e| Failure::new(Exit::Other, e))?;
    write_new(&args.output, &png, args.force)?;
    let times: Vec<f64> = picked.iter().map(|&k| pair.t_s[k]).collect();
    let value = json!({ "file": args.output, "t_s": times });
    context.out.result("rb.camera_strip/1", value, || {
        let times: Vec<String> = times.iter().map(|t_s| format!("{t_s:.1}")).collect();
        format!(
            "{}: frames at {} s",
            args.output.display(),
            times.join(", ")
        )
    });
    Ok(())
}

/// Writes the animated overlay.
pub(super) fn animate(args: &AnimateArgs, context: &Context) -> Outcome {
    let extension = args.output.extension().and_then(|e| e.to_str());
    let Some(kind @ ("png" | "html")) = extension else {
        let message = format!("{}: what kind of animation?", args.output.display());
        return Err(Failure::say(Exit::Usage, message).hint(
            "end the name in .png for an animated PNG or in .html for a page with a slider",
        ));
    };
    let pair = args.films.read()?;
    let frames = pair.refs();
    let bytes = if kind == "png" {
        // The delay of a frame is a whole part of a second.
        let rate_hz = args.films.rate.clamp(1.0, 1000.0) as u16;
        picture::animation_png(&frames, rate_hz)
    } else {
        let title = format!(
            "{} and {}",
            name(&args.films.robot),
            name(&args.films.simulated)
        );
        viewer::overlay_html(&title, &pair.t_s, &frames).map(String::into_bytes)
    };
    let bytes = bytes.map_err(|e| Failure::new(Exit::Other, e))?;
    write_new(&args.output, &bytes, args.force)?;
    let value = json!({ "file": args.output, "frames": frames.len(), "bytes": bytes.len() });
    context.out.result("rb.camera_animate/1", value, || {
        format!("{}: {} frames", args.output.display(), frames.len())
    });
    Ok(())
}

fn name(path: &Path) -> String {
    path.file_name().map_or_else(
        || path.display().to_string(),
        |n| n.to_string_lossy().into_owned(),
    )
}
