//! What can be wrong with a scenario file.

use thiserror::Error;

use crate::effects::EffectError;
use crate::motor::ParamError;

/// A scenario that cannot be used, with its place.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{file}:{line}: {problem}")]
pub struct ScenarioError {
    /// File as named by the caller.
    pub file: String,
    /// Line, from 1.
    pub line: usize,
    /// What is wrong.
    pub problem: Box<ScenarioProblem>,
}

/// What is wrong.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ScenarioProblem {
    /// No TOML.
    #[error("not valid TOML: {0}")]
    Syntax(toml::de::Error),
    /// Too long to be a scenario.
    #[error("{bytes} bytes; a scenario has at most {limit}")]
    TooLong {
        /// Length.
        bytes: usize,
        /// Limit.
        limit: usize,
    },
    /// A key that must be there is not.
    #[error("{table} needs `{key}`")]
    Missing {
        /// Table.
        table: String,
        /// Key.
        key: &'static str,
    },
    /// A key nobody reads.
    #[error("{table} has no key `{key}`; known: {known}")]
    UnknownKey {
        /// Table.
        table: String,
        /// Key given.
        key: String,
        /// Keys that exist.
        known: String,
    },
    /// A value of another kind.
    #[error("`{key}` must be {expected}")]
    WrongType {
        /// Key.
        key: String,
        /// What is expected.
        expected: &'static str,
    },
    /// A number outside its range.
    #[error("`{key}` = {value} is outside {min} to {max}")]
    OutOfRange {
        /// Key.
        key: String,
        /// Value.
        value: f64,
        /// Smallest.
        min: f64,
        /// Largest.
        max: f64,
    },
    /// A word that is not in the list.
    #[error("`{key}` = \"{word}\" is unknown; known: {known}")]
    UnknownWord {
        /// Key.
        key: &'static str,
        /// Word given.
        word: String,
        /// Words that exist.
        known: String,
    },
    /// A table that only the robot on the ground has.
    #[error("[{table}] needs the whole robot: write `body = \"ground\"`")]
    NeedsGround {
        /// Table.
        table: &'static str,
    },
    /// A key that only the robot on the ground has.
    #[error("`{key}` needs the whole robot: write `body = \"ground\"`")]
    KeyNeedsGround {
        /// Key.
        key: &'static str,
    },
    /// A camera that cannot exist.
    #[error(transparent)]
    View(camera::ViewError),
    /// A window that ends before it begins.
    #[error("to_s must be later than from_s")]
    EmptyWindow,
    /// An effect that does not exist or cannot have this value.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// A joint that cannot exist.
    #[error(transparent)]
    Joint(#[from] ParamError),
}
