//! What a verdict says, in version 1 (an effect on a joint a row) or 2 (causes with a scope).

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Value, json};

/// A cause that was said.
#[derive(Clone, Debug, PartialEq)]
pub struct Said {
    /// Effect and joints; the first is what was named, the others cannot be told from it.
    pub options: Vec<(String, BTreeSet<usize>)>,
    /// Stated probability.
    pub probability: Option<f64>,
    /// Numbers by their keys: `{value, ci95, by_joint}`.
    pub values: Value,
    /// Stage.
    pub stage: String,
}

fn list(v: &Value) -> &[Value] {
    v.as_array().map(Vec::as_slice).unwrap_or_default()
}

fn effect(v: &Value) -> String {
    v["effect"].as_str().unwrap_or("").to_owned()
}

/// Joints of a cause, a place or a member of a class; none for what the robot has once.
pub(super) fn joints(v: &Value) -> BTreeSet<usize> {
    if v["scope"] == "robot" {
        return BTreeSet::new();
    }
    let many = list(&v["joints"]).iter().filter_map(Value::as_u64);
    let one = v["joint"].as_u64();
    many.chain(one).map(|j| j as usize).collect()
}

/// Ends of a 95 % interval.
pub(super) fn interval(v: &Value) -> Option<[f64; 2]> {
    Some([v["ci95"][0].as_f64()?, v["ci95"][1].as_f64()?])
}

/// Causes said, the first first.
pub(super) fn said(verdict: &Value) -> Vec<Said> {
    match verdict["causes"].as_array() {
        Some(causes) => causes.iter().map(cause).collect(),
        None => effects(verdict),
    }
}

fn cause(c: &Value) -> Said {
    let own = joints(c);
    let alike = list(&c["alternatives"])
        .iter()
        .filter(|a| a["distinguishable"] == false);
    let other = |a: &Value| {
        let placed = !a["joints"].is_null() || !a["joint"].is_null() || !a["scope"].is_null();
        let place = if placed { joints(a) } else { own.clone() };
        (effect(a), place)
    };
    let mut options = vec![(effect(c), own.clone())];
    options.extend(alike.map(other));
    Said {
        options,
        probability: c["probability"].as_f64(),
        values: c["values"].clone(),
        stage: c["stage"].as_str().unwrap_or("").to_owned(),
    }
}

/// Version 1: equal effects on several joints are one shared cause, and those of a compound.
fn effects(verdict: &Value) -> Vec<Said> {
    let p = |key: &str| verdict["probabilities"][key].as_f64().unwrap_or(0.0);
    let sure = 1.0 - p("none") - p("unknown");
    let mut order: Vec<String> = Vec::new();
    let mut groups: BTreeMap<String, Vec<&Value>> = BTreeMap::new();
    for e in list(&verdict["effects"]) {
        let name = e["part_of"].as_str().map_or(effect(e), str::to_owned);
        if !groups.contains_key(&name) {
            order.push(name.clone());
        }
        groups.entry(name).or_default().push(e);
    }
    let of = |name: String| {
        let rows = &groups[&name];
        let own: BTreeSet<usize> = rows.iter().flat_map(|e| joints(e)).collect();
        let mut options = vec![(name, own.clone())];
        for class in list(&verdict["ambiguous"]) {
            let members = list(&class["members"]);
            let mine = |m: &Value| {
                let alike = |e: &&Value| e["effect"] == m["effect"] && e["joint"] == m["joint"];
                rows.iter().any(alike)
            };
            if !members.iter().any(mine) {
                continue;
            }
            for m in members {
                let place = joints(m);
                let shared = own.len() > 1 && !place.is_empty();
                let option = (effect(m), if shared { own.clone() } else { place });
                if !options.contains(&option) {
                    options.push(option);
                }
            }
        }
        Said {
            options,
            probability: Some(sure),
            values: values(rows),
            stage: rows[0]["stage"].as_str().unwrap_or("").to_owned(),
        }
    };
    order.into_iter().map(of).collect()
}

/// A value where there is none yet: of a compound the first effect's.
fn keep(slot: &mut Value, x: &Value) {
    if slot.is_null() {
        *slot = x.clone();
    }
}

/// Parameters of effects on several joints, as version 2 has them.
fn values(rows: &[&Value]) -> Value {
    let mut out = json!({});
    for e in rows {
        for (key, x) in e["parameters"].as_object().into_iter().flatten() {
            match e["joint"].as_u64() {
                Some(joint) => keep(&mut out[key]["by_joint"][joint.to_string()], x),
                None => keep(&mut out[key], x),
            }
        }
    }
    out
}
