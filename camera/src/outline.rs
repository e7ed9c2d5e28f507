//! Outlines of the meta-module's cubes straight from their shape, without a mesh.
//!
//! A cube is two half-balls, each cut by three faces. The cuts end before the plane between the halves: the ball's radius is below S / sqrt 3,
//! see [`RobotModel::new`]. So for every angle of the joint the two halves together are one convex body: a ball less six caps, three
//! that turn with the proximal body and three that turn with the distal one. Its outline in direction u is the ball's contour point, or,
//! where a cap is missing, the farthest point of that cap's rim.

use crate::{Silhouette, View};
use control::linalg::{Pose, Vec3};
use control::robot::{BODIES, RobotModel};

/// Points on the outline of one cube. With the area correction of [`MetaModule`] 32 err by less than 0.5 % of the area at a Kinect's
/// resolution (test `outlines_are_the_true_shapes`).
const DIRECTIONS: usize = 32;

/// The outlines of the four cubes of a meta-module.
#[derive(Clone, Debug, PartialEq)]
pub struct MetaModule {
    cubes: [Cube; 4],
    radius_m: f32,
    face_m: f32,
    /// Cosine and sine of the directions around an outline.
    around: [[f32; 2]; DIRECTIONS],
    /// Contour points are moved out by this factor so that the polygon has the area of the circle it stands for.
    widen: f32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Cube {
    /// Bodies of the proximal and the distal half.
    bodies: [usize; 2],
    /// Centre in the proximal body's frame, m.
    centre_m: Vec3,
    /// Outward normals of the faces in the frame of their half's body, proximal half first.
    faces: [[Vec3; 3]; 2],
}

/// Memory that a renderer uses again for every frame.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    pub(crate) corners: Vec<[f32; 2]>,
    pub(crate) spans: Vec<[f32; 2]>,
}

impl MetaModule {
    /// The outlines of this robot.
    #[must_use]
    pub fn new(robot: &RobotModel) -> Self {
        let origins = robot.body_origins_m();
        let axes = [
            Vec3::new(1.0, 0.0, 0.0),
            Vec3::new(0.0, 1.0, 0.0),
            Vec3::new(0.0, 0.0, 1.0),
        ];
        // The intra-cube joints; each joins the two halves of its cube.
        let cubes = [0usize, 2, 3, 5].map(|joint| {
            // Module B, with its faces, is turned against module A by the twist.
            let face = |axis: Vec3| {
                if joint >= 3 {
                    robot.twist().apply(axis)
                } else {
                    axis
                }
            };
            Cube {
                bodies: [joint, joint + 1],
                centre_m: robot.axis_points_m()[joint] - origins[joint],
                faces: [axes.map(|a| -face(a)), axes.map(face)],
            }
        });
        let step = core::f32::consts::TAU / DIRECTIONS as f32;
        let around = core::array::from_fn(|k| {
            let angle = k as f32 * step;
            [libm::cosf(angle), libm::sinf(angle)]
        });
        Self {
            cubes,
            radius_m: robot.ball_radius_m(),
            face_m: 0.5 * robot.cube_m(),
            around,
            widen: (step / libm::sinf(step)).sqrt(),
        }
    }

    /// Corners of the outline of one cube as `project` sees them from `eye_m`; false when the eye is inside the ball or below its top.
    fn outline(
        &self,
        cube: &Cube,
        poses: &[Pose; BODIES],
        eye_m: Vec3,
        project: impl Fn(Vec3) -> Option<[f32; 2]>,
        corners: &mut Vec<[f32; 2]>,
    ) -> bool {
        corners.clear();
        let halves = cube.bodies.map(|body| &poses[body]);
        let centre = halves[0].transform(cube.centre_m);
        let away = centre - eye_m;
        let distance = away.norm();
        if eye_m.z - centre.z <= self.radius_m {
            return false;
        }
        let forward = away * (1.0 / distance);
        // Never zero: the eye is above the ball, so `forward` has a part along z.
        let across = Vec3::new(forward.z, 0.0, -forward.x);
        let across = across * (1.0 / across.norm());
        let along = forward.cross(across);
        // The contour of a ball seen from nearby is a circle a little towards the eye and a little smaller than the ball.
        let near = self.radius_m / distance;
        let shrink = (1.0 - near * near).sqrt();
        let rim_m = (self.radius_m * self.radius_m - self.face_m * self.face_m).sqrt();
        let caps = self.visible_caps(cube, halves, (across, along), near);
        for [cos, sin] in self.around {
            let sideways = across * cos + along * sin;
            let normal = sideways * shrink - forward * near;
            let missing = caps
                .iter()
                .flatten()
                .find(|&&face| normal.dot(face) * self.radius_m > self.face_m);
            let point = match missing {
                Some(&face) => {
                    let beside = normal - face * normal.dot(face);
                    face * self.face_m + beside * (rim_m / beside.norm().max(f32::MIN_POSITIVE))
                }
                None => (sideways * (self.widen * shrink) - forward * near) * self.radius_m,
            };
            let Some(corner) = project(centre + point) else {
                return false;
            };
            corners.push(corner);
        }
        true
    }

    /// The caps that may change the outline: those whose face is seen nearly edge on.
    fn visible_caps(
        &self,
        cube: &Cube,
        halves: [&Pose; 2],
        (across, along): (Vec3, Vec3),
        near: f32,
    ) -> [Option<Vec3>; 6] {
        let least = self.face_m / self.radius_m;
        let mut caps = [None; 6];
        let faces = halves.iter().zip(&cube.faces);
        let turned = faces.flat_map(|(pose, faces)| faces.iter().map(|&f| pose.rotation.apply(f)));
        for (slot, face) in caps.iter_mut().zip(turned) {
            let (a, b) = (face.dot(across), face.dot(along));
            // The contour's normals are tilted towards the eye by `near`.
            *slot = ((a * a + b * b).sqrt() + near > least).then_some(face);
        }
        caps
    }
}

impl View {
    /// Draw the outline of a meta-module with its bodies at `poses` into a frame of this view's size. A cube whose ball reaches the camera's
    /// height is not drawn.
    pub fn draw(
        &self,
        robot: &MetaModule,
        poses: &[Pose; BODIES],
        frame: &mut Silhouette,
        scratch: &mut Scratch,
    ) {
        let (sin, cos) = self.turn();
        for cube in &robot.cubes {
            let project = |p| self.project_turned(p, sin, cos);
            if robot.outline(cube, poses, self.eye_m(), project, &mut scratch.corners) {
                frame.fill_convex(&scratch.corners, &mut scratch.spans);
            }
        }
    }

    /// The outline of a meta-module as a new frame.
    #[must_use]
    pub fn film_frame(&self, robot: &MetaModule, poses: &[Pose; BODIES]) -> Silhouette {
        let (width, height) = self.size_px();
        let mut frame = Silhouette::new(width, height);
        self.draw(robot, poses, &mut frame, &mut Scratch::default());
        frame
    }
}
