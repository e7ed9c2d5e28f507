//! Winding: voltage to current to torque.

use super::{Bridge, JointParams, JointState};

/// Electrical effects; neutral values make the catalogue motor.
#[derive(Clone, Debug, PartialEq)]
pub struct ElectricalParams {
    /// `motor_constant`: torque constant as a share of the catalogue's; neutral 1.
    pub motor_constant_ratio: f64,
    /// `winding_resistance`: share of the catalogue's; neutral 1.
    pub winding_resistance_ratio: f64,
    /// `current_limit` [A]; neutral infinite.
    pub current_limit_a: f64,
    /// `torque_limit` at the output, enforced as a current limit by the driver [N m].
    pub torque_limit_nm: f64,
    /// `thermal_derating`: time constant of the heat model [s]; used only with a fraction above 0.
    pub derating_time_constant_s: f64,
    /// `thermal_derating`: share of the motor torque lost once fully warm, 0..1; neutral 0.
    pub derating_fraction: f64,
}

/// Torque constant with the ratio and the magnets' temperature [N m/A].
#[must_use]
pub fn torque_constant_nm_a(params: &JointParams, state: &JointState) -> f64 {
    let thermal = &params.thermal;
    params.motor.kt_nm_a
        * params.electrical.motor_constant_ratio
        * (1.0 - thermal.magnet_loss_per_k * (state.case_c - thermal.reference_c))
}

/// Winding resistance with the ratio and the copper's temperature [ohm].
#[must_use]
pub fn winding_resistance_ohm(params: &JointParams, state: &JointState) -> f64 {
    let thermal = &params.thermal;
    params.motor.resistance_ohm
        * params.electrical.winding_resistance_ratio
        * (1.0 + thermal.copper_rise_per_k * (state.winding_c - thermal.reference_c))
}

/// The current that the driver allows: the smaller of its current limit and what the torque limit means [A].
#[must_use]
pub fn current_limit_a(params: &JointParams) -> f64 {
    // The driver knows the catalogue's constant, not the true one.
    let from_torque =
        params.electrical.torque_limit_nm / (params.motor.kt_nm_a * params.motor.ratio);
    from_torque.min(params.electrical.current_limit_a)
}

/// Current after one step under the bridge voltage, then the limit; notes the duty that this took.
pub(super) fn step(params: &JointParams, state: &mut JointState, bridge: Bridge, dt_s: f64) {
    if !bridge.enabled {
        state.current_a = 0.0;
        state.applied_duty = 0.0;
        return;
    }
    let resistance = winding_resistance_ohm(params, state);
    let emf_v = torque_constant_nm_a(params, state) * params.motor.ratio * state.gear_rad_s;
    let duty = bridge.duty.clamp(-1.0, 1.0);
    let steady_a = (duty * bridge.bus_v - emf_v) / resistance;
    let free_a = if params.motor.inductance_h > 0.0 {
        // Exact answer of L di/dt = V - R i - emf over one step of constant voltage and speed.
        let decay = libm::exp(-dt_s * resistance / params.motor.inductance_h);
        steady_a + (state.current_a - steady_a) * decay
    } else {
        steady_a
    };
    let limit = current_limit_a(params).min(bridge.limit_a);
    state.current_a = free_a.clamp(-limit, limit);
    // Chopping to the limit lowers the mean voltage to R i + emf.
    state.applied_duty = if state.current_a == free_a || bridge.bus_v <= 0.0 {
        duty
    } else {
        ((state.current_a * resistance + emf_v) / bridge.bus_v).clamp(-1.0, 1.0)
    };
}

/// Motor torque at the output, with derating, ripple and the asymmetric gain [N m].
pub(super) fn output_torque_nm(params: &JointParams, state: &JointState) -> f64 {
    let derated = 1.0 - params.electrical.derating_fraction * state.heat;
    let direction_gain = if state.current_a > 0.0 {
        1.0 + params.extra.gain_asymmetry
    } else {
        1.0 - params.extra.gain_asymmetry
    };
    let mean_nm = torque_constant_nm_a(params, state)
        * params.motor.ratio
        * state.current_a
        * derated
        * direction_gain;
    mean_nm + params.ripple.torque_nm(state.gear_rad)
}
