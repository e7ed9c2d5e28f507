//! One geared joint: brushed motor, gear, encoder side and link side.
//!
//! All mechanical quantities are referred to the gear **output** (N m, rad, rad/s); electrical ones to the motor.
//! Parameters and state are two types; [`step`] is the only law. Own integrator (semi-implicit Euler at 50 us, bristle
//! state implicit) and own friction law (LuGre): the diagnosis uses neither.

mod electrical;
mod friction;
mod imposed;
mod params;
mod presets;
mod thermal;
mod transmission;

pub use electrical::{
    ElectricalParams, current_limit_a, torque_constant_nm_a, winding_resistance_ohm,
};
pub use friction::FrictionParams;
pub use imposed::{available_torque_nm, bear, resistance_nm, speed_line};
pub use params::{ExtraParams, JointParams, ParamError, RippleParams};
pub use presets::JointKind;
pub use thermal::ThermalParams;
pub use transmission::TransmissionParams;

/// The motor and gear as the catalogue states them.
#[derive(Clone, Debug, PartialEq)]
pub struct MotorParams {
    /// Voltage at which the catalogue's no-load speed holds [V].
    pub nominal_v: f64,
    /// Torque constant, equal to the back-EMF constant in SI units [N m/A = V s/rad], motor side, at 22 degC.
    pub kt_nm_a: f64,
    /// Winding resistance at 22 degC [ohm].
    pub resistance_ohm: f64,
    /// Winding inductance [H]; 0 = current follows the voltage at once.
    pub inductance_h: f64,
    /// Rotor inertia, motor side [kg m2].
    pub rotor_inertia_kg_m2: f64,
    /// Gear reduction, motor turns per output turn.
    pub ratio: f64,
    /// Nominal torque at the output [N m].
    pub nominal_torque_nm: f64,
    /// Encoder edges per motor turn (relative encoder, zero lost at reset).
    pub encoder_edges_per_turn: u32,
}

impl MotorParams {
    /// Output speed without load or friction at `bus_v` [rad/s].
    #[must_use]
    pub fn no_load_speed_rad_s(&self, bus_v: f64) -> f64 {
        bus_v / (self.kt_nm_a * self.ratio)
    }

    /// Output torque at standstill without friction or limits at `bus_v` [N m].
    #[must_use]
    pub fn stall_torque_nm(&self, bus_v: f64) -> f64 {
        self.kt_nm_a * self.ratio * bus_v / self.resistance_ohm
    }

    /// Rotor inertia seen at the output [kg m2].
    #[must_use]
    pub fn reflected_inertia_kg_m2(&self) -> f64 {
        self.rotor_inertia_kg_m2 * self.ratio * self.ratio
    }

    /// Output angle of one encoder edge [rad].
    #[must_use]
    pub fn edge_rad(&self) -> f64 {
        core::f64::consts::TAU / (f64::from(self.encoder_edges_per_turn) * self.ratio)
    }
}

/// State of one joint. Angles are continuous (multi-turn).
#[derive(Clone, Debug, PartialEq)]
pub struct JointState {
    /// Gear side of the transmission: what the encoder sees, divided by the ratio [rad].
    pub gear_rad: f64,
    /// Its speed [rad/s].
    pub gear_rad_s: f64,
    /// Link side of the transmission: what the body sees [rad].
    pub link_rad: f64,
    /// Its speed [rad/s].
    pub link_rad_s: f64,
    /// Winding current [A], positive drives towards +angle.
    pub current_a: f64,
    /// Winding temperature [degC].
    pub winding_c: f64,
    /// Case temperature [degC]: what the driver's sensor sees.
    pub case_c: f64,
    /// Bristle deflection of the friction law [rad].
    pub bristle_rad: f64,
    /// Elastic part of the hysteretic spring [rad] (effect outside the vocabulary).
    pub hysteresis_rad: f64,
    /// How far the motor has warmed up, 0..=1 (derating).
    pub heat: f64,
    /// Torque through the transmission in the last step, positive pushes the link towards + [N m].
    pub transmitted_nm: f64,
    /// Torque that presses the teeth together: what is transmitted, smoothed by their elasticity [N m].
    pub pressed_nm: f64,
    /// Duty that the bridge applied after the current limit, -1..=1.
    pub applied_duty: f64,
    /// Joint time since power-up [s] (slow drifts).
    pub age_s: f64,
}

impl JointState {
    /// At rest at `angle_rad`, at ambient temperature.
    #[must_use]
    pub fn at_rest(angle_rad: f64, ambient_c: f64) -> Self {
        Self {
            gear_rad: angle_rad,
            gear_rad_s: 0.0,
            link_rad: angle_rad,
            link_rad_s: 0.0,
            current_a: 0.0,
            winding_c: ambient_c,
            case_c: ambient_c,
            bristle_rad: 0.0,
            hysteresis_rad: 0.0,
            heat: 0.0,
            transmitted_nm: 0.0,
            pressed_nm: 0.0,
            applied_duty: 0.0,
            age_s: 0.0,
        }
    }
}

/// What the bridge does during one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bridge {
    /// Commanded duty, -1..=1 of the bus voltage.
    pub duty: f64,
    /// False = all switches open: no current, the joint coasts.
    pub enabled: bool,
    /// Current limit set in the driver [A]; infinite = only the joint's own limits.
    pub limit_a: f64,
    /// Bus voltage [V].
    pub bus_v: f64,
}

/// What the transmission does to the body during one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkDrive {
    /// Torque on the link [N m].
    pub torque_nm: f64,
    /// Inertia that moves rigidly with the link (reflected rotor), 0 with an elastic transmission [kg m2].
    pub armature_kg_m2: f64,
    /// The rotor moves rigidly with the link: the body's answer is the gear's motion too.
    pub rigid: bool,
}

/// Advances everything on the motor's side of the link by `dt_s` and returns what drives the link.
///
/// With a rigid transmission the gear angle is not moved here: the body integrates link and armature together and
/// [`follow_link`] copies its answer. With play or compliance the rotor is integrated here.
pub fn step(params: &JointParams, state: &mut JointState, bridge: Bridge, dt_s: f64) -> LinkDrive {
    state.age_s += dt_s;
    electrical::step(params, state, bridge, dt_s);
    thermal::step(params, state, bridge.enabled, dt_s);
    let motor_nm = electrical::output_torque_nm(params, state);
    let friction_nm = friction::step(params, state, dt_s);
    let armature = params.motor.reflected_inertia_kg_m2() * params.inertia_ratio;
    let extra_nm = params.extra_torque_nm(state, dt_s);
    let net_nm = motor_nm - friction_nm + extra_nm;
    if params.transmission.is_rigid() {
        return LinkDrive {
            torque_nm: net_nm,
            armature_kg_m2: armature,
            rigid: true,
        };
    }
    let spring_nm = transmission::torque_nm(&params.transmission, state, armature);
    state.gear_rad_s += (net_nm - spring_nm) / armature * dt_s;
    state.gear_rad += state.gear_rad_s * dt_s;
    state.transmitted_nm = spring_nm;
    LinkDrive {
        torque_nm: spring_nm,
        armature_kg_m2: 0.0,
        rigid: false,
    }
}

/// Takes over the link motion that the body computed from `drive`.
pub fn follow_link(
    state: &mut JointState,
    drive: LinkDrive,
    link_rad: f64,
    link_rad_s: f64,
    dt_s: f64,
) {
    if drive.rigid {
        // What passes to the link is the drive less what accelerates the rotor.
        let acceleration = (link_rad_s - state.link_rad_s) / dt_s;
        state.transmitted_nm = drive.torque_nm - drive.armature_kg_m2 * acceleration;
        state.gear_rad = link_rad;
        state.gear_rad_s = link_rad_s;
    }
    state.link_rad = link_rad;
    state.link_rad_s = link_rad_s;
}
