//! Parameters of one trial, in double precision, from a model.

use crate::robot::{JointClass, Robot, RobotError};
use files::model::{Effect, Key, Model, Stage};
use files::structure::Motor;
use std::sync::Arc;

/// Standard gravity, m/s2 (CGPM 1901).
pub const GRAVITY_M_S2: f64 = 9.80665;

/// Why a model cannot be simulated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ParamsError {
    /// The effect acts on a stage that this simulator leaves to others.
    #[error(
        "the body simulator has no `{effect}` (stage {}); remove it, or simulate that stage before the set-points reach the body",
        stage.name()
    )]
    Effect {
        /// Name of the effect.
        effect: &'static str,
        /// Its stage.
        stage: Stage,
    },
    /// The effect acts on a joint that the robot does not have.
    #[error(
        "the robot has {joints} joints with motors, so there is no joint {joint} for `{effect}`; remove it"
    )]
    Joint {
        /// Name of the effect.
        effect: &'static str,
        /// Its joint.
        joint: usize,
        /// Joints of the robot.
        joints: usize,
    },
    /// The effect acts on a connection that the robot does not have.
    #[error(
        "the robot has no connector for `{effect}`; give its structure joints with motor = \"connector\", or remove the effect"
    )]
    Connector {
        /// Name of the effect.
        effect: &'static str,
    },
    /// The geometry does not fit together.
    #[error(transparent)]
    Robot(#[from] RobotError),
}

/// One joint: the Webots servo of Table II and the drivetrain and transmission effects. Neutral values switch an effect off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointParams {
    /// Highest speed the servo asks for, rad/s.
    pub max_speed_rad_s: f64,
    /// Highest torque of the motor, N m.
    pub max_torque_nm: f64,
    /// P of the servo, 1/s.
    pub gain_per_s: f64,
    /// Linear damping of the joint, N m s/rad.
    pub damping_nm_s_rad: f64,
    /// `coulomb_friction.torque_nm`.
    pub coulomb_nm: f64,
    /// `viscous_friction.nm_s_rad`.
    pub viscous_nm_s_rad: f64,
    /// `stribeck_friction.static_nm`: extra friction at rest; falls as exp(-(v / velocity)^2), see [`crate::laws::stribeck`].
    pub stribeck_nm: f64,
    /// `stribeck_friction.velocity_rad_s`.
    pub stribeck_rad_s: f64,
    /// `load_dependent_friction.fraction` of the torque transmitted in the step before.
    pub load_fraction: f64,
    /// `asymmetric_friction.difference_nm`: friction for positive minus friction for negative speed.
    pub asymmetry_nm: f64,
    /// `asymmetric_friction.difference_nm_s_rad`: the same for the viscous part.
    pub asymmetry_nm_s_rad: f64,
    /// `quadratic_friction.nm_s2_rad2`.
    pub quadratic_nm_s2_rad2: f64,
    /// `torque_ripple.amplitude_nm`; torque = amplitude sin(periods q + phase).
    pub ripple_nm: f64,
    /// `torque_ripple.periods` per turn.
    pub ripple_periods: f64,
    /// `torque_ripple.phase_rad`.
    pub ripple_phase_rad: f64,
    /// `inertia.ratio` of the inertia that the joint alone sees.
    pub inertia_ratio: f64,
    /// `gravity_load.ratio` of the gravity torque at the joint.
    pub gravity_ratio: f64,
    /// `backlash.half_width_rad`.
    pub backlash_rad: f64,
    /// `compliance.stiffness_nm_rad`; infinite = rigid.
    pub stiffness_nm_rad: f64,
    /// Set-point path: sign times scale.
    pub command_ratio: f64,
    /// Set-point path: `joint_offset.offset_rad`.
    pub command_offset_rad: f64,
    /// Set-point path: `quantisation.step_rad`.
    pub command_step_rad: f64,
    /// Set-point path: `latency.delay_s`.
    pub command_delay_s: f64,
    /// `deadband.half_width_rad` of the servo.
    pub deadband_rad: f64,
}

/// Everything about a trial's robot and ground that may differ between lanes.
#[derive(Clone, Debug, PartialEq)]
pub struct Params {
    /// Structure and geometry; lanes with equal structures run together.
    pub robot: Arc<Robot>,
    /// Mass of every half-sphere, kg.
    pub half_masses_kg: Vec<f64>,
    /// Joints by joint index, connectors last.
    pub joints: Vec<JointParams>,
    /// Constraint force mixing, in ODE's meaning (velocity per force, 1/(N s/m)).
    pub cfm: f64,
    /// Error reduction parameter, in ODE's meaning (share of the penetration removed in one step).
    pub erp: f64,
    /// Coulomb friction with the ground.
    pub friction: f64,
    /// How fast a contact point that sticks creeps along the ground under load, m/s per N: ODE's force-dependent slip (manual, `slip1` and `slip2`); 0 = it holds.
    pub slip_m_s_n: f64,
    /// The friction of a contact point is limited by a pyramid inside Coulomb's cone, edges along the ground's x and y (MuJoCo's default cone): by up to a
    /// factor of sqrt(2) less in between.
    pub pyramid: bool,
    /// Restitution at the ground.
    pub bounce: f64,
    /// Approach speed below which nothing bounces, m/s.
    pub bounce_speed_m_s: f64,
    /// Gravity in the ground's frame, m/s2; tilted for `ground_slope`.
    pub gravity_m_s2: [f64; 3],
    /// `friction_anisotropy.ratio`: friction along `anisotropy_direction_rad` over friction across it is 1 / ratio.
    pub anisotropy_ratio: f64,
    /// Direction in the ground plane, rad from x towards y, along which the friction is the nominal one.
    pub anisotropy_direction_rad: f64,
    /// `torsional_friction.coefficient_m`.
    pub torsional_m: f64,
    /// `ground_compliance`: stiffness of one contact point, N/m; infinite = CFM and ERP alone.
    pub ground_stiffness_n_m: f64,
    /// `ground_compliance`: damping of one contact point, N s/m.
    pub ground_damping_n_s_m: f64,
    /// `com_offset`: shift of the centre of mass of the base body's half-spheres, m, body frame.
    pub com_offset_m: [f64; 3],
    /// `clock_skew.ratio`: rate of the robot's clock, which makes the control ticks, over true rate.
    pub clock_ratio: f64,
}

impl TryFrom<&Model> for Params {
    type Error = ParamsError;

    /// The meta-module of a model with its effects.
    fn try_from(model: &Model) -> Result<Params, ParamsError> {
        Params::new(model, Arc::new(Robot::meta_module(model)?))
    }
}

impl Params {
    /// Parameters of a model on another structure; joint effects go by joint index, masses by half-sphere (at most eight; a larger
    /// structure repeats them), where the structure gives none of its own.
    ///
    /// # Errors
    /// Effects of stages that the body simulator does not hold, or on joints or connectors that the robot does not have.
    pub fn new(model: &Model, robot: Arc<Robot>) -> Result<Params, ParamsError> {
        let half_masses_kg = (0..robot.raw().halves.len())
            .map(|h| {
                let own_kg = robot.raw().halves[h].mass_kg;
                own_kg.unwrap_or_else(|| model.value(Key::MASSES[h % Key::MASSES.len()]))
            })
            .collect();
        let mut joints = Vec::with_capacity(robot.joints());
        for joint in 0..robot.joints() {
            let class = robot.raw().bodies[robot.body_of_joint(joint)].class;
            joints.push(JointParams::nominal(model, class));
        }
        let mut params = Params {
            robot,
            half_masses_kg,
            joints,
            cfm: model.value(Key::Cfm),
            erp: model.value(Key::Erp),
            friction: model.value(Key::Friction),
            bounce: model.value(Key::Bounce),
            bounce_speed_m_s: model.value(Key::BounceSpeed),
            gravity_m_s2: [0.0, 0.0, -GRAVITY_M_S2],
            anisotropy_ratio: 1.0,
            anisotropy_direction_rad: 0.0,
            torsional_m: 0.0,
            slip_m_s_n: model.value(Key::ContactSlip),
            pyramid: model.value(Key::FrictionPyramid) >= 0.5,
            ground_stiffness_n_m: f64::INFINITY,
            ground_damping_n_s_m: 0.0,
            com_offset_m: [0.0; 3],
            clock_ratio: 1.0,
        };
        for entry in model.effects() {
            let values: Vec<f64> = entry.parameters.iter().map(|p| p.value).collect();
            match entry.joint {
                Some(joint) => params.apply_joint(entry.effect, usize::from(joint), &values)?,
                None => params.apply(entry.effect, &values)?,
            }
        }
        Ok(params)
    }

    fn apply_joint(&mut self, effect: Effect, joint: usize, v: &[f64]) -> Result<(), ParamsError> {
        let joints = self.robot.motors();
        let Some(j) = self.joints[..joints].get_mut(joint) else {
            let effect = effect.info().name;
            return Err(ParamsError::Joint {
                effect,
                joint,
                joints,
            });
        };
        match effect {
            Effect::JointSign | Effect::JointScale => j.command_ratio *= v[0],
            Effect::JointOffset => j.command_offset_rad = v[0],
            Effect::Quantisation => j.command_step_rad = v[0],
            Effect::Latency => j.command_delay_s = v[0],
            Effect::Deadband => j.deadband_rad = v[0],
            Effect::LoopGain => j.gain_per_s *= v[0],
            Effect::DampingGain => j.damping_nm_s_rad *= v[0],
            Effect::VelocityLimit => j.max_speed_rad_s = v[0],
            Effect::TorqueLimit => j.max_torque_nm = v[0],
            Effect::CoulombFriction => j.coulomb_nm = v[0],
            Effect::ViscousFriction => j.viscous_nm_s_rad = v[0],
            Effect::StribeckFriction => (j.stribeck_nm, j.stribeck_rad_s) = (v[0], v[1]),
            Effect::LoadDependentFriction => j.load_fraction = v[0],
            Effect::AsymmetricFriction => (j.asymmetry_nm, j.asymmetry_nm_s_rad) = (v[0], v[1]),
            Effect::QuadraticFriction => j.quadratic_nm_s2_rad2 = v[0],
            Effect::TorqueRipple => {
                (j.ripple_nm, j.ripple_periods, j.ripple_phase_rad) = (v[0], v[1], v[2]);
            }
            Effect::Inertia => j.inertia_ratio = v[0],
            Effect::GravityLoad => j.gravity_ratio = v[0],
            Effect::Backlash => j.backlash_rad = v[0],
            Effect::Compliance => j.stiffness_nm_rad = v[0],
            other => return Err(unsupported(other)),
        }
        Ok(())
    }

    fn apply(&mut self, effect: Effect, v: &[f64]) -> Result<(), ParamsError> {
        let connectors = self.robot.motors()..self.joints.len();
        let bends = matches!(effect, Effect::ConnectorCompliance | Effect::ConnectorPlay);
        if bends && connectors.is_empty() {
            let effect = effect.info().name;
            return Err(ParamsError::Connector { effect });
        }
        match effect {
            Effect::ConnectorCompliance => {
                for j in &mut self.joints[connectors] {
                    j.stiffness_nm_rad = v[0];
                }
            }
            Effect::ConnectorPlay => {
                for j in &mut self.joints[connectors] {
                    j.backlash_rad = v[0];
                }
            }
            Effect::GroundFriction => self.friction = v[0],
            Effect::FrictionAnisotropy => {
                (self.anisotropy_ratio, self.anisotropy_direction_rad) = (v[0], v[1]);
            }
            Effect::TorsionalFriction => self.torsional_m = v[0],
            Effect::Restitution => self.bounce = v[0],
            Effect::GroundSlope => self.gravity_m_s2 = tilted(v[0], v[1]),
            Effect::GroundCompliance => {
                (self.ground_stiffness_n_m, self.ground_damping_n_s_m) = (v[0], v[1]);
            }
            Effect::Mass => {
                for m in &mut self.half_masses_kg {
                    *m *= v[0];
                }
            }
            Effect::ComOffset => self.com_offset_m = [v[0], v[1], v[2]],
            Effect::ClockSkew => self.clock_ratio = v[0],
            // The film is not the body's business; whoever makes one reads these.
            other if other.info().stage == Stage::Camera => {}
            other => return Err(unsupported(other)),
        }
        Ok(())
    }

    /// Contact softness and error reduction for a time step: those of the model, or with `ground_compliance` ODE's equivalents of a spring
    /// and damper (manual, "How to use ERP and CFM").
    pub(crate) fn contact_law(&self, h: f64) -> (f64, f64) {
        if self.ground_stiffness_n_m.is_infinite() {
            return (self.cfm, self.erp);
        }
        let hk = h * self.ground_stiffness_n_m;
        let sum = hk + self.ground_damping_n_s_m;
        (1.0 / sum, hk / sum)
    }
}

/// Gravity in the frame of a ground that was turned by `roll` about x, then by `pitch` about y.
fn tilted(roll_rad: f64, pitch_rad: f64) -> [f64; 3] {
    let (sr, cr) = libm::sincos(roll_rad);
    let (sp, cp) = libm::sincos(pitch_rad);
    [
        GRAVITY_M_S2 * sp,
        -GRAVITY_M_S2 * cp * sr + 0.0,
        -GRAVITY_M_S2 * cp * cr,
    ]
}

fn unsupported(effect: Effect) -> ParamsError {
    let info = effect.info();
    ParamsError::Effect {
        effect: info.name,
        stage: info.stage,
    }
}

impl JointParams {
    /// Whether the link hangs on its motor by a spring or with play.
    #[must_use]
    pub fn hangs(&self) -> bool {
        self.backlash_rad > 0.0 || self.stiffness_nm_rad.is_finite()
    }

    fn nominal(model: &Model, class: JointClass) -> JointParams {
        let keys = match class {
            JointClass::Intra => Motor::Intra.keys(),
            JointClass::Inter => Motor::Inter.keys(),
            JointClass::Connector => None,
        };
        // A connection has no motor; its spring holds whatever comes. The damping is that of a mechanical joint, 5 % of critical for
        // a module on a 100 N m/rad spring, so that play does not rattle for ever.
        let [speed, torque, gain, damping] = keys.map_or([0.0, 1e4, 0.0, 0.1], |k| {
            [k.speed, k.torque, k.gain, k.damping].map(|key| model.value(key))
        });
        JointParams {
            max_speed_rad_s: speed,
            max_torque_nm: torque,
            gain_per_s: gain,
            damping_nm_s_rad: damping,
            coulomb_nm: 0.0,
            viscous_nm_s_rad: 0.0,
            stribeck_nm: 0.0,
            stribeck_rad_s: 1.0,
            load_fraction: 0.0,
            asymmetry_nm: 0.0,
            asymmetry_nm_s_rad: 0.0,
            quadratic_nm_s2_rad2: 0.0,
            ripple_nm: 0.0,
            ripple_periods: 0.0,
            ripple_phase_rad: 0.0,
            inertia_ratio: 1.0,
            gravity_ratio: 1.0,
            backlash_rad: 0.0,
            stiffness_nm_rad: f64::INFINITY,
            command_ratio: 1.0,
            command_offset_rad: 0.0,
            command_step_rad: 0.0,
            command_delay_s: 0.0,
            deadband_rad: 0.0,
        }
    }
}
