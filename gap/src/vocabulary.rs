//! Names of stages and effects: the registry of `files`.

pub use files::effects::{Effect, Stage};
