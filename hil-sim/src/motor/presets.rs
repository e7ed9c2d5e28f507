//! The two joints of the meta-module.
//!
//! Sources: `[T1]` Table I of the paper (gear ratio, no-load speed, nominal torque at the output); `[F]` the
//! manufacturer's catalogue sheets of the 2342 ... CR and 2232 ... SR series, rounded catalogue values that were not
//! compared with a current sheet. The speeds agree: 8100 rpm / 305 = 26.6 rpm and 7100 rpm / 366 = 19.4 rpm; so do the
//! torques: the continuous 16 and 10 mN m times the ratios give 4.9 and 3.66 N m, so `[T1]` counts no gear loss.

use core::f64::consts::TAU;

use super::{
    ElectricalParams, ExtraParams, FrictionParams, JointParams, MotorParams, RippleParams,
    ThermalParams, TransmissionParams,
};

/// Which of the two drives a joint has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// Inside a cube: Faulhaber 2342 012 CR, 305:1.
    Intra,
    /// Between cubes: Faulhaber 2232 012 SR, 366:1.
    Inter,
}

/// Voltage of the catalogue's 012 windings [V] `[F]`.
const NOMINAL_V: f64 = 12.0;
/// Magnetic encoder IE2-512: 512 lines, four edges each `[F]`. The paper does not name the encoder; this is the
/// usual one on both motors.
const ENCODER_EDGES: u32 = 2048;
/// Resistance of copper per kelvin (IEC 60028, 0.00393 at 20 degC).
const COPPER_PER_K: f64 = 0.0039;
/// Remanence of NdFeB per kelvin (about -0.11 %/K in magnet makers' sheets).
const MAGNET_PER_K: f64 = 0.0011;

/// Numbers in which the two motors differ.
struct Catalogue {
    no_load_rpm: f64,
    ratio: f64,
    nominal_torque_nm: f64,
    resistance_ohm: f64,
    inductance_h: f64,
    rotor_inertia_kg_m2: f64,
    /// Friction torque at the motor shaft [N m].
    friction_nm: f64,
    winding_case_k_w: f64,
    case_ambient_k_w: f64,
    winding_time_constant_s: f64,
    case_time_constant_s: f64,
}

/// 2342 012 CR and 305:1.
const INTRA: Catalogue = Catalogue {
    no_load_rpm: 26.6,            // at the output [T1]
    ratio: 305.0,                 // [T1]
    nominal_torque_nm: 4.9,       // at the output [T1]
    resistance_ohm: 1.9,          // [F]
    inductance_h: 65.0e-6,        // [F]
    rotor_inertia_kg_m2: 5.8e-7,  // 5.8 g cm2 [F]
    friction_nm: 1.0e-3,          // about 75 mA no-load current [F]
    winding_case_k_w: 3.0,        // Rth1 [F]
    case_ambient_k_w: 20.0,       // Rth2 [F]
    winding_time_constant_s: 6.0, // tau w1 [F], rounded
    case_time_constant_s: 500.0,  // tau w2 [F], rounded
};

/// 2232 012 SR and 366:1.
const INTER: Catalogue = Catalogue {
    no_load_rpm: 19.4,            // at the output [T1]
    ratio: 366.0,                 // [T1]
    nominal_torque_nm: 3.6,       // at the output [T1]
    resistance_ohm: 4.09,         // [F]
    inductance_h: 180.0e-6,       // [F]
    rotor_inertia_kg_m2: 3.8e-7,  // 3.8 g cm2 [F]
    friction_nm: 0.28e-3,         // about 17.5 mA no-load current [F]
    winding_case_k_w: 4.0,        // Rth1 [F]
    case_ambient_k_w: 13.0,       // Rth2 [F]
    winding_time_constant_s: 7.0, // tau w1 [F], rounded
    case_time_constant_s: 330.0,  // tau w2 [F], rounded
};

impl JointKind {
    /// Kinds in joint order A.M0, A.M1, A.M2, B.M0, B.M1, B.M2.
    pub const METAMODULE: [Self; 6] = [
        Self::Intra,
        Self::Inter,
        Self::Intra,
        Self::Intra,
        Self::Inter,
        Self::Intra,
    ];

    fn catalogue(self) -> &'static Catalogue {
        match self {
            Self::Intra => &INTRA,
            Self::Inter => &INTER,
        }
    }

    /// The joint without any structural effect: no friction, rigid, cold; no-load speed and nominal torque of Table I.
    #[must_use]
    pub fn neutral(self) -> JointParams {
        let c = self.catalogue();
        let no_load_rad_s = c.no_load_rpm * TAU / 60.0;
        // Without friction the whole voltage is back-EMF at the no-load speed.
        let kt_nm_a = NOMINAL_V / (no_load_rad_s * c.ratio);
        JointParams {
            motor: MotorParams {
                nominal_v: NOMINAL_V,
                kt_nm_a,
                resistance_ohm: c.resistance_ohm,
                inductance_h: 0.0,
                rotor_inertia_kg_m2: c.rotor_inertia_kg_m2,
                ratio: c.ratio,
                nominal_torque_nm: c.nominal_torque_nm,
                encoder_edges_per_turn: ENCODER_EDGES,
            },
            electrical: ElectricalParams {
                motor_constant_ratio: 1.0,
                winding_resistance_ratio: 1.0,
                current_limit_a: f64::INFINITY,
                torque_limit_nm: c.nominal_torque_nm,
                derating_time_constant_s: c.winding_time_constant_s,
                derating_fraction: 0.0,
            },
            thermal: ThermalParams {
                winding_case_k_w: c.winding_case_k_w,
                case_ambient_k_w: c.case_ambient_k_w,
                winding_time_constant_s: c.winding_time_constant_s,
                case_time_constant_s: c.case_time_constant_s,
                ambient_c: 22.0,   // the catalogue's reference temperature [F]
                reference_c: 22.0, // [F]
                copper_rise_per_k: 0.0,
                magnet_loss_per_k: 0.0,
            },
            friction: FrictionParams {
                stribeck_rad_s: 0.05,
                ..FrictionParams::default()
            },
            ripple: RippleParams::default(),
            inertia_ratio: 1.0,
            transmission: TransmissionParams::default(),
            extra: ExtraParams::default(),
        }
    }

    /// The joint as the catalogue describes it: motor friction, inductance, warm copper and magnets. Its no-load speed
    /// is still that of Table I, friction included.
    #[must_use]
    pub fn catalogue_joint(self) -> JointParams {
        let c = self.catalogue();
        let mut joint = self.neutral();
        let motor_rad_s = c.no_load_rpm * TAU / 60.0 * c.ratio;
        // V = R M / kt + kt w, solved for kt.
        let root = libm::sqrt(
            NOMINAL_V * NOMINAL_V - 4.0 * c.resistance_ohm * c.friction_nm * motor_rad_s,
        );
        joint.motor.kt_nm_a = (NOMINAL_V + root) / (2.0 * motor_rad_s);
        joint.motor.inductance_h = c.inductance_h;
        joint.friction.coulomb_nm = c.friction_nm * c.ratio;
        joint.thermal.copper_rise_per_k = COPPER_PER_K;
        joint.thermal.magnet_loss_per_k = MAGNET_PER_K;
        joint
    }
}
