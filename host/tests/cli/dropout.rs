//! A Bluetooth link that stalls and breaks in mid-run, played by a proxy in front of the emulated robot.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use crate::rig::{Emulator, Folder, gait, rb};

const OPEN: u8 = 0;
const STALLED: u8 = 1;
const BROKEN: u8 = 2;

/// Copies bytes while the proxy is open; holds them while it is stalled; ends when it breaks.
fn copy(mut from: TcpStream, mut to: TcpStream, state: &AtomicU8) {
    from.set_read_timeout(Some(Duration::from_millis(20)))
        .unwrap();
    let mut buffer = [0; 512];
    let mut held = Vec::new();
    loop {
        match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => held.extend_from_slice(&buffer[..n]),
            Err(e)
                if matches!(
                    e.kind(),
                    std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut
                ) => {}
            Err(_) => break,
        }
        match state.load(Ordering::SeqCst) {
            OPEN => {
                if to.write_all(&held).is_err() {
                    break;
                }
                held.clear();
            }
            STALLED => {}
            _ => break,
        }
    }
    let _ = from.shutdown(Shutdown::Both);
    let _ = to.shutdown(Shutdown::Both);
}

/// Listens in front of `target`; refuses to forward while broken.
fn proxy(target: String, state: Arc<AtomicU8>, connections: Arc<AtomicU32>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for client in listener.incoming().map_while(Result::ok) {
            if state.load(Ordering::SeqCst) == BROKEN {
                continue;
            }
            let Ok(server) = TcpStream::connect(&target) else {
                continue;
            };
            connections.fetch_add(1, Ordering::SeqCst);
            let halves = [
                (client.try_clone(), server.try_clone()),
                (Ok(server), Ok(client)),
            ];
            for (from, to) in halves {
                let state = Arc::clone(&state);
                let (from, to) = (from.unwrap(), to.unwrap());
                std::thread::spawn(move || copy(from, to, &state));
            }
        }
    });
    address
}

#[test]
fn a_run_survives_a_stalled_and_a_broken_link_and_is_recorded_whole() {
    let folder = Folder::new("dropout");
    let robot = Emulator::start(&folder);
    rb(&folder, &["-p", &robot.uri(), "zero", "--yes"]).expect(0);
    let (state, connections) = (Arc::new(AtomicU8::new(OPEN)), Arc::new(AtomicU32::new(0)));
    let address = proxy(
        robot.address.clone(),
        Arc::clone(&state),
        Arc::clone(&connections),
    );
    let weather = Arc::clone(&state);
    let storm = std::thread::spawn(move || {
        let begin = Instant::now();
        for (at_ms, next) in [(3000, STALLED), (4500, OPEN), (6000, BROKEN), (8500, OPEN)] {
            std::thread::sleep(Duration::from_millis(at_ms).saturating_sub(begin.elapsed()));
            weather.store(next, Ordering::SeqCst);
        }
    });
    let port = format!("tcp://{address}");
    let done = rb(
        &folder,
        &[
            "-p",
            &port,
            "run",
            &gait("crawl.toml"),
            "-d",
            "10s",
            "--autonomous",
            "-r",
            "run.mcap",
            "--json",
        ],
    );
    storm.join().unwrap();
    let report = done.expect(0).json();
    let run = &report["runs"][0];
    assert_eq!(run["reason"], "completed", "{report}");
    assert!(run["reconnects"].as_u64() >= Some(1), "{report}");
    assert!(connections.load(Ordering::SeqCst) >= 2);
    // Everything that happened meanwhile was drained.
    assert_eq!(run["lost_on_link"], 0, "{report}");
    assert_eq!(run["recorded"], run["samples"], "{report}");
    rb(&folder, &["rec", "check", "run.mcap"]).expect(0);
    let events = rb(&folder, &["rec", "cat", "run.mcap", "--events"])
        .expect(0)
        .out;
    assert!(
        events.contains("link_lost") && events.contains("link_back"),
        "{events}"
    );
}
