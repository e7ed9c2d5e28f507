//! Vectors and 3x3 matrices over lanes.

use crate::lane::Lane;

/// A vector per lane.
#[derive(Clone, Copy)]
pub(crate) struct V3<L> {
    pub(crate) x: L,
    pub(crate) y: L,
    pub(crate) z: L,
}

impl<L: Lane> V3<L> {
    #[inline(always)]
    pub(crate) fn new(x: L, y: L, z: L) -> Self {
        V3 { x, y, z }
    }
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        V3::new(L::zero(), L::zero(), L::zero())
    }
    #[inline(always)]
    pub(crate) fn splat(v: [f64; 3]) -> Self {
        V3::new(L::splat(v[0]), L::splat(v[1]), L::splat(v[2]))
    }
    #[inline(always)]
    pub(crate) fn add(self, o: Self) -> Self {
        V3::new(self.x + o.x, self.y + o.y, self.z + o.z)
    }
    #[inline(always)]
    pub(crate) fn sub(self, o: Self) -> Self {
        V3::new(self.x - o.x, self.y - o.y, self.z - o.z)
    }
    #[inline(always)]
    pub(crate) fn scale(self, s: L) -> Self {
        V3::new(self.x * s, self.y * s, self.z * s)
    }
    #[inline(always)]
    pub(crate) fn neg(self) -> Self {
        V3::new(-self.x, -self.y, -self.z)
    }
    #[inline(always)]
    pub(crate) fn dot(self, o: Self) -> L {
        self.x * o.x + self.y * o.y + self.z * o.z
    }
    #[inline(always)]
    pub(crate) fn cross(self, o: Self) -> Self {
        V3::new(
            self.y * o.z - self.z * o.y,
            self.z * o.x - self.x * o.z,
            self.x * o.y - self.y * o.x,
        )
    }
    /// `if mask { self } else { other }`.
    #[inline(always)]
    pub(crate) fn or_else(self, mask: L::Mask, o: Self) -> Self {
        V3::new(
            self.x.or_else(mask, o.x),
            self.y.or_else(mask, o.y),
            self.z.or_else(mask, o.z),
        )
    }
    #[inline(always)]
    pub(crate) fn only(self, mask: L::Mask) -> Self {
        V3::new(self.x.only(mask), self.y.only(mask), self.z.only(mask))
    }
}

/// A rotation per lane, by columns: the body's axes in the world.
#[derive(Clone, Copy)]
pub(crate) struct Rot<L> {
    pub(crate) c: [V3<L>; 3],
}

impl<L: Lane> Rot<L> {
    #[inline(always)]
    pub(crate) fn identity() -> Self {
        Rot {
            c: [
                V3::splat([1.0, 0.0, 0.0]),
                V3::splat([0.0, 1.0, 0.0]),
                V3::splat([0.0, 0.0, 1.0]),
            ],
        }
    }

    /// From a unit quaternion, w first.
    #[inline(always)]
    pub(crate) fn from_quaternion(q: [L; 4]) -> Self {
        let [w, x, y, z] = q;
        let (x2, y2, z2) = (x + x, y + y, z + z);
        let (xx, yy, zz) = (x * x2, y * y2, z * z2);
        let (xy, xz, yz) = (x * y2, x * z2, y * z2);
        let (wx, wy, wz) = (w * x2, w * y2, w * z2);
        let one = L::one();
        Rot {
            c: [
                V3::new(one - (yy + zz), xy + wz, xz - wy),
                V3::new(xy - wz, one - (xx + zz), yz + wx),
                V3::new(xz + wy, yz - wx, one - (xx + yy)),
            ],
        }
    }

    /// The vector with body coordinates `v`, in the world.
    #[inline(always)]
    pub(crate) fn apply(&self, v: [f64; 3]) -> V3<L> {
        let [a, b, c] = [L::splat(v[0]), L::splat(v[1]), L::splat(v[2])];
        self.c[0]
            .scale(a)
            .add(self.c[1].scale(b))
            .add(self.c[2].scale(c))
    }

    /// The vector with body coordinates `v`, one per lane, in the world.
    #[inline(always)]
    pub(crate) fn apply_lanes(&self, v: V3<L>) -> V3<L> {
        self.c[0]
            .scale(v.x)
            .add(self.c[1].scale(v.y))
            .add(self.c[2].scale(v.z))
    }

    /// World height of the vector with body coordinates `v`.
    #[inline(always)]
    pub(crate) fn apply_z(&self, v: [f64; 3]) -> L {
        self.c[0].z * L::splat(v[0]) + self.c[1].z * L::splat(v[1]) + self.c[2].z * L::splat(v[2])
    }

    /// This rotation followed by a turn about body axis `axis` (world direction `world`) with the given sine and cosine (Rodrigues).
    #[inline(always)]
    pub(crate) fn turned(&self, axis: [f64; 3], world: V3<L>, sin: L, cos: L) -> Self {
        let versine = L::one() - cos;
        let mut out = *self;
        for (&p, (turned, axis)) in self.c.iter().zip(out.c.iter_mut().zip(axis)) {
            *turned = p
                .scale(cos)
                .add(world.cross(p).scale(sin))
                .add(world.scale(versine * L::splat(axis)));
        }
        out
    }
}

/// A symmetric 3x3 matrix per lane.
#[derive(Clone, Copy)]
pub(crate) struct Sym<L> {
    pub(crate) xx: L,
    pub(crate) yy: L,
    pub(crate) zz: L,
    pub(crate) xy: L,
    pub(crate) xz: L,
    pub(crate) yz: L,
}

impl<L: Lane> Sym<L> {
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        let z = L::zero();
        Sym {
            xx: z,
            yy: z,
            zz: z,
            xy: z,
            xz: z,
            yz: z,
        }
    }
    #[inline(always)]
    pub(crate) fn add(self, o: Self) -> Self {
        Sym {
            xx: self.xx + o.xx,
            yy: self.yy + o.yy,
            zz: self.zz + o.zz,
            xy: self.xy + o.xy,
            xz: self.xz + o.xz,
            yz: self.yz + o.yz,
        }
    }
    #[inline(always)]
    pub(crate) fn mul(&self, v: V3<L>) -> V3<L> {
        V3::new(
            self.xx * v.x + self.xy * v.y + self.xz * v.z,
            self.xy * v.x + self.yy * v.y + self.yz * v.z,
            self.xz * v.x + self.yz * v.y + self.zz * v.z,
        )
    }
    /// `a 1 + b n n^T`.
    #[inline(always)]
    pub(crate) fn axial(a: L, b: L, n: V3<L>) -> Self {
        let m = n.scale(b);
        Sym {
            xx: a + m.x * n.x,
            yy: a + m.y * n.y,
            zz: a + m.z * n.z,
            xy: m.x * n.y,
            xz: m.x * n.z,
            yz: m.y * n.z,
        }
    }
    /// Inertia about a point that lies at `-d` from the present one, of a body with mass `m` and first moment `h` about the present one.
    #[inline(always)]
    pub(crate) fn shifted(self, m: L, h: V3<L>, d: V3<L>) -> Self {
        let hd = h.dot(d);
        let e = d.scale(m);
        let trace = hd + hd + e.dot(d);
        Sym {
            xx: self.xx + (trace - (h.x * d.x + h.x * d.x + e.x * d.x)),
            yy: self.yy + (trace - (h.y * d.y + h.y * d.y + e.y * d.y)),
            zz: self.zz + (trace - (h.z * d.z + h.z * d.z + e.z * d.z)),
            xy: self.xy - (h.x * d.y + h.y * d.x + e.x * d.y),
            xz: self.xz - (h.x * d.z + h.z * d.x + e.x * d.z),
            yz: self.yz - (h.y * d.z + h.z * d.y + e.y * d.z),
        }
    }
    /// Inverse of a positive definite matrix, by cofactors.
    #[inline(always)]
    pub(crate) fn inverse(&self) -> Self {
        let cxx = self.yy * self.zz - self.yz * self.yz;
        let cxy = self.xz * self.yz - self.xy * self.zz;
        let cxz = self.xy * self.yz - self.xz * self.yy;
        let r = L::one() / (self.xx * cxx + self.xy * cxy + self.xz * cxz);
        Sym {
            xx: cxx * r,
            yy: (self.xx * self.zz - self.xz * self.xz) * r,
            zz: (self.xx * self.yy - self.xy * self.xy) * r,
            xy: cxy * r,
            xz: cxz * r,
            yz: (self.xy * self.xz - self.xx * self.yz) * r,
        }
    }
    #[inline(always)]
    pub(crate) fn scale(self, s: L) -> Self {
        Sym {
            xx: self.xx * s,
            yy: self.yy * s,
            zz: self.zz * s,
            xy: self.xy * s,
            xz: self.xz * s,
            yz: self.yz * s,
        }
    }
}
