//! The fit of Table II on a motion with known parameters.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod common;

use ::camera::Silhouette;
use common::camera;
use control::gait::Gait;
use control::linalg::{Pose, Rot3, Vec3};
use control::robot::{BODIES, RobotModel};
use files::model::Model;
use optimise::meta::{
    FilmedGait, Fit, Likeness, MetaError, Motion, MotionJob, MotionTrials, Placement, TableIii,
    rows_of,
};
use optimise::space::GaitSpace;
use optimise::table2::ROWS;

/// A robot that drifts along x with a speed set by the friction row and bends its first joint by the P row.
struct Drift;

impl MotionTrials for Drift {
    fn run(&self, jobs: &[MotionJob<'_>]) -> Vec<Option<Motion>> {
        let at_times = |job: &MotionJob<'_>| {
            let whole = drift(job.parameters)?;
            let samples = job.times.samples(30.0);
            Some(Motion {
                start: whole[0][3],
                bodies: samples.map_while(|k| whole.get(k).copied()).collect(),
            })
        };
        jobs.iter().map(at_times).collect()
    }
}

fn drift(parameters: &[f64; ROWS]) -> Option<Vec<[Pose; BODIES]>> {
    let robot = RobotModel::default();
    let frames = (0..330).map(|k| {
        let t_s = k as f32 / 30.0;
        let bend = (parameters[14] as f32 - 10.0) * 0.2;
        let q = [0.0, 0.0, bend, 0.0, 0.4 * t_s, 0.0];
        let x = 0.02 * parameters[2] as f32 * t_s - 0.165;
        let base = Pose {
            position_m: Vec3::new(x, 0.0, 0.1),
            ..Pose::default()
        };
        *control::kinematics::forward(&robot, &q)
            .rebased(3, &base)
            .bodies()
    });
    Some(frames.collect())
}

fn gait() -> Gait {
    GaitSpace::default().gait(&[0.1; 17], "any").unwrap()
}

fn truth() -> [f64; ROWS] {
    let mut truth = rows_of(&Model::hand_tuned());
    (truth[2], truth[14], truth[20], truth[21]) = (2.2, 7.5, 2.27, 0.5);
    truth
}

fn filmed(training: bool) -> FilmedGait {
    let film = camera(15)
        .film(
            &drift(&truth()).unwrap(),
            30.0,
            &truth(),
            300,
            1,
            Placement::default(),
        )
        .unwrap();
    FilmedGait::new(gait(), vec![film.clone(), film], None, 0.05, training).unwrap()
}

#[test]
fn a_fit_of_four_rows_recovers_what_was_filmed() {
    let gaits = [filmed(true), filmed(false)];
    let likeness = Likeness::new(&gaits, camera(15)).unwrap();
    let mut fit = Fit::start(&[3, 15, 21, 22], &rows_of(&Model::hand_tuned()), 24, 5).unwrap();
    let before = TableIii::new(&gaits, &likeness.ratios(&fit.best(), &Drift).unwrap());
    for _ in 0..25 {
        fit.iterate(&likeness, &Drift).unwrap();
    }
    let after = TableIii::new(&gaits, &likeness.ratios(&fit.best(), &Drift).unwrap());
    assert!(
        before.training < 0.7 && after.training > 0.95,
        "{before:?} {after:?}"
    );
    assert!(
        (after.test.unwrap() - after.training).abs() < 1e-9
            && (after.all - after.training).abs() < 1e-9
    );
    let best = fit.best();
    assert!(
        (best[2] - 2.2).abs() < 0.15 && (best[14] - 7.5).abs() < 0.5,
        "{best:?}"
    );
    assert_eq!(best[4], 0.325, "rows that are not fitted stay");
    let stored: Fit = serde_json::from_str(&serde_json::to_string(&fit).unwrap()).unwrap();
    assert_eq!(stored, fit);
}

#[test]
fn wrong_rows_and_missing_training_are_refused() {
    for rows in [&[0u8][..], &[23], &[3, 3]] {
        assert!(matches!(
            Fit::start(rows, &rows_of(&Model::hand_tuned()), 4, 0),
            Err(MetaError::Row { .. })
        ));
    }
    let gaits = [filmed(false)];
    assert!(matches!(
        Likeness::new(&gaits, camera(15)),
        Err(MetaError::NoTraining)
    ));
}

#[test]
fn a_film_without_the_robot_is_refused() {
    let film = filmed(true).films.remove(0);
    let empty = vec![Silhouette::new(160, 120); film.len()];
    let refused = FilmedGait::new(gait(), vec![film, empty], None, 0.05, true);
    assert!(matches!(refused, Err(MetaError::NeverSeen { trial: 2 })));
}

fn outside() -> Pose {
    Pose {
        position_m: Vec3::new(50.0, 0.0, 0.1),
        ..Pose::default()
    }
}

/// A film of a robot that was put down elsewhere and turned is matched by the motion of one that began at the origin.
#[test]
fn a_motion_is_laid_onto_the_measured_start() {
    let whole = drift(&truth()).unwrap();
    let turned = Pose {
        position_m: Vec3::new(0.2, -0.1, 0.0),
        rotation: Rot3::about(Vec3::new(0.0, 0.0, 1.0), 0.7),
    };
    let moved: Vec<[Pose; BODIES]> = whole
        .iter()
        .map(|bodies| bodies.map(|body| turned.compose(&body)))
        .collect();
    let film = camera(15)
        .film(&moved, 30.0, &truth(), 300, 1, Placement::default())
        .unwrap();
    let films = vec![film.clone(), film];
    let placed = FilmedGait::new(gait(), films.clone(), Some(moved[0][3]), 0.05, true).unwrap();
    let lost = FilmedGait::new(gait(), films, None, 0.05, true).unwrap();
    let gaits = [placed, lost];
    let likeness = Likeness::new(&gaits, camera(15)).unwrap();
    let ratios = likeness.ratios(&truth(), &Drift).unwrap();
    // A pixel at the rim may fall to the other side by rounding.
    assert!(ratios[0] > 0.99 && ratios[1] < 0.5, "{ratios:?}");
}

/// A gait whose robot is never seen where the simulated one is counts 0: it is neither perfect nor forgotten.
#[test]
fn a_gait_with_no_frame_of_both_robots_counts_zero() {
    let seen = filmed(true);
    // The simulated robot begins far outside the picture.
    let apart = FilmedGait {
        start: Some(outside()),
        ..seen.clone()
    };
    // The real one is seen in a single frame, which the search with its stride does not look at.
    let mut once = seen.films[0].clone();
    for (k, frame) in once.iter_mut().enumerate() {
        if k != 1 {
            frame.clear();
        }
    }
    let glimpsed = FilmedGait {
        start: Some(outside()),
        films: vec![once.clone(), once],
        ..seen.clone()
    };
    for (lost, share) in [(apart, 1.0), (glimpsed, 1.0 / 300.0)] {
        assert!((lost.share_seen() - share).abs() < 1e-9);
        let gaits = [lost, seen.clone()];
        let likeness = Likeness::new(&gaits, camera(15)).unwrap();
        assert_eq!(likeness.ratios(&truth(), &Drift).unwrap(), [0.0, 1.0]);
        let mut fit = Fit::start(&[3], &truth(), 2, 1).unwrap();
        fit.iterate(&likeness, &Drift).unwrap();
        // The first particle is the truth: 1 for the gait that is seen, 0 for the other, equal weights.
        assert_eq!(fit.swarm().best().unwrap().fitness, 0.5);
        assert!(fit.means()[0] <= 0.5 && fit.means().len() == 1);
    }
}
