//! Which robot a module is: its joints, and what of it may meet. [`control::machine::Machine`] is the checked one.

use control::machine::{Contact, Machine, MachineError};
use control::robot::{JointLimits, RobotModel, RobotParams};
use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::{JOINTS, MAX_JOINTS};

/// A robot as a module is told of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireRobot {
    /// What of it may meet.
    pub contact: WireContact,
    /// No-load speeds in joint order, rad/s; as many as the robot has joints. Joint k is driven by bus id k + 1.
    pub speeds_rad_s: Vec<f32, MAX_JOINTS>,
}

/// What is known of the parts of a robot that may meet, as [`Contact`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum WireContact {
    /// Six joints; the module checks every move with the geometry it is built with.
    MetaModule,
    /// Three joints; nothing of it can meet.
    Module,
    /// Nobody checks, and the user has said that he knows.
    Unchecked,
    /// Nobody checks, and nobody has said so: the robot does not run.
    Unstated,
}

impl WireContact {
    /// As a number, which is its place in the enum.
    #[must_use]
    pub const fn number(self) -> u8 {
        self as u8
    }

    /// The one with this number.
    #[must_use]
    pub const fn from_number(number: u8) -> Option<Self> {
        match number {
            0 => Some(Self::MetaModule),
            1 => Some(Self::Module),
            2 => Some(Self::Unchecked),
            3 => Some(Self::Unstated),
            _ => None,
        }
    }
}

impl From<&Contact> for WireContact {
    fn from(contact: &Contact) -> Self {
        match contact {
            Contact::MetaModule(_) => Self::MetaModule,
            Contact::Module => Self::Module,
            Contact::Unchecked => Self::Unchecked,
            Contact::Unstated => Self::Unstated,
        }
    }
}

impl From<&Machine> for WireRobot {
    fn from(machine: &Machine) -> Self {
        let mut speeds_rad_s = Vec::new();
        for joint in machine.limits() {
            // A machine has at most MAX_JOINTS.
            let _ = speeds_rad_s.push(joint.no_load_speed_rad_s);
        }
        Self {
            contact: machine.contact().into(),
            speeds_rad_s,
        }
    }
}

impl WireRobot {
    /// The robot, a meta-module with the geometry of `model`.
    ///
    /// # Errors
    /// [`MachineError`] says what of it cannot be.
    pub fn machine(&self, model: &RobotModel) -> Result<Machine, MachineError> {
        let mut limits = Vec::<JointLimits, MAX_JOINTS>::new();
        for speed in &self.speeds_rad_s {
            // Both hold MAX_JOINTS.
            let _ = limits.push(JointLimits {
                no_load_speed_rad_s: *speed,
            });
        }
        // The speeds first: the model's own check would not name them as this one does.
        let machine = Machine::new(&limits, Contact::Unstated)?;
        let contact = match self.contact {
            WireContact::Module => Contact::Module,
            WireContact::Unchecked => Contact::Unchecked,
            WireContact::Unstated => Contact::Unstated,
            WireContact::MetaModule => {
                let wrong = MachineError::WrongCount {
                    joints: machine.joints(),
                    expected: JOINTS as u8,
                };
                let joints = <[JointLimits; JOINTS]>::try_from(limits.as_slice());
                let params = RobotParams {
                    joints: joints.map_err(|_| wrong)?,
                    ..*model.params()
                };
                Contact::MetaModule(RobotModel::new(params).map_err(|_| wrong)?)
            }
        };
        Machine::new(&limits, contact)
    }
}
