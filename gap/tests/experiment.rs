//! The next experiment: a motion inside what the joint was asked for, that separates what the data could not.

mod common;

use files::dataset::{Recording, Signal};
use gap::fit::Stop;
use gap::joint::{P, Params, Problem};
use gap::vocabulary::Effect;
use gap::{Settings, diagnose, experiment};

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
fn a_dead_zone_gets_the_motion_and_the_signals_that_tell_its_causes_apart() {
    let planted = Params::default().with(P::Deadband, 0.02);
    let (manifest, mut recordings) = common::data(&planted, 3);
    position_only(&mut recordings);
    let d = diagnose(&manifest, &recordings, 0, &Settings::default()).expect("position is there");
    let next = d
        .verdict
        .next_experiment
        .as_ref()
        .expect("a dead zone has rivals");
    for e in [Effect::Deadband, Effect::Backlash] {
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
fn a_law_is_told_from_its_absence_and_not_from_itself() {
    let truth = Params::default().with(P::Lag, 0.03);
    let (manifest, recordings) = common::data(&truth, 5);
    let problem = Problem::new(&manifest, &recordings, 0).expect("position");
    let weight = gap::floor::floor(&problem).weights();
    let free = gap::candidates::nominal(&problem);
    let rival = gap::fit::Model {
        params: Params::default(),
        free: free.clone(),
    };
    let e = experiment::separating(&problem, &truth, &[rival], weight, 100.0, Stop::NEVER)
        .expect("a motion");
    let promised = e.separation.expect("a class");
    assert!(promised > 6.0, "{promised}");
    // A model that already is the truth cannot be told from it.
    let same = gap::fit::Model {
        params: truth,
        free,
    };
    let e = experiment::separating(&problem, &truth, &[same], weight, 100.0, Stop::NEVER)
        .expect("a motion");
    assert!(e.separation < Some(0.5), "{:?}", e.separation);
}
