//! Power cuts: commands that record are killed at many instants and go on from there.

use std::path::Path;
use std::process::Stdio;

use crate::hybrid::{TINY, tree};
use crate::rig::{Folder, command, gait, rb};

/// Runs until `seen` stands in the folder, then kills without warning; false when the command ended before.
fn killed_at(folder: &Folder, args: &[&str], seen: &str) -> bool {
    killed_when(folder, args, |folder| folder.path(seen).exists())
}

/// Runs until `now`, then kills without warning; false when the command ended before.
fn killed_when(folder: &Folder, args: &[&str], now: impl Fn(&Folder) -> bool) -> bool {
    let mut child = command(folder, args)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let ended = loop {
        if now(folder) {
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

/// Files and folders below a folder.
fn entries(path: &Path) -> usize {
    let inside = std::fs::read_dir(path).into_iter().flatten().flatten();
    inside.map(|entry| 1 + entries(&entry.path())).sum()
}

/// A search of three iterations.
const SEARCH: &str = "format = 1\nparticles = 6\niterations = 3\nseed = 9\n\
    [space]\nduration_s = 2\n[score]\nrepetitions = 2\n[select]\ncount = 2\nbest = 1\ntraining = 1\n";

/// What the commands below read: two filmed gaits, a recording, settings, a patch.
fn inputs(folder: &Folder) {
    let (crawl, roll) = (gait("crawl.toml"), gait("roll.toml"));
    folder.write("search.toml", SEARCH);
    let films = [
        "sim", &crawl, &roll, "-d", "1s", "--camera", "--repeat", "2", "-o", "films",
    ];
    rb(folder, &films).expect(0);
    let run = ["-p", "sim:", "run", &crawl, "-d", "1s", "-r", "run.mcap"];
    rb(folder, &run).expect(0);
    let servo = format!("{}/../examples/servo", env!("CARGO_MANIFEST_DIR"));
    let report = [
        "gap",
        "report",
        &servo,
        "--patch",
        "patch.toml",
        "--time-limit",
        "0s",
    ];
    rb(folder, &report).expect(0);
}

/// Commands that fill a folder `out`. Where the second is given, it goes on from a checkpoint.
fn fillers() -> Vec<(Vec<String>, Option<Vec<String>>)> {
    let crawl = gait("crawl.toml");
    let servo = format!("{}/../examples/servo", env!("CARGO_MANIFEST_DIR"));
    let words = |line: &str| -> Vec<String> {
        let line = line.replace("CRAWL", &crawl).replace("SERVO", &servo);
        line.split_whitespace().map(str::to_owned).collect()
    };
    [
        ("sim CRAWL -d 1s --camera --repeat 3 -o out", None),
        ("camera import films/crawl_1 -o out", None),
        ("camera simulate films --run crawl_1 -o out", None),
        ("rec convert run.mcap --to dataset -o out", None),
        ("gap predict SERVO --patch patch.toml -o out", None),
        ("emulate films CRAWL -d 2s --repeat 2 -o out", None),
        (
            "-p sim: gap collect CRAWL -d 1s --warm 0s --repeat 2 -o out",
            None,
        ),
        (
            "optimise gait -o out -s search.toml -j 1",
            Some("optimise gait -o out --resume -j 1"),
        ),
        (
            "optimise model films -o out --training crawl --rows 3 --particles 4 --iterations 3 -j 1",
            Some("optimise model films -o out --resume -j 1"),
        ),
    ]
    .map(|(begin, resume): (&str, Option<&str>)| (words(begin), resume.map(words)))
    .into()
}

#[test]
fn a_command_that_was_killed_while_it_filled_a_folder_fills_it_in_the_end() {
    for (begin, resume) in fillers() {
        let [whole, pieces] = ["cut-none", "cut-often"].map(Folder::new);
        inputs(&whole);
        inputs(&pieces);
        let words = |args: &[String]| {
            args.iter()
                .map(String::as_str)
                .collect::<Vec<_>>()
                .join(" ")
        };
        let line: Vec<&str> = begin.iter().map(String::as_str).collect();
        rb(&whole, &line).expect(0);
        let expected = tree(&whole.path("out"));
        let next = || match &resume {
            Some(resume) if pieces.path("out/checkpoint.json").exists() => resume.clone(),
            _ => begin.clone(),
        };
        for count in [1, 2, 3, 5, 8, 13, 21, 34] {
            let args = next();
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            killed_when(&pieces, &args, |folder| {
                entries(&folder.path("out")) >= count
            });
        }
        let last = next();
        let last: Vec<&str> = last.iter().map(String::as_str).collect();
        let again = rb(&pieces, &last);
        // The command may have been quicker than the last cut: then its folder is whole.
        let done = again.code == 0 || (again.code == 2 && again.err.contains("not empty"));
        assert!(done, "{}: {again:?}", words(&begin));
        let found = tree(&pieces.path("out"));
        let names: Vec<&String> = found.keys().collect();
        assert_eq!(
            names,
            expected.keys().collect::<Vec<_>>(),
            "{}",
            words(&begin)
        );
        for (name, bytes) in &expected {
            assert!(found[name] == *bytes, "{}: {name} differs", words(&begin));
        }
    }
}

#[test]
fn a_shorter_command_leaves_nothing_of_a_longer_one_that_was_killed() {
    let folder = Folder::new("cut-longer");
    let (crawl, roll, turn) = (gait("crawl.toml"), gait("roll.toml"), gait("turn.toml"));
    let short = |out: &'static str| {
        let line = ["sim", &crawl, "-d", "1s", "--camera", "-o", out];
        rb(&folder, &line)
    };
    short("whole").expect(0);
    let expected = tree(&folder.path("whole"));
    let long = [
        "sim", &roll, &crawl, &turn, "-d", "2s", "--camera", "--repeat", "3", "-o", "out",
    ];
    for seen in ["gaits/turn.toml", "roll_2.csv", "turn_1/00020.png"] {
        assert!(
            killed_at(&folder, &long, &format!("out/{seen}")),
            "{seen}: too fast"
        );
        // What somebody else put there is neither removed nor taken into the data set.
        folder.write("out/gaits/notes.txt", "mine");
        let refused = short("out").expect(2);
        assert!(refused.err.contains("gaits/notes.txt"), "{}", refused.err);
        assert_eq!(
            std::fs::read_to_string(folder.path("out/gaits/notes.txt")).unwrap(),
            "mine"
        );
        std::fs::remove_file(folder.path("out/gaits/notes.txt")).unwrap();
        short("out").expect(0);
        assert_eq!(tree(&folder.path("out")), expected, "{seen}");
        std::fs::remove_dir_all(folder.path("out")).unwrap();
    }
}

#[test]
fn a_diagnosis_that_was_killed_leaves_whole_files_or_none() {
    let folder = Folder::new("cut-report");
    let servo = format!("{}/../examples/servo", env!("CARGO_MANIFEST_DIR"));
    let report = [
        "gap",
        "report",
        &servo,
        "--time-limit",
        "0s",
        "--force",
        "-o",
        "r.html",
        "--json-file",
        "v.json",
        "--patch",
        "p.toml",
    ];
    let files = ["r.html", "v.json", "p.toml"];
    for seen in ["r.html.new", "r.html", "v.json.new", "v.json", "p.toml.new"] {
        for name in files {
            let _ = std::fs::remove_file(folder.path(name));
        }
        killed_at(&folder, &report, seen);
        let text = |name: &str| std::fs::read_to_string(folder.path(name)).ok();
        assert!(text("r.html").is_none_or(|html| html.trim_end().ends_with("</html>")));
        let json = text("v.json");
        assert!(json.is_none_or(|v| serde_json::from_str::<serde_json::Value>(&v).is_ok()));
    }
    rb(&folder, &report).expect(0);
    for name in files {
        assert!(!folder.path(&format!("{name}.new")).exists(), "{name}.new");
    }
}
