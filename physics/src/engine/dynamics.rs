//! Kinematics, inertias, bias forces, the servo law, integration.

use super::Command;
use super::params::{LaneParams, Switches};
use super::state::{State, Work};
use super::tree::Tree;
use crate::lane::{Lane, Lanes, Mask};
use crate::laws;
use crate::linear::{Rot, Sym, V3};

/// Speed below which a joint is at rest, rad/s: the last bits of a joint that friction holds.
const REST_RAD_S: f64 = 1e-4;

/// Rotations, origins and hinge axes in world axes, origins relative to the base's.
#[inline(always)]
pub(super) fn kinematics<L: Lane>(tree: &Tree, s: &State<L>, w: &mut Work<L>) {
    w.rot[0] = Rot::from_quaternion(s.quaternion);
    w.p[0] = V3::zero();
    for b in 1..tree.bodies {
        let parent = tree.parent[b];
        let rot = w.rot[parent];
        let axis = rot.apply(tree.axis[b]);
        let (sin, cos) = s.angle[b].sin_cos();
        let d = if tree.apart[b] {
            rot.apply(tree.offset[b])
        } else {
            V3::zero()
        };
        w.rot[b] = rot.turned(tree.axis[b], axis, sin, cos);
        w.axis[b] = axis;
        w.d[b] = d;
        w.p[b] = w.p[parent].add(d);
    }
}

/// Mass, first moment and inertia of every body and every subtree about its origin, world axes.
#[inline(always)]
pub(super) fn inertias<L: Lane>(tree: &Tree, p: &LaneParams<L>, w: &mut Work<L>) {
    for b in 0..tree.bodies {
        w.m[b] = L::zero();
        w.h[b] = V3::zero();
        w.i[b] = Sym::zero();
    }
    let com = L::splat(tree.com_m);
    let centre_inertia = L::splat(tree.centre_inertia_m2);
    for k in 0..tree.halves {
        let b = tree.half_body[k];
        let m = p.half_mass[k];
        let n = w.rot[b].apply(tree.half_diagonal[k]);
        // About the cube's centre the inertia is isotropic.
        let mut h = n.scale(com * m);
        let mut i = Sym::axial(centre_inertia * m, L::zero(), n);
        if p.has_com_offset && b == 0 {
            let shift = w.rot[b].apply_lanes(p.com_offset);
            // The offset moves every mass point of the half.
            let still = L::zero().lt(shift.dot(shift)).not();
            i = select_sym(still, i, i.shifted(m, h, shift));
            h = h.or_else(still, h.add(shift.scale(m)));
        }
        if tree.half_apart[k] {
            let d = w.rot[b].apply(tree.half_centre[k]);
            i = i.shifted(m, h, d);
            h = h.add(d.scale(m));
        }
        w.m[b] += m;
        w.h[b] = w.h[b].add(h);
        w.i[b] = w.i[b].add(i);
    }
    for b in 0..tree.bodies {
        w.sub_m[b] = w.m[b];
        w.sub_h[b] = w.h[b];
        w.sub_i[b] = w.i[b];
    }
    for b in (1..tree.bodies).rev() {
        let parent = tree.parent[b];
        let (m, h, i) = (w.sub_m[b], w.sub_h[b], w.sub_i[b]);
        if tree.apart[b] {
            let d = w.d[b];
            w.sub_i[parent] = w.sub_i[parent].add(i.shifted(m, h, d));
            w.sub_h[parent] = w.sub_h[parent].add(h.add(d.scale(m)));
        } else {
            w.sub_i[parent] = w.sub_i[parent].add(i);
            w.sub_h[parent] = w.sub_h[parent].add(h);
        }
        w.sub_m[parent] += m;
    }
}

#[inline(always)]
fn select_sym<L: Lane>(mask: L::Mask, a: Sym<L>, b: Sym<L>) -> Sym<L> {
    Sym {
        xx: a.xx.or_else(mask, b.xx),
        yy: a.yy.or_else(mask, b.yy),
        zz: a.zz.or_else(mask, b.zz),
        xy: a.xy.or_else(mask, b.xy),
        xz: a.xz.or_else(mask, b.xz),
        yz: a.yz.or_else(mask, b.yz),
    }
}

/// Centre of mass, its inverse inertia, the momenta of unit joint speeds and the matrix S.
#[inline(always)]
pub(super) fn couplings<L: Lane>(tree: &Tree, w: &mut Work<L>, p: &LaneParams<L>) {
    let free_base = if tree.fixed_base { L::zero() } else { L::one() };
    let inv = L::one() / w.sub_m[0];
    let c = w.sub_h[0].scale(inv);
    w.com = c;
    w.inv_mass = inv * free_base;
    // I_c = I_o - m (c.c 1 - c c^T): shift by -c with first moment m c.
    let about_com = w.sub_i[0].shifted(w.sub_m[0], w.sub_h[0], c.neg());
    w.inv_inertia = about_com.inverse().scale(free_base);
    for b in 1..tree.bodies {
        let axis = w.axis[b];
        let lin = axis.cross(w.sub_h[b]);
        let own = w.sub_i[b].mul(axis);
        let ang = own.add(w.p[b].sub(c).cross(lin));
        let lin_m = lin.scale(w.inv_mass);
        let ang_i = w.inv_inertia.mul(ang);
        w.lin[b] = lin;
        w.ang[b] = ang;
        w.lin_m[b] = lin_m;
        w.ang_i[b] = ang_i;
        // A joint further in: k <= b.
        for k in 1..=b {
            let mut s = L::zero() - (lin.dot(w.lin_m[k]) + ang.dot(w.ang_i[k]));
            if tree.path[b] & (1 << k) != 0 {
                let moment = if k == b {
                    own
                } else {
                    own.add(w.p[b].sub(w.p[k]).cross(lin))
                };
                s = w.axis[k].dot(moment) + s;
            }
            w.s[b][k] = s;
            w.s[k][b] = s;
        }
    }
    for b in 1..tree.bodies {
        let extra = p.joint[b].inertia_extra;
        w.s[b][b] = w.s[b][b] + w.s[b][b] * extra + p.joint[b].armature;
    }
}

/// Velocities of every body's origin, angular velocities, and V and W of the present state.
#[inline(always)]
pub(super) fn velocities<L: Lane>(tree: &Tree, s: &State<L>, w: &mut Work<L>) {
    w.omega[0] = s.angular;
    w.vel[0] = s.linear;
    let mut v = s.linear.add(s.angular.cross(w.com));
    let mut a = s.angular;
    for b in 1..tree.bodies {
        let parent = tree.parent[b];
        let speed = s.speed[b];
        w.vel[b] = w.vel[parent].add(w.omega[parent].cross(w.d[b]));
        w.omega[b] = w.omega[parent].add(w.axis[b].scale(speed));
        v = v.add(w.lin_m[b].scale(speed));
        a = a.add(w.ang_i[b].scale(speed));
    }
    w.v0 = v;
    w.w0 = a;
}

/// Bias forces (recursive Newton-Euler with zero joint and base acceleration, gravity as acceleration of the ground), passive
/// torques, and V and W after the step without constraints.
#[inline(always)]
pub(super) fn bias<L: Lane>(tree: &Tree, p: &LaneParams<L>, s: &State<L>, w: &mut Work<L>) {
    let mut alpha = [V3::<L>::zero(); crate::robot::MAX_BODIES];
    let mut acc = [V3::<L>::zero(); crate::robot::MAX_BODIES];
    acc[0] = p.gravity.neg();
    for b in 0..tree.bodies {
        let omega = w.omega[b];
        if b > 0 {
            let parent = tree.parent[b];
            let outer = w.omega[parent];
            alpha[b] = alpha[parent].add(outer.cross(w.axis[b].scale(s.speed[b])));
            acc[b] = if tree.apart[b] {
                let d = w.d[b];
                acc[parent]
                    .add(alpha[parent].cross(d))
                    .add(outer.cross(outer.cross(d)))
            } else {
                acc[parent]
            };
        }
        let h = w.h[b];
        w.f[b] = acc[b]
            .scale(w.m[b])
            .add(alpha[b].cross(h))
            .add(omega.cross(omega.cross(h)));
        w.n[b] = w.i[b]
            .mul(alpha[b])
            .add(omega.cross(w.i[b].mul(omega)))
            .add(h.cross(acc[b]));
    }
    for b in (1..tree.bodies).rev() {
        let parent = tree.parent[b];
        let (f, n) = (w.f[b], w.n[b]);
        w.f[parent] = w.f[parent].add(f);
        w.n[parent] = w.n[parent].add(n);
        if tree.apart[b] {
            w.n[parent] = w.n[parent].add(w.d[b].cross(f));
        }
    }
    let force = w.f[0];
    let moment = w.n[0].sub(w.com.cross(force));
    for b in 1..tree.bodies {
        let torque = w.axis[b].dot(w.n[b]) - w.lin_m[b].dot(force) - w.ang_i[b].dot(moment);
        w.bias[b] = torque * p.h;
    }
    w.v0 = w.v0.sub(force.scale(w.inv_mass * p.h));
    w.w0 = w.w0.sub(w.inv_inertia.mul(moment).scale(p.h));
}

/// Wanted speeds, torque limits, friction, damping and passive torques of the joints.
#[inline(always)]
pub(super) fn servo<L: Lane>(
    tree: &Tree,
    p: &LaneParams<L>,
    switches: &Switches,
    command: &Command<L>,
    s: &State<L>,
    w: &mut Work<L>,
) {
    let zero = L::zero();
    for b in 1..tree.bodies {
        let j = &p.joint[b];
        let mut error = command.set_point[b] - s.encoder[b];
        if switches.deadband {
            error = laws::dead_zone::<Lanes<L>>(error, j.deadband);
        }
        let servo = (j.gain * error).clamp(-j.max_speed, j.max_speed);
        // CFM of the motor row, with the torque of the step before: J v = wanted - CFM * force (ODE manual).
        let servo = servo - p.cfm * s.torque[b];
        let given = command.speed_given[b].gt(zero);
        let target = command.speed[b].or_else(given, servo);
        w.target[b] = target;
        w.limit[b] = j.max_torque * command.limit_factor[b] * p.h;
        let mut damping = j.damping;
        if switches.quadratic {
            damping += j.quadratic * s.speed[b].abs();
        }
        w.damping[b] = damping * p.h;
        let mut passive = command.torque[b];
        if switches.ripple {
            let (sin, _) = (j.ripple_periods * s.angle[b] + j.ripple_phase).sin_cos();
            passive += j.ripple * sin;
        }
        if switches.gravity_load {
            passive += j.gravity_extra * w.axis[b].dot(w.sub_h[b].cross(p.gravity));
        }
        w.bias[b] -= passive * p.h;
        w.friction[b] = zero;
        if switches.rub {
            // At rest the wanted speed says which way friction will act.
            let rest = s.speed[b].abs().lt(L::splat(REST_RAD_S));
            let v = target.or_else(rest, s.speed[b]);
            let stick = laws::stribeck::<Lanes<L>>(j.stribeck, v * j.stribeck_inv);
            let mut rub = j.coulomb + stick + j.load_fraction * s.torque[b].abs();
            rub += j.asymmetry.or_else(v.gt(zero), -j.asymmetry) + j.asymmetry_viscous * v;
            w.friction[b] = rub.max(zero) * p.h;
        }
        if switches.transmission {
            // Speeds that bring the link to the lower and upper end of its play in one step; a spring as softness (ODE manual).
            let ahead = s.encoder[b] + p.h * target - s.angle[b];
            w.low[b] = (ahead - j.backlash) * p.inv_h;
            w.high[b] = (ahead + j.backlash) * p.inv_h;
            let held = given.and(command.hangs[b].gt(zero).not());
            w.loose[b] = j.loose.gt(zero).and(held.not());
            w.give[b] = j.give * p.inv_h * p.inv_h;
        }
    }
}

/// Velocities back to base and joints; angles, position and orientation one step on.
#[inline(always)]
pub(super) fn integrate<L: Lane>(
    tree: &Tree,
    p: &LaneParams<L>,
    switches: &Switches,
    s: &mut State<L>,
    w: &mut Work<L>,
) {
    let mut angular = w.w;
    let mut linear = w.v;
    for b in 1..tree.bodies {
        let speed = w.start[b] + w.change[b];
        angular = angular.sub(w.ang_i[b].scale(speed));
        linear = linear.sub(w.lin_m[b].scale(speed));
        s.speed[b] = speed;
        s.angle[b] += p.h * speed;
        s.torque[b] = w.motor[b] * p.inv_h;
        let mut encoder = s.angle[b];
        if switches.transmission {
            encoder = loose_encoder(p, b, s, w, encoder);
        }
        s.encoder[b] = encoder;
    }
    if tree.fixed_base {
        angular = V3::zero();
        linear = V3::zero();
    }
    linear = linear.sub(angular.cross(w.com));
    s.linear = linear;
    s.angular = angular;
    s.position = s.position.add(linear.scale(p.h));
    s.quaternion = turned(s.quaternion, angular.scale(p.h));
}

/// Encoder angle of a joint with play or spring: the motor turns as asked unless its torque limit lets it slip; then the limit's torque
/// fixes where it stands against the link.
#[inline(always)]
fn loose_encoder<L: Lane>(p: &LaneParams<L>, b: usize, s: &State<L>, w: &Work<L>, rigid: L) -> L {
    let j = &p.joint[b];
    let motor = w.motor[b];
    let asked = s.encoder[b] + p.h * w.target[b];
    let stretch = j.give * motor * p.inv_h;
    let side = j.backlash.or_else(motor.gt(L::zero()), -j.backlash);
    let slipped = s.angle[b] + stretch + side;
    let limit = w.limit[b] * L::splat(0.9999);
    let loose = slipped.or_else(motor.abs().gt(limit), asked);
    loose.or_else(w.loose[b], rigid)
}

/// A quaternion turned by a small rotation vector in world axes (third order in the angle), normalised.
#[inline(always)]
fn turned<L: Lane>(q: [L; 4], turn: V3<L>) -> [L; 4] {
    let t2 = turn.dot(turn);
    let c = L::one() - t2 * L::splat(0.125);
    let v = turn.scale(L::splat(0.5) - t2 * L::splat(1.0 / 48.0));
    let [w, x, y, z] = q;
    let r = [
        c * w - (v.x * x + v.y * y + v.z * z),
        c * x + v.x * w + (v.y * z - v.z * y),
        c * y + v.y * w + (v.z * x - v.x * z),
        c * z + v.z * w + (v.x * y - v.y * x),
    ];
    let n = L::one() / (r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3]).sqrt();
    [r[0] * n, r[1] * n, r[2] * n, r[3] * n]
}
