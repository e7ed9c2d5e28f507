//! Pairs of cubes that may meet: clearance along the best of thirteen separating axes, and contact rows when they touch.
//!
//! The axes are the line of centres and the six faces of each cube. Along the line of centres the bound is exact for ball on ball, along a
//! face for a disc on a ball or disc. For rim on rim it is smaller than the true distance, so a contact comes early, never late. The
//! contact is frictionless: a trial in which it happens has already failed.

use super::state::Work;
use super::tree::Tree;
use crate::lane::{Lane, Mask};
use crate::linear::V3;

/// Clearances are known up to this, m: twice the margin of the pre-check (`control::precheck::MARGIN_M`).
const NEAR_M: f64 = 0.006;

/// Clearance of every pair, and rows where it is negative.
#[inline(always)]
pub(super) fn detect<L: Lane>(tree: &Tree, s: &mut super::State<L>, w: &mut Work<L>) {
    s.gap = L::one();
    for k in 0..tree.pairs {
        w.pair[k].any = false;
        let [i, j] = tree.pair[k];
        let d = w.cube[j].centre.sub(w.cube[i].centre);
        let distance2 = d.dot(d);
        let reach = 2.0 * tree.ball_m + NEAR_M;
        let near = distance2.lt(L::splat(reach * reach));
        if near.any() {
            meet(tree, s, w, k, d, distance2, near);
        }
    }
}

/// Support of a cube in direction `u` (unit): how far it reaches from its centre.
#[inline(always)]
fn reach<L: Lane>(tree: &Tree, w: &Work<L>, cube: usize, u: V3<L>) -> L {
    let [first, second] = tree.cube[cube];
    let (rot_a, rot_b) = (
        &w.rot[tree.half_body[first]],
        &w.rot[tree.half_body[second]],
    );
    let on_b = rot_b.apply(tree.half_diagonal[second]).dot(u).gt(L::zero());
    let mut cosine = L::splat(-1.0);
    for k in 0..3 {
        let a = rot_a.apply(tree.half_faces[first][k]).dot(u);
        let b = rot_b.apply(tree.half_faces[second][k]).dot(u);
        cosine = cosine.max(b.or_else(on_b, a));
    }
    let flat = cosine.gt(L::splat(tree.face_m / tree.ball_m));
    let sine = (L::one() - cosine * cosine).max(L::zero()).sqrt();
    let disc = L::splat(tree.face_m) * cosine + L::splat(tree.rim_m) * sine;
    disc.or_else(flat, L::splat(tree.ball_m))
}

#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn meet<L: Lane>(
    tree: &Tree,
    s: &mut super::State<L>,
    w: &mut Work<L>,
    k: usize,
    d: V3<L>,
    distance2: L,
    near: L::Mask,
) {
    let [i, j] = tree.pair[k];
    let distance = distance2.sqrt();
    let mut normal = d.scale(L::one() / distance.max(L::splat(1e-6)));
    let mut gap = distance - reach(tree, w, i, normal) - reach(tree, w, j, normal.neg());
    for (cube, sign) in [(i, 1.0), (j, -1.0)] {
        for half in tree.cube[cube] {
            for f in 0..3 {
                let face = w.rot[tree.half_body[half]].apply(tree.half_faces[half][f]);
                let n = face.scale(L::splat(sign));
                let g = d.dot(n) - reach(tree, w, i, n) - reach(tree, w, j, n.neg());
                let better = g.gt(gap);
                gap = g.or_else(better, gap);
                normal = n.or_else(better, normal);
            }
        }
    }
    s.gap = s.gap.min(gap.or_else(near, L::one()));
    s.clearance = s.clearance.min(s.gap);
    let active = near.and(gap.lt(L::zero()));
    if !active.any() {
        return;
    }
    // The contact lies midway between the two supports along the normal.
    let at = w.cube[i]
        .centre
        .add(normal.scale(reach(tree, w, i, normal) + gap * L::splat(0.5)));
    // One half per cube carries the contact; the hinge between the halves passes through the centre, so its arm is short.
    let [a, b] = [
        tree.half_body[tree.cube[i][0]],
        tree.half_body[tree.cube[j][0]],
    ];
    for q in 1..tree.bodies {
        let bit = 1 << q;
        let on = f64::from(i8::from(tree.path[b] & bit != 0) - i8::from(tree.path[a] & bit != 0));
        let arm = w.axis[q].cross(at.sub(w.p[q]));
        w.pair[k].j[q] = arm.dot(normal) * L::splat(on);
    }
    w.pair[k].normal = normal;
    w.pair[k].depth = -gap;
    w.pair[k].active = active;
    w.pair[k].any = true;
}
