//! The outlines that films are made of, against rays cast through every pixel at the true shapes.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use camera::{MetaModule, Scratch, Silhouette, Solid, View};
use control::kinematics;
use control::linalg::{Pose, Rot3, Vec3};
use control::robot::{BODIES, RobotModel, RobotParams};

const HEIGHT_M: f32 = 2.27;
const YAW_RAD: f32 = 0.4;
const SIZE_PX: (usize, usize) = (640, 480);
const FOCAL_PX: f32 = 580.0;

/// A stream of numbers in 0..1 (a linear congruence is random enough to choose poses).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.next()
    }
}

fn random_poses(robot: &RobotModel, numbers: &mut Numbers) -> [Pose; BODIES] {
    let q = std::array::from_fn(|_| numbers.between(-3.1, 3.1));
    let axis = Vec3::new(
        numbers.between(-1.0, 1.0),
        numbers.between(-1.0, 1.0),
        numbers.between(0.1, 1.0),
    );
    let base = Pose {
        position_m: Vec3::new(
            numbers.between(-0.9, 0.9),
            numbers.between(-0.6, 0.6),
            numbers.between(0.06, 0.3),
        ),
        rotation: Rot3::about(axis * (1.0 / axis.norm()), numbers.between(-3.1, 3.1)),
    };
    *kinematics::forward(robot, &q).rebased(3, &base).bodies()
}

/// Whether the ray `from + t * along` meets one half of a cube: the ball, the six faces and the plane between the halves, all about `centre`.
fn ray_meets_half(
    from: [f64; 3],
    along: [f64; 3],
    (ball_m, face_m): (f64, f64),
    towards: [f64; 3],
) -> bool {
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (a, b, c) = (
        dot(along, along),
        dot(from, along),
        dot(from, from) - ball_m * ball_m,
    );
    let root = b * b - a * c;
    if root < 0.0 {
        return false;
    }
    let (mut enter, mut leave) = ((-b - root.sqrt()) / a, (-b + root.sqrt()) / a);
    let mut cut = |normal: [f64; 3], limit: f64| {
        let (rise, room) = (dot(normal, along), limit - dot(normal, from));
        if rise > 0.0 {
            leave = leave.min(room / rise);
        } else if rise < 0.0 {
            enter = enter.max(room / rise);
        } else if room < 0.0 {
            leave = f64::NEG_INFINITY;
        }
    };
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let mut normal = [0.0; 3];
            normal[axis] = side;
            cut(normal, face_m);
        }
    }
    cut(towards.map(|v| -v), 0.0);
    enter <= leave
}

/// The picture by rays, in f64, from the geometry of the design alone.
fn cast(robot: &RobotModel, poses: &[Pose; BODIES]) -> Silhouette {
    let (ball_m, face_m) = (
        f64::from(robot.ball_radius_m()),
        0.5 * f64::from(robot.cube_m()),
    );
    let (sin, cos) = f64::from(YAW_RAD).sin_cos();
    let origins = robot.body_origins_m();
    let third = 1.0 / 3f64.sqrt();
    let mut frame = Silhouette::new(SIZE_PX.0, SIZE_PX.1);
    for (joint, body, side) in [0, 2, 3, 5]
        .into_iter()
        .flat_map(|j| [(j, j, -1.0), (j, j + 1, 1.0)])
    {
        let pose = &poses[body];
        let centre = pose.transform(robot.axis_points_m()[joint] - origins[body]);
        // Cube axes in the world; module B is turned by the twist.
        let turned = |v: Vec3| {
            pose.rotation.apply(if joint >= 3 {
                robot.twist().apply(v)
            } else {
                v
            })
        };
        let axes = [Rot3::IDENTITY.x, Rot3::IDENTITY.y, Rot3::IDENTITY.z].map(turned);
        let into_cube = |v: [f64; 3]| {
            axes.map(|a| f64::from(a.x) * v[0] + f64::from(a.y) * v[1] + f64::from(a.z) * v[2])
        };
        let from = into_cube([
            -f64::from(centre.x),
            -f64::from(centre.y),
            f64::from(HEIGHT_M - centre.z),
        ]);
        for (x, y) in (0..SIZE_PX.0).flat_map(|x| (0..SIZE_PX.1).map(move |y| (x, y))) {
            let (u, v) = (
                (x as f64 + 0.5 - 320.0) / f64::from(FOCAL_PX),
                (240.0 - y as f64 - 0.5) / f64::from(FOCAL_PX),
            );
            let along = into_cube([cos * u - sin * v, sin * u + cos * v, -1.0]);
            if ray_meets_half(from, along, (ball_m, face_m), [side * third; 3]) {
                frame.fill(y, x, x + 1);
            }
        }
    }
    frame
}

fn view() -> View {
    View::new(HEIGHT_M, (0.0, 0.0), YAW_RAD, SIZE_PX, FOCAL_PX).unwrap()
}

#[test]
fn outlines_are_the_true_shapes() {
    let round = RobotParams {
        ball_radius_m: 0.0634,
        twist_rad: 0.3,
        ..RobotParams::NOMINAL
    };
    let mut numbers = Numbers(3);
    for robot in [RobotModel::default(), RobotModel::new(round).unwrap()] {
        let (module, solids) = (MetaModule::new(&robot), Solid::meta_module(&robot));
        let (mut area, mut drawn_area, mut differing, mut hull_area) = (0u32, 0u32, 0u32, 0u32);
        for _ in 0..12 {
            let poses = random_poses(&robot, &mut numbers);
            let truth = cast(&robot, &poses);
            let drawn = view().film_frame(&module, &poses);
            let (overlap, union) = truth.overlap_and_union_px(&drawn).unwrap();
            let here = f64::from(union - overlap) / f64::from(truth.area_px().max(1));
            assert!(here < 0.02, "{here} of a frame's pixels differ");
            area += truth.area_px();
            drawn_area += drawn.area_px();
            differing += union - overlap;
            hull_area += view().render(&solids, &poses).area_px();
        }
        let of = |part: u32| f64::from(part) / f64::from(area);
        println!(
            "area {:.4}, differing {:.4}, area by hulls of points {:.4}",
            of(drawn_area),
            of(differing),
            of(hull_area)
        );
        assert!((of(drawn_area) - 1.0).abs() < 0.005, "{}", of(drawn_area));
        assert!(of(differing) < 0.01, "{}", of(differing));
        assert!((of(hull_area) - 1.0).abs() < 0.02, "{}", of(hull_area));
    }
}

#[test]
fn a_frame_drawn_again_is_the_same_and_cut_at_the_edge() {
    let robot = RobotModel::default();
    let module = MetaModule::new(&robot);
    let (mut frame, mut scratch) = (Silhouette::new(640, 480), Scratch::default());
    let mut numbers = Numbers(8);
    for _ in 0..40 {
        let mut poses = random_poses(&robot, &mut numbers);
        // Over the whole picture and past its edges.
        let shift = Vec3::new(numbers.between(-1.5, 1.5), numbers.between(-1.2, 1.2), 0.0);
        for pose in &mut poses {
            pose.position_m = pose.position_m + shift;
        }
        frame.clear();
        view().draw(&module, &poses, &mut frame, &mut scratch);
        let fresh = view().film_frame(&module, &poses);
        assert_eq!(frame, fresh);
        assert_eq!(frame.cropped(), fresh);
        let wide = View::new(HEIGHT_M, (0.0, 0.0), YAW_RAD, (2048, 1536), FOCAL_PX).unwrap();
        let wide = wide.film_frame(&module, &poses);
        for (x, y) in (0..640)
            .step_by(7)
            .flat_map(|x| (0..480).step_by(5).map(move |y| (x, y)))
        {
            assert_eq!(frame.get(x, y), wide.get(x + 704, y + 528), "{x} {y}");
        }
    }
}

#[test]
fn a_cropped_frame_counts_and_grows_like_a_whole_one() {
    let mut whole = Silhouette::new(200, 50);
    whole.fill(10, 60, 140);
    whole.fill(12, 66, 70);
    let mut cropped = whole.cropped();
    assert_eq!(
        (cropped.area_px(), cropped.centre_px()),
        (84, whole.centre_px())
    );
    for (y, from, to) in [
        (11, 60, 140),
        (49, 0, 200),
        (0, 199, 500),
        (60, 0, 9),
        (10, 0, 100),
    ] {
        whole.fill(y, from, to);
        cropped.fill(y, from, to);
        assert_eq!(cropped, whole);
    }
    assert_eq!(whole.area_px(), 140 + 80 + 4 + 200 + 1);
    let counted = (0..50).flat_map(|y| (0..200).map(move |x| (x, y)));
    assert_eq!(counted.filter(|&(x, y)| cropped.get(x, y)).count(), 425);
    whole.clear();
    assert_eq!(whole, Silhouette::new(200, 50));
    assert_ne!(whole, Silhouette::new(200, 51));
    assert_eq!(whole.cropped().area_px(), 0);
}
