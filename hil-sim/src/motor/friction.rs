//! Friction at the gear output: LuGre (Canudas de Wit, Olsson, Astrom, Lischinsky 1995) with load, direction,
//! quadratic and position terms.

use super::{JointParams, JointState};

/// Friction of one joint, at the gear output. All neutral values are 0: then the torque is exactly 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrictionParams {
    /// `coulomb_friction` [N m].
    pub coulomb_nm: f64,
    /// `viscous_friction` [N m s/rad].
    pub viscous_nm_s_rad: f64,
    /// `stribeck_friction`: what standstill holds above Coulomb [N m].
    pub static_nm: f64,
    /// `stribeck_friction`: speed at which the excess has fallen to 1/e [rad/s].
    pub stribeck_rad_s: f64,
    /// `load_dependent_friction`: share of the transmitted torque that is added to Coulomb.
    pub load_fraction: f64,
    /// `asymmetric_friction`: Coulomb in + direction less Coulomb in - direction [N m].
    pub asymmetry_nm: f64,
    /// `asymmetric_friction`: viscous in + direction less viscous in - direction [N m s/rad].
    pub asymmetry_nm_s_rad: f64,
    /// `quadratic_friction` [N m s2/rad2].
    pub quadratic_nm_s2_rad2: f64,
    /// Outside the vocabulary: extra Coulomb friction that comes and goes with the angle, at its peak [N m].
    pub position_nm: f64,
    /// Outside the vocabulary: swells per output turn.
    pub position_periods: f64,
}

/// Deflection at which a bristle slides [rad at the output]. Chosen: 1 mrad = 0.3 rad of motor shaft, the order of
/// pre-sliding seen in small planetary gears; small against every set-point step, large against the encoder's edge.
const PRESLIDING_RAD: f64 = 1.0e-3;

/// Time over which the load on the teeth builds up [s]. Chosen: the rotor on the stops' stiffness, sqrt(0.05 / 5e3).
const MESH_S: f64 = 3.0e-3;

/// Damping ratio of a bristle with the rotor inertia. Chosen: below critical, so that a stuck joint rings a little.
const BRISTLE_DAMPING: f64 = 0.5;

/// Advances the bristle and returns the friction torque, positive against motion towards + [N m].
pub(super) fn step(params: &JointParams, state: &mut JointState, dt_s: f64) -> f64 {
    let friction = &params.friction;
    let speed = state.gear_rad_s;
    let towards = if speed >= 0.0 { 0.5 } else { -0.5 };
    let viscous = friction.viscous_nm_s_rad + towards * friction.asymmetry_nm_s_rad;
    let smooth_nm = viscous * speed + friction.quadratic_nm_s2_rad2 * speed * speed.abs();

    // Teeth take up their load over the mesh's elasticity. Without that the friction of one step, its bristle's damping
    // included, made the load of the next: the torque chattered at the step, and rubbed by a newton metre without a load.
    state.pressed_nm += (state.transmitted_nm - state.pressed_nm) * (dt_s / (dt_s + MESH_S));
    let load_nm = friction.load_fraction * state.pressed_nm.abs();
    let position_nm = if friction.position_nm > 0.0 {
        0.5 * friction.position_nm * (1.0 + libm::sin(friction.position_periods * state.gear_rad))
    } else {
        0.0
    };
    let coulomb_nm =
        (friction.coulomb_nm + position_nm + towards * friction.asymmetry_nm + load_nm).max(0.0);
    let scale_nm = friction.coulomb_nm
        + friction.static_nm
        + friction.position_nm
        + 0.5 * friction.asymmetry_nm.abs()
        + friction.load_fraction * params.motor.nominal_torque_nm;
    if scale_nm <= 0.0 {
        return smooth_nm;
    }
    let stribeck_nm = if friction.static_nm > 0.0 {
        let x = speed / friction.stribeck_rad_s;
        friction.static_nm * libm::exp(-x * x)
    } else {
        0.0
    };
    let level_nm = coulomb_nm + stribeck_nm;
    if level_nm <= 0.0 {
        state.bristle_rad = 0.0;
        return smooth_nm;
    }
    let stiffness = scale_nm / PRESLIDING_RAD;
    let inertia = params.motor.reflected_inertia_kg_m2() * params.inertia_ratio;
    let damping = 2.0 * BRISTLE_DAMPING * (stiffness * inertia).sqrt();
    // dz/dt = v - stiffness |v| / level z, implicit in z: stable at any speed.
    let before = state.bristle_rad;
    state.bristle_rad = (before + dt_s * speed) / (1.0 + dt_s * stiffness * speed.abs() / level_nm);
    let rate = (state.bristle_rad - before) / dt_s;
    let bristle_nm =
        (stiffness * state.bristle_rad + damping * rate).clamp(-2.0 * scale_nm, 2.0 * scale_nm);
    smooth_nm + bristle_nm
}
