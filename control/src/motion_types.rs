//! Settings, errors and results of the motion planner.

use crate::CYCLE_S;
use crate::gait::RobotMismatch;
use crate::machine::{Angles, Machine};
use crate::precheck::{self, Blocked, Margins};
use crate::robot::RobotModel;

/// Longest look-ahead in cycles (1.2 s).
pub const MAX_LOOKAHEAD: usize = 24;
/// Numbers a user may set.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MotionSettings {
    /// Moves certified ahead; 20 is one second, 1 turns the look-ahead off. 1 to [`MAX_LOOKAHEAD`].
    pub lookahead_cycles: u8,
    /// Margins of moves between set-points.
    pub planned: Margins,
    /// Margins of the move from the measured pose: smaller, because servo lag takes some of the planned one.
    pub measured: Margins,
    /// Speed of the approach as a fraction of the no-load speed.
    pub approach_ratio: f32,
}

impl MotionSettings {
    /// The default; a constant, so that a static can hold it.
    pub const NOMINAL: MotionSettings = MotionSettings {
        lookahead_cycles: 20,
        planned: Margins {
            keep_m: precheck::MARGIN_M,
            escape_m: 1e-3,
        },
        measured: Margins {
            keep_m: 1e-3,
            escape_m: 2e-4,
        },
        approach_ratio: 0.5,
    };
}

impl Default for MotionSettings {
    fn default() -> Self {
        MotionSettings::NOMINAL
    }
}

/// The settings that were refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SettingsError {
    /// Look-ahead of zero or above [`MAX_LOOKAHEAD`].
    Lookahead,
    /// A margin is negative, above 50 mm or not a number, or the escape margin exceeds the kept one.
    Margin,
    /// The approach ratio is not in (0, 1].
    ApproachRatio,
}

/// Robot and settings, valid: what [`crate::motion::Planner`] reads and never writes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionParams {
    machine: Machine,
    settings: MotionSettings,
}

impl MotionParams {
    /// [`RobotModel::STRAIGHT`] with the default settings.
    pub const STRAIGHT: MotionParams = MotionParams {
        machine: Machine::meta_module(RobotModel::STRAIGHT),
        settings: MotionSettings::NOMINAL,
    };

    /// Validates the settings.
    ///
    /// # Errors
    /// [`SettingsError`] names the one out of range.
    pub fn new(machine: Machine, settings: MotionSettings) -> Result<Self, SettingsError> {
        if settings.lookahead_cycles == 0 || usize::from(settings.lookahead_cycles) > MAX_LOOKAHEAD
        {
            return Err(SettingsError::Lookahead);
        }
        for m in [settings.planned, settings.measured] {
            if !(m.escape_m >= 0.0 && m.escape_m <= m.keep_m && m.keep_m <= 0.05) {
                return Err(SettingsError::Margin);
            }
        }
        if !(settings.approach_ratio > 0.0 && settings.approach_ratio <= 1.0) {
            return Err(SettingsError::ApproachRatio);
        }
        Ok(MotionParams { machine, settings })
    }

    /// The robot.
    #[must_use]
    pub const fn machine(&self) -> &Machine {
        &self.machine
    }

    /// The same settings for another robot.
    #[must_use]
    pub const fn with_machine(self, machine: Machine) -> Self {
        MotionParams { machine, ..self }
    }

    /// The settings.
    #[must_use]
    pub const fn settings(&self) -> &MotionSettings {
        &self.settings
    }

    /// Largest change of each set-point in one cycle at `ratio` of the no-load speed, rad.
    pub(crate) fn steps_rad(&self, ratio: f32) -> Angles {
        Angles::each(self.machine.limits(), |joint| {
            joint.no_load_speed_rad_s * CYCLE_S * ratio
        })
    }
}

/// Why no motion can begin.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BeginError {
    /// The gait does not fit the robot.
    Mismatch(RobotMismatch),
    /// The pose is that of a robot with another number of joints.
    PoseCount {
        /// Angles given.
        angles: u8,
        /// Joints of the robot.
        joints: u8,
    },
    /// The robot stands outside [`crate::motion::POSITION_LIMIT_RAD`] or its pose is not a number.
    Pose {
        /// Joint index.
        joint: u8,
        /// The angle, rad.
        value_rad: f32,
    },
}

/// Why a new gait was not taken over.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RetargetError {
    /// The gait does not fit the robot.
    Mismatch(RobotMismatch),
    /// The last change has not reached the motors yet; try again one look-ahead later.
    ChangePending,
}

/// A set-point that failed its last check. It was not sent.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BadSetPoint {
    /// Joint index.
    pub joint: u8,
    /// The refused set-point, rad.
    pub value_rad: f32,
    /// The set-point before it, rad.
    pub previous_rad: f32,
}

/// One cycle's result.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CycleOutput {
    /// What to send to the motors, rad.
    pub set_point_rad: Angles,
    /// What the gait asks at this instant, rad; equal to `set_point_rad` to the bit unless held or catching up.
    pub gait_rad: Angles,
    /// The pre-check holds the robot in this cycle.
    pub held: bool,
    /// A move was blocked in this cycle: which pair, how close, how far ahead.
    pub blocked: Option<Blocked>,
    /// Approach only: the robot's set-point is the start pose and the first look-ahead of the run is certified.
    pub in_position: bool,
    /// Approach only: the way to the start pose is blocked and stays so.
    pub approach_blocked: bool,
    /// Ramp only: the amplitudes are zero, or the ramp was blocked; the robot is at rest.
    pub settled: bool,
}
