//! The report pages in a browser: no complaint, no network, by keyboard, on a phone, in print.

use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use crate::rig::{Folder, rb, skip};

/// Chromium as Debian, Ubuntu and others call it.
fn chromium() -> Option<&'static str> {
    ["chromium", "chromium-browser", "google-chrome"]
        .into_iter()
        .find(|name| {
            let asked = Command::new(name).arg("--version").output();
            asked.is_ok_and(|o| o.status.success())
        })
}

/// What a reader of `page` meets, as the script beside the foreign clients reports it.
fn read(chromium: &str, page: &Path) -> serde_json::Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .join("tests/foreign/read_report_in_chromium.py");
    let mut command = Command::new("python3");
    let said = command.arg(script).arg(chromium).arg(page);
    let said = said.output().unwrap();
    let text = String::from_utf8_lossy(&said.stdout).into_owned();
    assert!(
        said.status.success(),
        "{}",
        String::from_utf8_lossy(&said.stderr)
    );
    serde_json::from_str(&text).unwrap()
}

fn readable(page: &serde_json::Value) {
    assert_eq!(page["complaints"], serde_json::json!([]), "{page}");
    assert_eq!(page["network"], serde_json::json!([]), "{page}");
    assert_eq!(page["reached_by_tab"], true, "{page}");
    assert_ne!(page["times"][0], page["times"][1], "{page}");
    assert!(page["phone_width_px"].as_u64().unwrap() <= 360, "{page}");
    assert_eq!(page["slider_in_print"], "none", "{page}");
    assert_eq!(page["prints"], true, "{page}");
}

/// Three motions of a joint that follows its set-point with a time constant of 0.1 s.
fn bench(folder: &Folder) {
    std::fs::create_dir(folder.path("joint")).unwrap();
    let mut manifest =
        String::from("format = 1\nrobot = \"bench\"\n[bench]\ncommand = \"position\"\n");
    for (run, hz) in [0.2_f64, 0.35, 0.5].iter().enumerate() {
        let mut csv = String::from("t_s,setpoint_rad,position_rad\n");
        let mut q = 0.0;
        for i in 0..500 {
            let t = f64::from(i) * 0.02;
            // A triangle of 0.8 rad.
            let phase = (hz * t).fract();
            let sp = 0.8 * (1.0 - 4.0 * (phase - 0.5).abs());
            q += 0.02 / 0.1 * (sp - q);
            writeln!(csv, "{t:.3},{sp:.5},{q:.5}").unwrap();
        }
        folder.write(&format!("joint/run{run}.csv"), csv);
        write!(
            manifest,
            "[[run]]\nfile = \"run{run}.csv\"\ngait = \"g{run}\"\n"
        )
        .unwrap();
    }
    folder.write("joint/dataset.toml", manifest);
}

#[test]
fn report_pages_are_read_without_a_mouse_or_a_network() {
    if Command::new("python3").arg("--version").output().is_err() {
        return skip(
            "report pages in a browser",
            "no python3 (`cargo xtask setup`)",
        );
    }
    let Some(chromium) = chromium() else {
        return skip(
            "report pages in a browser",
            "no Chromium (`cargo xtask setup`)",
        );
    };
    let folder = Folder::new("report_page");
    bench(&folder);
    rb(&folder, &["gap", "report", "joint", "-o", "joint.html"]).expect(0);
    readable(&read(chromium, &folder.path("joint.html")));

    let case = [
        "gap",
        "blind",
        "--make-case",
        "ground_friction:0.4",
        "--gaits",
        "3",
        "-o",
        "robot",
    ];
    rb(&folder, &case).expect(0);
    rb(&folder, &["gap", "report", "robot", "-o", "robot.html"]).expect(0);
    readable(&read(chromium, &folder.path("robot.html")));
}
