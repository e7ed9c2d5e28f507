//! What can be wrong in a data set, with the place and the reason.

/// An error that stops the reading of one file of a data set.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// The text is not TOML.
    #[error("{file}:{line}: not valid TOML: {reason}")]
    Toml {
        /// File name as given by the caller.
        file: String,
        /// Line, counted from 1.
        line: usize,
        /// The parser's reason.
        reason: String,
    },
    /// A required key is absent.
    #[error("{file}: key `{key}` is missing; {hint}")]
    MissingKey {
        /// File name.
        file: String,
        /// Full key.
        key: String,
        /// What to write.
        hint: &'static str,
    },
    /// A key has the wrong type or an unknown word.
    #[error("{file}:{line}: `{key}` must be {expected}, found {found}")]
    BadKey {
        /// File name.
        file: String,
        /// Line, counted from 1.
        line: usize,
        /// Full key.
        key: String,
        /// What is allowed.
        expected: String,
        /// What stands there.
        found: String,
    },
    /// The CSV reader could not split a line.
    #[error("{file}:{line}: not valid CSV: {reason}")]
    Csv {
        /// File name.
        file: String,
        /// Line, counted from 1.
        line: usize,
        /// The reader's reason.
        reason: String,
    },
    /// A required column is absent.
    #[error("{file}:1: column `{column}` is missing; {hint}")]
    MissingColumn {
        /// File name.
        file: String,
        /// Header name that was looked for.
        column: String,
        /// What to do.
        hint: String,
    },
    /// The same column stands twice.
    #[error("{file}:1: column `{column}` stands twice")]
    DoubleColumn {
        /// File name.
        file: String,
        /// Header name.
        column: String,
    },
    /// A cell is not a finite number.
    #[error(
        "{file}:{line}: column `{column}`: `{text}` is not a finite number; leave the cell empty where there is no sample"
    )]
    NotANumber {
        /// File name.
        file: String,
        /// Line, counted from 1.
        line: usize,
        /// Header name.
        column: String,
        /// The cell.
        text: String,
    },
    /// A value outside its physical range.
    #[error(
        "{file}:{line}: column `{column}`: {value} is outside {low} .. {high}; the unit must be the one in the header"
    )]
    Range {
        /// File name.
        file: String,
        /// Line, counted from 1.
        line: usize,
        /// Header name.
        column: String,
        /// The value.
        value: f64,
        /// Lowest allowed value.
        low: f64,
        /// Highest allowed value.
        high: f64,
    },
    /// Time runs backwards.
    #[error(
        "{file}:{line}: column `t_s`: {t_s} comes after {previous_s}; rows must be in order of time"
    )]
    TimeOrder {
        /// File name.
        file: String,
        /// Line, counted from 1.
        line: usize,
        /// Time of this row.
        t_s: f64,
        /// Time of the row before.
        previous_s: f64,
    },
    /// Fewer than two rows.
    #[error("{file}: only {rows} rows of data; a run needs at least 2")]
    TooShort {
        /// File name.
        file: String,
        /// Rows found.
        rows: usize,
    },
}

/// Something odd that does not stop the reading.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Warning {
    /// A key that this version does not know; it is ignored.
    #[error("{file}:{line}: unknown key `{key}` is ignored (known here: {known})")]
    UnknownKey {
        /// File name.
        file: String,
        /// Line, counted from 1.
        line: usize,
        /// Full key.
        key: String,
        /// Known keys of that table.
        known: String,
    },
    /// A column that this version does not know; it is ignored.
    #[error(
        "{file}:1: unknown column `{column}` is ignored; rename it under [signals] if it is one of the known signals"
    )]
    UnknownColumn {
        /// File name.
        file: String,
        /// Header name.
        column: String,
    },
    /// A column that `[signals]` names is not in this file.
    #[error(
        "{file}:1: column `{column}` is missing; [signals] says that `{name}` stands in it; taken as not measured in this run"
    )]
    Renamed {
        /// File name.
        file: String,
        /// Signal.
        name: String,
        /// Header name that was looked for.
        column: String,
    },
    /// A long stretch without rows.
    #[error("{file}:{line}: no row for {gap_s:.3} s, the usual step is {step_s:.4} s")]
    Gap {
        /// File name.
        file: String,
        /// Line after the gap, counted from 1.
        line: usize,
        /// Length of the gap.
        gap_s: f64,
        /// Median step.
        step_s: f64,
    },
    /// Two rows of one instant that both hold a value of the same column.
    #[error(
        "{file}:{line}: column `t_s`: {t_s} stands in two rows, and both hold a `{column}`; is a row written twice?"
    )]
    SameTime {
        /// File name.
        file: String,
        /// Line of the second row, counted from 1.
        line: usize,
        /// Header name.
        column: String,
        /// Time of both.
        t_s: f64,
    },
    /// One joint lacks a column that others have.
    #[error(
        "{file}:1: column `{column}` is missing, but other joints have theirs; taken as not measured"
    )]
    JointWithout {
        /// File name.
        file: String,
        /// Header name that was looked for.
        column: String,
    },
    /// A measured column that never changes.
    #[error("{file}: column `{column}` never changes; is the sensor connected?")]
    Constant {
        /// File name.
        file: String,
        /// Header name.
        column: String,
    },
}
