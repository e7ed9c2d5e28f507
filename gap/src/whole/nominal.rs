//! The servos of the model: Table II of the paper, or what a user stated in its place.

use files::model::{Key, MOTORS, Model, MotorKeys};

use super::data::JOINTS;

/// Constants of motors and supply, as the model states them, each with its relative tolerance (1 sigma) but the supply's.
#[derive(Debug, Clone, PartialEq)]
pub struct Motors {
    /// Torque per current at the output, N m/A, by joint.
    pub(super) nm_per_a: [[f64; 2]; JOINTS],
    /// Resistance of the winding, ohm, by joint.
    pub(super) winding_ohm: [[f64; 2]; JOINTS],
    /// Voltage of the supply without load and its tolerance, V.
    pub(super) supply_v: [f64; 2],
}

impl Motors {
    /// Those of `model`.
    #[must_use]
    pub fn of(model: &Model) -> Self {
        let by_joint = |key: fn(&MotorKeys) -> Key| {
            MOTORS.map(|keys| {
                let p = model.parameter(key(&keys));
                [p.value, p.tolerance / p.value]
            })
        };
        let supply = model.parameter(Key::SupplyVoltage);
        Self {
            nm_per_a: by_joint(|k| k.torque_per_current),
            winding_ohm: by_joint(|k| k.winding),
            supply_v: [supply.value, supply.tolerance],
        }
    }
}

/// Whether joint `k` has the motor of the joints between cubes; the others sit inside one.
pub(super) fn inter(k: usize) -> bool {
    MOTORS[k] == MOTORS[1]
}

/// Nominal values of a joint's servo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Nominal {
    /// P, 1/s.
    pub(super) gain_per_s: f64,
    /// Tolerance of P as a share of it.
    pub(super) gain_tolerance: f64,
    /// Speed limit, rad/s.
    pub(super) max_speed_rad_s: f64,
    /// Torque limit, N m.
    pub(super) max_torque_nm: f64,
    /// Tolerance of the torque limit, N m.
    pub(super) torque_tolerance_nm: f64,
    /// Joint damping, N m s/rad.
    pub(super) damping_nm_s_rad: f64,
    /// Its tolerance, N m s/rad.
    pub(super) damping_tolerance_nm_s_rad: f64,
    /// Resistance of the winding, ohm; 0 = the supply bounds nothing.
    pub(super) winding_ohm: f64,
    /// Torque per current at the output, N m/A.
    pub(super) nm_per_a: f64,
}

impl Nominal {
    /// Least and largest torque of a joint at its limit, N m: three tolerances to either side. A motor that gives more has another limit.
    pub(super) fn at_limit_nm(&self) -> [f64; 2] {
        let reach = 3.0 * self.torque_tolerance_nm;
        [self.max_torque_nm - reach, self.max_torque_nm + reach]
    }
}

/// The servo of joint `k` as `model` has it.
pub(super) fn nominal(model: &Model, k: usize) -> Nominal {
    let MotorKeys {
        speed,
        torque,
        gain,
        damping,
        torque_per_current,
        ..
    } = MOTORS[k];
    let gain_per_s = model.value(gain);
    Nominal {
        gain_per_s,
        gain_tolerance: model.parameter(gain).tolerance / gain_per_s.max(1e-9),
        max_speed_rad_s: model.value(speed),
        max_torque_nm: model.value(torque),
        torque_tolerance_nm: model.parameter(torque).tolerance,
        winding_ohm: 0.0,
        damping_nm_s_rad: model.value(damping),
        damping_tolerance_nm_s_rad: model.parameter(damping).tolerance,
        nm_per_a: model.value(torque_per_current),
    }
}
