//! `rb-host model` and the check of data set folders.

use crate::rig::{Folder, gait, rb};

#[test]
fn schemas_are_printed_as_published() {
    let folder = Folder::new("schema");
    for (name, file) in [
        ("gait", "gait.json"),
        ("model", "model.json"),
        ("robot", "robot.json"),
        ("dataset", "dataset.json"),
        ("verdict", "gap-1.json"),
        ("causes", "gap-2.json"),
    ] {
        let printed = rb(&folder, &["model", "schema", name]).expect(0).out;
        let path = format!("{}/../docs/schema/{file}", env!("CARGO_MANIFEST_DIR"));
        assert_eq!(printed, std::fs::read_to_string(path).unwrap(), "{name}");
    }
    rb(&folder, &["model", "schema", "nonsense"]).expect(2);
}

#[test]
fn a_model_is_shown_with_source_and_effects() {
    let folder = Folder::new("show");
    let text = "format = 1\nname = \"slippery\"\n[environment]\nfriction = { value = 0.4, tolerance = 0.05, source = \"tilt test\" }\n\
                [effect.coulomb_friction.joint_2]\ntorque_nm = { value = 0.3, source = \"coast-down\" }\n";
    folder.write("m.toml", text);
    let shown = rb(&folder, &["model", "show", "m.toml"]).expect(0).out;
    for part in [
        "* environment.friction",
        "tilt test",
        "coulomb_friction.joint_2",
        "coast-down",
    ] {
        assert!(shown.contains(part), "{part}: {shown}");
    }
    let value = rb(&folder, &["model", "show", "--json"]).expect(0).json();
    let count = files::model::Key::COUNT;
    assert_eq!(value["values"].as_array().unwrap().len(), count);
    assert_eq!(value["values"][2]["value"], 1.0);
    assert!(value["effects"].as_array().unwrap().is_empty());
}

#[test]
fn a_wrong_model_is_refused_with_line_value_and_range() {
    let folder = Folder::new("check");
    folder.write("good.toml", "format = 1\n");
    let good = rb(&folder, &["model", "check", "good.toml"]).expect(0);
    assert!(good.out.contains("good.toml: ok"), "{}", good.out);
    for (body, said) in [
        (
            "[environment]\nfriction = { value = 40 }\n",
            "3: `environment.friction` is 40, allowed is 0 to 10",
        ),
        (
            "[environment]\nfrction = { value = 1 }\n",
            "3: unknown key `environment.frction`",
        ),
        (
            "[environment]\nfriction = 1\n",
            "3: `environment.friction` must be",
        ),
        (
            "[effect.motor_lag.joint_0]\ntime_constant_s = { value = 0.1 }\n",
            "the body simulator has no `motor_lag`",
        ),
    ] {
        folder.write("bad.toml", format!("format = 1\n{body}"));
        let done = rb(&folder, &["model", "check", "good.toml", "bad.toml"]).expect(3);
        assert!(done.err.contains("bad.toml"), "{}", done.err);
        assert!(done.err.contains(said), "{said}: {}", done.err);
    }
}

#[test]
fn a_data_set_folder_is_checked_file_by_file() {
    let folder = Folder::new("folder");
    let args = ["sim", &gait("crawl.toml"), "-d", "1s", "-o", "set"];
    rb(&folder, &args).expect(0);
    let whole = rb(&folder, &["rec", "check", "set"]).expect(0);
    assert!(whole.out.contains("1 runs"), "{}", whole.out);

    let csv = folder.path("set/crawl_1.csv");
    let good = std::fs::read_to_string(&csv).unwrap();
    let mut lines: Vec<&str> = good.lines().collect();
    let broken = lines[4].replacen("0.", "x.", 1);
    lines[4] = &broken;
    std::fs::write(&csv, lines.join("\n")).unwrap();
    let manifest = folder.path("set/dataset.toml");
    let text = std::fs::read_to_string(&manifest).unwrap();
    let text = format!("{text}frames = \"film\"\n\n[[run]]\nfile = \"lost.csv\"\n");
    std::fs::write(&manifest, text).unwrap();
    std::fs::create_dir(folder.path("set/film")).unwrap();
    folder.write("set/film/index.csv", "t_s,file\n0.0,a.png\nnow,a.png\n");
    folder.write("set/film/a.png", "");
    folder.write(
        "set/model.toml",
        "format = 1\n[mass]\nhalf_1_kg = { value = 99 }\n",
    );
    let done = rb(&folder, &["rec", "check", "set", "--json"]).expect(8);
    let value: serde_json::Value = serde_json::from_str(done.out.lines().next().unwrap()).unwrap();
    let found: Vec<&str> = value["findings"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f["text"].as_str().unwrap())
        .collect();
    for said in [
        "crawl_1.csv:5: column `t_s`: `x.",
        "lost.csv: ",
        "film/index.csv:3: column `t_s`: `now` is not a number",
        "model.toml:3: `mass.half_1_kg` is 99, allowed is 0.01 to 10",
    ] {
        assert!(
            found.iter().any(|f| f.starts_with(said)),
            "{said}: {found:?}"
        );
    }
}

/// A gait for the single module: three oscillators.
const THREE: &str = "format = 1\nname = \"three\"\nfrequency_hz = 0.2\nduration_s = 4\ncoupling = \"chain\"\nphase_lag_deg = [90, 90]\n\
    [[oscillator]]\namplitude_deg = 60\n[[oscillator]]\namplitude_deg = 40\n[[oscillator]]\namplitude_deg = 60\n";

fn robot(name: &str) -> String {
    format!("{}/../robots/{name}", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn another_robot_walks_and_a_gait_that_does_not_fit_is_refused() {
    let folder = Folder::new("robot");
    folder.write("three.toml", THREE);
    let module = robot("module.toml");
    let args = [
        "sim",
        "three.toml",
        "--robot",
        &module,
        "-o",
        "out",
        "--json",
    ];
    let done = rb(&folder, &args).expect(0);
    let run = &done.json()["runs"][0];
    assert!(run["distance_m"].as_f64().unwrap() > 0.001, "{run}");
    let csv = std::fs::read_to_string(folder.path("out/three_1.csv")).unwrap();
    let head = csv.lines().next().unwrap();
    assert!(head.contains("link_position_rad_2,base_x_m"), "{head}");
    assert!(folder.path("out/robot.toml").exists());

    let six = rb(&folder, &["sim", &gait("crawl.toml"), "--robot", &module]).expect(2);
    assert!(six.err.contains("the robot has 3 motors"), "{}", six.err);
    // The meta-module as a file is the built-in one.
    let crawl = gait("crawl.toml");
    let built_in = rb(&folder, &["sim", &crawl, "--json"]).expect(0).json();
    let file = robot("metamodule.toml");
    let from_file = rb(&folder, &["sim", &crawl, "--robot", &file, "--json"]);
    assert_eq!(from_file.expect(0).json(), built_in);
}

#[test]
fn a_structure_that_is_no_robot_is_refused_with_its_line() {
    let folder = Folder::new("structure");
    folder.write("three.toml", THREE);
    let good = std::fs::read_to_string(robot("module.toml")).unwrap();
    for (old, new, said) in [
        ("format = 1", "format = 2", "bad.toml:2: format = 2"),
        (
            "parent = 2",
            "parent = 7",
            "bad.toml:23: body 3 (from 0) refers to 7",
        ),
        (
            "joint = 2",
            "joint = 1",
            "bad.toml:23: joint indices must count",
        ),
        ("motor = \"inter\"", "motor = \"none\"", "bad.toml:21: "),
        (
            "halves = [0, 1]",
            "halves = [0, 2]",
            "bad.toml:50: the halves of cube 0",
        ),
        (
            "cube_m = 0.11",
            "cube_m = 0.2",
            "bad.toml:1: ball radius 0.062 m",
        ),
    ] {
        assert!(good.contains(old), "{old}");
        folder.write("bad.toml", good.replacen(old, new, 1));
        let done = rb(&folder, &["sim", "three.toml", "--robot", "bad.toml"]).expect(3);
        assert!(done.err.contains(said), "{said}: {}", done.err);
    }
}
