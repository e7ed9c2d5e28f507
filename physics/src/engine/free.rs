//! Joints whose motor cannot hold the wanted speed, or that have play or a spring: rows with limits instead of rigid joints.

use super::params::{LaneParams, Switches};
use super::state::{State, Work};
use super::tree::{SLOTS_PER_CUBE, Tree};
use crate::lane::{Lane, Mask};
use crate::linear::V3;
use crate::robot::MAX_BODIES;

/// Impulse that joint `b` needs from motor and friction for the given speeds: the wanted ones, or those of `start + change`.
#[inline(always)]
pub(super) fn needed<L: Lane>(tree: &Tree, s: &State<L>, w: &Work<L>, b: usize, solved: bool) -> L {
    let mut sum = w.bias[b] - w.load[b];
    for k in 1..tree.bodies {
        let speed = if solved {
            w.start[k] + w.change[k]
        } else {
            w.target[k]
        };
        sum += w.s[b][k] * (speed - s.speed[k]);
    }
    let own = if solved {
        w.start[b] + w.change[b]
    } else {
        w.target[b]
    };
    sum + w.damping[b] * own
}

/// The motor's part of a needed impulse, friction taken off, and whether the motor can give it.
#[inline(always)]
pub(super) fn motor_share<L: Lane>(w: &Work<L>, b: usize, need: L, slack: L) -> (L, L::Mask) {
    let zero = L::zero();
    let rub = w.friction[b];
    let forward = w.target[b].gt(zero);
    let backward = w.target[b].lt(zero);
    // At rest friction takes what it can.
    let resting = need - need.clamp(-rub, rub);
    let motor = (need + rub).or_else(forward, (need - rub).or_else(backward, resting));
    // A hair of absolute slack: a limit of zero with a need of rounding size is not broken.
    let limit = w.limit[b] * slack + L::splat(1e-9);
    (motor, motor.abs().gt(limit).not())
}

/// Chooses the free joints of this round.
#[inline(always)]
pub(super) fn choose<L: Lane>(
    tree: &Tree,
    switches: &Switches,
    round: u32,
    s: &State<L>,
    w: &mut Work<L>,
) {
    let mut touching = L::never();
    for k in 0..tree.pairs {
        if w.pair[k].any {
            touching = touching.or(w.pair[k].active);
        }
    }
    let mut need = [L::zero(); MAX_BODIES];
    for b in 1..tree.bodies {
        need[b] = needed(tree, s, w, b, false);
    }
    let mut broken_lane = L::never();
    for b in 1..tree.bodies {
        let held = if round == 0 {
            motor_share(w, b, need[b], L::one()).1
        } else {
            // `motor` of the round before holds what the rigid joint needed.
            w.motor[b]
                .abs()
                .gt(w.limit[b] * L::splat(1.0 + super::solve::SLACK) + L::splat(1e-9))
                .not()
        };
        let mut free = w.free[b].or(held.not());
        broken_lane = broken_lane.or(held.not().and(w.free[b].not()));
        if round == 0 {
            free = free.or(touching);
            if switches.transmission {
                free = free.or(w.loose[b]);
            }
        }
        w.free[b] = free;
    }
    if round >= 2 {
        for b in 1..tree.bodies {
            w.free[b] = w.free[b].or(broken_lane);
        }
    }
    w.free_lane = L::never();
    for b in 1..tree.bodies {
        w.free_lane = w.free_lane.or(w.free[b]);
        // Kept for `start`.
        w.change[b] = need[b];
    }
    w.any_free = w.free_lane.any();
}

/// Joint speeds and motor impulses to start the sweeps from. Expects the needed impulses in `change`, leaves it zero.
#[inline(always)]
pub(super) fn start<L: Lane>(tree: &Tree, p: &LaneParams<L>, s: &State<L>, w: &mut Work<L>) {
    if !w.any_free {
        for b in 1..tree.bodies {
            w.start[b] = w.target[b];
            w.change[b] = L::zero();
        }
        return;
    }
    invert(tree, w);
    let zero = L::zero();
    let mut missing = [zero; MAX_BODIES];
    for b in 1..tree.bodies {
        let need = w.change[b];
        let rub = w.friction[b];
        let (share, _) = motor_share(w, b, need, L::one());
        let motor = share.clamp(-w.limit[b], w.limit[b]);
        let warm = (s.torque[b] * p.h).clamp(-w.limit[b], w.limit[b]);
        let motor = warm.or_else(w.loose[b], motor);
        let against = (-rub).or_else(w.target[b].gt(zero), rub);
        let moving = w.target[b].abs().gt(zero);
        let rub = against.or_else(moving, (need - motor).clamp(-rub, rub));
        w.motor[b] = motor;
        w.rub[b] = rub;
        missing[b] = (motor + rub - need).only(w.free[b]);
    }
    for b in 1..tree.bodies {
        let mut extra = zero;
        for k in 1..tree.bodies {
            extra += w.b[b][k] * missing[k];
        }
        w.start[b] = (w.target[b] + extra).or_else(w.free[b], w.target[b]);
        w.change[b] = zero;
    }
}

/// `b` = inverse of S + damping over the free joints, zero elsewhere. Symmetric sweep operator (Beaton 1964), lower triangle.
#[inline(always)]
fn invert<L: Lane>(tree: &Tree, w: &mut Work<L>) {
    let n = tree.bodies;
    for j in 1..n {
        for k in 1..j {
            w.b[j][k] = w.s[j][k].only(w.free[j].and(w.free[k]));
        }
        w.b[j][j] = (w.s[j][j] + w.damping[j]).or_else(w.free[j], L::one());
    }
    for k in 1..n {
        let inv = L::one() / w.b[k][k];
        let mut column = [L::zero(); MAX_BODIES];
        for j in 1..n {
            column[j] = if j > k { w.b[j][k] } else { w.b[k][j] };
        }
        for j in 1..n {
            if j == k {
                continue;
            }
            let f = column[j] * inv;
            for l in 1..=j {
                if l != k {
                    w.b[j][l] -= f * column[l];
                }
            }
        }
        for j in 1..n {
            let f = column[j] * inv;
            if j > k {
                w.b[j][k] = f;
            } else {
                w.b[k][j] = f;
            }
        }
        w.b[k][k] = -inv;
    }
    for j in 1..n {
        for k in 1..=j {
            let value = (-w.b[j][k]).only(w.free[j].and(w.free[k]));
            w.b[j][k] = value;
            w.b[k][j] = value;
        }
    }
}

/// Contact rows over the free joints: velocity per joint speed, joint speed per impulse, and the contact's own block.
#[inline(always)]
pub(super) fn rows<L: Lane>(tree: &Tree, switches: &Switches, w: &mut Work<L>) {
    for c in 0..tree.cubes {
        let [a, b] = tree.cube[c].map(|h| tree.half_body[h]);
        let (path_a, path_b) = (tree.path[a], tree.path[b]);
        let second = w.cube[c].second;
        for k in c * SLOTS_PER_CUBE..(c + 1) * SLOTS_PER_CUBE {
            if !w.slot[k].any {
                continue;
            }
            let r = w.slot[k].r;
            let at = r.add(w.com);
            for j in 1..tree.bodies {
                let bit = 1 << j;
                let react = w.lin_m[j].add(w.ang_i[j].cross(r)).neg();
                let mut own = V3::zero();
                let mut turn = L::zero();
                if (path_a | path_b) & bit != 0 {
                    own = w.axis[j].cross(at.sub(w.p[j]));
                    turn = w.axis[j].z;
                    if path_b & bit == 0 {
                        own = own.only(second.not());
                        turn = turn.only(second.not());
                    } else if path_a & bit == 0 {
                        own = own.only(second);
                        turn = turn.only(second);
                    }
                }
                w.slot[k].j[j] = react.add(own).only(w.free[j]);
                w.slot[k].j_spin[j] = (turn - w.ang_i[j].z).only(w.free[j]);
            }
            mobility(tree, switches, k, w);
        }
    }
    pair_rows(tree, w);
}

#[inline(always)]
fn mobility<L: Lane>(tree: &Tree, switches: &Switches, k: usize, w: &mut Work<L>) {
    let mut a = w.slot[k].base;
    let mut spin = w.inv_inertia.zz;
    for j in 1..tree.bodies {
        let mut g = V3::zero();
        let mut g_spin = L::zero();
        for l in 1..tree.bodies {
            g = g.add(w.slot[k].j[l].scale(w.b[j][l]));
            if switches.torsion {
                g_spin += w.slot[k].j_spin[l] * w.b[j][l];
            }
        }
        w.slot[k].k[j] = g;
        w.slot[k].k_spin[j] = g_spin;
        let q = w.slot[k].j[j];
        a[0] += q.x * g.x;
        a[1] += q.y * g.y;
        a[2] += q.z * g.z;
        a[3] += q.x * g.y;
        a[4] += q.x * g.z;
        a[5] += q.y * g.z;
        spin += w.slot[k].j_spin[j] * g_spin;
    }
    super::contact::set_blocks(&mut w.slot[k], a);
    if switches.torsion {
        w.slot[k].inv_spin = L::one() / spin.max(L::splat(1e-12));
    }
}

#[inline(always)]
fn pair_rows<L: Lane>(tree: &Tree, w: &mut Work<L>) {
    for k in 0..tree.pairs {
        if !w.pair[k].any {
            continue;
        }
        let mut carried = L::zero();
        let mut a = L::splat(1e-9);
        for j in 1..tree.bodies {
            w.pair[k].j[j] = w.pair[k].j[j].only(w.free[j]);
            carried += w.pair[k].j[j] * w.start[j];
        }
        for j in 1..tree.bodies {
            let mut g = L::zero();
            for l in 1..tree.bodies {
                g += w.pair[k].j[l] * w.b[j][l];
            }
            w.pair[k].k[j] = g;
            a += w.pair[k].j[j] * g;
        }
        w.pair[k].carried = carried;
        w.pair[k].inv = L::one() / a;
        w.pair[k].p = L::zero();
    }
}

/// One pass over the rows of the joints and of the pairs of cubes.
#[inline(always)]
pub(super) fn sweep<L: Lane>(tree: &Tree, p: &LaneParams<L>, switches: &Switches, w: &mut Work<L>) {
    let zero = L::zero();
    for k in 0..tree.pairs {
        if !w.pair[k].any {
            continue;
        }
        let mut rate = w.pair[k].carried;
        for j in 1..tree.bodies {
            rate += w.pair[k].j[j] * w.change[j];
        }
        let old = w.pair[k].p;
        let wanted = p.push * w.pair[k].depth;
        let new = (old + (wanted - rate) * w.pair[k].inv)
            .max(zero)
            .only(w.pair[k].active);
        w.pair[k].p = new;
        for j in 1..tree.bodies {
            w.change[j] += w.pair[k].k[j] * (new - old);
        }
    }
    for j in 1..tree.bodies {
        if !w.free[j].any() {
            continue;
        }
        let speed = w.start[j] + w.change[j];
        let old = w.motor[j];
        let own = w.b[j][j];
        // Lanes in which the joint is rigid have b = 0; their result is dropped below.
        let mut new = old + (w.target[j] - speed) / own;
        if switches.transmission {
            let soft = own + w.give[j];
            let low = old + (w.low[j] - speed - w.give[j] * old) / soft;
            let high = old + (w.high[j] - speed - w.give[j] * old) / soft;
            let loose = low.max(zero) + high.min(zero);
            new = loose.or_else(w.loose[j], new);
        }
        let new = new.clamp(-w.limit[j], w.limit[j]).or_else(w.free[j], old);
        let mut d = new - old;
        w.motor[j] = new;
        if switches.rub {
            let speed = speed + own * d;
            let rub = (w.rub[j] - speed / own)
                .clamp(-w.friction[j], w.friction[j])
                .or_else(w.free[j], w.rub[j]);
            d += rub - w.rub[j];
            w.rub[j] = rub;
        }
        for k in 1..tree.bodies {
            w.change[k] += w.b[k][j] * d;
        }
    }
}
