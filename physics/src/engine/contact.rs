//! Contacts with the ground plane z = 0.
//!
//! Of a cube the half that faces down supports it: by its ball's lowest point, or, when the vertical passes through a face, by the
//! face's disc. Of a disc it is the lowest rim point and the two points 120 degrees on, so that a cube that lies flat has three.

use super::params::LaneParams;
use super::state::{Slot, State, Work};
use super::tree::{SLOTS_PER_CUBE, Tree};
use crate::lane::{Lane, Mask};
use crate::linear::V3;

/// Weight of the fixed direction in the choice of the lowest rim point: at tilts well below 1 mrad a disc touches everywhere and the
/// points must not run around with rounding.
const STEADY: f64 = 1e-3;

/// Finds the contact points of the present pose and prepares their rows.
#[inline(always)]
pub(super) fn detect<L: Lane>(tree: &Tree, p: &LaneParams<L>, s: &mut State<L>, w: &mut Work<L>) {
    for c in 0..tree.cubes {
        let first = tree.cube[c][0];
        let b = tree.half_body[first];
        let centre = if tree.half_apart[first] {
            w.p[b].add(w.rot[b].apply(tree.half_centre[first]))
        } else {
            w.p[b]
        };
        w.cube[c].centre = centre;
        let height = s.position.z + centre.z;
        let near = height.lt(L::splat(tree.ball_m));
        for k in 0..SLOTS_PER_CUBE {
            w.slot[c * SLOTS_PER_CUBE + k].any = false;
        }
        if near.any() {
            points(tree, p, s, w, c, height, near);
        }
    }
    for k in 0..tree.cubes * SLOTS_PER_CUBE {
        if !w.slot[k].any {
            s.touching[k] = L::zero();
            s.impulse[k] = V3::zero();
        }
    }
}

/// The contact points of one cube.
#[inline(always)]
fn points<L: Lane>(
    tree: &Tree,
    p: &LaneParams<L>,
    s: &mut State<L>,
    w: &mut Work<L>,
    c: usize,
    height: L,
    near: L::Mask,
) {
    let [first, second] = tree.cube[c];
    let (rot_a, rot_b) = (w.rot[tree.half_body[first]], w.rot[tree.half_body[second]]);
    let down_b = rot_b.apply_z(tree.half_diagonal[second]).lt(L::zero());
    w.cube[c].second = down_b;
    let (mut face, mut steady, mut cosine) = (V3::zero(), V3::zero(), L::splat(-1.0));
    for k in 0..3 {
        let (fa, fb) = (tree.half_faces[first][k], tree.half_faces[second][k]);
        let t = -(rot_b.apply_z(fb).or_else(down_b, rot_a.apply_z(fa)));
        let best = t.gt(cosine);
        let n = (k + 1) % 3;
        let (ga, gb) = (tree.half_faces[first][n], tree.half_faces[second][n]);
        face = V3::splat(fb)
            .or_else(down_b, V3::splat(fa))
            .or_else(best, face);
        steady = V3::splat(gb)
            .or_else(down_b, V3::splat(ga))
            .or_else(best, steady);
        cosine = t.or_else(best, cosine);
    }
    let flat = cosine.gt(L::splat(tree.face_m / tree.ball_m));
    let ball = V3::new(L::zero(), L::zero(), L::splat(-tree.ball_m));
    if !flat.any() {
        let depth = L::splat(tree.ball_m) - height;
        prepare(tree, p, s, w, c, 0, ball, depth, near);
        return;
    }
    let mut rot = rot_a;
    for k in 0..3 {
        rot.c[k] = rot_b.c[k].or_else(down_b, rot_a.c[k]);
    }
    let n = rot.apply_lanes(face);
    let m = rot.apply_lanes(steady);
    // Steepest descent in the disc's plane, with a little of a direction fixed in the body.
    let down = V3::new(L::zero(), L::zero(), -L::one()).sub(n.scale(cosine));
    let e = down.add(m.scale(L::splat(STEADY)));
    let rim = L::splat(tree.rim_m) / e.dot(e).sqrt();
    let e1 = e.scale(rim);
    let e2 = n.cross(e1);
    let middle = n.scale(L::splat(tree.face_m));
    let half = e1.scale(L::splat(-0.5));
    let side = e2.scale(L::splat(0.75f64.sqrt()));
    let low = middle.add(e1).or_else(flat, ball);
    prepare(tree, p, s, w, c, 0, low, -(height + low.z), near);
    for (k, point) in [
        (1, middle.add(half).add(side)),
        (2, middle.add(half).sub(side)),
    ] {
        prepare(
            tree,
            p,
            s,
            w,
            c,
            k,
            point,
            -(height + point.z),
            near.and(flat),
        );
    }
}

/// Fills one slot: `point` is relative to the cube's centre.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn prepare<L: Lane>(
    tree: &Tree,
    p: &LaneParams<L>,
    s: &mut State<L>,
    w: &mut Work<L>,
    c: usize,
    k: usize,
    point: V3<L>,
    depth: L,
    candidate: L::Mask,
) {
    let index = c * SLOTS_PER_CUBE + k;
    let zero = L::zero();
    let active = candidate.and(depth.gt(zero));
    if !active.any() {
        return;
    }
    let [first, second] = tree.cube[c];
    let (a, b) = (tree.half_body[first], tree.half_body[second]);
    let omega = w.omega[b].or_else(w.cube[c].second, w.omega[a]);
    // The centre moves with either half; half `first` may have it away from its body's origin.
    let mut vel = w.vel[a];
    if tree.half_apart[first] {
        vel = vel.add(w.omega[a].cross(w.cube[c].centre.sub(w.p[a])));
    }
    let approach = -(vel.z + (omega.x * point.y - omega.y * point.x));
    let bounce = (p.bounce * approach).only(approach.gt(p.bounce_speed));
    let fresh = active.and(s.touching[index].gt(zero).not());
    s.impact = s.impact.max(approach.only(fresh));
    s.touching[index] = L::one().only(active);
    s.depth_sum += depth.only(active);
    s.depth_max = s.depth_max.max(depth.only(active));
    s.depth_count += L::one().only(active);
    let slot = &mut w.slot[index];
    slot.active = active;
    slot.any = true;
    slot.depth = depth;
    slot.wanted = (p.push * depth).max(bounce);
    slot.soft = p.soft;
    slot.slip = p.slip;
    slot.r = w.cube[c].centre.add(point).sub(w.com);
    slot.p = s.impulse[index].only(active);
    base_mobility(w.inv_mass, &w.inv_inertia, slot);
}

/// The 3x3 block of a contact for a robot with rigid joints: A = 1/m - [r] I_c^-1 [r].
#[inline(always)]
fn base_mobility<L: Lane>(inv_mass: L, inv_inertia: &crate::linear::Sym<L>, slot: &mut Slot<L>) {
    let r = slot.r;
    let zero = L::zero();
    // Columns of [r]x: r x e_x = (0, z, -y), r x e_y = (-z, 0, x), r x e_z = (y, -x, 0).
    let arms = [
        V3::new(zero, r.z, -r.y),
        V3::new(-r.z, zero, r.x),
        V3::new(r.y, -r.x, zero),
    ];
    for k in 0..3 {
        slot.turn[k] = inv_inertia.mul(arms[k]);
    }
    let a_xx = inv_mass + arms[0].dot(slot.turn[0]);
    let a_yy = inv_mass + arms[1].dot(slot.turn[1]);
    let a_zz = inv_mass + arms[2].dot(slot.turn[2]);
    let a_xy = arms[0].dot(slot.turn[1]);
    let a_xz = arms[0].dot(slot.turn[2]);
    let a_yz = arms[1].dot(slot.turn[2]);
    slot.base = [a_xx, a_yy, a_zz, a_xy, a_xz, a_yz];
    set_blocks(slot, slot.base);
}

/// Inverses of the normal and the tangential block of A = (xx, yy, zz, xy, xz, yz).
#[inline(always)]
pub(super) fn set_blocks<L: Lane>(slot: &mut Slot<L>, a: [L; 6]) {
    let [a_xx, a_yy, a_zz, a_xy, a_xz, a_yz] = a;
    slot.a_xz = a_xz;
    slot.a_yz = a_yz;
    slot.inv_normal = L::one() / (a_zz + slot.soft);
    // 1 / the larger eigenvalue of the tangential block: the longest step against the sliding that does not overshoot.
    let (a_xx, a_yy) = (a_xx + slot.slip, a_yy + slot.slip);
    let (trace, gap) = (a_xx + a_yy, a_xx - a_yy);
    let spread = (gap * gap + L::splat(4.0) * (a_xy * a_xy)).sqrt();
    slot.slide = L::splat(2.0) / (trace + spread).max(L::splat(1e-12));
    // The floor keeps a bolted robot with rigid joints, which nothing can move, finite.
    let det = L::one() / (a_xx * a_yy - a_xy * a_xy).max(L::splat(1e-12));
    slot.t_inv = [a_yy * det, -a_xy * det, a_xx * det];
}
