//! The next experiment: a motion inside what the joint was asked for, that separates what the data could not.

mod common;
#[path = "common/diagnosis.rs"]
mod diagnosis;

use files::dataset::{Recording, Signal};
use gap::experiment::separating;
use gap::joint::{P, Params, Problem, Trace, simulate};
use gap::vocabulary::Effect;

/// Leaves set-point and position.
fn position_only(recordings: &mut [Recording]) {
    for r in recordings {
        let joint = r.joint_mut(0).expect("one joint");
        for s in [Signal::Current, Signal::Duty, Signal::LinkPosition] {
            joint.set(s, None);
        }
    }
}

#[test]
fn a_friction_gets_the_motion_and_the_signals_that_tell_its_kinds_apart() {
    let planted = Params::default().with(P::Coulomb, 0.08);
    let (manifest, mut recordings) = common::data(&planted, 3);
    position_only(&mut recordings);
    let d = diagnosis::diagnosed(&manifest, &recordings);
    let next = d
        .verdict
        .next_experiment
        .as_ref()
        .expect("a friction has rivals");
    for e in [Effect::CoulombFriction, Effect::StribeckFriction] {
        assert!(next.separates.contains(&e), "{next:?}");
    }
    let e = d.experiment.as_ref().expect("a motion");
    // Inside what was asked for: the waves of the data set reach from -1.2 to 0.9 rad.
    for (_, q) in &e.motion.setpoints {
        assert!((-1.25..=0.95).contains(q), "{q}");
    }
    let jumps = e.motion.setpoints.windows(2);
    assert!(jumps.map(|w| (w[1].1 - w[0].1).abs()).fold(0.0, f64::max) < 1.0);
    let promise = (e.motion.name, &e.signals, e.separation);
    assert!(e.separation > Some(3.0), "{promise:?}");
    let text = e.motion.to_csv(false);
    assert!(text.starts_with("t_s,setpoint_rad\n0.0000,"));
}

#[test]
fn the_motion_that_shows_most_is_chosen_and_none_shows_a_law_from_itself() {
    let truth = Params::default().with(P::Lag, 0.03);
    let (manifest, recordings) = common::data(&truth, 5);
    let problem = Problem::new(&manifest, &recordings, 0).expect("position");
    // Largest difference of the positions of two laws, mrad.
    let apart = |rival: &Params, play: Problem| {
        let run = &play.runs[0];
        let mut other = Trace::new();
        simulate(run, rival, play.dt_s, &mut other);
        let rows = run.samples.iter().zip(&other);
        let each = rows.map(|(s, y)| (s.measured[0] - y[0]).abs());
        1e3 * each.fold(0.0, f64::max)
    };
    let without = Params::default();
    let found = separating(&problem, &truth, &|play, _| apart(&without, play)).expect("a motion");
    assert!(found.separation > Some(6.0), "{:?}", found.separation);
    assert!(found.signals.is_empty(), "{:?}", found.signals);
    // A lag shows where the joint moves fast.
    assert_ne!(found.motion.name, "slow triangle");
    let same = separating(&problem, &truth, &|play, _| apart(&truth, play)).expect("a motion");
    assert_eq!(same.separation, Some(0.0));
}
