//! A robot that nothing but an overhead camera has seen: the paper's laboratory.

use crate::rig::{Folder, rb, trials};

/// Effects named in the data set `name`, with the sum of their parameters.
fn named(folder: &Folder, causes: &str) -> (String, Vec<(String, f64)>) {
    let make = [
        "make-case",
        causes,
        "--filmed",
        "--untracked",
        "--gaits",
        "6",
        "-o",
        "./case",
    ];
    trials(folder, &make).expect("a case");
    let done = rb(folder, &["--json", "gap", "report", "case"]).expect(0);
    let verdict = done.json();
    assert!(
        verdict["metrics"]["similarity_r"].is_array(),
        "{}",
        done.out
    );
    let effects = verdict["effects"].as_array().expect("effects").iter();
    let one = |e: &serde_json::Value| {
        let parameters = e["parameters"].as_object().expect("parameters").values();
        let sum = parameters.filter_map(|p| p["value"].as_f64()).sum();
        (e["effect"].as_str().expect("a name").to_string(), sum)
    };
    let word = verdict["verdict"].as_str().expect("a word").to_string();
    (word, effects.map(one).collect())
}

#[test]
fn a_film_alone_shows_a_slippery_ground_and_no_gap_where_there_is_none() {
    let folder = Folder::new("film_none");
    assert_eq!(named(&folder, "none"), ("none".to_string(), Vec::new()));
    let folder = Folder::new("film_friction");
    let (_, effects) = named(&folder, "ground_friction:0.4");
    assert!(
        matches!(effects.as_slice(), [(e, x)] if e == "ground_friction" && (x / 0.4 - 1.0).abs() < 0.15),
        "{effects:?}"
    );
}

#[test]
fn films_beside_a_tracked_robot_show_a_camera_with_another_clock() {
    let folder = Folder::new("film_clock");
    let make = "make-case camera_time_shift:0.4 --filmed --gaits 3 -o ./case";
    let make: Vec<&str> = make.split(' ').collect();
    trials(&folder, &make).expect("a case");
    let found = rb(&folder, &["--json", "gap", "causes", "case"])
        .expect(0)
        .json();
    let causes = found["causes"].as_array().expect("causes");
    assert_eq!(causes.len(), 1, "{found}");
    assert_eq!(causes[0]["effect"], "camera_time_shift", "{found}");
    let shift_s = causes[0]["values"]["shift_s"]["value"].as_f64();
    assert!(shift_s.is_some_and(|s| (s - 0.4).abs() < 0.02), "{found}");
}
