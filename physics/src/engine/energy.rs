//! Energy of a state, from masses and velocities alone: a check that shares nothing with the solver.

use super::dynamics;
use super::params::LaneParams;
use super::state::{State, Work};
use super::tree::Tree;

/// Kinetic and potential energy, J, of the half-spheres as rigid bodies.
pub(crate) fn energy(tree: &Tree, p: &LaneParams<f64>, s: &State<f64>) -> (f64, f64) {
    let mut w = Work::<f64>::new();
    dynamics::kinematics(tree, s, &mut w);
    dynamics::inertias(tree, p, &mut w);
    let (mut kinetic, mut potential) = (0.0, 0.0);
    w.omega[0] = s.angular;
    w.vel[0] = s.linear;
    for b in 0..tree.bodies {
        if b > 0 {
            let parent = tree.parent[b];
            w.vel[b] = w.vel[parent].add(w.omega[parent].cross(w.d[b]));
            w.omega[b] = w.omega[parent].add(w.axis[b].scale(s.speed[b]));
        }
        let (v, o) = (w.vel[b], w.omega[b]);
        kinetic += 0.5 * w.m[b] * v.dot(v) + v.dot(o.cross(w.h[b])) + 0.5 * o.dot(w.i[b].mul(o));
        let at = s.position.add(w.p[b]);
        potential -= p.gravity.dot(at.scale(w.m[b]).add(w.h[b]));
    }
    (kinetic, potential)
}
