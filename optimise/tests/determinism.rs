//! A whole search and a whole fit, in small: the same bits on every instruction set, lane width and thread count, cut or whole.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod common;

use common::camera;
use control::robot::RobotModel;
use files::model::Model;
use optimise::meta::{
    FilmedGait, Fit, FrameTimes, Likeness, MotionJob, MotionTrials, Placement, rows_of,
};
use optimise::score::ScoreSettings;
use optimise::search::Search;
use optimise::select::{SelectSettings, select};
use optimise::simulated::{Simulated, SimulatedMotions};
use optimise::space::GaitSpace;
use physics::Level;
use serde::Serialize;

const SEED: u64 = 3;
const DURATION_S: f32 = 3.0;
/// Half of the iterations run before the cut.
const ITERATIONS: u32 = 4;

/// What this processor has; the others are named, so that a green run says what it was green on.
fn levels() -> Vec<Level> {
    let (here, missing): (Vec<Level>, Vec<Level>) =
        [Level::Scalar, Level::Sse2, Level::Avx2, Level::Avx512]
            .into_iter()
            .partition(|level| level.available());
    for level in missing {
        eprintln!("SKIPPED: this processor has no {level:?}");
    }
    here
}

fn on_threads<T: Send>(threads: usize, job: impl FnOnce() -> T + Send) -> T {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.unwrap().install(job)
}

fn bytes(state: &impl Serialize) -> String {
    serde_json::to_string(state).unwrap()
}

fn search_start() -> Search {
    let space = GaitSpace {
        duration_s: DURATION_S,
        ..GaitSpace::default()
    };
    let score = ScoreSettings {
        repetitions: 2,
        ..ScoreSettings::default()
    };
    // Ten particles of two repetitions: more than one group of the widest lanes, and a group that is not full.
    Search::start(space, score, 1.0, 10, SEED).unwrap()
}

fn search_on(mut search: Search, level: Level, iterations: u32) -> Search {
    let trials = Simulated::new(&Model::hand_tuned(), DURATION_S, SEED).unwrap();
    let trials = trials.at(level);
    (0..iterations).for_each(|_| assert!(search.iterate(&trials)));
    search
}

#[test]
fn a_search_has_the_same_bits_on_every_level_and_thread_count() {
    let expected = search_on(search_start(), Level::Scalar, ITERATIONS);
    assert!(
        expected.swarm().best().unwrap().fitness > 0.0,
        "nothing walks"
    );
    let chosen = select(
        expected.space(),
        expected.archive(),
        &SelectSettings::default(),
    );
    for level in levels() {
        for threads in [1, 2, 3] {
            let found = on_threads(threads, || search_on(search_start(), level, ITERATIONS));
            assert!(
                bytes(&found) == bytes(&expected),
                "{level:?}, {threads} threads"
            );
            let again = select(found.space(), found.archive(), &SelectSettings::default());
            assert_eq!(again, chosen);
        }
    }
}

/// Stopped on one machine, gone on with on another that has other instructions.
#[test]
fn a_search_cut_and_resumed_on_another_level_has_the_same_bits() {
    let expected = bytes(&search_on(search_start(), Level::detect(), ITERATIONS));
    for first in levels() {
        for second in levels() {
            let stored = bytes(&search_on(search_start(), first, ITERATIONS / 2));
            let read: Search = serde_json::from_str(&stored).unwrap();
            let done = search_on(read, second, ITERATIONS - ITERATIONS / 2);
            assert!(bytes(&done) == expected, "{first:?}, then {second:?}");
        }
    }
}

fn motions(level: Level) -> SimulatedMotions {
    let duration_s = f64::from(DURATION_S) + 1.0;
    SimulatedMotions::new(&Model::hand_tuned(), RobotModel::default(), duration_s).at(level)
}

/// Two films of a gait on the meta-optimised model.
fn filmed(level: Level) -> FilmedGait {
    let gait = GaitSpace::default().gait(&[0.4; 17], "any").unwrap();
    let rows = rows_of(&Model::meta_optimised());
    let job = MotionJob {
        gait: &gait,
        parameters: &rows,
        // The whole motion, from the start of the gait.
        times: FrameTimes {
            rate_hz: 30.0,
            frames: 30 * (DURATION_S as usize + 1),
            stride: 1,
            shift_s: 0.0,
        },
    };
    let motion = motions(level).run(&[job]).remove(0).unwrap();
    let frames = (DURATION_S * 30.0) as usize;
    let film = camera(10)
        .film(&motion.bodies, 30.0, &rows, frames, 1, Placement::default())
        .unwrap();
    FilmedGait::new(gait, vec![film.clone(), film], None, 0.05, true).unwrap()
}

fn fit_on(fit: Option<Fit>, gaits: &[FilmedGait], level: Level, iterations: u32) -> Fit {
    let likeness = Likeness::new(gaits, camera(10)).unwrap();
    let start = rows_of(&Model::hand_tuned());
    let mut fit = fit.unwrap_or_else(|| Fit::start(&[3, 13, 21, 22], &start, 5, SEED).unwrap());
    (0..iterations).for_each(|_| assert!(fit.iterate(&likeness, &motions(level)).unwrap()));
    fit
}

#[test]
fn films_and_the_fit_to_them_have_the_same_bits_everywhere() {
    let gaits = [filmed(Level::Scalar)];
    let expected = bytes(&fit_on(None, &gaits, Level::Scalar, ITERATIONS));
    for level in levels() {
        assert!(filmed(level).films == gaits[0].films, "films on {level:?}");
        for threads in [1, 2, 3] {
            let found = on_threads(threads, || fit_on(None, &gaits, level, ITERATIONS));
            assert!(bytes(&found) == expected, "{level:?}, {threads} threads");
        }
        let stored = bytes(&fit_on(None, &gaits, level, 1));
        let read = serde_json::from_str(&stored).unwrap();
        let resumed = fit_on(Some(read), &gaits, Level::detect(), ITERATIONS - 1);
        assert!(bytes(&resumed) == expected, "cut on {level:?}");
    }
}
