//! Power cuts: commands that record are killed at many instants and go on from there.

use std::path::Path;
use std::process::Stdio;

use crate::hybrid::{TINY, tree};
use crate::rig::{Folder, command, gait, rb};

/// Runs until `seen` stands in the folder, then kills without warning; false when the command ended before.
fn killed_at(folder: &Folder, args: &[&str], seen: &str) -> bool {
    let mut child = command(folder, args)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let ended = loop {
        if folder.path(seen).exists() {
            break false;
        }
        if child.try_wait().unwrap().is_some() {
            break true;
        }
        std::thread::yield_now();
    };
    let _ = child.kill();
    child.wait().unwrap();
    !ended
}

/// The first instants at which a recording into a data set can be cut, by what stands there then.
const INSTANTS: [&str; 9] = [
    "gaits",
    "model.toml.new",
    "model.toml",
    "recordings/dataset.toml",
    "recordings/crawl_1.mcap.new",
    "recordings/crawl_1.mcap",
    "crawl_1.csv.new",
    "crawl_1.csv",
    "dataset.toml",
];

#[test]
fn a_data_set_that_was_cut_off_at_any_instant_is_completed() {
    let folder = Folder::new("cut-set");
    let crawl = gait("crawl.toml");
    let run =
        |set: &str| ["-p", "sim:", "run", &crawl, "-d", "1s", "--dataset", set].map(str::to_owned);
    let whole = run("whole");
    rb(&folder, &whole.each_ref().map(String::as_str)).expect(0);
    let expected = tree(&folder.path("whole"));
    for (k, instant) in INSTANTS.iter().enumerate() {
        let set = format!("set{k}");
        let args = run(&set);
        let args = args.each_ref().map(String::as_str);
        killed_at(&folder, &args, &format!("{set}/{instant}"));
        // A run that was in the set before the cut stays; the command then adds the next one.
        rb(&folder, &args).expect(0);
        rb(&folder, &["rec", "check", &set]).expect(0);
        let found = tree(&folder.path(&set));
        for (name, bytes) in &expected {
            assert!(
                name == "dataset.toml" || found.get(name) == Some(bytes),
                "{instant}: {name}"
            );
        }
    }
}

/// Instants of a hybrid cycle, in their order.
const STEPS: [&str; 14] = [
    "robot",
    "state.json",
    "cycle1/search",
    "cycle1/search/optimise.toml",
    "cycle1/search/checkpoint.json",
    "cycle1/search/selection.json",
    "cycle1/set",
    "cycle1/set/recordings/dataset.toml",
    "cycle1/set/g01_1",
    "cycle1/set/g01_1/index.csv",
    "cycle1/set/g01_1.csv",
    "cycle1/set/dataset.toml",
    "cycle1/match",
    "cycle1/resimulate",
];

#[test]
fn a_cycle_that_was_killed_again_and_again_ends_with_the_bytes_of_a_whole_one() {
    let whole = Folder::new("cut-whole");
    whole.write("tiny.toml", TINY);
    let begin = [
        "-p",
        "sim:",
        "hybrid",
        "-o",
        "hyb",
        "-j",
        "1",
        "-s",
        "tiny.toml",
    ];
    rb(&whole, &begin).expect(0);
    let expected = tree(&whole.path("hyb"));
    let pieces = Folder::new("cut-pieces");
    pieces.write("tiny.toml", TINY);
    let resume = ["hybrid", "-o", "hyb", "-j", "1", "--resume"];
    for step in STEPS {
        let args = if pieces.path("hyb/state.json").exists() {
            &resume[..]
        } else {
            &begin
        };
        killed_at(&pieces, args, &format!("hyb/{step}"));
    }
    rb(&pieces, &resume).expect(0);
    let found = tree(Path::new(&pieces.path("hyb")));
    let names: Vec<&String> = found.keys().collect();
    assert_eq!(names, expected.keys().collect::<Vec<_>>());
    for (name, bytes) in &expected {
        assert!(found[name] == *bytes, "{name} differs");
    }
}
