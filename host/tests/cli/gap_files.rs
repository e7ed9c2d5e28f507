//! What a diagnosis leaves in files: the page, the next experiment, the patch, and predictions from which anyone can compute
//! the held-out error. A run without response columns is predicted, not scored.

use std::fs;
use std::path::Path;

use crate::bench::Joint;
use crate::browser;
use crate::rig::{Folder, rb, trials};

/// A CSV file by columns; empty cells are NaN.
struct Columns {
    names: Vec<String>,
    rows: Vec<Vec<f64>>,
}

impl Columns {
    fn read(path: &Path) -> Self {
        let text = fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let mut lines = text.lines();
        let cells = |line: &str| -> Vec<String> { line.split(',').map(str::to_owned).collect() };
        let names = cells(lines.next().unwrap());
        let number = |c: String| c.parse().unwrap_or(f64::NAN);
        let row = |line| cells(line).into_iter().map(number).collect();
        Self {
            names,
            rows: lines.map(row).collect(),
        }
    }

    fn get(&self, name: &str) -> Vec<f64> {
        let found = self.names.iter().position(|n| n == name);
        let k = found.unwrap_or_else(|| panic!("no column {name} in {:?}", self.names));
        self.rows.iter().map(|r| r[k]).collect()
    }

    /// The column `name` at other times: of each the first row that is not before it by more than `early_s`.
    fn at(&self, name: &str, t_s: &[f64], early_s: f64) -> Vec<f64> {
        let (own_s, value) = (self.get("t_s"), self.get(name));
        let row = |t: &f64| {
            let next = own_s.partition_point(|own| *own < t - early_s);
            value[next.min(value.len() - 1)]
        };
        t_s.iter().map(row).collect()
    }

    /// The same file without the columns for which `response` holds.
    fn without(&self, response: impl Fn(&str) -> bool) -> String {
        let kept: Vec<usize> = (0..self.names.len())
            .filter(|k| !response(&self.names[*k]))
            .collect();
        let line = |cell: &dyn Fn(usize) -> String| {
            let cells: Vec<String> = kept.iter().map(|k| cell(*k)).collect();
            cells.join(",") + "\n"
        };
        let number = |x: f64| {
            if x.is_nan() {
                String::new()
            } else {
                x.to_string()
            }
        };
        let mut text = line(&|k| self.names[k].clone());
        for row in &self.rows {
            text.push_str(&line(&|k| number(row[k])));
        }
        text
    }
}

fn rmse(a: &[f64], b: &[f64]) -> f64 {
    let pairs = a.iter().zip(b).filter(|(a, b)| (*a - *b).is_finite());
    let squares: Vec<f64> = pairs.map(|(a, b)| (a - b).powi(2)).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

/// Appends a line to the table of the run `file`.
fn mark(folder: &Folder, manifest: &str, file: &str, line: &str) {
    let path = folder.path(manifest);
    let text = fs::read_to_string(&path).unwrap();
    let key = format!("file = \"{file}\"");
    assert!(text.contains(&key), "{text}");
    fs::write(path, text.replace(&key, &format!("{key}\n{line}"))).unwrap();
}

fn strip(folder: &Folder, file: &str, response: impl Fn(&str) -> bool) {
    let path = folder.path(file);
    let text = Columns::read(&path).without(response);
    fs::write(path, text).unwrap();
}

/// Diagnoses `data` into `out.html`, `patch.toml` and the file of the next experiment, and predicts it into `p`.
fn diagnosed(folder: &Folder, data: &str) -> serde_json::Value {
    let files = ["-o", "out.html", "--patch", "patch.toml", "--force"];
    let report = [&["--json", "gap", "report", data], &files[..]].concat();
    let verdict = rb(folder, &report).expect(0).json();
    browser::assert_readable(&folder.path("out.html"));
    let predict = [
        "gap",
        "predict",
        data,
        "--patch",
        "patch.toml",
        "-o",
        "p",
        "--force",
    ];
    rb(folder, &predict).expect(0);
    verdict
}

/// A bench gets set-points that it has been asked for before.
fn assert_next_motion(folder: &Folder, verdict: &serde_json::Value) {
    let next = &verdict["next_experiment"];
    assert_eq!(next["gait"], "out.next.csv", "{next}");
    let motion = Columns::read(&folder.path("out.next.csv"));
    assert_eq!(motion.names, ["t_s", "setpoint_rad"]);
    let (t_s, setpoint) = (motion.get("t_s"), motion.get("setpoint_rad"));
    assert!(t_s.windows(2).all(|w| w[1] > w[0]));
    assert!(setpoint.iter().all(|x| x.abs() <= 0.8), "{setpoint:?}");
    let last = t_s[t_s.len() - 1];
    assert!(last > 10.0 && t_s.len() > 200, "{last} s");
}

#[test]
fn a_joint_gets_a_page_a_motion_and_predictions_that_hold_the_error() {
    let folder = Folder::new("files_joint");
    // Set-point and position alone, and nothing stated: a cause is tentative, and more is to be recorded.
    let joint = Joint {
        play_rad: 0.03,
        ..Joint::default()
    };
    joint.record(&folder, &[0.2, 0.35, 0.5, 0.27, 0.42]);
    for run in ["run3.csv", "run4.csv"] {
        mark(&folder, "joint/dataset.toml", run, "role = \"check\"");
    }
    let secret = Columns::read(&folder.path("joint/run4.csv")).get("position_rad");
    strip(&folder, "joint/run4.csv", |c| c == "position_rad");
    let verdict = diagnosed(&folder, "joint");
    assert_next_motion(&folder, &verdict);
    assert_eq!(verdict["effects"][0]["effect"], "deadband", "{verdict}");
    let sentence = verdict["sentence"].as_str().unwrap();
    assert!(sentence.contains("controller gains"), "{sentence}");
    let gap = &verdict["gap"];
    assert_eq!(gap["held_out_runs"], serde_json::json!(["run3.csv"]));
    assert_eq!(gap["metric"], "position_rmse_rad");
    let files = |run: &str| {
        let read = |of: &str| Columns::read(&folder.path(&format!("{of}/{run}")));
        (read("joint"), read("p"))
    };
    let (measured, said) = files("run3.csv");
    assert_eq!(measured.get("t_s"), said.get("t_s"));
    assert_eq!(measured.get("setpoint_rad").len(), 500);
    let error = rmse(&measured.get("position_rad"), &said.get("position_rad"));
    let after = gap["after"].as_f64().unwrap();
    // Six decimals in the file.
    assert!((error - after).abs() < 1e-6, "{error} against {after}");
    // What the tool has not seen it has predicted as well.
    let (asked, said) = files("run4.csv");
    assert_eq!(asked.get("t_s"), said.get("t_s"));
    // But for its first second: nobody can know where an unmeasured joint stood.
    let error = rmse(&secret[50..], &said.get("position_rad")[50..]);
    assert!(error < 3.0 * after, "{error} against {after}");
}

#[test]
fn a_patch_of_causes_predicts_runs_that_no_fit_saw() {
    let folder = Folder::new("files_causes");
    let cause = "velocity_limit@2:0.3";
    let made = ["make-case", cause, "--gaits", "3", "-o", "./slow"];
    trials(&folder, &made).expect("a case");
    let asked = ["--json", "gap", "causes", "slow", "--patch", "patch.toml"];
    let found = rb(&folder, &asked).expect(0).json();
    assert_eq!(found["causes"][0]["effect"], "velocity_limit", "{found}");
    // Nothing is written over.
    let again = rb(&folder, &asked).expect(2);
    assert!(again.err.contains("patch.toml"), "{}", again.err);
    let run = found["held_out"]["runs"][0].as_str().expect("a run");
    let measured = Columns::read(&folder.path(&format!("slow/{run}")));
    let error = |model: &str| {
        let by = ["--patch", model, "-o", "p", "--force"];
        rb(&folder, &[&["gap", "predict", "slow"], &by[..]].concat()).expect(0);
        let said = Columns::read(&folder.path(&format!("p/{run}")));
        // A robot is predicted on rows of its own.
        let there = said.at("position_rad_2", &measured.get("t_s"), 1e-6);
        rmse(&measured.get("position_rad_2"), &there)
    };
    let (before, after) = (error("slow/model.toml"), error("patch.toml"));
    // Measured: 0.567 rad to 0.005 rad.
    assert!(before > 0.5 && after < 0.01, "{before} to {after}");
}

#[test]
fn a_robot_gets_a_page_a_gait_and_predictions() {
    let folder = Folder::new("files_robot");
    let cause = "torque_limit@2:0.8";
    let made = ["make-case", cause, "--gaits", "3", "-o", "./case"];
    trials(&folder, &made).expect("a case");
    let manifest = fs::read_to_string(folder.path("case/dataset.toml")).unwrap();
    let runs: Vec<&str> = manifest
        .lines()
        .filter_map(|l| l.strip_prefix("file = \"")?.strip_suffix('"'))
        .collect();
    let (asked, scored) = (runs[runs.len() - 1], runs[runs.len() - 2]);
    for run in [asked, scored] {
        mark(&folder, "case/dataset.toml", run, "role = \"check\"");
    }
    let secret = Columns::read(&folder.path(&format!("case/{asked}")));
    strip(&folder, &format!("case/{asked}"), |c| {
        c != "t_s" && !c.starts_with("setpoint_rad_")
    });
    let verdict = diagnosed(&folder, "case");
    let next = &verdict["next_experiment"];
    assert_eq!(next["gait"], "out.next.toml", "{next}");
    let moved = rb(&folder, &["gait", "check", "out.next.toml"]).expect(0);
    assert!(!moved.out.is_empty());
    let gait = fs::read_to_string(folder.path("out.next.toml")).unwrap();
    assert!(gait.contains("joint2"), "{gait}");
    assert_eq!(
        verdict["gap"]["held_out_runs"],
        serde_json::json!([scored]),
        "{verdict}"
    );
    for run in &runs {
        let said = Columns::read(&folder.path(&format!("p/{run}")));
        for k in 0..6 {
            assert!(said.get(&format!("link_position_rad_{k}")).len() > 100);
        }
        assert!(said.get("base_qw").iter().all(|q| q.is_finite()));
    }
    // Joints follow in the prediction as they did on the robot; rows are 20 ms apart there.
    let said = Columns::read(&folder.path(&format!("p/{asked}")));
    let at = said.at("position_rad_1", &secret.get("t_s"), 0.01);
    let error = rmse(&at, &secret.get("position_rad_1"));
    assert!(error < 0.1, "{error}");
}
