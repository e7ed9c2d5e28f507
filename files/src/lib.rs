//! The files people write: gait.toml, model.toml, robot.toml, dataset.toml and its CSV, parsed once into valid types with errors that name file, line and range.
#![forbid(unsafe_code)]

pub mod dataset;
pub mod effects;
pub mod gait;
pub mod model;
pub mod schema;
pub mod structure;
