//! JSON Schemas of the files, made from the tables that the readers use.
//!
//! They hold a file read as data (TOML tables are objects). What a schema cannot say, the readers still check: NaN and infinities, lengths in
//! bytes, as many phase lags as links of the chain, rings of links that close.

mod dataset;
mod gait;
mod model;
mod robot;

use serde_json::{Map, Value, json};

/// A file format that has a schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `gait.toml`.
    Gait,
    /// `model.toml`.
    Model,
    /// `robot.toml`.
    Robot,
    /// `dataset.toml`.
    Dataset,
}

impl Format {
    /// Every format.
    pub const ALL: [Format; 4] = [Format::Gait, Format::Model, Format::Robot, Format::Dataset];

    /// Name of the schema and of its file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Format::Gait => "gait",
            Format::Model => "model",
            Format::Robot => "robot",
            Format::Dataset => "dataset",
        }
    }

    /// The schema (draft 2020-12).
    #[must_use]
    pub fn schema(self) -> Value {
        match self {
            Format::Gait => gait::schema(),
            Format::Model => model::schema(),
            Format::Robot => robot::schema(),
            Format::Dataset => dataset::schema(),
        }
    }
}

/// The top of a schema: an object with these keys and no others.
fn document(title: &str, required: &[&str], properties: Map<String, Value>) -> Map<String, Value> {
    let mut out = closed(required, properties);
    let draft = "https://json-schema.org/draft/2020-12/schema";
    out.insert("$schema".to_owned(), draft.into());
    out.insert("title".to_owned(), title.into());
    out
}

/// An object with these keys and no others.
fn closed(required: &[&str], properties: Map<String, Value>) -> Map<String, Value> {
    let mut out = Map::new();
    out.insert("type".to_owned(), "object".into());
    if !required.is_empty() {
        out.insert("required".to_owned(), json!(required));
    }
    out.insert("properties".to_owned(), properties.into());
    out.insert("additionalProperties".to_owned(), false.into());
    out
}

/// A number in a closed interval; an infinite end is left open.
fn number(min: f64, max: f64) -> Value {
    let mut out = Map::new();
    out.insert("type".to_owned(), "number".into());
    for (key, end) in [("minimum", min), ("maximum", max)] {
        if end.is_finite() {
            out.insert(key.to_owned(), end.into());
        }
    }
    out.into()
}

fn described(mut schema: Value, text: &str) -> Value {
    if let Some(object) = schema.as_object_mut() {
        object.insert("description".to_owned(), text.into());
    }
    schema
}
