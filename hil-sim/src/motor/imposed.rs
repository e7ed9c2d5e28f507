//! The motor read backwards: the gear turns as something else decides (a servo's speed constraint), and the motor gives what that takes.

use super::{JointParams, JointState, electrical, friction, thermal};

/// Output torque per ampere now, with magnets, derating and the asymmetric gain in `direction` [N m/A].
fn torque_per_ampere(params: &JointParams, state: &JointState, direction: f64) -> f64 {
    let derated = 1.0 - params.electrical.derating_fraction * state.heat;
    let gain = if direction >= 0.0 {
        1.0 + params.extra.gain_asymmetry
    } else {
        1.0 - params.extra.gain_asymmetry
    };
    electrical::torque_constant_nm_a(params, state) * params.motor.ratio * derated * gain
}

/// Largest torque towards `direction` (+1, -1) at the present speed: current limit, and voltage left above the back-EMF [N m].
#[must_use]
pub fn available_torque_nm(
    params: &JointParams,
    state: &JointState,
    bus_v: f64,
    direction: f64,
) -> f64 {
    let emf_v =
        electrical::torque_constant_nm_a(params, state) * params.motor.ratio * state.gear_rad_s;
    let from_voltage_a =
        (bus_v - direction * emf_v).max(0.0) / electrical::winding_resistance_ohm(params, state);
    let current_a = from_voltage_a.min(electrical::current_limit_a(params));
    torque_per_ampere(params, state, direction) * current_a
}

/// The motor's own line at full duty: speed without torque [rad/s], and speed lost per torque [rad/s per N m].
#[must_use]
pub fn speed_line(params: &JointParams, state: &JointState, bus_v: f64) -> [f64; 2] {
    let volt_s = electrical::torque_constant_nm_a(params, state) * params.motor.ratio;
    let ohm = electrical::winding_resistance_ohm(params, state);
    [bus_v / volt_s, ohm / (volt_s * volt_s)]
}

/// What resists + motion inside the joint: friction, less ripple and the hysteretic spring's torque [N m]. Advances bristle and spring.
#[must_use]
pub fn resistance_nm(params: &JointParams, state: &mut JointState, dt_s: f64) -> f64 {
    let rubbing_nm = friction::step(params, state, dt_s);
    let spring_nm = params.extra_torque_nm(state, dt_s);
    rubbing_nm - params.ripple.torque_nm(state.gear_rad) - spring_nm
}

/// Current, duty and heat of a motor that gives `motor_nm` at the present speed under `bus_v`.
pub fn bear(params: &JointParams, state: &mut JointState, motor_nm: f64, bus_v: f64, dt_s: f64) {
    state.age_s += dt_s;
    state.current_a = motor_nm / torque_per_ampere(params, state, motor_nm);
    let emf_v =
        electrical::torque_constant_nm_a(params, state) * params.motor.ratio * state.gear_rad_s;
    let volt = electrical::winding_resistance_ohm(params, state) * state.current_a + emf_v;
    state.applied_duty = (volt / bus_v.max(0.1)).clamp(-1.0, 1.0);
    thermal::step(params, state, true, dt_s);
}
