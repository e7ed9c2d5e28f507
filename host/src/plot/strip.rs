//! A film strip: the robot's pose at equal times, drawn from the measured joint angles.

use control::kinematics;
use control::linalg::{Pose, Rot3, Vec3};
use control::robot::{JOINTS, RobotModel};

use super::svg::{Point, Svg};
use super::{MODULE_A, MODULE_B};
use crate::recording::RunData;

const FRAMES: usize = 9;
/// Pixels per metre: the stretched robot (0.45 m) fills a frame.
const SCALE: f64 = 250.0;
/// Light tints of the module colours for the proximal halves.
const TINTS: [&str; 2] = ["#b5d8ee", "#f6cfae"];
/// Joint through the centre of each cube: its axis is the normal of the cut between the two half-spheres.
const CUBE_JOINTS: [usize; 4] = [0, 2, 3, 5];
/// Proximal body of each cube.
const CUBE_BODIES: [usize; 4] = [0, 2, 3, 5];
/// The middle body, held still in the pictures.
const MIDDLE: usize = 3;

/// Draws the strip with its upper left corner at `at`.
pub(super) fn draw(
    out: &mut Svg,
    run: &RunData,
    model: &RobotModel,
    span: (f64, f64),
    seconds: &impl Fn(u64) -> f64,
    at: Point,
    width: f64,
) {
    let frame = width / FRAMES as f64;
    for k in 0..FRAMES {
        let t = span.0.max(0.0) + (span.1 - span.0.max(0.0)) * k as f64 / (FRAMES - 1) as f64;
        let nearest = run.samples.iter().min_by(|a, b| {
            let distance = |t_us| (seconds(t_us) - t).abs();
            distance(a.t_us).total_cmp(&distance(b.t_us))
        });
        let Some(sample) = nearest else { return };
        let mut q = [0f32; JOINTS];
        for (q, joint) in q.iter_mut().zip(&sample.joints) {
            *q = joint
                .feedback
                .map_or(joint.setpoint_rad, |f| f.position_rad) as f32;
        }
        let corner = (at.0 + frame * k as f64, at.1);
        let size = (frame - 4.0, super::STRIP_HEIGHT - 22.0);
        out.rect(corner, size, "#fafafa", 1.0);
        out.frame(corner, size, "#dddddd");
        let centre = (corner.0 + size.0 / 2.0, corner.1 + size.1 / 2.0);
        robot(out, model, &q, centre);
        let label = format!("{:.1} s", seconds(sample.t_us));
        out.text(
            (centre.0, corner.1 + size.1 + 15.0),
            11.0,
            "#555555",
            "middle",
            &label,
        );
    }
}

/// Viewing frame: x to the right, turned and seen from above by 25 degrees each: both halves of all four cubes show.
fn view() -> Rot3 {
    let turn = Rot3::about(Vec3::new(0.0, 0.0, 1.0), 0.44);
    let tilt = Rot3::about(Vec3::new(1.0, 0.0, 0.0), 0.44);
    turn.then_outer(&tilt)
}

fn robot(out: &mut Svg, model: &RobotModel, q: &[f32; JOINTS], centre: Point) {
    let still = Pose {
        position_m: Vec3::ZERO,
        rotation: Rot3::IDENTITY,
    };
    let poses = kinematics::forward(model, q).rebased(MIDDLE, &still);
    let view = view();
    let project = |p: Vec3| -> (Point, f32) {
        let v = view.apply(p);
        // World y goes into the picture, z up.
        (
            (
                centre.0 + f64::from(v.x) * SCALE,
                centre.1 - f64::from(v.z) * SCALE,
            ),
            -v.y,
        )
    };
    let mut cubes: Vec<(usize, Point, f32)> = poses
        .cube_centres_m()
        .iter()
        .enumerate()
        .map(|(k, c)| {
            let (point, depth) = project(*c);
            (k, point, depth)
        })
        .collect();
    // Far ones first.
    cubes.sort_by(|a, b| a.2.total_cmp(&b.2));
    for (k, point, _) in cubes {
        let rotation = &poses.bodies()[CUBE_BODIES[k]].rotation;
        let normal = view.apply(rotation.apply(model.axes()[CUBE_JOINTS[k]]));
        cube(
            out,
            point,
            f64::from(model.ball_radius_m()) * SCALE,
            normal,
            k / 2,
        );
    }
}

/// One cube as a ball of two halves; the dark half is the distal one.
fn cube(out: &mut Svg, centre: Point, radius: f64, normal: Vec3, module: usize) {
    let dark = if module == 0 { MODULE_A } else { MODULE_B };
    out.circle(centre, radius, TINTS[module.min(1)], "#333333");
    // In picture axes: x right, y up, z towards the viewer.
    let n = [
        f64::from(normal.x),
        f64::from(normal.z),
        -f64::from(normal.y),
    ];
    let flat = n[0].hypot(n[1]);
    if flat < 1e-3 {
        if n[2] > 0.0 {
            out.circle(centre, radius, dark, "#333333");
        }
        return;
    }
    let (ux, uy) = (n[0] / flat, n[1] / flat);
    // Outline on the normal's side, then back along the visible half of the cut circle.
    let turn = |i: usize| core::f64::consts::PI * (i as f64 / 16.0 - 0.5);
    let outline = (0..=16).map(|i| {
        let (s, c) = turn(i).sin_cos();
        (ux * c - uy * s, uy * c + ux * s)
    });
    let cut = (0..=16).rev().map(|i| {
        let (s, c) = turn(i).sin_cos();
        // The visible half of the cut circle bulges against the normal by its slant towards the viewer.
        (-uy * s - ux * c * n[2], ux * s - uy * c * n[2])
    });
    let points: Vec<Point> = outline
        .chain(cut)
        .map(|(x, y)| (centre.0 + x * radius, centre.1 - y * radius))
        .collect();
    out.polygon(&points, dark, "#333333", 0.8);
}
