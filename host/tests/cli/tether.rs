//! What a robot does when its host dies, and whom the host believes that it stopped.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use protocol::link::{
    Decoder, FromModule, Header, Hello, MAX_FRAME, ModuleState, Tag, ToModule, VERSION, encode,
};

use crate::rig::{Emulator, Folder, command, finish, gait, rb, skip};

fn state(folder: &Folder, uri: &str) -> String {
    let info = rb(folder, &["-p", uri, "info", "--json"]).expect(0).json();
    info["state"].as_str().unwrap().to_owned()
}

/// A run that has begun.
fn begun(folder: &Folder, uri: &str, more: &[&str]) -> Child {
    let file = gait("crawl.toml");
    let mut args = vec!["-p", uri, "-v", "run", &file];
    args.extend(more);
    let mut child = command(folder, &args)
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut said = String::new();
    let mut reader = BufReader::new(child.stderr.take().unwrap());
    while !said.contains("run_started") {
        assert!(reader.read_line(&mut said).unwrap() > 0, "{said}");
    }
    std::thread::spawn(move || std::io::copy(&mut reader, &mut std::io::sink()));
    child
}

/// A robot tells the next host of the run whose host was killed. That one took it for its own, and left the robot running.
#[test]
fn a_run_is_not_over_because_the_one_before_it_is() {
    let folder = Folder::new("the-one-before");
    let robot = Emulator::start(&folder);
    let uri = robot.uri();
    rb(&folder, &["-p", &uri, "zero", "--yes"]).expect(0);
    let mut child = begun(&folder, &uri, &["--autonomous", "-d", "2s"]);
    child.kill().unwrap();
    child.wait().unwrap();
    // Without a question: the first host that comes is told. Ramp and hold take three seconds.
    std::thread::sleep(Duration::from_secs(7));
    let args = ["-p", &uri, "run", &gait("crawl.toml"), "-d", "3s", "--json"];
    let report = rb(&folder, &args).expect(0).json();
    let run = &report["runs"][0];
    assert_eq!(run["cycles"], 60, "{report}");
    assert_eq!(run["recorded"], run["samples"], "{report}");
}

#[cfg(unix)]
#[test]
fn a_robot_stops_when_its_host_is_killed_unless_it_is_autonomous() {
    let folder = Folder::new("tether");
    let robot = Emulator::start(&folder);
    let uri = robot.uri();
    rb(&folder, &["-p", &uri, "zero", "--yes"]).expect(0);

    let mut child = begun(&folder, &uri, &["-d", "10m"]);
    child.kill().unwrap();
    child.wait().unwrap();
    // Nobody sends anything but questions, and those renew no lease: it comes to rest long before its ten minutes are over.
    let mut asked = 0;
    while state(&folder, &uri) != "idle" {
        asked += 1;
        assert!(asked < 3000, "the robot runs on");
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    let log = rb(&folder, &["-p", &uri, "log"]).expect(0).out;
    assert!(log.contains("host_lost"), "{log}");

    let mut child = begun(&folder, &uri, &["--autonomous", "-d", "10m"]);
    child.kill().unwrap();
    child.wait().unwrap();
    std::thread::sleep(std::time::Duration::from_secs(3));
    assert_eq!(state(&folder, &uri), "run", "it needs no host");
    rb(&folder, &["-p", &uri, "stop"]).expect(0);
}

/// `tests/foreign/link_client.py` was written from the page of the two wires, not from our code.
#[test]
fn a_client_written_from_the_page_alone_runs_the_robot() {
    let name = "a_client_written_from_the_page_alone_runs_the_robot";
    if let Err(why) = Command::new("python3").arg("--version").output() {
        return skip(name, &format!("python3: {why}"));
    }
    let folder = Folder::new("page-client");
    let robot = Emulator::start(&folder);
    let client = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../tests/foreign/link_client.py"
    );
    let mut command = Command::new("python3");
    let done = finish(command.args([client, &robot.address]).output().unwrap()).expect(0);
    assert!(done.out.contains("ALL CHECKS PASSED"), "{}", done.out);
}

/// Answers HELLO and STOP of one client as the robot with this id would, without its key.
fn liar(robot_id: u8, keyed: bool) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut decoder = Decoder::new();
        let mut buffer = [0; 512];
        while let Ok(count @ 1..) = stream.read(&mut buffer) {
            for byte in &buffer[..count] {
                let Some(frame) = decoder.push(*byte) else {
                    continue;
                };
                let (sequence, request) = (frame.header.sequence, frame.kind());
                let answer = match frame.decode::<ToModule>() {
                    Ok(ToModule::Hello { .. }) => FromModule::Hello(Hello {
                        protocol: VERSION,
                        robot_id,
                        boot_id: 77,
                        firmware: "rb-firmware".try_into().unwrap(),
                        model_digest: protocol::link::Digest::default(),
                        keyed,
                    }),
                    Ok(ToModule::ProveState { .. }) => FromModule::State {
                        state: ModuleState::Idle,
                        uptime_us: 1,
                        tag: Tag([0x5A; 16]),
                    },
                    _ => FromModule::Ack { request },
                };
                let header = Header {
                    version: VERSION,
                    source: robot_id,
                    sequence,
                    boot_id: 77,
                };
                let mut out = [0; MAX_FRAME];
                let len = encode(&header, &answer, &mut out).unwrap();
                stream.write_all(&out[..len]).unwrap();
            }
        }
    });
    format!("tcp://{address}")
}

#[test]
fn stop_believes_an_acknowledgement_only_with_the_proof_of_the_key() {
    let folder = Folder::new("liar");
    let robot = Emulator::start(&folder);
    rb(&folder, &["-p", &robot.uri(), "config", "key", "set"]).expect(0);
    let info = rb(&folder, &["-p", &robot.uri(), "info", "--json"])
        .expect(0)
        .json();
    let robot_id = u8::try_from(info["robot_id"].as_u64().unwrap()).unwrap();
    // Also one that says it had no key.
    for keyed in [true, false] {
        let done = rb(&folder, &["-p", &liar(robot_id, keyed), "stop"]).expect(5);
        assert!(done.err.contains("may be forged"), "{}", done.err);
    }
    let stranger = Folder::new("liar-stranger");
    let done = rb(&stranger, &["-p", &liar(robot_id, true), "stop"]).expect(0);
    assert!(done.out.contains("not authenticated"), "{}", done.out);
}
