//! [`Model`] to text.

use super::{FORMAT, Key, Model, Parameter};
use std::fmt::Write as _;

pub(super) fn to_toml(model: &Model) -> String {
    let mut out = format!("format = {FORMAT}\nname = {}\n", quoted(model.name()));
    let mut table = "";
    for key in Key::ALL {
        let info = key.info();
        if info.table != table {
            table = info.table;
            let _ = write!(out, "\n[{table}]\n");
        }
        let _ = writeln!(
            out,
            "{} = {} # {}",
            info.key,
            inline(model.parameter(key)),
            info.meaning
        );
    }
    for entry in model.effects() {
        let info = entry.effect.info();
        let _ = match entry.joint {
            Some(joint) => write!(out, "\n[effect.{}.joint_{joint}]\n", info.name),
            None => write!(out, "\n[effect.{}]\n", info.name),
        };
        for (d, p) in info.parameters.iter().zip(&entry.parameters) {
            let _ = writeln!(out, "{} = {}", d.key, inline(p));
        }
    }
    out
}

fn inline(p: &Parameter) -> String {
    format!(
        "{{ value = {}, tolerance = {}, source = {} }}",
        number(p.value),
        number(p.tolerance),
        quoted(&p.source)
    )
}

/// Shortest decimal that reads back to the same bits; `{:?}` of f64 guarantees it and always marks a float.
fn number(value: f64) -> String {
    format!("{value:?}")
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}
