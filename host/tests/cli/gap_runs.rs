//! The checks of the diagnosis from end to end, as small as they get: sealed suites, grafts, the closed loop.

use std::fs;
use std::process::{Command, Stdio};

use crate::bench::Joint;
use crate::rig::{Done, Folder, command, finish, rb};

/// The figure called `name` of a score table: value and number of cases.
#[track_caller]
fn figure(done: &Done, name: &str) -> (Option<f64>, u64) {
    let table = done.json();
    let rows = table["rows"].as_array();
    let row = rows.and_then(|r| r.iter().find(|r| r["figure"] == name));
    let row = row.unwrap_or_else(|| panic!("no figure `{name}`: {table}"));
    (row["value"].as_f64(), row["cases"].as_u64().unwrap_or(0))
}

fn stamp(folder: &Folder, file: &str) -> std::time::SystemTime {
    let meta = fs::metadata(folder.path(file)).unwrap_or_else(|e| panic!("{file}: {e}"));
    meta.modified().unwrap()
}

#[test]
fn a_sealed_suite_of_joints_is_scored_and_goes_on_where_it_stopped() {
    let folder = Folder::new("blind");
    let args = [
        "--json", "gap", "blind", "-o", "b", "--cases", "6", "--nulls", "2", "--seed", "31",
    ];
    let first = rb(&folder, &args).expect(0);
    assert!(first.err.contains("labels sealed: sha256"), "{}", first.err);
    let (alarms, nulls) = figure(&first, "false alarms on nulls (an effect named)");
    assert!(nulls >= 2 && alarms == Some(0.0), "{}", first.out);
    let (recall, pairs) = figure(&first, "recall, detectable pairs");
    assert!(pairs >= 1 && recall == Some(1.0), "{}", first.out);
    let (unknown, outside) = figure(&first, "unknown found, detectable outside");
    assert!(outside >= 2 && unknown == Some(1.0), "{}", first.out);
    assert_eq!(first.json()["failures"], serde_json::json!([]));
    // One verdict is lost: that case alone is diagnosed again, to the same bytes but for the time it took.
    let lost = folder.path("b/verdicts/case_0002.json");
    let before = fs::read_to_string(&lost).unwrap();
    let kept = stamp(&folder, "b/verdicts/case_0001.json");
    fs::remove_file(&lost).unwrap();
    let again = rb(&folder, &args).expect(0);
    assert_eq!(first.out, again.out);
    assert_eq!(kept, stamp(&folder, "b/verdicts/case_0001.json"));
    let strip = |text: &str| -> serde_json::Value {
        let mut v: serde_json::Value = serde_json::from_str(text).unwrap();
        v["provenance"]["wall_time_s"] = serde_json::Value::Null;
        v
    };
    assert_eq!(strip(&before), strip(&fs::read_to_string(&lost).unwrap()));
    let other = [
        "gap", "blind", "-o", "b", "--cases", "6", "--nulls", "2", "--seed", "32",
    ];
    let refused = rb(&folder, &other);
    assert!(
        refused.code == 2 && refused.err.contains("another suite"),
        "{}",
        refused.err
    );
    // A label that was changed after it was sealed is not scored.
    let label = folder.path("b/labels/case_0001.json");
    fs::write(&label, fs::read_to_string(&label).unwrap() + " ").unwrap();
    let refused = rb(&folder, &args);
    assert!(
        refused.code != 0 && refused.err.contains("labels were changed"),
        "{}",
        refused.err
    );
}

#[test]
fn a_suite_that_is_interrupted_says_how_to_go_on() {
    let folder = Folder::new("blind_stopped");
    let args = [
        "gap", "blind", "-o", "b", "--cases", "60", "--nulls", "0", "--jobs", "1",
    ];
    let child = command(&folder, &args)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    while !folder.path("b/labels/case_0000.json").exists() {
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let id = child.id().to_string();
    Command::new("kill").args(["-INT", &id]).status().unwrap();
    let done = finish(child.wait_with_output().unwrap()).expect(130);
    assert!(done.err.contains("goes on from there"), "{}", done.err);
    assert!(folder.path("b/labels/case_0000.json").exists());
}

#[test]
fn a_sealed_robot_is_diagnosed_and_scored() {
    let folder = Folder::new("blind_whole");
    let args = [
        "--json", "gap", "blind", "--whole", "1", "--gaits", "3", "--seed", "5", "-o", "w",
    ];
    let done = rb(&folder, &args).expect(0);
    assert!(done.err.contains("labels sealed: sha256"), "{}", done.err);
    let (seconds, cases) = figure(&done, "wall time of a diagnosis, median, s");
    assert!(cases == 1 && seconds > Some(0.0), "{}", done.out);
    assert!(folder.path("w/whole_score.md").exists());
    // The same command with joints: these first, then the robots, of which nothing is done again.
    let both = [&args[1..], &["--cases", "1", "--nulls", "1"]].concat();
    let done = rb(&folder, &both).expect(0);
    let at = |text: &str| {
        done.out
            .find(text)
            .unwrap_or_else(|| panic!("{text}: {}", done.out))
    };
    assert!(at("false alarms on nulls") < at("wall time of a diagnosis"));
    assert!(folder.path("w/score.md").exists());
    // Fewer signals are another suite.
    let fewer = [&args[..], &["--without", "echo"]].concat();
    let refused = rb(&folder, &fewer).expect(2);
    assert!(refused.err.contains("another suite"), "{}", refused.err);
    // Labels that changed after they were sealed are not scored.
    fs::write(folder.path("w/whole_labels/robot_0000.json"), "{}").unwrap();
    let refused = rb(&folder, &args);
    assert_ne!(refused.code, 0);
    assert!(
        refused.err.contains("labels were changed"),
        "{}",
        refused.err
    );
}

#[test]
fn faults_put_onto_recordings_are_found_on_top_of_their_baseline() {
    let folder = Folder::new("grafts");
    let joint = Joint {
        noise_rad: 1e-3,
        ..Joint::default()
    };
    joint.record(&folder, &[0.2, 0.35, 0.5, 0.27, 0.42, 0.6]);
    let args = [
        "--json", "gap", "graft", "joint", "-o", "g", "--cases", "2", "--splits", "1",
    ];
    let done = rb(&folder, &args).expect(0);
    let (right, large) = figure(&done, "grafts named, larger than 2");
    assert!(large == 2 && right == Some(1.0), "{}", done.out);
    let table = fs::read_to_string(folder.path("g/score.md")).unwrap();
    assert!(table.contains("latency"), "{table}");
}

#[test]
fn the_loop_closes_from_search_to_patched_search() {
    let folder = Folder::new("close");
    let args = [
        "gap",
        "close",
        "-o",
        "c",
        "--particles",
        "4",
        "--iterations",
        "1",
        "--gaits",
        "3",
        "--duration",
        "4",
    ];
    let done = rb(&folder, &args).expect(0);
    for line in [
        "the nominal simulator | patched",
        "the patched simulator | patched",
    ] {
        assert!(done.out.contains(line), "{}", done.out);
    }
    for file in ["close.md", "patched.toml", "verdict.json"] {
        assert!(folder.path("c").join(file).exists(), "{file}");
    }
    let patched = folder.path("c/patched.toml");
    rb(&folder, &["model", "check", patched.to_str().unwrap()]).expect(0);
}
