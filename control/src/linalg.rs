//! Three-vectors, rotations and rigid poses in f32. Operations are evaluated left to right, so results are the same bits everywhere.

use crate::math;
use core::ops::{Add, Mul, Neg, Sub};

/// A vector in R^3; unit and frame are the user's.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Vec3 {
    /// First component.
    pub x: f32,
    /// Second component.
    pub y: f32,
    /// Third component.
    pub z: f32,
}

impl Vec3 {
    /// The zero vector.
    pub const ZERO: Vec3 = Vec3::new(0.0, 0.0, 0.0);

    /// A vector from its components.
    #[must_use]
    pub const fn new(x: f32, y: f32, z: f32) -> Self {
        Vec3 { x, y, z }
    }

    /// Scalar product.
    #[must_use]
    pub fn dot(self, other: Vec3) -> f32 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Vector product.
    #[must_use]
    pub fn cross(self, other: Vec3) -> Vec3 {
        Vec3::new(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )
    }

    /// Squared length.
    #[must_use]
    pub fn norm_squared(self) -> f32 {
        self.dot(self)
    }

    /// Length.
    #[must_use]
    pub fn norm(self) -> f32 {
        math::sqrt(self.norm_squared())
    }

    /// The components as an array.
    #[must_use]
    pub const fn to_array(self) -> [f32; 3] {
        [self.x, self.y, self.z]
    }
}

impl Add for Vec3 {
    type Output = Vec3;
    fn add(self, o: Vec3) -> Vec3 {
        Vec3::new(self.x + o.x, self.y + o.y, self.z + o.z)
    }
}

impl Sub for Vec3 {
    type Output = Vec3;
    fn sub(self, o: Vec3) -> Vec3 {
        Vec3::new(self.x - o.x, self.y - o.y, self.z - o.z)
    }
}

impl Neg for Vec3 {
    type Output = Vec3;
    fn neg(self) -> Vec3 {
        Vec3::new(-self.x, -self.y, -self.z)
    }
}

impl Mul<f32> for Vec3 {
    type Output = Vec3;
    fn mul(self, k: f32) -> Vec3 {
        Vec3::new(self.x * k, self.y * k, self.z * k)
    }
}

/// A rotation matrix by its columns: the images of the unit vectors.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Rot3 {
    /// Image of x.
    pub x: Vec3,
    /// Image of y.
    pub y: Vec3,
    /// Image of z.
    pub z: Vec3,
}

impl Default for Rot3 {
    fn default() -> Self {
        Rot3::IDENTITY
    }
}

impl Rot3 {
    /// No rotation.
    pub const IDENTITY: Rot3 = Rot3 {
        x: Vec3::new(1.0, 0.0, 0.0),
        y: Vec3::new(0.0, 1.0, 0.0),
        z: Vec3::new(0.0, 0.0, 1.0),
    };

    /// Right-hand rotation by `angle_rad` about the unit vector `axis` (Rodrigues).
    #[must_use]
    pub fn about(axis: Vec3, angle_rad: f32) -> Rot3 {
        let (s, c) = math::sin_cos(angle_rad);
        let column = |e: Vec3, along: f32| e * c + axis.cross(e) * s + axis * (along * (1.0 - c));
        Rot3 {
            x: column(Rot3::IDENTITY.x, axis.x),
            y: column(Rot3::IDENTITY.y, axis.y),
            z: column(Rot3::IDENTITY.z, axis.z),
        }
    }

    /// This rotation after a turn about the own x axis.
    #[must_use]
    pub fn turned_about_x(&self, angle_rad: f32) -> Rot3 {
        let (s, c) = math::sin_cos(angle_rad);
        Rot3 {
            x: self.x,
            y: self.y * c + self.z * s,
            z: self.z * c - self.y * s,
        }
    }

    /// This rotation after a turn about the own diagonal (1,1,1)/sqrt 3, whose matrix is circulant.
    #[must_use]
    pub fn turned_about_diagonal(&self, angle_rad: f32) -> Rot3 {
        const THIRD: f32 = 1.0 / 3.0;
        const INV_SQRT_3: f32 = 0.577_350_26;
        let (s, c) = math::sin_cos(angle_rad);
        let same = THIRD + 2.0 * THIRD * c;
        let (even, odd) = (THIRD - THIRD * c, INV_SQRT_3 * s);
        let (before, after) = (even - odd, even + odd);
        Rot3 {
            x: self.x * same + self.y * after + self.z * before,
            y: self.x * before + self.y * same + self.z * after,
            z: self.x * after + self.y * before + self.z * same,
        }
    }

    /// The rotated vector.
    #[must_use]
    pub fn apply(&self, v: Vec3) -> Vec3 {
        self.x * v.x + self.y * v.y + self.z * v.z
    }

    /// The vector turned back.
    #[must_use]
    pub fn apply_inverse(&self, v: Vec3) -> Vec3 {
        Vec3::new(self.x.dot(v), self.y.dot(v), self.z.dot(v))
    }

    /// First `other`, then `self`.
    #[must_use]
    pub fn then_outer(&self, other: &Rot3) -> Rot3 {
        Rot3 {
            x: self.apply(other.x),
            y: self.apply(other.y),
            z: self.apply(other.z),
        }
    }

    /// The inverse rotation.
    #[must_use]
    pub fn transposed(&self) -> Rot3 {
        Rot3 {
            x: Vec3::new(self.x.x, self.y.x, self.z.x),
            y: Vec3::new(self.x.y, self.y.y, self.z.y),
            z: Vec3::new(self.x.z, self.y.z, self.z.z),
        }
    }

    /// Rotation of a unit quaternion (w, x, y, z), Hamilton; of four zeros, none.
    #[must_use]
    pub fn from_quaternion([w, x, y, z]: [f32; 4]) -> Rot3 {
        Rot3 {
            x: Vec3::new(
                1.0 - 2.0 * (y * y + z * z),
                2.0 * (x * y + w * z),
                2.0 * (x * z - w * y),
            ),
            y: Vec3::new(
                2.0 * (x * y - w * z),
                1.0 - 2.0 * (x * x + z * z),
                2.0 * (y * z + w * x),
            ),
            z: Vec3::new(
                2.0 * (x * z + w * y),
                2.0 * (y * z - w * x),
                1.0 - 2.0 * (x * x + y * y),
            ),
        }
    }

    /// Unit quaternion (w, x, y, z), Hamilton, w >= 0.
    #[must_use]
    pub fn to_quaternion(&self) -> [f32; 4] {
        let (m, n, o) = (self.x, self.y, self.z);
        // Shepperd's method: divide by the largest of the four candidates.
        let candidates = [
            1.0 + m.x + n.y + o.z,
            1.0 + m.x - n.y - o.z,
            1.0 - m.x + n.y - o.z,
            1.0 - m.x - n.y + o.z,
        ];
        let mut best = 0;
        let mut largest = f32::NEG_INFINITY;
        for (i, c) in candidates.iter().enumerate() {
            if *c > largest {
                largest = *c;
                best = i;
            }
        }
        let root = math::sqrt(largest.max(0.0));
        let k = 0.5 / root;
        let [wx, wy, wz] = [n.z - o.y, o.x - m.z, m.y - n.x];
        let [xy, xz, yz] = [m.y + n.x, o.x + m.z, n.z + o.y];
        let q = match best {
            0 => [0.5 * root, wx * k, wy * k, wz * k],
            1 => [wx * k, 0.5 * root, xy * k, xz * k],
            2 => [wy * k, xy * k, 0.5 * root, yz * k],
            _ => [wz * k, xz * k, yz * k, 0.5 * root],
        };
        if q[0] < 0.0 { q.map(|v| -v) } else { q }
    }
}

/// Position and orientation of a body frame in a reference frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Pose {
    /// Origin of the body frame in the reference frame, m.
    pub position_m: Vec3,
    /// Body frame to reference frame.
    pub rotation: Rot3,
}

impl Pose {
    /// A point of the body frame (m) in the reference frame.
    #[must_use]
    pub fn transform(&self, point_m: Vec3) -> Vec3 {
        self.position_m + self.rotation.apply(point_m)
    }

    /// The pose `inner`, given in this body's frame, in the reference frame.
    #[must_use]
    pub fn compose(&self, inner: &Pose) -> Pose {
        Pose {
            position_m: self.transform(inner.position_m),
            rotation: self.rotation.then_outer(&inner.rotation),
        }
    }

    /// The reference frame as seen from this body.
    #[must_use]
    pub fn inverse(&self) -> Pose {
        Pose {
            position_m: -self.rotation.apply_inverse(self.position_m),
            rotation: self.rotation.transposed(),
        }
    }
}
