//! Why a structure is no robot.

use files::structure::Part;

/// Why a structure was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RobotError {
    /// More than the engine holds.
    #[error("the robot has {found} {what}, at most {most} are supported")]
    TooMany {
        /// What there is too much of.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there may be.
        most: usize,
    },
    /// A part refers to something that does not exist or comes later.
    #[error("{part} refers to {to}, which does not exist or does not stand before it")]
    Reference {
        /// What refers.
        part: Part,
        /// Index of what it refers to.
        to: usize,
    },
    /// An axis or normal is not of unit length, or normals are not at right angles.
    #[error("the directions of {part} are not unit vectors at right angles to each other")]
    NotUnit {
        /// What they belong to.
        part: Part,
    },
    /// Without a body there is nothing to simulate.
    #[error("the robot has no body")]
    Empty,
    /// Nothing hangs on a body, so nothing resists its motor.
    #[error("neither {part} nor what hangs on it holds a half-sphere")]
    Massless {
        /// The body.
        part: Part,
    },
    /// Contacts are found cube by cube.
    #[error("{part} belongs to {found} cubes; it must belong to one")]
    Cubeless {
        /// The half-sphere.
        part: Part,
        /// Cubes that name it.
        found: usize,
    },
    /// Gaits count the motors, so joints without one stand behind.
    #[error(
        "{part} has a motor, but a joint without one comes before it; give connectors the last joint indices"
    )]
    ConnectorFirst {
        /// The body.
        part: Part,
    },
    /// Joint indices must be 0.. without gaps, the base alone without joint.
    #[error(
        "joint indices must count from 0 without gaps, one per body but the base; body {body} breaks this"
    )]
    Joints {
        /// The offending body.
        body: usize,
    },
    /// The two halves of a cube must share a centre and face away from each other.
    #[error("the halves of cube {cube} do not share a centre or do not face away from each other")]
    Cube {
        /// The offending cube.
        cube: usize,
    },
    /// The ball must be larger than the inscribed and smaller than the edge-touching ball of the cube.
    #[error("ball radius {radius_m} m must lie between {min_m} and {max_m} m for this cube")]
    Ball {
        /// The refused radius.
        radius_m: f64,
        /// Half the cube's edge.
        min_m: f64,
        /// Largest radius for which the face discs stay apart.
        max_m: f64,
    },
}

impl RobotError {
    /// The part of a structure that it is about.
    #[must_use]
    pub fn part(&self) -> Part {
        match *self {
            RobotError::Reference { part, .. }
            | RobotError::NotUnit { part }
            | RobotError::Massless { part }
            | RobotError::Cubeless { part, .. }
            | RobotError::ConnectorFirst { part } => part,
            RobotError::Joints { body } => Part::Body(body),
            RobotError::Cube { cube } => Part::Cube(cube),
            RobotError::TooMany { .. } | RobotError::Empty | RobotError::Ball { .. } => Part::Top,
        }
    }
}
