//! Walks a TOML tree with line numbers; every read key is taken out, so what is left over is unknown.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::{DatasetError, Warning};

/// One TOML table under the eye of the reader.
pub(super) struct Walk<'a, 'i> {
    file: &'a str,
    text: &'a str,
    path: String,
    table: &'a DeTable<'i>,
    seen: std::cell::RefCell<Vec<&'static str>>,
}

fn line_of(text: &str, offset: usize) -> usize {
    text.as_bytes()
        .iter()
        .take(offset)
        .filter(|b| **b == b'\n')
        .count()
        + 1
}

/// Whether a path stays in its folder on every system: relative, and no part of it goes up or names a drive.
#[must_use]
pub fn is_inside(path: &str) -> bool {
    let absolute = path.starts_with(['/', '\\']) || path.get(1..2) == Some(":");
    let goes_up = path.split(['/', '\\']).any(|part| part == "..");
    !path.is_empty() && !absolute && !goes_up
}

/// Parses TOML text, with file and line in the error.
pub(super) fn parse<'i>(file: &str, text: &'i str) -> Result<DeTable<'i>, DatasetError> {
    DeTable::parse(text)
        .map(Spanned::into_inner)
        .map_err(|e| DatasetError::Toml {
            file: file.into(),
            line: line_of(text, e.span().map_or(0, |s| s.start)),
            reason: e.message().into(),
        })
}

impl<'a, 'i> Walk<'a, 'i> {
    pub(super) fn new(file: &'a str, text: &'a str, path: &str, table: &'a DeTable<'i>) -> Self {
        Self {
            file,
            text,
            path: path.into(),
            table,
            seen: Vec::new().into(),
        }
    }

    fn get(&self, key: &'static str) -> Option<&'a Spanned<DeValue<'i>>> {
        self.seen.borrow_mut().push(key);
        self.table.get(key)
    }

    pub(super) fn full(&self, key: &str) -> String {
        if self.path.is_empty() {
            key.into()
        } else {
            format!("{}.{key}", self.path)
        }
    }

    fn bad(
        &self,
        key: &str,
        value: &Spanned<DeValue<'i>>,
        expected: impl Into<String>,
    ) -> DatasetError {
        let span = value.span();
        DatasetError::BadKey {
            file: self.file.into(),
            line: line_of(self.text, span.start),
            key: self.full(key),
            expected: expected.into(),
            found: self
                .text
                .get(span)
                .unwrap_or("?")
                .chars()
                .take(60)
                .collect(),
        }
    }

    pub(super) fn missing(&self, key: &str, hint: &'static str) -> DatasetError {
        DatasetError::MissingKey {
            file: self.file.into(),
            key: self.full(key),
            hint,
        }
    }

    pub(super) fn text(&self, key: &'static str) -> Result<Option<&'a str>, DatasetError> {
        self.get(key)
            .map(|v| {
                v.get_ref()
                    .as_str()
                    .ok_or_else(|| self.bad(key, v, "a text"))
            })
            .transpose()
    }

    /// A file or folder inside the data set folder.
    pub(super) fn path_inside(&self, key: &'static str) -> Result<Option<&'a str>, DatasetError> {
        let Some(path) = self.text(key)? else {
            return Ok(None);
        };
        match (is_inside(path), self.table.get(key)) {
            (false, Some(value)) => {
                let expected = "a path inside the data set folder, without `..` and not absolute";
                Err(self.bad(key, value, expected))
            }
            _ => Ok(Some(path)),
        }
    }

    /// One word out of a closed list.
    pub(super) fn word<T: Copy>(
        &self,
        key: &'static str,
        words: &[(&str, T)],
    ) -> Result<Option<T>, DatasetError> {
        let Some(v) = self.get(key) else {
            return Ok(None);
        };
        let found = v
            .get_ref()
            .as_str()
            .and_then(|s| words.iter().find(|w| w.0 == s));
        found.map(|w| Some(w.1)).ok_or_else(|| {
            let list: Vec<String> = words.iter().map(|w| format!("\"{}\"", w.0)).collect();
            self.bad(key, v, format!("one of {}", list.join(", ")))
        })
    }

    fn number_of(value: &Spanned<DeValue<'i>>) -> Option<f64> {
        let x: f64 = match value.get_ref() {
            DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix()).ok()? as f64,
            DeValue::Float(f) => f.as_str().parse().ok()?,
            _ => return None,
        };
        x.is_finite().then_some(x)
    }

    pub(super) fn number(
        &self,
        key: &'static str,
        low: f64,
        high: f64,
    ) -> Result<Option<f64>, DatasetError> {
        let Some(v) = self.get(key) else {
            return Ok(None);
        };
        let ok = Self::number_of(v).filter(|x| (low..=high).contains(x));
        ok.map(Some)
            .ok_or_else(|| self.bad(key, v, format!("a number from {low} to {high}")))
    }

    /// A plain number, or `{ value, tolerance }`; returns value and tolerance, if any.
    pub(super) fn quantity(
        &self,
        key: &'static str,
        low: f64,
        high: f64,
        warnings: &mut Vec<Warning>,
    ) -> Result<Option<(f64, Option<f64>)>, DatasetError> {
        let Some(v) = self.get(key) else {
            return Ok(None);
        };
        if let DeValue::Table(t) = v.get_ref() {
            let inner = Walk::new(self.file, self.text, &self.full(key), t);
            let value = inner
                .number("value", low, high)?
                .ok_or_else(|| inner.missing("value", "write a number"))?;
            let tolerance = inner.number("tolerance", 0.0, 10.0)?;
            inner.get("source");
            inner.finish(warnings);
            return Ok(Some((value, tolerance)));
        }
        self.number(key, low, high).map(|x| x.map(|x| (x, None)))
    }

    pub(super) fn table(&self, key: &'static str) -> Result<Option<Walk<'a, 'i>>, DatasetError> {
        let Some(v) = self.get(key) else {
            return Ok(None);
        };
        match v.get_ref() {
            DeValue::Table(t) => Ok(Some(Walk::new(self.file, self.text, &self.full(key), t))),
            _ => Err(self.bad(key, v, "a table")),
        }
    }

    pub(super) fn tables(&self, key: &'static str) -> Result<Vec<Walk<'a, 'i>>, DatasetError> {
        let Some(v) = self.get(key) else {
            return Ok(Vec::new());
        };
        let DeValue::Array(list) = v.get_ref() else {
            return Err(self.bad(key, v, "an array of tables"));
        };
        let one = |item: &'a Spanned<DeValue<'i>>| match item.get_ref() {
            DeValue::Table(t) => Ok(Walk::new(self.file, self.text, key, t)),
            _ => Err(self.bad(key, item, "a table")),
        };
        list.iter().map(one).collect()
    }

    /// All keys with text values (the [signals] table).
    pub(super) fn pairs(&self) -> Result<Vec<(String, String)>, DatasetError> {
        let one = |(k, v): (&'a Spanned<_>, &'a Spanned<DeValue<'i>>)| {
            let key: &std::borrow::Cow<'i, str> = k.get_ref();
            let text = v
                .get_ref()
                .as_str()
                .ok_or_else(|| self.bad(key, v, "a column name"))?;
            Ok((key.to_string(), text.to_string()))
        };
        self.table.iter().map(one).collect()
    }

    /// Warns about keys that nobody asked for.
    pub(super) fn finish(&self, warnings: &mut Vec<Warning>) {
        let seen = self.seen.borrow();
        for (key, _) in self.table.iter() {
            if !seen.iter().any(|s| *s == key.get_ref()) {
                warnings.push(Warning::UnknownKey {
                    file: self.file.into(),
                    line: line_of(self.text, key.span().start),
                    key: self.full(key.get_ref()),
                    known: seen.join(", "),
                });
            }
        }
    }
}
