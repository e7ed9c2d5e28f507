//! One time step of the seven-body tree, for any lane type.
//!
//! Coordinates. Let m be the robot's mass, c its centre of mass and I_c its inertia about c as if all joints were rigid. A joint speed
//! v_j alone would carry linear momentum lin_j v_j and angular momentum l_j v_j about c. With V the velocity of the centre of mass
//! and W = I_c^-1 times the angular momentum, the kinetic energy is
//!
//! ```text
//! 2 T = m V.V + W.I_c W + v^T S v,    S_jk = M_jk - lin_j.lin_k / m - l_j.I_c^-1 l_k
//! ```
//!
//! so the mass matrix is block diagonal in (V, W, v). A motor changes v alone, never V or W: as long as a servo holds its speed, its
//! joint is rigid for everything that touches the ground, and a contact needs 3 + 3 coordinates whatever the number of joints.
//!
//! A step: kinematics -> inertias and S -> bias forces -> contacts -> solve -> integrate (semi-implicit Euler). Solve: joints whose motor
//! can hold the wanted speed are rigid; the others ("free") are rows with a torque limit beside the contact rows, all by projected
//! Gauss-Seidel with warm start. Afterwards the torque of every rigid joint is checked against its limit; where it is broken, the lane is
//! solved again with that joint free.

// Loops run over body indices that address several tables at once; iterators would hide that, and must not be left uninlined here.
#![allow(clippy::needless_range_loop)]

mod contact;
mod dynamics;
mod energy;
mod free;
mod params;
mod selfcontact;
mod solve;
mod state;
mod tree;

pub(crate) use energy::energy;
pub(crate) use params::{LaneParams, Switches};
pub(crate) use state::{State, Work};
pub(crate) use tree::Tree;

use crate::lane::Lane;

/// What drives the joints during one step, by body index (entry 0 unused).
pub(crate) struct Command<L> {
    /// Set-points of the servos, rad. Ignored where `speed_given`.
    pub set_point: [L; crate::robot::MAX_BODIES],
    /// Speeds to hold instead of the servo law, rad/s.
    pub speed: [L; crate::robot::MAX_BODIES],
    /// Torques added to the joints from outside, N m.
    pub torque: [L; crate::robot::MAX_BODIES],
    /// One where `speed` replaces the servo law.
    pub speed_given: [L; crate::robot::MAX_BODIES],
    /// One where the speed is that of the motor and the link hangs on it by its transmission.
    pub hangs: [L; crate::robot::MAX_BODIES],
    /// Factor on the torque limit: 1 the motor's own, 0 no motor.
    pub limit_factor: [L; crate::robot::MAX_BODIES],
}

impl<L: Lane> Command<L> {
    pub(crate) fn hold() -> Self {
        let zero = [L::zero(); crate::robot::MAX_BODIES];
        Command {
            set_point: zero,
            speed: zero,
            torque: zero,
            speed_given: zero,
            hangs: zero,
            limit_factor: [L::one(); crate::robot::MAX_BODIES],
        }
    }
}

/// A part of a step, for profiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Set-points, noise, samples.
    Control,
    /// Sines, rotations, positions.
    Kinematics,
    /// Inertias, couplings and the matrix S.
    MassMatrix,
    /// Velocities, gravity and velocity products, servo.
    Bias,
    /// Contact points with the ground.
    Contacts,
    /// Cubes against each other.
    SelfContact,
    /// Gauss-Seidel and motor torques.
    Solver,
    /// New velocities and positions, check for numbers.
    Integration,
}

/// Is told when a stage ends. It owns the clock; the engine has none.
pub trait Probe {
    /// The stage has just ended.
    fn ended(&mut self, stage: Stage);
}

/// Listens to nothing and costs nothing.
pub(crate) struct NoProbe;

impl Probe for NoProbe {
    #[inline(always)]
    fn ended(&mut self, _: Stage) {}
}

/// One step. `switches` says which effects any lane of the batch uses; a lane with neutral parameters gives the same bits either way.
#[inline(always)]
pub(crate) fn step<L: Lane>(
    tree: &Tree,
    p: &LaneParams<L>,
    switches: &Switches,
    command: &Command<L>,
    s: &mut State<L>,
    w: &mut Work<L>,
    probe: &mut impl Probe,
) {
    dynamics::kinematics(tree, s, w);
    probe.ended(Stage::Kinematics);
    dynamics::inertias(tree, p, w);
    dynamics::couplings(tree, w, p);
    probe.ended(Stage::MassMatrix);
    dynamics::velocities(tree, s, w);
    dynamics::bias(tree, p, s, w);
    dynamics::servo(tree, p, switches, command, s, w);
    probe.ended(Stage::Bias);
    contact::detect(tree, p, s, w);
    probe.ended(Stage::Contacts);
    selfcontact::detect(tree, s, w);
    probe.ended(Stage::SelfContact);
    solve::solve(tree, p, switches, s, w);
    probe.ended(Stage::Solver);
    dynamics::integrate(tree, p, switches, s, w);
}
