//! What a person sees at a terminal: progress while a command works, and words that the shell completes.

use std::fs::File;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use hil_sim::endpoint::{Endpoint, Pty};

use crate::rig::{Emulator, Folder, command, gait, rb, trials};

/// Longest wait of a test for something that must come.
const PATIENCE: Duration = Duration::from_secs(300);
const SLICE: Duration = Duration::from_millis(20);

/// A terminal, and what was written to it so far.
struct Terminal {
    pty: Pty,
    seen: String,
}

impl Terminal {
    fn new() -> Self {
        Self {
            pty: Pty::open(None).unwrap(),
            seen: String::new(),
        }
    }

    fn side(&self) -> File {
        let device = PathBuf::from(self.pty.device());
        File::options().read(true).write(true).open(device).unwrap()
    }

    fn read(&mut self) {
        let mut buffer = [0; 4096];
        let count = self.pty.read(&mut buffer, SLICE).unwrap();
        self.seen
            .push_str(&String::from_utf8_lossy(&buffer[..count]));
    }

    fn wait_for(&mut self, words: &str) {
        let start = Instant::now();
        while !self.seen.contains(words) {
            assert!(start.elapsed() < PATIENCE, "no `{words}`: {}", self.seen);
            self.read();
        }
    }

    fn until_end(&mut self, child: &mut Child) -> Option<i32> {
        loop {
            self.read();
            if let Some(status) = child.try_wait().unwrap() {
                self.read();
                return status.code();
            }
        }
    }
}

#[test]
fn long_commands_show_how_far_they_are() {
    let folder = Folder::new("bars");
    let crawl = gait("crawl.toml");
    let sim = ["sim", &crawl, "-o", "set", "--camera", "--repeat", "6"];
    let robot = Emulator::start(&folder);
    let uri = robot.uri();
    rb(&folder, &["-p", &uri, "zero", "--yes"]).expect(0);
    let run = ["-p", &uri, "run", &crawl, "-d", "2s", "-r", "a.mcap"];
    let work: [(&[&str], &str); 4] = [
        (&sim, "simulating"),
        (
            &["camera", "import", "set/crawl_1", "-o", "film"],
            "importing",
        ),
        (&["-p", &uri, "bus", "bench", "-d", "2s"], "measuring"),
        (&run, "run 1"),
    ];
    for (args, what) in work {
        let mut terminal = Terminal::new();
        let mut child = command(&folder, args)
            .stdout(Stdio::null())
            .stderr(terminal.side())
            .spawn()
            .unwrap();
        let code = terminal.until_end(&mut child);
        assert_eq!(code, Some(0), "{args:?}: {}", terminal.seen);
        let seen = &terminal.seen;
        assert!(
            seen.contains(what) && seen.contains(" left"),
            "{args:?}: {seen}"
        );
    }
}

/// Starts a command on a terminal, waits for words on it, and kills the command.
fn shown_at_work(folder: &Folder, args: &[&str], words: &[&str]) {
    let mut terminal = Terminal::new();
    let mut child = command(folder, args)
        .stdout(Stdio::null())
        .stderr(terminal.side())
        .spawn()
        .unwrap();
    for words in words {
        terminal.wait_for(words);
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_diagnosis_shows_its_phase_and_the_time_that_is_left() {
    let folder = Folder::new("phases");
    let servo = format!("{}/../examples/servo", env!("CARGO_MANIFEST_DIR"));
    let report = ["gap", "report", &servo, "-o", "r.html"];
    shown_at_work(&folder, &report, &["searching effect", "s left"]);
    let predict = ["gap", "predict", &servo, "-o", "p"];
    shown_at_work(&folder, &predict, &["searching effect", "s left"]);
    trials(
        &folder,
        &["make-case", "none", "--gaits", "2", "-o", "./case"],
    )
    .expect("a case");
    for set in [servo.as_str(), "case"] {
        let words = ["searching causes", "s left"];
        shown_at_work(&folder, &["gap", "causes", set], &words);
    }
    let phases = ["(1 of 4)", "(2 of 4)", "s left"];
    shown_at_work(&folder, &["gap", "report", "case"], &phases);
    shown_at_work(
        &folder,
        &["gap", "predict", "case", "-o", "p"],
        &phases[..1],
    );
}

#[test]
fn films_show_their_phase_and_the_time_that_is_left() {
    let folder = Folder::new("film-phases");
    let (crawl, roll) = (gait("crawl.toml"), gait("roll.toml"));
    let set = [
        "sim", &crawl, &roll, "-d", "20s", "--camera", "--repeat", "2", "-o", "set",
    ];
    rb(&folder, &set).expect(0);
    let compare = ["camera", "compare", "set"];
    shown_at_work(&folder, &compare, &["simulating and comparing", "s left"]);
    let simulate = [
        "camera", "simulate", "set", "--run", "crawl_1", "-o", "film",
    ];
    shown_at_work(&folder, &simulate, &["writing", "s left"]);
}

#[cfg(unix)]
#[test]
fn a_prediction_that_was_stopped_writes_nothing() {
    let folder = Folder::new("predict-stopped");
    let servo = format!("{}/../examples/servo", env!("CARGO_MANIFEST_DIR"));
    let mut terminal = Terminal::new();
    let mut child = command(&folder, &["gap", "predict", &servo, "-o", "p"])
        .stdout(Stdio::null())
        .stderr(terminal.side())
        .spawn()
        .unwrap();
    terminal.wait_for("searching effect");
    let id = child.id().to_string();
    Command::new("kill").args(["-INT", &id]).status().unwrap();
    let code = terminal.until_end(&mut child);
    assert_eq!(code, Some(130), "{}", terminal.seen);
    assert!(terminal.seen.contains("stopped; nothing was written"));
    assert!(!folder.path("p").exists());
}

#[test]
fn a_search_of_gaits_that_was_stopped_says_so_at_once_and_chooses() {
    let folder = Folder::new("gaits-stopped");
    let mut terminal = Terminal::new();
    let mut child = command(&folder, &["optimise", "gait", "-o", "found"])
        .stdout(Stdio::null())
        .stderr(terminal.side())
        .spawn()
        .unwrap();
    terminal.wait_for("best ");
    let id = child.id().to_string();
    Command::new("kill").args(["-INT", &id]).status().unwrap();
    terminal.wait_for("stopping: choosing from what was found so far; Ctrl-C again ends");
    let code = terminal.until_end(&mut child);
    assert_eq!(code, Some(130), "{}", terminal.seen);
    assert!(terminal.seen.contains("the checkpoint is written"));
    assert!(folder.path("found/selection.json").exists());
}

#[test]
fn ctrl_c_ends_work_on_a_terminal_at_once() {
    let folder = Folder::new("bars-stopped");
    let crawl = gait("crawl.toml");
    let mut terminal = Terminal::new();
    let mut child = command(&folder, &["sim", &crawl, "--repeat", "60000"])
        .stdout(Stdio::null())
        .stderr(terminal.side())
        .spawn()
        .unwrap();
    terminal.wait_for("simulating");
    let id = child.id().to_string();
    Command::new("kill").args(["-INT", &id]).status().unwrap();
    let code = terminal.until_end(&mut child);
    assert_eq!(code, Some(130), "{}", terminal.seen);
}

#[test]
fn bash_completes_at_its_prompt() {
    let folder = Folder::new("prompt");
    let script = rb(&folder, &["completions", "bash"]).expect(0).out;
    folder.write("rb-host.bash", script);
    let mut terminal = Terminal::new();
    let mut bash = Command::new("bash")
        .args(["--norc", "--noprofile", "-i"])
        .env("TERM", "dumb")
        .env("HOME", folder.path("."))
        .current_dir(folder.path("."))
        .stdin(terminal.side())
        .stdout(terminal.side())
        .stderr(terminal.side())
        .spawn()
        .unwrap();
    terminal
        .pty
        .write(b"stty sane; source ./rb-host.bash && echo re''ady\n")
        .unwrap();
    terminal.wait_for("ready");
    for (typed, completed) in [
        ("rb-host gap re\t", "rb-host gap report "),
        ("rb-host gap report --withh\t", "--withhold "),
        ("rb-host gait convert x --to to\t", "--to toml "),
    ] {
        terminal.seen.clear();
        terminal.pty.write(typed.as_bytes()).unwrap();
        terminal.wait_for(completed);
        // Ctrl-U empties the line.
        terminal.pty.write(b"\x15").unwrap();
    }
    terminal.pty.write(b"exit\n").unwrap();
    terminal.until_end(&mut bash);
}
