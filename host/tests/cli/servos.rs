//! A robot on off-the-shelf servos: the scan proposes their kind, the robot is told, and a mixed bus is refused.

use crate::rig::{Emulator, Folder, rb};

/// A structure file that names its drivers.
fn robot_file(folder: &Folder, name: &str, driver: &str) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/metamodule.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let bus = format!("[bus]\ndriver = \"{driver}\"\n\n[[body]]");
    folder.write(name, text.replacen("[[body]]", &bus, 1));
}

#[test]
fn the_scan_proposes_the_kind_and_the_robot_takes_it_from_its_file() {
    for kind in ["packed", "xl330", "sts"] {
        let folder = Folder::new(&format!("servos-{kind}"));
        let robot = Emulator::start_with(&folder, &["--drivers", kind]);
        let uri = robot.uri();
        let on = |args: &[&str]| rb(&folder, &[&["-p", &uri], args].concat());
        let scan = on(&["bus", "scan", "--json"]).expect(0).json();
        assert_eq!(scan["drivers"].as_array().unwrap().len(), 6);
        assert_eq!(scan["driver"], kind);
        robot_file(&folder, "robot.toml", kind);
        let done = on(&["bus", "use", "robot.toml", "--json"]).expect(0).json();
        assert_eq!(
            (&done["driver"], &done["motor_mask"]),
            (&kind.into(), &63.into())
        );
        assert_eq!(
            on(&["zero", "--yes", "--json"]).expect(0).json()["state"],
            "idle"
        );
    }
}

#[test]
fn a_mixed_bus_and_unknown_kinds_are_refused() {
    let folder = Folder::new("servos-mixed");
    let kinds = "packed,packed,xl330,packed,packed,packed";
    let robot = Emulator::start_with(&folder, &["--drivers", kinds]);
    let uri = robot.uri();
    let on = |args: &[&str]| rb(&folder, &[&["-p", &uri], args].concat());
    let done = on(&["bus", "scan"]).expect(8);
    assert!(
        done.err
            .contains("mixed: packed (1, 2, 4, 5, 6), xl330 (3)"),
        "{}",
        done.err
    );
    let done = on(&["zero", "--yes"]).expect(7);
    assert!(
        done.err.contains("joint 2 (A.M2) is of another kind"),
        "{}",
        done.err
    );
    for (kind, code, words) in [
        ("xl320", 2, "known: packed, xl330"),
        ("absent.toml", 3, "absent.toml"),
        ("bad.toml", 3, "bad.toml:8: `bus.driver` is \"mx28\""),
        ("silent.toml", 3, "does not name its drivers"),
    ] {
        robot_file(&folder, "bad.toml", "mx28");
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/metamodule.toml");
        folder.write("silent.toml", std::fs::read_to_string(path).unwrap());
        let done = on(&["bus", "use", kind]).expect(code);
        assert!(done.err.contains(words), "{kind}: {}", done.err);
    }
}
