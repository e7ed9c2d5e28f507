//! The robot as data: a tree of rigid bodies, half-spheres on them, cubes made of two half-spheres.
//!
//! At home all body frames are parallel to the world. The base is one body (body 3 of the meta-module, so that no path is longer than
//! three joints); every other body hangs on its parent by one hinge. [`RawRobot`] is what a structure is written as; [`Robot`] is
//! checked, sorted and holds the constants of the half-sphere's shape.

mod check;
mod error;

pub use error::RobotError;

use check::{check_bodies, check_shapes, check_whole, home_origins};
use control::robot::{RobotModel, RobotParams};
use files::model::{Key, Model};
use files::structure::{Hinge, Motor, Structure};

/// Most joints of a robot: two meta-modules (`control::gait::MAX_OSCILLATORS`).
pub const MAX_JOINTS: usize = 12;
/// Most bodies.
pub(crate) const MAX_BODIES: usize = MAX_JOINTS + 1;
/// Most half-spheres: four for every three joints, and four.
pub(crate) const MAX_HALVES: usize = 16;
/// Most cubes.
pub(crate) const MAX_CUBES: usize = MAX_HALVES / 2;
/// Most pairs of cubes that may meet.
pub(crate) const MAX_PAIRS: usize = 15;

/// Which motor drives a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointClass {
    /// Between the halves of one cube.
    Intra,
    /// Between two cubes.
    Inter,
    /// No motor: a direction in which the connection of two modules gives.
    Connector,
}

/// One body of a [`RawRobot`].
#[derive(Clone, Debug, PartialEq)]
pub struct RawBody {
    /// Parent body, `None` for the base; a parent stands before its children.
    pub parent: Option<usize>,
    /// From the parent's origin to this body's origin at home, m. The hinge axis passes through this body's origin.
    pub offset_m: [f64; 3],
    /// Unit axis about which this body turns against its parent when the joint angle grows.
    pub axis: [f64; 3],
    /// Joint index in gaits and recordings; `None` for the base.
    pub joint: Option<usize>,
    /// Motor of the joint.
    pub class: JointClass,
}

/// One half-sphere of a [`RawRobot`].
#[derive(Clone, Debug, PartialEq)]
pub struct RawHalf {
    /// Body it belongs to.
    pub body: usize,
    /// From the body's origin to the cube's centre, m.
    pub centre_m: [f64; 3],
    /// The three outward normals of the faces that cut it, unit, at right angles; their sum points to the half's middle.
    pub faces: [[f64; 3]; 3],
    /// Mass, kg; `None` = the model's for the half-sphere with this index, modulo 8.
    pub mass_kg: Option<f64>,
}

/// A structure as written, not yet checked.
#[derive(Clone, Debug, PartialEq)]
pub struct RawRobot {
    /// Bodies, parents first; body 0 is the base.
    pub bodies: Vec<RawBody>,
    /// Half-spheres; their order is that of the masses.
    pub halves: Vec<RawHalf>,
    /// Cubes as pairs of half-spheres with one centre and opposite sides.
    pub cubes: Vec<[usize; 2]>,
    /// Pairs of cubes that may meet.
    pub pairs: Vec<[usize; 2]>,
    /// Edge of a cube, m.
    pub cube_m: f64,
    /// Radius of the ball, m.
    pub ball_radius_m: f64,
    /// Whether the base is bolted to the world.
    pub fixed_base: bool,
}

/// Constants of the half-sphere: a half ball less three caps, uniform density, per kg.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfShape {
    /// Volume, m3.
    pub volume_m3: f64,
    /// Distance of the centre of mass from the cube's centre along the diagonal, m.
    pub com_m: f64,
    /// Inertia about the cube's centre is this times the identity, m2 (kg m2 per kg).
    pub centre_inertia_m2: f64,
    /// Distance of a face from the centre, m.
    pub face_m: f64,
    /// Radius of a face's disc, m.
    pub rim_m: f64,
}

impl HalfShape {
    /// Closed forms: half ball minus caps. The caps lie inside the half because `face_m > sqrt(2) rim_m`. The second moment of
    /// half ball and caps about the centre is isotropic, because the three faces are at right angles.
    fn new(cube_m: f64, radius_m: f64) -> HalfShape {
        use std::f64::consts::PI;
        let (r, a) = (radius_m, cube_m / 2.0);
        let height = r - a;
        let rim2 = r * r - a * a;
        let volume = 2.0 / 3.0 * PI * r * r * r - PI * height * height * (3.0 * r - height);
        let moment = PI * r * r * r * r / 4.0 - 3.0f64.sqrt() * PI * rim2 * rim2 / 4.0;
        let (r5, a3, a5) = (r * r * r * r * r, a * a * a, a * a * a * a * a);
        let axial = PI * (r5 * 2.0 / 15.0 - (r * r * a3 / 3.0 - a5 / 5.0));
        let across =
            PI / 4.0 * (r5 * 8.0 / 15.0 - (r * r * r * r * a - 2.0 * r * r * a3 / 3.0 + a5 / 5.0));
        let second = 2.0 * PI * r5 / 15.0 - (axial + 2.0 * across);
        HalfShape {
            volume_m3: volume,
            com_m: moment / volume,
            centre_inertia_m2: 2.0 * second / volume,
            face_m: a,
            rim_m: rim2.sqrt(),
        }
    }
}

/// A checked robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    raw: RawRobot,
    shape: HalfShape,
    /// Body of each joint index.
    body_of_joint: Vec<usize>,
    /// The same robot as the firmware's pre-check knows it; only meta-modules have one.
    precheck: Option<Box<RobotModel>>,
    /// For every body: bit k set when body k lies on its path to the base (itself included, base excluded).
    paths: Vec<u32>,
}

impl From<&Structure> for RawRobot {
    fn from(structure: &Structure) -> RawRobot {
        let base = Hinge {
            parent: 0,
            offset_m: [0.0; 3],
            axis: [1.0, 0.0, 0.0],
            joint: 0,
            motor: Motor::Connector,
            no_load_speed_rad_s: None,
        };
        let body = |hinge: &Option<Hinge>| {
            let h = hinge.as_ref().unwrap_or(&base);
            RawBody {
                parent: hinge.as_ref().map(|h| h.parent),
                offset_m: h.offset_m,
                axis: h.axis,
                joint: hinge.as_ref().map(|h| h.joint),
                class: match h.motor {
                    Motor::Intra => JointClass::Intra,
                    Motor::Inter => JointClass::Inter,
                    Motor::Connector => JointClass::Connector,
                },
            }
        };
        let halves = structure.halves.iter().map(|half| RawHalf {
            body: half.body,
            centre_m: half.centre_m,
            faces: half.faces,
            mass_kg: half.mass_kg,
        });
        RawRobot {
            bodies: structure.bodies.iter().map(body).collect(),
            halves: halves.collect(),
            cubes: structure.cubes.clone(),
            pairs: structure.pairs.clone(),
            cube_m: structure.cube_m,
            ball_radius_m: structure.ball_radius_m,
            fixed_base: structure.fixed_base,
        }
    }
}

impl Robot {
    /// The robot of a structure file. A meta-module with the model's twist is known as one: the firmware's pre-check looks at it too.
    ///
    /// # Errors
    /// When the parts do not make a robot.
    pub fn of_structure(structure: &Structure, model: &Model) -> Result<Robot, RobotError> {
        let mut robot = Robot::try_from(RawRobot::from(structure))?;
        let [cube_m, ball_m] = [robot.raw.cube_m, robot.raw.ball_radius_m];
        let twist_rad = model.value(Key::Twist);
        let mut known = meta_module(cube_m, ball_m, twist_rad, false);
        for (half, ours) in known.halves.iter_mut().zip(&robot.raw.halves) {
            half.mass_kg = ours.mass_kg;
        }
        if known == robot.raw {
            robot.precheck = precheck(cube_m, ball_m, twist_rad);
        }
        Ok(robot)
    }

    /// The meta-module of a model: two modules, joints 0..5, base = body 3.
    ///
    /// # Errors
    /// [`RobotError::Ball`] when ball and cube do not fit together.
    pub fn meta_module(model: &Model) -> Result<Robot, RobotError> {
        let connector = model.effects().iter().any(|e| {
            matches!(
                e.effect.info().name,
                "connector_compliance" | "connector_play"
            )
        });
        let mut robot = Robot::try_from(meta_module(
            model.value(Key::Cube),
            model.value(Key::BallRadius),
            model.value(Key::Twist),
            connector,
        ))?;
        robot.precheck = precheck(
            model.value(Key::Cube),
            model.value(Key::BallRadius),
            model.value(Key::Twist),
        );
        Ok(robot)
    }

    /// Clearance of the robot with itself by the firmware's pre-check, m; `None` for structures it does not know.
    #[must_use]
    pub fn precheck_clearance_m(&self, angles_rad: &[f32; 6]) -> Option<f64> {
        let model = self.precheck.as_ref()?;
        Some(f64::from(
            control::precheck::clearance(model, angles_rad).clearance_m,
        ))
    }

    /// The structure as data.
    #[must_use]
    pub fn raw(&self) -> &RawRobot {
        &self.raw
    }

    /// Constants of the half-sphere.
    #[must_use]
    pub fn shape(&self) -> &HalfShape {
        &self.shape
    }

    /// Joints that gaits and recordings count, connectors excluded.
    #[must_use]
    pub fn motors(&self) -> usize {
        self.raw
            .bodies
            .iter()
            .skip(1)
            .filter(|b| b.class != JointClass::Connector)
            .count()
    }

    /// All joints, connectors last.
    #[must_use]
    pub fn joints(&self) -> usize {
        self.raw.bodies.len() - 1
    }

    /// Motor of each joint that gaits count, by joint index.
    pub fn motor_classes(&self) -> impl Iterator<Item = JointClass> {
        (0..self.motors()).map(|joint| self.raw.bodies[self.body_of_joint[joint]].class)
    }

    /// Height of the base's origin over the ground at home: the lowest cube lies on its face, m.
    pub(crate) fn home_height_m(&self) -> f64 {
        let origins = home_origins(&self.raw);
        let heights = self
            .raw
            .halves
            .iter()
            .map(|half| origins[half.body][2] + half.centre_m[2]);
        self.shape.face_m - heights.fold(f64::INFINITY, f64::min)
    }

    pub(crate) fn body_of_joint(&self, joint: usize) -> usize {
        self.body_of_joint[joint]
    }

    pub(crate) fn path(&self, body: usize) -> u32 {
        self.paths[body]
    }

    /// Diagonal of a half-sphere: unit vector from the cube's centre to the half's middle.
    pub(crate) fn diagonal(&self, half: usize) -> [f64; 3] {
        let f = &self.raw.halves[half].faces;
        let s = 1.0 / 3.0f64.sqrt();
        std::array::from_fn(|i| s * (f[0][i] + f[1][i] + f[2][i]))
    }
}

/// The firmware's view of a meta-module; geometry beyond what it accepts is left to this crate's own clearance.
fn precheck(cube_m: f64, ball_radius_m: f64, twist_rad: f64) -> Option<Box<RobotModel>> {
    RobotModel::new(RobotParams {
        twist_rad: twist_rad as f32,
        cube_m: cube_m as f32,
        ball_radius_m: ball_radius_m as f32,
        ..RobotParams::default()
    })
    .ok()
    .map(Box::new)
}

impl TryFrom<RawRobot> for Robot {
    type Error = RobotError;

    fn try_from(raw: RawRobot) -> Result<Robot, RobotError> {
        let limit = |what, found: usize, most: usize| {
            if found > most {
                Err(RobotError::TooMany { what, found, most })
            } else {
                Ok(())
            }
        };
        limit("bodies", raw.bodies.len(), MAX_BODIES)?;
        limit("half-spheres", raw.halves.len(), MAX_HALVES)?;
        limit("cubes", raw.cubes.len(), MAX_CUBES)?;
        limit("pairs", raw.pairs.len(), MAX_PAIRS)?;
        let (radius_m, min_m) = (raw.ball_radius_m, raw.cube_m / 2.0);
        // The discs of neighbouring faces stay apart, and inside their half, while the rim is smaller than the face distance / sqrt 2.
        let max_m = min_m * 1.5f64.sqrt();
        if !(radius_m > min_m && radius_m < max_m) {
            return Err(RobotError::Ball {
                radius_m,
                min_m,
                max_m,
            });
        }
        let (body_of_joint, paths) = check_bodies(&raw)?;
        check_shapes(&raw)?;
        check_whole(&raw, &body_of_joint, &paths)?;
        let shape = HalfShape::new(raw.cube_m, raw.ball_radius_m);
        Ok(Robot {
            raw,
            shape,
            body_of_joint,
            precheck: None,
            paths,
        })
    }
}

/// The meta-module of design section 2.1. With `connector`, body 3 is split at the connection: module B then hangs on three hinges
/// (x, y, z through the connection's middle) that have springs instead of motors.
fn meta_module(cube_m: f64, ball_radius_m: f64, twist_rad: f64, connector: bool) -> RawRobot {
    let (s, c) = libm::sincos(twist_rad);
    let s3 = 1.0 / 3.0f64.sqrt();
    let d = [s3, s3, s3];
    let e: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    // Rx(twist) of the axes, and of the diagonal.
    let t: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]];
    let dt = [s3, s3 * (c - s), s3 * (s + c)];
    let minus = |v: [f64; 3]| [-v[0], -v[1], -v[2]];
    let x = e[0];
    let body = |parent, dx: f64, axis, joint, class| RawBody {
        parent: Some(parent),
        offset_m: [dx, 0.0, 0.0],
        axis,
        joint: Some(joint),
        class,
    };
    let half_edge = cube_m / 2.0;
    let (intra, inter) = (JointClass::Intra, JointClass::Inter);
    // Base = body 3; then 2, 1, 0 of module A (turning backwards), then 4, 5, 6 of module B.
    let base = RawBody {
        parent: None,
        offset_m: [0.0; 3],
        axis: x,
        joint: None,
        class: JointClass::Connector,
    };
    let mut bodies = vec![
        base,
        body(0, -half_edge, minus(d), 2, intra),
        body(1, -cube_m, minus(x), 1, inter),
        body(2, 0.0, minus(d), 0, intra),
    ];
    let mut root_b = 0;
    if connector {
        for (k, axis) in e.into_iter().enumerate() {
            bodies.push(body(root_b, 0.0, axis, 6 + k, JointClass::Connector));
            root_b = bodies.len() - 1;
        }
    }
    let b4 = bodies.len();
    bodies.push(body(root_b, half_edge, dt, 3, intra));
    bodies.push(body(b4, cube_m, x, 4, inter));
    bodies.push(body(b4 + 1, 0.0, dt, 5, intra));
    let half = |body, cx: f64, axes: [[f64; 3]; 3], sign: f64| RawHalf {
        body,
        centre_m: [cx, 0.0, 0.0],
        faces: axes.map(|a| [sign * a[0], sign * a[1], sign * a[2]]),
        mass_kg: None,
    };
    RawRobot {
        bodies,
        halves: vec![
            half(3, 0.0, e, -1.0),
            half(2, 0.0, e, 1.0),
            half(1, 0.0, e, -1.0),
            half(0, -half_edge, e, 1.0),
            half(root_b, half_edge, t, -1.0),
            half(b4, 0.0, t, 1.0),
            half(b4 + 1, 0.0, t, -1.0),
            half(b4 + 2, 0.0, t, 1.0),
        ],
        cubes: vec![[0, 1], [2, 3], [4, 5], [6, 7]],
        pairs: vec![[0, 3]],
        cube_m,
        ball_radius_m,
        fixed_base: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The figures of design section 2.1's background were computed from a mesh; the closed forms agree to the mesh's error.
    #[test]
    fn half_sphere_constants() {
        let s = HalfShape::new(0.110, 0.062);
        assert!((s.com_m - 22.675e-3).abs() < 5e-6, "{}", s.com_m);
        let across = s.centre_inertia_m2 - s.com_m * s.com_m;
        assert!((across - 9.7208e-4).abs() < 4e-6, "{across}");
        assert!((s.com_m * s.com_m - 5.1275e-4).abs() < 2e-6);
    }

    #[test]
    fn connector_splits_the_middle_body() {
        let rigid = Robot::try_from(meta_module(0.11, 0.062, 1.0, false)).unwrap();
        let split = Robot::try_from(meta_module(0.11, 0.062, 1.0, true)).unwrap();
        assert_eq!((rigid.joints(), rigid.motors()), (6, 6));
        assert_eq!((split.joints(), split.motors()), (9, 6));
    }

    #[test]
    fn broken_structures_are_refused() {
        let good = meta_module(0.11, 0.062, 0.0, false);
        let mut raw = good.clone();
        raw.bodies[2].parent = Some(5);
        assert!(matches!(
            Robot::try_from(raw),
            Err(RobotError::Reference { .. })
        ));
        let mut raw = good.clone();
        raw.bodies[2].joint = Some(0);
        assert!(matches!(
            Robot::try_from(raw),
            Err(RobotError::Joints { .. })
        ));
        let mut raw = good.clone();
        raw.halves[1].faces[0] = [0.5, 0.5, 0.0];
        assert!(matches!(
            Robot::try_from(raw),
            Err(RobotError::NotUnit { .. })
        ));
        let mut raw = good.clone();
        raw.halves[1].centre_m = [0.0, 0.001, 0.0];
        assert_eq!(Robot::try_from(raw), Err(RobotError::Cube { cube: 0 }));
        let mut raw = good.clone();
        raw.cubes.pop();
        raw.pairs.clear();
        assert!(matches!(
            Robot::try_from(raw),
            Err(RobotError::Cubeless { found: 0, .. })
        ));
        let mut raw = good.clone();
        raw.bodies[1].class = JointClass::Connector;
        assert!(matches!(
            Robot::try_from(raw),
            Err(RobotError::ConnectorFirst { .. })
        ));
        let mut raw = good.clone();
        raw.halves[0].body = 2;
        assert!(Robot::try_from(raw).is_err());
        let mut raw = good;
        raw.ball_radius_m = 0.050;
        assert!(matches!(Robot::try_from(raw), Err(RobotError::Ball { .. })));
    }
}
