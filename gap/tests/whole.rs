//! The whole-robot diagnosis on recordings of a stand-in that is stepped and parametrised otherwise.

mod robot;

use files::dataset::{Manifest, Recording};
use files::model::{Effect as E, Key, Model};
use gap::decide::Calibration;
use gap::verdict::{Verdict, Word};
use gap::vocabulary::Effect;
use gap::whole::{DataSet, Diagnosis, Film, Settings};
use robot::{Plan, Reality, films, record};

fn diagnose((manifest, recordings): &(Manifest, Vec<Recording>), films: &[Film]) -> Diagnosis {
    let set = DataSet {
        manifest,
        recordings,
        films,
        model: &Model::hand_tuned(),
    };
    gap::whole::diagnose(set, &Settings::default(), &Calibration::shipped()).expect("diagnosable")
}

fn verdict(plan: &Plan, reality: &Reality) -> Verdict {
    diagnose(&record(plan, reality), &[]).verdict().clone()
}

fn planted(effect: E, joint: Option<u8>, values: &[f64]) -> Reality {
    Reality::with(|m| m.set_effect(effect, joint, values).expect("in range"))
}

#[test]
fn a_robot_within_its_tolerances_has_no_gap() {
    let v = verdict(&Plan::default(), &Reality::default());
    assert_eq!(
        (v.verdict, v.effects.len()),
        (Word::None, 0),
        "{:?}",
        v.effects
    );
    let sum: f64 = v.place.iter().map(|w| w.share).sum();
    assert!((sum - 1.0).abs() < 1e-9, "{sum}");
}

/// Data, reality, and what must be named: effect, joint, key, value, relative error, and the regime of the joint that holds the gap.
type Planted<'a> = (
    &'a Plan,
    Reality,
    Effect,
    Option<usize>,
    &'static str,
    f64,
    f64,
    Option<&'static str>,
);

#[test]
fn one_effect_per_stage_is_named_with_joint_and_size() {
    let link = Plan {
        link: true,
        ..Plan::default()
    };
    let plain = Plan::default();
    let cases: [Planted<'_>; 8] = [
        (
            &plain,
            planted(E::JointOffset, Some(3), &[0.05]),
            Effect::JointOffset,
            Some(3),
            "offset_rad",
            0.05,
            0.02,
            Some("all"),
        ),
        (
            &plain,
            planted(E::Latency, Some(2), &[0.1]),
            Effect::Latency,
            Some(2),
            "delay_s",
            0.1,
            0.03,
            Some("all"),
        ),
        (
            &plain,
            planted(E::VelocityLimit, Some(4), &[0.12]),
            Effect::VelocityLimit,
            Some(4),
            "limit_rad_s",
            0.12,
            0.02,
            None,
        ),
        (
            &plain,
            planted(E::VelocityLimit, Some(0), &[0.3]),
            Effect::VelocityLimit,
            Some(0),
            "limit_rad_s",
            0.3,
            0.02,
            // Slow motion, reversals and loads do not meet the limit.
            Some("other"),
        ),
        (
            &plain,
            planted(E::TorqueLimit, Some(2), &[1.0]),
            Effect::TorqueLimit,
            Some(2),
            "limit_nm",
            1.0,
            0.3,
            Some("saturation"),
        ),
        (
            &plain,
            planted(E::CoulombFriction, Some(1), &[0.5]),
            Effect::CoulombFriction,
            Some(1),
            "torque_nm",
            0.5,
            0.15,
            None,
        ),
        (
            &link,
            planted(E::Compliance, Some(0), &[30.0]),
            Effect::Compliance,
            Some(0),
            "stiffness_nm_rad",
            30.0,
            0.1,
            // A spring yields where it is loaded.
            Some("high_load"),
        ),
        (
            &plain,
            planted(E::ConnectorPlay, None, &[0.03]),
            Effect::ConnectorPlay,
            None,
            "half_width_rad",
            0.03,
            0.3,
            None,
        ),
    ];
    for (plan, reality, effect, joint, key, value, relative, regime) in cases {
        let v = verdict(plan, &reality);
        let first = v
            .effects
            .first()
            .unwrap_or_else(|| panic!("{}: {:?}", effect.name(), v.verdict));
        let class = v
            .ambiguous
            .iter()
            .find(|a| a.members[0].effect == first.effect);
        let named = first.effect == effect || class.is_some_and(|c| c.effects.contains(&effect));
        assert!(
            named && first.joint == joint,
            "{}: {:?}",
            effect.name(),
            v.effects
        );
        if first.effect == effect {
            let found = first.parameters[key].value;
            assert!(
                (found / value - 1.0).abs() < relative,
                "{}: {found}",
                effect.name()
            );
        }
        assert!(v.gap.after < v.gap.before, "{}: {:?}", effect.name(), v.gap);
        if let Some(regime) = regime {
            let stage = effect.stage().name();
            let place = v
                .place
                .iter()
                .find(|w| w.joint == joint && w.stage == stage);
            let of = place.map(|w| w.regime.as_str());
            assert_eq!(of, Some(regime), "{}: {:?}", effect.name(), v.place);
        }
    }
}

#[test]
fn a_heavier_or_lighter_robot_is_told_with_its_size() {
    for ratio in [2.0, 0.3] {
        let reality = Reality::with(|m| {
            for key in Key::MASSES {
                m.set(key, ratio * m.value(key)).expect("in range");
            }
        });
        let v = verdict(&Plan::default(), &reality);
        let named: Vec<Effect> = v.effects.iter().map(|e| e.effect).collect();
        assert_eq!(named, [Effect::Mass], "{ratio}: {:?}", v.effects);
        let found = &v.effects[0].parameters["ratio"];
        assert!((found.value / ratio - 1.0).abs() < 0.2, "{found:?}");
    }
}

#[test]
fn a_heavier_robot_is_told_beside_a_centre_of_mass_elsewhere_and_each_comes_and_goes_alone() {
    let reality = Reality::with(|m| {
        for key in Key::MASSES {
            m.set(key, 1.8 * m.value(key)).expect("in range");
        }
        m.set_effect(E::ComOffset, None, &[0.0, 0.03, 0.0])
            .expect("in range");
    });
    let v = verdict(&Plan::default(), &reality);
    let mut named: Vec<&str> = v.effects.iter().map(|e| e.effect.name()).collect();
    named.sort_unstable();
    assert_eq!(named, ["com_offset", "mass"], "{:?}", v.effects);
    let mass = v.effects.iter().find(|e| e.effect == Effect::Mass);
    let [low, high] = mass.expect("named").parameters["ratio"].ci95;
    assert!(low < 1.8 && 1.8 < high, "{low} {high}");
    let effort = v.metrics["effort_rmse_nm"];
    assert!(effort[2] < 0.7 * effort[1], "{effort:?}");
    let pose = v.metrics["pose_rmse_m"];
    assert!(pose[2] < 0.7 * pose[1], "{pose:?}");
}

/// Joints 0 to 5 stand in these columns, with their set-points: only the body tells.
#[test]
fn six_joints_in_a_ring_are_put_in_order() {
    let plan = Plan {
        columns: [3, 0, 4, 1, 5, 2],
        ..Plan::default()
    };
    let v = verdict(&plan, &Reality::default());
    let named: Vec<Effect> = v.effects.iter().map(|e| e.effect).collect();
    assert_eq!(named, [Effect::JointOrder], "{:?}", v.effects);
    // The column a's set-points reach joint [1, 3, 5, 0, 2, 4][a]: 1 * 120 + 2 * 24 + 3 * 6 permutations of six come before it.
    let found = v.effects[0].parameters["permutation"].value;
    assert!((found - 186.0).abs() < 0.5, "{found}");
}

/// Beside a loose connector no order mends the windows as the right one does on a sound robot; but motors of two kinds stand in each other's columns.
#[test]
fn motors_tell_of_an_order_that_a_loose_connector_hides() {
    let plan = Plan {
        columns: [0, 3, 1, 5, 2, 4],
        effort: false,
        motors: true,
        ..Plan::default()
    };
    let reality = planted(E::ConnectorPlay, None, &[0.12]);
    let v = verdict(&plan, &reality);
    let mut named: Vec<Effect> = v.effects.iter().map(|e| e.effect).collect();
    named.sort_by_key(|e| *e == Effect::ConnectorPlay);
    assert_eq!(
        named,
        [Effect::JointOrder, Effect::ConnectorPlay],
        "{:?}",
        v.effects
    );
    let own = v.effects.iter().find(|e| e.effect == Effect::JointOrder);
    let found = own.expect("named").parameters["permutation"].value;
    assert!((found - 37.0).abs() < 0.5, "{found}");
}

#[test]
fn a_stated_supply_is_no_error_of_the_robot() {
    let plan = |stated| Plan {
        gaits: 3,
        motors: true,
        bus_v: 7.4,
        stated,
        ..Plan::default()
    };
    let names = |stated| -> Vec<String> {
        let v = verdict(&plan(stated), &Reality::default());
        v.effects.iter().map(|e| e.effect.name().into()).collect()
    };
    let said = names("[metamodule]\nsupply_v = { value = 7.4, tolerance = 0.02 }\n");
    assert!(!said.contains(&"supply_voltage".into()), "{said:?}");
    // The same robot against the shipped model, which states 12 V.
    assert!(names("").contains(&"supply_voltage".into()));
}

#[test]
fn a_permuted_joint_order_is_named_before_anything_else() {
    // Columns that the joints follow, and the number of the joints that the columns reach, in lexicographic order: joints 1 and 2
    // exchanged (0 2 1 3 4 5); what was meant for joint 1 reaches joint 2, for 2 joint 3, for 3 joint 1 (0 2 3 1 4 5).
    let swap = ([0, 2, 1, 3, 4, 5], 24.0);
    let cycle = ([0, 3, 1, 2, 4, 5], 30.0);
    for ((columns, number), echo) in [(swap, false), (swap, true), (cycle, false)] {
        let follow = move |p: &[f64; 6]| columns.map(|c: usize| p[c]);
        let reality = Reality {
            path: Box::new(move |s| s.iter().map(follow).collect()),
            ..Reality::default()
        };
        let plan = Plan {
            echo,
            ..Plan::default()
        };
        let v = verdict(&plan, &reality);
        // What the drivers echo beside their own joints is read in the right order too: nothing else is at fault.
        assert_eq!(v.effects.len(), 1, "{:?}", v.effects);
        assert_eq!(v.effects[0].effect, Effect::JointOrder);
        assert_eq!(v.effects[0].parameters["permutation"].value, number);
        assert_eq!(v.place[0].stage, "conventions");
        assert_eq!(v.verdict, Word::PartlyExplained);
        let p = v.probabilities.none + v.probabilities.unknown + v.effects[0].confidence;
        assert!((p - 1.0).abs() < 1e-12, "{p}");
    }
}

#[test]
fn missing_signals_narrow_the_verdict_and_break_nothing() {
    let plan = Plan {
        base: false,
        effort: false,
        ..Plan::default()
    };
    let v = verdict(&plan, &planted(E::Latency, Some(4), &[0.15]));
    assert_eq!(
        (v.effects[0].effect, v.effects[0].joint),
        (Effect::Latency, Some(4))
    );
    assert_eq!(v.gap.metric, "position_rmse_rad");
    let unseen = |e: Effect| v.unseen.iter().any(|u| u.effect == e);
    assert!(unseen(Effect::CoulombFriction) && unseen(Effect::GroundFriction));
}

#[test]
fn a_turned_camera_with_another_clock_is_named() {
    let plan = Plan {
        gaits: 4,
        effort: false,
        ..Plan::default()
    };
    let recorded = record(&plan, &Reality::default());
    let view = camera::View::new(2.6, (0.0, 0.0), 0.15, (320, 240), 290.0).expect("a camera");
    let films = films(&recorded.0, &recorded.1, &view, 0.4);
    let d = diagnose(&recorded, &films);
    let value = |effect: Effect, key: &str| {
        let row = d.verdict().effects.iter().find(|e| e.effect == effect);
        row.unwrap_or_else(|| panic!("{}: {:?}", effect.name(), d.verdict().effects))
            .parameters[key]
            .value
    };
    assert!((value(Effect::CameraYaw, "angle_rad") - 0.15).abs() < 0.02);
    assert!((value(Effect::CameraTimeShift, "shift_s") - 0.4).abs() < 0.03);
    let [before, _, after] = d.verdict().metrics["similarity_r"];
    assert!(after > before && after > 0.9, "{before} {after}");
}

#[test]
fn a_film_stands_in_for_a_tracker() {
    let plan = Plan {
        gaits: 4,
        effort: false,
        ..Plan::default()
    };
    let blind = Plan {
        base: false,
        ..plan
    };
    let reality = Reality::default();
    let (manifest, tracked) = record(&plan, &reality);
    let view = camera::View::new(2.6, (0.0, 0.0), 0.0, (320, 240), 290.0).expect("a camera");
    let films = films(&manifest, &tracked, &view, 0.0);
    let d = diagnose(&record(&blind, &reality), &films);
    let v = d.verdict();
    assert_eq!(
        (v.verdict, v.effects.len()),
        (Word::None, 0),
        "{:?}",
        v.effects
    );
    assert!(v.metrics.contains_key("pose_rmse_m") && v.metrics.contains_key("similarity_r"));
    // What was read off the film says nothing of the camera.
    let unseen = |e: Effect| v.unseen.iter().any(|u| u.effect == e);
    assert!(unseen(Effect::CameraYaw));
    // Forty seconds of film are too few for the friction of the ground, and that is said with a size.
    let friction = v.unseen.iter().find(|u| u.effect == Effect::GroundFriction);
    let why = &friction.expect("too coarse").why;
    assert!(why.contains("would be named"), "{why}");
}
