//! The real shape of a cube: two half-spheres, each a ball cut by the cube's faces and by the plane across the body diagonal.
//!
//! The two halves of one cube turn against each other about the diagonal. Each half owns the three flats of its own side. A flat
//! spans 27.5 deg about its normal, and the cut plane lies 35.3 deg from it. So no flat reaches the cut plane and no two flats meet,
//! at any angle between the halves. Both halves together are therefore one convex body: a ball with six round flats. Its support
//! function is closed-form, and its distance to another such body equals the smallest distance over the four pairs of halves.

use crate::linalg::{Rot3, Vec3};
use crate::math;
use crate::robot::RobotModel;

/// One of the eight half-spheres as a set of constraints in the frame of its body: every point p with `|p - centre| <= ball`,
/// `normal . (p - centre) <= height` for each of the six cube faces, and `cut_normal . (p - centre) <= 0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSphere {
    /// Body 0..6 it is fixed to; body 3 has two.
    pub body: u8,
    /// Cube 0..3, that is C1..C4.
    pub cube: u8,
    /// It lies on the side of C1's free end.
    pub proximal: bool,
    /// Cube centre in the frame of the body, m.
    pub centre_m: Vec3,
    /// Outward unit normal of the cut across the body diagonal.
    pub cut_normal: Vec3,
    /// Outward unit normals of the three faces that cut this half; the other three do not touch it.
    pub flat_normals: [Vec3; 3],
    /// Distance of the faces from the centre, m.
    pub height_m: f32,
    /// Radius of the ball, m.
    pub ball_m: f32,
}

/// The eight half-spheres, proximal before distal, C1 to C4. Body frames as in [`crate::kinematics`].
#[must_use]
pub fn half_spheres(model: &RobotModel) -> [HalfSphere; 8] {
    let offset_m = 0.5 * model.cube_m();
    let make = |body: u8, cube: u8, proximal: bool| {
        let cube_axes = if cube < 2 {
            Rot3::IDENTITY
        } else {
            *model.twist()
        };
        let side = if proximal { -1.0 } else { 1.0 };
        let along = match (body, cube) {
            (3, 1) => -offset_m,
            (3, 2) => offset_m,
            _ => 0.0,
        };
        HalfSphere {
            body,
            cube,
            proximal,
            centre_m: Vec3::new(along, 0.0, 0.0),
            cut_normal: cube_axes.apply(RobotModel::DIAGONAL) * -side,
            flat_normals: [cube_axes.x * side, cube_axes.y * side, cube_axes.z * side],
            height_m: offset_m,
            ball_m: model.ball_radius_m(),
        }
    };
    [
        make(0, 0, true),
        make(1, 0, false),
        make(2, 1, true),
        make(3, 1, false),
        make(3, 2, true),
        make(4, 2, false),
        make(5, 3, true),
        make(6, 3, false),
    ]
}

/// Dimensions of the flats, from the robot model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FlatShape {
    /// Radius R of the ball, m.
    pub(crate) ball_m: f32,
    /// Distance h of a flat from the centre, m.
    pub(crate) height_m: f32,
    /// Radius of a flat's rim, sqrt(R^2 - h^2), m.
    pub(crate) rim_m: f32,
    /// Cosine of the half-angle under which the centre sees a flat, h / R.
    cos_rim: f32,
}

impl FlatShape {
    pub(crate) fn of(model: &RobotModel) -> Self {
        let ball_m = model.ball_radius_m();
        let height_m = 0.5 * model.cube_m();
        let rim_m = math::sqrt((ball_m * ball_m - height_m * height_m).max(0.0));
        FlatShape {
            ball_m,
            height_m,
            rim_m,
            cos_rim: height_m / ball_m,
        }
    }
}

/// The flat that faces a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ActiveFlat {
    /// Outer unit normal.
    pub(crate) normal: Vec3,
    /// Cosine and sine of the angle between normal and direction.
    pub(crate) cos: f32,
    pub(crate) sin: f32,
    /// The flat belongs to the proximal half.
    pub(crate) proximal: bool,
}

/// A whole cube: centre and the orientations of its two halves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cube {
    /// Centre, m.
    pub(crate) centre_m: Vec3,
    /// Cube axes as carried by the proximal half (its flats look along -x, -y, -z).
    pub(crate) proximal: Rot3,
    /// Cube axes as carried by the distal half (its flats look along +x, +y, +z).
    pub(crate) distal: Rot3,
    /// Along the body diagonal about which the halves turn, towards the distal one; not of unit length.
    diagonal: Vec3,
}

impl Cube {
    fn new(centre_m: Vec3, proximal: Rot3, distal: Rot3) -> Self {
        Cube {
            centre_m,
            proximal,
            distal,
            diagonal: distal.x + distal.y + distal.z,
        }
    }

    /// The flat whose cone holds the unit direction `v`, if there is one. It lies on the side of the cut that `v` points to.
    pub(crate) fn active_flat(&self, shape: &FlatShape, v: Vec3) -> Option<ActiveFlat> {
        let proximal = self.proximal_side(v);
        let (half, sign) = if proximal {
            (&self.proximal, -1.0)
        } else {
            (&self.distal, 1.0)
        };
        for axis in [half.x, half.y, half.z] {
            let cos = sign * axis.dot(v);
            if cos > shape.cos_rim {
                // Comparisons, because a Cortex-M4 has no minimum of floats and calls a function.
                let cos = if cos > 1.0 { 1.0 } else { cos };
                let rest = 1.0 - cos * cos;
                let sin_squared = if rest > 0.0 { rest } else { 0.0 };
                let sin = sin_squared * math::inverse_sqrt(sin_squared);
                return Some(ActiveFlat {
                    normal: axis * sign,
                    cos,
                    sin,
                    proximal,
                });
            }
        }
        None
    }

    /// Whether the direction `v` points to the proximal side of the cut; both halves carry the same diagonal.
    pub(crate) fn proximal_side(&self, v: Vec3) -> bool {
        self.diagonal.dot(v) < 0.0
    }
}

impl FlatShape {
    /// Point of a cube furthest along the unit vector `v`, relative to its centre, m; `flat` is the one active along `v`.
    pub(crate) fn support_m(&self, flat: Option<&ActiveFlat>, v: Vec3) -> Vec3 {
        let Some(flat) = flat else {
            return v * self.ball_m;
        };
        // The rim point: h n + rim (v - n cos) / sin.
        if flat.sin > 1e-6 {
            let along = self.rim_m / flat.sin;
            v * along + flat.normal * (self.height_m - flat.cos * along)
        } else {
            flat.normal * self.height_m
        }
    }
}

/// Largest value of `v . p` over the cube for a fixed unit `v`, relative to the centre, while every flat normal turns by at most
/// `turn_rad` (proximal, distal): an upper bound, m.
///
/// With θ the angle between normal and `v` and α the half-angle of the flat the support is R cos(α - θ), concave and rising in θ, so
/// its tangent bounds it.
pub(crate) fn support_bound_m(shape: &FlatShape, flat: Option<&ActiveFlat>, turn_rad: f32) -> f32 {
    match flat {
        None => shape.ball_m,
        Some(flat) => {
            let here = shape.height_m * flat.cos + shape.rim_m * flat.sin;
            let slope = shape.rim_m * flat.cos - shape.height_m * flat.sin;
            (here + slope.max(0.0) * turn_rad).min(shape.ball_m)
        }
    }
}

/// Cubes C1 and C4 in the frame of body 3 (origin midway between C2 and C3), and the arms that carry them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct EndCubes {
    /// Bodies 0 (proximal) and 1 (distal).
    pub(crate) first: Cube,
    /// Bodies 5 (proximal) and 6 (distal).
    pub(crate) last: Cube,
}

/// Centres of C1 and C4 in the frame of body 3 with the cube axes as carried by bodies 2 and 4.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Arms {
    pub(crate) first_m: Vec3,
    pub(crate) last_m: Vec3,
    body2: Rot3,
    body4: Rot3,
}

impl Arms {
    /// Depends on A.M2 and B.M0 alone.
    pub(crate) fn at(model: &RobotModel, q_am2: f32, q_bm0: f32) -> Arms {
        let s = model.cube_m();
        let body2 = Rot3::IDENTITY.turned_about_diagonal(-q_am2);
        // In the twisted frame of module B its diagonal is (1,1,1)/sqrt 3 too.
        let body4 = model.twist().turned_about_diagonal(q_bm0);
        let first_m = Vec3::new(-0.5 * s, 0.0, 0.0) - body2.x * s;
        let last_m = Vec3::new(0.5 * s, 0.0, 0.0) + body4.x * s;
        Arms {
            first_m,
            last_m,
            body2,
            body4,
        }
    }

    /// C1 to C4, m.
    pub(crate) fn span_m(&self) -> Vec3 {
        self.last_m - self.first_m
    }

    /// Velocity of [`Arms::span_m`] when A.M2 and B.M0 turn at the given rates, m per unit of time.
    pub(crate) fn span_rate(&self, model: &RobotModel, rate_am2: f32, rate_bm0: f32) -> Vec3 {
        let [_, _, axis_a, axis_b, _, _] = *model.axes();
        let s = model.cube_m();
        // C1 turns by -q about axis_a through C2, C4 by +q about axis_b through C3.
        let first = axis_a.cross(self.body2.x * -s) * -rate_am2;
        let last = axis_b.cross(self.body4.x * s) * rate_bm0;
        last - first
    }

    /// The two end cubes with all their flats; the other four joints only turn the flats.
    pub(crate) fn end_cubes(&self, q_rad: &[f32; 6]) -> EndCubes {
        let [q0, q1, _, _, q4, q5] = *q_rad;
        let body1 = self.body2.turned_about_x(-q1);
        let body0 = body1.turned_about_diagonal(-q0);
        let body5 = self.body4.turned_about_x(q4);
        let body6 = body5.turned_about_diagonal(q5);
        EndCubes {
            first: Cube::new(self.first_m, body0, body1),
            last: Cube::new(self.last_m, body5, body6),
        }
    }
}
