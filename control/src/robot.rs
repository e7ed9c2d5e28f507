//! The meta-module as parameters: two modules with three joints each, four cubes, seven rigid bodies. What the law needs of any robot, of
//! one to twelve joints, is a [`crate::machine::Machine`].

use crate::linalg::{Rot3, Vec3};
use crate::math;

/// Joints of a meta-module.
pub const JOINTS: usize = 6;
/// Rigid bodies of a meta-module; body k and body k+1 meet in joint k.
pub const BODIES: usize = 7;

/// Edge of one cube, m (EPFL kinematics; paper: 110 x 110 x 440 mm meta-module).
pub const CUBE_M: f32 = 0.110;
/// Radius of the ball a half-sphere is cut from, m (design parameter: shells are rounder than cubes, larger than balls of one edge).
pub const BALL_RADIUS_M: f32 = 0.062;
/// No-load speed of an intra-cube joint (M0, M2): 26.6 rpm, Faulhaber 2342 012 CR with 305:1 (paper, Table I).
pub const INTRA_NO_LOAD_RAD_S: f32 = 2.786;
/// No-load speed of an inter-cube joint (M1): 19.4 rpm, Faulhaber 2232 012 SR with 366:1 (paper, Table I).
pub const INTER_NO_LOAD_RAD_S: f32 = 2.032;
/// Default twist between the modules at the connection: 90 deg, "PER" (EPFL).
pub const TWIST_RAD: f32 = core::f32::consts::FRAC_PI_2;

/// How a joint is built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum JointKind {
    /// M0 and M2: turns the two halves of one cube about its body diagonal.
    IntraCube,
    /// M1: turns two cubes about the line through their centres.
    InterCube,
}

/// Kind of joint 0..5 in joint order.
pub const JOINT_KINDS: [JointKind; JOINTS] = [
    JointKind::IntraCube,
    JointKind::InterCube,
    JointKind::IntraCube,
    JointKind::IntraCube,
    JointKind::InterCube,
    JointKind::IntraCube,
];

/// Names of joint 0..5 in joint order.
pub const JOINT_NAMES: [&str; JOINTS] = ["A.M0", "A.M1", "A.M2", "B.M0", "B.M1", "B.M2"];

/// What one joint can do.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct JointLimits {
    /// No-load speed, rad/s: no set-point asks for more.
    pub no_load_speed_rad_s: f32,
}

impl JointLimits {
    /// Limits of the motor that drives joints of this kind (paper, Table I).
    #[must_use]
    pub const fn of(kind: JointKind) -> Self {
        match kind {
            JointKind::IntraCube => JointLimits {
                no_load_speed_rad_s: INTRA_NO_LOAD_RAD_S,
            },
            JointKind::InterCube => JointLimits {
                no_load_speed_rad_s: INTER_NO_LOAD_RAD_S,
            },
        }
    }
}

/// Plain numbers of a robot before validation.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RobotParams {
    /// Rotation of module B against module A about the long axis, rad.
    pub twist_rad: f32,
    /// Edge of a cube, m.
    pub cube_m: f32,
    /// Radius of the ball, m.
    pub ball_radius_m: f32,
    /// Limits of joint 0..5.
    pub joints: [JointLimits; JOINTS],
}

impl RobotParams {
    /// The default; a constant, so that a static can hold it.
    pub const NOMINAL: RobotParams = RobotParams {
        twist_rad: TWIST_RAD,
        cube_m: CUBE_M,
        ball_radius_m: BALL_RADIUS_M,
        joints: {
            let intra = JointLimits::of(JointKind::IntraCube);
            let inter = JointLimits::of(JointKind::InterCube);
            [intra, inter, intra, intra, inter, intra]
        },
    };
}

impl Default for RobotParams {
    fn default() -> Self {
        RobotParams::NOMINAL
    }
}

/// The parameter of [`RobotParams`] that was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RobotField {
    /// `twist_rad`.
    Twist,
    /// `cube_m`.
    Cube,
    /// `ball_radius_m`.
    BallRadius,
    /// `joints[k].no_load_speed_rad_s`.
    NoLoadSpeed,
}

/// Why a robot was refused.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RobotError {
    /// A parameter is not a number or outside its range.
    OutOfRange {
        /// Which parameter.
        field: RobotField,
        /// Joint index, 0 for parameters that exist once.
        index: u8,
        /// The refused value.
        value: f32,
        /// Smallest accepted value.
        min: f32,
        /// Largest accepted value.
        max: f32,
    },
}

impl core::fmt::Display for RobotError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let RobotError::OutOfRange {
            field,
            index,
            value,
            min,
            max,
        } = *self;
        let name = match field {
            RobotField::Twist => "twist_rad",
            RobotField::Cube => "cube_m",
            RobotField::BallRadius => "ball_radius_m",
            RobotField::NoLoadSpeed => "no_load_speed_rad_s",
        };
        write!(
            f,
            "{name} (joint {index}) is {value}, allowed is {min} to {max}"
        )
    }
}

impl core::error::Error for RobotError {}

/// A valid robot: geometry and joint limits, with what kinematics and pre-check need precomputed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotModel {
    params: RobotParams,
    twist: Rot3,
    axes: [Vec3; JOINTS],
}

impl Default for RobotModel {
    /// The nominal meta-module of the paper: twist 90 deg, 110 mm cubes, 62 mm balls, Table I motors.
    fn default() -> Self {
        RobotModel::build(RobotParams::default())
    }
}

impl RobotModel {
    /// The nominal robot but for its twist of 0. A constant, so that a static can hold it until the real model is set.
    pub const STRAIGHT: RobotModel = RobotModel {
        params: RobotParams {
            twist_rad: 0.0,
            ..RobotParams::NOMINAL
        },
        twist: Rot3::IDENTITY,
        axes: {
            let (d, x) = (Self::DIAGONAL, Rot3::IDENTITY.x);
            [d, x, d, d, x, d]
        },
    };

    /// Body diagonal (1,1,1)/sqrt 3: axis of the intra-cube joints of an untwisted module at home.
    pub const DIAGONAL: Vec3 = Vec3::new(0.577_350_26, 0.577_350_26, 0.577_350_26);

    /// Validates the numbers.
    ///
    /// # Errors
    /// [`RobotError::OutOfRange`]. The ball radius must lie between S/2 and S/sqrt 3 (S the cube edge): above it cubes 1 and 3
    /// could meet, which the pre-check takes as impossible.
    pub fn new(params: RobotParams) -> Result<Self, RobotError> {
        let check = |field, index: usize, value: f32, min: f32, max: f32| {
            if value >= min && value <= max {
                Ok(())
            } else {
                Err(RobotError::OutOfRange {
                    field,
                    index: index as u8,
                    value,
                    min,
                    max,
                })
            }
        };
        check(
            RobotField::Twist,
            0,
            params.twist_rad,
            -math::TAU,
            math::TAU,
        )?;
        check(RobotField::Cube, 0, params.cube_m, 0.01, 1.0)?;
        let s = params.cube_m;
        check(
            RobotField::BallRadius,
            0,
            params.ball_radius_m,
            0.5 * s,
            0.577 * s,
        )?;
        for (k, joint) in params.joints.iter().enumerate() {
            check(
                RobotField::NoLoadSpeed,
                k,
                joint.no_load_speed_rad_s,
                0.01,
                20.0,
            )?;
        }
        Ok(RobotModel::build(params))
    }

    fn build(params: RobotParams) -> Self {
        let twist = Rot3::about(Rot3::IDENTITY.x, params.twist_rad);
        let diagonal_b = twist.apply(Self::DIAGONAL);
        let x = Rot3::IDENTITY.x;
        let axes = [Self::DIAGONAL, x, Self::DIAGONAL, diagonal_b, x, diagonal_b];
        RobotModel {
            params,
            twist,
            axes,
        }
    }

    /// The numbers this robot was built from.
    #[must_use]
    pub const fn params(&self) -> &RobotParams {
        &self.params
    }

    /// Rotation of module B against module A about the long axis at home, rad.
    #[must_use]
    pub const fn twist_rad(&self) -> f32 {
        self.params.twist_rad
    }

    /// The twist as a rotation about x.
    #[must_use]
    pub const fn twist(&self) -> &Rot3 {
        &self.twist
    }

    /// Edge S of a cube, m.
    #[must_use]
    pub const fn cube_m(&self) -> f32 {
        self.params.cube_m
    }

    /// Radius of the balls, m.
    #[must_use]
    pub const fn ball_radius_m(&self) -> f32 {
        self.params.ball_radius_m
    }

    /// Limits of joint 0..5.
    #[must_use]
    pub const fn joints(&self) -> &[JointLimits; JOINTS] {
        &self.params.joints
    }

    /// Unit axes of joint 0..5 at home, all body frames parallel to the world.
    #[must_use]
    pub const fn axes(&self) -> &[Vec3; JOINTS] {
        &self.axes
    }

    /// A point on the axis of joint 0..5 at home, m: C1, midpoint C1 C2, C2, C3, midpoint C3 C4, C4.
    #[must_use]
    pub fn axis_points_m(&self) -> [Vec3; JOINTS] {
        [0.0, 0.5, 1.0, 2.0, 2.5, 3.0].map(|k| Vec3::new(k * self.params.cube_m, 0.0, 0.0))
    }

    /// Body frame origins at home, m: C1, C1, C2, midpoint C2 C3, C3, C4, C4.
    #[must_use]
    pub fn body_origins_m(&self) -> [Vec3; BODIES] {
        [0.0, 0.0, 1.0, 1.5, 2.0, 3.0, 3.0].map(|k| Vec3::new(k * self.params.cube_m, 0.0, 0.0))
    }
}
