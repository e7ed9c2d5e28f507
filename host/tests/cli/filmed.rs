//! The emulated robot filmed and tracked: through firmware and link into a data set folder, clocks laid by the first motion.

use std::collections::BTreeMap;

use files::dataset::{Manifest, Recording};

use crate::rig::{Emulator, Folder, gait, rb};

/// A clock 7.25 s ahead of the robot's, placing and torques that differ from run to run.
const SCENARIO: &str = r#"
body = "ground"
seed = 5
[noise]
disturbance_nm = 0.05
[start]
x_m = 0.1
y_m = -0.2
yaw_deg = 30
sigma_m = 0.002
sigma_deg = 0.5
[camera]
height_m = 2.2
clock_ahead_s = 7.25
clock_ratio = 1.00003
[tracker]
[imu]
"#;
/// See [`SCENARIO`].
const AHEAD_S: f64 = 7.25;
/// Two frames: the crawl begins slowly, and the outline shows that later than the encoders do.
const SYNC_S: f64 = 2.0 / 30.0;

fn sync(folder: &Folder, run: &str) -> serde_json::Value {
    let text = std::fs::read_to_string(folder.path(&format!("set/{run}/sync.json"))).unwrap();
    serde_json::from_str(&text).unwrap()
}

fn load(folder: &Folder) -> (Manifest, BTreeMap<String, Recording>) {
    let text = std::fs::read_to_string(folder.path("set/dataset.toml")).unwrap();
    let (manifest, warnings) = Manifest::parse("dataset.toml", &text).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    let csv = |file: &str| {
        let text = std::fs::read_to_string(folder.path("set").join(file)).unwrap();
        let (recording, warnings) = Recording::parse(file, &text, &manifest).unwrap();
        assert!(warnings.is_empty(), "{warnings:?}");
        recording
    };
    let runs = manifest.runs.iter();
    let recordings = runs.map(|run| (run.file.clone(), csv(&run.file))).collect();
    (manifest, recordings)
}

fn frames(folder: &Folder, run: &str) -> Vec<f64> {
    let index = std::fs::read_to_string(folder.path(&format!("set/{run}/index.csv"))).unwrap();
    let rows = index
        .lines()
        .skip(1)
        .map(|line| line.split_once(',').unwrap());
    rows.map(|(t_s, file)| {
        assert!(folder.path(&format!("set/{run}/{file}")).exists(), "{file}");
        t_s.parse().unwrap()
    })
    .collect()
}

#[test]
fn runs_on_the_emulated_robot_are_filmed_tracked_and_laid_in_time() {
    let folder = Folder::new("filmed");
    folder.write("ground.toml", SCENARIO);
    let crawl = gait("crawl.toml");
    let run = |extra: &[&str]| {
        let base = [
            "-p",
            "sim:ground.toml",
            "run",
            &crawl,
            "-d",
            "4s",
            "--dataset",
            "set",
        ];
        rb(&folder, &[&base, extra].concat())
    };
    run(&["--repeat", "2", "--role", "fit"]).expect(0);
    run(&[]).expect(0);
    let (manifest, recordings) = load(&folder);
    let files: Vec<&str> = manifest.runs.iter().map(|run| run.file.as_str()).collect();
    assert_eq!(files, ["crawl_1.csv", "crawl_2.csv", "crawl_3.csv"]);
    for run in ["crawl_1", "crawl_2", "crawl_3"] {
        let sync = sync(&folder, run);
        // The camera's clock gained 30 ppm over the 2 s before the mark: nothing beside a frame.
        let error_s = sync["offset_s"].as_f64().unwrap() + AHEAD_S;
        assert!(error_s.abs() < SYNC_S, "{run}: {error_s} s");
        let times = frames(&folder, run);
        assert!((120..=122).contains(&times.len()) && times[0].abs() <= 1.0 / 60.0);
        let body = recordings[&format!("{run}.csv")].body().clone();
        let first = |column: &Option<Vec<f64>>| {
            *column
                .as_ref()
                .unwrap()
                .iter()
                .find(|v| v.is_finite())
                .unwrap()
        };
        // Body 3 moved a little on the way to the start pose; the yaw is that of the scenario.
        assert!((first(&body.base_m[0]) - 0.1).abs() < 0.1);
        let yaw_deg = 2.0
            * first(&body.base_q[3])
                .atan2(first(&body.base_q[0]))
                .to_degrees();
        assert!((yaw_deg - 30.0).abs() < 20.0, "{yaw_deg}");
        // At rest on the ground the sensor shows 1 g; a crawl stays within a few m/s2 on average.
        let accel = body.accel_m_s2.each_ref().map(first);
        let norm = accel.iter().map(|a| a * a).sum::<f64>().sqrt();
        assert!((norm - 9.81).abs() < 5.0, "{accel:?}");
    }
    let csv = |run: &str| std::fs::read(folder.path(&format!("set/{run}.csv"))).unwrap();
    assert_ne!(csv("crawl_1"), csv("crawl_2"), "repeats differ");
    // The same command gives the same bytes.
    let before = csv("crawl_1");
    std::fs::remove_dir_all(folder.path("set")).unwrap();
    run(&[]).expect(0);
    assert_eq!(csv("crawl_1"), before);
}

/// What a user with a camera of his own does: record the motors, bring the film, and let the first motion lay it in time.
#[test]
fn a_film_brought_later_is_laid_in_time() {
    let folder = Folder::new("film-later");
    folder.write("ground.toml", SCENARIO);
    let extra = ["--scenario", "ground.toml", "--film", "raw"];
    let emulator = Emulator::start_with(&folder, &extra);
    let crawl = gait("crawl.toml");
    let uri = emulator.uri();
    rb(&folder, &["-p", &uri, "zero", "--yes"]).expect(0);
    let args = [
        "-p",
        &uri,
        "--yes",
        "run",
        &crawl,
        "-d",
        "3s",
        "--dataset",
        "set",
    ];
    let done = rb(&folder, &args).expect(0);
    assert!(done.out.contains("rec film set RUN FOLDER"), "{done:?}");
    emulator.interrupt();
    let film = [
        "rec",
        "film",
        "set",
        "crawl_1",
        "raw",
        "--track",
        "raw/track.csv",
    ];
    rb(&folder, &film).expect(0);
    let (manifest, recordings) = load(&folder);
    assert_eq!(manifest.runs[0].frames.as_deref(), Some("crawl_1"));
    assert!(recordings["crawl_1.csv"].body().base_m[0].is_some());
    let error_s = sync(&folder, "crawl_1")["offset_s"].as_f64().unwrap() + AHEAD_S;
    assert!(error_s.abs() < SYNC_S, "{error_s} s");
    // A film without rest before the first motion has no mark: the set's own film begins at t = 0.
    std::fs::rename(folder.path("set/crawl_1"), folder.path("late")).unwrap();
    let late = rb(&folder, &["rec", "film", "set", "crawl_1", "late"]).expect(3);
    assert!(late.err.contains("start the camera first"), "{late:?}");
    let nobody = rb(&folder, &["rec", "film", "set", "crawl_9", "raw"]).expect(2);
    assert!(nobody.err.contains("its runs: crawl_1"), "{nobody:?}");
}

#[test]
fn a_drawn_robot_is_filmed_and_its_truth_stands_apart() {
    let folder = Folder::new("drawn");
    let crawl = gait("crawl.toml");
    let args = [
        "emulate", "films", "--seed", "3", "-o", "set", "-d", "3s", "--repeat", "2",
    ];
    let done = rb(
        &folder,
        &[&args[..], &["--training", "crawl", &crawl, "--json"]].concat(),
    );
    let report = done.expect(0).json();
    assert_eq!(report["runs"].as_array().unwrap().len(), 2);
    let (manifest, _) = load(&folder);
    assert!(manifest.runs.iter().all(|run| run.frames.is_some()));
    let text = |name: &str| std::fs::read_to_string(folder.path(name)).unwrap();
    let truth = files::model::Model::parse("robot.toml", &text("set-truth/robot.toml")).unwrap();
    for key in files::model::Key::TABLE_II {
        let (low, high) = key.info().search;
        assert!(
            (low..=high).contains(&truth.value(key)),
            "{}",
            key.info().path()
        );
    }
    assert_eq!(
        files::model::Model::parse("model.toml", &text("set/model.toml")).unwrap(),
        files::model::Model::hand_tuned(),
        "the data set carries the nominal model, not the truth"
    );
}
