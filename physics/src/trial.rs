//! What a trial is, and what comes out of it.

use crate::params::Params;
use control::gait::Gait;
use std::sync::Arc;

/// Rate of the set-points, Hz (paper, section II).
pub const CONTROL_RATE_HZ: f64 = 20.0;

/// Position and orientation of body 3 in the world: z up, ground z = 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Origin of body 3, m.
    pub position_m: [f32; 3],
    /// Body 3 -> world, Hamilton, w first.
    pub quaternion: [f32; 4],
}

/// Velocity of the base: of its origin, and angular, both in world axes.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Twist {
    /// Velocity of the origin of body 3, m/s.
    pub linear_m_s: [f32; 3],
    /// Angular velocity, rad/s.
    pub angular_rad_s: [f32; 3],
}

/// How a trial begins.
#[derive(Clone, Debug, PartialEq)]
pub enum Start {
    /// All joints at zero, lying on the ground. Then, before t = 0, the joints move to the first set-points at
    /// [`Options::approach_rad_s`] and the robot settles for [`Options::settle_s`].
    Home,
    /// All joints at zero, lying on the ground, t = 0 at once.
    HomeAtOnce,
    /// A given state, t = 0 at once.
    State {
        /// Pose of body 3.
        base: Pose,
        /// Velocity of body 3.
        twist: Twist,
        /// Link angles in joint order, rad; those of the connectors may follow, else they are at rest.
        angles_rad: Vec<f32>,
        /// Joint speeds in joint order, rad/s; as many.
        speeds_rad_s: Vec<f32>,
    },
}

/// What moves the joints.
#[derive(Clone, Debug, PartialEq)]
pub enum Drive {
    /// Set-points of a gait at 20 Hz from `control::cpg`, the code of the firmware, held between ticks.
    Gait {
        /// The gait; one oscillator per joint.
        gait: Arc<Gait>,
        /// Standard deviation of the noise added to every set-point, rad.
        noise_rad: f64,
        /// Seed of the noise; joint and tick are counters, so a trial's noise depends on nothing else.
        seed: u64,
    },
    /// Given set-points, held between samples.
    SetPoints {
        /// Time between samples, s.
        period_s: f64,
        /// Joint-major within a sample: `values[sample * joints + joint]`, rad.
        values_rad: Arc<[f32]>,
    },
    /// Link angles that the joints follow exactly, whatever torque it takes; linear between samples.
    LinkAngles {
        /// Time between samples, s.
        period_s: f64,
        /// `values[sample * joints + joint]`, rad.
        values_rad: Arc<[f32]>,
    },
    /// The same of the motors' encoders: a link hangs on its motor by the play and the spring of its transmission.
    EncoderAngles {
        /// Time between samples, s.
        period_s: f64,
        /// `values[sample * joints + joint]`, rad.
        values_rad: Arc<[f32]>,
    },
}

/// One trial: model, start, drive, duration. Every lane of a batch may differ in all of them.
#[derive(Clone, Debug)]
pub struct Trial {
    /// Parameters of the simulated robot and ground.
    pub params: Arc<Params>,
    /// How it begins.
    pub start: Start,
    /// What moves it.
    pub drive: Drive,
    /// Length from t = 0, s.
    pub duration_s: f64,
}

/// Numerical settings, the same for all trials of a batch.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Time step, s.
    pub time_step_s: f64,
    /// Gauss-Seidel sweeps of the contact solver.
    pub sweeps: u32,
    /// Samples per second of the recorded poses; 0 records nothing but the ends. At most one per step.
    pub sample_rate_hz: f64,
    /// Records link angles beside poses.
    pub record_angles: bool,
    /// Records motor torques and encoder angles beside poses.
    pub record_motors: bool,
    /// Speed of the move from home to the first set-points, rad/s.
    pub approach_rad_s: f64,
    /// Rest between that move and t = 0, s.
    pub settle_s: f64,
    /// Ends a trial at its first collision of the robot with itself.
    pub stop_on_collision: bool,
}

impl Default for Options {
    /// 4 ms and 12 sweeps: the convergence table in `docs/explanation/physics.md` shows what they cost in accuracy.
    fn default() -> Options {
        Options {
            time_step_s: 0.004,
            sweeps: 12,
            sample_rate_hz: 20.0,
            record_angles: false,
            record_motors: false,
            // Half the slower motor's no-load speed (paper, Table I).
            approach_rad_s: 1.0,
            settle_s: 0.5,
            stop_on_collision: false,
        }
    }
}

/// A step whose result was not a number; the trial's values from there on mean nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NotFinite {
    /// Step from the start of the simulation, lead-in included.
    pub step: u64,
    /// Time from t = 0, s; negative in the lead-in.
    pub time_s: f64,
}

/// How a trial began and ended, and what it recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Base pose at t = 0, 1 / rate, 2 / rate, ...; the first step at or after each instant. At least the first and the last pose.
    pub poses: Vec<Pose>,
    /// Link angles of the motor joints, `angles_rad[sample * motors + joint]`; empty unless asked for.
    pub angles_rad: Vec<f32>,
    /// Encoder angles, as `angles_rad`; empty unless asked for.
    pub encoders_rad: Vec<f32>,
    /// Motor torques, N m, as `angles_rad`; empty unless asked for.
    pub torques_nm: Vec<f32>,
    /// Angles of all joints at the end, connectors last, rad: where another trial may begin.
    pub end_angles_rad: Vec<f32>,
    /// Their speeds, rad/s.
    pub end_speeds_rad_s: Vec<f32>,
    /// Horizontal distance of the base from t = 0 to the end, m.
    pub distance_m: f64,
    /// The same by the duration, m/s.
    pub speed_m_s: f64,
    /// First time at which the robot touched itself, s from t = 0; negative in the lead-in.
    pub collided_at_s: Option<f64>,
    /// Smallest clearance between cubes that may meet, m, 1 when none came near: the smaller of the engine's at every step and the
    /// firmware pre-check's at every control tick. A robot holds below `control::precheck::MARGIN_M`.
    pub clearance_m: f64,
    /// Largest speed at which a part struck the ground, m/s.
    pub impact_m_s: f64,
    /// Largest sum of the ground's normal forces, averaged over one step, N.
    pub peak_force_n: f64,
    /// Mean and largest penetration of touching points, m.
    pub penetration_m: (f64, f64),
    /// Root mean square of set-point less encoder angle, over joints and ticks, rad.
    pub tracking_rms_rad: f64,
    /// Set when a number stopped being one.
    pub not_finite: Option<NotFinite>,
}

/// Why trials were refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RunError {
    /// A setting is out of range.
    #[error("`{setting}` is {value}, allowed is {min} to {max}")]
    Setting {
        /// Name of the field.
        setting: &'static str,
        /// The refused value.
        value: f64,
        /// Smallest accepted value.
        min: f64,
        /// Largest accepted value.
        max: f64,
    },
    /// A gait, series or start state has another number of joints than the robot has motors.
    #[error(
        "trial {trial}: {found} joints in the drive or start state, the robot has {motors} motors"
    )]
    JointCount {
        /// Index of the trial.
        trial: usize,
        /// Joints found.
        found: usize,
        /// Motors of the robot.
        motors: usize,
    },
    /// A series of set-points or angles is empty or its period is not positive.
    #[error("trial {trial}: a series needs at least one sample and a positive period")]
    Series {
        /// Index of the trial.
        trial: usize,
    },
}

impl Options {
    pub(crate) fn check(&self) -> Result<(), RunError> {
        let settings = [
            ("time_step_s", self.time_step_s, 1e-5, 0.02),
            ("sweeps", f64::from(self.sweeps), 1.0, 10_000.0),
            (
                "sample_rate_hz",
                self.sample_rate_hz,
                0.0,
                1.0 / self.time_step_s,
            ),
            ("approach_rad_s", self.approach_rad_s, 0.01, 100.0),
            ("settle_s", self.settle_s, 0.0, 60.0),
        ];
        for (setting, value, min, max) in settings {
            if !(value >= min && value <= max * (1.0 + 1e-12)) {
                return Err(RunError::Setting {
                    setting,
                    value,
                    min,
                    max,
                });
            }
        }
        Ok(())
    }
}

impl Trial {
    pub(crate) fn check(&self, trial: usize) -> Result<(), RunError> {
        let motors = self.params.robot.motors();
        let count = |found: usize| {
            if found == motors {
                Ok(())
            } else {
                Err(RunError::JointCount {
                    trial,
                    found,
                    motors,
                })
            }
        };
        if !(self.duration_s > 0.0 && self.duration_s <= 3600.0) {
            return Err(RunError::Setting {
                setting: "duration_s",
                value: self.duration_s,
                min: 0.0,
                max: 3600.0,
            });
        }
        if let Start::State {
            angles_rad,
            speeds_rad_s,
            ..
        } = &self.start
        {
            let all = self.params.robot.joints();
            if [angles_rad, speeds_rad_s].map(Vec::len) != [all, all] {
                count(angles_rad.len())?;
                count(speeds_rad_s.len())?;
            }
        }
        match &self.drive {
            Drive::Gait { gait, .. } => count(gait.oscillators().len()),
            Drive::SetPoints {
                period_s,
                values_rad,
            }
            | Drive::LinkAngles {
                period_s,
                values_rad,
            }
            | Drive::EncoderAngles {
                period_s,
                values_rad,
            } => {
                if values_rad.is_empty() || period_s.is_nan() || *period_s <= 0.0 {
                    return Err(RunError::Series { trial });
                }
                count(if values_rad.len().is_multiple_of(motors) {
                    motors
                } else {
                    values_rad.len()
                })
            }
        }
    }
}
