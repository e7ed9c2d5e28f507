//! Takes: runs on a robot that become runs of a data set, each from a robot at rest in its home pose.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use control::gait::Gait;
use files::dataset::Role;
use files::model::{Key, Model};
use optimise::meta::FilmSettings;
use physics::{Drive, Params, Start, Trial};
use protocol::link::EndReason;

use crate::context::Context;
use crate::disk;
use crate::failure::{Exit, Failure, Outcome};
use crate::link::sim::{self, SimLink};
use crate::link::{PortUri, Robot, text};
use crate::recording::beside::{Laid, Seen};
use crate::recording::set::SetFolder;
use crate::recording::{Header, Recorder, RecorderError};
use crate::runner::{self, Order, RunReport};
use crate::searching::films;
use crate::upload::{self, Options};

/// Rest before the first movement: the mark by which a film is laid in time.
pub const MARK: Duration = Duration::from_secs(1);

/// One take.
#[derive(Debug, Clone)]
pub struct Take {
    /// Name of the run in the data set.
    pub name: String,
    /// Gait.
    pub gait: Gait,
    /// Use of the run.
    pub role: Option<Role>,
    /// Length of the run.
    pub duration: Duration,
    /// Samples per second.
    pub rate_hz: u32,
    /// Runs to its end when this host is gone.
    pub autonomous: bool,
    /// Where to store the gait; `None` = the robot's choice.
    pub slot: Option<u8>,
    /// Where an emulated robot is put down, beside what its scenario says, m.
    pub start_m: [f64; 2],
    /// Whether a camera beside the robot films it. A robot held in the air needs no film.
    pub filmed: bool,
}

/// Where to put a robot down so that what the model predicts of a gait stays in the middle of the picture, m; always so that its
/// start, by which films are laid in time, is in the picture.
///
/// # Errors
/// Exit code 3 for a model that cannot be simulated.
pub fn centred_start_m(model: &Model, gait: &Gait, camera: &FilmSettings) -> Outcome<[f64; 2]> {
    let bad = |e: anyhow::Error| Failure::new(Exit::BadFile, e);
    let trial = Trial {
        params: Arc::new(Params::try_from(model).map_err(|e| bad(e.into()))?),
        start: Start::Home,
        drive: Drive::Gait {
            gait: Arc::new(gait.clone()),
            noise_rad: 0.0,
            seed: 0,
        },
        duration_s: gait.duration_s().into(),
    };
    let outcomes =
        physics::run(&[trial], &physics::Options::default()).map_err(|e| bad(e.into()))?;
    let middle_m = outcomes
        .first()
        .map_or([0.0; 2], crate::cmd::sim::centring_start_m);
    // Half the picture on the ground under the lowest camera of Table II; its sides need not lie along x and y, so the short one counts.
    let (lowest_m, _) = Key::CameraHeight.info().search;
    let short_px = camera.width_px.min(camera.height_px) as f64;
    let half_m = 0.5 * short_px * lowest_m / f64::from(camera.focal_px);
    let reach_m = (half_m - ROBOT_M).max(0.0);
    let under_m = [f64::from(camera.x_m), f64::from(camera.y_m)];
    // Millimetres are all that a hand can do.
    Ok(core::array::from_fn(|axis| {
        let from_m = f64::from(middle_m[axis]).clamp(-reach_m, reach_m);
        ((under_m[axis] + from_m) * 1e3).round() * 1e-3
    }))
}

/// Half the length of the robot with room for its way to the start pose [m].
const ROBOT_M: f64 = 0.35;

/// What a take gave.
#[derive(Debug, Clone)]
pub struct Taken {
    /// How the run went.
    pub report: RunReport,
    /// What instruments saw, laid in time; `None` for a real robot, whose film comes later.
    pub laid: Option<Laid>,
    /// Why what instruments saw could not be laid in time; such a run is not kept.
    pub misfit: Option<String>,
    /// Robot time from power-up or connection to the end of the run.
    pub robot_time: Duration,
}

impl Taken {
    /// Whether the run is in the data set.
    #[must_use]
    pub fn is_kept(&self) -> bool {
        self.is_complete() && self.misfit.is_none()
    }

    /// Whether the robot played the gait to its end.
    fn is_complete(&self) -> bool {
        !self.report.interrupted && self.report.reason == Some(EndReason::Completed)
    }
}

/// Name of the `n`-th take (from 1) of a gait.
#[must_use]
pub fn name(gait: &Gait, n: u32) -> String {
    format!("{}_{n}", gait.name())
}

/// The `[camera]` table for what stands beside the robot at `uri`; empty when nothing is known.
///
/// # Errors
/// A scenario that cannot be read.
pub fn camera_toml(uri: &PortUri) -> Outcome<String> {
    let PortUri::Sim(path) = uri else {
        return Ok(String::new());
    };
    let scenario = sim::load_scenario(path.as_deref())?;
    let Some(camera) = scenario.lab.camera else {
        return Ok(String::new());
    };
    let setup = camera.setup();
    let settings = FilmSettings {
        rate_hz: setup.rate_hz,
        x_m: setup.x_m as f32,
        y_m: setup.y_m as f32,
        yaw_rad: setup.yaw_rad as f32,
        width_px: setup.width_px,
        height_px: setup.height_px,
        focal_px: setup.focal_px as f32,
        stride: 1,
    };
    // Films in the set are on the robot's clock.
    Ok(films::camera_toml(&settings) + "clock_offset_s = 0.0\n")
}

/// Runs one take and adds it to the set when it was completed.
///
/// # Errors
/// Exit codes 1, 3, 4, 5, 6, 7.
pub fn take(context: &Context, uri: &PortUri, set: &SetFolder, take: &Take) -> Outcome<Taken> {
    let mut robot = connect(context, uri, take)?;
    let options = Options {
        slot: take.slot,
        activate: false,
        verify: true,
    };
    let stored = upload::upload(&mut robot, &take.gait, options)?;
    let order = Order {
        slot: stored.slot,
        digest: stored.digest,
        gait: take.gait.clone(),
        duration: take.duration,
        rate_hz: take.rate_hz,
        countdown: MARK,
        then: None,
        lease: runner::lease(uri, take.autonomous),
    };
    let path = set.recording_path(&take.name);
    let mut recorder = open_recording(&path, true, &mut robot, &take.gait, None)?;
    let report = runner::run(context, &mut robot, Some(&mut recorder), 0, &order)?;
    recorder
        .finish()
        .map_err(|e| Failure::new(Exit::Other, e))?;
    let mut taken = Taken {
        report,
        laid: None,
        misfit: None,
        robot_time: robot.link().now(),
    };
    if taken.is_complete() {
        let seen = robot.link().seen().map(|lab| lab.seen);
        let seen = if take.filmed {
            seen
        } else {
            seen.map(Seen::without_film)
        };
        match set.add(&take.name, &take.gait, take.role, seen) {
            Ok(laid) => taken.laid = laid,
            Err(failure) if failure.exit() == Exit::BadFile => {
                taken.misfit = Some(failure.to_string());
            }
            Err(failure) => return Err(failure),
        }
    }
    Ok(taken)
}

/// A robot at rest: an emulated one is powered anew, with chance named by the take; a real one must have been placed.
fn connect(context: &Context, uri: &PortUri, take: &Take) -> Outcome<Robot> {
    match uri {
        PortUri::Sim(path) => {
            let link = SimLink::open_repeat(path.as_deref(), chance(&take.name), take.start_m)?;
            context.connect_over(Box::new(link))
        }
        uri => context.connect_to(uri),
    }
}

/// A number that stands for a name.
fn chance(name: &str) -> u64 {
    const CRC: crc::Crc<u64> = crc::Crc::<u64>::new(&crc::CRC_64_XZ);
    CRC.checksum(name.as_bytes())
}

/// Opens a recording of a run with this gait.
///
/// # Errors
/// Exit code 1 when the file cannot be made, 5 when the link fails.
pub fn open_recording(
    path: &Path,
    force: bool,
    robot: &mut Robot,
    gait: &Gait,
    model: Option<&str>,
) -> Outcome<Recorder> {
    let clock_offset_ns = clock_offset_ns(robot)?;
    let hello = robot.hello();
    let header = Header {
        tool: format!("rb-host {}", env!("CARGO_PKG_VERSION")),
        firmware: hello.firmware.to_string(),
        robot: hello.robot_id.to_string(),
        port: robot.link().uri().to_string(),
        emulated: hello.is_emulated(),
        model_digest: text::hex(&hello.model_digest.0),
        clock_offset_ns,
    };
    let open = || -> Result<Recorder, RecorderError> {
        let mut recorder = Recorder::create(path, force, &header)?;
        recorder.attach(
            "gait.toml",
            "application/toml",
            files::gait::to_toml(gait).as_bytes(),
        )?;
        if let Some(model) = model {
            recorder.attach("model.toml", "application/toml", model.as_bytes())?;
        }
        Ok(recorder)
    };
    open().map_err(|error| match error {
        RecorderError::Exists { path } => disk::exists(&path),
        error => Failure::new(Exit::Other, error),
    })
}

/// What turns device time into recording time: nothing on virtual time, so that the same run gives the same file.
fn clock_offset_ns(robot: &mut Robot) -> Outcome<i64> {
    if robot.link().uri().is_sim() {
        return Ok(0);
    }
    let pong = robot.ping()?;
    let unix = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    let middle_ns = (unix.saturating_sub(pong.round_trip / 2)).as_nanos();
    let module_ns = u128::from(pong.module_us) * 1000;
    Ok(i64::try_from(middle_ns as i128 - module_ns as i128).unwrap_or(0))
}

/// The folder of a data set for takes on the robot at `uri`.
///
/// # Errors
/// Exit codes 1, 2, 3.
pub fn open_set(path: &Path, name: &str, model: &str, uri: &PortUri) -> Outcome<SetFolder> {
    SetFolder::open(path, name, model, &camera_toml(uri)?)
}

/// Where to read why a run ended early.
#[must_use]
pub fn what_happened(uri: &PortUri) -> String {
    if uri.is_sim() {
        return "the emulated robot forgets its log when the command ends; run it again with -v to see its events".to_owned();
    }
    "`rb-host log` tells what happened".to_owned()
}

/// What a person is told of a take.
#[must_use]
pub fn line(take: &Take, taken: &Taken) -> String {
    let mut words = format!("{}: ", take.name);
    match taken.laid.as_ref().map(|laid| (laid, laid.alignment)) {
        Some((laid, Some(alignment))) => words.push_str(&format!(
            "{} frames, clock shift {:.3} s by the first motion (likeness {:.2})",
            laid.film.frames.len(),
            alignment.offset_s,
            alignment.correlation
        )),
        _ if taken.is_kept() => words.push_str("motors recorded"),
        _ if taken.misfit.is_some() => {
            words.push_str("not kept: ");
            words.push_str(taken.misfit.as_deref().unwrap_or_default());
        }
        _ => words.push_str(&format!(
            "ended early ({}), not kept",
            taken.report.end.reason
        )),
    }
    if taken.report.end.holds > 0 {
        let holds = taken.report.end.holds;
        words.push_str(&format!(", {holds} cycles held by the pre-check"));
    }
    words
}
