//! SIGINT and SIGTERM end every long command. One that has a robot or a search to look after says so first; then the second signal
//! ends it. Waiting is not measured, because a busy machine waits long: what counts is the processor time that a command takes after
//! the signal, at most 2 s on each core.

use std::io::Read as _;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::rig::{Emulator, Folder, command, gait, rb, trials};

/// Processor time that a command may take to end, s.
const LONGEST_S: f64 = 2.0;
/// A command that is still there then hangs.
const HANGS: Duration = Duration::from_secs(300);
/// Begin of a request that a command stops; a second signal ends it.
const AGAIN: &str = "Ctrl-C again ends rb-host at once";

/// State and processor time of a process, s, from `/proc`; `Z` once it has ended.
fn state(child: &Child) -> (char, f64) {
    let text = std::fs::read_to_string(format!("/proc/{}/stat", child.id())).unwrap();
    // The name in brackets may hold anything; fields 3, 14 and 15 come after it (proc(5)).
    let fields: Vec<&str> = text
        .rsplit_once(')')
        .unwrap()
        .1
        .split_whitespace()
        .collect();
    let ticks: f64 = fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap();
    (fields[0].chars().next().unwrap(), ticks / 100.0)
}

fn signal(child: &Child, name: &str) {
    let id = child.id().to_string();
    let sent = Command::new("kill")
        .args([&format!("-{name}"), &id])
        .status()
        .unwrap();
    assert!(sent.success());
}

/// Waits until the child has ended, or has said that it is about to; gives which.
fn ended_or_said(child: &Child, folder: &Folder, args: &[&str]) -> bool {
    let begun = Instant::now();
    loop {
        if state(child).0 == 'Z' {
            return true;
        }
        let said = std::fs::read_to_string(folder.path("err")).unwrap_or_default();
        if said.contains(AGAIN) {
            return false;
        }
        assert!(begun.elapsed() < HANGS, "{args:?} hangs");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Sends the signal at work; gives the processor time that the command took to end, s, and whether it said what it does first.
fn end(folder: &Folder, args: &[&str], name: &str, after: Duration) -> (f64, bool) {
    let err = std::fs::File::create(folder.path("err")).unwrap();
    let mut command = command(folder, args);
    let mut child = command.stdout(Stdio::piped()).stderr(err).spawn().unwrap();
    let mut out = child.stdout.take().unwrap();
    let drain = std::thread::spawn(move || out.read_to_end(&mut Vec::new()));
    std::thread::sleep(after);
    let (now, before_s) = state(&child);
    if now == 'Z' {
        // A fast machine was done before the signal.
        let said = std::fs::read_to_string(folder.path("err")).unwrap();
        assert!(child.wait().unwrap().success(), "{args:?}: {said}");
        return (0.0, false);
    }
    signal(&child, name);
    let ended = ended_or_said(&child, folder, args);
    if !ended {
        signal(&child, name);
        let begun = Instant::now();
        while state(&child).0 != 'Z' {
            assert!(
                begun.elapsed() < HANGS,
                "{args:?} hangs after the second signal"
            );
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    let took_s = state(&child).1 - before_s;
    let code = child.wait().unwrap().code();
    drain.join().unwrap().unwrap();
    // A filter or a monitor that is stopped has done its work.
    assert!(
        code.is_none_or(|code| code == 130 || code == 0),
        "{args:?}: {code:?}"
    );
    (took_s, !ended)
}

#[test]
fn every_long_command_ends_by_a_signal() {
    let folder = Folder::new("signals");
    let crawl = gait("crawl.toml");
    let servo = format!("{}/../examples/servo", env!("CARGO_MANIFEST_DIR"));
    let (roll, turn) = (gait("roll.toml"), gait("turn.toml"));
    let set = [
        "sim", &crawl, &roll, &turn, "-d", "6s", "--camera", "--repeat", "2", "-o", "set",
    ];
    rb(&folder, &set).expect(0);
    let case = ["make-case", "none", "--gaits", "2", "-o", "./case"];
    trials(&folder, &case).expect("a case");
    let made = Command::new("mkfifo")
        .arg(folder.path("pipe"))
        .status()
        .unwrap();
    assert!(made.success());
    let emulator = Emulator::start(&folder);
    let uri = emulator.uri();
    // A robot that takes the connection and says nothing.
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let silent_uri = format!("tcp://{}", silent.local_addr().unwrap());
    let long: Vec<Vec<&str>> = vec![
        vec!["gait", "check", "pipe"],
        vec!["model", "check", "pipe"],
        vec!["-p", "sim:pipe", "info"],
        vec!["emulate", "robot", "--tcp", "127.0.0.1:0"],
        vec!["emulate", "motors", "--tcp", "127.0.0.1:0"],
        vec![
            "emulate", "films", &crawl, "-o", "@", "-d", "600s", "--repeat", "90",
        ],
        vec!["-p", &uri, "monitor", "--plain"],
        vec!["-p", &uri, "log", "--follow"],
        vec!["-p", "sim:", "bus", "bench", "-d", "24h"],
        vec!["-p", "sim:", "run", &crawl, "-d", "3600s"],
        vec!["-p", &silent_uri, "info", "--timeout", "300s"],
        vec!["sim", &crawl, "-d", "3600s", "--repeat", "500"],
        vec!["optimise", "gait", "-o", "@"],
        vec![
            "optimise",
            "model",
            "set",
            "-o",
            "@",
            "--training",
            "crawl,roll",
        ],
        vec!["gap", "report", &servo],
        vec!["gap", "predict", &servo, "-o", "@"],
        vec!["gap", "report", "case"],
        vec!["gap", "causes", "case"],
        vec!["-p", "sim:", "gap", "collect", "-o", "@", "--repeat", "60"],
        vec!["-p", "sim:", "hybrid", "-o", "@"],
        vec!["bench", "--alone", "--trials", "10000"],
    ];
    let mut rows = Vec::new();
    for (k, args) in long.iter().enumerate() {
        for (name, after_ms) in [("INT", 400), ("TERM", 700)] {
            let output = format!("out-{k}-{name}");
            let args: Vec<&str> = args
                .iter()
                .map(|a| if *a == "@" { &output } else { *a })
                .collect();
            let (took_s, said) = end(&folder, &args, name, Duration::from_millis(after_ms));
            rows.push((took_s, said, args.join(" ")));
        }
    }
    for (took_s, said, args) in &rows {
        println!(
            "{took_s:6.2} s of the processor  {}  {args}",
            if *said { "said" } else { "    " }
        );
    }
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as f64;
    for (took_s, _, args) in rows {
        assert!(took_s <= LONGEST_S * cores, "{args} took {took_s} s to end");
    }
}
