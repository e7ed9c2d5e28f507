//! A walk over a parsed TOML table that keeps the place of every value, so that each error names its line.

use core::ops::Range as Span;

use control::gait::Range;
use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

use super::error::{Excerpt, GaitFileError, KeyList, Problem};

/// Tables with the byte each begins at, and the byte of their list.
pub(super) type Tables<'s> = (Vec<(&'s DeTable<'s>, usize)>, usize);

/// The file being read.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) file: &'a str,
    pub(super) text: &'a str,
}

/// A number with the place and the words it was written in.
pub(super) struct Number<'a> {
    pub(super) text: &'a str,
    pub(super) span: Span<usize>,
}

/// A closed interval with its unit, in the unit of the key.
#[derive(Clone, Copy)]
pub(super) struct Allowed {
    pub(super) min: f64,
    pub(super) max: f64,
    pub(super) unit: &'static str,
}

impl<'a> Source<'a> {
    pub(super) fn error(&self, at: usize, problem: Problem) -> GaitFileError {
        let at = at.min(self.text.len());
        let before = self.text.get(..at).unwrap_or("");
        let start = before.rfind('\n').map_or(0, |i| i + 1);
        let line_text = self.text.get(start..).unwrap_or("");
        let line_text = line_text.lines().next().unwrap_or("");
        GaitFileError {
            file: Excerpt::new(self.file).as_str().to_owned(),
            line: before.matches('\n').count() + 1,
            column: before.get(start..).unwrap_or("").chars().count() + 1,
            source_line: Excerpt::new(line_text).as_str().to_owned(),
            problem: Box::new(problem),
        }
    }

    pub(super) fn excerpt(&self, span: &Span<usize>) -> Excerpt {
        Excerpt::new(self.text.get(span.clone()).unwrap_or(""))
    }

    /// A decimal number; anything else is an error naming `key`.
    pub(super) fn number<'v>(
        &self,
        key: &'static str,
        value: &'v Spanned<DeValue<'a>>,
    ) -> Result<Number<'v>, GaitFileError> {
        let span = value.span();
        let text = match value.get_ref() {
            DeValue::Float(float) => float.as_str(),
            DeValue::Integer(integer) if integer.radix() == 10 => integer.as_str(),
            DeValue::Integer(_) => {
                let value = self.excerpt(&span);
                return Err(self.error(span.start, Problem::NotDecimal { key, value }));
            }
            other => return Err(self.wrong_type(key, &span, other, "a number")),
        };
        Ok(Number { text, span })
    }

    pub(super) fn wrong_type(
        &self,
        key: &'static str,
        span: &Span<usize>,
        found: &DeValue<'_>,
        expected: &'static str,
    ) -> GaitFileError {
        let found = type_name(found);
        let problem = Problem::WrongType {
            key,
            found,
            expected,
        };
        self.error(span.start, problem)
    }

    /// The number in the unit of its key, if it is finite and allowed.
    pub(super) fn in_range(
        &self,
        key: &'static str,
        number: &Number<'_>,
        allowed: Allowed,
    ) -> Result<f64, GaitFileError> {
        let Allowed { min, max, unit } = allowed;
        let value = self.excerpt(&number.span);
        let parsed: f64 = number.text.parse().unwrap_or(f64::NAN);
        if !parsed.is_finite() {
            let problem = Problem::NotFinite {
                key,
                value,
                min,
                max,
                unit,
            };
            return Err(self.error(number.span.start, problem));
        }
        if parsed < min || parsed > max {
            let problem = Problem::OutOfRange {
                key,
                value,
                min,
                max,
                unit,
            };
            return Err(self.error(number.span.start, problem));
        }
        Ok(parsed)
    }
}

/// One table of the file; a key read from it counts as known.
pub(super) struct Section<'s, 'a> {
    pub(super) source: Source<'s>,
    pub(super) table: &'s DeTable<'a>,
    /// Where to point when a key is missing.
    pub(super) start: usize,
    pub(super) known: &'static [&'static str],
}

impl<'s> Section<'s, 's> {
    /// Refuses the first key (in file order) that is not in the list of known ones.
    pub(super) fn check_keys(&self, angles: &'static [&'static str]) -> Result<(), GaitFileError> {
        let mut unknown: Option<(&str, usize)> = None;
        for key in self.table.keys() {
            let start = key.span().start;
            let name = key.get_ref().as_ref();
            if !self.known.contains(&name) && unknown.is_none_or(|(_, first)| start < first) {
                unknown = Some((name, start));
            }
        }
        let Some((name, start)) = unknown else {
            return Ok(());
        };
        let problem = match angles.iter().find(|angle| **angle == name) {
            Some(key) => Problem::NoUnit { key },
            None => Problem::UnknownKey {
                key: Excerpt::new(name),
                suggestion: nearest(name, self.known),
                known: KeyList(self.known),
            },
        };
        Err(self.source.error(start, problem))
    }

    pub(super) fn get(&self, key: &str) -> Option<&'s Spanned<DeValue<'s>>> {
        self.table.get(key)
    }

    pub(super) fn missing(&self, key: &'static str, example: &'static str) -> GaitFileError {
        self.source
            .error(self.start, Problem::Missing { key, example })
    }

    /// A plain quantity whose key carries its unit.
    pub(super) fn quantity(
        &self,
        key: &'static str,
        allowed: Allowed,
    ) -> Result<Option<f32>, GaitFileError> {
        let Some(value) = self.get(key) else {
            return Ok(None);
        };
        let number = self.source.number(key, value)?;
        self.source.in_range(key, &number, allowed)?;
        Ok(number.text.parse().ok())
    }

    /// The angle `base`, written as `base_deg` or `base_rad`; radians come out.
    pub(super) fn angle(
        &self,
        names: &Angle,
        limits_rad: Range,
    ) -> Result<Option<f32>, GaitFileError> {
        let Some((value, unit)) = self.either(names)? else {
            return Ok(None);
        };
        read_angle(&self.source, names, unit, value, limits_rad).map(Some)
    }

    /// The value of an angle key with its unit, refusing both units at once.
    pub(super) fn either(
        &self,
        names: &Angle,
    ) -> Result<Option<(&'s Spanned<DeValue<'s>>, AngleUnit)>, GaitFileError> {
        match (self.get(names.deg), self.get(names.rad)) {
            (Some(_), Some(second)) => {
                let problem = Problem::TwoUnits { key: names.base };
                Err(self.source.error(second.span().start, problem))
            }
            (Some(deg), None) => Ok(Some((deg, AngleUnit::Deg))),
            (None, Some(rad)) => Ok(Some((rad, AngleUnit::Rad))),
            (None, None) => Ok(None),
        }
    }

    /// A whole number.
    pub(super) fn integer(
        &self,
        key: &'static str,
    ) -> Result<Option<(i64, Span<usize>)>, GaitFileError> {
        let Some(value) = self.get(key) else {
            return Ok(None);
        };
        let number = self.source.number(key, value)?;
        let Ok(parsed) = number.text.parse::<i64>() else {
            let expected = "a whole number";
            return Err(self
                .source
                .wrong_type(key, &number.span, value.get_ref(), expected));
        };
        Ok(Some((parsed, number.span)))
    }

    /// The tables of `[[key]]`.
    pub(super) fn tables(&self, key: &'static str) -> Result<Option<Tables<'s>>, GaitFileError> {
        let Some(value) = self.get(key) else {
            return Ok(None);
        };
        let span = value.span();
        let DeValue::Array(array) = value.get_ref() else {
            let expected = "a list of tables, each headed by its name in double brackets";
            return Err(self
                .source
                .wrong_type(key, &span, value.get_ref(), expected));
        };
        let mut tables = Vec::new();
        for item in array.iter() {
            let DeValue::Table(table) = item.get_ref() else {
                let span = item.span();
                return Err(self
                    .source
                    .wrong_type(key, &span, item.get_ref(), "a table"));
            };
            tables.push((table, item.span().start));
        }
        Ok(Some((tables, span.start)))
    }

    /// A list of values.
    pub(super) fn list(
        &self,
        key: &'static str,
        value: &'s Spanned<DeValue<'s>>,
    ) -> Result<&'s DeArray<'s>, GaitFileError> {
        match value.get_ref() {
            DeValue::Array(array) => Ok(array),
            other => Err(self
                .source
                .wrong_type(key, &value.span(), other, "a list of numbers")),
        }
    }
}

/// An angle's key without unit, in degrees and in radians.
pub(super) struct Angle {
    pub(super) base: &'static str,
    pub(super) deg: &'static str,
    pub(super) rad: &'static str,
}

/// Unit an angle was written in.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum AngleUnit {
    Deg,
    Rad,
}

/// Reads one angle; the range in the message is in the unit of the key.
pub(super) fn read_angle(
    source: &Source<'_>,
    names: &Angle,
    unit: AngleUnit,
    value: &Spanned<DeValue<'_>>,
    limits_rad: Range,
) -> Result<f32, GaitFileError> {
    let (min, max) = (f64::from(limits_rad.min), f64::from(limits_rad.max));
    match unit {
        AngleUnit::Rad => {
            let number = source.number(names.rad, value)?;
            let allowed = Allowed {
                min,
                max,
                unit: "rad",
            };
            let wide = source.in_range(names.rad, &number, allowed)?;
            Ok(number.text.parse::<f32>().unwrap_or(wide as f32))
        }
        AngleUnit::Deg => {
            let number = source.number(names.deg, value)?;
            let (min, max) = (neat_degrees(min), neat_degrees(max));
            let unit = "deg";
            let wide = source.in_range(names.deg, &number, Allowed { min, max, unit })?;
            Ok(radians(wide).clamp(limits_rad.min, limits_rad.max))
        }
    }
}

/// Degrees in the file to the radians of the control law: one rounding, in double precision before.
pub(super) fn radians(degrees: f64) -> f32 {
    (degrees * (core::f64::consts::PI / 180.0)) as f32
}

/// A limit in degrees without the tail that single precision leaves.
pub(crate) fn neat_degrees(rad: f64) -> f64 {
    (rad * (180.0 / core::f64::consts::PI) * 1e4).round() / 1e4
}

fn type_name(value: &DeValue<'_>) -> &'static str {
    match value {
        DeValue::String(_) => "a string",
        DeValue::Integer(_) => "a whole number",
        DeValue::Float(_) => "a number with a decimal point",
        DeValue::Boolean(_) => "true or false",
        DeValue::Datetime(_) => "a date or time",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a table",
    }
}

/// The known key within an edit distance of two, if any.
fn nearest(key: &str, known: &'static [&'static str]) -> Option<&'static str> {
    if key.len() > 40 {
        return None;
    }
    known
        .iter()
        .map(|k| (distance(key, k), *k))
        .filter(|(d, _)| *d <= 2)
        .min()
        .map(|(_, k)| k)
}

/// Levenshtein distance of two short keys.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut last = i;
        let mut left = i + 1;
        for (cell, cb) in row.iter_mut().skip(1).zip(&b) {
            let up = *cell;
            left = (last + usize::from(ca != *cb)).min(up + 1).min(left + 1);
            last = up;
            *cell = left;
        }
        if let Some(first) = row.first_mut() {
            *first = i + 1;
        }
    }
    row.last().copied().unwrap_or(0)
}
