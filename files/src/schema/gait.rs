//! Schema of `gait.toml`.

use super::{closed, document, number};
use crate::gait::{FORMAT, neat, neat_degrees};
use control::gait::{
    AMPLITUDE_RAD, DURATION_S, FREQUENCY_HZ, MAX_LINKS, MAX_NAME, MAX_OSCILLATORS, OFFSET_RAD,
    PHASE_RAD, RATE_A_PER_S, Range, WEIGHT,
};
use serde_json::{Map, Value, json};

fn within(range: Range) -> Value {
    number(neat(range.min), neat(range.max))
}

/// An angle's two keys, of which a file has at most one.
fn angle(keys: &mut Map<String, Value>, base: &str, range: Range, list: bool) {
    let degrees = |rad: f32| neat_degrees(rad.into());
    let deg = number(degrees(range.min), degrees(range.max));
    for (unit, one) in [("deg", deg), ("rad", within(range))] {
        let many = json!({ "type": "array", "items": one, "maxItems": MAX_OSCILLATORS - 1 });
        let value = if list { many } else { one };
        keys.insert(format!("{base}_{unit}"), value);
    }
}

/// Not both units of an angle.
fn one_unit(base: &str) -> Value {
    json!({ "not": { "required": [format!("{base}_deg"), format!("{base}_rad")] } })
}

/// Exactly one unit of an angle.
fn needs(base: &str) -> Value {
    json!({ "oneOf": [{ "required": [format!("{base}_deg")] }, { "required": [format!("{base}_rad")] }] })
}

fn object(required: &[&str], keys: Map<String, Value>, rules: Vec<Value>) -> Value {
    let mut out = closed(required, keys);
    out.insert("allOf".to_owned(), rules.into());
    out.into()
}

pub(super) fn schema() -> Value {
    let mut oscillator = Map::new();
    angle(&mut oscillator, "amplitude", AMPLITUDE_RAD, false);
    angle(&mut oscillator, "offset", OFFSET_RAD, false);
    angle(&mut oscillator, "initial_phase", PHASE_RAD, false);
    let rules = vec![
        needs("amplitude"),
        one_unit("offset"),
        one_unit("initial_phase"),
    ];
    let oscillator = object(&[], oscillator, rules);

    let end = json!({ "type": "integer", "minimum": 0, "maximum": MAX_OSCILLATORS - 1 });
    let mut link = Map::new();
    link.insert("from".to_owned(), end.clone());
    link.insert("to".to_owned(), end);
    link.insert("weight".to_owned(), within(WEIGHT));
    angle(&mut link, "phase_lag", PHASE_RAD, false);
    let link = object(&["from", "to"], link, vec![needs("phase_lag")]);

    let mut top = Map::new();
    top.insert("format".to_owned(), json!({ "const": FORMAT }));
    let name = json!({ "type": "string", "minLength": 1, "maxLength": MAX_NAME, "pattern": "\\S" });
    top.insert("name".to_owned(), name);
    for (key, range) in [
        ("frequency_hz", FREQUENCY_HZ),
        ("duration_s", DURATION_S),
        ("rate_a_per_s", RATE_A_PER_S),
        ("weight", WEIGHT),
    ] {
        top.insert(key.to_owned(), within(range));
    }
    top.insert("coupling".to_owned(), json!({ "enum": ["chain", "none"] }));
    angle(&mut top, "phase_lag", PHASE_RAD, true);
    let many = |of: Value, min: usize, max: usize| json!({ "type": "array", "items": of, "minItems": min, "maxItems": max });
    top.insert(
        "oscillator".to_owned(),
        many(oscillator, 1, MAX_OSCILLATORS),
    );
    top.insert("link".to_owned(), many(link, 0, MAX_LINKS));
    let mut out = document(
        "gait.toml",
        &["format", "name", "frequency_hz", "oscillator"],
        top,
    );
    // Either a word for the coupling or a list of links; lags and weight belong to the chain.
    let chain_keys = ["coupling", "weight", "phase_lag_deg", "phase_lag_rad"];
    let any_of =
        |keys: &[&str]| -> Vec<Value> { keys.iter().map(|k| json!({ "required": [k] })).collect() };
    let with_links = json!({ "required": ["link"], "not": { "anyOf": any_of(&chain_keys) } });
    let chain = json!({ "properties": { "coupling": { "const": "chain" } }, "required": ["coupling"], "not": { "required": ["link"] } });
    let none = json!({
        "properties": { "coupling": { "const": "none" } }, "required": ["coupling"],
        "not": { "anyOf": any_of(&["link", "weight", "phase_lag_deg", "phase_lag_rad"]) },
    });
    out.insert("oneOf".to_owned(), json!([chain, none, with_links]));
    out.insert("allOf".to_owned(), json!([one_unit("phase_lag")]));
    out.into()
}
