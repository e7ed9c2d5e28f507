//! The numbers of a gait: an amplitude and an offset per joint and the phase lags of their chain; the meta-module's are 17.

use control::gait::{self, Gait, GaitError, Oscillator, RawGait};
use control::math;
use physics::{JointClass, Robot};
use serde::{Deserialize, Serialize};

/// The search space and what all its gaits share. Parameters only.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GaitSpace {
    /// f, Hz; the paper's 0.2.
    pub frequency_hz: f32,
    /// a, 1/s; the paper's 2.
    pub rate_a_per_s: f32,
    /// w, 1/(s rad); the paper's 0.5.
    pub weight: f32,
    /// Length of a trial, s; the paper's 30.
    pub duration_s: f32,
    /// Highest speed a set-point may ask of each joint, rad/s; one entry per joint, so its length says how many oscillators a gait has.
    pub joint_speed_rad_s: Vec<f32>,
    /// Offsets reach this far either way, rad.
    pub offset_limit_rad: f32,
}

/// The hand-tuned maximum velocities of the simulated motors (paper, Table II rows 13 and 17), by joint kind. Gaits that ask for
/// more would be clipped in simulation, and the real motors' no-load speeds (2.786, 2.032 rad/s) leave little above them.
const HAND_TUNED_SPEED_RAD_S: [f32; 2] = [2.5, 1.5];

impl Default for GaitSpace {
    /// The paper's constants; offsets up to half a turn, as the joints have no end stops.
    fn default() -> Self {
        let [intra, inter] = HAND_TUNED_SPEED_RAD_S;
        Self {
            frequency_hz: 0.2,
            rate_a_per_s: 2.0,
            weight: 0.5,
            duration_s: 30.0,
            joint_speed_rad_s: vec![intra, inter, intra, intra, inter, intra],
            offset_limit_rad: math::PI,
        }
    }
}

/// The speeds of [`GaitSpace::default`] for the joints of another robot, by the kind of their motor.
#[must_use]
pub fn joint_speeds_rad_s(robot: &Robot) -> Vec<f32> {
    let [intra, inter] = HAND_TUNED_SPEED_RAD_S;
    let speed = |class| match class {
        JointClass::Intra => intra,
        // A connector has no motor and is not counted among them.
        JointClass::Inter | JointClass::Connector => inter,
    };
    robot.motor_classes().map(speed).collect()
}

impl GaitSpace {
    /// Joints, and so oscillators.
    #[must_use]
    pub fn joints(&self) -> usize {
        self.joint_speed_rad_s.len()
    }

    /// Numbers per gait: 17 for the meta-module.
    #[must_use]
    pub fn dimensions(&self) -> usize {
        (3 * self.joints()).saturating_sub(1)
    }

    /// Bounds of the swarm: amplitudes from 0 to where R 2 pi f meets the joint's speed, offsets, lags of half a turn either way.
    #[must_use]
    pub fn bounds(&self) -> Vec<(f64, f64)> {
        let omega_rad_s = math::TAU * self.frequency_hz;
        let amplitudes = self.joint_speed_rad_s.iter().map(|&speed| {
            let highest = (speed / omega_rad_s).min(gait::AMPLITUDE_RAD.max);
            (0.0, f64::from(highest))
        });
        let offset = f64::from(self.offset_limit_rad);
        let offsets = (0..self.joints()).map(|_| (-offset, offset));
        let lag = f64::from(math::PI);
        let lags = (1..self.joints()).map(|_| (-lag, lag));
        amplitudes.chain(offsets).chain(lags).collect()
    }

    /// The gait of a position, started phase-locked.
    ///
    /// # Errors
    /// When the position does not have [`GaitSpace::dimensions`] numbers in range; positions inside [`GaitSpace::bounds`] always are.
    pub fn gait(&self, position: &[f64], name: &str) -> Result<Gait, GaitError> {
        let at = |i: usize| position.get(i).map_or(f32::NAN, |&x| x as f32);
        let joints = self.joints();
        let oscillators = (0..joints).map(|joint| Oscillator {
            amplitude_rad: at(joint),
            offset_rad: at(joints + joint),
            initial_phase_rad: 0.0,
        });
        let lags: Vec<f32> = (1..joints).map(|i| at(2 * joints + i - 1)).collect();
        let mut raw = RawGait {
            name: name.chars().take(gait::MAX_NAME / 4).collect(),
            frequency_hz: self.frequency_hz,
            rate_a_per_s: self.rate_a_per_s,
            duration_s: self.duration_s,
            oscillators: oscillators.take(gait::MAX_OSCILLATORS).collect(),
            links: gait::chain(self.weight, &lags),
        };
        raw.lock_phases();
        Gait::try_from(raw)
    }
}
