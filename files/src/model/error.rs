//! What can be wrong with a model file, and what to do about it.

/// Why a model was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// Not TOML.
    #[error("{file}:{line}: not valid TOML: {message}")]
    Syntax {
        /// File name as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What the TOML reader says.
        message: String,
    },
    /// A key that the format does not know.
    #[error("{file}:{line}: unknown key `{key}`; known here: {known}")]
    UnknownKey {
        /// File name as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// The key with its table.
        key: String,
        /// Keys that may stand there.
        known: String,
    },
    /// A value of the wrong type.
    #[error("{file}:{line}: `{key}` must be {expected}")]
    Type {
        /// File name as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// The key with its table.
        key: String,
        /// What belongs there.
        expected: &'static str,
    },
    /// A key that must be present is not.
    #[error("{file}:{line}: `{key}` is missing, add it")]
    Missing {
        /// File name as given.
        file: String,
        /// Line of the table it belongs to, from 1.
        line: usize,
        /// The key with its table.
        key: String,
    },
    /// A valid number at the wrong place or size, found while reading a file.
    #[error("{file}:{line}: {source}")]
    At {
        /// File name as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        source: Box<ModelError>,
    },
    /// The file format is newer or not given.
    #[error("{file}:{line}: format = {found}, this program reads format = 1")]
    Format {
        /// File name as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What the file says.
        found: i64,
    },
    /// Not finite or outside the range.
    #[error("`{key}` is {value}, allowed is {min} to {max}")]
    ValueOutOfRange {
        /// The key with its table.
        key: String,
        /// The refused value.
        value: f64,
        /// Smallest accepted value.
        min: f64,
        /// Largest accepted value.
        max: f64,
    },
    /// A tolerance must be a finite number, zero or larger.
    #[error("the tolerance of `{key}` is {value}; give one standard deviation, zero or larger")]
    ToleranceOutOfRange {
        /// The key with its table.
        key: String,
        /// The refused value.
        value: f64,
    },
    /// `joint_K` on an effect that exists once, or missing on one that exists per joint.
    #[error("effect `{effect}` {}", if *per_joint { "exists per joint: write [effect.NAME.joint_K], K = 0 to 5" } else { "exists once: write [effect.NAME]" })]
    EffectJoint {
        /// Name of the effect.
        effect: &'static str,
        /// Whether it exists per joint.
        per_joint: bool,
    },
    /// Wrong number of parameters.
    #[error("effect `{effect}` takes {expected} parameters, {found} were given")]
    EffectParameters {
        /// Name of the effect.
        effect: &'static str,
        /// How many it takes.
        expected: usize,
        /// How many were given.
        found: usize,
    },
}
