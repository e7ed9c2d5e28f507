//! Two-body thermal model: winding and case.

use super::{JointParams, JointState, electrical};

/// Heat paths and what temperature does to the motor.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermalParams {
    /// Winding to case [K/W].
    pub winding_case_k_w: f64,
    /// Case to ambient [K/W].
    pub case_ambient_k_w: f64,
    /// Time constant of the winding [s].
    pub winding_time_constant_s: f64,
    /// Time constant of the case [s].
    pub case_time_constant_s: f64,
    /// Ambient temperature [degC].
    pub ambient_c: f64,
    /// Temperature at which resistance and torque constant hold [degC].
    pub reference_c: f64,
    /// Rise of resistance per kelvin; neutral 0.
    pub copper_rise_per_k: f64,
    /// Loss of torque constant per kelvin; neutral 0.
    pub magnet_loss_per_k: f64,
}

pub(super) fn step(params: &JointParams, state: &mut JointState, driven: bool, dt_s: f64) {
    let thermal = &params.thermal;
    let loss_w =
        state.current_a * state.current_a * electrical::winding_resistance_ohm(params, state);
    let to_case_w = (state.winding_c - state.case_c) / thermal.winding_case_k_w;
    let to_ambient_w = (state.case_c - thermal.ambient_c) / thermal.case_ambient_k_w;
    // Heat capacity = time constant / thermal resistance, the catalogue's definition.
    let winding_j_k = thermal.winding_time_constant_s / thermal.winding_case_k_w;
    let case_j_k = thermal.case_time_constant_s / thermal.case_ambient_k_w;
    state.winding_c += (loss_w - to_case_w) / winding_j_k * dt_s;
    state.case_c += (to_case_w - to_ambient_w) / case_j_k * dt_s;
    if params.electrical.derating_fraction > 0.0 {
        // Warm-up while driven, cooling while released.
        let target = if driven { 1.0 } else { 0.0 };
        state.heat +=
            (target - state.heat) * (dt_s / params.electrical.derating_time_constant_s).min(1.0);
    }
}
