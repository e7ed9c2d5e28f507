//! Forward kinematics of the meta-module: seven body poses from six joint angles.
//!
//! Frames: body frames are parallel to the world at home; origins are C1 for bodies 0 and 1, C2 for 2, the midpoint of C2 and C3 for
//! 3, C3 for 4, C4 for 5 and 6. A positive angle turns the distal body right-handed against the proximal one.

use crate::linalg::{Pose, Rot3, Vec3};
use crate::robot::{BODIES, JOINTS, RobotModel};

/// Poses of the seven bodies in one reference frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Poses {
    bodies: [Pose; BODIES],
    half_cube_m: f32,
}

impl Poses {
    /// Poses of body 0..6.
    #[must_use]
    pub const fn bodies(&self) -> &[Pose; BODIES] {
        &self.bodies
    }

    /// Centres of cubes C1..C4, m.
    #[must_use]
    pub fn cube_centres_m(&self) -> [Vec3; 4] {
        let [b0, _, b2, _, b4, _, b6] = &self.bodies;
        [b0.position_m, b2.position_m, b4.position_m, b6.position_m]
    }

    /// Centre of the end face of cube C4 (distal, +x at home), m.
    #[must_use]
    pub fn end_face_m(&self) -> Vec3 {
        let [.., end] = &self.bodies;
        end.transform(Vec3::new(self.half_cube_m, 0.0, 0.0))
    }

    /// The same configuration with the given body at `pose` in a new reference frame (body 3 at its world pose, for example).
    ///
    /// A body index above 6 is taken as 6.
    #[must_use]
    pub fn rebased(&self, body: usize, pose: &Pose) -> Poses {
        let [.., last] = &self.bodies;
        let base = self.bodies.get(body).unwrap_or(last);
        let shift = pose.compose(&base.inverse());
        Poses {
            bodies: self.bodies.map(|b| shift.compose(&b)),
            half_cube_m: self.half_cube_m,
        }
    }
}

/// Body poses at joint angles `q_rad`, body 0 at its home frame (origin C1, axes of the world).
///
/// The result is finite for finite angles; angles may be multi-turn.
#[must_use]
pub fn forward(model: &RobotModel, q_rad: &[f32; JOINTS]) -> Poses {
    let origins = model.body_origins_m();
    let points = model.axis_points_m();
    let mut bodies = [Pose::default(); BODIES];
    let mut position = Vec3::ZERO;
    let mut rotation = Rot3::IDENTITY;
    let [first, distal @ ..] = &origins;
    let mut origin = *first;
    let joints = model.axes().iter().zip(&points).zip(q_rad).zip(distal);
    for (pose, (((axis, point), q), next_origin)) in bodies.iter_mut().skip(1).zip(joints) {
        let pivot = position + rotation.apply(*point - origin);
        rotation = rotation.then_outer(&Rot3::about(*axis, *q));
        position = pivot + rotation.apply(*next_origin - *point);
        origin = *next_origin;
        *pose = Pose {
            position_m: position,
            rotation,
        };
    }
    Poses {
        bodies,
        half_cube_m: 0.5 * model.cube_m(),
    }
}
