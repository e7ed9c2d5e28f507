//! The hybrid cycle: whole, in pieces, interrupted; on the emulated robot and with a camera of the user's own.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::rig::{Emulator, Folder, command, rb};

/// Seconds where the paper takes hours.
pub(crate) const TINY: &str = r#"
format = 1
repeats = 2
[search]
particles = 8
iterations = 3
[search.space]
duration_s = 3
[search.score]
repetitions = 2
[search.select]
count = 3
best = 2
training = 2
[match]
particles = 4
iterations = 2
rows = "3,13,17"
"#;

/// The only files that may hold a wall time.
const TIMED: [&str; 5] = [
    "times.json",
    "account.txt",
    "account.json",
    "account.svg",
    "report.html",
];

/// Every file below a folder, by its path in it.
pub(crate) fn tree(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(root).unwrap().display().to_string();
                files.insert(name, std::fs::read(&path).unwrap());
            }
        }
    }
    files.retain(|name, _| !TIMED.contains(&name.as_str()));
    files
}

fn hybrid(folder: &Folder, extra: &[&str]) -> crate::rig::Done {
    // Unattended, the emulated robot must be named.
    let robot: &[&str] = if extra.contains(&"-p") {
        &[]
    } else {
        &["-p", "sim:"]
    };
    rb(
        folder,
        &[robot, &["hybrid", "-o", "hyb", "-j", "1"], extra].concat(),
    )
}

fn json(folder: &Folder, name: &str) -> serde_json::Value {
    let text = std::fs::read_to_string(folder.path(name)).unwrap();
    serde_json::from_str(&text).unwrap()
}

#[test]
fn a_cycle_in_pieces_ends_with_the_bytes_of_a_whole_one() {
    let whole = Folder::new("hybrid-whole");
    whole.write("tiny.toml", TINY);
    let done = hybrid(&whole, &["-s", "tiny.toml", "--cycles", "2"]).expect(0);
    assert!(
        done.out.contains("Table III") && done.out.contains("Time account"),
        "{done:?}"
    );
    let expected = tree(&whole.path("hyb"));
    for name in [
        "cycle1/search/selection.json",
        "cycle1/set/dataset.toml",
        "cycle1/set/g01_1/index.csv",
        "cycle1/match/model.toml",
        "cycle1/resimulate/result.json",
        "cycle1/resimulate/overlay.png",
        "cycle2/match/tables.txt",
    ] {
        assert!(expected.contains_key(name), "{name}");
    }
    assert_eq!(
        expected["cycle1/match/model.toml"], expected["cycle2/model.toml"],
        "the next cycle searches on the matched model"
    );
    assert_ne!(
        expected["cycle1/search/selection.json"],
        expected["cycle2/search/selection.json"]
    );

    let pieces = Folder::new("hybrid-pieces");
    pieces.write("tiny.toml", TINY);
    hybrid(
        &pieces,
        &["-s", "tiny.toml", "--cycles", "2", "--until", "search"],
    )
    .expect(0);
    hybrid(&pieces, &["-s", "tiny.toml"]).expect(2);
    // Ctrl-C in the middle of the recordings.
    let args = ["hybrid", "-o", "hyb", "--cycles", "2", "--resume"];
    let mut child = command(&pieces, &args)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    while !pieces.path("hyb/cycle1/set/g01_1.csv").exists() {
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let id = child.id().to_string();
    Command::new("kill").args(["-INT", &id]).status().unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(json(&pieces, "hyb/state.json")["step"], "record");
    for step in ["record", "match", "resimulate"] {
        hybrid(&pieces, &["--resume", "--cycles", "2", "--until", step]).expect(0);
    }
    assert_eq!(json(&pieces, "hyb/state.json")["cycle"], 2);
    hybrid(&pieces, &["--resume", "--cycles", "2"]).expect(0);
    let found = tree(&pieces.path("hyb"));
    let names = |files: &BTreeMap<String, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&found), names(&expected));
    for (name, bytes) in &expected {
        assert!(found[name] == *bytes, "{name} differs");
    }
}

/// Without the time that the diagnosis took.
fn timeless(folder: &Folder) -> BTreeMap<String, Vec<u8>> {
    let mut files = tree(&folder.path("hyb"));
    files.retain(|name, _| !name.ends_with("diagnosis.html"));
    for (name, bytes) in &mut files {
        if name.ends_with("diagnosis.json") {
            let mut verdict: serde_json::Value = serde_json::from_slice(bytes).unwrap();
            verdict["provenance"]["wall_time_s"] = serde_json::Value::Null;
            *bytes = verdict.to_string().into_bytes();
        }
    }
    files
}

/// The effects that a model file switches on, as its text has them.
fn effects(files: &BTreeMap<String, Vec<u8>>, name: &str) -> String {
    let text = std::str::from_utf8(&files[name]).unwrap();
    let start = text.find("[effect");
    start.map_or_else(String::new, |start| text[start..].to_owned())
}

#[test]
fn a_diagnosed_cycle_searches_on_the_patched_model_next_and_may_be_interrupted() {
    let settings = format!("diagnose = true{TINY}");
    let whole = Folder::new("hybrid-diagnosed");
    whole.write("tiny.toml", &settings);
    hybrid(&whole, &["-s", "tiny.toml", "--until", "resimulate"]).expect(0);
    hybrid(&whole, &["--resume", "--cycles", "2", "--until", "search"]).expect(0);
    let files = timeless(&whole);
    let found = effects(&files, "cycle1/diagnosis.toml");
    assert!(!found.is_empty(), "the drawn robot has a gap that is named");
    assert_eq!(found, effects(&files, "cycle1/patched.toml"));
    assert_eq!(
        found,
        effects(&files, "cycle2/model.toml"),
        "the next cycle searches with the effects found"
    );
    assert_eq!(effects(&files, "cycle1/start.toml"), "");
    // Ctrl-C while it diagnoses: the step is done again, to the same bytes.
    let pieces = Folder::new("hybrid-interrupted");
    pieces.write("tiny.toml", &settings);
    hybrid(
        &pieces,
        &["-s", "tiny.toml", "--cycles", "2", "--until", "record"],
    )
    .expect(0);
    let args = [
        "hybrid", "-o", "hyb", "-j", "1", "--cycles", "2", "--resume",
    ];
    let mut child = command(&pieces, &args)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let id = child.id().to_string();
    Command::new("kill").args(["-INT", &id]).status().unwrap();
    child.wait().unwrap();
    hybrid(
        &pieces,
        &["--resume", "--cycles", "2", "--until", "diagnose"],
    )
    .expect(0);
    let again = timeless(&pieces);
    for name in ["cycle1/diagnosis.json", "cycle1/diagnosis.toml"] {
        assert!(again[name] == files[name], "{name} differs");
    }
}

/// The account adds up, and the robot's part of it is what the runs took.
#[test]
fn the_time_account_adds_up() {
    let folder = Folder::new("hybrid-account");
    folder.write("tiny.toml", TINY);
    hybrid(&folder, &["-s", "tiny.toml", "--robot-seed", "2"]).expect(0);
    let (account, times) = (
        json(&folder, "hyb/account.json"),
        json(&folder, "hyb/times.json"),
    );
    let lines = account["hybrid"].as_array().unwrap();
    let hours = |line: &serde_json::Value| line["hours"].as_f64().unwrap();
    let sum: f64 = lines.iter().map(hours).sum();
    assert!((sum - account["hybrid_hours"].as_f64().unwrap()).abs() < 1e-12);
    let (robot_s, runs) = (
        times["robot_s"].as_f64().unwrap(),
        times["experiments"].as_f64().unwrap(),
    );
    // Each run: a second of mark, three of gait, and the way to the start pose; half a minute of handling.
    assert!(
        robot_s > 4.0 * runs && robot_s < 30.0 * runs,
        "{robot_s} s in {runs} runs"
    );
    assert!((hours(&lines[1]) - (robot_s + 30.0 * runs) / 3600.0).abs() < 1e-9);
    // 50 x 100 x 3 experiments of 33 s.
    assert!((hours(&account["online"][0]) - 15_000.0 * 33.0 / 3600.0).abs() < 1e-9);
    let page = std::fs::read_to_string(folder.path("hyb/report.html")).unwrap();
    assert!(page.contains("data:image/png;base64,") && !page.contains("src=\"http"));
}

/// A robot behind a port: its takes are recorded, then the cycle says which films it needs and where to put them.
#[test]
fn with_a_robot_on_a_port_the_films_are_asked_for() {
    let folder = Folder::new("hybrid-port");
    folder.write("ground.toml", "body = \"ground\"\n");
    let one = TINY.replace(
        "count = 3\nbest = 2\ntraining = 2",
        "count = 1\nbest = 1\ntraining = 1",
    );
    folder.write("one.toml", one);
    let emulator = Emulator::start_with(&folder, &["--scenario", "ground.toml"]);
    let uri = emulator.uri();
    rb(&folder, &["-p", &uri, "zero", "--yes"]).expect(0);
    let args = ["-p", &uri, "--yes", "-s", "one.toml"];
    let no_slot = hybrid(&folder, &args).expect(2);
    assert!(no_slot.err.contains("--slot"), "{no_slot:?}");
    let asked = hybrid(&folder, &[&args[..], &["--slot", "0"]].concat()).expect(1);
    assert!(asked.err.contains("g01_1, g01_2"), "{asked:?}");
    assert!(asked.err.contains("hyb/cycle1/films/TAKE"), "{asked:?}");
    assert_eq!(json(&folder, "hyb/state.json")["step"], "record");
    // Asked again, it does not run the robot again.
    drop(emulator);
    let again = hybrid(&folder, &["--resume"]).expect(1);
    assert!(again.err.contains("g01_1, g01_2"), "{again:?}");
}
