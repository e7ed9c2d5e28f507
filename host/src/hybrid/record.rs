//! The step on the robot: every selected gait several times, each take from the home pose, with its film.

use std::collections::BTreeMap;
use std::time::Duration;

use control::gait::Gait;
use files::dataset::Role;
use optimise::select::Chosen;

use super::Hybrid;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;
use crate::link::PortUri;
use crate::recording::beside::{self, Seen};
use crate::recording::set::SetFolder;
use crate::searching::folder::Folder;
use crate::searching::frames::Frames;
use crate::takes::{self, Take};

/// Samples per second of the motors.
const TELEMETRY_HZ: u32 = 20;
/// Gaits that the robot could not play, in the cycle's folder: name to reason.
const REFUSED: &str = "refused.json";

impl Hybrid<'_> {
    /// The data set of this cycle.
    pub(super) fn set(&self) -> Outcome<SetFolder> {
        let path = self.cycle_path().join("set");
        let uri = self.port()?;
        let camera = match &uri {
            PortUri::Sim(_) => takes::camera_toml(&uri)?,
            _ => self.state.camera.clone(),
        };
        let name = format!("hybrid cycle {}", self.state.cycle);
        SetFolder::open(&path, &name, &self.model()?.to_toml(), &camera)
    }

    pub(super) fn record(&mut self) -> Outcome {
        let uri = self.port()?;
        let set = self.set()?;
        let gaits = self.selected()?;
        let camera = set.camera()?;
        let folder = Folder::at(&self.cycle_path());
        let mut refused: BTreeMap<String, String> = BTreeMap::new();
        let takes = gaits.len() as u64 * u64::from(self.settings.repeats);
        let bar = self.context.out.progress(takes, "recording");
        for (gait, role) in &gaits {
            let start_m = takes::centred_start_m(&self.model()?, gait, &camera)?;
            for number in 1..=self.settings.repeats {
                bar.inc(1);
                let take = Take {
                    name: takes::name(gait, number),
                    gait: gait.clone(),
                    role: Some(*role),
                    duration: Duration::from_secs_f32(gait.duration_s()),
                    autonomous: false,
                    rate_hz: TELEMETRY_HZ,
                    slot: self.state.slot,
                    start_m,
                    filmed: true,
                };
                if set.runs()?.contains(&take.name) {
                    continue;
                }
                if let Some(reason) = self.take(&uri, &set, &take)? {
                    // Repeatability needs all takes, so the gait goes as a whole.
                    set.remove_gait(gait.name())?;
                    refused.insert(gait.name().to_owned(), reason);
                    break;
                }
            }
        }
        bar.finish_and_clear();
        let text = serde_json::to_string_pretty(&refused).map_err(anyhow::Error::from)?;
        folder.write(REFUSED, (text + "\n").as_bytes())?;
        if set.runs()?.is_empty() {
            let message = "the robot could play none of the gaits";
            return Err(Failure::say(Exit::Refused, message)
                .hint(format!("{} says why", folder.join(REFUSED).display())));
        }
        self.films(&set)
    }

    /// The selected gaits with their use.
    fn selected(&self) -> Outcome<Vec<(Gait, Role)>> {
        let path = self.cycle_path().join("search");
        let file = path.join("selection.json");
        let bad = |e: String| Failure::say(Exit::BadFile, format!("{}: {e}", file.display()));
        let text =
            disk::read_regular_text(&file, disk::MAX_TEXT).map_err(|e| bad(e.to_string()))?;
        let chosen: Vec<Chosen> = serde_json::from_str(&text).map_err(|e| bad(e.to_string()))?;
        if !chosen.iter().any(|gait| gait.training) {
            return Err(bad("the search found no gait to train with".to_owned())
                .hint("give it more particles or iterations, in a new folder"));
        }
        let gait = |(k, chosen): (usize, &Chosen)| {
            let file = path.join("gaits").join(format!("g{:02}.toml", k + 1));
            let role = if chosen.training {
                Role::Fit
            } else {
                Role::Check
            };
            Ok((crate::gait_file::load(&file)?, role))
        };
        chosen.iter().enumerate().map(gait).collect()
    }

    /// One take; gives the reason when the robot could not play the gait.
    fn take(&mut self, uri: &PortUri, set: &SetFolder, take: &Take) -> Outcome<Option<String>> {
        if interrupt::pressed() {
            return Err(Failure::say(
                Exit::Interrupted,
                format!("stopped before take {}", take.name),
            ));
        }
        if !uri.is_sim() {
            let [x_m, y_m] = take.start_m;
            let question = format!(
                "Take {}: home pose, flat on the ground, middle of the robot at x {x_m:.2} m, y {y_m:.2} m under the camera, along x; camera on. Run it?",
                take.name
            );
            crate::cmd::confirm(self.context, &question)?;
        }
        let taken = match takes::take(self.context, uri, set, take) {
            // The gait was refused before it began.
            Err(failure) if failure.exit() == Exit::Refused => {
                return Ok(Some(failure.to_string()));
            }
            other => other?,
        };
        self.times.experiments += 1;
        self.times.robot_s += taken.robot_time.as_secs_f64();
        self.store_times()?;
        if taken.report.interrupted {
            return Err(Failure::say(
                Exit::Interrupted,
                format!("stopped in take {}", take.name),
            ));
        }
        self.context.out.say(takes::line(take, &taken));
        let reason = taken.misfit.as_ref().unwrap_or(&taken.report.end.reason);
        Ok((!taken.is_kept()).then(|| reason.clone()))
    }

    /// Films that came with the takes, or that a person has brought since; stops when some are missing.
    fn films(&self, set: &SetFolder) -> Outcome {
        let brought = self.cycle_path().join("films");
        let mut missing = Vec::new();
        for run in &set.manifest()?.runs {
            if run.frames.is_some() {
                continue;
            }
            let name = run.file.trim_end_matches(".csv");
            let film = brought.join(name);
            if !film.join("index.csv").exists() {
                missing.push(name.to_owned());
                continue;
            }
            let track = film.join("track.csv");
            let seen = Seen {
                film: Frames::read(&film)?,
                base: if track.exists() {
                    beside::read_track(&track)?
                } else {
                    Vec::new()
                },
                imu: Vec::new(),
            };
            set.add_film(name, seen)?;
        }
        if missing.is_empty() {
            return Ok(());
        }
        let message = format!(
            "{} takes are recorded but have no film: {}",
            missing.len(),
            missing.join(", ")
        );
        Err(Failure::say(Exit::Other, message).hint(format!(
            "put each film (PNG silhouettes, index.csv with `t_s,file` on the camera's clock; track.csv if the base was tracked) into {}/TAKE, then `rb-host hybrid --resume -o {}`",
            brought.display(),
            self.path.display()
        )))
    }
}
