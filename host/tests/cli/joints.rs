//! Robots of one to twelve motors from `robot.toml`, through every command that a user of one needs.

use std::process::Stdio;
use std::time::Duration;

use crate::rig::{Emulator, Folder, command, finish, rb};

/// A robot of so many half-spheres in a row, each on the one before it.
fn robot_toml(motors: usize, more: &str) -> String {
    let mut text =
        format!("format = 1\nname = \"row\"\n{more}\n[bus]\ndriver = \"packed\"\n\n[[body]]\n");
    for joint in 0..motors {
        text.push_str(&format!(
            "\n[[body]]\nparent = {joint}\noffset_m = [0.11, 0, 0]\naxis = [1, 0, 0]\njoint = {joint}\nmotor = \"inter\"\n"
        ));
    }
    for (body, side) in [(0, -1), (motors.min(1), 1)] {
        text.push_str(&format!(
            "\n[[half]]\nbody = {body}\ncentre_m = [0, 0, 0]\nfaces = [[{side}, 0, 0], [0, {side}, 0], [0, 0, {side}]]\n"
        ));
    }
    text + "\n[[cube]]\nhalves = [0, 1]\n"
}

const UNCHECKED: &str = "self_collision = \"unchecked\"";

fn gait_toml(oscillators: usize) -> String {
    let lags = vec!["40"; oscillators - 1].join(", ");
    let mut text = format!(
        "format = 1\nname = \"wave\"\nfrequency_hz = 0.5\nduration_s = 2\nrate_a_per_s = 4.0\ncoupling = \"chain\"\nweight = 0.5\nphase_lag_deg = [{lags}]\n"
    );
    for _ in 0..oscillators {
        text.push_str("[[oscillator]]\namplitude_deg = 15\noffset_deg = 0\n");
    }
    text
}

/// Largest less smallest of a column of numbers.
fn travel(csv: &str, column: &str) -> f64 {
    let mut lines = csv.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let at = header.iter().position(|name| *name == column);
    let at = at.unwrap_or_else(|| panic!("no column {column}"));
    let cells: Vec<f64> = lines
        .filter_map(|line| line.split(',').nth(at)?.parse().ok())
        .collect();
    let fold = |pick: fn(f64, f64) -> f64| cells.iter().copied().reduce(pick).unwrap();
    fold(f64::max) - fold(f64::min)
}

#[test]
fn robots_of_one_two_six_and_twelve_motors_are_told_zeroed_run_recorded_and_stopped() {
    for motors in [1, 2, 6, 12] {
        let folder = Folder::new(&format!("joints-{motors}"));
        folder.write("robot.toml", robot_toml(motors, UNCHECKED));
        folder.write("wave.toml", gait_toml(motors));
        let robot = Emulator::start_with(&folder, &["--robot", "robot.toml"]);
        let uri = robot.uri();
        let on = |args: &[&str]| rb(&folder, &[&["-p", &uri], args].concat());

        let scan = on(&["bus", "scan", "--json"]).expect(0).json();
        assert_eq!(scan["drivers"].as_array().unwrap().len(), motors);
        let told = on(&["bus", "use", "robot.toml", "--json"]).expect(0).json();
        assert_eq!(
            (&told["joints"], &told["contact"], &told["motor_mask"]),
            (
                &motors.into(),
                &"unchecked".into(),
                &((1 << motors) - 1).into()
            )
        );
        on(&["upload", "wave.toml"]).expect(0);
        let zero = on(&["zero", "--yes", "--json"]).expect(0).json();
        assert_eq!(zero["state"], "idle");
        let done = on(&["run", "wave.toml", "--record", "wave.mcap", "--json"]).expect(0);
        assert_eq!(done.json()["runs"][0]["reason"], "completed");

        rb(&folder, &["rec", "check", "wave.mcap"]).expect(0);
        rb(
            &folder,
            &[
                "rec",
                "convert",
                "wave.mcap",
                "--to",
                "csv",
                "-o",
                "wave.csv",
            ],
        )
        .expect(0);
        let csv = std::fs::read_to_string(folder.path("wave.csv")).unwrap();
        for joint in 0..motors {
            let [set, stood] = ["setpoint_rad", "position_rad"]
                .map(|name| travel(&csv, &format!("{name}_{joint}")));
            assert!(
                set > 0.4 && stood > 0.3,
                "joint {joint} of {motors}: {set} {stood}"
            );
        }
        assert!(
            !csv.lines()
                .next()
                .unwrap()
                .contains(&format!("position_rad_{motors}"))
        );
        rb(&folder, &["rec", "plot", "wave.mcap", "-o", "wave.svg"]).expect(0);

        let run = command(&folder, &["-p", &uri, "run", "wave.toml", "-d", "30s"])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_secs(3));
        let id = run.id().to_string();
        std::process::Command::new("kill")
            .args(["-INT", &id])
            .status()
            .unwrap();
        let done = finish(run.wait_with_output().unwrap()).expect(130);
        assert!(done.err.contains("STOP acknowledged"), "{}", done.err);
    }
}

#[test]
fn a_gait_of_another_size_and_robots_that_cannot_be_are_refused() {
    let folder = Folder::new("joints-refused");
    folder.write("four.toml", gait_toml(4));
    let done = rb(&folder, &["-p", "sim:", "run", "four.toml"]).expect(7);
    let words = "the gait has 4 oscillators, the robot 6 joints";
    assert!(done.err.contains(words), "{}", done.err);
    let done = rb(
        &folder,
        &["-p", "sim:", "run", "four.toml", "--skip-host-check"],
    )
    .expect(7);
    assert!(done.err.contains("4 oscillators"), "{}", done.err);
    for (motors, words) in [
        (0, "bad.toml:1: 0 motors, allowed are 1 to 12"),
        (13, "bad.toml:1: 13 motors, allowed are 1 to 12"),
    ] {
        folder.write("bad.toml", robot_toml(motors, UNCHECKED));
        for args in [
            &["-p", "sim:", "bus", "use", "bad.toml"][..],
            &["-p", "sim:bad.toml", "info"],
            &["emulate", "robot", "--robot", "bad.toml"],
        ] {
            let done = rb(&folder, args);
            assert!(
                done.code != 0 && done.err.contains(words),
                "{args:?}: {}",
                done.err
            );
        }
    }
    folder.write("bad.toml", robot_toml(2, "self_collision = \"off\""));
    let done = rb(&folder, &["-p", "sim:", "bus", "use", "bad.toml"]).expect(3);
    assert!(
        done.err.contains("bad.toml:3: ") && done.err.contains("unchecked"),
        "{}",
        done.err
    );
}

#[test]
fn a_robot_that_nobody_checks_does_not_run_until_its_file_says_so() {
    let folder = Folder::new("joints-unstated");
    folder.write("robot.toml", robot_toml(2, ""));
    folder.write("wave.toml", gait_toml(2));
    let run = ["-p", "sim:robot.toml", "run", "wave.toml"];
    let done = rb(&folder, &run).expect(7);
    assert!(
        done.err.contains("write `self_collision = \"unchecked\"`"),
        "{}",
        done.err
    );
    folder.write("robot.toml", robot_toml(2, UNCHECKED));
    rb(&folder, &run).expect(0);
}

#[test]
fn the_robots_that_come_along_are_checked_where_they_can_be() {
    let folder = Folder::new("joints-shipped");
    for (name, joints, contact) in [
        ("metamodule", 6, "metamodule"),
        ("module", 3, "module"),
        ("quadruped", 12, "unstated"),
    ] {
        let path = format!("{}/../robots/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(path).unwrap();
        // No word of a user takes the check away.
        let said = if name == "metamodule" { UNCHECKED } else { "" };
        let bus = format!("{said}\n[bus]\ndriver = \"packed\"\n\n[[body]]");
        folder.write("robot.toml", text.replacen("[[body]]", &bus, 1));
        let told = rb(
            &folder,
            &["-p", "sim:robot.toml", "bus", "use", "robot.toml", "--json"],
        )
        .expect(0)
        .json();
        assert_eq!(
            (&told["joints"], &told["contact"]),
            (&joints.into(), &contact.into())
        );
    }
}
