//! The servos of the model: Table II of the paper, or what a user stated in its place.

use files::model::{Key, Model};

use super::data::JOINTS;

/// Joints between cubes; the others sit inside one.
pub(super) const INTER: [usize; 2] = [1, 4];

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

/// Rated figures of the two motors (paper, Table I): no-load speed at 12 V gives torque per current at the output.
pub(super) fn nm_per_a(k: usize) -> f64 {
    if INTER.contains(&k) {
        12.0 / 2.032
    } else {
        12.0 / 2.786
    }
}

/// Damping of every joint, N m s/rad.
pub(super) fn damping_nm_s(model: &Model) -> [f64; JOINTS] {
    std::array::from_fn(|k| {
        model.value(if INTER.contains(&k) {
            Key::InterDamping
        } else {
            Key::IntraDamping
        })
    })
}

/// The servo of joint `k` as `model` has it.
pub(super) fn nominal(model: &Model, k: usize) -> Nominal {
    let keys = if INTER.contains(&k) {
        [
            Key::InterSpeed,
            Key::InterTorque,
            Key::InterGain,
            Key::InterDamping,
        ]
    } else {
        [
            Key::IntraSpeed,
            Key::IntraTorque,
            Key::IntraGain,
            Key::IntraDamping,
        ]
    };
    let [speed, torque, gain, damping] = keys.map(|key| model.value(key));
    Nominal {
        gain_per_s: gain,
        gain_tolerance: model.parameter(keys[2]).tolerance / gain.max(1e-9),
        max_speed_rad_s: speed,
        max_torque_nm: torque,
        torque_tolerance_nm: model.parameter(keys[1]).tolerance,
        winding_ohm: 0.0,
        damping_nm_s_rad: damping,
        nm_per_a: nm_per_a(k),
    }
}
