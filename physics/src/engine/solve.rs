//! Projected Gauss-Seidel over contacts and the joints that are free.

use super::free;
use super::params::{LaneParams, Switches};
use super::state::{Slot, State, Work};
use super::tree::{SLOTS_PER_CUBE, Tree};
use crate::lane::{Lane, Mask};
use crate::linear::V3;

/// At most: as predicted; with the joints that broke their limit free; with all joints of such lanes free.
const ROUNDS: u32 = 3;
/// A rigid joint may exceed its torque limit by this share before the lane is solved again.
pub(super) const SLACK: f64 = 1e-3;

/// Speeds, contact impulses and motor impulses of this step.
#[inline(always)]
pub(super) fn solve<L: Lane>(
    tree: &Tree,
    p: &LaneParams<L>,
    switches: &Switches,
    s: &mut State<L>,
    w: &mut Work<L>,
) {
    for b in 1..tree.bodies {
        w.free[b] = L::never();
    }
    for round in 0..ROUNDS {
        for k in 0..tree.cubes * SLOTS_PER_CUBE {
            if w.slot[k].any {
                w.slot[k].p = s.impulse[k].only(w.slot[k].active);
                w.slot[k].spin = L::zero();
            }
        }
        load(tree, w);
        free::choose(tree, switches, round, s, w);
        free::start(tree, p, s, w);
        carry(tree, switches, w);
        if w.any_free {
            free::rows(tree, switches, w);
        }
        for _ in 0..p.sweeps {
            sweep(tree, p, switches, w);
        }
        load(tree, w);
        let broken = finish(tree, s, w);
        w.rounds = round + 1;
        if !broken.any() {
            break;
        }
    }
    let mut force = L::zero();
    for k in 0..tree.cubes * SLOTS_PER_CUBE {
        if w.slot[k].any {
            s.impulse[k] = w.slot[k].p;
            force += w.slot[k].p.z;
        }
    }
    s.peak_force = s.peak_force.max(force * p.inv_h);
}

/// What the present contact impulses do: V and W, and the torque on every joint with the base's reaction.
#[inline(always)]
fn load<L: Lane>(tree: &Tree, w: &mut Work<L>) {
    for b in 0..tree.bodies {
        w.f[b] = V3::zero();
        w.n[b] = V3::zero();
    }
    for c in 0..tree.cubes {
        let [a, b] = tree.cube[c].map(|h| tree.half_body[h]);
        let (mut force, mut moment) = (V3::zero(), V3::zero());
        let mut any = false;
        for k in c * SLOTS_PER_CUBE..(c + 1) * SLOTS_PER_CUBE {
            if w.slot[k].any {
                any = true;
                let q = w.slot[k].p;
                force = force.add(q);
                // About the base's origin, to be shifted to each body's.
                moment = moment.add(w.slot[k].r.add(w.com).cross(q));
                moment.z += w.slot[k].spin;
            }
        }
        if any {
            let second = w.cube[c].second;
            let (fb, nb) = (force.only(second), moment.only(second));
            let (fa, na) = (force.sub(fb), moment.sub(nb));
            w.f[a] = w.f[a].add(fa);
            w.n[a] = w.n[a].add(na);
            w.f[b] = w.f[b].add(fb);
            w.n[b] = w.n[b].add(nb);
        }
    }
    for b in (1..tree.bodies).rev() {
        let parent = tree.parent[b];
        w.f[parent] = w.f[parent].add(w.f[b]);
        w.n[parent] = w.n[parent].add(w.n[b]);
    }
    let force = w.f[0];
    let moment = w.n[0].sub(w.com.cross(force));
    for b in 1..tree.bodies {
        let own = w.n[b].sub(w.p[b].cross(w.f[b]));
        w.load[b] = w.axis[b].dot(own) - w.lin_m[b].dot(force) - w.ang_i[b].dot(moment);
    }
    w.v = w.v0.add(force.scale(w.inv_mass));
    w.w = w.w0.add(w.inv_inertia.mul(moment));
}

/// Point velocities that the joint speeds at the start of the sweeps cause while V = W = 0.
#[inline(always)]
fn carry<L: Lane>(tree: &Tree, switches: &Switches, w: &mut Work<L>) {
    let (mut linear, mut angular) = (V3::zero(), V3::zero());
    for b in 1..tree.bodies {
        linear = linear.sub(w.lin_m[b].scale(w.start[b]));
        angular = angular.sub(w.ang_i[b].scale(w.start[b]));
    }
    if tree.fixed_base {
        (linear, angular) = (V3::zero(), V3::zero());
    }
    w.omega[0] = angular;
    w.vel[0] = linear.sub(angular.cross(w.com));
    for b in 1..tree.bodies {
        let parent = tree.parent[b];
        w.vel[b] = w.vel[parent].add(w.omega[parent].cross(w.d[b]));
        w.omega[b] = w.omega[parent].add(w.axis[b].scale(w.start[b]));
    }
    for c in 0..tree.cubes {
        let [a, b] = tree.cube[c].map(|h| tree.half_body[h]);
        let omega = w.omega[b].or_else(w.cube[c].second, w.omega[a]);
        let centre = w.cube[c].centre;
        for k in c * SLOTS_PER_CUBE..(c + 1) * SLOTS_PER_CUBE {
            if w.slot[k].any {
                let point = w.slot[k].r.add(w.com).sub(centre);
                let at_centre = w.vel[a].add(w.omega[a].cross(centre.sub(w.p[a])));
                w.slot[k].carried = at_centre.add(omega.cross(point));
                if switches.torsion {
                    w.slot[k].carried_spin = omega.z;
                    w.slot[k].inv_spin = L::one() / w.inv_inertia.zz.max(L::splat(1e-12));
                }
            }
        }
    }
}

/// One pass over all rows.
#[inline(always)]
fn sweep<L: Lane>(tree: &Tree, p: &LaneParams<L>, switches: &Switches, w: &mut Work<L>) {
    for k in 0..tree.cubes * SLOTS_PER_CUBE {
        if w.slot[k].any {
            point(tree, p, switches, k, w);
        }
    }
    if w.any_free {
        free::sweep(tree, p, switches, w);
    }
}

/// One contact point: normal, then friction, then what they do to the robot.
#[inline(always)]
fn point<L: Lane>(tree: &Tree, p: &LaneParams<L>, switches: &Switches, k: usize, w: &mut Work<L>) {
    let slot = &w.slot[k];
    let mut v = w.v.add(w.w.cross(slot.r)).add(slot.carried);
    if w.any_free {
        let mut u = v;
        for b in 1..tree.bodies {
            u = u.add(slot.j[b].scale(w.change[b]));
        }
        v = u.or_else(w.free_lane, v);
    }
    let old = slot.p;
    let normal = (old.z + (slot.wanted - v.z - slot.soft * old.z) * slot.inv_normal)
        .max(L::zero())
        .only(slot.active);
    let push = normal - old.z;
    let (x, y) = (
        v.x + slot.a_xz * push + slot.slip * old.x,
        v.y + slot.a_yz * push + slot.slip * old.y,
    );
    let [txx, txy, tyy] = slot.t_inv;
    let tx = old.x - (txx * x + txy * y);
    let ty = old.y - (txy * x + tyy * y);
    let slide = (old.x - slot.slide * x, old.y - slot.slide * y);
    let (tx, ty) = cone(p, switches, normal, (tx, ty), slide);
    let (tx, ty) = (tx.only(slot.active), ty.only(slot.active));
    let dp = V3::new(tx - old.x, ty - old.y, push);
    let turn = slot.turn;
    w.slot[k].p = V3::new(tx, ty, normal);
    w.v = w.v.add(dp.scale(w.inv_mass));
    w.w =
        w.w.add(turn[0].scale(dp.x))
            .add(turn[1].scale(dp.y))
            .add(turn[2].scale(dp.z));
    if w.any_free {
        for b in 1..tree.bodies {
            w.change[b] += w.slot[k].k[b].dot(dp);
        }
    }
    if switches.torsion {
        spin(tree, p, k, w);
    }
}

/// Tangential impulse inside Coulomb's cone: `stick` where that lies inside; else `slide`, a step against the sliding velocity with
/// one factor for both directions, so that friction ends up opposite to the sliding, brought back to the cone.
#[inline(always)]
fn cone<L: Lane>(
    p: &LaneParams<L>,
    switches: &Switches,
    normal: L,
    stick: (L, L),
    slide: (L, L),
) -> (L, L) {
    let limit = p.friction * normal;
    let slides = size2(p, switches, stick).gt(limit * limit);
    if !slides.any() {
        return stick;
    }
    // Zero where nothing presses, and no division by zero: the largest normal number below every real impulse.
    let size = size2(p, switches, slide).sqrt().max(L::splat(1e-30));
    let shrink = (limit / size).min(L::one());
    (
        (slide.0 * shrink).or_else(slides, stick.0),
        (slide.1 * shrink).or_else(slides, stick.1),
    )
}

/// Square of a tangential impulse, measured so that Coulomb's limit is a circle.
#[inline(always)]
fn size2<L: Lane>(p: &LaneParams<L>, switches: &Switches, t: (L, L)) -> L {
    let mut out = t.0 * t.0 + t.1 * t.1;
    let mut edges = t;
    if switches.anisotropy {
        let along = t.0 * p.grain.0 + t.1 * p.grain.1;
        let across = (t.1 * p.grain.0 - t.0 * p.grain.1) * p.inv_anisotropy;
        let one = L::one();
        let equal = p.anisotropy.lt(one).or(p.anisotropy.gt(one)).not();
        out = out.or_else(equal, along * along + across * across);
        edges = (t.0.or_else(equal, along), t.1.or_else(equal, across));
    }
    if switches.pyramid {
        let sum = edges.0.abs() + edges.1.abs();
        out = (sum * sum).or_else(p.pyramid.gt(L::zero()), out);
    }
    out
}

/// Torsional friction of one contact point: a couple about the vertical, at most coefficient times normal impulse.
#[inline(always)]
fn spin<L: Lane>(tree: &Tree, p: &LaneParams<L>, k: usize, w: &mut Work<L>) {
    let slot: &Slot<L> = &w.slot[k];
    let mut rate = w.w.z + slot.carried_spin;
    if w.any_free {
        let mut u = rate;
        for b in 1..tree.bodies {
            u += slot.j_spin[b] * w.change[b];
        }
        rate = u.or_else(w.free_lane, rate);
    }
    let limit = p.torsion * slot.p.z;
    let new = (slot.spin - rate * slot.inv_spin)
        .clamp(-limit, limit)
        .only(slot.active);
    let d = new - slot.spin;
    // Without torsional friction the limit is zero and nothing changes.
    let on = p.torsion.gt(L::zero());
    let i = &w.inv_inertia;
    let turned = V3::new(w.w.x + i.xz * d, w.w.y + i.yz * d, w.w.z + i.zz * d);
    w.w = turned.or_else(on, w.w);
    if w.any_free {
        for b in 1..tree.bodies {
            w.change[b] += w.slot[k].k_spin[b] * d;
        }
    }
    w.slot[k].spin = new;
}

/// Motor impulses of the rigid joints, and the lanes in which one is beyond its limit (its joint is then marked free).
#[inline(always)]
fn finish<L: Lane>(tree: &Tree, s: &State<L>, w: &mut Work<L>) -> L::Mask {
    let mut broken = L::never();
    for b in 1..tree.bodies {
        let need = free::needed(tree, s, w, b, true);
        let (motor, held) = free::motor_share(w, b, need, L::splat(1.0 + SLACK));
        let rigid = w.free[b].not();
        broken = broken.or(rigid.and(held.not()));
        w.motor[b] = motor.or_else(rigid, w.motor[b]);
        w.rub[b] = (need - motor).or_else(rigid, w.rub[b]);
    }
    broken
}
