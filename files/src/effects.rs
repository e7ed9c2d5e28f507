//! The registry of effects: one row a cause, in the order of the simulated chain.

use serde::{Serialize, Serializer};

/// A stage of the simulated chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Joint order, sign, unit, scale, zero.
    Conventions,
    /// Set-points from the gait.
    Cpg,
    /// Set-point sent to set-point applied.
    Transport,
    /// Set-point, encoder and speed to duty.
    Driver,
    /// Duty, voltage, speed and temperature to current.
    Electrical,
    /// Sum of the currents to bus voltage.
    Supply,
    /// Current and load to encoder angle.
    Drivetrain,
    /// Encoder angle to link angle.
    Transmission,
    /// Link angles to base motion, contact and load.
    Body,
    /// Pose to silhouettes.
    Camera,
}

impl Stage {
    /// Stages that a joint has.
    pub const JOINT: [Stage; 7] = [
        Stage::Conventions,
        Stage::Transport,
        Stage::Driver,
        Stage::Electrical,
        Stage::Supply,
        Stage::Drivetrain,
        Stage::Transmission,
    ];

    /// Name in files and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Stage::Conventions => "conventions",
            Stage::Cpg => "cpg",
            Stage::Transport => "transport",
            Stage::Driver => "driver",
            Stage::Electrical => "electrical",
            Stage::Supply => "supply",
            Stage::Drivetrain => "drivetrain",
            Stage::Transmission => "transmission",
            Stage::Body => "body",
            Stage::Camera => "camera",
        }
    }
}

/// Names one effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Effect {
    /// Joints are wired in another order (index of the permutation in lexicographic order).
    JointOrder,
    /// A joint turns the other way (-1).
    JointSign,
    /// A joint's angles are scaled.
    JointScale,
    /// A joint's zero is shifted.
    JointOffset,
    /// Set-points arrive late.
    Latency,
    /// Set-points arrive at uneven times.
    Jitter,
    /// Set-points get lost.
    PacketLoss,
    /// Set-points are rounded.
    Quantisation,
    /// Clocks run at different rates.
    ClockSkew,
    /// Position gain of the joint's controller.
    LoopGain,
    /// Damping of the joint's controller.
    DampingGain,
    /// The controller ignores small errors.
    Deadband,
    /// Highest commanded speed.
    VelocityLimit,
    /// The controller sees old angles.
    FeedbackDelay,
    /// The drive follows its command with a lag.
    MotorLag,
    /// Torque per current.
    MotorConstant,
    /// Resistance of the winding.
    WindingResistance,
    /// Current is limited.
    CurrentLimit,
    /// Torque is limited.
    TorqueLimit,
    /// Torque falls as the motor warms.
    ThermalDerating,
    /// Bus voltage without load.
    SupplyVoltage,
    /// Bus voltage falls with current.
    SupplySag,
    /// Constant friction against motion.
    CoulombFriction,
    /// Friction proportional to speed.
    ViscousFriction,
    /// Extra friction at low speed.
    StribeckFriction,
    /// Friction proportional to the transmitted torque.
    LoadDependentFriction,
    /// Friction differs between the directions.
    AsymmetricFriction,
    /// Friction proportional to speed squared.
    QuadraticFriction,
    /// Torque periodic in the joint angle.
    TorqueRipple,
    /// Inertia seen by the joint.
    Inertia,
    /// Gravity torque seen by the joint.
    GravityLoad,
    /// Play between encoder and link.
    Backlash,
    /// Spring between encoder and link.
    Compliance,
    /// The connection of the modules bends.
    ConnectorCompliance,
    /// The connection of the modules is loose.
    ConnectorPlay,
    /// Friction of the ground.
    GroundFriction,
    /// Friction differs between two directions.
    FrictionAnisotropy,
    /// A contact resists turning about its normal.
    TorsionalFriction,
    /// Bounce of the ground.
    Restitution,
    /// The ground is tilted.
    GroundSlope,
    /// The ground is soft.
    GroundCompliance,
    /// Mass of the robot.
    Mass,
    /// Centre of mass of body 3 is shifted.
    ComOffset,
    /// Height of the camera.
    CameraHeight,
    /// Position of the camera.
    CameraOffset,
    /// Direction of the camera.
    CameraYaw,
    /// Film and recording have different clocks.
    CameraTimeShift,
    /// Frames are missing.
    FrameDrop,
}

/// One parameter of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectParam {
    /// Key in the file; ends in its unit.
    pub key: &'static str,
    /// Value that means "off". Where "off" is the nominal model's own value, the hand-tuned one.
    pub neutral: f64,
    /// Smallest accepted value.
    pub min: f64,
    /// Largest accepted value.
    pub max: f64,
}

/// What is known about an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectInfo {
    /// The effect.
    pub effect: Effect,
    /// Name in files and reports.
    pub name: &'static str,
    /// Stage of the chain it belongs to.
    pub stage: Stage,
    /// Whether every joint has its own.
    pub per_joint: bool,
    /// Whether the nominal model already holds the parameter, so that a change of it is parametric, not structural.
    pub base: bool,
    /// Its parameters, in file order.
    pub parameters: &'static [EffectParam],
    /// Meaning in words.
    pub meaning: &'static str,
    /// One plain clause for people.
    pub plain: &'static str,
}

const fn p(key: &'static str, neutral: f64, min: f64, max: f64) -> EffectParam {
    EffectParam {
        key,
        neutral,
        min,
        max,
    }
}

#[rustfmt::skip]
const INFO: [EffectInfo; Effect::COUNT] = [
    EffectInfo { effect: Effect::JointOrder, name: "joint_order", stage: Stage::Conventions, per_joint: false, base: false, parameters: &[p("permutation", 0.0, 0.0, 719.0)], meaning: "joints are wired in another order (index of the permutation in lexicographic order)", plain: "joints are wired in another order" },
    EffectInfo { effect: Effect::JointSign, name: "joint_sign", stage: Stage::Conventions, per_joint: true, base: false, parameters: &[p("sign", 1.0, -1.0, 1.0)], meaning: "a joint turns the other way (-1)", plain: "the joint counts in the other direction" },
    EffectInfo { effect: Effect::JointScale, name: "joint_scale", stage: Stage::Conventions, per_joint: true, base: false, parameters: &[p("ratio", 1.0, -100.0, 100.0)], meaning: "a joint's angles are scaled", plain: "angles are scaled (unit or gear ratio)" },
    EffectInfo { effect: Effect::JointOffset, name: "joint_offset", stage: Stage::Conventions, per_joint: true, base: false, parameters: &[p("offset_rad", 0.0, -6.4, 6.4)], meaning: "a joint's zero is shifted", plain: "the joint's zero is off" },
    EffectInfo { effect: Effect::Latency, name: "latency", stage: Stage::Transport, per_joint: true, base: false, parameters: &[p("delay_s", 0.0, 0.0, 5.0)], meaning: "set-points arrive late", plain: "set-points arrive late" },
    EffectInfo { effect: Effect::Jitter, name: "jitter", stage: Stage::Transport, per_joint: true, base: false, parameters: &[p("sigma_s", 0.0, 0.0, 5.0)], meaning: "set-points arrive at uneven times", plain: "set-points arrive at irregular times" },
    EffectInfo { effect: Effect::PacketLoss, name: "packet_loss", stage: Stage::Transport, per_joint: true, base: false, parameters: &[p("probability", 0.0, 0.0, 1.0)], meaning: "set-points get lost", plain: "set-points or samples get lost" },
    EffectInfo { effect: Effect::Quantisation, name: "quantisation", stage: Stage::Transport, per_joint: true, base: false, parameters: &[p("step_rad", 0.0, 0.0, 1.0)], meaning: "set-points are rounded", plain: "set-points are coarse" },
    EffectInfo { effect: Effect::ClockSkew, name: "clock_skew", stage: Stage::Transport, per_joint: false, base: false, parameters: &[p("ratio", 1.0, 0.5, 2.0)], meaning: "clocks run at different rates", plain: "the robot's clock runs at another rate" },
    EffectInfo { effect: Effect::LoopGain, name: "loop_gain", stage: Stage::Driver, per_joint: true, base: true, parameters: &[p("ratio", 1.0, 0.0, 100.0)], meaning: "position gain of the joint's controller", plain: "the controller's position gain differs" },
    EffectInfo { effect: Effect::DampingGain, name: "damping_gain", stage: Stage::Driver, per_joint: true, base: true, parameters: &[p("ratio", 1.0, 0.0, 100.0)], meaning: "damping of the joint's controller", plain: "the controller's velocity gain differs" },
    EffectInfo { effect: Effect::Deadband, name: "deadband", stage: Stage::Driver, per_joint: true, base: false, parameters: &[p("half_width_rad", 0.0, 0.0, 1.0)], meaning: "the controller ignores small errors", plain: "the controller ignores small errors" },
    EffectInfo { effect: Effect::VelocityLimit, name: "velocity_limit", stage: Stage::Driver, per_joint: true, base: true, parameters: &[p("limit_rad_s", f64::INFINITY, 0.0, f64::INFINITY)], meaning: "highest commanded speed", plain: "the driver limits the speed" },
    EffectInfo { effect: Effect::FeedbackDelay, name: "feedback_delay", stage: Stage::Driver, per_joint: true, base: false, parameters: &[p("delay_s", 0.0, 0.0, 1.0)], meaning: "the controller sees old angles", plain: "the controller sees the encoder late" },
    EffectInfo { effect: Effect::MotorLag, name: "motor_lag", stage: Stage::Driver, per_joint: true, base: false, parameters: &[p("time_constant_s", 0.0, 0.0, 10.0)], meaning: "the drive follows its command with a lag", plain: "the motor follows the controller with a lag" },
    EffectInfo { effect: Effect::MotorConstant, name: "motor_constant", stage: Stage::Electrical, per_joint: true, base: true, parameters: &[p("ratio", 1.0, 0.01, 100.0)], meaning: "torque per current", plain: "the motor constant differs" },
    EffectInfo { effect: Effect::WindingResistance, name: "winding_resistance", stage: Stage::Electrical, per_joint: true, base: true, parameters: &[p("ratio", 1.0, 0.01, 100.0)], meaning: "resistance of the winding", plain: "the winding resistance differs" },
    EffectInfo { effect: Effect::CurrentLimit, name: "current_limit", stage: Stage::Electrical, per_joint: true, base: false, parameters: &[p("limit_a", f64::INFINITY, 0.0, f64::INFINITY)], meaning: "current is limited", plain: "the current is limited" },
    EffectInfo { effect: Effect::TorqueLimit, name: "torque_limit", stage: Stage::Electrical, per_joint: true, base: true, parameters: &[p("limit_nm", f64::INFINITY, 0.0, f64::INFINITY)], meaning: "torque is limited", plain: "the torque is limited" },
    EffectInfo { effect: Effect::ThermalDerating, name: "thermal_derating", stage: Stage::Electrical, per_joint: true, base: false, parameters: &[p("time_constant_s", f64::INFINITY, 0.0, f64::INFINITY), p("fraction", 0.0, 0.0, 1.0)], meaning: "torque falls as the motor warms", plain: "the motor weakens as it warms up" },
    EffectInfo { effect: Effect::SupplyVoltage, name: "supply_voltage", stage: Stage::Supply, per_joint: false, base: true, parameters: &[p("value_v", 7.4, 0.0, 100.0)], meaning: "bus voltage without load", plain: "the supply voltage differs" },
    EffectInfo { effect: Effect::SupplySag, name: "supply_sag", stage: Stage::Supply, per_joint: false, base: false, parameters: &[p("resistance_ohm", 0.0, 0.0, 100.0)], meaning: "bus voltage falls with current", plain: "the supply sags under load" },
    EffectInfo { effect: Effect::CoulombFriction, name: "coulomb_friction", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("torque_nm", 0.0, 0.0, 100.0)], meaning: "constant friction against motion", plain: "dry friction in the gear" },
    EffectInfo { effect: Effect::ViscousFriction, name: "viscous_friction", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("nm_s_rad", 0.0, 0.0, 100.0)], meaning: "friction proportional to speed", plain: "friction that grows with speed" },
    EffectInfo { effect: Effect::StribeckFriction, name: "stribeck_friction", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("static_nm", 0.0, 0.0, 100.0), p("velocity_rad_s", 0.05, 1e-06, 100.0)], meaning: "extra friction at low speed", plain: "extra friction near standstill" },
    EffectInfo { effect: Effect::LoadDependentFriction, name: "load_dependent_friction", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("fraction", 0.0, 0.0, 1.0)], meaning: "friction proportional to the transmitted torque", plain: "friction that grows with the load" },
    EffectInfo { effect: Effect::AsymmetricFriction, name: "asymmetric_friction", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("difference_nm", 0.0, -100.0, 100.0), p("difference_nm_s_rad", 0.0, -100.0, 100.0)], meaning: "friction differs between the directions", plain: "friction that differs by direction" },
    EffectInfo { effect: Effect::QuadraticFriction, name: "quadratic_friction", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("nm_s2_rad2", 0.0, 0.0, 100.0)], meaning: "friction proportional to speed squared", plain: "friction that grows with speed squared" },
    EffectInfo { effect: Effect::TorqueRipple, name: "torque_ripple", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("amplitude_nm", 0.0, -100.0, 100.0), p("periods", 1.0, 0.0, 100000.0), p("phase_rad", 0.0, -6.4, 6.4)], meaning: "torque periodic in the joint angle", plain: "torque that varies with the angle" },
    EffectInfo { effect: Effect::Inertia, name: "inertia", stage: Stage::Drivetrain, per_joint: true, base: true, parameters: &[p("ratio", 1.0, 0.01, 100.0)], meaning: "inertia seen by the joint", plain: "the inertia differs" },
    EffectInfo { effect: Effect::GravityLoad, name: "gravity_load", stage: Stage::Drivetrain, per_joint: true, base: true, parameters: &[p("ratio", 1.0, -100.0, 100.0)], meaning: "gravity torque seen by the joint", plain: "the gravity load differs" },
    EffectInfo { effect: Effect::Backlash, name: "backlash", stage: Stage::Transmission, per_joint: true, base: false, parameters: &[p("half_width_rad", 0.0, 0.0, 1.0)], meaning: "play between encoder and link", plain: "play in the gear" },
    EffectInfo { effect: Effect::Compliance, name: "compliance", stage: Stage::Transmission, per_joint: true, base: false, parameters: &[p("stiffness_nm_rad", f64::INFINITY, 0.01, f64::INFINITY)], meaning: "spring between encoder and link", plain: "the gear twists under load" },
    EffectInfo { effect: Effect::ConnectorCompliance, name: "connector_compliance", stage: Stage::Transmission, per_joint: false, base: false, parameters: &[p("stiffness_nm_rad", f64::INFINITY, 0.01, f64::INFINITY)], meaning: "the connection of the modules bends", plain: "the connector twists under load" },
    EffectInfo { effect: Effect::ConnectorPlay, name: "connector_play", stage: Stage::Transmission, per_joint: false, base: false, parameters: &[p("half_width_rad", 0.0, 0.0, 1.0)], meaning: "the connection of the modules is loose", plain: "play in the connector" },
    EffectInfo { effect: Effect::GroundFriction, name: "ground_friction", stage: Stage::Body, per_joint: false, base: true, parameters: &[p("coefficient", 1.0, 0.0, 10.0)], meaning: "friction of the ground", plain: "the ground is more or less slippery" },
    EffectInfo { effect: Effect::FrictionAnisotropy, name: "friction_anisotropy", stage: Stage::Body, per_joint: false, base: false, parameters: &[p("ratio", 1.0, 0.01, 100.0), p("direction_rad", 0.0, -6.4, 6.4)], meaning: "friction differs between two directions", plain: "the ground is slippery in one direction" },
    EffectInfo { effect: Effect::TorsionalFriction, name: "torsional_friction", stage: Stage::Body, per_joint: false, base: false, parameters: &[p("coefficient_m", 0.0, 0.0, 1.0)], meaning: "a contact resists turning about its normal", plain: "turning on the spot is braked" },
    EffectInfo { effect: Effect::Restitution, name: "restitution", stage: Stage::Body, per_joint: false, base: true, parameters: &[p("coefficient", 0.5, 0.0, 1.0)], meaning: "bounce of the ground", plain: "impacts bounce" },
    EffectInfo { effect: Effect::GroundSlope, name: "ground_slope", stage: Stage::Body, per_joint: false, base: false, parameters: &[p("roll_rad", 0.0, -1.5, 1.5), p("pitch_rad", 0.0, -1.5, 1.5)], meaning: "the ground is tilted", plain: "the ground is not level" },
    EffectInfo { effect: Effect::GroundCompliance, name: "ground_compliance", stage: Stage::Body, per_joint: false, base: false, parameters: &[p("stiffness_n_m", f64::INFINITY, 1.0, f64::INFINITY), p("damping_n_s_m", 0.0, 0.0, 1000000.0)], meaning: "the ground is soft", plain: "the ground is soft" },
    EffectInfo { effect: Effect::Mass, name: "mass", stage: Stage::Body, per_joint: false, base: true, parameters: &[p("ratio", 1.0, 0.01, 100.0)], meaning: "mass of the robot", plain: "the mass differs" },
    EffectInfo { effect: Effect::ComOffset, name: "com_offset", stage: Stage::Body, per_joint: false, base: false, parameters: &[p("x_m", 0.0, -1.0, 1.0), p("y_m", 0.0, -1.0, 1.0), p("z_m", 0.0, -1.0, 1.0)], meaning: "centre of mass of body 3 is shifted", plain: "the centre of mass is off" },
    EffectInfo { effect: Effect::CameraHeight, name: "camera_height", stage: Stage::Camera, per_joint: false, base: true, parameters: &[p("value_m", 2.6, 0.1, 100.0)], meaning: "height of the camera", plain: "the camera hangs at another height" },
    EffectInfo { effect: Effect::CameraOffset, name: "camera_offset", stage: Stage::Camera, per_joint: false, base: false, parameters: &[p("x_m", 0.0, -10.0, 10.0), p("y_m", 0.0, -10.0, 10.0)], meaning: "position of the camera", plain: "the camera is shifted" },
    EffectInfo { effect: Effect::CameraYaw, name: "camera_yaw", stage: Stage::Camera, per_joint: false, base: false, parameters: &[p("angle_rad", 0.0, -6.4, 6.4)], meaning: "direction of the camera", plain: "the camera is turned" },
    EffectInfo { effect: Effect::CameraTimeShift, name: "camera_time_shift", stage: Stage::Camera, per_joint: false, base: false, parameters: &[p("shift_s", 0.0, -60.0, 60.0)], meaning: "film and recording have different clocks", plain: "the camera's clock is off" },
    EffectInfo { effect: Effect::FrameDrop, name: "frame_drop", stage: Stage::Camera, per_joint: false, base: false, parameters: &[p("probability", 0.0, 0.0, 1.0)], meaning: "frames are missing", plain: "frames are missing" },
];

impl Effect {
    /// How many there are.
    pub const COUNT: usize = 48;

    /// Every effect, in the order of the chain.
    pub const ALL: &'static [Effect] = &ALL;

    /// What is known about the effect.
    #[must_use]
    pub fn info(self) -> &'static EffectInfo {
        &INFO[self as usize]
    }

    /// Name in files and reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.info().name
    }

    /// The effect of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Effect> {
        INFO.iter()
            .find(|info| info.name == name)
            .map(|info| info.effect)
    }

    /// Stage it acts in.
    #[must_use]
    pub fn stage(self) -> Stage {
        self.info().stage
    }

    /// Whether the nominal model already holds its parameter: a change is a parametric gap.
    #[must_use]
    pub fn is_base(self) -> bool {
        self.info().base
    }

    /// Its parameters, in file order.
    #[must_use]
    pub fn parameters(self) -> &'static [EffectParam] {
        self.info().parameters
    }

    /// One plain clause for people.
    #[must_use]
    pub fn plain(self) -> &'static str {
        self.info().plain
    }
}

/// The effects of [`INFO`], in its order.
const ALL: [Effect; Effect::COUNT] = {
    let mut all = [Effect::JointOrder; Effect::COUNT];
    let mut k = 0;
    while k < Effect::COUNT {
        all[k] = INFO[k].effect;
        k += 1;
    }
    all
};

impl Serialize for Stage {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl Serialize for Effect {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}
