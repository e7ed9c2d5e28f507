//! Robots from files: the meta-module as a file is the built-in one to the bit, others obey the same laws.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use control::gait::{Gait, Oscillator, RawGait};
use files::model::{Effect, Key, Model};
use files::structure::Structure;
use peers::random_gait;
use physics::{
    Drive, GRAVITY_M_S2, Level, Options, Outcome, Params, ParamsError, Pose, Robot, Start, Trial,
    Twist, run_at,
};
use std::sync::Arc;

const METAMODULE: &str = include_str!("../../robots/metamodule.toml");
const MODULE: &str = include_str!("../../robots/module.toml");
const QUADRUPED: &str = include_str!("../../robots/quadruped.toml");

fn robot(text: &str, model: &Model) -> Arc<Robot> {
    let structure = Structure::parse("robot.toml", text).unwrap();
    Arc::new(Robot::of_structure(&structure, model).unwrap())
}

fn options() -> Options {
    Options {
        record_angles: true,
        record_motors: true,
        ..Options::default()
    }
}

fn played(params: &Arc<Params>, level: Level) -> Vec<Outcome> {
    let trial = |k| Trial {
        params: Arc::clone(params),
        start: Start::Home,
        drive: Drive::Gait {
            // Wide enough that some of them touch themselves, so that clearances and the pre-check are compared too.
            gait: Arc::new(random_gait(5, k, (1.5, 3.0))),
            noise_rad: 0.02,
            seed: u64::from(k),
        },
        duration_s: 8.0,
    };
    let trials: Vec<Trial> = (0..32).map(trial).collect();
    run_at(level, &trials, &options()).unwrap()
}

fn bits(outcomes: &[Outcome]) -> Vec<u64> {
    let of = |o: &Outcome| {
        let poses = o
            .poses
            .iter()
            .flat_map(|p| p.position_m.into_iter().chain(p.quaternion));
        let rest = [&o.angles_rad, &o.encoders_rad, &o.torques_nm];
        let samples = poses.chain(rest.into_iter().flatten().copied());
        let mut out: Vec<u64> = samples.map(|x| u64::from(x.to_bits())).collect();
        out.extend([o.distance_m, o.clearance_m, o.impact_m_s].map(f64::to_bits));
        out.push(o.collided_at_s.map_or(0, f64::to_bits));
        out
    };
    outcomes.iter().flat_map(of).collect()
}

#[test]
fn the_metamodule_as_a_file_is_the_built_in_one_to_the_bit() {
    let plain = Model::hand_tuned();
    let mut rich = Model::meta_optimised();
    rich.set_effect(Effect::Backlash, Some(4), &[0.02]).unwrap();
    rich.set_effect(Effect::Mass, None, &[1.1]).unwrap();
    rich.set_effect(Effect::ComOffset, None, &[0.0, 0.01, 0.0])
        .unwrap();
    for model in [plain, rich] {
        let built_in = Arc::new(Params::try_from(&model).unwrap());
        let from_file = Arc::new(Params::new(&model, robot(METAMODULE, &model)).unwrap());
        for level in [Level::Scalar, Level::detect()] {
            let (a, b) = (played(&built_in, level), played(&from_file, level));
            assert!(a.iter().any(|o| o.collided_at_s.is_some()));
            assert!(bits(&a) == bits(&b), "{level:?}");
        }
    }
}

/// A gait of `joints` equal oscillators, or of equal legs of three.
fn equal_legs(joints: usize) -> Gait {
    let mut raw = RawGait {
        frequency_hz: 0.5,
        rate_a_per_s: 2.0,
        duration_s: 10.0,
        ..RawGait::default()
    };
    raw.name.push_str("legs").unwrap();
    for joint in 0..joints {
        let amplitude_rad = [0.6, 0.5, 0.4][joint % 3];
        let oscillator = Oscillator {
            amplitude_rad,
            offset_rad: 0.2,
            initial_phase_rad: [0.0, 1.0, 2.0][joint % 3],
        };
        raw.oscillators.push(oscillator).unwrap();
    }
    Gait::try_from(raw).unwrap()
}

fn run_one(params: &Arc<Params>, level: Level, start: Start, duration_s: f64) -> Outcome {
    let gait = Arc::new(equal_legs(params.robot.motors()));
    let trial = Trial {
        params: Arc::clone(params),
        start,
        drive: Drive::Gait {
            gait,
            noise_rad: 0.0,
            seed: 0,
        },
        duration_s,
    };
    run_at(level, &[trial], &options()).unwrap().remove(0)
}

#[test]
fn other_structures_have_the_same_bits_on_every_level() {
    let model = Model::hand_tuned();
    for text in [MODULE, QUADRUPED] {
        let params = Arc::new(Params::new(&model, robot(text, &model)).unwrap());
        let expected = run_one(&params, Level::Scalar, Start::Home, 5.0);
        assert_eq!(expected.not_finite, None);
        for level in [Level::Sse2, Level::Avx2, Level::Avx512] {
            let found = run_one(&params, level, Start::Home, 5.0);
            assert!(
                bits(&[found]) == bits(std::slice::from_ref(&expected)),
                "{level:?}"
            );
        }
    }
}

/// Legs that move alike push alike: a robot with fourfold symmetry turns on the spot and does not leave it.
#[test]
fn equal_legs_of_the_quadruped_cancel() {
    let mut model = Model::hand_tuned();
    model.set(Key::Bounce, 0.0).unwrap();
    let params = Arc::new(Params::new(&model, robot(QUADRUPED, &model)).unwrap());
    let out = run_one(&params, Level::Reference, Start::HomeAtOnce, 2.0);
    let [x, y, _] = out.poses.last().unwrap().position_m;
    assert!(x.hypot(y) < 0.003, "{x} {y}");
    let moved = out.angles_rad.iter().fold(0.0f32, |m, a| m.max(a.abs()));
    assert!(moved > 0.3, "the legs moved by {moved} rad");
}

/// In the air the centre of mass falls freely, whatever the motors do. The base of the quadruped, moved by equal legs, stays above it.
#[test]
fn the_quadruped_falls_freely() {
    let model = Model::hand_tuned();
    let params = Arc::new(Params::new(&model, robot(QUADRUPED, &model)).unwrap());
    let total_kg: f64 = params.half_masses_kg.iter().sum();
    assert!((total_kg - 16.0 * 0.325).abs() < 1e-12);
    let start = Start::State {
        base: Pose {
            position_m: [0.0, 0.0, 50.0],
            quaternion: [1.0, 0.0, 0.0, 0.0],
        },
        twist: Twist::default(),
        angles_rad: vec![0.0; 12],
        speeds_rad_s: vec![0.0; 12],
    };
    let mut limp = (*params).clone();
    limp.joints.iter_mut().for_each(|j| j.max_torque_nm = 0.0);
    let out = run_one(&Arc::new(limp), Level::Reference, start, 1.0);
    let end = out.poses.last().unwrap().position_m;
    let fallen_m = 50.0 - f64::from(end[2]);
    // Semi-implicit Euler falls h t g / 2 further than the parabola.
    let expected_m = GRAVITY_M_S2 * (0.5 + 0.004 / 2.0);
    assert!((fallen_m - expected_m).abs() < 1e-3, "{fallen_m}");
    assert!(end[0].hypot(end[1]) < 1e-4, "{end:?}");
}

#[test]
fn effects_that_a_structure_has_no_place_for_are_refused() {
    let with = |effect, joint, value| {
        let mut model = Model::hand_tuned();
        model.set_effect(effect, joint, &[value]).unwrap();
        Params::new(&model, robot(MODULE, &model)).map(drop)
    };
    assert_eq!(with(Effect::CoulombFriction, Some(2), 0.1), Ok(()));
    assert!(matches!(
        with(Effect::CoulombFriction, Some(3), 0.1),
        Err(ParamsError::Joint {
            joint: 3,
            joints: 3,
            ..
        })
    ));
    assert!(matches!(
        with(Effect::ConnectorPlay, None, 0.1),
        Err(ParamsError::Connector { .. })
    ));
}

#[test]
fn a_mass_in_the_file_is_that_half_spheres_own() {
    let heavy = MODULE.replacen("centre_m", "mass_kg = 2\ncentre_m", 1);
    let model = Model::hand_tuned();
    let params = Params::new(&model, robot(&heavy, &model)).unwrap();
    assert_eq!(params.half_masses_kg, [2.0, 0.325, 0.325, 0.325]);
}
