//! The published schemas: made from the readers' own tables, accept what the readers accept, refuse what they refuse.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use files::dataset::Manifest;
use files::model::{Effect, Model};
use files::schema::Format;
use files::structure::Structure;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A TOML file as the data that a schema speaks of.
fn data(text: &str) -> serde_json::Value {
    let table: toml::Table = text.parse().unwrap();
    serde_json::to_value(table).unwrap()
}

fn by_schema(format: Format, text: &str) -> Result<(), String> {
    let validator = jsonschema::validator_for(&format.schema()).unwrap();
    let data = data(text);
    let result = validator.validate(&data);
    result.map_err(|error| format!("{}: {error}", error.instance_path()))
}

fn by_reader(format: Format, text: &str) -> Result<(), String> {
    match format {
        Format::Gait => files::gait::parse("f", text)
            .map(drop)
            .map_err(|e| e.to_string()),
        Format::Model => Model::parse("f", text).map(drop).map_err(|e| e.to_string()),
        Format::Robot => Structure::parse("f", text)
            .map(drop)
            .map_err(|e| e.to_string()),
        Format::Dataset => Manifest::parse("f", text)
            .map(drop)
            .map_err(|e| e.to_string()),
    }
}

#[track_caller]
fn accepted(format: Format, text: &str) {
    assert_eq!(by_reader(format, text), Ok(()), "{text}");
    assert_eq!(by_schema(format, text), Ok(()), "{text}");
}

#[test]
fn published_schemas_are_those_of_the_readers() {
    for format in Format::ALL {
        let path = root().join(format!("docs/schema/{}.json", format.name()));
        let published: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        assert_eq!(
            published,
            format.schema(),
            "{}: run `cargo run -p files --example docs`",
            format.name()
        );
    }
}

#[test]
fn shipped_robots_fit() {
    for file in toml_files(&root().join("robots")) {
        accepted(Format::Robot, &std::fs::read_to_string(file).unwrap());
    }
}

fn toml_files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path());
    let is_toml = |p: &PathBuf| p.extension().is_some_and(|x| x == "toml");
    entries.filter(is_toml).collect()
}

#[test]
fn shipped_gaits_fit() {
    let mut files = toml_files(&root().join("gaits"));
    files.extend(toml_files(&root().join("gaits/searched")));
    assert!(files.len() >= 20);
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        accepted(Format::Gait, &text);
        // And in the form in which the tool writes it.
        let gait = files::gait::parse("f", &text).unwrap();
        accepted(Format::Gait, &files::gait::to_toml(&gait));
    }
}

#[test]
fn models_with_every_effect_fit() {
    accepted(Format::Model, &Model::hand_tuned().to_toml());
    let mut model = Model::meta_optimised();
    for effect in Effect::ALL.iter().copied() {
        let info = effect.info();
        let finite = |p: &files::model::EffectParam| p.neutral.clamp(p.min, p.max.min(1e3));
        let values: Vec<f64> = info.parameters.iter().map(finite).collect();
        let joint = info.per_joint().then_some(5);
        model.set_effect(effect, joint, &values).unwrap();
    }
    accepted(Format::Model, &model.to_toml());
    accepted(
        Format::Model,
        "format = 1\n[environment]\nfriction = { value = 0.4 }\n",
    );
}

const DATASET: &str = "format = 1\nrobot = \"bench\"\nname = \"demo\"\n[signals]\nposition_rad = \"q\"\n[bench]\ncommand = \"effort\"\n\
    inertia_kg_m2 = { value = 0.0049, tolerance = 0.1, source = \"scale\" }\nsupply_v = 7.4\n[bench.controller]\nkind = \"p\"\nkp = 1.0\n\
    [camera]\nheight_m = { value = 2.6, tolerance = 0.02 }\n[[run]]\nfile = \"a.csv\"\ngait = \"g1\"\nrole = \"fit\"\nframes = \"a\"\n\
    bench.controller.kp = 4.0\n";

#[test]
fn data_sets_fit() {
    accepted(Format::Dataset, DATASET);
    accepted(
        Format::Dataset,
        "format = 1\nrobot = \"metamodule\"\n[metamodule]\nmodel = \"model.toml\"\n[[run]]\nfile = \"a.csv\"\n",
    );
    // A key that nobody knows is a warning, not an error.
    accepted(Format::Dataset, &format!("operator = \"Ann\"\n{DATASET}"));
}

const GAIT: &str = "format = 1\nname = \"g\"\nfrequency_hz = 0.2\ncoupling = \"chain\"\nphase_lag_deg = [90]\n\
    [[oscillator]]\namplitude_deg = 20\n[[oscillator]]\namplitude_deg = 20\noffset_deg = 10\n";

/// One change each: what stood there, what stands there now.
const BROKEN: &[(Format, &str, &str)] = &[
    (Format::Gait, "format = 1", "format = 2"),
    (Format::Gait, "name = \"g\"", "name = \"\""),
    (Format::Gait, "name = \"g\"\n", ""),
    (Format::Gait, "frequency_hz = 0.2", "frequency_hz = 2.5"),
    (Format::Gait, "frequency_hz = 0.2", "frequency_hz = \"0.2\""),
    (Format::Gait, "frequency_hz = 0.2", "frequency = 0.2"),
    (Format::Gait, "coupling = \"chain\"", "coupling = \"ring\""),
    (Format::Gait, "coupling = \"chain\"", "coupling = \"none\""),
    (Format::Gait, "coupling = \"chain\"\n", ""),
    (
        Format::Gait,
        "phase_lag_deg = [90]",
        "phase_lag_deg = [900]",
    ),
    (
        Format::Gait,
        "phase_lag_deg = [90]",
        "phase_lag_deg = [90]\nphase_lag_rad = [1]",
    ),
    (Format::Gait, "offset_deg = 10", "offset_deg = 181"),
    (
        Format::Gait,
        "offset_deg = 10",
        "offset_deg = 10\noffset_rad = 0.1",
    ),
    (Format::Gait, "offset_deg = 10", "offset = 10"),
    (Format::Gait, "amplitude_deg = 20\noffset_deg", "offset_deg"),
    (Format::Model, "format = 1", "format = 3"),
    (Format::Model, "friction", "fricton"),
    (Format::Model, "value = 0.4", "value = -0.4"),
    (Format::Model, "value = 0.4", "valu = 0.4"),
    (Format::Model, "value = 0.4", "value = 0.4, tolerance = -1"),
    (Format::Model, "joint_2", "joint_6"),
    (Format::Model, "coulomb_friction", "coulomb_frictions"),
    (Format::Model, "torque_nm", "torque"),
    (Format::Robot, "format = 1", "format = 0"),
    (Format::Robot, "cube_m = 0.11", "cube_m = 11"),
    (Format::Robot, "motor = \"intra\"", "motor = \"servo\""),
    (Format::Robot, "offset_m = [0, 0, 0]", "offset_m = [0, 0]"),
    (
        Format::Robot,
        "offset_m = [0.11, 0, 0]",
        "offset_m = [110, 0, 0]",
    ),
    (Format::Robot, "centre_m = [0, 0, 0]\n", ""),
    (
        Format::Robot,
        "centre_m = [0, 0, 0]\n",
        "centre_m = [0, 0, 0]\nmass_kg = 0\n",
    ),
    (Format::Robot, "halves = [0, 1]", "halves = [0, -1]"),
    (Format::Robot, "parent = 2", "parnt = 2"),
    (Format::Dataset, "robot = \"bench\"", "robot = \"arm\""),
    (Format::Dataset, "robot = \"bench\"\n", ""),
    (
        Format::Dataset,
        "command = \"effort\"",
        "command = \"torque\"",
    ),
    (Format::Dataset, "value = 0.0049", "value = -1"),
    (Format::Dataset, "supply_v = 7.4", "supply_v = \"7.4\""),
    (Format::Dataset, "role = \"fit\"", "role = \"train\""),
    (Format::Dataset, "file = \"a.csv\"\n", ""),
    (Format::Dataset, "kp = 4.0", "kp = -4.0"),
];

#[test]
fn what_the_readers_refuse_the_schemas_refuse() {
    const MODEL: &str = "format = 1\n[environment]\nfriction = { value = 0.4 }\n[effect.coulomb_friction.joint_2]\ntorque_nm = { value = 0.3 }\n";
    for (format, old, new) in BROKEN {
        let good = match format {
            Format::Gait => GAIT,
            Format::Model => MODEL,
            Format::Robot => include_str!("../../robots/module.toml"),
            Format::Dataset => DATASET,
        };
        accepted(*format, good);
        assert!(good.contains(old), "{old}");
        let text = good.replacen(old, new, 1);
        assert!(by_reader(*format, &text).is_err(), "reader accepts {text}");
        assert!(by_schema(*format, &text).is_err(), "schema accepts {text}");
    }
}
