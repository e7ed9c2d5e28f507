//! A search that is asked to stop leaves the rest of its iteration, and stays as it was.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod common;

use common::camera;
use std::sync::atomic::{AtomicUsize, Ordering};

use control::robot::RobotModel;
use files::model::Model;
use optimise::meta::{
    FilmedGait, Fit, FrameTimes, Likeness, MotionJob, MotionTrials, Placement, rows_of,
};
use optimise::score::ScoreSettings;
use optimise::search::{GaitTrials, Search};
use optimise::shard::{Alone, Sharded};
use optimise::simulated::{Simulated, SimulatedMotions};
use optimise::space::GaitSpace;
use physics::Level;

const DURATION_S: f32 = 2.0;
const PARTICLES: usize = 40;

static SEARCH_ASKED: AtomicUsize = AtomicUsize::new(0);
static FIT_ASKED: AtomicUsize = AtomicUsize::new(0);

/// From the third question on.
fn search_stop() -> bool {
    SEARCH_ASKED.fetch_add(1, Ordering::SeqCst) >= 2
}

fn fit_stop() -> bool {
    FIT_ASKED.fetch_add(1, Ordering::SeqCst) >= 2
}

#[test]
fn a_gait_search_asks_before_every_group_and_drops_the_iteration() {
    let space = GaitSpace {
        duration_s: DURATION_S,
        ..GaitSpace::default()
    };
    let mut search = Search::start(space, ScoreSettings::default(), 1.0, PARTICLES, 3).unwrap();
    let trials = || {
        let trials = Simulated::new(&Model::hand_tuned(), DURATION_S, 3).unwrap();
        trials.at(Level::Scalar)
    };
    assert!(search.iterate(&Sharded::new(trials(), Alone)));
    let before = search.clone();
    let stopping = Sharded::new(trials().until(search_stop), Alone);
    assert!(!search.iterate(&stopping));
    assert_eq!(search, before);
    // Once a group, and once at the end.
    let groups = PARTICLES.div_ceil(Level::Scalar.lanes());
    assert!(SEARCH_ASKED.load(Ordering::SeqCst) > groups);
    assert!(stopping.stopped());
    // It goes on with the same bits.
    let mut whole = before.clone();
    assert!(search.iterate(&trials()) && whole.iterate(&trials()));
    assert_eq!(search, whole);
}

fn motions() -> SimulatedMotions {
    let duration_s = f64::from(DURATION_S) + 1.0;
    SimulatedMotions::new(&Model::hand_tuned(), RobotModel::default(), duration_s)
}

#[test]
fn a_fit_asks_before_every_group_and_every_film_and_drops_the_iteration() {
    let gait = GaitSpace::default().gait(&[0.4; 17], "any").unwrap();
    let rows = rows_of(&Model::meta_optimised());
    let job = MotionJob {
        gait: &gait,
        parameters: &rows,
        times: FrameTimes {
            rate_hz: 30.0,
            frames: 30 * (DURATION_S as usize + 1),
            stride: 1,
            shift_s: 0.0,
        },
    };
    let motion = motions().run(&[job]).remove(0).unwrap();
    let frames = (DURATION_S * 30.0) as usize;
    let film = camera(10).film(&motion.bodies, 30.0, &rows, frames, 1, Placement::default());
    let film = film.unwrap();
    let gaits = [FilmedGait::new(gait, vec![film.clone(), film], None, 0.05, true).unwrap()];
    let likeness = Likeness::new(&gaits, camera(10)).unwrap();
    let start = rows_of(&Model::hand_tuned());
    let mut fit = Fit::start(&[3, 13, 21, 22], &start, PARTICLES, 5).unwrap();
    assert!(fit.iterate(&likeness, &motions()).unwrap());
    let before = fit.clone();
    let stopping = motions().until(fit_stop);
    assert!(!fit.iterate(&likeness, &stopping).unwrap());
    assert_eq!(fit, before);
    assert!(FIT_ASKED.load(Ordering::SeqCst) >= PARTICLES.div_ceil(Level::detect().lanes()));
    assert!(fit.iterate(&likeness, &motions()).unwrap());
}
