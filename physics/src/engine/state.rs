//! State that lasts from step to step, and scratch that does not.

use super::tree::MAX_SLOTS;
use crate::lane::Lane;
use crate::linear::{Rot, Sym, V3};
use crate::robot::{MAX_BODIES, MAX_CUBES, MAX_PAIRS};

/// Everything a trial remembers, one trial per lane. Joint arrays go by body index, entry 0 unused.
#[derive(Clone)]
pub(crate) struct State<L> {
    /// Origin of the base body in the world, m.
    pub position: V3<L>,
    /// Base body -> world, w first.
    pub quaternion: [L; 4],
    /// Velocity of the base's origin, world axes, m/s.
    pub linear: V3<L>,
    /// Angular velocity of the base, world axes, rad/s.
    pub angular: V3<L>,
    /// Link angles, rad.
    pub angle: [L; MAX_BODIES],
    /// Joint speeds on the link side, rad/s.
    pub speed: [L; MAX_BODIES],
    /// Encoder angles, rad; equal to the link angles without a transmission effect.
    pub encoder: [L; MAX_BODIES],
    /// Motor torque of the last step, N m.
    pub torque: [L; MAX_BODIES],
    /// Contact impulses of the last step (warm start), N s: x, y tangential, z normal.
    pub impulse: [V3<L>; MAX_SLOTS],
    /// One where the slot touched in the last step.
    pub touching: [L; MAX_SLOTS],
    /// Largest approach speed of a new contact so far, m/s.
    pub impact: L,
    /// Largest sum of normal forces of one step so far, N.
    pub peak_force: L,
    /// Clearance between pairs of cubes in the last step, m; 1 when not near.
    pub gap: L,
    /// Smallest clearance between pairs of cubes so far, m (exact when small).
    pub clearance: L,
    /// Sum and maximum of penetration over touching slots and steps, and their number.
    pub depth_sum: L,
    pub depth_max: L,
    pub depth_count: L,
}

impl<L: Lane> State<L> {
    pub(crate) fn at_rest() -> Self {
        let z = L::zero();
        State {
            position: V3::zero(),
            quaternion: [L::one(), z, z, z],
            linear: V3::zero(),
            angular: V3::zero(),
            angle: [z; MAX_BODIES],
            speed: [z; MAX_BODIES],
            encoder: [z; MAX_BODIES],
            torque: [z; MAX_BODIES],
            impulse: [V3::zero(); MAX_SLOTS],
            touching: [z; MAX_SLOTS],
            impact: z,
            peak_force: z,
            gap: L::one(),
            clearance: L::one(),
            depth_sum: z,
            depth_max: z,
            depth_count: z,
        }
    }

    /// Forgets the statistics; the motion stays.
    pub(crate) fn reset_statistics(&mut self, lane: usize) {
        self.impact.set(lane, 0.0);
        self.peak_force.set(lane, 0.0);
        self.clearance.set(lane, 1.0);
        self.depth_sum.set(lane, 0.0);
        self.depth_max.set(lane, 0.0);
        self.depth_count.set(lane, 0.0);
    }
}

/// One contact point.
#[derive(Clone, Copy)]
pub(crate) struct Slot<L: Lane> {
    /// Lanes in which it touches.
    pub active: L::Mask,
    /// Whether any lane touches; the other fields are only valid then.
    pub any: bool,
    /// Point relative to the centre of mass.
    pub r: V3<L>,
    /// Penetration, m.
    pub depth: L,
    /// Wanted normal speed after the step: the larger of error reduction and bounce.
    pub wanted: L,
    /// Impulse.
    pub p: V3<L>,
    /// Velocity of the point that does not come from V and W: from the joint speeds at the start of the sweeps.
    pub carried: V3<L>,
    /// Mobility of the point with rigid joints: xx, yy, zz, xy, xz, yz.
    pub base: [L; 6],
    /// 1 / (A_zz + CFM / h).
    pub inv_normal: L,
    pub a_xz: L,
    pub a_yz: L,
    /// Inverse of the tangential 2x2 block: xx, xy, yy.
    pub t_inv: [L; 3],
    /// 1 / larger eigenvalue of the tangential block.
    pub slide: L,
    /// I_c^-1 [r]x, by columns: what an impulse along x, y, z does to W.
    pub turn: [V3<L>; 3],
    /// Softness CFM / h.
    pub soft: L,
    /// Creep per impulse of a tangent: see [`crate::Params::slip_m_s_n`].
    pub slip: L,
    /// Torsional impulse and 1 / its diagonal.
    pub spin: L,
    pub inv_spin: L,
    /// Joint contribution to the spin speed at the start of the sweeps.
    pub carried_spin: L,
    /// Spin speed per joint speed, joint speed per torsional impulse (free lanes only).
    pub j_spin: [L; MAX_BODIES],
    pub k_spin: [L; MAX_BODIES],
    /// Velocity of the point per joint speed, with the base's reaction (free lanes only).
    pub j: [V3<L>; MAX_BODIES],
    /// Joint speed per impulse (free lanes only).
    pub k: [V3<L>; MAX_BODIES],
}

/// What is known about a cube in this step.
#[derive(Clone, Copy)]
pub(crate) struct Cube<L: Lane> {
    /// Centre relative to the base's origin.
    pub centre: V3<L>,
    /// Lanes in which the second half is the lower one.
    pub second: L::Mask,
}

/// A pair of cubes that may meet.
#[derive(Clone, Copy)]
pub(crate) struct Pair<L: Lane> {
    pub any: bool,
    pub active: L::Mask,
    /// From the first cube to the second.
    pub normal: V3<L>,
    pub depth: L,
    pub p: L,
    /// Separation speed per joint speed, and joint speed per impulse.
    pub j: [L; MAX_BODIES],
    pub k: [L; MAX_BODIES],
    pub inv: L,
    /// Separation speed at the start of the sweeps.
    pub carried: L,
}

/// Scratch of one step.
pub(crate) struct Work<L: Lane> {
    pub rot: [Rot<L>; MAX_BODIES],
    /// Origins relative to the base's origin, world axes.
    pub p: [V3<L>; MAX_BODIES],
    /// Origin relative to the parent's.
    pub d: [V3<L>; MAX_BODIES],
    pub axis: [V3<L>; MAX_BODIES],
    /// Mass, first moment and inertia about the origin: of the body, then of the subtree.
    pub m: [L; MAX_BODIES],
    pub h: [V3<L>; MAX_BODIES],
    pub i: [Sym<L>; MAX_BODIES],
    pub sub_m: [L; MAX_BODIES],
    pub sub_h: [V3<L>; MAX_BODIES],
    pub sub_i: [Sym<L>; MAX_BODIES],
    pub inv_mass: L,
    pub com: V3<L>,
    pub inv_inertia: Sym<L>,
    /// lin_j, l_j, lin_j / m, I_c^-1 l_j.
    pub lin: [V3<L>; MAX_BODIES],
    pub ang: [V3<L>; MAX_BODIES],
    pub lin_m: [V3<L>; MAX_BODIES],
    pub ang_i: [V3<L>; MAX_BODIES],
    /// S with `inertia.ratio`, both triangles.
    pub s: [[L; MAX_BODIES]; MAX_BODIES],
    /// Inverse of S over the free joints.
    pub b: [[L; MAX_BODIES]; MAX_BODIES],
    pub omega: [V3<L>; MAX_BODIES],
    pub vel: [V3<L>; MAX_BODIES],
    /// Bias force and moment about the body's origin.
    pub f: [V3<L>; MAX_BODIES],
    pub n: [V3<L>; MAX_BODIES],
    /// Bias torque with the base's reaction, times h, less passive torques.
    pub bias: [L; MAX_BODIES],
    /// V and W: before constraints, and current.
    pub v0: V3<L>,
    pub w0: V3<L>,
    pub v: V3<L>,
    pub w: V3<L>,
    /// Wanted joint speed, impulse limit of the motor, friction impulse, damping impulse per speed.
    pub target: [L; MAX_BODIES],
    pub limit: [L; MAX_BODIES],
    pub friction: [L; MAX_BODIES],
    pub damping: [L; MAX_BODIES],
    /// Lower and upper wanted speed and softness of joints with play or spring.
    pub low: [L; MAX_BODIES],
    pub high: [L; MAX_BODIES],
    pub give: [L; MAX_BODIES],
    /// Lanes in which the joint has play or a spring and is not driven by a given speed.
    pub loose: [L::Mask; MAX_BODIES],
    /// Joints that are free in a lane.
    pub free: [L::Mask; MAX_BODIES],
    /// Lanes with any free joint.
    pub free_lane: L::Mask,
    pub any_free: bool,
    /// Joint speed at the start of the sweeps, change since, motor impulse, friction impulse.
    pub start: [L; MAX_BODIES],
    pub change: [L; MAX_BODIES],
    pub motor: [L; MAX_BODIES],
    pub rub: [L; MAX_BODIES],
    /// Contact torque on every joint, with the base's reaction.
    pub load: [L; MAX_BODIES],
    pub cube: [Cube<L>; MAX_CUBES],
    pub slot: [Slot<L>; MAX_SLOTS],
    pub pair: [Pair<L>; MAX_PAIRS],
    /// Rounds that the last solve took.
    pub rounds: u32,
}

impl<L: Lane> Slot<L> {
    fn empty() -> Self {
        let (z, v, never) = (L::zero(), V3::zero(), L::never());
        let (lanes, vectors) = ([z; MAX_BODIES], [v; MAX_BODIES]);
        Slot {
            active: never,
            any: false,
            r: v,
            depth: z,
            wanted: z,
            p: v,
            carried: v,
            base: [z; 6],
            inv_normal: z,
            a_xz: z,
            a_yz: z,
            t_inv: [z; 3],
            slide: z,
            turn: [v; 3],
            soft: z,
            slip: z,
            spin: z,
            inv_spin: z,
            carried_spin: z,
            j_spin: lanes,
            k_spin: lanes,
            j: vectors,
            k: vectors,
        }
    }
}

impl<L: Lane> Pair<L> {
    fn empty() -> Self {
        let (z, v, never) = (L::zero(), V3::zero(), L::never());
        let lanes = [z; MAX_BODIES];
        Pair {
            any: false,
            active: never,
            normal: v,
            depth: z,
            p: z,
            j: lanes,
            k: lanes,
            inv: z,
            carried: z,
        }
    }
}

impl<L: Lane> Work<L> {
    pub(crate) fn new() -> Box<Self> {
        let z = L::zero();
        let v = V3::zero();
        let lanes = [z; MAX_BODIES];
        let vectors = [v; MAX_BODIES];
        let never = L::never();
        Box::new(Work {
            rot: [Rot::identity(); MAX_BODIES],
            p: vectors,
            d: vectors,
            axis: vectors,
            m: lanes,
            h: vectors,
            i: [Sym::zero(); MAX_BODIES],
            sub_m: lanes,
            sub_h: vectors,
            sub_i: [Sym::zero(); MAX_BODIES],
            inv_mass: z,
            com: v,
            inv_inertia: Sym::zero(),
            lin: vectors,
            ang: vectors,
            lin_m: vectors,
            ang_i: vectors,
            s: [lanes; MAX_BODIES],
            b: [lanes; MAX_BODIES],
            omega: vectors,
            vel: vectors,
            f: vectors,
            n: vectors,
            bias: lanes,
            v0: v,
            w0: v,
            v,
            w: v,
            target: lanes,
            limit: lanes,
            friction: lanes,
            damping: lanes,
            low: lanes,
            high: lanes,
            give: lanes,
            loose: [never; MAX_BODIES],
            free: [never; MAX_BODIES],
            free_lane: never,
            any_free: false,
            start: lanes,
            change: lanes,
            motor: lanes,
            rub: lanes,
            load: lanes,
            cube: [Cube {
                centre: v,
                second: never,
            }; MAX_CUBES],
            slot: [Slot::empty(); MAX_SLOTS],
            pair: [Pair::empty(); MAX_PAIRS],
            rounds: 0,
        })
    }
}
