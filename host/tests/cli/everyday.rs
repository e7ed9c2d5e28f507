//! What happens on any day: a pipe that closes, a full disk, a typo, an existing file, a refused robot, hostile text in a file.

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Command, Stdio};

use crate::bench::Joint;
use crate::rig::{Done, Emulator, Folder, command, finish, gait, rb, trials};

/// A command line of a shell; `rb` in it is rb-host.
fn shell(folder: &Folder, line: &str) -> Done {
    let program = command(folder, &[]);
    let mut sh = Command::new("bash");
    sh.args([
        "-c",
        &format!(
            "rb() {{ '{}' \"$@\"; }}; {line}",
            program.get_program().display()
        ),
    ])
    .env("NO_COLOR", "1")
    .env("HOME", folder.path("."))
    .current_dir(folder.path("."))
    .stdin(Stdio::null());
    finish(sh.output().unwrap())
}

#[test]
fn a_reader_that_has_gone_ends_a_stream_silently() {
    let folder = Folder::new("pipe");
    for line in ["-q -p sim: monitor", "-q -p sim: monitor --json --rate 100"] {
        let done = shell(
            &folder,
            &format!("rb {line} | head -2; exit ${{PIPESTATUS[0]}}"),
        )
        .expect(0);
        assert_eq!(done.out.lines().count(), 2, "{done:?}");
        assert_eq!(done.err, "", "{line}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_on_standard_output_is_told() {
    let folder = Folder::new("full-out");
    let crawl = gait("crawl.toml");
    for line in [
        "-p sim: info",
        &format!("gait check {crawl}"),
        &format!("gait convert {crawl} --to toml"),
        "bus table --json",
        "completions bash",
        "man",
        "-p sim: monitor -d 1s",
        "--help",
        "--version",
    ] {
        let done = shell(&folder, &format!("rb {line} > /dev/full")).expect(1);
        assert!(
            done.err
                .contains("cannot write to standard output: No space left"),
            "{line}: {done:?}"
        );
    }
    // Nobody can be told, but the exit code is right.
    shell(&folder, "rb gait check absent.toml 2> /dev/full").expect(3);
    shell(
        &folder,
        "rb gait check absent.toml --json > /dev/full 2> /dev/full",
    )
    .expect(3);
}

/// What bash offers for the last word of a line, by the completion function itself.
fn completed(folder: &Folder, words: &[&str]) -> Vec<String> {
    let last = words.len() - 1;
    let line = format!(
        "source <(rb completions bash); COMP_WORDS=(rb-host {}); COMP_CWORD={}; shown=$(complete -p rb-host); shown=${{shown##*-F }}; ${{shown%% *}} rb-host '{}' '{}'; printf '%s\\n' \"${{COMPREPLY[@]}}\"",
        words
            .iter()
            .map(|w| format!("'{w}'"))
            .collect::<Vec<_>>()
            .join(" "),
        words.len(),
        words[last],
        if last == 0 {
            "rb-host"
        } else {
            words[last - 1]
        },
    );
    let done = shell(folder, &line).expect(0);
    done.out.lines().map(str::to_owned).collect()
}

#[test]
fn bash_completes_every_word_of_a_command_line() {
    let folder = Folder::new("bash");
    for (words, expected) in [
        (&["ga"][..], &["gait", "gap"][..]),
        (&["gap", "re"], &["report"]),
        (&["gap", "report", "--with"], &["--withhold"]),
        (
            &["gait", "convert", "x.toml", "--to", ""],
            &["toml", "json", "hex"],
        ),
        (&["config", "key", "s"], &["set"]),
        (&["camera", "co"], &["compare"]),
    ] {
        assert_eq!(completed(&folder, words), expected, "{words:?}");
    }
}

#[test]
fn a_misspelt_key_is_told_and_stands_in_the_verdict() {
    let folder = Folder::new("typo");
    Joint::default().record(&folder, &[0.2, 0.35]);
    let path = folder.path("joint/dataset.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(
        &path,
        text.replace("[bench]\n", "[bench]\ninertia = 0.003\n"),
    )
    .unwrap();
    let csv = std::fs::read_to_string(folder.path("joint/run1.csv")).unwrap();
    folder.write(
        "joint/run1.csv",
        csv.replace("position_rad", "position_rad,torque")
            .replace('\n', ",0\n")
            .replacen(",0\n", "\n", 1),
    );
    let args = [
        "--json",
        "gap",
        "report",
        "joint",
        "--time-limit",
        "0s",
        "--markdown",
        "r.md",
        "-o",
        "r.html",
    ];
    let done = rb(&folder, &args).expect(0);
    let key = "unknown key `bench.inertia` is ignored";
    let column = "unknown column `torque` is ignored";
    for words in [key, column] {
        assert!(
            done.err
                .contains(&format!("warning: dataset.toml:4: {words}"))
                || words == column,
            "{}",
            done.err
        );
        assert_eq!(done.err.matches(words).count(), 1, "{}", done.err);
        let warnings = done.json()["provenance"]["warnings"].to_string();
        assert!(warnings.contains(words), "{warnings}");
        for file in ["r.md", "r.html"] {
            let text = std::fs::read_to_string(folder.path(file)).unwrap();
            assert!(text.contains(words), "{file}");
            assert!(done.err.contains(&format!("wrote {file}")), "{}", done.err);
        }
    }
    // The checker calls the typo a problem, and the column, which may be meant, a note.
    let checked = rb(&folder, &["rec", "check", "joint"]).expect(8);
    assert!(
        checked
            .out
            .contains(&format!("PROBLEM: dataset.toml:4: {key}")),
        "{}",
        checked.out
    );
    assert!(
        checked.out.contains(&format!("note: run1.csv:1: {column}")),
        "{}",
        checked.out
    );
}

#[test]
fn a_refused_run_leaves_the_folder_as_it_was() {
    let folder = Folder::new("refused");
    let robot = Emulator::start(&folder);
    let uri = robot.uri();
    let crawl = gait("crawl.toml");
    let run = ["-p", &uri, "run", &crawl, "-d", "1s", "-r", "live.mcap"];
    let done = rb(&folder, &run).expect(7);
    assert!(done.err.contains("rb-host zero"), "{}", done.err);
    for left in ["live.mcap", "live.mcap.new"] {
        assert!(!folder.path(left).exists(), "{left}");
    }
    // Nor does --force cost an earlier recording.
    folder.write("live.mcap", "earlier");
    rb(&folder, &[&run[..], &["--force"]].concat()).expect(7);
    assert_eq!(std::fs::read(folder.path("live.mcap")).unwrap(), b"earlier");
    rb(&folder, &["-p", &uri, "zero", "--yes"]).expect(0);
    rb(&folder, &[&run[..], &["--force"]].concat()).expect(0);
    rb(&folder, &["rec", "check", "live.mcap"]).expect(0);
}

#[test]
fn nothing_is_overwritten_unasked_and_always_with_exit_code_2() {
    let folder = Folder::new("overwrite");
    let crawl = gait("crawl.toml");
    Joint::default().record(&folder, &[0.2, 0.35]);
    rb(
        &folder,
        &["-p", "sim:", "run", &crawl, "-d", "1s", "-r", "r.mcap"],
    )
    .expect(0);
    let commands: [&[&str]; 11] = [
        &["gait", "new", "old"],
        &["gait", "show", &crawl, "--plot", "old"],
        &["gait", "convert", &crawl, "--to", "json", "-o", "old"],
        &["-p", "sim:", "run", &crawl, "-d", "1s", "-r", "old"],
        &["-p", "sim:", "download", "-o", "old"],
        &["rec", "plot", "r.mcap", "-o", "old"],
        &["rec", "convert", "r.mcap", "--to", "csv", "-o", "old"],
        &["gap", "report", "joint", "-o", "old"],
        &["gap", "report", "joint", "--json-file", "old"],
        &["gap", "report", "joint", "--markdown", "old"],
        &["--json", "gap", "report", "joint", "old"],
    ];
    for args in commands {
        folder.write("old", "precious");
        let done = rb(&folder, args).expect(2);
        assert!(
            done.err.contains("old exists") && done.err.contains("--force"),
            "{args:?}: {done:?}"
        );
        assert_eq!(
            std::fs::read(folder.path("old")).unwrap(),
            b"precious",
            "{args:?}"
        );
    }
    // Told before the work: these runs would take an hour.
    std::fs::create_dir(folder.path("full")).unwrap();
    folder.write("full/notes.txt", "precious");
    let long = [
        "sim", &crawl, "-d", "600s", "--repeat", "6000", "-o", "full",
    ];
    let done = rb(&folder, &long).expect(2);
    assert!(
        done.err.contains("full exists and is not empty"),
        "{}",
        done.err
    );
    // A folder of other things is no place for a search, and a missing one is told before the work.
    std::fs::create_dir(folder.path("mine")).unwrap();
    folder.write("mine/notes.txt", "precious");
    let done = rb(&folder, &["optimise", "gait", "-o", "mine"]).expect(2);
    assert!(done.err.contains("mine holds notes.txt"), "{}", done.err);
    let done = rb(&folder, &["gap", "report", "joint", "-o", "absent/r.html"]).expect(2);
    assert!(
        done.err.contains("there is no folder absent"),
        "{}",
        done.err
    );
}

#[test]
fn without_a_person_the_emulated_robot_must_be_named() {
    let folder = Folder::new("unattended");
    if rb(&folder, &["list", "--json"]).expect(0).json()["ports"] != serde_json::json!([]) {
        return crate::rig::skip("unattended", "a robot may be attached to this machine");
    }
    let crawl = gait("crawl.toml");
    for args in [
        &["run", &crawl, "-d", "1s", "-r", "a.mcap"][..],
        &["run", &crawl, "-d", "1s", "--dataset", "set"],
        &["gap", "collect", &crawl, "-d", "1s", "-o", "set"],
        &["hybrid", "-o", "h"],
        &["upload", &crawl],
        &["slots", "activate", "0"],
        &["slots", "erase", "0", "--yes"],
        // A STOP that stops nothing must not look like one that did.
        &["stop"],
        &["zero", "--yes"],
        &["reset"],
        &["bus", "write", "2", "goal-position", "100"],
        &["bus", "bench", "-d", "1s"],
        &["bus", "use", "xm430"],
        &["config", "key", "set"],
        &["monitor", "-d", "1s"],
    ] {
        let done = rb(&folder, args).expect(2);
        assert!(
            done.err.contains("hint: give -p sim:"),
            "{args:?}: {}",
            done.err
        );
    }
    let left = std::fs::read_dir(folder.path(".")).unwrap().count();
    assert_eq!(left, 0);
}

#[test]
fn pictures_and_recordings_of_the_emulated_robot_say_so() {
    let folder = Folder::new("says-emulated");
    let crawl = gait("crawl.toml");
    rb(
        &folder,
        &["-p", "sim:", "run", &crawl, "-d", "1s", "-r", "a.mcap"],
    )
    .expect(0);
    let about = rb(&folder, &["rec", "info", "a.mcap", "--json"])
        .expect(0)
        .json();
    assert_eq!(about["about"]["emulated"], "true");
    rb(&folder, &["rec", "plot", "a.mcap"]).expect(0);
    let drawn = std::fs::read_to_string(folder.path("a.svg")).unwrap();
    assert!(drawn.contains(">emulated robot, run 1,"));
    let checked = rb(&folder, &["rec", "check", "a.mcap"]).expect(0);
    assert!(checked.out.contains("emulated robot"), "{}", checked.out);

    // The robot itself says what it is, so a recording over a port says it too.
    let robot = Emulator::start(&folder);
    let uri = robot.uri();
    let said = rb(&folder, &["-p", &uri, "info", "--json"])
        .expect(0)
        .json();
    assert_eq!(said["emulated"], true);
    rb(&folder, &["-p", &uri, "zero", "--yes"]).expect(0);
    rb(
        &folder,
        &["-p", &uri, "run", &crawl, "-d", "1s", "-r", "port.mcap"],
    )
    .expect(0);
    let about = rb(&folder, &["rec", "info", "port.mcap", "--json"])
        .expect(0)
        .json();
    assert_eq!(about["about"]["emulated"], "true");
    rb(&folder, &["rec", "plot", "port.mcap"]).expect(0);
    let drawn = std::fs::read_to_string(folder.path("port.svg")).unwrap();
    assert!(drawn.contains(">emulated robot, run 1,"));
}

#[test]
fn messages_tell_their_cause_once_and_name_the_file() {
    let folder = Folder::new("words");
    let done = rb(&folder, &["gait", "check", "absent.toml"]).expect(3);
    assert_eq!(done.err.matches("No such file").count(), 1, "{}", done.err);
    let done = rb(&folder, &["-p", "tcp://127.0.0.1:1", "info"]).expect(4);
    assert_eq!(
        done.err.matches("onnection refused").count(),
        1,
        "{}",
        done.err
    );
    // The gait is optional beside --slot, and both are named.
    let done = rb(&folder, &["run"]).expect(2);
    assert!(
        done.err.contains("gait file") && done.err.contains("-s"),
        "{}",
        done.err
    );
    folder.write("o.toml", "particles = 3\nparticlez = 4\n");
    let done = rb(&folder, &["optimise", "gait", "-o", "s", "-s", "o.toml"]).expect(3);
    assert!(
        done.err.contains("o.toml:2: unknown field `particlez`"),
        "{}",
        done.err
    );
    // A value of 20 kB is not shown in full.
    folder.write(
        "o.toml",
        format!("particles = \"{}\"\n", "x".repeat(20_000)),
    );
    let done = rb(&folder, &["optimise", "gait", "-o", "s", "-s", "o.toml"]).expect(3);
    assert!(done.err.len() < 2_000, "{} bytes", done.err.len());
    folder.write("file", "");
    let done = rb(&folder, &["man", "-o", "file/man"]).expect(1);
    assert!(
        done.err.contains("cannot make the folder file/man"),
        "{}",
        done.err
    );
    // Errors have a colour when asked for.
    let done = rb(
        &folder,
        &["--color", "always", "gait", "check", "absent.toml"],
    )
    .expect(3);
    assert!(
        done.err.starts_with("\u{1b}[31merror\u{1b}[0m: "),
        "{:?}",
        done.err
    );
}

#[test]
fn gaits_come_from_standard_input_and_from_their_json() {
    let folder = Folder::new("gait-in");
    let crawl = gait("crawl.toml");
    let mut child = command(&folder, &["gait", "check", "-"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let text = std::fs::read(&crawl).unwrap();
    child.stdin.take().unwrap().write_all(&text).unwrap();
    finish(child.wait_with_output().unwrap()).expect(0);
    for name in ["crawl.toml", "turn.toml", "roll.toml"] {
        let file = gait(name);
        rb(
            &folder,
            &[
                "gait", "convert", &file, "--to", "json", "-o", "g.json", "--force",
            ],
        )
        .expect(0);
        rb(&folder, &["gait", "diff", &file, "g.json"]).expect(0);
    }
    folder.write("bad.json", "{ \"format\": 1,\n \"name\": }");
    let done = rb(&folder, &["gait", "check", "bad.json"]).expect(3);
    assert!(done.err.contains("bad.json:2"), "{}", done.err);
    rb(&folder, &["optimize", "gait", "--help"]).expect(0);
}

/// A robot under a camera, filmed from the ground up.
const FILMED: &str =
    "body = \"ground\"\nseed = 5\n[camera]\nheight_m = 2.2\nclock_ahead_s = 7.25\n[tracker]\n";

#[test]
fn a_run_in_the_air_needs_no_film() {
    let folder = Folder::new("air");
    folder.write("plant.toml", FILMED);
    let crawl = gait("crawl.toml");
    let args = [
        "-p",
        "sim:plant.toml",
        "gap",
        "collect",
        &crawl,
        "-o",
        "set",
        "-d",
        "4s",
        "--warm",
        "0s",
        "--repeat",
        "1",
    ];
    let mut child = command(&folder, &args)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = String::new();
    let mut reader = BufReader::new(child.stderr.take().unwrap());
    // The first motion in the air is enough; the rest is the same.
    while !said.contains("joint0_step: ") {
        assert!(reader.read_line(&mut said).unwrap() > 0, "{said}");
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(said.contains("joint0_step: motors recorded"), "{said}");
    let manifest = std::fs::read_to_string(folder.path("set/dataset.toml")).unwrap();
    assert!(manifest.contains("frames = \"crawl_0\""), "{manifest}");
    assert!(
        manifest.contains("joint0_step") && !manifest.contains("frames = \"joint0_step\""),
        "{manifest}"
    );
}

#[test]
fn collecting_goes_on_past_a_recording_that_fails_and_tells_what_is_missing() {
    let folder = Folder::new("collect-misfit");
    // The camera looks elsewhere: no film fits its run.
    folder.write(
        "plant.toml",
        FILMED.replace("height_m = 2.2", "height_m = 2.2\nx_m = 9"),
    );
    let crawl = gait("crawl.toml");
    let args = [
        "--json",
        "-p",
        "sim:plant.toml",
        "gap",
        "collect",
        &crawl,
        "-o",
        "set",
        "-d",
        "2s",
        "--warm",
        "0s",
        "--no-joints",
        "--repeat",
        "2",
    ];
    let done = rb(&folder, &args).expect(7);
    let value: serde_json::Value = serde_json::from_str(done.out.lines().next().unwrap()).unwrap();
    assert_eq!(
        value["missing_names"],
        serde_json::json!(["crawl_0", "crawl_1"]),
        "{done:?}"
    );
    assert!(
        done.err.contains("going on with the next one"),
        "{}",
        done.err
    );
    assert!(
        done.err.contains("the same command goes on from here"),
        "{}",
        done.err
    );
}

#[cfg(unix)]
#[test]
fn ctrl_c_in_a_diagnosis_leaves_a_partial_verdict_and_exit_code_130() {
    let folder = Folder::new("partial");
    let joint = Joint {
        play_rad: 0.02,
        noise_rad: 1e-3,
    };
    joint.record(&folder, &[0.2, 0.35, 0.5, 0.27, 0.42, 0.6]);
    let args = ["-v", "gap", "report", "joint", "--json-file", "v.json"];
    let mut child = command(&folder, &args)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = String::new();
    let mut reader = BufReader::new(child.stderr.take().unwrap());
    while !said.contains("searching") {
        assert!(reader.read_line(&mut said).unwrap() > 0, "{said}");
    }
    let id = child.id().to_string();
    Command::new("kill").args(["-INT", &id]).status().unwrap();
    reader.read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
    assert!(
        said.contains("stopping: the verdict so far is written"),
        "{said}"
    );
    assert!(
        said.contains("wrote v.json") && said.contains("the verdict is partial"),
        "{said}"
    );
    let text = std::fs::read_to_string(folder.path("v.json")).unwrap();
    let verdict: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(verdict["partial"], true);
}

#[cfg(unix)]
#[test]
fn ctrl_c_in_the_diagnosis_of_a_robot_ends_it_and_writes_nothing() {
    let folder = Folder::new("robot-stopped");
    let case = ["make-case", "none", "--gaits", "2", "-o", "./case"];
    trials(&folder, &case).expect("a case");
    let args = ["-v", "gap", "report", "case", "--json-file", "v.json"];
    let mut child = command(&folder, &args)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = String::new();
    let mut reader = BufReader::new(child.stderr.take().unwrap());
    while !said.contains("searching causes (2 of 4)") {
        assert!(reader.read_line(&mut said).unwrap() > 0, "{said}");
    }
    let id = child.id().to_string();
    Command::new("kill").args(["-INT", &id]).status().unwrap();
    reader.read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
    assert!(said.contains("stopped; nothing was written"), "{said}");
    assert!(!folder.path("v.json").exists());
    // A time limit that nobody would keep is refused.
    let limited = ["gap", "report", "case", "--time-limit", "1min"];
    let refused = rb(&folder, &limited).expect(2);
    assert!(refused.err.contains("is for one joint"), "{}", refused.err);
}
