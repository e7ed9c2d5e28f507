//! The nominal parameters: Table II in its order, then geometry and the constants the paper leaves unsaid.

use super::Parameter;
use crate::structure::Motor;

/// Names one nominal parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Key {
    /// Constraint force mixing of the contacts and motors.
    Cfm,
    /// Error reduction parameter of the contacts.
    Erp,
    /// Coulomb friction, body on ground.
    Friction,
    /// Coefficient of restitution, body on ground.
    Bounce,
    /// Mass of half-sphere 1, counted from the free end of module A.
    Mass1,
    /// Mass of half-sphere 2, counted from the free end of module A.
    Mass2,
    /// Mass of half-sphere 3, counted from the free end of module A.
    Mass3,
    /// Mass of half-sphere 4, counted from the free end of module A.
    Mass4,
    /// Mass of half-sphere 5, counted from the free end of module A.
    Mass5,
    /// Mass of half-sphere 6, counted from the free end of module A.
    Mass6,
    /// Mass of half-sphere 7, counted from the free end of module A.
    Mass7,
    /// Mass of half-sphere 8, counted from the free end of module A.
    Mass8,
    /// Maximum velocity, intra-cube joints.
    IntraSpeed,
    /// Maximum torque, intra-cube joints.
    IntraTorque,
    /// Control parameter P, intra-cube joints.
    IntraGain,
    /// Damping constant, intra-cube joints.
    IntraDamping,
    /// Resistance of the winding, intra-cube joints.
    IntraWinding,
    /// Torque at the output per current, intra-cube joints.
    IntraTorquePerCurrent,
    /// Maximum velocity, inter-cube joints.
    InterSpeed,
    /// Maximum torque, inter-cube joints.
    InterTorque,
    /// Control parameter P, inter-cube joints.
    InterGain,
    /// Damping constant, inter-cube joints.
    InterDamping,
    /// Resistance of the winding, inter-cube joints.
    InterWinding,
    /// Torque at the output per current, inter-cube joints.
    InterTorquePerCurrent,
    /// Voltage of the supply without load.
    SupplyVoltage,
    /// Height of the overhead camera.
    CameraHeight,
    /// Time shift between the recorded and the simulated film.
    CameraTimeShift,
    /// Rotation of module B against module A about x.
    Twist,
    /// Edge of a cube.
    Cube,
    /// Radius of the ball a half-sphere is cut from.
    BallRadius,
    /// Standard deviation of the noise on the CPG outputs.
    CpgNoise,
    /// Approach speed below which nothing bounces.
    BounceSpeed,
    /// Creep of a contact point under load.
    ContactSlip,
    /// Whether a pyramid inside Coulomb's cone limits friction.
    FrictionPyramid,
    /// Largest touch-down speed of an acceptable gait.
    ImpactLimit,
}

/// Keys of one kind of motor with its gear; every figure is at the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MotorKeys {
    /// Maximum velocity.
    pub speed: Key,
    /// Maximum torque.
    pub torque: Key,
    /// Control parameter P.
    pub gain: Key,
    /// Damping constant.
    pub damping: Key,
    /// Resistance of the winding.
    pub winding: Key,
    /// Torque per current.
    pub torque_per_current: Key,
}

/// Keys of the intra-cube motor.
const INTRA: MotorKeys = MotorKeys {
    speed: Key::IntraSpeed,
    torque: Key::IntraTorque,
    gain: Key::IntraGain,
    damping: Key::IntraDamping,
    winding: Key::IntraWinding,
    torque_per_current: Key::IntraTorquePerCurrent,
};
/// Keys of the inter-cube motor.
const INTER: MotorKeys = MotorKeys {
    speed: Key::InterSpeed,
    torque: Key::InterTorque,
    gain: Key::InterGain,
    damping: Key::InterDamping,
    winding: Key::InterWinding,
    torque_per_current: Key::InterTorquePerCurrent,
};

impl Motor {
    /// Its keys in the model; `None` for a connection, which has no motor.
    #[must_use]
    pub const fn keys(self) -> Option<MotorKeys> {
        match self {
            Motor::Intra => Some(INTRA),
            Motor::Inter => Some(INTER),
            Motor::Connector => None,
        }
    }
}

/// Which motor drives each joint of the meta-module, as `robots/metamodule.toml` has it.
pub const MOTORS: [MotorKeys; 6] = [INTRA, INTER, INTRA, INTRA, INTER, INTRA];

/// What is known about a nominal parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyInfo {
    /// Table of the file.
    pub table: &'static str,
    /// Key in that table; ends in its unit.
    pub key: &'static str,
    /// Row of Table II, 1..22; `None` for parameters that are not in it.
    pub table_ii: Option<u8>,
    /// Smallest accepted value.
    pub min: f64,
    /// Largest accepted value.
    pub max: f64,
    /// Search range of Table II (lower, upper); the accepted range for the others.
    pub search: (f64, f64),
    /// Default: the hand-tuned column of Table II.
    pub hand: f64,
    /// Column "after meta-optimisation" of Table II; the default for the others.
    pub meta_optimised: f64,
    /// Default tolerance, one standard deviation.
    pub tolerance: f64,
    /// Meaning in words.
    pub meaning: &'static str,
    /// Where the default comes from.
    pub source: &'static str,
}

impl KeyInfo {
    /// `table.key` as it stands in messages.
    #[must_use]
    pub fn path(&self) -> String {
        format!("{}.{}", self.table, self.key)
    }

    pub(super) fn hand_tuned(&self) -> Parameter {
        Parameter {
            value: self.hand,
            tolerance: self.tolerance,
            source: self.source.to_owned(),
        }
    }
}

const HAND: &str = "paper, Table II, hand tuned";
const CATALOGUE: &str =
    "Faulhaber catalogue, 2342 012 CR and 2232 012 SR; 4 %: copper that is 10 K warmer";
const TABLE_I: &str = "12 V over the no-load speed of paper, Table I; 3 %: motors of one type";
/// The paper does not say how its packs are wired: in parallel they give 7.4 V, in series 14.8 V.
const SUPPLY: &str = "voltage at which the speeds of paper, Table I hold; tolerance of a charged pack. The 2 x 2 cells in parallel give 7.4 V, in series 14.8 V: state yours";

#[rustfmt::skip]
const INFO: [KeyInfo; Key::COUNT] = [
    KeyInfo { table: "environment", key: "cfm", table_ii: Some(1), min: 0.0, max: 0.01, search: (0.0, 0.001), hand: 1e-05, meta_optimised: 0.00014892, tolerance: 1e-05, meaning: "constraint force mixing of the contacts and motors", source: HAND },
    KeyInfo { table: "environment", key: "erp", table_ii: Some(2), min: 0.0, max: 1.0, search: (0.1, 0.8), hand: 0.2, meta_optimised: 0.3652, tolerance: 0.1, meaning: "error reduction parameter of the contacts", source: HAND },
    KeyInfo { table: "environment", key: "friction", table_ii: Some(3), min: 0.0, max: 10.0, search: (0.1, 5.0), hand: 1.0, meta_optimised: 0.8018, tolerance: 0.2, meaning: "Coulomb friction, body on ground", source: HAND },
    KeyInfo { table: "environment", key: "bounce", table_ii: Some(4), min: 0.0, max: 1.0, search: (0.0, 1.0), hand: 0.5, meta_optimised: 0.804, tolerance: 0.2, meaning: "coefficient of restitution, body on ground", source: HAND },
    KeyInfo { table: "mass", key: "half_1_kg", table_ii: Some(5), min: 0.01, max: 10.0, search: (0.28, 0.37), hand: 0.325, meta_optimised: 0.3038, tolerance: 0.02, meaning: "mass of half-sphere 1, counted from the free end of module A", source: HAND },
    KeyInfo { table: "mass", key: "half_2_kg", table_ii: Some(6), min: 0.01, max: 10.0, search: (0.28, 0.37), hand: 0.325, meta_optimised: 0.3142, tolerance: 0.02, meaning: "mass of half-sphere 2, counted from the free end of module A", source: HAND },
    KeyInfo { table: "mass", key: "half_3_kg", table_ii: Some(7), min: 0.01, max: 10.0, search: (0.28, 0.37), hand: 0.325, meta_optimised: 0.2939, tolerance: 0.02, meaning: "mass of half-sphere 3, counted from the free end of module A", source: HAND },
    KeyInfo { table: "mass", key: "half_4_kg", table_ii: Some(8), min: 0.01, max: 10.0, search: (0.28, 0.37), hand: 0.325, meta_optimised: 0.3308, tolerance: 0.02, meaning: "mass of half-sphere 4, counted from the free end of module A", source: HAND },
    KeyInfo { table: "mass", key: "half_5_kg", table_ii: Some(9), min: 0.01, max: 10.0, search: (0.28, 0.37), hand: 0.325, meta_optimised: 0.3079, tolerance: 0.02, meaning: "mass of half-sphere 5, counted from the free end of module A", source: HAND },
    KeyInfo { table: "mass", key: "half_6_kg", table_ii: Some(10), min: 0.01, max: 10.0, search: (0.28, 0.37), hand: 0.325, meta_optimised: 0.3316, tolerance: 0.02, meaning: "mass of half-sphere 6, counted from the free end of module A", source: HAND },
    KeyInfo { table: "mass", key: "half_7_kg", table_ii: Some(11), min: 0.01, max: 10.0, search: (0.28, 0.37), hand: 0.325, meta_optimised: 0.3438, tolerance: 0.02, meaning: "mass of half-sphere 7, counted from the free end of module A", source: HAND },
    KeyInfo { table: "mass", key: "half_8_kg", table_ii: Some(12), min: 0.01, max: 10.0, search: (0.28, 0.37), hand: 0.325, meta_optimised: 0.3017, tolerance: 0.02, meaning: "mass of half-sphere 8, counted from the free end of module A", source: HAND },
    KeyInfo { table: "intra", key: "max_velocity_rad_s", table_ii: Some(13), min: 0.01, max: 100.0, search: (1.0, 15.0), hand: 2.5, meta_optimised: 6.8721, tolerance: 0.25, meaning: "maximum velocity, intra-cube joints", source: HAND },
    KeyInfo { table: "intra", key: "max_torque_nm", table_ii: Some(14), min: 0.0, max: 100.0, search: (2.5, 15.0), hand: 4.8, meta_optimised: 9.0643, tolerance: 0.48, meaning: "maximum torque, intra-cube joints", source: HAND },
    KeyInfo { table: "intra", key: "gain_per_s", table_ii: Some(15), min: 0.0, max: 100.0, search: (5.0, 15.0), hand: 10.0, meta_optimised: 6.9873, tolerance: 1.0, meaning: "control parameter P, intra-cube joints", source: HAND },
    KeyInfo { table: "intra", key: "damping_nm_s_rad", table_ii: Some(16), min: 0.0, max: 10.0, search: (0.0, 1.0), hand: 0.0, meta_optimised: 0.1172, tolerance: 0.05, meaning: "damping constant, intra-cube joints", source: HAND },
    KeyInfo { table: "intra", key: "winding_ohm", table_ii: None, min: 0.001, max: 1000.0, search: (0.001, 1000.0), hand: 1.9, meta_optimised: 1.9, tolerance: 0.08, meaning: "resistance of the winding, intra-cube joints", source: CATALOGUE },
    KeyInfo { table: "intra", key: "torque_nm_a", table_ii: None, min: 0.001, max: 1000.0, search: (0.001, 1000.0), hand: 4.307, meta_optimised: 4.307, tolerance: 0.13, meaning: "torque at the output per current, intra-cube joints", source: TABLE_I },
    KeyInfo { table: "inter", key: "max_velocity_rad_s", table_ii: Some(17), min: 0.01, max: 100.0, search: (1.0, 15.0), hand: 1.5, meta_optimised: 7.5193, tolerance: 0.15, meaning: "maximum velocity, inter-cube joints", source: HAND },
    KeyInfo { table: "inter", key: "max_torque_nm", table_ii: Some(18), min: 0.0, max: 100.0, search: (2.5, 15.0), hand: 3.2, meta_optimised: 12.208, tolerance: 0.32, meaning: "maximum torque, inter-cube joints", source: HAND },
    KeyInfo { table: "inter", key: "gain_per_s", table_ii: Some(19), min: 0.0, max: 100.0, search: (5.0, 15.0), hand: 10.0, meta_optimised: 12.8652, tolerance: 1.0, meaning: "control parameter P, inter-cube joints", source: HAND },
    KeyInfo { table: "inter", key: "damping_nm_s_rad", table_ii: Some(20), min: 0.0, max: 10.0, search: (0.0, 1.0), hand: 0.0, meta_optimised: 0.5622, tolerance: 0.05, meaning: "damping constant, inter-cube joints", source: HAND },
    KeyInfo { table: "inter", key: "winding_ohm", table_ii: None, min: 0.001, max: 1000.0, search: (0.001, 1000.0), hand: 4.09, meta_optimised: 4.09, tolerance: 0.16, meaning: "resistance of the winding, inter-cube joints", source: CATALOGUE },
    KeyInfo { table: "inter", key: "torque_nm_a", table_ii: None, min: 0.001, max: 1000.0, search: (0.001, 1000.0), hand: 5.906, meta_optimised: 5.906, tolerance: 0.18, meaning: "torque at the output per current, inter-cube joints", source: TABLE_I },
    KeyInfo { table: "supply", key: "voltage_v", table_ii: None, min: 0.1, max: 100.0, search: (0.1, 100.0), hand: 12.0, meta_optimised: 12.0, tolerance: 0.15, meaning: "voltage of the supply without load", source: SUPPLY },
    KeyInfo { table: "camera", key: "height_m", table_ii: Some(21), min: 0.5, max: 10.0, search: (2.1, 2.4), hand: 2.6, meta_optimised: 2.27816, tolerance: 0.05, meaning: "height of the overhead camera", source: HAND },
    KeyInfo { table: "camera", key: "time_shift_s", table_ii: Some(22), min: -5.0, max: 5.0, search: (0.0, 1.2), hand: 0.9, meta_optimised: 0.4241056, tolerance: 0.2, meaning: "time shift between the recorded and the simulated film", source: HAND },
    KeyInfo { table: "robot", key: "twist_rad", table_ii: None, min: -core::f64::consts::TAU, max: core::f64::consts::TAU, search: (-core::f64::consts::TAU, core::f64::consts::TAU), hand: core::f64::consts::FRAC_PI_2, meta_optimised: core::f64::consts::FRAC_PI_2, tolerance: 0.0087, meaning: "rotation of module B against module A about x", source: "EPFL kinematics: perpendicular connection" },
    KeyInfo { table: "robot", key: "cube_m", table_ii: None, min: 0.02, max: 1.0, search: (0.02, 1.0), hand: 0.11, meta_optimised: 0.11, tolerance: 0.0005, meaning: "edge of a cube", source: "EPFL kinematics" },
    KeyInfo { table: "robot", key: "ball_radius_m", table_ii: None, min: 0.01, max: 1.0, search: (0.01, 1.0), hand: 0.062, meta_optimised: 0.062, tolerance: 0.0005, meaning: "radius of the ball a half-sphere is cut from", source: "design parameter: rounder than the cube, larger than a ball of one edge" },
    KeyInfo { table: "simulation", key: "cpg_noise_rad", table_ii: None, min: 0.0, max: 1.0, search: (0.0, 1.0), hand: 0.02, meta_optimised: 0.02, tolerance: 0.02, meaning: "standard deviation of the noise on the CPG outputs", source: "not in the paper; 0.02 rad is about one degree, the repeatability of a geared joint" },
    KeyInfo { table: "simulation", key: "bounce_speed_m_s", table_ii: None, min: 0.0, max: 1.0, search: (0.0, 1.0), hand: 0.01, meta_optimised: 0.01, tolerance: 0.0, meaning: "approach speed below which nothing bounces", source: "Webots default for a contact's bounceVelocity" },
    KeyInfo { table: "simulation", key: "contact_slip_m_s_n", table_ii: None, min: 0.0, max: 0.1, search: (0.0, 0.1), hand: 0.0, meta_optimised: 0.0, tolerance: 0.0, meaning: "creep of a contact point under load", source: "Webots default for a contact's forceDependentSlip" },
    KeyInfo { table: "simulation", key: "friction_pyramid", table_ii: None, min: 0.0, max: 1.0, search: (0.0, 1.0), hand: 0.0, meta_optimised: 0.0, tolerance: 0.0, meaning: "friction limited by Coulomb's round cone (below 0.5) or by a pyramid inside it (from 0.5 on)", source: "Coulomb's law: alike in all directions" },
    KeyInfo { table: "simulation", key: "impact_limit_m_s", table_ii: None, min: 0.0, max: 10.0, search: (0.0, 10.0), hand: 0.5, meta_optimised: 0.5, tolerance: 0.1, meaning: "largest touch-down speed of an acceptable gait", source: "not in the paper; a fall of 13 mm, a fifth of the ball radius" },
];

impl Key {
    /// How many there are.
    pub const COUNT: usize = 35;

    /// Every key, in the order of the file.
    #[rustfmt::skip]
    pub const ALL: [Key; Key::COUNT] = [
        Key::Cfm, Key::Erp, Key::Friction, Key::Bounce, Key::Mass1, Key::Mass2, Key::Mass3,
        Key::Mass4, Key::Mass5, Key::Mass6, Key::Mass7, Key::Mass8, Key::IntraSpeed,
        Key::IntraTorque, Key::IntraGain, Key::IntraDamping, Key::IntraWinding,
        Key::IntraTorquePerCurrent, Key::InterSpeed, Key::InterTorque, Key::InterGain,
        Key::InterDamping, Key::InterWinding, Key::InterTorquePerCurrent, Key::SupplyVoltage,
        Key::CameraHeight, Key::CameraTimeShift, Key::Twist,
        Key::Cube, Key::BallRadius, Key::CpgNoise, Key::BounceSpeed, Key::ContactSlip,
        Key::FrictionPyramid, Key::ImpactLimit,
    ];

    /// The 22 parameters of Table II in its order.
    #[rustfmt::skip]
    pub const TABLE_II: [Key; 22] = [
        Key::Cfm, Key::Erp, Key::Friction, Key::Bounce, Key::Mass1, Key::Mass2, Key::Mass3,
        Key::Mass4, Key::Mass5, Key::Mass6, Key::Mass7, Key::Mass8, Key::IntraSpeed,
        Key::IntraTorque, Key::IntraGain, Key::IntraDamping, Key::InterSpeed, Key::InterTorque,
        Key::InterGain, Key::InterDamping, Key::CameraHeight, Key::CameraTimeShift,
    ];

    /// Masses of the eight half-spheres, from the free end of module A.
    pub const MASSES: [Key; 8] = [
        Key::Mass1,
        Key::Mass2,
        Key::Mass3,
        Key::Mass4,
        Key::Mass5,
        Key::Mass6,
        Key::Mass7,
        Key::Mass8,
    ];

    /// What is known about the parameter.
    #[must_use]
    pub fn info(self) -> &'static KeyInfo {
        &INFO[self as usize]
    }
}
