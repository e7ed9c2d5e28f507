//! Play and compliance between gear and link.

use super::JointState;

/// Gear output to link. Neutral: no play, infinite stiffness (rotor and link are one body).
#[derive(Clone, Debug, PartialEq)]
pub struct TransmissionParams {
    /// `backlash`: half of the play [rad]; neutral 0.
    pub backlash_half_width_rad: f64,
    /// `compliance`: stiffness [N m/rad]; neutral infinite.
    pub stiffness_nm_rad: f64,
    /// Damping ratio of the spring with the rotor inertia.
    pub damping_ratio: f64,
}

/// Stiffness of the stops when play is set and compliance is not [N m/rad]. Chosen: 1 mrad under the nominal 5 N m,
/// far below any play worth naming, and slow enough for the 50 us step.
const STOP_STIFFNESS_NM_RAD: f64 = 5.0e3;

impl Default for TransmissionParams {
    fn default() -> Self {
        Self {
            backlash_half_width_rad: 0.0,
            stiffness_nm_rad: f64::INFINITY,
            // Chosen: gear trains ring for a few cycles.
            damping_ratio: 0.2,
        }
    }
}

impl TransmissionParams {
    /// Neither play nor compliance.
    #[must_use]
    pub fn is_rigid(&self) -> bool {
        self.backlash_half_width_rad <= 0.0 && self.stiffness_nm_rad.is_infinite()
    }

    /// Stiffness in contact: the compliance, or that of the stops when only play is set [N m/rad].
    #[must_use]
    pub fn contact_stiffness_nm_rad(&self) -> f64 {
        if self.stiffness_nm_rad.is_infinite() {
            STOP_STIFFNESS_NM_RAD
        } else {
            self.stiffness_nm_rad
        }
    }
}

/// Torque from gear to link [N m].
pub(super) fn torque_nm(
    params: &TransmissionParams,
    state: &JointState,
    armature_kg_m2: f64,
) -> f64 {
    let stiffness = params.contact_stiffness_nm_rad();
    let twist = state.gear_rad - state.link_rad;
    let half = params.backlash_half_width_rad;
    let beyond = if twist > half {
        twist - half
    } else if twist < -half {
        twist + half
    } else {
        return 0.0;
    };
    let damping = 2.0 * params.damping_ratio * (stiffness * armature_kg_m2).sqrt();
    let torque = stiffness * beyond + damping * (state.gear_rad_s - state.link_rad_s);
    // A stop can push, never pull.
    if half > 0.0 && torque * beyond < 0.0 {
        0.0
    } else {
        torque
    }
}
