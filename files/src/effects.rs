//! The registry of effects: one row a cause, in the order of the simulated chain.
//!
//! File keys, JSON Schema, reference page, reports and the diagnosis read this table; names and keys stand nowhere else but in the
//! generator of test data, which keeps its own. `docs/how-to/add-an-effect.md` tells how a row is added.

mod channel;
mod drive;
mod mechanics;
mod page;
mod prior;
mod signals;
mod world;

pub use channel::Channel;
pub use page::page;
pub use prior::{JointScales, Prior, Resolution, Scale};

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
    /// All of them, in the order of the chain.
    pub const ALL: [Stage; 10] = [
        Stage::Conventions,
        Stage::Cpg,
        Stage::Transport,
        Stage::Driver,
        Stage::Electrical,
        Stage::Supply,
        Stage::Drivetrain,
        Stage::Transmission,
        Stage::Body,
        Stage::Camera,
    ];

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

/// What an effect has one instance of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// Every joint its own; several joints may share one.
    Joint,
    /// The robot as a whole.
    Robot,
}

/// What an effect says of the nominal model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The model lacks it.
    Structural,
    /// The model holds the parameter; the effect is another value.
    Parametric,
}

/// What an effect can be found on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plant {
    /// One joint on a stand.
    BenchJoint,
    /// A joint of a robot.
    RobotJoint,
    /// The robot's body on the ground.
    Body,
    /// The overhead camera.
    Camera,
}

impl Plant {
    const JOINT: [Plant; 2] = [Plant::BenchJoint, Plant::RobotJoint];
    const ROBOT_JOINT: [Plant; 1] = [Plant::RobotJoint];
    const BODY: [Plant; 1] = [Plant::Body];
    const CAMERA: [Plant; 1] = [Plant::Camera];

    /// Name for people.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Plant::BenchJoint => "bench joint",
            Plant::RobotJoint => "robot joint",
            Plant::Body => "body",
            Plant::Camera => "camera",
        }
    }
}

/// One parameter of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectParam {
    /// Key in the file; ends in its unit, where it has one.
    pub key: &'static str,
    /// Unit; `1` where there is none. A linear joint has m, m/s and N in place of rad, rad/s and N m.
    pub unit: &'static str,
    /// Value that means "off". Where "off" is the nominal model's own value, the shipped one.
    pub neutral: f64,
    /// Smallest accepted value.
    pub min: f64,
    /// Largest accepted value.
    pub max: f64,
    /// What prior and resolution are shares of.
    pub scale: Scale,
    /// What is believed about the size of an effect that is there.
    pub prior: Prior,
    /// Where the prior comes from.
    pub prior_source: &'static str,
    /// Smallest size worth a name; `None` for what only shapes an effect whose size is another parameter.
    pub resolution: Option<Resolution>,
}

/// One row of the registry: what is known about an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectInfo {
    /// The effect.
    pub effect: Effect,
    /// Name in files and reports.
    pub name: &'static str,
    /// Stage of the chain it belongs to.
    pub stage: Stage,
    /// What has one.
    pub scope: Scope,
    /// Whether the nominal model already holds the parameter.
    pub kind: Kind,
    /// What it can be found on.
    pub plants: &'static [Plant],
    /// The effect as a noun, for lists and headlines: "dry friction in the gear".
    pub plain: &'static str,
    /// A sentence with the parameters' keys and, where every joint has one, `joints` in braces.
    pub sentence: &'static str,
    /// The law as an equation in plain text.
    pub law: &'static str,
    /// Signals that show it, most telling first.
    pub signals: &'static [Channel],
    /// Effects that look like it where signals are missing.
    pub confounded: &'static [Effect],
    /// Its parameters, in file order.
    pub parameters: &'static [EffectParam],
}

impl EffectInfo {
    /// Whether every joint has its own.
    #[must_use]
    pub fn per_joint(&self) -> bool {
        self.scope == Scope::Joint
    }
}

/// The registry, in the order of [`Effect`].
static REGISTRY: [EffectInfo; Effect::COUNT] = {
    let mut all = [signals::ROWS[0]; Effect::COUNT];
    let parts: [&[EffectInfo]; 4] = [&signals::ROWS, &drive::ROWS, &mechanics::ROWS, &world::ROWS];
    let (mut part, mut row, mut k) = (0, 0, 0);
    while part < parts.len() {
        if row == parts[part].len() {
            (part, row) = (part + 1, 0);
            continue;
        }
        all[k] = parts[part][row];
        (row, k) = (row + 1, k + 1);
    }
    assert!(k == Effect::COUNT, "one row an effect");
    all
};

impl Effect {
    /// How many there are.
    pub const COUNT: usize = 48;

    /// Every effect, in the order of the chain.
    pub const ALL: &'static [Effect] = &[
        Effect::JointOrder,
        Effect::JointSign,
        Effect::JointScale,
        Effect::JointOffset,
        Effect::Latency,
        Effect::Jitter,
        Effect::PacketLoss,
        Effect::Quantisation,
        Effect::ClockSkew,
        Effect::LoopGain,
        Effect::DampingGain,
        Effect::Deadband,
        Effect::VelocityLimit,
        Effect::FeedbackDelay,
        Effect::MotorLag,
        Effect::MotorConstant,
        Effect::WindingResistance,
        Effect::CurrentLimit,
        Effect::TorqueLimit,
        Effect::ThermalDerating,
        Effect::SupplyVoltage,
        Effect::SupplySag,
        Effect::CoulombFriction,
        Effect::ViscousFriction,
        Effect::StribeckFriction,
        Effect::LoadDependentFriction,
        Effect::AsymmetricFriction,
        Effect::QuadraticFriction,
        Effect::TorqueRipple,
        Effect::Inertia,
        Effect::GravityLoad,
        Effect::Backlash,
        Effect::Compliance,
        Effect::ConnectorCompliance,
        Effect::ConnectorPlay,
        Effect::GroundFriction,
        Effect::FrictionAnisotropy,
        Effect::TorsionalFriction,
        Effect::Restitution,
        Effect::GroundSlope,
        Effect::GroundCompliance,
        Effect::Mass,
        Effect::ComOffset,
        Effect::CameraHeight,
        Effect::CameraOffset,
        Effect::CameraYaw,
        Effect::CameraTimeShift,
        Effect::FrameDrop,
    ];

    /// What is known about the effect.
    #[must_use]
    pub fn info(self) -> &'static EffectInfo {
        &REGISTRY[self as usize]
    }

    /// Name in files and reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.info().name
    }

    /// The effect of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Effect> {
        REGISTRY
            .iter()
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
        self.info().kind == Kind::Parametric
    }

    /// Its parameters, in file order.
    #[must_use]
    pub fn parameters(self) -> &'static [EffectParam] {
        self.info().parameters
    }

    /// The effect as a noun, for lists and headlines.
    #[must_use]
    pub fn plain(self) -> &'static str {
        self.info().plain
    }
}

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
