//! `rb-host model` and the check of data set folders.

use crate::rig::{Folder, gait, rb};

#[test]
fn schemas_are_printed_as_published() {
    let folder = Folder::new("schema");
    for (name, file) in [
        ("gait", "gait.json"),
        ("model", "model.json"),
        ("dataset", "dataset.json"),
        ("verdict", "gap-1.json"),
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
    assert_eq!(value["values"].as_array().unwrap().len(), 28);
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
