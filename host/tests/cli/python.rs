//! The recording read back by the format's own Python readers, checksums included.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::rig::{Folder, gait, rb};

const SCRIPT: &str = r#"
import sys
from mcap.reader import NonSeekingReader, SeekingReader
from mcap_ros2.decoder import DecoderFactory
path = sys.argv[1]
counts = {}
for make in (lambda f: SeekingReader(f, validate_crcs=True, decoder_factories=[DecoderFactory()]),
             lambda f: NonSeekingReader(f, validate_crcs=True, decoder_factories=[DecoderFactory()])):
    counts = {}
    last = {}
    with open(path, "rb") as f:
        reader = make(f)
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            last[channel.topic] = decoded
            assert schema.encoding == "ros2msg" and channel.message_encoding == "cdr"
    joints = last["/joint_states"]
    assert list(joints.name) == ["A.M0", "A.M1", "A.M2", "B.M0", "B.M1", "B.M2"], joints.name
    assert len(joints.position) == 6 and len(joints.velocity) == 6 and len(joints.effort) == 0
    motors = last["/rb/motors"]
    assert len(motors.setpoint_rad) == 6 and len(motors.status) == 6 and motors.t_us > 0
    assert list(motors.position_rad) == list(joints.position)
with open(path, "rb") as f:
    reader = SeekingReader(f, validate_crcs=True)
    assert reader.get_header().profile == "ros2"
    names = [a.name for a in reader.iter_attachments()]
    assert "gait.toml" in names, names
    events = [m.metadata.get("event") for m in reader.iter_metadata() if m.name == "rb.run"]
    assert "start" in events and "end" in events, events
print(counts["/joint_states"], counts["/rb/motors"], counts["/rb/cpg"], counts["/rb/events"])
"#;

/// A Python with the readers in `target/venv`, made on first use; `None` when it cannot be had.
fn python() -> Option<PathBuf> {
    let venv = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .parent()?
        .join("venv");
    let python = venv.join("bin/python");
    let works = |python: &Path| {
        let check = Command::new(python)
            .args(["-c", "import mcap, mcap_ros2"])
            .output();
        check.is_ok_and(|o| o.status.success())
    };
    if works(&python) {
        return Some(python);
    }
    let ran = |command: &mut Command| command.output().is_ok_and(|o| o.status.success());
    let made = ran(Command::new("python3").args(["-m", "venv"]).arg(&venv))
        && ran(Command::new(&python).args([
            "-m",
            "pip",
            "install",
            "-q",
            "mcap",
            "mcap-ros2-support",
        ]));
    (made && works(&python)).then_some(python)
}

#[test]
fn python_readers_accept_the_recording_with_its_checksums() {
    let Some(python) = python() else {
        assert_ne!(
            std::env::var("CI").as_deref(),
            Ok("true"),
            "in CI the Python readers must be installable"
        );
        eprintln!(
            "SKIPPED: no Python with mcap and mcap-ros2-support; the recording was not read back by foreign readers"
        );
        return;
    };
    let folder = Folder::new("python");
    rb(
        &folder,
        &[
            "-p",
            "sim:",
            "run",
            &gait("sidewind.toml"),
            "-d",
            "5s",
            "-r",
            "p.mcap",
        ],
    )
    .expect(0);
    let script = folder.write("read.py", SCRIPT);
    let output = Command::new(python)
        .arg(script)
        .arg(folder.path("p.mcap"))
        .output()
        .unwrap();
    let (out, err) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert!(output.status.success(), "{err}");
    let counts: Vec<u32> = out.split_whitespace().map(|n| n.parse().unwrap()).collect();
    let [joints, motors, cpg, events] = counts[..] else {
        panic!("{out}")
    };
    assert!(
        joints == motors && motors > 100 && cpg == 100 && events > 3,
        "{out}"
    );
}
