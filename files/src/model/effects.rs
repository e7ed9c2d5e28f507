//! The effect vocabulary: one name per cause, in the order of the simulated chain.

/// A stage of the simulated chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Joint order, sign, unit, scale, zero.
    Conventions,
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
    /// Name in files and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Stage::Conventions => "conventions",
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
    EffectInfo { effect: Effect::JointOrder, name: "joint_order", stage: Stage::Conventions, per_joint: false, base: false, parameters: &[p("permutation", 0.0, 0.0, 719.0)], meaning: "joints are wired in another order (index of the permutation in lexicographic order)" },
    EffectInfo { effect: Effect::JointSign, name: "joint_sign", stage: Stage::Conventions, per_joint: true, base: false, parameters: &[p("sign", 1.0, -1.0, 1.0)], meaning: "a joint turns the other way (-1)" },
    EffectInfo { effect: Effect::JointScale, name: "joint_scale", stage: Stage::Conventions, per_joint: true, base: false, parameters: &[p("ratio", 1.0, -100.0, 100.0)], meaning: "a joint's angles are scaled" },
    EffectInfo { effect: Effect::JointOffset, name: "joint_offset", stage: Stage::Conventions, per_joint: true, base: false, parameters: &[p("offset_rad", 0.0, -6.4, 6.4)], meaning: "a joint's zero is shifted" },
    EffectInfo { effect: Effect::Latency, name: "latency", stage: Stage::Transport, per_joint: true, base: false, parameters: &[p("delay_s", 0.0, 0.0, 5.0)], meaning: "set-points arrive late" },
    EffectInfo { effect: Effect::Jitter, name: "jitter", stage: Stage::Transport, per_joint: true, base: false, parameters: &[p("sigma_s", 0.0, 0.0, 5.0)], meaning: "set-points arrive at uneven times" },
    EffectInfo { effect: Effect::PacketLoss, name: "packet_loss", stage: Stage::Transport, per_joint: true, base: false, parameters: &[p("probability", 0.0, 0.0, 1.0)], meaning: "set-points get lost" },
    EffectInfo { effect: Effect::Quantisation, name: "quantisation", stage: Stage::Transport, per_joint: true, base: false, parameters: &[p("step_rad", 0.0, 0.0, 1.0)], meaning: "set-points are rounded" },
    EffectInfo { effect: Effect::ClockSkew, name: "clock_skew", stage: Stage::Transport, per_joint: false, base: false, parameters: &[p("ratio", 1.0, 0.5, 2.0)], meaning: "clocks run at different rates" },
    EffectInfo { effect: Effect::LoopGain, name: "loop_gain", stage: Stage::Driver, per_joint: true, base: true, parameters: &[p("ratio", 1.0, 0.0, 100.0)], meaning: "position gain of the joint's controller" },
    EffectInfo { effect: Effect::DampingGain, name: "damping_gain", stage: Stage::Driver, per_joint: true, base: true, parameters: &[p("ratio", 1.0, 0.0, 100.0)], meaning: "damping of the joint's controller" },
    EffectInfo { effect: Effect::Deadband, name: "deadband", stage: Stage::Driver, per_joint: true, base: false, parameters: &[p("half_width_rad", 0.0, 0.0, 1.0)], meaning: "the controller ignores small errors" },
    EffectInfo { effect: Effect::VelocityLimit, name: "velocity_limit", stage: Stage::Driver, per_joint: true, base: true, parameters: &[p("limit_rad_s", f64::INFINITY, 0.0, f64::INFINITY)], meaning: "highest commanded speed" },
    EffectInfo { effect: Effect::FeedbackDelay, name: "feedback_delay", stage: Stage::Driver, per_joint: true, base: false, parameters: &[p("delay_s", 0.0, 0.0, 1.0)], meaning: "the controller sees old angles" },
    EffectInfo { effect: Effect::MotorLag, name: "motor_lag", stage: Stage::Driver, per_joint: true, base: false, parameters: &[p("time_constant_s", 0.0, 0.0, 10.0)], meaning: "the drive follows its command with a lag" },
    EffectInfo { effect: Effect::MotorConstant, name: "motor_constant", stage: Stage::Electrical, per_joint: true, base: true, parameters: &[p("ratio", 1.0, 0.01, 100.0)], meaning: "torque per current" },
    EffectInfo { effect: Effect::WindingResistance, name: "winding_resistance", stage: Stage::Electrical, per_joint: true, base: true, parameters: &[p("ratio", 1.0, 0.01, 100.0)], meaning: "resistance of the winding" },
    EffectInfo { effect: Effect::CurrentLimit, name: "current_limit", stage: Stage::Electrical, per_joint: true, base: false, parameters: &[p("limit_a", f64::INFINITY, 0.0, f64::INFINITY)], meaning: "current is limited" },
    EffectInfo { effect: Effect::TorqueLimit, name: "torque_limit", stage: Stage::Electrical, per_joint: true, base: true, parameters: &[p("limit_nm", f64::INFINITY, 0.0, f64::INFINITY)], meaning: "torque is limited" },
    EffectInfo { effect: Effect::ThermalDerating, name: "thermal_derating", stage: Stage::Electrical, per_joint: true, base: false, parameters: &[p("time_constant_s", f64::INFINITY, 0.0, f64::INFINITY), p("fraction", 0.0, 0.0, 1.0)], meaning: "torque falls as the motor warms" },
    EffectInfo { effect: Effect::SupplyVoltage, name: "supply_voltage", stage: Stage::Supply, per_joint: false, base: true, parameters: &[p("value_v", 7.4, 0.0, 100.0)], meaning: "bus voltage without load" },
    EffectInfo { effect: Effect::SupplySag, name: "supply_sag", stage: Stage::Supply, per_joint: false, base: false, parameters: &[p("resistance_ohm", 0.0, 0.0, 100.0)], meaning: "bus voltage falls with current" },
    EffectInfo { effect: Effect::CoulombFriction, name: "coulomb_friction", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("torque_nm", 0.0, 0.0, 100.0)], meaning: "constant friction against motion" },
    EffectInfo { effect: Effect::ViscousFriction, name: "viscous_friction", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("nm_s_rad", 0.0, 0.0, 100.0)], meaning: "friction proportional to speed" },
    EffectInfo { effect: Effect::StribeckFriction, name: "stribeck_friction", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("static_nm", 0.0, 0.0, 100.0), p("velocity_rad_s", 0.05, 1e-06, 100.0)], meaning: "extra friction at low speed" },
    EffectInfo { effect: Effect::LoadDependentFriction, name: "load_dependent_friction", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("fraction", 0.0, 0.0, 1.0)], meaning: "friction proportional to the transmitted torque" },
    EffectInfo { effect: Effect::AsymmetricFriction, name: "asymmetric_friction", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("difference_nm", 0.0, -100.0, 100.0), p("difference_nm_s_rad", 0.0, -100.0, 100.0)], meaning: "friction differs between the directions" },
    EffectInfo { effect: Effect::QuadraticFriction, name: "quadratic_friction", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("nm_s2_rad2", 0.0, 0.0, 100.0)], meaning: "friction proportional to speed squared" },
    EffectInfo { effect: Effect::TorqueRipple, name: "torque_ripple", stage: Stage::Drivetrain, per_joint: true, base: false, parameters: &[p("amplitude_nm", 0.0, -100.0, 100.0), p("periods", 1.0, 0.0, 100000.0), p("phase_rad", 0.0, -6.4, 6.4)], meaning: "torque periodic in the joint angle" },
    EffectInfo { effect: Effect::Inertia, name: "inertia", stage: Stage::Drivetrain, per_joint: true, base: true, parameters: &[p("ratio", 1.0, 0.01, 100.0)], meaning: "inertia seen by the joint" },
    EffectInfo { effect: Effect::GravityLoad, name: "gravity_load", stage: Stage::Drivetrain, per_joint: true, base: true, parameters: &[p("ratio", 1.0, -100.0, 100.0)], meaning: "gravity torque seen by the joint" },
    EffectInfo { effect: Effect::Backlash, name: "backlash", stage: Stage::Transmission, per_joint: true, base: false, parameters: &[p("half_width_rad", 0.0, 0.0, 1.0)], meaning: "play between encoder and link" },
    EffectInfo { effect: Effect::Compliance, name: "compliance", stage: Stage::Transmission, per_joint: true, base: false, parameters: &[p("stiffness_nm_rad", f64::INFINITY, 0.01, f64::INFINITY)], meaning: "spring between encoder and link" },
    EffectInfo { effect: Effect::ConnectorCompliance, name: "connector_compliance", stage: Stage::Transmission, per_joint: false, base: false, parameters: &[p("stiffness_nm_rad", f64::INFINITY, 0.01, f64::INFINITY)], meaning: "the connection of the modules bends" },
    EffectInfo { effect: Effect::ConnectorPlay, name: "connector_play", stage: Stage::Transmission, per_joint: false, base: false, parameters: &[p("half_width_rad", 0.0, 0.0, 1.0)], meaning: "the connection of the modules is loose" },
    EffectInfo { effect: Effect::GroundFriction, name: "ground_friction", stage: Stage::Body, per_joint: false, base: true, parameters: &[p("coefficient", 1.0, 0.0, 10.0)], meaning: "friction of the ground" },
    EffectInfo { effect: Effect::FrictionAnisotropy, name: "friction_anisotropy", stage: Stage::Body, per_joint: false, base: false, parameters: &[p("ratio", 1.0, 0.01, 100.0), p("direction_rad", 0.0, -6.4, 6.4)], meaning: "friction differs between two directions" },
    EffectInfo { effect: Effect::TorsionalFriction, name: "torsional_friction", stage: Stage::Body, per_joint: false, base: false, parameters: &[p("coefficient_m", 0.0, 0.0, 1.0)], meaning: "a contact resists turning about its normal" },
    EffectInfo { effect: Effect::Restitution, name: "restitution", stage: Stage::Body, per_joint: false, base: true, parameters: &[p("coefficient", 0.5, 0.0, 1.0)], meaning: "bounce of the ground" },
    EffectInfo { effect: Effect::GroundSlope, name: "ground_slope", stage: Stage::Body, per_joint: false, base: false, parameters: &[p("roll_rad", 0.0, -1.5, 1.5), p("pitch_rad", 0.0, -1.5, 1.5)], meaning: "the ground is tilted" },
    EffectInfo { effect: Effect::GroundCompliance, name: "ground_compliance", stage: Stage::Body, per_joint: false, base: false, parameters: &[p("stiffness_n_m", f64::INFINITY, 1.0, f64::INFINITY), p("damping_n_s_m", 0.0, 0.0, 1000000.0)], meaning: "the ground is soft" },
    EffectInfo { effect: Effect::Mass, name: "mass", stage: Stage::Body, per_joint: false, base: true, parameters: &[p("ratio", 1.0, 0.01, 100.0)], meaning: "mass of the robot" },
    EffectInfo { effect: Effect::ComOffset, name: "com_offset", stage: Stage::Body, per_joint: false, base: false, parameters: &[p("x_m", 0.0, -1.0, 1.0), p("y_m", 0.0, -1.0, 1.0), p("z_m", 0.0, -1.0, 1.0)], meaning: "centre of mass of body 3 is shifted" },
    EffectInfo { effect: Effect::CameraHeight, name: "camera_height", stage: Stage::Camera, per_joint: false, base: true, parameters: &[p("value_m", 2.6, 0.1, 100.0)], meaning: "height of the camera" },
    EffectInfo { effect: Effect::CameraOffset, name: "camera_offset", stage: Stage::Camera, per_joint: false, base: false, parameters: &[p("x_m", 0.0, -10.0, 10.0), p("y_m", 0.0, -10.0, 10.0)], meaning: "position of the camera" },
    EffectInfo { effect: Effect::CameraYaw, name: "camera_yaw", stage: Stage::Camera, per_joint: false, base: false, parameters: &[p("angle_rad", 0.0, -6.4, 6.4)], meaning: "direction of the camera" },
    EffectInfo { effect: Effect::CameraTimeShift, name: "camera_time_shift", stage: Stage::Camera, per_joint: false, base: false, parameters: &[p("shift_s", 0.0, -60.0, 60.0)], meaning: "film and recording have different clocks" },
    EffectInfo { effect: Effect::FrameDrop, name: "frame_drop", stage: Stage::Camera, per_joint: false, base: false, parameters: &[p("probability", 0.0, 0.0, 1.0)], meaning: "frames are missing" },
];

impl Effect {
    /// How many there are.
    pub const COUNT: usize = 48;

    /// Every effect, in the order of the chain.
    pub fn all() -> impl Iterator<Item = Effect> {
        INFO.iter().map(|info| info.effect)
    }

    /// What is known about the effect.
    #[must_use]
    pub fn info(self) -> &'static EffectInfo {
        &INFO[self as usize]
    }

    /// The effect of that name.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Effect> {
        INFO.iter()
            .find(|info| info.name == name)
            .map(|info| info.effect)
    }
}
