use super::*;
use files::model::Effect as E;

/// A robot that a tracker has seen for the length of a gait.
fn question(among: Vec<Explanation>) -> Question {
    let data = Data {
        runs: Vec::new(),
        gaits: Vec::new(),
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

fn explanation(effect: E, values: &[f64]) -> Explanation {
    let mut model = Model::hand_tuned();
    model.set_effect(effect, None, values).expect("in range");
    Explanation {
        effect: Effect::from_name(effect.info().name).expect("shared"),
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
    let slope = explanation(E::GroundSlope, &[0.08, 0.0]);
    let shift = explanation(E::ComOffset, &[0.0, 0.02, 0.0]);
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
    let same = || explanation(E::GroundFriction, &[0.6]);
    let q = question(vec![same(), same()]);
    let e = q.experiment(&menu(), &|_| true).expect("a gait");
    let look = e.look.expect("something to look at");
    assert!(look.apart < 1e-9, "{look:?}");
    assert!(e.heading_rad.is_none() && e.text.contains("No gait of the menu"));
    let slippery = explanation(E::GroundFriction, &[0.3]);
    let q = question(vec![same(), slippery]);
    assert_eq!(q.experiment(&menu(), &|_| false), None);
    let slow = q.experiment(&menu(), &|g| g.name() == "paddle_slower");
    assert_eq!(slow.expect("one passes").gait.name(), "paddle_slower");
}
