//! Text to [`Model`].

use super::{Effect, EffectEntry, FORMAT, Key, Model, ModelError, Parameter};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

type Value<'a> = Spanned<DeValue<'a>>;

struct Reader<'a> {
    file: &'a str,
    text: &'a str,
}

pub(super) fn parse(file: &str, text: &str) -> Result<Model, ModelError> {
    let reader = Reader { file, text };
    let document = DeTable::parse(text).map_err(|e| ModelError::Syntax {
        file: file.to_owned(),
        line: e.span().map_or(1, |s| reader.line(s.start)),
        message: e.message().to_owned(),
    })?;
    let table = document.get_ref();
    reader.format(table)?;
    let mut model = Model::hand_tuned();
    for (key, value) in table {
        match key.get_ref().as_ref() {
            "format" => {}
            "name" => model.set_name(reader.string("name", value)?),
            "effect" => reader.effects(&mut model, value)?,
            name if Key::ALL.iter().any(|k| k.info().table == name) => {
                reader.parameters(&mut model, name, value)?;
            }
            name => {
                return Err(reader.unknown(
                    key.span().start,
                    name,
                    "format, name, environment, mass, intra, inter, supply, camera, robot, simulation, effect",
                ));
            }
        }
    }
    Ok(model)
}

impl Reader<'_> {
    fn line(&self, at: usize) -> usize {
        1 + self.text.as_bytes()[..at.min(self.text.len())]
            .iter()
            .filter(|b| **b == b'\n')
            .count()
    }

    fn unknown(&self, at: usize, key: &str, known: &str) -> ModelError {
        ModelError::UnknownKey {
            file: self.file.to_owned(),
            line: self.line(at),
            key: key.to_owned(),
            known: known.to_owned(),
        }
    }

    fn wrong_type(&self, value: &Value<'_>, key: &str, expected: &'static str) -> ModelError {
        ModelError::Type {
            file: self.file.to_owned(),
            line: self.line(value.span().start),
            key: key.to_owned(),
            expected,
        }
    }

    fn at(&self, value: &Value<'_>) -> impl Fn(ModelError) -> ModelError {
        let (file, line) = (self.file.to_owned(), self.line(value.span().start));
        move |source| ModelError::At {
            file: file.clone(),
            line,
            source: Box::new(source),
        }
    }

    fn format(&self, table: &DeTable<'_>) -> Result<(), ModelError> {
        let Some(value) = table.get("format") else {
            return Err(ModelError::Missing {
                file: self.file.to_owned(),
                line: 1,
                key: "format".to_owned(),
            });
        };
        let found = value
            .get_ref()
            .as_integer()
            .and_then(|i| i64::from_str_radix(i.as_str(), i.radix()).ok())
            .ok_or_else(|| self.wrong_type(value, "format", "the number 1"))?;
        if found != FORMAT {
            return Err(ModelError::Format {
                file: self.file.to_owned(),
                line: self.line(value.span().start),
                found,
            });
        }
        Ok(())
    }

    fn string<'v>(&self, key: &str, value: &'v Value<'_>) -> Result<&'v str, ModelError> {
        value
            .get_ref()
            .as_str()
            .ok_or_else(|| self.wrong_type(value, key, "a text in quotes"))
    }

    fn table<'v, 'a>(
        &self,
        key: &str,
        value: &'v Value<'a>,
    ) -> Result<&'v DeTable<'a>, ModelError> {
        value
            .get_ref()
            .as_table()
            .ok_or_else(|| self.wrong_type(value, key, "a table"))
    }

    fn number(&self, key: &str, value: &Value<'_>) -> Result<f64, ModelError> {
        let parsed = match value.get_ref() {
            DeValue::Integer(i) if i.radix() == 10 => i.as_str().parse::<f64>().ok(),
            DeValue::Float(f) => f.as_str().parse::<f64>().ok(),
            _ => None,
        };
        parsed.ok_or_else(|| self.wrong_type(value, key, "a number"))
    }

    /// `{ value, tolerance, source }`; tolerance and source fall back to the given defaults.
    fn parameter(
        &self,
        path: &str,
        value: &Value<'_>,
        default: Parameter,
    ) -> Result<Parameter, ModelError> {
        const SHAPE: &str = "{ value = …, tolerance = …, source = \"…\" }";
        let table = value
            .get_ref()
            .as_table()
            .ok_or_else(|| self.wrong_type(value, path, SHAPE))?;
        let mut out = default;
        let mut has_value = false;
        for (key, entry) in table {
            match key.get_ref().as_ref() {
                "value" => {
                    out.value = self.number(path, entry)?;
                    has_value = true;
                }
                "tolerance" => out.tolerance = self.number(path, entry)?,
                "source" => self.string(path, entry)?.clone_into(&mut out.source),
                other => {
                    return Err(self.unknown(
                        key.span().start,
                        &format!("{path}.{other}"),
                        "value, tolerance, source",
                    ));
                }
            }
        }
        if !has_value {
            return Err(ModelError::Missing {
                file: self.file.to_owned(),
                line: self.line(value.span().start),
                key: format!("{path}.value"),
            });
        }
        Ok(out)
    }

    fn parameters(
        &self,
        model: &mut Model,
        name: &str,
        value: &Value<'_>,
    ) -> Result<(), ModelError> {
        for (key, entry) in self.table(name, value)? {
            let found = Key::ALL
                .iter()
                .find(|k| k.info().table == name && k.info().key == key.get_ref().as_ref());
            let Some(&found) = found else {
                let known: Vec<&str> = Key::ALL
                    .iter()
                    .map(|k| k.info())
                    .filter(|i| i.table == name)
                    .map(|i| i.key)
                    .collect();
                return Err(self.unknown(
                    key.span().start,
                    &format!("{name}.{}", key.get_ref()),
                    &known.join(", "),
                ));
            };
            let path = found.info().path();
            let mut default = found.info().hand_tuned();
            default.source.clear();
            let parameter = self.parameter(&path, entry, default)?;
            model
                .set_parameter(found, parameter)
                .map_err(self.at(entry))?;
        }
        Ok(())
    }

    fn effects(&self, model: &mut Model, value: &Value<'_>) -> Result<(), ModelError> {
        for (key, entry) in self.table("effect", value)? {
            let name = key.get_ref().as_ref();
            let Some(effect) = Effect::from_name(name) else {
                let known: Vec<&str> = Effect::ALL.iter().map(|e| e.info().name).collect();
                return Err(self.unknown(
                    key.span().start,
                    &format!("effect.{name}"),
                    &known.join(", "),
                ));
            };
            if effect.info().per_joint() {
                for (joint_key, joint_entry) in self.table(name, entry)? {
                    let joint = joint_key
                        .get_ref()
                        .strip_prefix("joint_")
                        .and_then(|k| k.parse::<u8>().ok());
                    if joint.is_none() {
                        return Err(self.at(joint_entry)(ModelError::EffectJoint {
                            effect: effect.info().name,
                            per_joint: true,
                        }));
                    }
                    self.effect(model, effect, joint, joint_entry)?;
                }
            } else {
                self.effect(model, effect, None, entry)?;
            }
        }
        Ok(())
    }

    fn effect(
        &self,
        model: &mut Model,
        effect: Effect,
        joint: Option<u8>,
        value: &Value<'_>,
    ) -> Result<(), ModelError> {
        let info = effect.info();
        let table = self.table(info.name, value)?;
        for (key, _) in table {
            if !info
                .parameters
                .iter()
                .any(|p| p.key == key.get_ref().as_ref())
            {
                let known: Vec<&str> = info.parameters.iter().map(|p| p.key).collect();
                return Err(self.unknown(
                    key.span().start,
                    &format!("effect.{}.{}", info.name, key.get_ref()),
                    &known.join(", "),
                ));
            }
        }
        let mut parameters = Vec::with_capacity(info.parameters.len());
        for p in info.parameters {
            let neutral = Parameter {
                value: p.neutral,
                tolerance: 0.0,
                source: String::new(),
            };
            let path = format!("effect.{}.{}", info.name, p.key);
            parameters.push(match table.get(p.key) {
                Some(entry) => self.parameter(&path, entry, neutral)?,
                None => neutral,
            });
        }
        let entry = EffectEntry {
            effect,
            joint,
            parameters,
        };
        model.set_effect_entry(entry).map_err(self.at(value))
    }
}
