//! Every constant of a joint, and the check that none is absurd.

use thiserror::Error;

use super::{
    ElectricalParams, FrictionParams, JointState, MotorParams, ThermalParams, TransmissionParams,
};

/// `torque_ripple`: torque over the output angle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RippleParams {
    /// Amplitude [N m]; neutral 0.
    pub amplitude_nm: f64,
    /// Periods per output turn.
    pub periods: f64,
    /// Phase at 0 rad [rad].
    pub phase_rad: f64,
}

impl RippleParams {
    pub(super) fn torque_nm(&self, angle_rad: f64) -> f64 {
        if self.amplitude_nm == 0.0 {
            return 0.0;
        }
        self.amplitude_nm * libm::sin(self.periods * angle_rad + self.phase_rad)
    }
}

/// Effects outside the vocabulary of the diagnosis, for cases it must call unknown. All neutral at 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExtraParams {
    /// Hysteretic spring on the gear side (Bouc-Wen form): stiffness [N m/rad].
    pub hysteresis_nm_rad: f64,
    /// Hysteretic spring: deflection at which it yields [rad].
    pub hysteresis_yield_rad: f64,
    /// Slow drift of the encoder's zero [rad/s].
    pub zero_drift_rad_s: f64,
    /// Torque gain + this in + direction, - this in - direction.
    pub gain_asymmetry: f64,
}

/// One joint.
#[derive(Clone, Debug, PartialEq)]
pub struct JointParams {
    /// Catalogue motor and gear.
    pub motor: MotorParams,
    /// Winding and limits.
    pub electrical: ElectricalParams,
    /// Heat.
    pub thermal: ThermalParams,
    /// Friction.
    pub friction: FrictionParams,
    /// Torque ripple.
    pub ripple: RippleParams,
    /// `inertia`: share of the reflected rotor inertia; neutral 1.
    pub inertia_ratio: f64,
    /// Play and compliance.
    pub transmission: TransmissionParams,
    /// Effects outside the vocabulary.
    pub extra: ExtraParams,
}

/// A parameter that no motor can have.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ParamError {
    /// Outside its range.
    #[error(
        "{name} = {value} is outside {minimum} to {maximum}: correct it, or leave it out for the neutral value"
    )]
    Range {
        /// Parameter with its unit.
        name: &'static str,
        /// Value given.
        value: f64,
        /// Smallest value accepted.
        minimum: f64,
        /// Largest value accepted.
        maximum: f64,
    },
    /// The step is too coarse for the stiffest spring.
    #[error(
        "a stiffness of {stiffness_nm_rad} N m/rad needs a step below {limit_us:.1} us, the world uses {step_us:.1} us"
    )]
    TooStiff {
        /// Stiffness given.
        stiffness_nm_rad: f64,
        /// Step in use [us].
        step_us: f64,
        /// Longest stable step [us].
        limit_us: f64,
    },
}

const INF: f64 = f64::INFINITY;

impl JointParams {
    /// Torque of the hysteretic spring [N m], 0 when it is off.
    pub(super) fn extra_torque_nm(&self, state: &mut JointState, dt_s: f64) -> f64 {
        if self.extra.hysteresis_nm_rad == 0.0 {
            return 0.0;
        }
        let limit = self.extra.hysteresis_yield_rad;
        state.hysteresis_rad =
            (state.hysteresis_rad + state.gear_rad_s * dt_s).clamp(-limit, limit);
        -self.extra.hysteresis_nm_rad * state.hysteresis_rad
    }

    /// Angle that the encoder reads less the true gear angle [rad].
    #[must_use]
    pub fn encoder_error_rad(&self, state: &JointState) -> f64 {
        self.extra.zero_drift_rad_s * state.age_s
    }

    /// Every constant with its range: an order of magnitude or more around anything a joint of this size can be.
    #[rustfmt::skip]
    fn ranges(&self) -> Vec<(&'static str, f64, f64, f64)> {
        let (m, e, t, f) = (&self.motor, &self.electrical, &self.thermal, &self.friction);
        let x = &self.transmission;
        vec![
            ("motor.nominal_v", m.nominal_v, 1.0, 60.0),
            ("motor.kt_nm_a", m.kt_nm_a, 1e-4, 1.0),
            ("motor.resistance_ohm", m.resistance_ohm, 1e-2, 1e3),
            ("motor.inductance_h", m.inductance_h, 0.0, 1.0),
            ("motor.rotor_inertia_kg_m2", m.rotor_inertia_kg_m2, 1e-9, 1e-3),
            ("motor.ratio", m.ratio, 1.0, 1e4),
            ("motor.nominal_torque_nm", m.nominal_torque_nm, 1e-3, 1e3),
            ("motor.encoder_edges_per_turn", f64::from(m.encoder_edges_per_turn), 1.0, 1e6),
            ("motor_constant.ratio", e.motor_constant_ratio, 0.05, 20.0),
            ("winding_resistance.ratio", e.winding_resistance_ratio, 0.05, 20.0),
            ("current_limit.limit_a", e.current_limit_a, 1e-3, INF),
            ("torque_limit.limit_nm", e.torque_limit_nm, 1e-3, INF),
            ("thermal_derating.time_constant_s", e.derating_time_constant_s, 1e-2, 1e6),
            ("thermal_derating.fraction", e.derating_fraction, 0.0, 0.95),
            ("thermal.winding_case_k_w", t.winding_case_k_w, 1e-2, 1e3),
            ("thermal.case_ambient_k_w", t.case_ambient_k_w, 1e-2, 1e3),
            ("thermal.winding_time_constant_s", t.winding_time_constant_s, 1e-1, 1e5),
            ("thermal.case_time_constant_s", t.case_time_constant_s, 1e-1, 1e6),
            ("thermal.ambient_c", t.ambient_c, -40.0, 85.0),
            ("thermal.copper_rise_per_k", t.copper_rise_per_k, 0.0, 0.01),
            ("thermal.magnet_loss_per_k", t.magnet_loss_per_k, 0.0, 0.005),
            ("coulomb_friction.torque_nm", f.coulomb_nm, 0.0, 20.0),
            ("viscous_friction.nm_s_rad", f.viscous_nm_s_rad, 0.0, 50.0),
            ("stribeck_friction.static_nm", f.static_nm, 0.0, 20.0),
            ("stribeck_friction.velocity_rad_s", f.stribeck_rad_s, 1e-4, 10.0),
            ("load_dependent_friction.fraction", f.load_fraction, 0.0, 0.95),
            ("asymmetric_friction.difference_nm", f.asymmetry_nm, -20.0, 20.0),
            ("asymmetric_friction.difference_nm_s_rad", f.asymmetry_nm_s_rad, -50.0, 50.0),
            ("quadratic_friction.nm_s2_rad2", f.quadratic_nm_s2_rad2, 0.0, 50.0),
            ("position_friction.torque_nm", f.position_nm, 0.0, 20.0),
            ("position_friction.periods", f.position_periods, 0.0, 1e3),
            ("torque_ripple.amplitude_nm", self.ripple.amplitude_nm, 0.0, 20.0),
            ("torque_ripple.periods", self.ripple.periods, 0.0, 1e4),
            ("torque_ripple.phase_rad", self.ripple.phase_rad, -100.0, 100.0),
            ("inertia.ratio", self.inertia_ratio, 0.05, 20.0),
            ("backlash.half_width_rad", x.backlash_half_width_rad, 0.0, 0.5),
            ("compliance.stiffness_nm_rad", x.stiffness_nm_rad, 1.0, INF),
            ("compliance.damping_ratio", x.damping_ratio, 0.0, 2.0),
            ("hysteretic_spring.stiffness_nm_rad", self.extra.hysteresis_nm_rad, 0.0, 1e3),
            ("hysteretic_spring.yield_rad", self.extra.hysteresis_yield_rad, 0.0, 10.0),
            ("zero_drift.rad_s", self.extra.zero_drift_rad_s, -0.1, 0.1),
            ("asymmetric_gain.fraction", self.extra.gain_asymmetry, -0.9, 0.9),
        ]
    }

    /// Checks every constant.
    ///
    /// # Errors
    /// The first parameter outside its range.
    pub fn validate(&self) -> Result<(), ParamError> {
        for (name, value, minimum, maximum) in self.ranges() {
            if !(value >= minimum && value <= maximum) {
                return Err(ParamError::Range {
                    name,
                    value,
                    minimum,
                    maximum,
                });
            }
        }
        Ok(())
    }
}
