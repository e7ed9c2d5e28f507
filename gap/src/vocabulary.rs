//! Names of stages and effects: the words used in files, code and reports.

use serde::Serialize;

/// A stage of the simulated chain, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Joint order, sign, unit, scale, zero.
    Conventions,
    /// Set-points from the gait.
    Cpg,
    /// Set-point sent -> applied.
    Transport,
    /// Set-point, encoder, speed -> duty.
    Driver,
    /// Duty, voltage, speed -> current.
    Electrical,
    /// Currents -> bus voltage.
    Supply,
    /// Current, load -> encoder angle.
    Drivetrain,
    /// Encoder angle -> link angle.
    Transmission,
    /// Link angles -> base motion.
    Body,
    /// Pose -> silhouettes.
    Camera,
}

impl Stage {
    /// Stages that a joint has.
    pub const JOINT: [Self; 7] = [
        Self::Conventions,
        Self::Transport,
        Self::Driver,
        Self::Electrical,
        Self::Supply,
        Self::Drivetrain,
        Self::Transmission,
    ];

    /// Name as in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Conventions => "conventions",
            Self::Cpg => "cpg",
            Self::Transport => "transport",
            Self::Driver => "driver",
            Self::Electrical => "electrical",
            Self::Supply => "supply",
            Self::Drivetrain => "drivetrain",
            Self::Transmission => "transmission",
            Self::Body => "body",
            Self::Camera => "camera",
        }
    }
}

/// One row of the vocabulary.
struct Row {
    name: &'static str,
    stage: Stage,
    base: bool,
    parameters: &'static [&'static str],
    plain: &'static str,
}

macro_rules! effects {
    ($($id:ident, $name:literal, $stage:ident, $base:literal, [$($p:literal),*], $plain:literal;)*) => {
        /// An effect of the vocabulary.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
        pub enum Effect { $(#[doc = $plain] $id),* }

        impl Effect {
            /// Every effect, in the order of the chain.
            pub const ALL: &'static [Self] = &[$(Self::$id),*];

            fn row(self) -> Row {
                match self {
                    $(Self::$id => Row { name: $name, stage: Stage::$stage, base: $base, parameters: &[$($p),*], plain: $plain }),*
                }
            }
        }
    };
}

effects! {
    JointOrder, "joint_order", Conventions, false, ["permutation"], "joints are wired in another order";
    JointSign, "joint_sign", Conventions, false, [], "the joint counts in the other direction";
    JointScale, "joint_scale", Conventions, false, ["ratio"], "angles are scaled (unit or gear ratio)";
    JointOffset, "joint_offset", Conventions, false, ["offset_rad"], "the joint's zero is off";
    Latency, "latency", Transport, false, ["delay_s"], "set-points arrive late";
    Jitter, "jitter", Transport, false, ["sigma_s"], "set-points arrive at irregular times";
    PacketLoss, "packet_loss", Transport, false, ["probability"], "set-points or samples get lost";
    Quantisation, "quantisation", Transport, false, ["step_rad"], "set-points are coarse";
    ClockSkew, "clock_skew", Transport, false, ["ratio"], "the robot's clock runs at another rate";
    LoopGain, "loop_gain", Driver, true, ["ratio"], "the controller's position gain differs";
    DampingGain, "damping_gain", Driver, true, ["ratio"], "the controller's velocity gain differs";
    Deadband, "deadband", Driver, false, ["half_width_rad"], "the controller ignores small errors";
    VelocityLimit, "velocity_limit", Driver, true, ["limit_rad_s"], "the driver limits the speed";
    FeedbackDelay, "feedback_delay", Driver, false, ["delay_s"], "the controller sees the encoder late";
    MotorLag, "motor_lag", Driver, false, ["time_constant_s"], "the motor follows the controller with a lag";
    MotorConstant, "motor_constant", Electrical, true, ["ratio"], "the motor constant differs";
    WindingResistance, "winding_resistance", Electrical, true, ["ratio"], "the winding resistance differs";
    CurrentLimit, "current_limit", Electrical, false, ["limit_a"], "the current is limited";
    TorqueLimit, "torque_limit", Electrical, true, ["limit_nm"], "the torque is limited";
    ThermalDerating, "thermal_derating", Electrical, false, ["time_constant_s", "fraction"], "the motor weakens as it warms up";
    SupplyVoltage, "supply_voltage", Supply, true, ["value_v"], "the supply voltage differs";
    SupplySag, "supply_sag", Supply, false, ["resistance_ohm"], "the supply sags under load";
    CoulombFriction, "coulomb_friction", Drivetrain, false, ["torque_nm"], "dry friction in the gear";
    ViscousFriction, "viscous_friction", Drivetrain, false, ["nm_s_rad"], "friction that grows with speed";
    StribeckFriction, "stribeck_friction", Drivetrain, false, ["static_nm", "velocity_rad_s"], "extra friction near standstill";
    LoadDependentFriction, "load_dependent_friction", Drivetrain, false, ["fraction"], "friction that grows with the load";
    AsymmetricFriction, "asymmetric_friction", Drivetrain, false, ["difference_nm", "difference_nm_s_rad"], "friction that differs by direction";
    QuadraticFriction, "quadratic_friction", Drivetrain, false, ["nm_s2_rad2"], "friction that grows with speed squared";
    TorqueRipple, "torque_ripple", Drivetrain, false, ["amplitude_nm", "periods", "phase_rad"], "torque that varies with the angle";
    Inertia, "inertia", Drivetrain, true, ["ratio"], "the inertia differs";
    GravityLoad, "gravity_load", Drivetrain, true, ["ratio"], "the gravity load differs";
    Backlash, "backlash", Transmission, false, ["half_width_rad"], "play in the gear";
    Compliance, "compliance", Transmission, false, ["stiffness_nm_rad"], "the gear twists under load";
    ConnectorCompliance, "connector_compliance", Transmission, false, ["stiffness_nm_rad"], "the connector twists under load";
    ConnectorPlay, "connector_play", Transmission, false, ["half_width_rad"], "play in the connector";
    GroundFriction, "ground_friction", Body, true, ["coefficient"], "the ground is more or less slippery";
    FrictionAnisotropy, "friction_anisotropy", Body, false, ["ratio", "direction_rad"], "the ground is slippery in one direction";
    TorsionalFriction, "torsional_friction", Body, false, ["coefficient_m"], "turning on the spot is braked";
    Restitution, "restitution", Body, true, ["coefficient"], "impacts bounce";
    GroundSlope, "ground_slope", Body, false, ["roll_rad", "pitch_rad"], "the ground is not level";
    GroundCompliance, "ground_compliance", Body, false, ["stiffness_n_m", "damping_n_s_m"], "the ground is soft";
    Mass, "mass", Body, true, ["ratio"], "the mass differs";
    ComOffset, "com_offset", Body, false, ["x_m", "y_m", "z_m"], "the centre of mass is off";
    CameraHeight, "camera_height", Camera, true, ["value_m"], "the camera hangs at another height";
    CameraOffset, "camera_offset", Camera, false, ["x_m", "y_m"], "the camera is shifted";
    CameraYaw, "camera_yaw", Camera, false, ["angle_rad"], "the camera is turned";
    CameraTimeShift, "camera_time_shift", Camera, false, ["shift_s"], "the camera's clock is off";
    FrameDrop, "frame_drop", Camera, false, ["probability"], "frames are missing";
}

impl Effect {
    /// Name as in files and reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.row().name
    }

    /// The effect of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|e| e.name() == name)
    }

    /// Stage it acts in.
    #[must_use]
    pub fn stage(self) -> Stage {
        self.row().stage
    }

    /// Whether the nominal model already holds its parameter: a change is a parametric gap.
    #[must_use]
    pub fn is_base(self) -> bool {
        self.row().base
    }

    /// Parameter keys.
    #[must_use]
    pub fn parameters(self) -> &'static [&'static str] {
        self.row().parameters
    }

    /// One plain clause for people.
    #[must_use]
    pub fn plain(self) -> &'static str {
        self.row().plain
    }
}

impl Serialize for Effect {
    fn serialize<S: serde::Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_are_unique() {
        for (i, e) in Effect::ALL.iter().enumerate() {
            assert_eq!(Effect::from_name(e.name()), Some(*e));
            assert!(Effect::ALL[..i].iter().all(|o| o.name() != e.name()));
        }
    }
}
