//! A robot that nothing but an overhead camera has seen: the paper's laboratory.

use crate::rig::{Folder, rb, trials};

#[test]
fn a_film_alone_shows_no_gap_where_there_is_none_and_what_it_could_not_show() {
    let folder = Folder::new("film_none");
    let make = "make-case none --filmed --untracked --gaits 6 -o ./case";
    let make: Vec<&str> = make.split(' ').collect();
    trials(&folder, &make).expect("a case");
    let verdict = rb(&folder, &["--json", "gap", "report", "case"])
        .expect(0)
        .json();
    assert_eq!(verdict["verdict"], "none", "{}", verdict["sentence"]);
    assert_eq!(verdict["effects"], serde_json::json!([]));
    let similarity = &verdict["metrics"]["similarity_r"];
    assert!(similarity.is_array(), "{}", verdict["metrics"]);
    let unseen = verdict["unseen"].as_array().expect("a list").iter();
    let names: Vec<&serde_json::Value> = unseen.map(|u| &u["effect"]).collect();
    assert!(names.contains(&&"camera_yaw".into()), "{names:?}");
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
