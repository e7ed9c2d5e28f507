use super::*;
use crate::whole::nominal::Motors;

/// A robot that a tracker has seen for the length of a gait.
fn question(among: Vec<Explanation>) -> Question {
    let data = Data {
        runs: Vec::new(),
        gaits: Vec::new(),
        motors: Motors::of(&Model::hand_tuned()),
    };
    Question {
        open: Open::Class(among),
        data: Arc::new(data),
        meters: Meters {
            place_m: Some(PLACE_M),
            torque_nm: Vec::new(),
        },
    }
}

fn explanation(effect: Effect, values: &[f64]) -> Explanation {
    let mut model = Model::hand_tuned();
    model.set_effect(effect, None, values).expect("in range");
    Explanation {
        effect,
        parameters: std::collections::BTreeMap::new(),
        model,
    }
}

fn menu() -> Vec<Gait> {
    let text = include_str!("../../../../gaits/paddle.toml");
    vec![files::gait::parse("paddle", text).expect("a gait")]
}

#[test]
fn a_slope_is_told_from_a_shifted_mass_at_some_heading() {
    let slope = explanation(Effect::GroundSlope, &[0.08, 0.0]);
    let shift = explanation(Effect::ComOffset, &[0.0, 0.02, 0.0]);
    let q = question(vec![slope, shift]);
    let e = q.experiment(&menu(), &|_| true).expect("a gait");
    // A slope has a direction, so the heading is part of the experiment.
    assert!(e.heading_rad.is_some(), "{e:?}");
    let look = e.look.expect("something to look at");
    assert!(look.separation() > CLEAR, "{look:?}");
    let [a, b] = [0, 1].map(|i| look.predicted[i].1.clone());
    let apart = libm::hypot(a[0] - b[0], a[1] - b[1]);
    assert!((apart - look.apart).abs() < 1e-9, "{look:?}");
    for word in ["paddle", "ground_slope", "com_offset", "degrees"] {
        assert!(e.text.contains(word), "{}", e.text);
    }
}

#[test]
fn what_is_alike_is_not_promised_to_differ_and_what_is_refused_is_not_proposed() {
    let same = || explanation(Effect::GroundFriction, &[0.6]);
    let q = question(vec![same(), same()]);
    let e = q.experiment(&menu(), &|_| true).expect("a gait");
    let look = e.look.expect("something to look at");
    assert!(look.apart < 1e-9, "{look:?}");
    assert!(e.heading_rad.is_none() && e.text.contains("No gait of the menu"));
    let slippery = explanation(Effect::GroundFriction, &[0.3]);
    let q = question(vec![same(), slippery]);
    assert_eq!(q.experiment(&menu(), &|_| false), None);
    let slow = q.experiment(&menu(), &|g| g.name() == "paddle_slower");
    assert_eq!(slow.expect("one passes").gait.name(), "paddle_slower");
}

/// A run that was sent `gait`.
fn sent_run(gait: &Gait) -> super::super::data::Run {
    use super::super::data::{JointTracks, Run, Track};
    let mut state = control::cpg::start(gait);
    let mut joints: [JointTracks; JOINTS] = Default::default();
    for tick in 0..240 {
        let points = control::cpg::step(gait, &mut state, control::CYCLE_S);
        for (joint, q) in joints.iter_mut().zip(points.as_slice()) {
            let track = joint.command.get_or_insert_with(Track::default);
            track.t_s.push(f64::from(tick) * 0.05);
            track.v.push(f64::from(*q));
        }
    }
    Run {
        name: "run.csv".into(),
        gait: 0,
        repeat: 0,
        role: None,
        joints,
        base: None,
        bus_v: None,
        blows_s: None,
        t0_s: 0.0,
        length_s: 11.95,
        index: 0,
    }
}

#[test]
fn a_remainder_gets_its_gait_again_slower() {
    let gait = menu().remove(0);
    let data = Arc::new(Data {
        runs: vec![sent_run(&gait)],
        gaits: vec!["paddle".into()],
        motors: Motors::of(&Model::hand_tuned()),
    });
    let q = Question {
        open: Open::Remainder {
            gait: 0,
            cost: 12.0,
        },
        data: Arc::clone(&data),
        ..question(Vec::new())
    };
    let e = q.experiment(&[], &|_| true).expect("its own gait");
    let ratio = e.gait.frequency_hz() / gait.frequency_hz();
    assert!((ratio - 0.5).abs() < 1e-3, "{ratio}");
    for (a, b) in e.gait.oscillators().iter().zip(gait.oscillators()) {
        let turned = control::math::wrap_pi(a.initial_phase_rad - b.initial_phase_rad);
        assert!((a.amplitude_rad - b.amplitude_rad).abs() < 0.01);
        assert!(turned.abs() < 0.02 || a.amplitude_rad < 0.01, "{a:?} {b:?}");
    }
    assert!(e.text.contains("gait paddle leave most (12 squared"));
}
