//! Tables of a scenario file: typed reads that know their place, and a check that every key was read.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::{ScenarioError, ScenarioProblem};

/// The file being read.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) file: &'a str,
    pub(super) text: &'a str,
}

impl Source<'_> {
    pub(super) fn error(&self, at: usize, problem: ScenarioProblem) -> ScenarioError {
        let before = self.text.get(..at.min(self.text.len())).unwrap_or("");
        let line = before.matches('\n').count() + 1;
        ScenarioError {
            file: self.file.to_owned(),
            line,
            problem: Box::new(problem),
        }
    }
}

/// One table.
pub(super) struct Table<'a> {
    source: Source<'a>,
    table: &'a DeTable<'a>,
    /// As written in the file, for messages.
    path: String,
    start: usize,
    known: Vec<&'static str>,
    read: Vec<&'a str>,
}

impl<'a> Table<'a> {
    pub(super) fn new(
        source: Source<'a>,
        table: &'a DeTable<'a>,
        path: String,
        start: usize,
    ) -> Self {
        Self {
            source,
            table,
            path,
            start,
            known: Vec::new(),
            read: Vec::new(),
        }
    }

    pub(super) fn start(&self) -> usize {
        self.start
    }

    pub(super) fn error(&self, at: usize, problem: ScenarioProblem) -> ScenarioError {
        self.source.error(at, problem)
    }

    /// All entries in file order: name, place, value.
    pub(super) fn entries(&self) -> Vec<(&'a str, usize, &'a Spanned<DeValue<'a>>)> {
        let mut all: Vec<_> = self
            .table
            .iter()
            .map(|(key, value)| (key.get_ref().as_ref(), key.span().start, value))
            .collect();
        all.sort_by_key(|(_, start, _)| *start);
        all
    }

    fn get(&mut self, key: &'static str) -> Option<&'a Spanned<DeValue<'a>>> {
        self.known.push(key);
        self.read.push(key);
        self.table.get(key)
    }

    fn wrong(
        &self,
        key: &str,
        value: &Spanned<DeValue<'_>>,
        expected: &'static str,
    ) -> ScenarioError {
        self.error(
            value.span().start,
            ScenarioProblem::WrongType {
                key: key.to_owned(),
                expected,
            },
        )
    }

    /// A number from `min` to `max`; `None` = not given.
    pub(super) fn number(
        &mut self,
        key: &'static str,
        min: f64,
        max: f64,
    ) -> Result<Option<f64>, ScenarioError> {
        let Some(value) = self.get(key) else {
            return Ok(None);
        };
        let number = self.as_number(key, value)?;
        if number >= min && number <= max {
            return Ok(Some(number));
        }
        let problem = ScenarioProblem::OutOfRange {
            key: key.to_owned(),
            value: number,
            min,
            max,
        };
        Err(self.error(value.span().start, problem))
    }

    /// Any number, infinities included (neutral limits).
    pub(super) fn as_number(
        &self,
        key: &str,
        value: &Spanned<DeValue<'_>>,
    ) -> Result<f64, ScenarioError> {
        let parsed = match value.get_ref() {
            DeValue::Float(float) => float.as_str().parse().ok(),
            DeValue::Integer(integer) if integer.radix() == 10 => integer.as_str().parse().ok(),
            _ => None,
        };
        parsed.ok_or_else(|| self.wrong(key, value, "a decimal number"))
    }

    /// A whole number from 0 to `max`.
    pub(super) fn whole(
        &mut self,
        key: &'static str,
        max: u64,
    ) -> Result<Option<u64>, ScenarioError> {
        let Some(value) = self.get(key) else {
            return Ok(None);
        };
        let parsed = match value.get_ref() {
            DeValue::Integer(integer) if integer.radix() == 10 => {
                integer.as_str().parse::<u64>().ok()
            }
            _ => None,
        };
        match parsed {
            Some(number) if number <= max => Ok(Some(number)),
            Some(number) => {
                let (value_f, max) = (number as f64, max as f64);
                let problem = ScenarioProblem::OutOfRange {
                    key: key.to_owned(),
                    value: value_f,
                    min: 0.0,
                    max,
                };
                Err(self.error(value.span().start, problem))
            }
            None => Err(self.wrong(key, value, "a whole number, 0 or more")),
        }
    }

    pub(super) fn flag(&mut self, key: &'static str) -> Result<Option<bool>, ScenarioError> {
        let Some(value) = self.get(key) else {
            return Ok(None);
        };
        match value.get_ref() {
            DeValue::Boolean(flag) => Ok(Some(*flag)),
            _ => Err(self.wrong(key, value, "true or false")),
        }
    }

    /// A text and its place.
    pub(super) fn text(
        &mut self,
        key: &'static str,
    ) -> Result<Option<(&'a str, usize)>, ScenarioError> {
        let Some(value) = self.get(key) else {
            return Ok(None);
        };
        match value.get_ref() {
            DeValue::String(text) => Ok(Some((text.as_ref(), value.span().start))),
            _ => Err(self.wrong(key, value, "a text")),
        }
    }

    /// One word of a list.
    pub(super) fn word<T: Copy>(
        &mut self,
        key: &'static str,
        words: &[(&str, T)],
    ) -> Result<Option<T>, ScenarioError> {
        let Some((word, start)) = self.text(key)? else {
            return Ok(None);
        };
        if let Some((_, value)) = words.iter().find(|(name, _)| *name == word) {
            return Ok(Some(*value));
        }
        let known = words
            .iter()
            .map(|(name, _)| *name)
            .collect::<Vec<_>>()
            .join(", ");
        Err(self.error(
            start,
            ScenarioProblem::UnknownWord {
                key,
                word: word.to_owned(),
                known,
            },
        ))
    }

    /// A table inside this one.
    pub(super) fn table(&mut self, key: &'static str) -> Result<Option<Table<'a>>, ScenarioError> {
        let Some(value) = self.get(key) else {
            return Ok(None);
        };
        self.inner(key, value).map(Some)
    }

    /// The table that `value` must be.
    pub(super) fn inner(
        &self,
        key: &str,
        value: &'a Spanned<DeValue<'a>>,
    ) -> Result<Table<'a>, ScenarioError> {
        let DeValue::Table(table) = value.get_ref() else {
            return Err(self.wrong(key, value, "a table"));
        };
        let path =
            format!("{}.{key}", self.path.trim_end_matches(']')).replace("the file.", "[") + "]";
        Ok(Table::new(self.source, table, path, value.span().start))
    }

    /// An array of tables.
    pub(super) fn tables(&mut self, key: &'static str) -> Result<Vec<Table<'a>>, ScenarioError> {
        let Some(value) = self.get(key) else {
            return Ok(Vec::new());
        };
        let DeValue::Array(array) = value.get_ref() else {
            return Err(self.wrong(key, value, "an array of tables"));
        };
        let mut all = Vec::new();
        for item in array.iter() {
            let DeValue::Table(table) = item.get_ref() else {
                return Err(self.wrong(key, item, "an array of tables"));
            };
            all.push(Table::new(
                self.source,
                table,
                format!("[[{key}]]"),
                item.span().start,
            ));
        }
        Ok(all)
    }

    /// Refuses the first key that nobody has read.
    pub(super) fn finish(self) -> Result<(), ScenarioError> {
        for (name, start, _) in self.entries() {
            if !self.read.contains(&name) {
                let (key, known) = (name.to_owned(), self.known.join(", "));
                return Err(self.error(
                    start,
                    ScenarioProblem::UnknownKey {
                        table: self.path.clone(),
                        key,
                        known,
                    },
                ));
            }
        }
        Ok(())
    }

    pub(super) fn missing(&self, key: &'static str) -> ScenarioError {
        self.error(
            self.start,
            ScenarioProblem::Missing {
                table: self.path.clone(),
                key,
            },
        )
    }
}
