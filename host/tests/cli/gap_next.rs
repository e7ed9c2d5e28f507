//! The next experiment of the whole robot where the body holds what is open: a gait that the robot's own check lets pass, chosen for
//! what it shows, and a promise that the same emulated robot then keeps.

use std::fs;

use crate::rig::{Folder, rb, trials};

/// A case with `cause`, made with `more`, and the verdict on it with its next gait in `out.next.toml`.
fn diagnosed(folder: &Folder, cause: &str, more: &[&str]) -> serde_json::Value {
    let make = ["make-case", cause, "--gaits", "6", "-o", "./case"];
    trials(folder, &[&make[..], more].concat()).expect("a case");
    let report = ["--json", "gap", "report", "case", "-o", "out.html"];
    let verdict = rb(folder, &report).expect(0).json();
    let next = &verdict["next_experiment"];
    assert_eq!(next["gait"], "out.next.toml", "{next}");
    rb(folder, &["gait", "check", "out.next.toml"]).expect(0);
    verdict
}

/// The numbers in `text` up to the first word that is none.
fn numbers(text: &str) -> Vec<f64> {
    let words = text.split_whitespace().map(|w| w.trim_matches([',', '(']));
    words.map_while(|w| w.parse().ok()).collect()
}

/// What stands behind `mark` in `text`.
fn behind<'a>(text: &'a str, mark: &str) -> &'a str {
    let at = text.find(mark);
    &text[at.unwrap_or_else(|| panic!("no `{mark}` in: {text}")) + mark.len()..]
}

/// Columns of a CSV file by name, as numbers; empty cells are left out together with their time.
fn column(text: &str, name: &str) -> Vec<(f64, f64)> {
    let mut lines = text.lines().map(|l| l.split(',').collect::<Vec<_>>());
    let names = lines.next().expect("a header");
    let at = names.iter().position(|n| *n == name);
    let at = at.unwrap_or_else(|| panic!("no {name} in {names:?}"));
    let row = |r: Vec<&str>| Some((r[0].parse().ok()?, r[at].parse().ok()?));
    lines.filter_map(row).collect()
}

/// What the recording `csv` shows of what the verdict says to look at.
fn seen(csv: &str, text: &str) -> Vec<f64> {
    if text.contains("how far the base has come") {
        let at_s = numbers(behind(text, "has come "))[0];
        let way = |name: &str| {
            let all = column(csv, name);
            let late = all.iter().find(|x| x.0 >= all[0].0 + at_s);
            late.expect("long enough").1 - all[0].1
        };
        return vec![way("base_x_m"), way("base_y_m")];
    }
    let joint = behind(text, "current of joint ").split(':').next();
    let all = column(csv, &format!("current_a_{}", joint.expect("a joint")));
    let square: f64 = all.iter().map(|x| x.1 * x.1).sum();
    vec![(square / all.len() as f64).sqrt()]
}

/// A film cannot tell a slippery ground from a light robot. The gait that is proposed can: played by the same emulated robot, it shows what the
/// true cause predicts, not what the other one does.
#[test]
fn the_next_gait_tells_a_slippery_ground_from_a_light_robot() {
    let folder = Folder::new("next_class");
    let cause = "ground_friction:0.4";
    let verdict = diagnosed(&folder, cause, &["--filmed", "--untracked"]);
    let next = &verdict["next_experiment"];
    let separates = serde_json::json!(["ground_friction", "mass"]);
    assert_eq!(next["separates"], separates, "{next}");
    let text = next["text"].as_str().expect("words");
    let promised = numbers(behind(text, "scatter by ").split_once('(').expect("it").1)[0];
    let recorded = numbers(behind(text, "standard deviations; "))[0];
    assert!(promised > recorded && promised > 2.5, "{text}");
    let gait = ["--gait", "./out.next.toml", "-o", "./again"];
    trials(&folder, &[&["make-case", cause], &gait[..]].concat()).expect("a case");
    let runs = fs::read_dir(folder.path("again")).expect("a folder");
    let paths = runs.map(|f| f.expect("a file").path());
    let csv = paths.filter(|p| p.extension().is_some_and(|e| e == "csv"));
    let predicted = behind(text, ": ").split_once(": ").map_or(text, |x| x.1);
    let expected = |effect: &str| {
        let part = predicted.split("; ").find(|p| p.contains(effect));
        numbers(part.expect("a prediction").trim_start())
    };
    let off = |shown: &[f64], effect: &str| {
        let square = shown
            .iter()
            .zip(expected(effect))
            .map(|(a, b)| (a - b).powi(2));
        square.sum::<f64>().sqrt()
    };
    let mut count = 0;
    for path in csv {
        let shown = seen(&fs::read_to_string(path).expect("text"), text);
        let [near, far] = ["ground_friction", "mass"].map(|e| off(&shown, e));
        assert!(near < far, "{shown:?}: {near} against {far}; {text}");
        count += 1;
    }
    assert_eq!(count, 3, "three repeats");
}

/// A friction that changes along a run is in no library: the gait that shows it is to be played for longer.
#[test]
fn an_unknown_remainder_of_the_body_gets_the_gait_that_left_most() {
    let folder = Folder::new("next_unknown");
    let verdict = diagnosed(&folder, "friction_drift", &[]);
    assert_eq!(verdict["verdict"], "unknown", "{}", verdict["sentence"]);
    assert_eq!(verdict["where"][0]["stage"], "body", "{}", verdict["where"]);
    let text = verdict["next_experiment"]["text"].as_str().expect("words");
    assert!(text.starts_with("The windows of gait"), "{text}");
    let name = behind(text, "The windows of gait ").split(' ').next();
    let sent = folder.path(&format!("case/gaits/{}.toml", name.expect("a name")));
    let sent = files_gait(&sent);
    let next = files_gait(&folder.path("out.next.toml"));
    assert!(next.duration_s() > sent.duration_s() || next.frequency_hz() < sent.frequency_hz());
    // Read off the set-points, it is the gait that was sent.
    for (a, b) in sent.oscillators().iter().zip(next.oscillators()) {
        assert!((a.offset_rad - b.offset_rad).abs() < 0.03, "{a:?} {b:?}");
        assert!(
            (a.amplitude_rad - b.amplitude_rad).abs() < 0.03,
            "{a:?} {b:?}"
        );
    }
}

fn files_gait(path: &std::path::Path) -> control::gait::Gait {
    let text = fs::read_to_string(path).expect("a gait file");
    files::gait::parse(&path.display().to_string(), &text).expect("a gait")
}
