//! The robot's films, and simulated ones through the candidate's camera.

use super::MetaError;
use crate::table2::ROWS;
use camera::similarity::{gait_weight, repeatability};
use camera::{MetaModule, Scratch, Silhouette, View, ViewError};
use control::gait::Gait;
use control::linalg::Pose;
use control::robot::{BODIES, RobotModel};
use serde::{Deserialize, Serialize};

/// Index of the camera height in Table II.
const CAMERA_HEIGHT: usize = 20;
/// Index of the time shift in Table II.
const TIME_SHIFT: usize = 21;

/// Every `stride`-th instant of a film, seen from the simulation: S(t + s) of equation (6).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameTimes {
    /// Frames per second of the film.
    pub rate_hz: f64,
    /// Frames of the film.
    pub frames: usize,
    /// Every how many frames one is wanted; at least 1.
    pub stride: usize,
    /// Time shift, s.
    pub shift_s: f64,
}

impl FrameTimes {
    /// The instants, s from the start of the gait.
    pub fn iter(&self) -> impl Iterator<Item = f64> + use<> {
        let Self {
            rate_hz, shift_s, ..
        } = *self;
        let frames = (0..self.frames).step_by(self.stride.max(1));
        frames.map(move |k| k as f64 / rate_hz + shift_s)
    }

    /// The sample of a motion recorded at `rate_hz` nearest to each instant; negative instants take the first sample.
    pub fn samples(&self, rate_hz: f64) -> impl Iterator<Item = usize> + use<> {
        self.iter()
            .map(move |t_s| (t_s * rate_hz + 0.5).max(0.0) as usize)
    }
}

/// One simulated motion to make.
#[derive(Clone, Copy, Debug)]
pub struct MotionJob<'a> {
    /// The gait to play, without noise.
    pub gait: &'a Gait,
    /// Values of all rows of Table II.
    pub parameters: &'a [f64; ROWS],
    /// Instants at which the bodies are wanted.
    pub times: FrameTimes,
}

/// What a simulated robot did.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Body 3 at the start of the gait, in the simulation's world.
    pub start: Pose,
    /// All bodies at the wanted instants; ends early where the simulation does.
    pub bodies: Vec<[Pose; BODIES]>,
}

/// Where a simulated motion stands in the camera's world: turned about the vertical, then moved over the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Placement {
    /// Turn about z, rad.
    pub yaw_rad: f32,
    /// Where the simulation's origin comes to lie, m.
    pub x_m: f32,
    /// See `x_m`.
    pub y_m: f32,
}

impl Placement {
    /// The placement that lays a body at pose `from` onto pose `to`, but for what only tilting or lifting could mend.
    #[must_use]
    pub fn onto(from: &Pose, to: &Pose) -> Self {
        let turn = to.rotation.then_outer(&from.rotation.transposed());
        // The turn about z nearest to that rotation.
        let yaw_rad = libm::atan2f(turn.x.y - turn.y.x, turn.x.x + turn.y.y);
        let (sin, cos) = (libm::sinf(yaw_rad), libm::cosf(yaw_rad));
        let (f, t) = (from.position_m, to.position_m);
        Self {
            yaw_rad,
            x_m: t.x - (cos * f.x - sin * f.y),
            y_m: t.y - (sin * f.x + cos * f.y),
        }
    }
}

/// Something that simulates motions; the result of a job depends on that job alone.
pub trait MotionTrials: Sync {
    /// Motions in the order of the jobs; `None` where a number was lost.
    fn run(&self, jobs: &[MotionJob<'_>]) -> Vec<Option<Motion>>;

    /// Whether somebody wants the work to end. Motions mean nothing then, and some may be missing.
    fn stopped(&self) -> bool {
        false
    }
}

/// What was filmed of one gait on the robot.
#[derive(Clone, Debug)]
pub struct FilmedGait {
    /// The gait.
    pub gait: Gait,
    /// One film per trial.
    pub films: Vec<Vec<Silhouette>>,
    /// Body 3 at the start of the gait in the camera's world; simulated motions are laid onto it. `None` when it was not measured: then
    /// the robot was put down where the simulation begins, at the origin along x.
    pub start: Option<Pose>,
    /// R_H, equation (8).
    pub repeatability: f64,
    /// Mean speed on the robot, m/s.
    pub mean_speed_m_s: f64,
    /// W_gait, equation (7).
    pub weight: f64,
    /// Whether the fit may see it.
    pub training: bool,
}

impl FilmedGait {
    /// Weigh a gait by its mean speed and the likeness of its trials.
    ///
    /// # Errors
    /// With fewer than two trials, films that do not compare, or a film that never shows the robot.
    pub fn new(
        gait: Gait,
        films: Vec<Vec<Silhouette>>,
        start: Option<Pose>,
        mean_speed_m_s: f64,
        training: bool,
    ) -> Result<Self, MetaError> {
        let unseen = |film: &Vec<Silhouette>| film.iter().all(|frame| frame.area_px() == 0);
        if let Some(trial) = films.iter().position(unseen) {
            return Err(MetaError::NeverSeen { trial: trial + 1 });
        }
        let trials: Vec<&[Silhouette]> = films.iter().map(Vec::as_slice).collect();
        let repeatability = repeatability(&trials)?;
        Ok(Self {
            gait,
            films,
            start,
            repeatability,
            mean_speed_m_s,
            weight: gait_weight(mean_speed_m_s, repeatability),
            training,
        })
    }

    /// Share of the frames of all films that show the robot.
    #[must_use]
    pub fn share_seen(&self) -> f64 {
        let frames = || self.films.iter().flatten();
        let seen = frames().filter(|frame| frame.area_px() > 0).count();
        seen as f64 / frames().count().max(1) as f64
    }

    /// Frames of the longest film.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.films.iter().map(Vec::len).max().unwrap_or(0)
    }
}

/// The real camera and how finely the search looks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FilmSettings {
    /// Frames per second of the robot's films.
    pub rate_hz: f64,
    /// Camera position over the ground, m.
    pub x_m: f32,
    /// Camera position over the ground, m.
    pub y_m: f32,
    /// Camera yaw, rad.
    pub yaw_rad: f32,
    /// Frame size of the films, px.
    pub width_px: usize,
    /// Frame size of the films, px.
    pub height_px: usize,
    /// Focal length at that frame size, px.
    pub focal_px: f32,
    /// Every how many frames of the robot's film are compared.
    pub stride: usize,
}

/// The virtual camera and what stands before it.
#[derive(Clone, Debug)]
pub struct FilmMaker {
    settings: FilmSettings,
    robot: MetaModule,
}

impl FilmMaker {
    /// A camera over a meta-module.
    #[must_use]
    pub fn new(settings: FilmSettings, robot: &RobotModel) -> Self {
        Self {
            settings,
            robot: MetaModule::new(robot),
        }
    }

    /// How finely the search looks.
    #[must_use]
    pub fn settings(&self) -> &FilmSettings {
        &self.settings
    }

    /// The instants at which a film of `frames` frames sees a simulation with these parameters.
    #[must_use]
    pub fn times(&self, parameters: &[f64; ROWS], frames: usize, stride: usize) -> FrameTimes {
        FrameTimes {
            rate_hz: self.settings.rate_hz,
            frames,
            stride: stride.max(1),
            shift_s: parameters[TIME_SHIFT],
        }
    }

    /// The film of a whole motion recorded at `rate_hz`: S(t + s) at the times t of `frames` frames, every
    /// `stride`-th of them; times past the end of the motion are left out.
    ///
    /// # Errors
    /// When the camera height is impossible.
    pub fn film(
        &self,
        motion: &[[Pose; BODIES]],
        rate_hz: f64,
        parameters: &[f64; ROWS],
        frames: usize,
        stride: usize,
        placement: Placement,
    ) -> Result<Vec<Silhouette>, ViewError> {
        let times = self.times(parameters, frames, stride);
        let poses = times
            .samples(rate_hz)
            .map_while(|sample| motion.get(sample));
        let mut film = Vec::new();
        self.show(
            poses,
            parameters,
            placement,
            &mut Canvas::default(),
            |_, frame| film.push(frame.cropped()),
        )?;
        Ok(film)
    }

    /// The film of a motion made for these instants, laid onto a measured start of body 3.
    ///
    /// # Errors
    /// When the camera height is impossible.
    pub fn film_of(
        &self,
        motion: &Motion,
        parameters: &[f64; ROWS],
        start: Option<&Pose>,
    ) -> Result<Vec<Silhouette>, ViewError> {
        let mut film = Vec::new();
        self.show_motion(
            motion,
            parameters,
            start,
            &mut Canvas::default(),
            |_, frame| film.push(frame.cropped()),
        )?;
        Ok(film)
    }

    /// As [`FilmMaker::film_of`], frame by frame.
    pub(super) fn show_motion(
        &self,
        motion: &Motion,
        parameters: &[f64; ROWS],
        start: Option<&Pose>,
        canvas: &mut Canvas,
        look: impl FnMut(usize, &Silhouette),
    ) -> Result<(), ViewError> {
        let placement = start.map_or_else(Placement::default, |start| {
            Placement::onto(&motion.start, start)
        });
        self.show(&motion.bodies, parameters, placement, canvas, look)
    }

    /// Draws poses one after the other and shows each frame with its index.
    fn show<'a>(
        &self,
        poses: impl IntoIterator<Item = &'a [Pose; BODIES]>,
        parameters: &[f64; ROWS],
        placement: Placement,
        canvas: &mut Canvas,
        mut look: impl FnMut(usize, &Silhouette),
    ) -> Result<(), ViewError> {
        let view = self.view(parameters, placement)?;
        let (width, height) = view.size_px();
        let frame = canvas
            .frame
            .get_or_insert_with(|| Silhouette::new(width, height));
        for (k, poses) in poses.into_iter().enumerate() {
            frame.clear();
            view.draw(&self.robot, poses, frame, &mut canvas.scratch);
            look(k, frame);
        }
        Ok(())
    }

    /// The camera of these parameters as a motion placed so sees it.
    ///
    /// # Errors
    /// When its height is impossible.
    pub fn view(&self, parameters: &[f64; ROWS], placement: Placement) -> Result<View, ViewError> {
        let s = &self.settings;
        let (sin, cos) = (libm::sinf(placement.yaw_rad), libm::cosf(placement.yaw_rad));
        let (x, y) = (s.x_m - placement.x_m, s.y_m - placement.y_m);
        View::new(
            parameters[CAMERA_HEIGHT] as f32,
            (cos * x + sin * y, cos * y - sin * x),
            s.yaw_rad - placement.yaw_rad,
            (s.width_px, s.height_px),
            s.focal_px,
        )
    }
}

/// Memory used again from frame to frame, one per thread and frame size.
#[derive(Debug, Default)]
pub(super) struct Canvas {
    frame: Option<Silhouette>,
    scratch: Scratch,
}
