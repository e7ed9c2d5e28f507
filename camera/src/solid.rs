//! Convex solids as points on their surface.

/// Position and orientation of a body in the world (z up, ground z = 0).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Origin of the body in the world.
    pub position_m: [f32; 3],
    /// Rows of the rotation matrix body -> world.
    pub rotation: [[f32; 3]; 3],
}

impl Pose {
    /// Body frame on the world frame.
    pub const IDENTITY: Self = Self {
        position_m: [0.0; 3],
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    };

    pub(crate) fn apply(&self, p: [f32; 3]) -> [f32; 3] {
        let mut world = self.position_m;
        for (w, row) in world.iter_mut().zip(&self.rotation) {
            *w += row[0] * p[0] + row[1] * p[1] + row[2] * p[2];
        }
        world
    }
}

/// A convex solid fixed to a body: the hull of its points, in the body frame, in metres.
#[derive(Clone, Debug, PartialEq)]
pub struct Solid {
    /// Body the solid moves with.
    pub body: usize,
    /// Surface points whose hull is the solid.
    pub points_m: Vec<[f32; 3]>,
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
        centre_m: [f32; 3],
        normal: [f32; 3],
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
                let (a, b) = (out * libm::cosf(azimuth), out * libm::sinf(azimuth));
                let direction: [f32; 3] =
                    core::array::from_fn(|i| up * normal[i] + a * u[i] + b * v[i]);
                let largest = direction.iter().fold(0.0f32, |m, d| m.max(d.abs()));
                let reach = radius_m.min(half_cube_m / largest);
                points_m.push(core::array::from_fn(|i| centre_m[i] + reach * direction[i]));
            }
        }
        Self { body, points_m }
    }
}

/// Two unit vectors that complete `n` to an orthogonal frame.
fn tangents(n: [f32; 3]) -> ([f32; 3], [f32; 3]) {
    let helper = if n[0].abs() < 0.9 {
        [1.0, 0.0, 0.0]
    } else {
        [0.0, 1.0, 0.0]
    };
    let u = unit(cross(n, helper));
    (u, cross(n, u))
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn unit(a: [f32; 3]) -> [f32; 3] {
    let length = (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt();
    a.map(|c| c / length)
}
