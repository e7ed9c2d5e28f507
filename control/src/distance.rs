//! Distance of two convex cubes with a certificate: for any unit direction v, the gap between the supporting planes along v is a lower
//! bound of the distance, however v was found. So the iteration may stop anywhere and never errs on the optimistic side.

use crate::geometry::{EndCubes, FlatShape};
use crate::linalg::Vec3;
use crate::math;

/// Iterations of the search; each one costs two support points. 3 are the mean for near cubes; 8 leave the bound at most 1.6 mm short
/// (near-parallel flats), 12 would leave 0.6 mm.
const MAX_ITERATIONS: usize = 8;
/// The search ends when lower and upper bound are this close, m.
const TOLERANCE_M: f32 = 1e-4;

/// A separating direction with the gap it certifies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Separation {
    /// Unit vector from C1 towards C4.
    pub(crate) direction: Vec3,
    /// Certified lower bound of the distance, m; not positive when the cubes may overlap.
    pub(crate) lower_m: f32,
    /// Upper bound of the distance, m: two points of the cubes are no further apart.
    pub(crate) upper_m: f32,
}

/// The best separation found in [`MAX_ITERATIONS`] (Gilbert, Johnson, Keerthi), ended early once the distance is known to be
/// below `give_up_m` or certified to be at least `enough_m`.
pub(crate) fn separation(
    shape: &FlatShape,
    cubes: &EndCubes,
    give_up_m: f32,
    enough_m: f32,
) -> Separation {
    let span = cubes.last.centre_m - cubes.first.centre_m;
    let mut x = span;
    let mut simplex = Simplex::empty();
    let mut best = Separation {
        direction: Vec3::new(1.0, 0.0, 0.0),
        lower_m: f32::NEG_INFINITY,
        upper_m: f32::INFINITY,
    };
    for _ in 0..MAX_ITERATIONS {
        let (length, v) = unit(x);
        if length < best.upper_m {
            best.upper_m = length;
        }
        if length < 1e-6 || best.upper_m < give_up_m {
            break;
        }
        let flats = (
            cubes.first.active_flat(shape, v),
            cubes.last.active_flat(shape, -v),
        );
        if let (None, None) = flats
            && simplex.len == 0
        {
            // Along the line of centres both show the ball: then the gap of the balls is the distance.
            let gap = length - 2.0 * shape.ball_m;
            return Separation {
                direction: v,
                lower_m: gap,
                upper_m: gap,
            };
        }
        let nearest = shape.support_m(flats.0.as_ref(), v);
        let w = span + shape.support_m(flats.1.as_ref(), -v) - nearest;
        let lower = v.dot(w);
        if lower > best.lower_m {
            best.lower_m = lower;
            best.direction = v;
        }
        if length - best.lower_m < TOLERANCE_M || best.lower_m >= enough_m {
            break;
        }
        x = simplex.add_and_reduce(w);
    }
    best
}

/// Up to three points kept of the Minkowski difference, and the fourth just found.
struct Simplex {
    points: [Vec3; 3],
    len: u8,
}

impl Simplex {
    const fn empty() -> Self {
        Simplex {
            points: [Vec3::ZERO; 3],
            len: 0,
        }
    }

    /// Adds a point, keeps the face nearest to the origin, and returns the point of it nearest to the origin.
    fn add_and_reduce(&mut self, w: Vec3) -> Vec3 {
        let [a, b, c] = self.points;
        let nearest = match self.len {
            0 => Nearest::point(w, 0),
            1 => nearest_on_segment((w, 0), (a, 1)),
            2 => nearest_on_triangle((w, 0), (a, 1), (b, 2)),
            _ => nearest_on_new_faces(w, a, b, c),
        };
        let corner = |number| match number {
            0 => w,
            1 => a,
            2 => b,
            _ => c,
        };
        let [first, second, third] = nearest.corners;
        self.points = [corner(first), corner(second), corner(third)];
        self.len = nearest.len;
        nearest.at
    }
}

/// A point of a simplex and its number there: 0 is the new one.
type Corner = (Vec3, u8);

/// The point of a simplex nearest to the origin and the corners of the feature it lies on, by their numbers; beyond `len` they mean nothing.
#[derive(Clone, Copy)]
struct Nearest {
    at: Vec3,
    corners: [u8; 3],
    len: u8,
}

impl Nearest {
    fn point(a: Vec3, corner: u8) -> Self {
        Nearest {
            at: a,
            corners: [corner; 3],
            len: 1,
        }
    }
}

fn nearest_on_segment((a, ia): Corner, (b, ib): Corner) -> Nearest {
    let ab = b - a;
    let along = -a.dot(ab);
    let whole = ab.norm_squared();
    if along <= 0.0 || whole < 1e-14 {
        Nearest::point(a, ia)
    } else if along >= whole {
        Nearest::point(b, ib)
    } else {
        Nearest {
            at: a + ab * (along / whole),
            corners: [ia, ib, ib],
            len: 2,
        }
    }
}

/// Voronoi regions of a triangle (Ericson, Real-Time Collision Detection, 5.1.5).
fn nearest_on_triangle((a, ia): Corner, (b, ib): Corner, (c, ic): Corner) -> Nearest {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (-ab.dot(a), -ac.dot(a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return Nearest::point(a, ia);
    }
    let (d3, d4) = (-ab.dot(b), -ac.dot(b));
    if d3 >= 0.0 && d4 <= d3 {
        return Nearest::point(b, ib);
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return nearest_on_segment((a, ia), (b, ib));
    }
    let (d5, d6) = (-ab.dot(c), -ac.dot(c));
    if d6 >= 0.0 && d5 <= d6 {
        return Nearest::point(c, ic);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return nearest_on_segment((a, ia), (c, ic));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && (d4 - d3) >= 0.0 && (d5 - d6) >= 0.0 {
        return nearest_on_segment((b, ib), (c, ic));
    }
    let total = va + vb + vc;
    if total < 1e-20 {
        return nearest_on_segment((a, ia), (b, ib));
    }
    let k = 1.0 / total;
    Nearest {
        at: a + ab * (vb * k) + ac * (vc * k),
        corners: [ia, ib, ic],
        len: 3,
    }
}

/// The nearest of the three faces that hold the new point `w`, unless the origin lies inside the tetrahedron.
fn nearest_on_new_faces(w: Vec3, a: Vec3, b: Vec3, c: Vec3) -> Nearest {
    let mut best = Nearest {
        at: Vec3::ZERO,
        corners: [0, 1, 2],
        len: 3,
    };
    let mut best_squared = f32::INFINITY;
    let mut face = |p: Corner, q: Corner, other: Vec3| {
        let normal = (p.0 - w).cross(q.0 - w);
        let origin_side = -normal.dot(w);
        let other_side = normal.dot(other - w);
        if origin_side * other_side > 0.0 {
            return;
        }
        let candidate = nearest_on_triangle((w, 0), p, q);
        let squared = candidate.at.norm_squared();
        // The first one counts whatever it is.
        if best_squared == f32::INFINITY || squared < best_squared {
            (best, best_squared) = (candidate, squared);
        }
    };
    face((a, 1), (b, 2), c);
    face((b, 2), (c, 3), a);
    face((a, 1), (c, 3), b);
    best
}

/// Length of a vector and its unit vector; x for the zero vector.
pub(crate) fn unit(v: Vec3) -> (f32, Vec3) {
    let squared = v.norm_squared();
    let inverse = math::inverse_sqrt(squared);
    if squared > 1e-18 {
        (squared * inverse, v * inverse)
    } else {
        (0.0, Vec3::new(1.0, 0.0, 0.0))
    }
}
