//! Causes of a joint on a bench: recordings of the diagnosis' own simulator, which check the search and its numbers.

mod common;

use files::dataset::{Manifest, Recording, Signal};
use gap::bench::{Word, name_causes};
use gap::decide::Calibration;
use gap::joint::{P, Params, Problem, Trace, simulate};
use gap::math::Rng;

/// Nulls that ask for an evidence of 12, beyond what simulated joints without a cause show.
fn calibration() -> Calibration {
    let strongest = (0..20).map(|i| f64::from(i) * 12.0 / 19.0).collect();
    Calibration::new(strongest, "test", "numbers").expect("enough")
}

/// Effect, key of its parameter, size.
type Expected = Option<(&'static str, &'static str, f64)>;
/// What is planted, in words and as parameters, and what is to be named.
type Case = (&'static str, &'static [(P, f64)], Expected);

#[test]
fn what_was_planted_is_named_with_its_size() {
    let cases: [Case; 5] = [
        ("nothing", &[], None),
        (
            "late",
            &[(P::Delay, 0.04)],
            Some(("latency", "delay_s", 0.04)),
        ),
        (
            "dry",
            &[(P::Coulomb, 0.8)],
            Some(("coulomb_friction", "torque_nm", 0.8)),
        ),
        (
            "weak",
            &[(P::LoopGain, 0.7)],
            Some(("loop_gain", "ratio", 0.7)),
        ),
        (
            "off",
            &[(P::Offset, 0.05)],
            Some(("joint_offset", "offset_rad", 0.05)),
        ),
    ];
    for (what, planted, expected) in cases {
        let mut params = Params::default();
        planted.iter().for_each(|(p, v)| params.set(*p, *v));
        let (manifest, recordings) = common::data(&params, 3);
        let found = name_causes(&manifest, &recordings, &[], &calibration()).expect("positions");
        match expected {
            None => {
                assert_eq!(found.verdict, Word::None, "{what}: {found:?}");
                assert!(found.causes.is_empty(), "{what}: {found:?}");
            }
            Some((effect, key, size)) => {
                assert_eq!(found.causes.len(), 1, "{what}: {found:?}");
                let row = &found.causes[0];
                assert_eq!(row.effect, Some(effect), "{what}: {found:?}");
                let value = row.values[key].value;
                assert!((value - size).abs() < 0.05 * size, "{what}: {value}");
            }
        }
    }
}

/// A current of a known motor is its torque, so either limit explains the other: by evidence they differ by what their
/// priors do, some nats. A rival that stays where its limit acts too little is off by a hundred.
#[test]
fn a_rival_of_a_limit_is_fitted_as_far_as_the_limit() {
    let limits = ["torque_limit", "current_limit"];
    let params = Params::default().with(P::TorqueLimit, 1.2);
    let (manifest, mut recordings) = common::data(&params, 3);
    for r in &mut recordings {
        let joint = r.joint_mut(0).expect("one joint");
        for s in [Signal::Current, Signal::Duty, Signal::LinkPosition] {
            joint.set(s, None);
        }
    }
    let found = name_causes(&manifest, &recordings, &[], &calibration()).expect("positions");
    assert_eq!(found.causes.len(), 1, "{found:?}");
    let row = &found.causes[0];
    let named = limits.iter().position(|l| row.effect == Some(l));
    let named = named.expect("a limit is named");
    let other = row.alternatives.iter();
    let other = other.filter(|a| a.effect == Some(limits[1 - named]));
    let margins: Vec<f64> = other.map(|a| a.margin).collect();
    assert!(margins.len() == 1 && margins[0] < 10.0, "{margins:?}");
}

#[test]
fn withheld_effects_are_not_named() {
    let params = Params::default().with(P::Delay, 0.04);
    let (manifest, recordings) = common::data(&params, 3);
    let withhold = [gap::vocabulary::Effect::Latency];
    let found = name_causes(&manifest, &recordings, &withhold, &calibration()).expect("positions");
    assert!(
        found.causes.iter().all(|r| r.effect != Some("latency")),
        "{found:?}"
    );
}

#[test]
fn too_little_stated_is_an_answer_with_the_list_of_what_to_state() {
    let (mut manifest, recordings) = common::data(&Params::default(), 3);
    // One run lacks the one, another the other.
    manifest.runs[0].bench.controller.kp = None;
    manifest.runs[1].bench.inertia = None;
    let found = name_causes(&manifest, &recordings, &[], &calibration()).expect("positions");
    assert_eq!(found.verdict, Word::Unknown);
    assert_eq!(
        found.to_state,
        ["bench.controller.kp", "bench.inertia_kg_m2"]
    );
    assert!(found.causes.is_empty());
}

#[test]
fn what_healthy_joints_differ_by_is_no_cause() {
    let params = Params::default().with(P::Coulomb, 0.3);
    let (manifest, recordings) = common::data(&params, 3);
    let mut healthy = calibration();
    let named = name_causes(&manifest, &recordings, &[], &healthy).expect("positions");
    assert_eq!(
        named.causes[0].effect,
        Some("coulomb_friction"),
        "{named:?}"
    );
    // Three times the size that the effect usually has.
    let dry = "drivetrain.coulomb_friction..0".to_owned();
    healthy.spreads.columns.insert(dry, 3.0);
    let found = name_causes(&manifest, &recordings, &[], &healthy).expect("positions");
    assert!(found.causes.is_empty(), "{found:?}");
}

#[test]
fn a_late_encoder_is_named_where_repeats_swing_out_of_step() {
    // The loop sees its encoder 12 ms late and swings; every run has a little more inertia than the one before.
    let late = Params::default().with(P::FeedbackDelay, 0.012);
    let (manifest, recordings) =
        common::data_of(|run| late.with(P::Inertia, 1.0 + 0.004 * run as f64), 3);
    let found = name_causes(&manifest, &recordings, &[], &calibration()).expect("positions");
    let named: Vec<_> = found.causes.iter().map(|c| c.effect).collect();
    assert!(!named.contains(&Some("packet_loss")), "{found:?}");
    assert_eq!(named[0], Some("feedback_delay"), "{found:?}");
}

/// A data set whose set-points are sent every 50 ms and lost by chance; none of what it recorded shows which.
fn losing(share: f64, seed: u64) -> (Manifest, Vec<Recording>) {
    let (manifest, sent) = common::data(&Params::default(), seed);
    let mut rng = Rng::new(seed);
    let mut arrived = sent.clone();
    for rec in &mut arrived {
        let joint = rec.joint_mut(0).expect("one joint");
        let mut column = joint.get(Signal::Setpoint).expect("sent").to_vec();
        for tick in (5..column.len()).step_by(5) {
            if rng.uniform() < share {
                let last = column[tick - 1];
                column[tick..tick + 5].fill(last);
            }
        }
        joint.set(Signal::Setpoint, Some(column));
    }
    let problem = Problem::new(&manifest, &arrived, 0).expect("position is there");
    let mut out = sent;
    for (rec, run) in out.iter_mut().zip(&problem.runs) {
        let mut trace = Trace::new();
        simulate(run, &Params::default(), problem.dt_s, &mut trace);
        common::fill(rec, &trace, &mut rng);
    }
    (manifest, out)
}

#[test]
fn lost_set_points_are_counted_though_nothing_echoes_them() {
    let (manifest, recordings) = losing(0.35, 5);
    let found = name_causes(&manifest, &recordings, &[], &calibration()).expect("positions");
    let named: Vec<_> = found.causes.iter().map(|c| c.effect).collect();
    assert_eq!(named, [Some("packet_loss")], "{found:?}");
    let share = found.causes[0].values["probability"].value;
    assert!((share - 0.35).abs() < 0.03, "{share}");
}

#[test]
fn what_the_law_of_a_cause_is_off_by_is_no_second_one() {
    // Dry friction that rises with the speed.
    let dry = Params::default()
        .with(P::Coulomb, 0.8)
        .with(P::Quadratic, 0.25);
    let (manifest, recordings) = common::data(&dry, 3);
    let mut known = calibration();
    let count = |known: &Calibration| {
        let found = name_causes(&manifest, &recordings, &[], known).expect("positions");
        let first = found.causes[0].effect;
        assert_eq!(first, Some("coulomb_friction"), "{found:?}");
        found.causes.len()
    };
    assert!(count(&known) > 1);
    known.laws.insert("drivetrain".into(), 0.3);
    assert_eq!(count(&known), 1);
}
