//! Schema of `dataset.toml`. Keys that nobody knows are allowed, as the reader only warns of them.

use super::{described, number};
use crate::dataset::bounds::{CAMERA_KEYS, CAMERA_LIMIT, HIGH, PERIOD_S, POSITIVE};
use crate::model::Key;
use serde_json::{Map, Value, json};

/// A number, or `{ value, tolerance }` with the relative tolerance of one standard deviation.
fn quantity(min: f64, max: f64) -> Value {
    json!({ "oneOf": [
        number(min, max),
        { "type": "object", "required": ["value"], "properties": {
            "value": number(min, max), "tolerance": number(0.0, 10.0) } },
    ] })
}

fn object(properties: Map<String, Value>) -> Value {
    json!({ "type": "object", "properties": properties })
}

fn controller() -> Value {
    let mut keys = Map::new();
    let kinds = json!({ "enum": ["p", "pid", "cascade"] });
    keys.insert("kind".to_owned(), kinds);
    let outputs = json!({ "enum": ["duty", "voltage", "effort", "velocity"] });
    keys.insert("output".to_owned(), outputs);
    for key in ["kp", "ki", "kd", "kv"] {
        keys.insert(key.to_owned(), quantity(0.0, HIGH));
    }
    keys.insert("limit".to_owned(), quantity(POSITIVE, HIGH));
    keys.insert("period_s".to_owned(), quantity(PERIOD_S, HIGH));
    object(keys)
}

fn bench() -> Value {
    let mut keys = Map::new();
    let commands = json!({ "enum": ["position", "effort", "voltage"] });
    keys.insert("command".to_owned(), commands);
    keys.insert("motion".to_owned(), json!({ "enum": ["rotary", "linear"] }));
    for key in [
        "inertia_kg_m2",
        "mass_kg",
        "supply_v",
        "effort_per_volt",
        "max_speed_rad_s",
        "max_speed_m_s",
        "max_effort_nm",
        "max_effort_n",
    ] {
        keys.insert(key.to_owned(), quantity(POSITIVE, HIGH));
    }
    for key in ["gravity_nm", "gravity_n"] {
        keys.insert(key.to_owned(), quantity(-HIGH, HIGH));
    }
    keys.insert("controller".to_owned(), controller());
    object(keys)
}

fn text() -> Value {
    json!({ "type": "string" })
}

fn metamodule() -> Value {
    let supply = Key::SupplyVoltage.info();
    json!({ "type": "object", "properties": {
        "model": described(text(), "model.toml, relative to the folder"),
        "supply_v": described(quantity(supply.min, supply.max), "supply voltage without load, where it is not the model's"),
    } })
}

pub(super) fn schema() -> Value {
    let run = json!({ "type": "object", "required": ["file"], "properties": {
        "file": described(text(), "CSV file, relative to the folder"),
        "gait": described(text(), "runs of one gait repeat each other; the file's name when absent"),
        "role": { "enum": ["fit", "check"] },
        "frames": described(text(), "folder of silhouettes with index.csv"),
        "bench": described(bench(), "what differs in this run"),
    } });
    let camera = CAMERA_KEYS.map(|key| (key.to_owned(), quantity(-CAMERA_LIMIT, CAMERA_LIMIT)));
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "dataset.toml",
        "type": "object",
        "required": ["format", "robot", "run"],
        "properties": {
            "format": { "const": 1 },
            "robot": { "enum": ["bench", "metamodule"] },
            "name": text(),
            "signals": described(json!({ "type": "object", "additionalProperties": text() }), "our header name to the name in the CSV files"),
            "bench": bench(),
            "metamodule": metamodule(),
            "camera": object(camera.into_iter().collect()),
            "run": { "type": "array", "minItems": 1, "items": run },
        },
    })
}
