//! Forward kinematics against the published table, an independent f64 chain and distance invariants.

use crate::oracle::{EDGE_M, Oracle, Rng};
use control::kinematics::forward;
use control::linalg::{Pose, Rot3, Vec3};
use control::robot::{RobotError, RobotField, RobotModel, RobotParams};

/// Joint angles in degrees, then C2, C3, C4 and the end face centre in m, then the distance C1 C4.
type Row = ([f32; 6], [[f32; 3]; 4], f32);

const TABLE: [Row; 4] = [
    (
        [120.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [
            [0.0, 0.110, 0.0],
            [0.0, 0.220, 0.0],
            [0.0, 0.330, 0.0],
            [0.0, 0.385, 0.0],
        ],
        0.330_000,
    ),
    (
        [0.0, 90.0, 120.0, 0.0, 0.0, 0.0],
        [
            [0.110, 0.0, 0.0],
            [0.110, 0.0, 0.110],
            [0.110, 0.0, 0.220],
            [0.110, 0.0, 0.275],
        ],
        0.245_967,
    ),
    (
        [0.0, 0.0, 120.0, -120.0, 0.0, 0.0],
        [
            [0.110, 0.0, 0.0],
            [0.110, 0.110, 0.0],
            [0.110, 0.110, -0.110],
            [0.110, 0.110, -0.165],
        ],
        0.190_526,
    ),
    (
        [30.0, -45.0, 60.0, -75.0, 90.0, -105.0],
        [
            [0.100_175, 0.036_667, -0.026_842],
            [0.134_705, 0.103_703, -0.106_929],
            [0.172_577, 0.062_415, -0.201_591],
            [0.143_491, 0.015_761, -0.203_156],
        ],
        0.272_612,
    ),
];

#[test]
fn the_published_table_to_a_micrometre() {
    let model = RobotModel::default();
    for (q_deg, points, distance) in TABLE {
        let poses = forward(&model, &q_deg.map(f32::to_radians));
        let [c1, c2, c3, c4] = poses.cube_centres_m();
        for (found, want) in [c2, c3, c4, poses.end_face_m()].into_iter().zip(points) {
            for (f, w) in found.to_array().into_iter().zip(want) {
                assert!((f - w).abs() <= 1e-6, "{q_deg:?}: {found:?} not {want:?}");
            }
        }
        assert!(((c4 - c1).norm() - distance).abs() <= 1e-6);
    }
}

#[test]
fn the_chain_agrees_with_an_independent_one_at_any_twist() {
    let mut rng = Rng(3);
    for twist in [0.0f64, 0.5, std::f64::consts::FRAC_PI_2, -1.0, 3.0] {
        let twist = twist as f32;
        let model = RobotModel::new(RobotParams {
            twist_rad: twist,
            ..RobotParams::default()
        })
        .expect("valid");
        let oracle = Oracle::new(f64::from(twist));
        for _ in 0..200 {
            let q = rng.pose();
            let ours = forward(&model, &q);
            let origins = model.body_origins_m();
            for (k, world) in oracle.bodies(&q).iter().enumerate() {
                let home = origins[k].to_array().map(f64::from);
                let want = world * nalgebra::Point3::from(home);
                let body = ours.bodies()[k];
                for (f, w) in body.position_m.to_array().into_iter().zip(want.iter()) {
                    assert!((f64::from(f) - w).abs() < 1e-6);
                }
                for (e, axis) in [
                    (body.rotation.x, 0),
                    (body.rotation.y, 1),
                    (body.rotation.z, 2),
                ] {
                    let mut unit = nalgebra::Vector3::zeros();
                    unit[axis] = 1.0;
                    let want = world.rotation * unit;
                    for (f, w) in e.to_array().into_iter().zip(want.iter()) {
                        assert!((f64::from(f) - w).abs() < 2e-6);
                    }
                }
            }
        }
    }
}

#[test]
fn centre_distances_depend_on_two_joints_and_keep_their_floor() {
    let model = RobotModel::default();
    let mut rng = Rng(4);
    for _ in 0..500 {
        let (a, b) = (rng.pose(), rng.pose());
        let mixed = [b[0], b[1], a[2], a[3], b[4], b[5]];
        let distances = |q| {
            let [c1, c2, c3, c4] = forward(&model, q).cube_centres_m();
            [(c3 - c1).norm(), (c4 - c2).norm(), (c4 - c1).norm()]
        };
        let (p, q) = (distances(&a), distances(&mixed));
        for (x, y) in p.into_iter().zip(q) {
            assert!((x - y).abs() < 1e-6);
        }
        assert!(p[0] >= 1.1547 * 0.11 - 1e-5 && p[1] >= 1.1547 * 0.11 - 1e-5);
    }
    let touching = |model: &RobotModel| {
        let n = 200;
        let mut inside = 0;
        for i in 0..n * n {
            let angle = |k: i32| k as f32 / n as f32 * std::f32::consts::TAU;
            let [c1, _, _, c4] =
                forward(model, &[0.0, 0.0, angle(i % n), angle(i / n), 0.0, 0.0]).cube_centres_m();
            inside += i32::from((c4 - c1).norm() < EDGE_M as f32);
        }
        100.0 * f64::from(inside) / f64::from(n * n)
    };
    for (twist_deg, share) in [(0.0f32, 0.0), (90.0, 3.6), (180.0, 10.1), (270.0, 3.6)] {
        let model = RobotModel::new(RobotParams {
            twist_rad: twist_deg.to_radians(),
            ..RobotParams::default()
        })
        .expect("valid");
        let found = touching(&model);
        assert!((found - share).abs() < 0.15, "twist {twist_deg}: {found} %");
    }
}

#[test]
fn any_body_can_be_the_base() {
    let model = RobotModel::default();
    let q = [0.3, -0.4, 1.0, 2.0, -3.0, 0.7];
    let poses = forward(&model, &q);
    let base = Pose {
        position_m: Vec3::new(0.1, 0.2, 0.3),
        rotation: Rot3::about(Vec3::new(0.6, 0.0, 0.8), 1.2),
    };
    for body in 0..7 {
        let moved = poses.rebased(body, &base);
        let at = moved.bodies()[body];
        assert!((at.position_m - base.position_m).norm() < 1e-6);
        for (i, j) in [(0, 6), (2, 5), (1, 3)] {
            let before = (poses.bodies()[i].position_m - poses.bodies()[j].position_m).norm();
            let after = (moved.bodies()[i].position_m - moved.bodies()[j].position_m).norm();
            assert!((before - after).abs() < 1e-6);
        }
    }
}

#[test]
fn quaternions_are_those_of_nalgebra() {
    let mut rng = Rng(9);
    for _ in 0..300 {
        let (axis, angle) = (rng.pose(), rng.pose()[0]);
        let v = nalgebra::Vector3::new(f64::from(axis[0]), f64::from(axis[1]), f64::from(axis[2]))
            .normalize();
        let want = nalgebra::UnitQuaternion::from_axis_angle(
            &nalgebra::Unit::new_normalize(v),
            f64::from(angle),
        );
        let q = Rot3::about(Vec3::new(v.x as f32, v.y as f32, v.z as f32), angle).to_quaternion();
        let sign = if want.w < 0.0 { -1.0 } else { 1.0 };
        for (f, w) in q.into_iter().zip([want.w, want.i, want.j, want.k]) {
            assert!((f64::from(f) - sign * w).abs() < 1e-5, "{q:?} {want:?}");
        }
        let back = Rot3::from_quaternion(q);
        let want = want.to_rotation_matrix();
        for (column, axis) in [back.x, back.y, back.z].into_iter().zip(0..3) {
            for (f, row) in column.to_array().into_iter().zip(0..3) {
                let w = want[(row, axis)];
                assert!((f64::from(f) - w).abs() < 1e-5, "{back:?} {want:?}");
            }
        }
    }
}

#[test]
fn a_robot_out_of_range_is_refused() {
    for (params, field) in [
        (
            RobotParams {
                twist_rad: f32::NAN,
                ..RobotParams::default()
            },
            RobotField::Twist,
        ),
        (
            RobotParams {
                cube_m: 0.0,
                ..RobotParams::default()
            },
            RobotField::Cube,
        ),
        (
            RobotParams {
                ball_radius_m: 0.064,
                ..RobotParams::default()
            },
            RobotField::BallRadius,
        ),
        (
            RobotParams {
                ball_radius_m: 0.054,
                ..RobotParams::default()
            },
            RobotField::BallRadius,
        ),
    ] {
        let Err(RobotError::OutOfRange { field: found, .. }) = RobotModel::new(params) else {
            panic!("{params:?}")
        };
        assert_eq!(found, field);
    }
}
