//! The search on trials with a known answer, cut and resumed, and what it keeps.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use files::model::{Key, Model};
use optimise::score::{ScoreSettings, TrialOutcome};
use optimise::search::{GaitJob, GaitTrials, Search};
use optimise::select::{SelectSettings, Why, difference, select};
use optimise::shard::{Exchange, Sharded};
use optimise::space::GaitSpace;
use optimise::table2::implausible_factor;
use std::sync::{Arc, Barrier, Mutex};
use swarm::{Purpose, stream, unit};

/// Numbers of a meta-module's gait (paper, section V).
const DIMENSIONS: usize = 17;

/// A robot whose speed is known: it grows with the amplitude of joint 1 and with the nearness of its offset to 0.5 rad; joints 2 and
/// 3 with the same sign of offset collide.
struct Known;

impl GaitTrials for Known {
    fn run(&self, jobs: &[GaitJob<'_>]) -> Vec<TrialOutcome> {
        jobs.iter().map(known_outcome).collect()
    }
}

fn known_outcome(job: &GaitJob<'_>) -> TrialOutcome {
    let o = job.gait.oscillators();
    let noise = unit(&mut stream(
        1,
        job.iteration,
        job.particle,
        Purpose::Noise(job.repetition),
    )) as f32;
    let off = o[1].offset_rad - 0.5;
    let speed = 0.05 * o[1].amplitude_rad / (1.0 + off * off) + 0.001 * noise;
    TrialOutcome {
        path_m: (0..=30).map(|t| [speed * t as f32, 0.0]).collect(),
        period_s: 1.0,
        collided: o[2].offset_rad * o[3].offset_rad > 0.0,
        impact_m_s: 0.1,
        failed_at_step: None,
    }
}

fn search(iterations: u32) -> Search {
    let mut search =
        Search::start(GaitSpace::default(), ScoreSettings::default(), 0.5, 60, 4).unwrap();
    for _ in 0..iterations {
        search.iterate(&Known);
    }
    search
}

#[test]
fn the_known_optimum_is_found_without_collision() {
    let search = search(60);
    let best = search.swarm().best().unwrap();
    let highest = search.space().bounds()[1].1;
    assert!(
        (best.position[1] / highest - 1.0).abs() < 0.02,
        "{:?}",
        best.position
    );
    assert!((best.position[7] - 0.5).abs() < 0.1, "{:?}", best.position);
    assert!(best.position[8] * best.position[9] <= 0.0);
    assert!(search.counts().collisions > 0);
    assert_eq!(search.counts().trials, 60 * 60 * 3);
    assert!(
        search
            .swarm()
            .history()
            .windows(2)
            .all(|w| w[0].fitness <= w[1].fitness)
    );
}

#[test]
fn a_search_stored_and_read_back_goes_on_with_the_same_bits() {
    let mut cut = search(7);
    cut = serde_json::from_str(&serde_json::to_string(&cut).unwrap()).unwrap();
    for _ in 7..15 {
        cut.iterate(&Known);
    }
    assert_eq!(cut, search(15));
}

#[test]
fn amplitudes_respect_the_speed_of_their_joint() {
    let space = GaitSpace::default();
    let bounds = space.bounds();
    assert_eq!((bounds.len(), space.dimensions()), (DIMENSIONS, DIMENSIONS));
    let speed = |joint: usize| bounds[joint].1 * core::f64::consts::TAU * 0.2;
    assert!((speed(0) - 2.5).abs() < 1e-6 && (speed(1) - 1.5).abs() < 1e-6);
    let corner: Vec<f64> = bounds.iter().map(|b| b.1).collect();
    assert!(space.gait(&corner, "corner").is_ok());
    assert!(space.gait(&corner[..16], "short").is_err());
}

#[test]
fn fitness_follows_the_papers_words() {
    let trial = |speed: f32, side: f32| TrialOutcome {
        path_m: (0..=10)
            .map(|t| [speed * t as f32, side * t as f32])
            .collect(),
        period_s: 1.0,
        collided: false,
        impact_m_s: 0.2,
        failed_at_step: None,
    };
    let settings = ScoreSettings::default();
    let same = settings.score(&[trial(0.05, 0.0), trial(0.05, 0.0), trial(0.05, 0.0)], 0.5);
    assert!((same.fitness - 0.05).abs() < 1e-8 && same.deviation_m == 0.0);
    // Two of three pairs part by 0.022 m/s for 10 s: mean 0.11 m over these pairs, two thirds of it over all.
    let parted = settings.score(
        &[trial(0.05, 0.0), trial(0.05, 0.0), trial(0.05, 0.022)],
        0.5,
    );
    assert!(
        (parted.deviation_m - 0.11 * 2.0 / 3.0).abs() < 1e-6,
        "{}",
        parted.deviation_m
    );
    assert!(parted.fitness < parted.speed_m_s);
    let mut bad = trial(0.05, 0.0);
    bad.collided = true;
    assert_eq!(settings.score(&[trial(0.05, 0.0), bad], 0.5).fitness, 0.0);
    let mut hard = trial(0.05, 0.0);
    hard.impact_m_s = 1.2;
    assert_eq!(settings.score(&[trial(0.05, 0.0), hard], 0.5).fitness, 0.0);
    let mut lost = trial(0.05, 0.0);
    lost.failed_at_step = Some(17);
    assert_eq!(settings.score(&[lost], 0.5).fitness, 0.0);
    assert_eq!(settings.score(&[], 0.5).fitness, 0.0);
}

#[test]
fn the_selection_holds_the_best_and_spreads() {
    let search = search(60);
    let settings = SelectSettings::default();
    let chosen = select(search.space(), search.archive(), &settings);
    assert_eq!(chosen.len(), 17);
    assert_eq!(chosen.iter().filter(|c| c.training).count(), 6);
    assert_eq!(chosen.iter().filter(|c| c.why == Why::Best).count(), 6);
    let best = search.swarm().best().unwrap();
    assert_eq!(chosen[0].found.position, best.position);
    for (k, a) in chosen.iter().enumerate() {
        assert!(a.found.score.fitness >= 0.4 * chosen[0].found.score.fitness);
        for b in &chosen[k + 1..] {
            let d = difference(search.space(), &a.found.position, &b.found.position);
            assert!(
                d >= settings.least_difference,
                "two chosen gaits differ by {d}"
            );
        }
    }
}

#[test]
fn differences_of_gaits_know_what_matters() {
    let space = GaitSpace::default();
    let mut a = vec![0.0; DIMENSIONS];
    let mut b = a.clone();
    b[DIMENSIONS - 1] = 1.5;
    assert!(
        difference(&space, &a, &b) < 1e-6,
        "a lag without amplitude does not show"
    );
    a[0] = 1.0;
    b[0] = 1.0;
    b[6] = 0.6;
    let d = difference(&space, &a, &b);
    assert!(
        (d - 0.6 / (core::f64::consts::PI * 6f64.sqrt())).abs() < 1e-3,
        "{d}"
    );
}

/// The paper's own fit made motors 2.5 and 3.7 times faster and 1.8 and 3.4 times stronger than they are.
#[test]
fn the_papers_impossible_motors_are_flagged() {
    let fitted = Model::meta_optimised();
    let flagged: Vec<(u8, f64)> = Key::TABLE_II
        .iter()
        .filter_map(|key| {
            let factor = implausible_factor(*key, fitted.value(*key))?;
            Some((key.info().table_ii.unwrap(), (factor * 10.0).round() / 10.0))
        })
        .collect();
    assert_eq!(flagged, [(13, 2.5), (14, 1.8), (17, 3.7), (18, 3.4)]);
    let hand = Model::hand_tuned();
    assert!(
        Key::TABLE_II
            .iter()
            .all(|key| implausible_factor(*key, hand.value(*key)).is_none())
    );
}

/// Processes played by threads: a board everyone writes to, and two meetings per exchange.
#[derive(Clone)]
struct Threads {
    rank: usize,
    board: Arc<Mutex<Vec<Vec<u8>>>>,
    meeting: Arc<Barrier>,
}

impl Exchange for Threads {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.board.lock().unwrap().len()
    }

    fn all_gather(&self, mine: &[u8]) -> Vec<Vec<u8>> {
        self.board.lock().unwrap()[self.rank] = mine.to_vec();
        self.meeting.wait();
        let all = self.board.lock().unwrap().clone();
        self.meeting.wait();
        all
    }
}

#[test]
fn any_number_of_processes_gives_the_same_bits() {
    let alone = search(6);
    for size in [1, 2, 3, 7] {
        let board = Arc::new(Mutex::new(vec![Vec::new(); size]));
        let meeting = Arc::new(Barrier::new(size));
        let searches: Vec<Search> = std::thread::scope(|scope| {
            let spawn = |rank| {
                let exchange = Threads {
                    rank,
                    board: Arc::clone(&board),
                    meeting: Arc::clone(&meeting),
                };
                scope.spawn(move || {
                    let trials = Sharded::new(Known, exchange);
                    let mut search = search(0);
                    (0..6).for_each(|_| assert!(search.iterate(&trials)));
                    search
                })
            };
            let handles: Vec<_> = (0..size).map(spawn).collect();
            handles
                .into_iter()
                .map(|handle| handle.join().unwrap())
                .collect()
        });
        assert!(
            searches.iter().all(|search| *search == alone),
            "{size} processes"
        );
    }
}
