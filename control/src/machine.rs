//! What the law knows of a robot: one to twelve joints, how fast each turns, and what of it may meet.

use crate::precheck::{self, Margins, Verdict};
use crate::robot::{JOINTS, JointKind, JointLimits, RobotModel};

/// Joints a robot may have; a gait has one oscillator for each.
pub const MAX_JOINTS: usize = crate::gait::MAX_OSCILLATORS;
/// Joints of one module.
pub const MODULE_JOINTS: usize = 3;
/// Smallest and largest no-load speed of a joint, rad/s.
pub const SPEED_RAD_S: (f32, f32) = (0.01, 20.0);

/// One bit per joint of a robot of `joints`, all set.
#[must_use]
pub const fn all_joints(joints: u8) -> u16 {
    // At most MAX_JOINTS bits, so the shift stays inside the type.
    let joints = if joints as usize > MAX_JOINTS {
        MAX_JOINTS as u32
    } else {
        joints as u32
    };
    (1u16 << joints) - 1
}

/// One angle per joint, rad, in joint order.
#[derive(Clone, Copy, Debug)]
pub struct Angles {
    /// Zero beyond `count`.
    rad: [f32; MAX_JOINTS],
    count: u8,
}

impl Angles {
    /// The angles; `None` for none or more than [`MAX_JOINTS`].
    #[must_use]
    pub fn new(angles_rad: &[f32]) -> Option<Self> {
        let fits = !angles_rad.is_empty() && angles_rad.len() <= MAX_JOINTS;
        fits.then(|| Angles::each(angles_rad, |angle| *angle))
    }

    /// One angle for each of the first [`MAX_JOINTS`] items.
    pub(crate) fn each<T>(items: &[T], angle_rad: impl Fn(&T) -> f32) -> Self {
        let mut rad = [0.0; MAX_JOINTS];
        for (to, item) in rad.iter_mut().zip(items) {
            *to = angle_rad(item);
        }
        Angles {
            rad,
            count: items.len().min(MAX_JOINTS) as u8,
        }
    }

    /// The angles, rad.
    #[must_use]
    pub fn as_slice(&self) -> &[f32] {
        self.rad.get(..usize::from(self.count)).unwrap_or(&[])
    }

    /// The angles to change, rad.
    pub fn as_mut_slice(&mut self) -> &mut [f32] {
        self.rad
            .get_mut(..usize::from(self.count))
            .unwrap_or(&mut [])
    }

    /// The angles of a meta-module, rad; joints that are not there stand at home.
    #[must_use]
    pub const fn meta_module(&self) -> [f32; JOINTS] {
        let [a, b, c, d, e, f, ..] = self.rad;
        [a, b, c, d, e, f]
    }
}

impl PartialEq for Angles {
    fn eq(&self, other: &Self) -> bool {
        self.as_slice() == other.as_slice()
    }
}

impl<const N: usize> PartialEq<[f32; N]> for Angles {
    fn eq(&self, other: &[f32; N]) -> bool {
        self.as_slice() == other.as_slice()
    }
}

impl core::ops::Deref for Angles {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        self.as_slice()
    }
}

impl core::ops::DerefMut for Angles {
    fn deref_mut(&mut self) -> &mut [f32] {
        self.as_mut_slice()
    }
}

impl<const N: usize> From<[f32; N]> for Angles {
    fn from(angles_rad: [f32; N]) -> Self {
        const { assert!(N >= 1 && N <= MAX_JOINTS) };
        Angles::each(&angles_rad, |angle| *angle)
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Angles {
    fn format(&self, to: defmt::Formatter<'_>) {
        defmt::Format::format(self.as_slice(), to);
    }
}

/// What is known of the parts of a robot that may meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Contact {
    /// Six joints; [`crate::precheck`] checks every move.
    MetaModule(RobotModel),
    /// Three joints, two cubes that are neighbours: nothing of it can meet.
    Module,
    /// Nobody checks, and the user has said that he knows.
    Unchecked,
    /// Nobody checks, and nobody has said so: the robot does not run.
    Unstated,
}

/// Why a machine was refused.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MachineError {
    /// No joint, or more than [`MAX_JOINTS`].
    JointCount {
        /// Joints given.
        joints: u8,
    },
    /// A meta-module has six joints, a module three.
    WrongCount {
        /// Joints given.
        joints: u8,
        /// Joints it has.
        expected: u8,
    },
    /// A no-load speed is not a number or outside [`SPEED_RAD_S`].
    Speed {
        /// Joint index.
        joint: u8,
        /// The refused speed, rad/s.
        value_rad_s: f32,
    },
}

impl core::fmt::Display for MachineError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            MachineError::JointCount { joints } => {
                write!(f, "{joints} motors, allowed are 1 to {MAX_JOINTS}")
            }
            MachineError::WrongCount { joints, expected } => {
                write!(f, "{joints} motors, a robot of this kind has {expected}")
            }
            MachineError::Speed { joint, value_rad_s } => {
                let (min, max) = SPEED_RAD_S;
                write!(
                    f,
                    "no-load speed of joint {joint} is {value_rad_s} rad/s, allowed is {min} to {max}"
                )
            }
        }
    }
}

impl core::error::Error for MachineError {}

/// A valid robot as the law sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Machine {
    /// Those of an intra-cube joint beyond `count`.
    limits: [JointLimits; MAX_JOINTS],
    count: u8,
    contact: Contact,
}

impl Default for Machine {
    /// The nominal meta-module.
    fn default() -> Self {
        Machine::meta_module(RobotModel::default())
    }
}

impl Machine {
    /// A meta-module.
    #[must_use]
    pub const fn meta_module(model: RobotModel) -> Self {
        let [a, b, c, d, e, f] = *model.joints();
        let none = JointLimits::of(JointKind::IntraCube);
        Machine {
            limits: [a, b, c, d, e, f, none, none, none, none, none, none],
            count: JOINTS as u8,
            contact: Contact::MetaModule(model),
        }
    }

    /// A robot of these joints.
    ///
    /// # Errors
    /// [`MachineError`]. The limits of a meta-module are those of its model.
    pub fn new(limits: &[JointLimits], contact: Contact) -> Result<Self, MachineError> {
        let joints = limits.len().min(usize::from(u8::MAX)) as u8;
        if limits.is_empty() || limits.len() > MAX_JOINTS {
            return Err(MachineError::JointCount { joints });
        }
        let expected = match contact {
            Contact::MetaModule(_) => JOINTS as u8,
            Contact::Module => MODULE_JOINTS as u8,
            Contact::Unchecked | Contact::Unstated => joints,
        };
        if joints != expected {
            return Err(MachineError::WrongCount { joints, expected });
        }
        let mut machine = Machine {
            limits: [JointLimits::of(JointKind::IntraCube); MAX_JOINTS],
            count: joints,
            contact,
        };
        for (k, (to, from)) in machine.limits.iter_mut().zip(limits).enumerate() {
            let speed = from.no_load_speed_rad_s;
            if !(speed >= SPEED_RAD_S.0 && speed <= SPEED_RAD_S.1) {
                return Err(MachineError::Speed {
                    joint: k as u8,
                    value_rad_s: speed,
                });
            }
            *to = *from;
        }
        Ok(machine)
    }

    /// Number of joints, 1 to [`MAX_JOINTS`].
    #[must_use]
    pub const fn joints(&self) -> u8 {
        self.count
    }

    /// One bit per joint, all set.
    #[must_use]
    pub const fn all_joints(&self) -> u16 {
        all_joints(self.count)
    }

    /// Limits of the joints, in joint order.
    #[must_use]
    pub fn limits(&self) -> &[JointLimits] {
        self.limits.get(..usize::from(self.count)).unwrap_or(&[])
    }

    /// What is known of its parts that may meet.
    #[must_use]
    pub const fn contact(&self) -> &Contact {
        &self.contact
    }

    /// The geometry that the pre-check uses; `None` for a robot that it does not know.
    #[must_use]
    pub const fn model(&self) -> Option<&RobotModel> {
        match &self.contact {
            Contact::MetaModule(model) => Some(model),
            Contact::Module | Contact::Unchecked | Contact::Unstated => None,
        }
    }

    /// Whether a straight move keeps its distance. Of a robot that the pre-check does not know every move is clear: such a robot runs
    /// only where nothing can meet or the user has said that nobody checks.
    #[must_use]
    pub fn check_move(&self, from_rad: &Angles, to_rad: &Angles, margins: Margins) -> Verdict {
        match self.model() {
            Some(model) => precheck::check_move(
                model,
                &from_rad.meta_module(),
                &to_rad.meta_module(),
                margins,
            ),
            None => UNCHECKED,
        }
    }

    /// As [`Machine::check_move`], for a robot that keeps `margin_m` from its first pose on.
    #[must_use]
    pub fn swept(&self, from_rad: &Angles, to_rad: &Angles, margin_m: f32) -> Verdict {
        match self.model() {
            Some(model) => precheck::swept(
                model,
                &from_rad.meta_module(),
                &to_rad.meta_module(),
                margin_m,
            ),
            None => UNCHECKED,
        }
    }
}

/// What a robot gets that the pre-check does not know.
const UNCHECKED: Verdict = Verdict::Clear {
    clearance_m: f32::INFINITY,
};
