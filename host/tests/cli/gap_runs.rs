//! The checks of the diagnosis from end to end, as small as they get: sealed suites, grafts, the closed loop.

use std::collections::BTreeMap;
use std::fs;

use crate::bench::Joint;
use crate::rig::{Folder, rb, trials};

const HOST: &str = env!("CARGO_BIN_EXE_rb-host");

/// Value and count of the figure called `name` on the side of the emulator.
#[track_caller]
fn figure(folder: &Folder, name: &str) -> (Option<f64>, serde_json::Value) {
    let text = fs::read_to_string(folder.path("b/score.json")).unwrap();
    let table: serde_json::Value = serde_json::from_str(&text).unwrap();
    let rows = table["engines"]["emulator"].as_array();
    let row = rows.and_then(|r| r.iter().find(|r| r["figure"] == name));
    let row = row.unwrap_or_else(|| panic!("no figure `{name}`: {table}"));
    (row["value"].as_f64(), row["count"].clone())
}

fn stamp(folder: &Folder, file: &str) -> std::time::SystemTime {
    let meta = fs::metadata(folder.path(file)).unwrap_or_else(|e| panic!("{file}: {e}"));
    meta.modified().unwrap()
}

/// Makes, diagnoses and scores a suite in `b`.
fn suite(folder: &Folder, make: &[&str]) -> Result<(), String> {
    trials(folder, make)?;
    trials(
        folder,
        &["run", "./b/cases", "-o", "./b/verdicts", "--host", HOST],
    )?;
    let score = [
        "score",
        "--labels",
        "./b/labels.json",
        "--verdicts",
        "./b/verdicts",
    ];
    trials(
        folder,
        &[
            &score[..],
            &["--json-file", "./b/score.json", "--laws", "./b/laws.json"],
        ]
        .concat(),
    )
}

#[test]
fn a_sealed_suite_of_joints_is_scored_and_goes_on_where_it_stopped() {
    let folder = Folder::new("blind");
    let make = [
        "joints", "-o", "./b", "--cases", "2", "--nulls", "2", "--seed", "31",
    ];
    suite(&folder, &make).expect("a suite");
    // Rates need more than two joints: `trials/tests/joint_verdicts.rs` holds those without a cause to no alarm.
    let (_, count) = figure(&folder, "nulls accused (a cause said)");
    assert!(count[1].as_u64() >= Some(2), "{count}");
    // Two joints are too few to say how far sizes are off.
    let laws: BTreeMap<String, f64> =
        serde_json::from_str(&fs::read_to_string(folder.path("b/laws.json")).unwrap()).unwrap();
    assert!(laws.is_empty(), "{laws:?}");
    // One verdict is lost: that case alone is diagnosed again, to the same bytes but for the time it took.
    let lost = folder.path("b/verdicts/case_1001.json");
    let before = fs::read_to_string(&lost).unwrap();
    let kept = stamp(&folder, "b/verdicts/case_1000.json");
    fs::remove_file(&lost).unwrap();
    suite(&folder, &make).expect("the same suite");
    assert_eq!(kept, stamp(&folder, "b/verdicts/case_1000.json"));
    let strip = |text: &str| -> serde_json::Value {
        let mut v: serde_json::Value = serde_json::from_str(text).unwrap();
        v["provenance"]["wall_time_s"] = serde_json::Value::Null;
        v
    };
    assert_eq!(strip(&before), strip(&fs::read_to_string(&lost).unwrap()));
    let other = [
        "joints", "-o", "./b", "--cases", "2", "--nulls", "2", "--seed", "32",
    ];
    let refused = trials(&folder, &other).unwrap_err();
    assert!(refused.contains("another suite"), "{refused}");
    // A label that was changed after it was sealed is not scored.
    let labels = folder.path("b/labels.json");
    fs::write(&labels, fs::read_to_string(&labels).unwrap() + " ").unwrap();
    let score = [
        "score",
        "--labels",
        "./b/labels.json",
        "--verdicts",
        "./b/verdicts",
    ];
    let refused = trials(&folder, &score).unwrap_err();
    assert!(refused.contains("is not what"), "{refused}");
}

#[test]
fn a_sealed_robot_is_diagnosed_and_scored() {
    let folder = Folder::new("blind_whole");
    let make = [
        "robots", "-o", "./b", "--cases", "1", "--gaits", "3", "--seed", "5",
    ];
    suite(&folder, &make).expect("a suite");
    let (seconds, _) = figure(&folder, "wall time of a diagnosis, median, s");
    assert!(seconds > Some(0.0), "{seconds:?}");
    // The other command of the diagnosis, by a calibration of one's own.
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../gap/calibration/robot.json");
    let run = [
        "run",
        "./b/cases",
        "-o",
        "./b/causes",
        "--command",
        "causes",
        "--calibration",
        shipped,
        "--host",
        HOST,
    ];
    trials(&folder, &run).expect("causes");
    let text = fs::read_to_string(folder.path("b/causes/robot_0000.json")).unwrap();
    assert!(text.contains("rb.gap/2"), "{text}");
    // Fewer signals are another suite.
    let refused = trials(&folder, &[&make[..], &["--without", "echo"]].concat());
    assert!(refused.unwrap_err().contains("another suite"));
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
        "graft", "./joint", "-o", "./g", "--cases", "2", "--splits", "1", "--host", HOST,
    ];
    trials(&folder, &args).expect("grafts");
    let table = fs::read_to_string(folder.path("g/score.md")).unwrap();
    assert!(table.contains("larger than 2 | 1.000 | 2 of 2"), "{table}");
    assert!(table.contains("latency"), "{table}");
    // Without recordings there is nothing to do.
    trials(
        &folder,
        &["graft", "./nowhere", "-o", "./n", "--host", HOST],
    )
    .expect("skipped");
}

#[test]
fn the_loop_closes_from_search_to_patched_search() {
    let folder = Folder::new("close");
    let small = [
        "--particles",
        "4",
        "--iterations",
        "1",
        "--gaits",
        "3",
        "--duration",
        "4",
    ];
    let args = ["close", "-o", "./c", "--host", HOST];
    trials(&folder, &[&args[..], &small].concat()).expect("the loop");
    let table = fs::read_to_string(folder.path("c/close.md")).unwrap();
    for line in [
        "the nominal simulator | patched",
        "the patched simulator | patched",
    ] {
        assert!(table.contains(line), "{table}");
    }
    for file in ["close.md", "patched.toml", "verdict.json"] {
        assert!(folder.path("c").join(file).exists(), "{file}");
    }
    let patched = folder.path("c/patched.toml");
    rb(&folder, &["model", "check", patched.to_str().unwrap()]).expect(0);
}
