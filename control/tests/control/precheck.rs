//! The pre-check against the oracle, in a size for every test run; the example `precheck_oracle` runs the full one.

use crate::oracle::Rng;
use crate::study::{Study, Where};
use control::geometry::half_spheres;
use control::precheck::{self, MARGIN_M, Margins, Verdict};
use control::robot::RobotModel;
use std::f64::consts::{FRAC_PI_2, PI};

#[test]
fn no_pose_is_missed_and_the_bound_is_never_optimistic() {
    for (twist, seed) in [(FRAC_PI_2, 11), (PI, 12), (0.3, 13)] {
        let study = Study::new(twist, seed);
        assert!(
            study.oracle.reach_m < 2e-4,
            "the polyhedra are fine enough: {}",
            study.oracle.reach_m
        );
        for table in [
            study.poses(40_000, Where::Everywhere),
            study.poses(if twist > 1.0 { 10_000 } else { 0 }, Where::Near),
        ] {
            assert_eq!((table.missed, table.optimistic), (0, 0), "{table}");
            assert!(table.gap_max_mm < 2.0, "the bound is tight: {table}");
        }
    }
}

#[test]
fn no_move_is_missed_and_few_with_room_are_blocked() {
    for (twist, seed) in [(FRAC_PI_2, 21), (PI, 22)] {
        let table = Study::new(twist, seed).moves(4_000);
        assert_eq!((table.missed, table.optimistic), (0, 0), "{table}");
        assert!(
            table.colliding > 500 && table.in_band > 500,
            "the sample is a real test: {table}"
        );
        assert!(table.blocked_share() < 0.05, "{table}");
    }
}

#[test]
fn other_joints_turn_the_flats_and_matter() {
    // The same two arms; what differs is which flat faces the other cube.
    let model = RobotModel::default();
    let arms = [(-150f32).to_radians(), (-195f32).to_radians()];
    let mut rng = Rng(5);
    let mut seen = (f32::INFINITY, 0.0f32);
    for _ in 0..2000 {
        let mut q = rng.pose();
        [q[2], q[3]] = arms;
        let c = precheck::clearance(&model, &q).clearance_m;
        seen = (seen.0.min(c), seen.1.max(c));
    }
    assert!(seen.1 - seen.0 > 0.004, "{seen:?}");
}

#[test]
fn not_a_number_is_never_clear() {
    let model = RobotModel::default();
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for joint in 0..6 {
            let mut q = [0.1f32; 6];
            q[joint] = bad;
            assert!(precheck::clearance(&model, &q).clearance_m < 0.0);
            if joint == 2 || joint == 3 {
                assert!(matches!(
                    precheck::swept(&model, &[0.1; 6], &q, MARGIN_M),
                    Verdict::Blocked(_)
                ));
                assert!(matches!(
                    precheck::swept(&model, &q, &[0.1; 6], MARGIN_M),
                    Verdict::Blocked(_)
                ));
            }
        }
    }
}

#[test]
fn a_robot_too_close_may_move_apart_but_not_closer() {
    let model = RobotModel::default();
    let margins = Margins {
        keep_m: 3e-3,
        escape_m: 1e-3,
    };
    // Along A.M2 towards the keep-out zone until the clearance is about 2 mm.
    let pose = |q2: f32| [0.0, 0.0, q2, (-127f32).to_radians(), 0.0, 0.0];
    let clearance = |q2: f32| precheck::clearance(&model, &pose(q2)).clearance_m;
    let mut q2 = -1.4f32;
    while clearance(q2) > 2e-3 {
        q2 -= 1e-3;
    }
    assert!((1e-3..2.1e-3).contains(&clearance(q2)));
    let check = |to: f32| precheck::check_move(&model, &pose(q2), &pose(to), margins);
    assert!(
        matches!(check(q2 + 0.05), Verdict::Clear { .. }),
        "away: {:?}",
        check(q2 + 0.05)
    );
    assert!(matches!(check(q2 - 0.001), Verdict::Blocked(_)), "closer");
    assert!(
        matches!(check(q2 - 6.0), Verdict::Blocked(_)),
        "through and out on the other side"
    );
    while clearance(q2) > 0.5e-3 {
        q2 -= 1e-3;
    }
    assert!(
        matches!(
            precheck::check_move(&model, &pose(q2), &pose(q2 + 0.05), margins),
            Verdict::Blocked(_)
        ),
        "in contact"
    );
}

#[test]
fn eight_half_spheres_on_seven_bodies() {
    let halves = half_spheres(&RobotModel::default());
    assert_eq!(halves.map(|h| h.body), [0, 1, 2, 3, 3, 4, 5, 6]);
    for h in halves {
        for n in h.flat_normals {
            // Each flat looks away from the cut and does not reach it: 35.3 deg against 27.5 deg.
            let to_cut = libm::asinf(-n.dot(h.cut_normal));
            assert!(to_cut > libm::acosf(h.height_m / h.ball_m) + 0.1);
        }
    }
}
