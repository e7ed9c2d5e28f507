//! A structure as the firmware sees it: its joints, and what of it may meet.

use super::{Motor, Part, Structure};
use control::machine::{Contact, MAX_JOINTS, Machine, MachineError};
use control::robot::{JointKind, JointLimits, RobotModel};

/// The two robots whose parts are known: one is checked, of the other nothing can meet.
const METAMODULE: &str = include_str!("../../../robots/metamodule.toml");
const MODULE: &str = include_str!("../../../robots/module.toml");

/// Why a structure is no robot that the firmware drives.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoMachine {
    /// Too few, too many or impossible joints.
    #[error("{0}")]
    Machine(MachineError),
    /// A motor's joint index is taken, or leaves a gap below it.
    #[error("joint = {joint}: motors are joints 0 to {last}, each once")]
    Joint {
        /// Body with the index.
        body: usize,
        /// The index.
        joint: usize,
        /// Largest index.
        last: usize,
    },
}

impl NoMachine {
    /// Part of the file it is about.
    #[must_use]
    pub fn part(&self) -> Part {
        match self {
            Self::Machine(_) => Part::Top,
            Self::Joint { body, .. } => Part::Body(*body),
        }
    }
}

impl Structure {
    /// The robot as the firmware sees it: connections that give are no joints.
    ///
    /// # Errors
    /// [`NoMachine`]
    pub fn machine(&self) -> Result<Machine, NoMachine> {
        let motors = self.bodies.iter().enumerate().filter_map(|(body, hinge)| {
            let hinge = hinge.as_ref()?;
            Some((body, hinge, kind(hinge.motor)?))
        });
        let count = motors.clone().count();
        if count == 0 || count > MAX_JOINTS {
            let joints = count.min(usize::from(u8::MAX)) as u8;
            return Err(NoMachine::Machine(MachineError::JointCount { joints }));
        }
        let mut limits = vec![None; count];
        for (body, hinge, kind) in motors {
            let wrong = NoMachine::Joint {
                body,
                joint: hinge.joint,
                last: count - 1,
            };
            let place = limits.get_mut(hinge.joint).ok_or(wrong)?;
            if place.is_some() {
                return Err(wrong);
            }
            let speed = hinge.no_load_speed_rad_s.map(|speed| speed as f32);
            *place = Some(JointLimits {
                no_load_speed_rad_s: speed.unwrap_or(JointLimits::of(kind).no_load_speed_rad_s),
            });
        }
        // Each of `count` joints has found a place of its own.
        let limits: Vec<JointLimits> = limits.into_iter().flatten().collect();
        Machine::new(&limits, self.contact()).map_err(NoMachine::Machine)
    }

    /// What of it may meet. Only the two robots that come with the program, to the bit, are known; no word of a user takes the check from
    /// the meta-module.
    fn contact(&self) -> Contact {
        if self.has_shape_of(METAMODULE) {
            Contact::MetaModule(RobotModel::default())
        } else if self.has_shape_of(MODULE) {
            Contact::Module
        } else if self.unchecked {
            Contact::Unchecked
        } else {
            Contact::Unstated
        }
    }

    /// Whether name, masses, speeds and drivers are all that differs.
    fn has_shape_of(&self, text: &str) -> bool {
        let Ok(mut known) = Self::parse("robot.toml", text) else {
            return false;
        };
        let mut own = self.clone();
        for structure in [&mut known, &mut own] {
            structure.lines.clear();
            structure.name.clear();
            structure.driver = None;
            structure.unchecked = false;
            structure.fixed_base = false;
            for half in &mut structure.halves {
                half.mass_kg = None;
            }
            for hinge in structure.bodies.iter_mut().flatten() {
                hinge.no_load_speed_rad_s = None;
            }
        }
        known == own
    }
}

fn kind(motor: Motor) -> Option<JointKind> {
    match motor {
        Motor::Intra => Some(JointKind::IntraCube),
        Motor::Inter => Some(JointKind::InterCube),
        Motor::Connector => None,
    }
}
