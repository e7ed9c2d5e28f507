//! The bits of four gaits, and what the engine says when numbers run away.
//!
//! The golden has caught: nothing yet. It changes when, and only when, the engine, the CPG, the noise or a default changes; then run the
//! validation again and say so in the commit.
// Helpers outside `#[test]` functions may fail a test by panicking too.
#![allow(clippy::unwrap_used)]

use files::model::{Effect, Model};
use peers::random_gait;
use physics::{Drive, Level, Options, Outcome, Params, Pose, Start, Trial, Twist, run_at};
use std::sync::Arc;

fn trial(model: &Model, k: u32) -> Trial {
    Trial {
        params: Arc::new(Params::try_from(model).unwrap()),
        start: Start::Home,
        drive: Drive::Gait {
            gait: Arc::new(random_gait(21, k, (0.5, 1.2))),
            noise_rad: 0.02,
            seed: 17,
        },
        duration_s: 5.0,
    }
}

/// FNV-1a over the bits of all samples.
fn hash(outcomes: &[Outcome]) -> u64 {
    let mut h = 0xcbf2_9ce4_8422_2325u64;
    for o in outcomes {
        for p in &o.poses {
            for x in p.position_m.iter().chain(&p.quaternion) {
                for byte in x.to_bits().to_le_bytes() {
                    h = (h ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
                }
            }
        }
    }
    h
}

#[test]
fn golden_bits() {
    let mut rich = Model::meta_optimised();
    for joint in 0..6 {
        rich.set_effect(Effect::CoulombFriction, Some(joint), &[0.5])
            .unwrap();
        rich.set_effect(Effect::Compliance, Some(joint), &[60.0])
            .unwrap();
    }
    let plain: Vec<Trial> = (0..4).map(|k| trial(&Model::hand_tuned(), k)).collect();
    let rich: Vec<Trial> = (0..4).map(|k| trial(&rich, k)).collect();
    for level in [Level::Scalar, Level::Sse2, Level::Avx2, Level::Avx512] {
        let run = |t: &[Trial]| hash(&run_at(level, t, &Options::default()).unwrap());
        assert_eq!([run(&plain), run(&rich)], [PLAIN, RICH], "{level:?}");
    }
}

const PLAIN: u64 = 18_353_126_581_020_555_658;
const RICH: u64 = 6_547_426_504_853_606_752;

#[test]
fn a_trial_that_runs_away_is_named_with_its_step_and_harms_no_other() {
    let good = trial(&Model::hand_tuned(), 1);
    let mut bad = good.clone();
    bad.start = Start::State {
        base: Pose {
            position_m: [0.0, 0.0, 0.055],
            quaternion: [1.0, 0.0, 0.0, 0.0],
        },
        twist: Twist {
            linear_m_s: [0.0; 3],
            angular_rad_s: [1e25, 0.0, 0.0],
        },
        angles_rad: vec![0.0; 6],
        speeds_rad_s: vec![0.0; 6],
    };
    let alone = run_at(
        Level::detect(),
        std::slice::from_ref(&good),
        &Options::default(),
    )
    .unwrap();
    let both = run_at(Level::detect(), &[bad, good], &Options::default()).unwrap();
    let report = both[0].not_finite.unwrap();
    assert_eq!((report.step, report.time_s), (0, 0.0));
    assert_eq!(both[1], alone[0]);
}

#[test]
fn settings_out_of_range_are_refused_by_name() {
    let t = trial(&Model::hand_tuned(), 1);
    let options = Options {
        time_step_s: 0.5,
        ..Options::default()
    };
    let error = run_at(Level::detect(), std::slice::from_ref(&t), &options).unwrap_err();
    assert!(
        error.to_string().starts_with("`time_step_s` is 0.5"),
        "{error}"
    );
    let mut short = t;
    short.drive = Drive::SetPoints {
        period_s: 1.0,
        values_rad: Arc::from([0.0; 5]),
    };
    let error = run_at(Level::detect(), &[short], &Options::default()).unwrap_err();
    assert!(error.to_string().contains("5 joints"), "{error}");
}
