//! Convex solids as points on their surface.

use control::linalg::Vec3;
use control::robot::RobotModel;

/// A convex solid fixed to a body: the hull of its points, in the body frame, in metres.
#[derive(Clone, Debug, PartialEq)]
pub struct Solid {
    /// Body the solid moves with.
    pub body: usize,
    /// Surface points whose hull is the solid.
    pub points_m: Vec<Vec3>,
}

/// Rings of sample directions of a half-sphere: with these counts the outline of a whole cube has 99 % of its true area.
const RINGS: usize = 12;
/// Directions per ring.
const SECTORS: usize = 32;

impl Solid {
    /// A Roombots half-sphere: ball of `radius_m` about `centre_m`, cut by the cube faces at `half_cube_m` and by the
    /// plane through the centre with unit `normal`; the side that `normal` points to is kept.
    #[must_use]
    pub fn half_sphere(
        body: usize,
        centre_m: Vec3,
        normal: Vec3,
        radius_m: f32,
        half_cube_m: f32,
    ) -> Self {
        let (u, v) = tangents(normal);
        let mut points_m = Vec::with_capacity(RINGS * SECTORS + 1);
        for ring in 0..=RINGS {
            let elevation = ring as f32 / RINGS as f32 * core::f32::consts::FRAC_PI_2;
            let (up, out) = (libm::sinf(elevation), libm::cosf(elevation));
            let sectors = if ring == RINGS { 1 } else { SECTORS };
            for sector in 0..sectors {
                let azimuth = sector as f32 / SECTORS as f32 * core::f32::consts::TAU;
                let d =
                    normal * up + u * (out * libm::cosf(azimuth)) + v * (out * libm::sinf(azimuth));
                let largest = d.x.abs().max(d.y.abs()).max(d.z.abs());
                points_m.push(centre_m + d * radius_m.min(half_cube_m / largest));
            }
        }
        Self { body, points_m }
    }

    /// The eight half-spheres of a meta-module, proximal before distal, cube 1 to 4; body 3 carries two.
    #[must_use]
    pub fn meta_module(robot: &RobotModel) -> Vec<Self> {
        let origins = robot.body_origins_m();
        // Joint of each cube's diagonal; the joint's proximal body carries the proximal half.
        let cubes = [0usize, 2, 3, 5];
        let halves = cubes
            .iter()
            .flat_map(|&joint| [(joint, joint, -1.0), (joint, joint + 1, 1.0)]);
        halves
            .map(|(joint, body, side)| {
                let centre = robot.axis_points_m()[joint] - origins[body];
                let mut half = Self::half_sphere(
                    body,
                    Vec3::ZERO,
                    RobotModel::DIAGONAL * side,
                    robot.ball_radius_m(),
                    0.5 * robot.cube_m(),
                );
                for p in &mut half.points_m {
                    // Module B, with its faces, is turned against module A by the twist.
                    let turned = if joint >= 3 {
                        robot.twist().apply(*p)
                    } else {
                        *p
                    };
                    *p = centre + turned;
                }
                half
            })
            .collect()
    }
}

/// Two unit vectors that complete `n` to an orthogonal frame.
fn tangents(n: Vec3) -> (Vec3, Vec3) {
    let x = Vec3::new(1.0, 0.0, 0.0);
    let helper = if n.x.abs() < 0.9 {
        x
    } else {
        Vec3::new(0.0, 1.0, 0.0)
    };
    let across = n.cross(helper);
    let u = across * (1.0 / across.norm());
    (u, n.cross(u))
}
