//! What can be wrong with a gait file, said so that the author can mend it without reading this code.

use core::fmt;

/// A gait file that was refused: where, and what is wrong there.
#[derive(Debug, Clone, PartialEq)]
pub struct GaitFileError {
    /// File name as given by the caller, cleaned of control characters.
    pub file: String,
    /// Line of the offending text, from 1.
    pub line: usize,
    /// Column of the offending text in characters, from 1.
    pub column: usize,
    /// The source line, cleaned of control characters and cut to a screen's width.
    pub source_line: String,
    /// What is wrong.
    pub problem: Box<Problem>,
}

/// The closed list of reasons to refuse a gait file.
///
/// Text taken from the file is cleaned of control characters and cut before it is stored here.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// The file is larger than any gait can be.
    #[error("the file has {bytes} bytes, a gait file has at most {max}; is this another file?")]
    TooLarge {
        /// Size of the file.
        bytes: usize,
        /// Largest accepted size.
        max: usize,
    },
    /// Not TOML.
    #[error("not valid TOML: {parser}")]
    Syntax {
        /// The TOML parser's own words.
        parser: ParserText,
    },
    /// A required key is missing.
    #[error("{key} is missing; add a line such as `{example}`")]
    Missing {
        /// The key.
        key: &'static str,
        /// A valid line.
        example: &'static str,
    },
    /// A key this format does not know.
    #[error("unknown key `{key}`{}; known here: {known}", Hint(.suggestion))]
    UnknownKey {
        /// The key as written.
        key: Excerpt,
        /// The nearest known key, if one is near.
        suggestion: Option<&'static str>,
        /// All keys known at this place.
        known: KeyList,
    },
    /// An angle without a unit.
    #[error("`{key}` has no unit; write `{key}_deg` or `{key}_rad`")]
    NoUnit {
        /// The key without unit.
        key: &'static str,
    },
    /// The same angle in both units.
    #[error("`{key}_deg` and `{key}_rad` are both given; keep one of them")]
    TwoUnits {
        /// The key without unit.
        key: &'static str,
    },
    /// A value of another type.
    #[error("{key} is {found}, expected {expected}")]
    WrongType {
        /// The key.
        key: &'static str,
        /// What the file has.
        found: &'static str,
        /// What belongs there.
        expected: &'static str,
    },
    /// Hexadecimal, octal or binary where a quantity belongs.
    #[error("{key} = {value} is not written in decimal; quantities are decimal numbers")]
    NotDecimal {
        /// The key.
        key: &'static str,
        /// As written.
        value: Excerpt,
    },
    /// NaN, infinity, or a number too large for a float.
    #[error("{key} = {value} is not a finite number; allowed: {min} to {max} {unit}")]
    NotFinite {
        /// The key.
        key: &'static str,
        /// As written.
        value: Excerpt,
        /// Smallest allowed value in the unit of the key.
        min: f64,
        /// Largest allowed value in the unit of the key.
        max: f64,
        /// Unit of the key.
        unit: &'static str,
    },
    /// A number outside its range.
    #[error("{key} = {value} is out of range; allowed: {min} to {max} {unit}")]
    OutOfRange {
        /// The key.
        key: &'static str,
        /// As written.
        value: Excerpt,
        /// Smallest allowed value in the unit of the key.
        min: f64,
        /// Largest allowed value in the unit of the key.
        max: f64,
        /// Unit of the key.
        unit: &'static str,
    },
    /// A format this version does not read.
    #[error("format = {value}; this version reads format = {supported}")]
    Format {
        /// As written.
        value: Excerpt,
        /// The format this version reads.
        supported: i64,
    },
    /// A name that cannot be shown or stored.
    #[error("name has {bytes} bytes; allowed: 1 to {max} bytes of printable text")]
    NameLength {
        /// Length of the name.
        bytes: usize,
        /// Largest length.
        max: usize,
    },
    /// A control character in the name.
    #[error("name holds the control character {character}; use printable text")]
    NameCharacter {
        /// Escaped form of the character.
        character: Excerpt,
    },
    /// Not one of a few words.
    #[error("{key} = {value}; allowed: {allowed}")]
    NotOneOf {
        /// The key.
        key: &'static str,
        /// As written.
        value: Excerpt,
        /// The words.
        allowed: &'static str,
    },
    /// A list or a table array of the wrong length.
    #[error("{key} has {found} entries; allowed: {min} to {max}{why}")]
    Count {
        /// The key.
        key: &'static str,
        /// Entries in the file.
        found: usize,
        /// Fewest entries.
        min: usize,
        /// Most entries.
        max: usize,
        /// Why, starting with a separator, or empty.
        why: &'static str,
    },
    /// Two keys that exclude each other.
    #[error("{key} does not go with {other}; remove one of them")]
    Conflict {
        /// The key found here.
        key: &'static str,
        /// What it conflicts with.
        other: &'static str,
    },
    /// A link with an end that is no oscillator, or from an oscillator to itself, or given twice.
    #[error("link {from} -> {to}: {why}; oscillators are 0 to {last}")]
    Link {
        /// First end.
        from: i64,
        /// Second end.
        to: i64,
        /// What is wrong.
        why: &'static str,
        /// Index of the last oscillator.
        last: usize,
    },
    /// Some oscillators have an initial phase and some have none.
    #[error(
        "initial_phase is given for some oscillators only; give it for all, or for none to start phase-locked"
    )]
    SomePhases,
    /// Without initial phases the lags must fix them.
    #[error(
        "the phase lags around a loop do not add up to a full turn, so no phase-locked start exists; give initial_phase for every oscillator"
    )]
    OpenLoop,
    /// Refused by the control law for a reason this reader does not check itself.
    #[error("refused by the control law: {0}")]
    Law(#[source] control::gait::GaitError),
}

/// Words of the TOML parser, cleaned and cut.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ParserText(pub(crate) Excerpt);

impl fmt::Display for ParserText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// A piece of the file, safe to print: control characters escaped, at most [`Excerpt::MAX`] characters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Excerpt(String);

impl Excerpt {
    /// Longest excerpt in characters; a terminal line.
    pub const MAX: usize = 100;

    /// Cleans `text`.
    #[must_use]
    pub fn new(text: &str) -> Self {
        let mut out = String::new();
        for (i, c) in text.chars().enumerate() {
            if i == Self::MAX {
                out.push('…');
                break;
            }
            if c == '\t' {
                out.push(' ');
            } else if is_unprintable(c) {
                out.extend(c.escape_unicode());
            } else {
                out.push(c);
            }
        }
        Self(out)
    }

    /// The cleaned text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Excerpt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Control characters, and the invisible ones that reorder or hide text on a terminal.
pub(crate) fn is_unprintable(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{2069}' | '\u{feff}')
}

/// Keys for a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeyList(pub(crate) &'static [&'static str]);

impl fmt::Display for KeyList {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, key) in self.0.iter().enumerate() {
            if i > 0 {
                f.write_str(", ")?;
            }
            f.write_str(key)?;
        }
        Ok(())
    }
}

/// `, did you mean X?` or nothing.
struct Hint<'a>(&'a Option<&'static str>);

impl fmt::Display for Hint<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some(key) => write!(f, ", did you mean `{key}`?"),
            None => Ok(()),
        }
    }
}

impl fmt::Display for GaitFileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}:{}:{}: {}",
            self.file, self.line, self.column, self.problem
        )?;
        if !self.source_line.is_empty() {
            write!(f, "\n  {:>4} | {}", self.line, self.source_line)?;
        }
        Ok(())
    }
}

impl std::error::Error for GaitFileError {}
