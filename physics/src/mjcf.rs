//! The robot in other engines' terms: MJCF for MuJoCo, and the plain numbers behind it for anything else.
//!
//! Masses and inertias are the exact ones of this engine; contact shapes are convex hulls of points on the true surface. The servo of
//! Table II becomes what it is, a velocity constraint with a force limit: every joint is tied by a tendon with dry friction `Tmax` to
//! a flywheel on its own axle. Whoever steps the model sets the flywheels' speeds to `clamp(P (set-point - q), +-vmax)` before
//! each step; the tendon then holds the joint at that speed with at most `Tmax`.

use crate::params::{JointParams, Params};
use crate::robot::Robot;
use std::fmt::Write as _;

/// One rigid body: masses in its own frame, which is parallel to the world at home.
#[derive(Clone, Debug, PartialEq)]
pub struct RigidBody {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass from the body's origin, m.
    pub com_m: [f64; 3],
    /// Inertia about the centre of mass, kg m2: xx, yy, zz, xy, xz, yz.
    pub inertia_kg_m2: [f64; 6],
}

/// Mass, centre of mass and inertia of every body, in the order of [`crate::RawRobot::bodies`].
#[must_use]
pub fn rigid_bodies(params: &Params) -> Vec<RigidBody> {
    let robot = &params.robot;
    let shape = robot.shape();
    let mut out = Vec::new();
    for index in 0..robot.raw().bodies.len() {
        let mut parts: Vec<(f64, [f64; 3], [f64; 3])> = Vec::new();
        for (h, half) in robot.raw().halves.iter().enumerate() {
            if half.body == index {
                let n = robot.diagonal(h);
                let shift = if index == 0 {
                    params.com_offset_m
                } else {
                    [0.0; 3]
                };
                let com = std::array::from_fn(|k| half.centre_m[k] + shape.com_m * n[k] + shift[k]);
                parts.push((params.half_masses_kg[h], com, n));
            }
        }
        out.push(combine(&parts, shape.com_m, shape.centre_inertia_m2));
    }
    out
}

/// Sum of half-spheres, each with its inertia about its own centre of mass: (I_centre - c^2) 1 + c^2 n n^T per kg.
fn combine(parts: &[(f64, [f64; 3], [f64; 3])], com_m: f64, centre_m2: f64) -> RigidBody {
    let mass: f64 = parts.iter().map(|p| p.0).sum();
    let com: [f64; 3] =
        std::array::from_fn(|k| parts.iter().map(|p| p.0 * p.1[k]).sum::<f64>() / mass);
    let mut inertia = [0.0; 6];
    for (m, c, n) in parts {
        let d: [f64; 3] = std::array::from_fn(|k| c[k] - com[k]);
        let d2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
        for (slot, (i, j)) in
            inertia
                .iter_mut()
                .zip([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)])
        {
            let one = f64::from(u8::from(i == j));
            *slot += m
                * ((centre_m2 - com_m * com_m + d2) * one + com_m * com_m * n[i] * n[j]
                    - d[i] * d[j]);
        }
    }
    RigidBody {
        mass_kg: mass,
        com_m: com,
        inertia_kg_m2: inertia,
    }
}

/// Points on a half-sphere's surface, from the cube's centre, m, home orientation: ball, rims of the faces, rim of the diagonal plane.
/// `per_turn` points on a great circle.
#[must_use]
pub fn surface(robot: &Robot, half: usize, per_turn: usize) -> Vec<[f64; 3]> {
    let raw = &robot.raw().halves[half];
    let shape = robot.shape();
    let radius = robot.raw().ball_radius_m;
    let mut points = Vec::new();
    let n = robot.diagonal(half);
    let (u, v) = across(n);
    let circle = |centre: [f64; 3], r: f64, u: [f64; 3], v: [f64; 3], count: usize| {
        (0..count)
            .map(|k| {
                let (s, c) = libm::sincos(std::f64::consts::TAU * k as f64 / count as f64);
                std::array::from_fn(|i| centre[i] + r * (c * u[i] + s * v[i]))
            })
            .collect::<Vec<[f64; 3]>>()
    };
    for face in raw.faces {
        let (u, v) = across(face);
        let centre = face.map(|x| x * shape.face_m);
        points.extend(circle(centre, shape.rim_m, u, v, per_turn / 2));
    }
    points.extend(circle([0.0; 3], radius, u, v, per_turn));
    // Rings of the ball around the diagonal, without what the faces cut off.
    let rings = per_turn / 4;
    for ring in 1..=rings {
        let (s, c) = libm::sincos(std::f64::consts::FRAC_PI_2 * ring as f64 / rings as f64);
        let centre = n.map(|x| x * radius * s);
        let count = ((per_turn as f64 * c) as usize).max(1);
        let inside = |p: &[f64; 3]| {
            raw.faces
                .iter()
                .all(|f| p[0] * f[0] + p[1] * f[1] + p[2] * f[2] < shape.face_m)
        };
        points.extend(
            circle(centre, radius * c, u, v, count)
                .into_iter()
                .filter(inside),
        );
    }
    points
}

/// Two unit vectors at right angles to `n` and each other.
fn across(n: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let least = if n[0].abs() < 0.6 {
        [1.0, 0.0, 0.0]
    } else {
        [0.0, 1.0, 0.0]
    };
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    };
    let u = cross(n, least);
    let size = (u[0] * u[0] + u[1] * u[1] + u[2] * u[2]).sqrt();
    let u = u.map(|x| x / size);
    (u, cross(n, u))
}

fn joined(values: &[f64]) -> String {
    let words: Vec<String> = values.iter().map(|v| format!("{v}")).collect();
    words.join(" ")
}

/// How the export builds the servo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Servo {
    /// Flywheel and dry tendon: the servo's own law (see the module).
    Constraint,
    /// MuJoCo's velocity actuator with a force range: fewer degrees of freedom, but a viscous law, soft enough to stay stable.
    Actuator,
}

/// Gain of [`Servo::Actuator`], N m s/rad: the largest of 2, 5, 10 and 20 with which the robot does not throw itself about at 4 ms. MuJoCo
/// evaluates the limited torque at the old speed, so a stiffer motor overshoots; this one lags by 1 rad/s per 2 N m.
const ACTUATOR_GAIN: f64 = 2.0;

/// The model as MJCF. Joints are `joint0..`, flywheels `wheel0..`, the base is body `body0` with a free joint; `per_turn` as in [`surface`].
#[must_use]
pub fn to_mjcf(params: &Params, time_step_s: f64, per_turn: usize, servo: Servo) -> String {
    let robot = &params.robot;
    let mut out = String::from("<mujoco model=\"metamodule\">\n");
    let _ = writeln!(
        out,
        "  <compiler angle=\"radian\" autolimits=\"true\"/>\n  <option timestep=\"{time_step_s}\" gravity=\"{}\" cone=\"elliptic\"/>\n  <asset>",
        joined(&params.gravity_m_s2)
    );
    for half in 0..robot.raw().halves.len() {
        let flat: Vec<f64> = surface(robot, half, per_turn)
            .into_iter()
            .flatten()
            .collect();
        let _ = writeln!(
            out,
            "    <mesh name=\"half{half}\" vertex=\"{}\"/>",
            joined(&flat)
        );
    }
    let _ = writeln!(
        out,
        "  </asset>\n  <worldbody>\n    <geom name=\"ground\" type=\"plane\" size=\"0 0 1\" friction=\"{f} 0 0\" condim=\"3\"/>",
        f = params.friction
    );
    let rigid = rigid_bodies(params);
    body(&mut out, params, &rigid, 0, 2);
    match servo {
        Servo::Constraint => constraint_servos(&mut out, params),
        Servo::Actuator => actuator_servos(&mut out, params),
    }
    out.push_str("  <contact>\n");
    exclusions(&mut out, robot);
    out.push_str("  </contact>\n</mujoco>\n");
    out
}

fn actuator_servos(out: &mut String, params: &Params) {
    out.push_str("  </worldbody>\n  <option integrator=\"implicitfast\"/>\n  <actuator>\n");
    for (joint, j) in params.joints.iter().enumerate().take(params.robot.motors()) {
        let t = j.max_torque_nm;
        let _ = writeln!(
            out,
            "    <velocity name=\"motor{joint}\" joint=\"joint{joint}\" kv=\"{ACTUATOR_GAIN}\" forcerange=\"-{t} {t}\"/>"
        );
    }
    out.push_str("  </actuator>\n");
}

fn constraint_servos(out: &mut String, params: &Params) {
    for joint in 0..params.robot.motors() {
        // Far off, heavy enough that six newton metres for an hour change its speed by 2 %.
        let _ = writeln!(
            out,
            "    <body name=\"flywheel{joint}\" pos=\"0 {} -5\"><joint name=\"wheel{joint}\" type=\"hinge\" axis=\"0 1 0\"/><inertial pos=\"0 0 0\" mass=\"1\" diaginertia=\"1e6 1e6 1e6\"/></body>",
            joint as f64 * 0.1
        );
    }
    out.push_str("  </worldbody>\n  <tendon>\n");
    for (joint, j) in params.joints.iter().enumerate().take(params.robot.motors()) {
        dry_tendon(out, joint, j);
    }
    out.push_str("  </tendon>\n");
}

/// Dry friction of the tendon is the motor: at once (`solimp` near 1), at most `Tmax`.
fn dry_tendon(out: &mut String, joint: usize, j: &JointParams) {
    let _ = writeln!(
        out,
        "    <fixed name=\"motor{joint}\" frictionloss=\"{}\" solimpfriction=\"0.9999 0.9999 0.001 0.5 2\"><joint joint=\"joint{joint}\" coef=\"1\"/><joint joint=\"wheel{joint}\" coef=\"-1\"/></fixed>",
        j.max_torque_nm
    );
}

fn body(out: &mut String, params: &Params, rigid: &[RigidBody], index: usize, depth: usize) {
    let robot = &params.robot;
    let raw = robot.raw();
    let pad = "  ".repeat(depth);
    let b = &raw.bodies[index];
    let pos = if index == 0 {
        [0.0, 0.0, raw.cube_m / 2.0]
    } else {
        b.offset_m
    };
    let _ = writeln!(
        out,
        "{pad}<body name=\"body{index}\" pos=\"{}\">",
        joined(&pos)
    );
    match b.joint {
        Some(joint) => {
            let damping = params.joints[joint].damping_nm_s_rad;
            let _ = writeln!(
                out,
                "{pad}  <joint name=\"joint{joint}\" type=\"hinge\" axis=\"{}\" damping=\"{damping}\"/>",
                joined(&b.axis)
            );
        }
        None if raw.fixed_base => {}
        None => {
            let _ = writeln!(out, "{pad}  <freejoint name=\"base\"/>");
        }
    }
    let r = &rigid[index];
    if r.mass_kg > 0.0 {
        let _ = writeln!(
            out,
            "{pad}  <inertial pos=\"{}\" mass=\"{}\" fullinertia=\"{}\"/>",
            joined(&r.com_m),
            r.mass_kg,
            joined(&r.inertia_kg_m2)
        );
    }
    for (h, half) in raw.halves.iter().enumerate() {
        if half.body == index {
            let _ = writeln!(
                out,
                "{pad}  <geom name=\"half{h}\" type=\"mesh\" mesh=\"half{h}\" pos=\"{}\" friction=\"{} 0 0\" condim=\"3\"/>",
                joined(&half.centre_m),
                params.friction
            );
        }
    }
    for child in 0..raw.bodies.len() {
        if raw.bodies[child].parent == Some(index) {
            body(out, params, rigid, child, depth + 1);
        }
    }
    let _ = writeln!(out, "{pad}</body>");
}

/// Only cubes of the robot's pairs may meet; all other pairs of bodies are excluded (parents and children are anyway).
fn exclusions(out: &mut String, robot: &Robot) {
    let raw = robot.raw();
    let bodies_of = |cube: usize| raw.cubes[cube].map(|h| raw.halves[h].body);
    for a in 0..raw.bodies.len() {
        for b in a + 1..raw.bodies.len() {
            let meets = raw.pairs.iter().any(|[i, j]| {
                let (x, y) = (bodies_of(*i), bodies_of(*j));
                (x.contains(&a) && y.contains(&b)) || (x.contains(&b) && y.contains(&a))
            });
            if !meets {
                let _ = writeln!(out, "    <exclude body1=\"body{a}\" body2=\"body{b}\"/>");
            }
        }
    }
}
