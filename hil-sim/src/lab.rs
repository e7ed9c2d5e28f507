//! Instruments beside the robot: an overhead camera, a tracker of its base, an inertial sensor on it.
//!
//! Camera and tracker are one device with a clock of its own, as in a laboratory: nothing tells them when the robot was
//! switched on. The inertial sensor is read by the robot and shares its clock. What they see is kept as it happens and
//! handed out afterwards; the robot and its firmware know nothing of them.

use std::collections::VecDeque;

use camera::{Silhouette, Solid, View, ViewError};
use control::kinematics;
use control::linalg::{Pose, Rot3, Vec3};
use control::robot::{JOINTS, RobotModel};

use crate::rng::Rng;

/// A clock: what it shows when the robot's virtual time is 0, and how fast it goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockParams {
    /// Reading at the robot's time 0 [s].
    pub ahead_s: f64,
    /// Its seconds per true second.
    pub ratio: f64,
}

impl Default for ClockParams {
    fn default() -> Self {
        Self {
            ahead_s: 0.0,
            ratio: 1.0,
        }
    }
}

/// Place and optics of an overhead depth camera that looks straight down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraSetup {
    /// Height over the ground [m].
    pub height_m: f64,
    /// Place over the ground [m].
    pub x_m: f64,
    /// Place over the ground [m].
    pub y_m: f64,
    /// Turn about the vertical [rad].
    pub yaw_rad: f64,
    /// Frame [px].
    pub width_px: usize,
    /// Frame [px].
    pub height_px: usize,
    /// Focal length [px].
    pub focal_px: f64,
    /// Frames per second of its own clock.
    pub rate_hz: f64,
}

/// An overhead depth camera whose frames are cut down to silhouettes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraParams {
    setup: CameraSetup,
    view: View,
}

impl CameraParams {
    /// Place and optics.
    #[must_use]
    pub fn setup(&self) -> &CameraSetup {
        &self.setup
    }
}

impl TryFrom<CameraSetup> for CameraParams {
    type Error = ViewError;

    fn try_from(setup: CameraSetup) -> Result<Self, ViewError> {
        let view = View::new(
            setup.height_m as f32,
            (setup.x_m as f32, setup.y_m as f32),
            setup.yaw_rad as f32,
            (setup.width_px, setup.height_px),
            setup.focal_px as f32,
        )?;
        Ok(Self { setup, view })
    }
}

/// A tracker of the base pose, on the camera's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackerParams {
    /// Poses per second of its own clock.
    pub rate_hz: f64,
    /// Standard deviation of each coordinate [m].
    pub sigma_m: f64,
    /// Standard deviation of each rotation [rad].
    pub sigma_rad: f64,
}

/// An inertial sensor at the origin of body 3, on the robot's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuParams {
    /// Readings per second.
    pub rate_hz: f64,
    /// Standard deviation of each axis [rad/s].
    pub gyro_sigma_rad_s: f64,
    /// Standard deviation of each axis [m/s2].
    pub accel_sigma_m_s2: f64,
}

/// Which instruments stand there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LabParams {
    /// Clock of camera and tracker.
    pub clock: ClockParams,
    /// Overhead camera.
    pub camera: Option<CameraParams>,
    /// Base tracker.
    pub tracker: Option<TrackerParams>,
    /// Inertial sensor.
    pub imu: Option<ImuParams>,
}

impl LabParams {
    /// Whether nobody looks.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.camera.is_none() && self.tracker.is_none() && self.imu.is_none()
    }
}

/// A frame as it was exposed: when, and how the robot stood.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Exposure {
    t_s: f64,
    base: physics::Pose,
    angles_rad: [f32; JOINTS],
}

/// A pose on the camera's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tracked {
    /// Camera's clock [s].
    pub t_s: f64,
    /// Position of body 3 [m].
    pub position_m: [f64; 3],
    /// Its rotation, Hamilton, w first.
    pub quaternion: [f64; 4],
}

/// A reading on the robot's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuReading {
    /// Robot's clock [s].
    pub t_s: f64,
    /// Angular velocity in body axes [rad/s].
    pub gyro_rad_s: [f64; 3],
    /// Specific force in body axes [m/s2].
    pub accel_m_s2: [f64; 3],
}

/// How long instruments remember [s]: longer than the longest run (600 s) with its way to the start pose.
const MEMORY_S: f64 = 700.0;
/// Stream numbers of the instruments' noise.
const PURPOSE_TRACKER: u64 = 0xCA;
/// See [`PURPOSE_TRACKER`].
const PURPOSE_IMU: u64 = 0xCB;

/// The instruments and what they have seen.
#[derive(Clone, Debug)]
pub struct Lab {
    params: LabParams,
    seed: u64,
    frames: Series<Exposure>,
    poses: Series<Tracked>,
    readings: Series<ImuReading>,
}

/// Samples of one instrument.
#[derive(Clone, Debug)]
struct Series<T> {
    rate_hz: f64,
    next: u64,
    kept: VecDeque<T>,
}

impl<T> Series<T> {
    /// From the first whole period at or after `from_s` of the instrument's clock; rate 0 = never.
    fn new(rate_hz: f64, from_s: f64) -> Self {
        Self {
            rate_hz,
            next: libm::ceil(from_s * rate_hz).max(0.0) as u64,
            kept: VecDeque::new(),
        }
    }

    /// The instant of the next sample if it has come by `clock_s`.
    fn due_s(&self, clock_s: f64) -> Option<f64> {
        let at_s = self.next as f64 / self.rate_hz;
        (self.rate_hz > 0.0 && clock_s >= at_s).then_some(at_s)
    }

    fn keep(&mut self, sample: T) {
        self.next += 1;
        if self.kept.len() as f64 >= MEMORY_S * self.rate_hz {
            self.kept.pop_front();
        }
        self.kept.push_back(sample);
    }
}

impl Lab {
    /// Instruments that are on before the robot is.
    #[must_use]
    pub fn new(params: LabParams, seed: u64) -> Self {
        let ahead_s = params.clock.ahead_s;
        Self {
            frames: Series::new(params.camera.map_or(0.0, |c| c.setup.rate_hz), ahead_s),
            poses: Series::new(params.tracker.map_or(0.0, |t| t.rate_hz), ahead_s),
            readings: Series::new(params.imu.map_or(0.0, |i| i.rate_hz), 0.0),
            params,
            seed,
        }
    }

    /// Looks at the body at the robot's time `t_s`. Called every body step: a sample is at most one step late.
    pub fn look(&mut self, t_s: f64, body: &physics::Body) {
        let clock = self.params.clock;
        let clock_s = clock.ahead_s + clock.ratio * t_s;
        if let Some(at_s) = self.frames.due_s(clock_s) {
            let mut angles_rad = [0.0; JOINTS];
            for (slot, angle) in angles_rad.iter_mut().zip(body.angles_rad()) {
                *slot = angle as f32;
            }
            self.frames.keep(Exposure {
                t_s: at_s,
                base: body.base(),
                angles_rad,
            });
        }
        if let (Some(at_s), Some(tracker)) = (self.poses.due_s(clock_s), self.params.tracker) {
            let mut rng = Rng::new(self.seed, PURPOSE_TRACKER, self.poses.next);
            self.poses
                .keep(track(at_s, &body.base(), &tracker, &mut rng));
        }
        if let (Some(at_s), Some(imu)) = (self.readings.due_s(t_s), self.params.imu) {
            let mut rng = Rng::new(self.seed, PURPOSE_IMU, self.readings.next);
            let truth = body.imu();
            self.readings.keep(ImuReading {
                t_s: at_s,
                gyro_rad_s: truth
                    .gyro_rad_s
                    .map(|w| w + imu.gyro_sigma_rad_s * rng.normal()),
                accel_m_s2: truth
                    .accel_m_s2
                    .map(|a| a + imu.accel_sigma_m_s2 * rng.normal()),
            });
        }
    }

    /// Which instruments stand there.
    #[must_use]
    pub fn params(&self) -> &LabParams {
        &self.params
    }

    /// The film: instant on the camera's clock [s] and silhouette of the true shapes of `robot`, in order.
    pub fn film(&self, robot: &RobotModel) -> impl Iterator<Item = (f64, Silhouette)> + '_ {
        let solids = Solid::meta_module(robot);
        let robot = *robot;
        let frames = self.params.camera.map(|camera| {
            self.frames.kept.iter().map(move |frame| {
                let base = Pose {
                    position_m: vec3(frame.base.position_m),
                    rotation: Rot3::from_quaternion(frame.base.quaternion),
                };
                let poses = kinematics::forward(&robot, &frame.angles_rad).rebased(3, &base);
                (frame.t_s, camera.view.render(&solids, poses.bodies()))
            })
        });
        frames.into_iter().flatten()
    }

    /// Frames exposed so far.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.frames.kept.len()
    }

    /// Tracked poses, in order.
    pub fn poses(&self) -> impl Iterator<Item = &Tracked> {
        self.poses.kept.iter()
    }

    /// Inertial readings, in order.
    pub fn readings(&self) -> impl Iterator<Item = &ImuReading> {
        self.readings.kept.iter()
    }
}

fn track(t_s: f64, base: &physics::Pose, tracker: &TrackerParams, rng: &mut Rng) -> Tracked {
    let position_m = base
        .position_m
        .map(|x| f64::from(x) + tracker.sigma_m * rng.normal());
    // A small rotation in the world, first order; renormalised.
    let [x, y, z] = [0; 3].map(|_| 0.5 * tracker.sigma_rad * rng.normal());
    let [a, b, c, d] = base.quaternion.map(f64::from);
    let turned = [
        a - x * b - y * c - z * d,
        b + x * a + y * d - z * c,
        c + y * a + z * b - x * d,
        d + z * a + x * c - y * b,
    ];
    let norm = turned.iter().map(|q| q * q).sum::<f64>().sqrt();
    Tracked {
        t_s,
        position_m,
        quaternion: turned.map(|q| q / norm),
    }
}

fn vec3([x, y, z]: [f32; 3]) -> Vec3 {
    Vec3::new(x, y, z)
}
