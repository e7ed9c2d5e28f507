//! Every command: help, exit codes, JSON, settings.

use std::io::{Read, Write};
use std::net::TcpListener;

use protocol::link::{FromModule, Header, MAX_FRAME, encode};

use crate::rig::{Emulator, Folder, command, finish, gait, rb};

const COMMANDS: [&str; 25] = [
    "list",
    "info",
    "doctor",
    "upload",
    "download",
    "slots",
    "run",
    "stop",
    "monitor",
    "log",
    "zero",
    "reset",
    "bus",
    "gait",
    "emulate",
    "rec",
    "sim",
    "optimise",
    "model",
    "gap",
    "bench",
    "completions",
    "man",
    "config",
    "version",
];

#[test]
fn every_command_has_help_and_stands_in_the_list() {
    let folder = Folder::new("help");
    let all = rb(&folder, &["--help"]).expect(0);
    for name in COMMANDS {
        let done = rb(&folder, &[name, "--help"]).expect(0);
        assert!(done.out.contains("Usage: rb-host"), "{name}: {}", done.out);
        assert!(
            all.out.contains(&format!("\n  {name} ")),
            "{name} is not in the list of commands"
        );
    }
}

#[test]
fn usage_errors_exit_2() {
    let folder = Folder::new("usage");
    for args in [
        &["nonsense"][..],
        &["run"],
        &["--port", "ftp://x", "info"],
        &["run", "g.toml", "-d", "soon"],
        &["run", "g.toml", "--rate", "50"],
        &["bus", "write", "1", "no such register", "1"],
        &["emulate", "robot", "--fault", "nothing"],
        &["-p", "sim:", "zero", "--joint", "6"],
    ] {
        let done = rb(&folder, args);
        let bus = args[0] == "bus";
        assert_eq!(done.code, 2, "{args:?}: {done:?}");
        assert!(!done.err.is_empty() || bus);
    }
}

#[test]
fn ports_that_cannot_be_opened_exit_4_with_a_hint() {
    let folder = Folder::new("ports");
    for port in ["/dev/does-not-exist", "tcp://127.0.0.1:1"] {
        let done = rb(&folder, &["-p", port, "info"]).expect(4);
        assert!(done.err.contains("hint:"), "{}", done.err);
    }
    let done = rb(&folder, &["-p", "/dev/does-not-exist", "info", "--json"]).expect(4);
    assert_eq!(done.json()["schema"], "rb.error/1");
    assert_eq!(done.json()["kind"], "port");
}

#[test]
fn a_silent_peer_exits_5() {
    let folder = Folder::new("silent");
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("tcp://{}", listener.local_addr().unwrap());
    let done = rb(&folder, &["-p", &port, "--timeout", "300ms", "info"]).expect(5);
    assert!(
        done.err.contains("no answer to HELLO within 300 ms"),
        "{}",
        done.err
    );
}

#[test]
fn another_protocol_version_exits_6_and_names_both() {
    let folder = Folder::new("version");
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("tcp://{}", listener.local_addr().unwrap());
    let peer = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut asked = [0; 64];
        let _ = stream.read(&mut asked).unwrap();
        let header = Header {
            version: 9,
            source: 7,
            sequence: 0,
            boot_id: 1,
        };
        let mut frame = [0; MAX_FRAME];
        let length = encode(&header, &FromModule::Ack { request: 0 }, &mut frame).unwrap();
        stream.write_all(&frame[..length]).unwrap();
        // Held open until rb-host has closed its end.
        while stream.read(&mut asked).is_ok_and(|n| n > 0) {}
    });
    let done = rb(&folder, &["-p", &port, "info"]).expect(6);
    assert!(
        done.err
            .contains("speaks protocol 9, this rb-host speaks protocol 1"),
        "{}",
        done.err
    );
    peer.join().unwrap();
}

#[test]
fn without_a_robot_the_emulated_one_is_used_and_said() {
    let folder = Folder::new("default");
    let done = rb(&folder, &["info"]);
    // A machine with a robot attached would use it.
    if done.err.contains("EMULATED") {
        assert_eq!(done.code, 0, "{done:?}");
        assert!(done.out.contains("on sim:"), "{}", done.out);
    }
    let done = rb(&folder, &["-p", "sim:", "info"]).expect(0);
    assert!(done.err.is_empty(), "{}", done.err);
}

#[test]
fn flag_beats_variable_beats_ports_file_beats_project_file_beats_default() {
    let folder = Folder::new("settings");
    let show = |args: &[&str], variable: Option<&str>| {
        let mut line = command(&folder, &[args, &["config", "show", "--json"]].concat());
        if let Some(value) = variable {
            line.env("RB_PORT", value);
        }
        let setting = finish(line.output().unwrap()).expect(0).json()["settings"]["port"].clone();
        (
            setting["value"].as_str().unwrap().to_owned(),
            setting["origin"].as_str().unwrap().to_owned(),
        )
    };
    assert_eq!(show(&[], None), (String::new(), "default".into()));
    folder.write("rb.toml", "format = 1\nport = \"tcp://project:1\"\n");
    assert_eq!(show(&[], None).0, "tcp://project:1");
    folder.write("rb_ports.toml", "port = \"tcp://ports:1\"\n");
    assert!(show(&[], None).1.ends_with("rb_ports.toml"));
    assert_eq!(
        show(&[], Some("tcp://var:1")),
        ("tcp://var:1".into(), "environment variable RB_PORT".into())
    );
    assert_eq!(
        show(&["-p", "sim:"], Some("tcp://var:1")),
        ("sim:".into(), "command line".into())
    );
}

#[test]
fn bad_settings_files_name_file_line_and_key() {
    let folder = Folder::new("bad-settings");
    for (text, words) in [
        ("format = 1\nspeed = 3\n", "rb.toml:2: unknown key"),
        ("format = 1\nbaud = 12\n", "300 to 4000000"),
        ("format = 1\nbaud = 0x10\n", "must be text or a number"),
        ("format = 1\ntimeout = \"1ms\"\n", "at least 10ms"),
        ("port = [\n", "not valid TOML"),
        ("format = 2\n", "known: format = 1"),
    ] {
        folder.write("rb.toml", text);
        let done = rb(&folder, &["version"]).expect(3);
        assert!(done.err.contains(words), "{text}: {}", done.err);
    }
}

#[test]
fn bad_scenarios_exit_3() {
    let folder = Folder::new("bad-scenario");
    folder.write("s.toml", "format = 1\nnonsense = 3\n");
    let done = rb(&folder, &["-p", "sim:s.toml", "info"]).expect(3);
    assert!(done.err.contains("s.toml:2"), "{}", done.err);
    rb(&folder, &["-p", "sim:absent.toml", "info"]).expect(3);
}

#[test]
fn service_commands_over_tcp() {
    let folder = Folder::new("service");
    let robot = Emulator::start(&folder);
    let uri = robot.uri();
    let on = |args: &[&str]| rb(&folder, &[&["-p", &uri], args].concat());
    assert_eq!(on(&["info", "--json"]).expect(0).json()["state"], "unhomed");
    // Not homed: refused, with what to do.
    let done = on(&["run", &gait("crawl.toml"), "-d", "1s"]).expect(7);
    assert!(done.err.contains("rb-host zero"), "{}", done.err);
    // Without a terminal the question needs --yes.
    on(&["zero"]).expect(2);
    assert_eq!(
        on(&["zero", "--yes", "--json"]).expect(0).json()["state"],
        "idle"
    );
    let stored = on(&[
        "upload",
        &gait("turn.toml"),
        "-s",
        "3",
        "--activate",
        "--json",
    ])
    .expect(0)
    .json();
    assert_eq!(
        (stored["slot"].as_u64(), stored["active"].as_bool()),
        (Some(3), Some(true))
    );
    // Download gives the same gait, bit for bit.
    on(&["download", "-o", "back.toml"]).expect(0);
    rb(&folder, &["gait", "diff", "back.toml", &gait("turn.toml")]).expect(0);
    rb(&folder, &["gait", "diff", "back.toml", &gait("crawl.toml")]).expect(8);
    on(&["download", "-o", "back.toml"]).expect(2);
    on(&["slots", "erase", "3"]).expect(7);
    on(&["slots", "activate", "5"]).expect(7);
    assert!(on(&["slots"]).expect(0).out.contains("* 3  turn"));
    assert_eq!(
        on(&["bus", "scan", "--json"]).expect(0).json()["drivers"]
            .as_array()
            .unwrap()
            .len(),
        6
    );
    assert!(
        on(&["bus", "read", "2", "model-number"])
            .expect(0)
            .out
            .contains("16978")
    );
    on(&["bus", "ping", "77"]).expect(5);
    on(&["bus", "bench", "-d", "200ms"]).expect(0);
    on(&["doctor"]).expect(0);
    assert!(on(&["log"]).expect(0).out.contains("gait_stored"));
    assert!(
        on(&["monitor", "-d", "300ms", "--json"])
            .expect(0)
            .out
            .contains("rb.sample/1")
    );
    assert!(on(&["stop"]).expect(0).out.contains("acknowledged"));
    keys_guard_orders(&folder, &uri);
}

/// A key set over the wire is needed from then on; another host has none.
fn keys_guard_orders(folder: &Folder, uri: &str) {
    rb(folder, &["-p", uri, "reset", "--fault"]);
    rb(folder, &["-p", uri, "config", "key", "set"]).expect(0);
    rb(folder, &["-p", uri, "upload", &gait("roll.toml")]).expect(0);
    let stranger = Folder::new("stranger");
    let done = rb(&stranger, &["-p", uri, "upload", &gait("roll.toml")]).expect(7);
    assert!(done.err.contains("key"), "{}", done.err);
    // STOP needs no key; with it the robot proves that it was the one that stopped.
    let done = rb(&stranger, &["-p", uri, "stop"]).expect(0);
    assert!(done.out.contains("not authenticated"), "{}", done.out);
    let done = rb(folder, &["-p", uri, "stop", "--json"]).expect(0).json();
    assert_eq!(done["proved"], true, "{done}");
}

#[cfg(unix)]
#[test]
fn ctrl_c_stops_the_robot_and_says_so() {
    let folder = Folder::new("ctrl-c");
    let robot = Emulator::start(&folder);
    rb(&folder, &["-p", &robot.uri(), "zero", "--yes"]).expect(0);
    let (uri, file) = (robot.uri(), gait("crawl.toml"));
    let mut line = command(
        &folder,
        &[
            "-p", &uri, "-v", "run", &file, "-d", "60s", "-r", "cut.mcap",
        ],
    );
    let mut child = line
        .stderr(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    // The run has begun when its event is reported.
    let mut said = String::new();
    let mut reader = std::io::BufReader::new(child.stderr.take().unwrap());
    while !said.contains("run_started") {
        assert!(
            std::io::BufRead::read_line(&mut reader, &mut said).unwrap() > 0,
            "{said}"
        );
    }
    std::process::Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .unwrap();
    reader.read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
    assert!(said.contains("robot stopped (STOP acknowledged)"), "{said}");
    // What takes longer than a moment says why.
    assert!(said.contains("waiting at most 6 s for that"), "{said}");
    let check = rb(&folder, &["rec", "info", "cut.mcap", "--json"])
        .expect(0)
        .json();
    assert_eq!(check["runs"][0]["end"]["reason"], "stopped");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_told_and_the_robot_stopped() {
    let folder = Folder::new("full");
    let done = rb(
        &folder,
        &[
            "-p",
            "sim:",
            "run",
            &gait("crawl.toml"),
            "-d",
            "5s",
            "-r",
            "/dev/full",
            "--force",
        ],
    )
    .expect(1);
    assert!(done.err.contains("cannot write /dev/full"), "{}", done.err);
}

#[test]
fn bench_measures_every_level_of_this_processor() {
    let folder = Folder::new("bench");
    let args = ["bench", "--trials", "2", "--json"];
    let done = rb(&folder, &[&args[..], &["--alone"]].concat()).expect(0);
    let value = done.json();
    let tables = value["tables"].as_array().unwrap();
    assert_eq!(tables.len(), 2);
    for table in tables {
        let rows = table["rows"].as_array().unwrap();
        assert!(rows.len() >= 2, "{rows:?}");
        for row in rows {
            assert!(row["simulated_s_per_s"].as_f64().unwrap() > 1.0, "{row}");
            let tracking_rad = row["tracking_rms_rad"].as_f64().unwrap();
            assert!((0.05..0.2).contains(&tracking_rad), "{row}");
            assert!(row["penetration_worst_mm"].as_f64().unwrap() < 5.0, "{row}");
            assert!(row["ratio_to_mujoco"].is_null());
        }
    }
    let shares = value["profile"].as_array().unwrap();
    let sum: f64 = shares.iter().map(|s| s["share"].as_f64().unwrap()).sum();
    assert!((sum - 1.0).abs() < 1e-9, "{sum}");
    assert_eq!(shares.len(), 8);
}
