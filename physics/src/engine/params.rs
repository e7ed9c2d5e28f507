//! Parameters of a batch, one trial per lane.

use crate::lane::Lane;
use crate::linear::V3;
use crate::params::Params;
use crate::robot::{MAX_BODIES, MAX_HALVES, Robot};

/// Which code any lane needs. A lane with neutral parameters gives the same bits whether a switch is on or off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Switches {
    /// Coulomb, Stribeck, load-dependent, asymmetric friction.
    pub rub: bool,
    pub ripple: bool,
    pub quadratic: bool,
    pub gravity_load: bool,
    pub inertia: bool,
    /// Backlash, compliance, connectors.
    pub transmission: bool,
    pub anisotropy: bool,
    pub pyramid: bool,
    pub torsion: bool,
    pub deadband: bool,
}

/// Joint parameters of a batch, by body index.
pub(crate) struct LaneJoint<L> {
    pub max_speed: L,
    pub max_torque: L,
    pub gain: L,
    pub damping: L,
    pub coulomb: L,
    pub stribeck: L,
    /// 1 / Stribeck velocity.
    pub stribeck_inv: L,
    pub load_fraction: L,
    /// Half the differences between positive and negative direction.
    pub asymmetry: L,
    pub asymmetry_viscous: L,
    pub quadratic: L,
    pub ripple: L,
    pub ripple_periods: L,
    pub ripple_phase: L,
    /// Ratios less one.
    pub inertia_extra: L,
    /// Inertia that turns with the joint alone: a rotor behind its gear, kg m2; only [`crate::Body`] sets it.
    pub armature: L,
    pub gravity_extra: L,
    pub backlash: L,
    /// 1 / stiffness.
    pub give: L,
    /// One where the joint has play or spring.
    pub loose: L,
    pub deadband: L,
}

/// Parameters of a batch.
pub(crate) struct LaneParams<L> {
    pub h: L,
    pub inv_h: L,
    pub sweeps: u32,
    pub gravity: V3<L>,
    pub cfm: L,
    /// Contact softness CFM / h, and ERP / h.
    pub soft: L,
    pub push: L,
    pub friction: L,
    /// Force-dependent slip / h.
    pub slip: L,
    /// One where a pyramid limits friction.
    pub pyramid: L,
    pub bounce: L,
    pub bounce_speed: L,
    /// Unit vector along which friction is nominal, and the ratio.
    pub grain: (L, L),
    pub anisotropy: L,
    pub inv_anisotropy: L,
    pub torsion: L,
    pub half_mass: [L; MAX_HALVES],
    pub com_offset: V3<L>,
    /// One where `com_offset` is not zero.
    pub has_com_offset: bool,
    pub joint: Vec<LaneJoint<L>>,
}

impl<L: Lane> LaneParams<L> {
    /// Parameters of up to `L::N` trials on one structure; the last one fills the lanes that are left.
    pub(crate) fn new(robot: &Robot, trials: &[&Params], h: f64, sweeps: u32) -> (Self, Switches) {
        let lanes = |f: &dyn Fn(&Params) -> f64| -> L {
            let mut out = L::zero();
            for lane in 0..L::N {
                out.set(lane, f(trials[lane.min(trials.len() - 1)]));
            }
            out
        };
        let mut half_mass = [L::zero(); MAX_HALVES];
        for (k, slot) in half_mass
            .iter_mut()
            .enumerate()
            .take(robot.raw().halves.len())
        {
            *slot = lanes(&|p| p.half_masses_kg[k]);
        }
        let mut joint = Vec::with_capacity(MAX_BODIES);
        for body in 0..=robot.joints() {
            joint.push(LaneJoint::new(robot, body, &lanes));
        }
        let params = LaneParams {
            h: L::splat(h),
            inv_h: L::splat(1.0 / h),
            sweeps,
            gravity: V3::new(
                lanes(&|p| p.gravity_m_s2[0]),
                lanes(&|p| p.gravity_m_s2[1]),
                lanes(&|p| p.gravity_m_s2[2]),
            ),
            cfm: lanes(&|p| p.cfm),
            soft: lanes(&|p| p.contact_law(h).0 / h),
            push: lanes(&|p| p.contact_law(h).1 / h),
            friction: lanes(&|p| p.friction),
            slip: lanes(&|p| p.slip_m_s_n / h),
            pyramid: lanes(&|p| f64::from(u8::from(p.pyramid))),
            bounce: lanes(&|p| p.bounce),
            bounce_speed: lanes(&|p| p.bounce_speed_m_s),
            grain: (
                lanes(&|p| libm::cos(p.anisotropy_direction_rad)),
                lanes(&|p| libm::sin(p.anisotropy_direction_rad)),
            ),
            anisotropy: lanes(&|p| p.anisotropy_ratio),
            inv_anisotropy: lanes(&|p| 1.0 / p.anisotropy_ratio),
            torsion: lanes(&|p| p.torsional_m),
            half_mass,
            com_offset: V3::new(
                lanes(&|p| p.com_offset_m[0]),
                lanes(&|p| p.com_offset_m[1]),
                lanes(&|p| p.com_offset_m[2]),
            ),
            has_com_offset: trials.iter().any(|p| p.com_offset_m != [0.0; 3]),
            joint,
        };
        (params, Switches::new(trials))
    }
}

/// Gathers one number of every trial into lanes.
type Gather<'a, L> = dyn Fn(&dyn Fn(&Params) -> f64) -> L + 'a;

impl<L: Lane> LaneJoint<L> {
    fn new(robot: &Robot, body: usize, lanes: &Gather<'_, L>) -> Self {
        let index = robot.raw().bodies[body].joint;
        let of = |f: &dyn Fn(&crate::params::JointParams) -> f64| -> L {
            index.map_or(L::zero(), |k| lanes(&|p| f(&p.joints[k])))
        };
        LaneJoint {
            max_speed: of(&|j| j.max_speed_rad_s),
            max_torque: of(&|j| j.max_torque_nm),
            gain: of(&|j| j.gain_per_s),
            damping: of(&|j| j.damping_nm_s_rad + j.viscous_nm_s_rad),
            coulomb: of(&|j| j.coulomb_nm),
            stribeck: of(&|j| j.stribeck_nm),
            stribeck_inv: of(&|j| 1.0 / j.stribeck_rad_s),
            load_fraction: of(&|j| j.load_fraction),
            asymmetry: of(&|j| 0.5 * j.asymmetry_nm),
            asymmetry_viscous: of(&|j| 0.5 * j.asymmetry_nm_s_rad),
            quadratic: of(&|j| j.quadratic_nm_s2_rad2),
            ripple: of(&|j| j.ripple_nm),
            ripple_periods: of(&|j| j.ripple_periods),
            ripple_phase: of(&|j| j.ripple_phase_rad),
            inertia_extra: of(&|j| j.inertia_ratio - 1.0),
            armature: L::zero(),
            gravity_extra: of(&|j| j.gravity_ratio - 1.0),
            backlash: of(&|j| j.backlash_rad),
            give: of(&|j| 1.0 / j.stiffness_nm_rad),
            loose: of(&|j| f64::from(u8::from(j.hangs()))),
            deadband: of(&|j| j.deadband_rad),
        }
    }
}

impl Switches {
    fn new(trials: &[&Params]) -> Switches {
        let mut s = Switches::default();
        for p in trials {
            s.anisotropy |= p.anisotropy_ratio != 1.0;
            s.pyramid |= p.pyramid;
            s.torsion |= p.torsional_m != 0.0;
            for j in &p.joints {
                s.rub |= j.coulomb_nm != 0.0
                    || j.stribeck_nm != 0.0
                    || j.load_fraction != 0.0
                    || j.asymmetry_nm != 0.0
                    || j.asymmetry_nm_s_rad != 0.0;
                s.ripple |= j.ripple_nm != 0.0;
                s.quadratic |= j.quadratic_nm_s2_rad2 != 0.0;
                s.gravity_load |= j.gravity_ratio != 1.0;
                s.inertia |= j.inertia_ratio != 1.0;
                s.transmission |= j.backlash_rad > 0.0 || j.stiffness_nm_rad.is_finite();
                s.deadband |= j.deadband_rad != 0.0;
            }
        }
        s
    }
}
