//! Data for a diagnosis: collected on the emulated robot, made with a known cause, and recordings read as data sets.

use crate::rig::{Folder, gait, rb, trials};

#[test]
fn collect_tells_the_time_records_and_goes_on_where_it_stopped() {
    let folder = Folder::new("collect");
    let crawl = gait("crawl.toml");
    let common = ["-p", "sim:", "--json", "gap", "collect", crawl.as_str()];
    let call = |more: &[&str]| rb(&folder, &[&common, more].concat()).expect(0);
    let dry = call(&["-o", "set", "--dry-run"]);
    // Three repeats of 30 s, ten minutes of hold, five motions of six joints; the way there and back comes on top.
    assert!(dry.json()["robot_time_s"].as_f64().unwrap() > 3.0 * 30.0 + 600.0 + 6.0 * 47.0);
    assert!(dry.err.contains("robot time"), "{}", dry.err);
    assert!(!folder.path("set").exists());
    let short = [
        "-o",
        "set",
        "-d",
        "1s",
        "--warm",
        "0s",
        "--no-joints",
        "--repeat",
    ];
    let first = call(&[&short[..], &["1"]].concat()).json();
    assert_eq!(
        (first["recorded_now"].as_u64(), first["missing"].as_u64()),
        (Some(1), Some(0))
    );
    let more = call(&[&short[..], &["2"]].concat()).json();
    assert_eq!(
        more["recorded_now"].as_u64(),
        Some(1),
        "the first one is not made again"
    );
    let checked = rb(&folder, &["--json", "rec", "check", "set"])
        .expect(0)
        .json();
    assert_eq!(checked["runs"].as_u64(), Some(2));
    // A data set may name the recordings themselves.
    let manifest = "format = 1\nrobot = \"metamodule\"\n[[run]]\nfile = \"crawl_0.mcap\"\n[[run]]\nfile = \"crawl_1.mcap#1\"\n";
    folder.write("set/recordings/dataset.toml", manifest);
    let checked = rb(&folder, &["--json", "rec", "check", "set/recordings"])
        .expect(0)
        .json();
    assert_eq!(checked["runs"].as_u64(), Some(2));
    folder.write("set/recordings/dataset.toml", manifest.replace("#1", "#2"));
    let refused = rb(&folder, &["rec", "check", "set/recordings"]).expect(8);
    assert!(refused.out.contains("has no run 2"), "{}", refused.out);
}

#[test]
fn a_case_by_name_is_a_data_set_with_its_label() {
    let folder = Folder::new("case");
    let cause = "coulomb_friction@2:0.5";
    trials(
        &folder,
        &["make-case", cause, "--gaits", "1", "-o", "./case"],
    )
    .expect("a case");
    let label = std::fs::read_to_string(folder.path("case/label.json")).unwrap();
    let label: serde_json::Value = serde_json::from_str(&label).unwrap();
    let planted = &label["causes"][0];
    assert_eq!(planted["joints"], serde_json::json!([2]));
    assert_eq!(planted["values"]["torque_nm"]["value"].as_f64(), Some(0.5));
    let checked = rb(&folder, &["--json", "rec", "check", "case"])
        .expect(0)
        .json();
    assert_eq!(checked["runs"].as_u64(), Some(3));
    let refused = |cause: &str| trials(&folder, &["make-case", cause, "-o", "./x"]).unwrap_err();
    assert!(refused("coulomb_friction:0.5").contains("effect@JOINT"));
    assert!(refused("warp@1").contains("no effect `warp`"));
}

#[test]
fn a_latency_that_all_joints_share_is_one_cause() {
    let folder = Folder::new("shared");
    let late: Vec<String> = (0..6).map(|k| format!("latency@{k}:0.06")).collect();
    let made = ["make-case", &late.join("+"), "--gaits", "3", "-o", "./late"];
    trials(&folder, &made).expect("a case");
    let found = rb(&folder, &["--json", "gap", "causes", "late"])
        .expect(0)
        .json();
    assert_eq!(found["schema"], "rb.gap/2", "{found}");
    // One cause of all joints. A short lag of the drive looks the same, so the class holds both.
    let causes = found["causes"].as_array().unwrap();
    assert_eq!(causes.len(), 1, "{found}");
    assert_eq!(causes[0]["scope"], "all", "{found}");
    let class = causes[0]["alternatives"].as_array().unwrap().iter();
    let same = class.filter(|a| a["distinguishable"] == false && a["scope"] == "all");
    let mut named = same.chain(std::iter::once(&causes[0]));
    assert!(named.any(|c| c["effect"] == "latency"), "{found}");
    // A library without the effect names something else, or nothing.
    let without = ["--json", "gap", "causes", "late", "--withhold", "latency"];
    let other = rb(&folder, &without).expect(0).json();
    let named = other["causes"].as_array().unwrap();
    assert!(named.iter().all(|c| c["effect"] != "latency"), "{other}");
}

#[test]
fn a_centre_of_mass_that_is_off_is_named_first() {
    let folder = Folder::new("centre");
    let made = [
        "make-case",
        "com_offset:-0.012,0.012,0.015",
        "--gaits",
        "4",
        "--effort",
        "-o",
        "./heavy",
    ];
    trials(&folder, &made).expect("a case");
    let found = rb(&folder, &["--json", "gap", "causes", "heavy"])
        .expect(0)
        .json();
    assert_eq!(found["causes"][0]["effect"], "com_offset", "{found}");
    assert!(found["causes"][0]["evidence"].as_f64() > found["causes"][0]["asked"].as_f64());
    // What comes nearest beside it has less than is asked, or nothing adds evidence.
    let nearest = &found["nearest"];
    let below = nearest["evidence"].as_f64() < nearest["asked"].as_f64();
    assert!(nearest.is_null() || below, "{found}");
    let places = found["where"].as_array().unwrap();
    assert_eq!(places[0]["stage"], "body", "{found}");
    let shares = places.iter().map(|p| p["share"].as_f64().unwrap());
    assert!((shares.sum::<f64>() - 1.0).abs() < 1e-9, "{found}");
}

#[test]
fn a_robot_without_a_cause_has_none_and_few_of_them_calibrate_nothing() {
    let folder = Folder::new("nulls");
    let made = ["make-case", "none", "--gaits", "3", "-o", "./nulls/one"];
    std::fs::create_dir_all(folder.path("nulls")).unwrap();
    trials(&folder, &made).expect("a case");
    let found = rb(&folder, &["--json", "gap", "causes", "nulls/one"])
        .expect(0)
        .json();
    assert_eq!(found["verdict"], "none", "{found}");
    assert_eq!(found["causes"].as_array().unwrap().len(), 0, "{found}");
    assert_eq!(found["where"].as_array().unwrap().len(), 0, "{found}");
    let none = ["gap", "calibrate", "--nulls", ".", "-o", "own.json"];
    let refused = rb(&folder, &none).expect(3);
    assert!(refused.err.contains("no folder in it"), "{}", refused.err);
    for (text, says) in [
        (r#"{"gears": 0.1}"#, "no stage is called `gears`"),
        (r#"{"body": 3}"#, "`body` is 3, not a share from 0 to 1"),
        ("0.1", "laws.json: "),
    ] {
        std::fs::write(folder.path("laws.json"), text).unwrap();
        let asked = ["--nulls", "nulls", "--laws", "laws.json", "-o", "own.json"];
        let refused = rb(&folder, &[&["gap", "calibrate"][..], &asked].concat()).expect(3);
        assert!(refused.err.contains(says), "{}", refused.err);
    }
    let few = ["--nulls", "nulls", "--keep", "kept", "-o", "own.json"];
    let few = [&["gap", "calibrate"][..], &few].concat();
    let calibrate = || {
        let refused = rb(&folder, &few).expect(3);
        let few = refused.err.contains("at least 19 robots");
        assert!(few, "{}", refused.err);
        assert!(!folder.path("own.json").exists());
        let kept = std::fs::read_dir(folder.path("kept")).unwrap();
        let files: Vec<_> = kept.map(|f| f.unwrap().path()).collect();
        let [file] = files.as_slice() else {
            panic!("{files:?}");
        };
        let written = file.metadata().unwrap().modified().unwrap();
        (file.clone(), written, std::fs::read(file).unwrap())
    };
    let first = calibrate();
    assert_eq!(calibrate(), first, "what is kept is read");
    std::fs::write(&first.0, "no blocks").unwrap();
    assert_eq!(calibrate().2, first.2, "what is damaged is made again");
    let model = folder.path("nulls/one/model.toml");
    let text = std::fs::read_to_string(&model).unwrap_or_else(|_| "format = 1\n".into());
    let heavy = text.replace("0.325", "0.4");
    assert_ne!(heavy, text, "{text}");
    std::fs::write(&model, heavy).unwrap();
    rb(&folder, &few).expect(3);
    let kept = std::fs::read_dir(folder.path("kept")).unwrap();
    assert_eq!(kept.count(), 2, "another model has blocks of its own");
}
