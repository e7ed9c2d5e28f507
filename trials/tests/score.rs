//! What counts as right: verdicts of both versions against labels.

use serde_json::{Value, json};
use trials::label::{Label, Labels, open, seal};
use trials::score::{Case, Figure, failures, left_out, table};

fn label(kind: &str, causes: Value) -> Label {
    let label = json!({ "name": "a", "engine": "mujoco", "kind": kind, "causes": causes });
    serde_json::from_value(label).expect("a label")
}

/// Dry friction in these joints.
fn friction(scope: &str, joints: &[usize]) -> Value {
    let by_joint: Value = joints.iter().map(|j| (j.to_string(), json!(0.5))).collect();
    json!({
        "effect": "coulomb_friction", "stage": "drivetrain", "scope": scope, "joints": joints,
        "values": { "torque_nm": { "value": 0.5, "by_joint": by_joint } }, "delta_chi2_refitted": 900.0,
    })
}

fn effect(name: &str, joint: usize, ci95: [f64; 2]) -> Value {
    json!({
        "effect": name, "stage": "drivetrain", "joint": joint, "confidence": 0.9,
        "parameters": { "torque_nm": { "value": 0.5, "ci95": ci95 } },
    })
}

fn version_1(word: &str, effects: Value, ambiguous: Value) -> Value {
    json!({
        "verdict": word, "effects": effects, "ambiguous": ambiguous,
        "probabilities": { "none": 0.0, "unknown": 0.1 }, "where": [{ "stage": "drivetrain", "joint": 2 }],
    })
}

#[test]
fn equal_effects_on_all_joints_are_a_shared_cause_in_version_1() {
    let effects: Value = (0..6)
        .map(|j| effect("coulomb_friction", j, [0.4, 0.45 + 0.03 * j as f64]))
        .collect();
    let all: Vec<usize> = (0..6).collect();
    let case = Case::new(
        label("single", json!([friction("all", &all)])),
        version_1("explained", effects, json!([])),
    );
    assert!(case.first(true) && case.exact() && case.place());
    assert_eq!(case.stated(), [(0.9, true)]);
    // Intervals of joints 0 and 1 end at 0.45 and 0.48.
    let covered: Vec<bool> = case.sized().iter().map(|s| s.holds()).collect();
    assert_eq!(covered.iter().filter(|c| **c).count(), 4);
    assert_eq!(covered.len(), 6);
}

#[test]
fn effects_of_a_payload_are_one_cause_with_the_ratio_of_its_weight() {
    let part = |effect: &str, value: f64| {
        json!({
            "effect": effect, "part_of": "payload", "stage": "drivetrain", "joint": 0, "confidence": 0.45,
            "parameters": { "ratio": { "value": value, "ci95": [value - 0.1, value + 0.1] } },
        })
    };
    let payload = json!([{
        "effect": "payload", "stage": "drivetrain", "scope": "joint", "joints": [0], "also": ["gravity_load"],
        "values": { "ratio": { "value": 1.6, "by_joint": { "0": 1.6 } } }, "delta_chi2_refitted": 900.0,
    }]);
    let effects = json!([part("gravity_load", 1.62), part("inertia", 1.3)]);
    let case = Case::new(
        label("single", payload),
        version_1("parametric", effects, json!([])),
    );
    assert!(case.first(true) && case.exact());
    let covered: Vec<bool> = case.sized().iter().map(|s| s.holds()).collect();
    assert_eq!(covered, [true]);
}

#[test]
fn one_joint_of_a_shared_cause_is_its_effect_but_not_its_place() {
    let said = json!([effect("coulomb_friction", 2, [0.0, 1.0])]);
    let case = Case::new(
        label("single", json!([friction("module", &[0, 1, 2])])),
        version_1("explained", said, json!([])),
    );
    assert!(!case.first(true) && case.first(false) && !case.exact());
    assert!(case.claims() && failures(&[&case], 25.0).len() == 1);
}

#[test]
fn a_class_counts_up_to_three() {
    let member = |e: &str| json!({ "effect": e, "joint": 2 });
    for (others, right) in [
        (vec!["coulomb_friction"], true),
        (vec!["coulomb_friction", "backlash"], true),
        (vec!["coulomb_friction", "backlash", "deadband"], false),
    ] {
        let mut members: Vec<Value> = others.iter().map(|e| member(e)).collect();
        members.push(member("viscous_friction"));
        let case = Case::new(
            label("single", json!([friction("joint", &[2])])),
            version_1(
                "explained",
                json!([effect("viscous_friction", 2, [0.0, 1.0])]),
                json!([{ "members": members }]),
            ),
        );
        assert_eq!(case.exact(), right, "{others:?}");
    }
}

#[test]
fn causes_of_version_2_have_scope_probability_and_rivals() {
    let cause = |effect: &str, alternatives: Value| {
        json!({
            "effect": effect, "stage": "drivetrain", "scope": "kind", "joints": [1, 4], "probability": 0.8,
            "values": { "torque_nm": { "value": 0.5, "ci95": [0.4, 0.6] } }, "alternatives": alternatives,
        })
    };
    let told = |alternatives: Value| {
        let verdict =
            json!({ "verdict": "explained", "causes": [cause("viscous_friction", alternatives)] });
        Case::new(label("single", json!([friction("kind", &[1, 4])])), verdict)
    };
    let rival = |distinguishable: bool| json!([{ "effect": "coulomb_friction", "distinguishable": distinguishable }]);
    assert!(told(rival(false)).exact());
    assert!(!told(rival(true)).exact());
    assert_eq!(told(rival(false)).stated(), [(0.8, true)]);
}

#[test]
fn nulls_are_in_no_denominator_of_unknown() {
    let none = json!({ "verdict": "unknown", "effects": [], "probabilities": { "none": 0.2 } });
    let null = Case::new(label("null", json!([])), none);
    let caused = Case::new(
        label("single", json!([friction("joint", &[2])])),
        version_1("unknown", json!([]), json!([])),
    );
    let figures = table(&[&null, &caused], false, 25.0);
    let count = |name: &str| {
        let found = figures.iter().find(|f: &&Figure| f.name.starts_with(name));
        found.expect("a figure").count
    };
    assert_eq!(count("false `unknown`"), Some((1, 1)));
    assert_eq!(count("nulls accused"), Some((0, 1)));
    assert_eq!(count("nulls not `none`"), Some((1, 1)));
    // Withheld, the same word in the right place is right.
    let left = left_out(&[&null, &caused], false, 25.0);
    assert_eq!(left[0].count, Some((1, 1)));
}

#[test]
fn labels_are_sealed_once() {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("seal");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join("labels.json");
    let labels = |kind: &str| Labels {
        format: 1,
        cases: vec![label(kind, json!([friction("joint", &[3])]))],
    };
    let hash = seal(&path, &labels("single")).expect("sealed");
    assert_eq!(seal(&path, &labels("single")).expect("the same"), hash);
    let (read, again) = open(&path).expect("opened");
    assert_eq!((read, again), (labels("single"), hash));
    assert!(seal(&path, &labels("several")).is_err());
    std::fs::write(&path, "{}").expect("written");
    assert!(open(&path).is_err());
}
