//! Independent oracle of the collision pre-check: f64 kinematics by nalgebra from the joint table, half-spheres as convex
//! polyhedra, distances by parry3d. It shares no code with the crate under test but the robot's numbers.
//!
//! Each polyhedron is the hull of points on the true surface, so it lies inside the true half-sphere and the distance of two
//! polyhedra is an upper bound of the true distance. How far the true shape reaches outside is bounded from the hull's faces (`reach`), so
//! that distance minus twice that is a lower bound. Both bounds together make the statements of the tests rigorous.

use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};
use parry3d::math::{Pose, Rotation, Vector};
use parry3d::shape::ConvexPolyhedron;

type V = Vector3<f64>;

pub(crate) const EDGE_M: f64 = 0.110;
pub(crate) const BALL_M: f64 = 0.062;
/// parry works in f32 with absolute tolerances: shapes are given to it in units of 1/SCALE m.
const SCALE: f64 = 10.0;
/// Error allowed to parry's own f32 distance, m.
pub(crate) const PARRY_ERROR_M: f64 = 2e-5;

struct Half {
    body: usize,
    centre: V,
    hull: ConvexPolyhedron,
}

pub(crate) struct Oracle {
    twist: f64,
    first: Vec<Half>,
    last: Vec<Half>,
    /// Largest distance of a point of a true half-sphere from its polyhedron, m.
    pub(crate) reach_m: f64,
}

/// Bounds of the true distance, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    pub(crate) lower_m: f64,
    pub(crate) upper_m: f64,
    pub(crate) pair: (usize, usize),
}

fn diagonal() -> V {
    V::new(1.0, 1.0, 1.0).normalize()
}

fn turn_x(angle: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&V::x_axis(), angle)
}

/// Points on the surface of one half: ball, cut circle, rims of the three flats; relative to the cube centre.
fn surface(side: f64) -> Vec<V> {
    let d = diagonal();
    let height = EDGE_M / 2.0;
    let rim = (BALL_M * BALL_M - height * height).sqrt();
    let flats = [V::x() * side, V::y() * side, V::z() * side];
    let mut points = Vec::new();
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let total = 1600;
    for i in 0..total {
        let z = 1.0 - 2.0 * (i as f64 + 0.5) / total as f64;
        let r = (1.0 - z * z).sqrt();
        let u = V::new(
            r * (golden * i as f64).cos(),
            r * (golden * i as f64).sin(),
            z,
        );
        if side * u.dot(&d) > 0.0 && flats.iter().all(|n| n.dot(&u) * BALL_M <= height) {
            points.push(u * BALL_M);
        }
    }
    let mut circle = |normal: V, offset: f64, radius: f64, count: usize| {
        let e1 = normal.cross(&V::new(0.3, -0.5, 0.8)).normalize();
        let e2 = normal.cross(&e1);
        for k in 0..count {
            let a = std::f64::consts::TAU * k as f64 / count as f64;
            points.push(normal * offset + (e1 * a.cos() + e2 * a.sin()) * radius);
        }
    };
    circle(d, 0.0, BALL_M, 120);
    for n in flats {
        circle(n, height, rim, 60);
    }
    points
}

/// Hull of one half, turned by the twist, and a bound of how far the true shape reaches outside it.
fn half(body: usize, cube: usize, side: f64, twist: f64) -> (Half, f64) {
    let to_parry = |v: &V| {
        Vector::new(
            (v.x * SCALE) as f32,
            (v.y * SCALE) as f32,
            (v.z * SCALE) as f32,
        )
    };
    let local = surface(side);
    let points: Vec<V> = local.iter().map(|p| turn_x(twist) * p).collect();
    let cloud: Vec<Vector> = points.iter().map(to_parry).collect();
    let (vertices, faces) = parry3d::transformation::try_convex_hull(&cloud).expect("hull");
    let back = |v: &Vector| turn_x(-twist) * V::new(v.x as f64, v.y as f64, v.z as f64) / SCALE;
    // All corners lie on the ball. A point p of a face with corners v_i is at radius^2 = R^2 - sum l_i |v_i - p|^2, and that sum is at
    // most a third of the longest edge squared. So along any ray from the centre the true shape ends within `reach` of the hull.
    let mut edge = 0.0f64;
    for f in &faces {
        let corners = f.map(|i| back(&vertices[i as usize]));
        let plane = |n: V, offset: f64| corners.iter().all(|p| (n.dot(p) - offset).abs() < 1e-6);
        let flats = [V::x() * side, V::y() * side, V::z() * side];
        if plane(diagonal(), 0.0) || flats.iter().any(|n| plane(*n, EDGE_M / 2.0)) {
            continue;
        }
        let [a, b, c] = corners;
        edge = edge
            .max((b - a).norm())
            .max((c - b).norm())
            .max((a - c).norm());
    }
    let reach = BALL_M * (BALL_M / (BALL_M * BALL_M - edge * edge / 3.0).sqrt() - 1.0);
    let hull = ConvexPolyhedron::from_convex_hull(&cloud).expect("hull");
    let centre = V::new(cube as f64 * EDGE_M, 0.0, 0.0);
    (Half { body, centre, hull }, reach)
}

impl Oracle {
    pub(crate) fn new(twist: f64) -> Self {
        let made = [
            half(0, 0, -1.0, 0.0),
            half(1, 0, 1.0, 0.0),
            half(5, 3, -1.0, twist),
            half(6, 3, 1.0, twist),
        ];
        let reach_m = made.iter().map(|m| m.1).fold(0.0, f64::max);
        let mut halves: Vec<Half> = made.into_iter().map(|m| m.0).collect();
        let last = halves.split_off(2);
        Oracle {
            twist,
            first: halves,
            last,
            reach_m,
        }
    }

    /// World displacement of every body from home, body 0 fixed: the product of the joint rotations about their home axes.
    pub(crate) fn bodies(&self, q: &[f32; 6]) -> [Isometry3<f64>; 7] {
        let d = diagonal();
        let db = turn_x(self.twist) * d;
        let x = V::x();
        let table = [(d, 0.0), (x, 0.5), (d, 1.0), (db, 2.0), (x, 2.5), (db, 3.0)];
        let mut out = [Isometry3::identity(); 7];
        for k in 0..6 {
            let (axis, at) = table[k];
            let p = V::new(at * EDGE_M, 0.0, 0.0);
            let turn = UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), f64::from(q[k]));
            let about = Translation3::from(p) * turn * Translation3::from(-p);
            out[k + 1] = out[k] * about;
        }
        out
    }

    /// Distance of cube centres C1 and C4, m.
    pub(crate) fn centre_distance_m(&self, q: &[f32; 6]) -> f64 {
        let b = self.bodies(q);
        ((b[6] * nalgebra::Point3::new(3.0 * EDGE_M, 0.0, 0.0)) - nalgebra::Point3::origin()).norm()
    }

    pub(crate) fn distance(&self, q: &[f32; 6]) -> Bounds {
        let bodies = self.bodies(q);
        let place = |h: &Half| {
            let at = bodies[h.body] * nalgebra::Point3::from(h.centre);
            let r = bodies[h.body].rotation;
            let t = Vector::new(
                (at.x * SCALE) as f32,
                (at.y * SCALE) as f32,
                (at.z * SCALE) as f32,
            );
            Pose::from_parts(
                t,
                Rotation::from_xyzw(r.i as f32, r.j as f32, r.k as f32, r.w as f32),
            )
        };
        let mut upper_m = f64::INFINITY;
        let mut pair = (0, 0);
        for a in &self.first {
            for b in &self.last {
                let found = parry3d::query::distance(&place(a), &a.hull, &place(b), &b.hull)
                    .expect("supported shapes");
                let found_m = f64::from(found.distance) / SCALE;
                if found_m < upper_m {
                    upper_m = found_m;
                    pair = (a.body, b.body);
                }
            }
        }
        Bounds {
            lower_m: upper_m - 2.0 * self.reach_m,
            upper_m,
            pair,
        }
    }
}

/// SplitMix64 (Steele, Lea, Flood 2014): seeded, the same everywhere.
pub(crate) struct Rng(pub(crate) u64);

impl Rng {
    pub(crate) fn next_u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [low, high).
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * ((self.next_u64() >> 11) as f64 / (1u64 << 53) as f64)
    }

    pub(crate) fn pose(&mut self) -> [f32; 6] {
        std::array::from_fn(|_| self.between(-std::f64::consts::PI, std::f64::consts::PI) as f32)
    }
}
