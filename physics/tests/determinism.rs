//! The same bits on every instruction set, in every company, on every thread count.
// Helpers outside `#[test]` functions may fail a test by panicking too.
#![allow(clippy::unwrap_used)]

use files::model::{Effect, Model};
use peers::random_gait;
use physics::{Drive, Level, Options, Outcome, Params, Start, Trial, run_at};
use std::sync::Arc;

fn trials(count: u32, duration_s: f64) -> Vec<Trial> {
    let plain = Arc::new(Params::try_from(&Model::hand_tuned()).unwrap());
    let mut model = Model::meta_optimised();
    model
        .set_effect(Effect::CoulombFriction, Some(2), &[0.3])
        .unwrap();
    model
        .set_effect(Effect::Backlash, Some(4), &[0.02])
        .unwrap();
    model
        .set_effect(Effect::FrictionAnisotropy, None, &[1.5, 0.4])
        .unwrap();
    model
        .set_effect(Effect::TorsionalFriction, None, &[0.01])
        .unwrap();
    let rich = Arc::new(Params::try_from(&model).unwrap());
    (0..count)
        .map(|k| Trial {
            params: Arc::clone(if k % 5 == 3 { &rich } else { &plain }),
            start: if k % 3 == 0 {
                Start::Home
            } else {
                Start::HomeAtOnce
            },
            drive: Drive::Gait {
                gait: Arc::new(random_gait(11, k, (0.5, 1.2))),
                noise_rad: 0.02,
                seed: u64::from(k),
            },
            duration_s,
        })
        .collect()
}

fn options() -> Options {
    Options {
        record_angles: true,
        record_motors: true,
        ..Options::default()
    }
}

fn bits(outcomes: &[Outcome]) -> Vec<Vec<u32>> {
    outcomes
        .iter()
        .map(|o| {
            assert_eq!(o.not_finite, None);
            let poses = o
                .poses
                .iter()
                .flat_map(|p| p.position_m.into_iter().chain(p.quaternion));
            let rest = o
                .angles_rad
                .iter()
                .chain(&o.encoders_rad)
                .chain(&o.torques_nm);
            poses.chain(rest.copied()).map(f32::to_bits).collect()
        })
        .collect()
}

#[test]
fn every_level_gives_the_same_bits() {
    let trials = trials(21, 4.0);
    let expected = bits(&run_at(Level::Scalar, &trials, &options()).unwrap());
    for level in [Level::Sse2, Level::Avx2, Level::Avx512] {
        let found = bits(&run_at(level, &trials, &options()).unwrap());
        for (k, (a, b)) in expected.iter().zip(&found).enumerate() {
            let at = a.iter().zip(b).position(|(x, y)| x != y);
            assert_eq!(at, None, "{level:?}, trial {k}");
        }
    }
}

#[test]
fn neighbours_and_threads_do_not_matter() {
    let trials = trials(24, 3.0);
    let together = run_at(Level::detect(), &trials, &options()).unwrap();
    let alone: Vec<Outcome> = std::thread::scope(|scope| {
        let handles: Vec<_> = trials
            .chunks(5)
            .map(|chunk| scope.spawn(move || run_at(Level::detect(), chunk, &options()).unwrap()))
            .collect();
        handles
            .into_iter()
            .flat_map(|h| h.join().unwrap())
            .collect()
    });
    assert_eq!(together, alone);
}
