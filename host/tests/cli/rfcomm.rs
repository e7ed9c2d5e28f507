//! A Bluetooth serial port as the operating system shows it: a terminal that loses bytes, vanishes in mid-run and comes back under its old name.
//!
//! A pseudo-terminal stands for `/dev/rfcomm0`; a thread carries its bytes to the emulated robot.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use hil_sim::endpoint::{Endpoint, Pty};

use crate::rig::{Emulator, Folder, gait, rb};

const OPEN: u8 = 0;
const LOSSY: u8 = 1;
const GONE: u8 = 2;
const END: u8 = 3;

/// Longest wait for bytes in one direction.
const SLICE: Duration = Duration::from_millis(2);

struct Radio {
    state: Arc<AtomicU8>,
    sessions: Arc<AtomicU32>,
    device: PathBuf,
}

impl Radio {
    fn start(folder: &Folder, robot: String) -> Self {
        let radio = Self {
            state: Arc::new(AtomicU8::new(OPEN)),
            sessions: Arc::new(AtomicU32::new(0)),
            device: folder.path("rfcomm0"),
        };
        let (state, sessions) = (Arc::clone(&radio.state), Arc::clone(&radio.sessions));
        let device = radio.device.clone();
        std::thread::spawn(move || {
            while state.load(Ordering::SeqCst) != END {
                if state.load(Ordering::SeqCst) == GONE {
                    std::thread::sleep(SLICE);
                    continue;
                }
                let mut pty = Pty::open(Some(&device)).unwrap();
                let tcp = TcpStream::connect(&robot).unwrap();
                sessions.fetch_add(1, Ordering::SeqCst);
                carry(&mut pty, tcp, &state);
            }
        });
        while !radio.device.exists() {
            std::thread::sleep(SLICE);
        }
        radio
    }

    /// What happens to the radio, at times after now.
    fn weather(&self, course: &'static [(u64, u8)]) -> std::thread::JoinHandle<()> {
        let state = Arc::clone(&self.state);
        std::thread::spawn(move || {
            let begin = Instant::now();
            for (at_ms, next) in course {
                let at = Duration::from_millis(*at_ms);
                std::thread::sleep(at.saturating_sub(begin.elapsed()));
                state.store(*next, Ordering::SeqCst);
            }
        })
    }
}

impl Drop for Radio {
    fn drop(&mut self) {
        self.state.store(END, Ordering::SeqCst);
    }
}

/// Carries bytes both ways until the radio is gone; while it is lossy, one part in 31 (about 25 bytes) is lost.
fn carry(pty: &mut Pty, mut tcp: TcpStream, state: &AtomicU8) {
    tcp.set_read_timeout(Some(SLICE)).unwrap();
    let (mut buffer, mut parts) = ([0; 256], 0_u32);
    let mut passes = |state: u8| {
        parts += 1;
        state != LOSSY || !parts.is_multiple_of(31)
    };
    loop {
        let now = state.load(Ordering::SeqCst);
        if now == GONE || now == END {
            return;
        }
        let count = pty.read(&mut buffer, SLICE).unwrap();
        if count > 0 && passes(now) {
            tcp.write_all(&buffer[..count]).unwrap();
        }
        match tcp.read(&mut buffer) {
            Ok(0) => return,
            Ok(count) if passes(now) => pty.write(&buffer[..count]).unwrap(),
            Ok(_) | Err(_) => {}
        }
    }
}

#[test]
fn a_run_over_a_bluetooth_port_survives_losses_and_a_port_that_vanishes() {
    let folder = Folder::new("rfcomm");
    let robot = Emulator::start(&folder);
    rb(&folder, &["-p", &robot.uri(), "zero", "--yes"]).expect(0);
    let radio = Radio::start(&folder, robot.address.clone());
    let port = radio.device.display().to_string();
    // Questions and an upload get through a lossy radio: they are sent again.
    radio.state.store(LOSSY, Ordering::SeqCst);
    for _ in 0..3 {
        rb(&folder, &["-p", &port, "info"]).expect(0);
    }
    rb(&folder, &["-p", &port, "upload", &gait("roll.toml")]).expect(0);
    radio.state.store(OPEN, Ordering::SeqCst);

    let storm = radio.weather(&[(3000, LOSSY), (4500, OPEN), (6000, GONE), (8500, OPEN)]);
    let file = gait("crawl.toml");
    let args = [
        "-p",
        &port,
        "run",
        &file,
        "-d",
        "10s",
        "--autonomous",
        "-r",
        "run.mcap",
        "--json",
    ];
    let report = rb(&folder, &args).expect(0).json();
    storm.join().unwrap();
    let run = &report["runs"][0];
    assert_eq!(run["reason"], "completed", "{report}");
    assert!(run["reconnects"].as_u64() >= Some(1), "{report}");
    assert!(radio.sessions.load(Ordering::SeqCst) >= 2);
    assert_eq!(run["lost_on_link"], 0, "{report}");
    assert_eq!(run["recorded"], run["samples"], "{report}");
    rb(&folder, &["rec", "check", "run.mcap"]).expect(0);

    // A tethered run ends with the radio, and the record of what was is whole.
    let storm = radio.weather(&[(4000, GONE), (9000, OPEN)]);
    let args = [
        "-p",
        &port,
        "run",
        &file,
        "-d",
        "60s",
        "-r",
        "tethered.mcap",
        "--json",
    ];
    let done = rb(&folder, &args).expect(7);
    storm.join().unwrap();
    let line = done.out.lines().find(|line| line.contains("rb.run/1"));
    let report: serde_json::Value = serde_json::from_str(line.unwrap()).unwrap();
    let run = &report["runs"][0];
    assert_eq!(run["reason"], "host_lost", "{report}");
    assert_eq!(run["recorded"], run["samples"], "{report}");
    assert!(done.err.contains("--autonomous"), "{}", done.err);
    rb(&folder, &["rec", "check", "tethered.mcap"]).expect(0);
}
