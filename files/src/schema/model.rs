//! Schema of `model.toml`.

use super::{closed, described, document, number};
use crate::model::{Effect, FORMAT, JOINTS, Key};
use serde_json::{Map, Value, json};

/// `{ value, tolerance, source }`.
fn parameter(min: f64, max: f64, meaning: &str) -> Value {
    let mut keys = Map::new();
    keys.insert("value".to_owned(), number(min, max));
    keys.insert("tolerance".to_owned(), number(0.0, f64::INFINITY));
    keys.insert("source".to_owned(), json!({ "type": "string" }));
    described(closed(&["value"], keys).into(), meaning)
}

fn unit(unit: &'static str) -> &'static str {
    if unit == "1" { "no unit" } else { unit }
}

fn effect(of: Effect) -> Value {
    let info = of.info();
    let parameters = info
        .parameters
        .iter()
        .map(|p| (p.key.to_owned(), parameter(p.min, p.max, unit(p.unit))));
    let one: Value = closed(&[], parameters.collect()).into();
    if !info.per_joint() {
        return described(one, info.plain);
    }
    let joints = (0..JOINTS).map(|joint| (format!("joint_{joint}"), one.clone()));
    described(closed(&[], joints.collect()).into(), info.plain)
}

pub(super) fn schema() -> Value {
    let mut top = Map::new();
    top.insert("format".to_owned(), json!({ "const": FORMAT }));
    top.insert("name".to_owned(), json!({ "type": "string" }));
    for key in Key::ALL {
        let info = key.info();
        let table = top
            .entry(info.table)
            .or_insert_with(|| closed(&[], Map::new()).into());
        if let Some(keys) = table["properties"].as_object_mut() {
            let one = parameter(info.min, info.max, info.meaning);
            keys.insert(info.key.to_owned(), one);
        }
    }
    let effects = Effect::ALL
        .iter()
        .map(|&e| (e.name().to_owned(), effect(e)));
    top.insert("effect".to_owned(), closed(&[], effects.collect()).into());
    document("model.toml", &["format"], top).into()
}
