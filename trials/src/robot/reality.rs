//! From a plan to a robot: constants drawn within their tolerances, then the planted causes.

use std::sync::Arc;

use files::model::{Effect, Key, Model, Parameter};
use physics::Params;

use super::drive::{Convention, DriveParams, ServoParams};
use super::{JOINTS, Planted, SUPPLY_V};
use hil_sim::driver::transport::TransportParams;
use hil_sim::motor::JointKind;
use hil_sim::rng::Rng;
use hil_sim::supply::SupplyParams;

/// Relative 1-sigma tolerances with which motor constant, resistance and supply are drawn; at most those of the
/// shipped model.
const MOTOR_TOLERANCE: [f64; 3] = [0.03, 0.03, 0.01];

/// Tolerances of the case's model file: a robot whose makers measured it. The shipped ones are those of a first guess.
#[rustfmt::skip]
const TOLERANCES: &[(Key, f64)] = &[
    (Key::Friction, 0.05), (Key::Bounce, 0.05), (Key::Erp, 0.05),
    (Key::Mass1, 0.008), (Key::Mass2, 0.008), (Key::Mass3, 0.008), (Key::Mass4, 0.008),
    (Key::Mass5, 0.008), (Key::Mass6, 0.008), (Key::Mass7, 0.008), (Key::Mass8, 0.008),
    (Key::IntraSpeed, 0.08), (Key::IntraTorque, 0.15), (Key::IntraGain, 0.3), (Key::IntraDamping, 0.02),
    (Key::InterSpeed, 0.05), (Key::InterTorque, 0.1), (Key::InterGain, 0.3), (Key::InterDamping, 0.02),
    (Key::CameraHeight, 0.02),
];

/// The model that the case states: the hand-tuned column, with the tolerances above.
pub(super) fn stated_model() -> Model {
    let mut model = Model::hand_tuned();
    for (key, tolerance) in TOLERANCES {
        let mut p = model.parameter(*key).clone();
        p.tolerance = *tolerance;
        p.source = "paper, Table II, hand tuned; tolerance of a measured robot".to_owned();
        let known = model.set_parameter(*key, p);
        debug_assert!(known.is_ok());
    }
    // Films here are on the robot's clock.
    let known = model.set_parameter(
        Key::CameraTimeShift,
        Parameter {
            value: 0.0,
            tolerance: 0.01,
            source: "one clock".to_owned(),
        },
    );
    debug_assert!(known.is_ok());
    model.set_name("stated model of a blind case");
    model
}

/// The overhead camera.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CameraTruth {
    pub(super) height_m: f64,
    pub(super) x_m: f64,
    pub(super) y_m: f64,
    pub(super) yaw_rad: f64,
    /// Film clock: a frame labelled t was taken at t + shift.
    pub(super) shift_s: f64,
    pub(super) drop: f64,
}

/// A robot as it is.
#[derive(Clone, Debug)]
pub(super) struct Reality {
    pub(super) params: Arc<Params>,
    pub(super) drives: Vec<DriveParams>,
    pub(super) conventions: [Convention; JOINTS],
    /// Joint that a set-point for joint k reaches.
    pub(super) order: [usize; JOINTS],
    /// Whether the readings are mixed up with the set-points.
    pub(super) order_of_readings: bool,
    pub(super) supply: SupplyParams,
    /// Gait clock of the robot over true time.
    pub(super) clock: f64,
    /// Outside the vocabulary: share of the ground's friction lost per second.
    pub(super) friction_drift_1_s: f64,
    pub(super) camera: CameraTruth,
}

impl Reality {
    /// The robot of a seed with these causes. `None` if the physics refuses it.
    pub(super) fn new(seed: u64, planted: &[Planted]) -> Option<Self> {
        Self::nudged(seed, planted, None)
    }

    /// The same with one nominal number, of [`NUDGES`], off by one more tolerance.
    pub(super) fn nudged(seed: u64, planted: &[Planted], nudge: Option<usize>) -> Option<Self> {
        let stated = stated_model();
        let mut rng = Rng::new(seed, 0x7E, 0);
        let mut within = |value: f64, tolerance: f64| (value + tolerance * rng.normal()).max(0.0);
        let mut model = Model::hand_tuned();
        for key in Key::TABLE_II {
            let p = stated.parameter(key);
            let info = key.info();
            let value = within(p.value, p.tolerance).clamp(info.min, info.max);
            model.set(key, value).ok()?;
        }
        let mut drives = JointKind::METAMODULE.map(|kind| drive(kind, &stated, &mut within));
        let mut supply = SupplyParams {
            voltage_v: within(SUPPLY_V, MOTOR_TOLERANCE[2] * SUPPLY_V),
            resistance_ohm: 0.0,
        };
        if let Some(number) = nudge {
            shift(number, &mut model, &mut drives, &mut supply)?;
        }
        let camera = CameraTruth {
            height_m: model.value(Key::CameraHeight),
            x_m: 0.0,
            y_m: 0.0,
            yaw_rad: 0.0,
            shift_s: 0.0,
            drop: 0.0,
        };
        let mut reality = Self {
            params: Arc::new(Params::try_from(&model).ok()?),
            drives: drives.to_vec(),
            conventions: [Convention::RIGHT; JOINTS],
            order: std::array::from_fn(|k| k),
            order_of_readings: false,
            supply,
            clock: 1.0,
            friction_drift_1_s: 0.0,
            camera,
        };
        for cause in planted {
            reality.plant(cause, &mut model);
        }
        let mut params = Params::try_from(&model).ok()?;
        for joint in &mut params.joints[..JOINTS] {
            // The servo's own damping is a load of the motor here.
            joint.damping_nm_s_rad = 0.0;
        }
        reality.params = Arc::new(params);
        Some(reality)
    }

    /// Plants a cause. A ratio is one to the stated nominal value, so it takes the place of what was drawn within its
    /// tolerance.
    fn plant(&mut self, cause: &Planted, model: &mut Model) {
        let value = |k: usize| cause.parameters.get(k).map_or(0.0, |p| p.1);
        let (x, y) = (value(0), value(1));
        if let Some(joint) = cause.joint {
            self.plant_on(joint, cause, [x, y, value(2)], model);
            return;
        }
        match cause.effect {
            "joint_order" => {
                self.order = permutation(x as usize);
                self.order_of_readings = cause.readings_too;
            }
            "clock_skew" => self.clock = x,
            "supply_voltage" => self.supply.voltage_v = x,
            "supply_sag" => self.supply.resistance_ohm = x,
            "friction_drift" => self.friction_drift_1_s = x,
            "camera_height" => self.camera.height_m = x,
            "camera_offset" => (self.camera.x_m, self.camera.y_m) = (x, y),
            "camera_yaw" => self.camera.yaw_rad = x,
            "camera_time_shift" => self.camera.shift_s = x,
            "frame_drop" => self.camera.drop = x,
            name => set(model, name, None, cause),
        }
    }

    fn plant_on(&mut self, joint: usize, cause: &Planted, v: [f64; 3], model: &mut Model) {
        let Some(drive) = self.drives.get_mut(joint) else {
            return;
        };
        let convention = &mut self.conventions[joint];
        convention.readings_too |= cause.readings_too;
        let (servo, motor) = (&mut drive.servo, &mut drive.motor);
        let kind = JointKind::METAMODULE[joint.min(JOINTS - 1)];
        let stated = self::drive(kind, &stated_model(), &mut |value, _| value).servo;
        let x = v[0];
        match cause.effect {
            "joint_sign" => convention.sign = x,
            "joint_scale" => convention.scale = x,
            "joint_offset" => convention.offset_rad = x,
            "latency" => drive.transport.latency_s = x,
            "jitter" => drive.transport.jitter_s = x,
            "packet_loss" => drive.transport.loss_probability = x,
            "quantisation" => drive.transport.quantisation_rad = x,
            "loop_gain" => servo.gain_1_s = x * stated.gain_1_s,
            "damping_gain" => servo.damping_nm_s_rad = x * stated.damping_nm_s_rad,
            "deadband" => servo.deadband_rad = x,
            "velocity_limit" => servo.max_speed_rad_s = x,
            "feedback_delay" => servo.feedback_delay_s = x,
            "motor_lag" => servo.lag_s = x,
            "motor_constant" => motor.electrical.motor_constant_ratio = x,
            "winding_resistance" => motor.electrical.winding_resistance_ratio = x,
            "current_limit" => motor.electrical.current_limit_a = x,
            "torque_limit" => motor.electrical.torque_limit_nm = x,
            "thermal_derating" => {
                motor.electrical.derating_time_constant_s = x;
                motor.electrical.derating_fraction = v[1];
            }
            "coulomb_friction" => motor.friction.coulomb_nm = x,
            "viscous_friction" => motor.friction.viscous_nm_s_rad = x,
            "stribeck_friction" => {
                (motor.friction.static_nm, motor.friction.stribeck_rad_s) = (x, v[1]);
            }
            "load_dependent_friction" => motor.friction.load_fraction = x,
            "asymmetric_friction" => {
                (
                    motor.friction.asymmetry_nm,
                    motor.friction.asymmetry_nm_s_rad,
                ) = (x, v[1]);
            }
            "quadratic_friction" => motor.friction.quadratic_nm_s2_rad2 = x,
            "torque_ripple" => {
                motor.ripple.amplitude_nm = x;
                (motor.ripple.periods, motor.ripple.phase_rad) = (v[1], v[2]);
            }
            "inertia" => motor.inertia_ratio = x,
            "backlash" => motor.transmission.backlash_half_width_rad = x,
            "compliance" => motor.transmission.stiffness_nm_rad = x,
            "position_friction" => {
                (motor.friction.position_nm, motor.friction.position_periods) = (x, v[1]);
            }
            "hysteretic_spring" => {
                (
                    motor.extra.hysteresis_nm_rad,
                    motor.extra.hysteresis_yield_rad,
                ) = (x, v[1]);
            }
            "zero_drift" => motor.extra.zero_drift_rad_s = x,
            "asymmetric_gain" => motor.extra.gain_asymmetry = x,
            name => set(model, name, u8::try_from(joint).ok(), cause),
        }
    }

    /// Joint whose readings stand in column `column`.
    pub(super) fn reads(&self, column: usize) -> usize {
        if self.order_of_readings {
            self.order[column]
        } else {
            column
        }
    }

    /// Whether some joint has play or a spring, so that the body needs shorter steps.
    pub(super) fn is_loose(&self) -> bool {
        self.drives.iter().any(|d| !d.motor.transmission.is_rigid())
    }
}

/// Nominal numbers that a diagnosis may fit in a cause's place: friction, masses, bounce; gain, speed, torque and
/// damping of either kind of joint; torque constant, winding, supply.
pub(super) const NUDGES: usize = 14;

/// Adds its tolerance to a nominal number.
fn shift(
    number: usize,
    model: &mut Model,
    drives: &mut [DriveParams; JOINTS],
    supply: &mut SupplyParams,
) -> Option<()> {
    let stated = stated_model();
    let mut more = |key: Key| {
        let info = key.info();
        let value = model.value(key) + stated.parameter(key).tolerance;
        model.set(key, value.clamp(info.min, info.max)).ok()
    };
    match number {
        0 => more(Key::Friction)?,
        1 => Key::MASSES.into_iter().try_for_each(more)?,
        2 => more(Key::Bounce)?,
        11 => supply.voltage_v *= 1.0 + MOTOR_TOLERANCE[2],
        12 | 13 => {
            for drive in drives {
                let e = &mut drive.motor.electrical;
                match number {
                    12 => e.motor_constant_ratio *= 1.0 + MOTOR_TOLERANCE[0],
                    _ => e.winding_resistance_ratio *= 1.0 + MOTOR_TOLERANCE[1],
                }
            }
        }
        _ => {
            let (inter, what) = ((number - 3) / 4 == 1, (number - 3) % 4);
            let key = SERVO_KEYS[usize::from(inter)][what];
            let by = stated.parameter(key).tolerance;
            for (drive, kind) in drives.iter_mut().zip(JointKind::METAMODULE) {
                if (kind == JointKind::Inter) != inter {
                    continue;
                }
                match what {
                    0 => drive.servo.max_speed_rad_s += by,
                    1 => drive.motor.electrical.torque_limit_nm += by,
                    2 => drive.servo.gain_1_s += by,
                    _ => drive.servo.damping_nm_s_rad += by,
                }
            }
        }
    }
    Some(())
}

/// Speed, torque, gain and damping of the joints within cubes, and of those between them.
const SERVO_KEYS: [[Key; 4]; 2] = [
    [
        Key::IntraSpeed,
        Key::IntraTorque,
        Key::IntraGain,
        Key::IntraDamping,
    ],
    [
        Key::InterSpeed,
        Key::InterTorque,
        Key::InterGain,
        Key::InterDamping,
    ],
];

/// By how many tolerances a planted nominal number is off; `None` for what the nominal model has not.
pub(super) fn tolerances_off(planted: &Planted) -> Option<f64> {
    let x = planted.parameters.first()?.1;
    let stated = stated_model();
    let off = |key: Key, value: f64| {
        let p = stated.parameter(key);
        Some((value - p.value).abs() / p.tolerance)
    };
    let kind = planted.joint.and_then(|j| JointKind::METAMODULE.get(j));
    let [speed, torque, gain, _] = SERVO_KEYS[usize::from(kind == Some(&JointKind::Inter))];
    match planted.effect {
        "loop_gain" => off(gain, x * stated.value(gain)),
        "velocity_limit" => off(speed, x),
        "torque_limit" => off(torque, x),
        "motor_constant" => Some((x - 1.0).abs() / MOTOR_TOLERANCE[0]),
        "winding_resistance" => Some((x - 1.0).abs() / MOTOR_TOLERANCE[1]),
        "supply_voltage" => Some((x / SUPPLY_V - 1.0).abs() / MOTOR_TOLERANCE[2]),
        "ground_friction" => off(Key::Friction, x),
        "restitution" => off(Key::Bounce, x),
        "camera_height" => off(Key::CameraHeight, x),
        // Eight masses that are off alike.
        "mass" => {
            let half = stated.parameter(Key::Mass1);
            Some((x - 1.0).abs() * half.value * libm::sqrt(8.0) / half.tolerance)
        }
        _ => None,
    }
}

/// An effect that the body simulator's parameters hold.
fn set(model: &mut Model, name: &str, joint: Option<u8>, cause: &Planted) {
    let values: Vec<f64> = cause.parameters.iter().map(|p| p.1).collect();
    let known = Effect::from_name(name)
        .ok_or(())
        .and_then(|e| model.set_effect(e, joint, &values).map_err(|_| ()));
    debug_assert!(known.is_ok(), "{name} {values:?}");
}

fn drive(kind: JointKind, stated: &Model, within: &mut impl FnMut(f64, f64) -> f64) -> DriveParams {
    let [speed, torque, gain, damping] =
        SERVO_KEYS[usize::from(kind == JointKind::Inter)].map(|key| {
            let p = stated.parameter(key);
            within(p.value, p.tolerance)
        });
    let mut motor = kind.neutral();
    motor.electrical.torque_limit_nm = torque.max(0.01);
    motor.electrical.motor_constant_ratio = within(1.0, MOTOR_TOLERANCE[0]);
    motor.electrical.winding_resistance_ratio = within(1.0, MOTOR_TOLERANCE[1]);
    DriveParams {
        servo: ServoParams {
            gain_1_s: gain,
            max_speed_rad_s: speed,
            damping_nm_s_rad: damping,
            deadband_rad: 0.0,
            feedback_delay_s: 0.0,
            lag_s: 0.0,
        },
        transport: TransportParams::default(),
        motor,
    }
}

/// Permutation of this index in lexicographic order.
fn permutation(index: usize) -> [usize; JOINTS] {
    let mut left = index % (1..=JOINTS).product::<usize>();
    let mut rest: Vec<usize> = (0..JOINTS).collect();
    std::array::from_fn(|place| {
        let block: usize = (1..JOINTS - place).product();
        let taken = rest.remove(left / block);
        left %= block;
        taken
    })
}
