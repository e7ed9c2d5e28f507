//! `model.toml`: the robot model and the simulator's parameters, each as a value with a tolerance and a source, and the named effects.
//!
//! The defaults are the hand-tuned column of the paper's Table II. A file names only what differs from them. Effects stand under
//! `[effect.NAME]` (one instance) or `[effect.NAME.joint_K]` (K = 0..5); an absent effect is off, and a simulator must then give the
//! same bits as without it.
//!
//! ```
//! use files::model::{Effect, Key, Model};
//! let text = "format = 1\nname = \"slippery\"\n[environment]\nfriction = { value = 0.4, tolerance = 0.05, source = \"tilt test\" }\n\
//!             [effect.coulomb_friction.joint_2]\ntorque_nm = { value = 0.3, tolerance = 0.05, source = \"coast-down\" }\n";
//! let model = Model::parse("model.toml", text).unwrap();
//! assert_eq!(model.value(Key::Friction), 0.4);
//! assert_eq!(model.value(Key::Erp), 0.2);
//! assert_eq!(model.effect(Effect::CoulombFriction, Some(2), "torque_nm"), Some(0.3));
//! ```

mod error;
mod keys;
mod read;
mod write;

pub use crate::effects::{Effect, EffectInfo, EffectParam, Stage};
pub use error::ModelError;
pub use keys::{Key, KeyInfo, MOTORS, MotorKeys};

/// Joints of the meta-module, for `joint_K`.
pub const JOINTS: u8 = MOTORS.len() as u8;
/// Version of the file format.
pub const FORMAT: i64 = 1;

/// One number of the model.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// The value, in the unit of its key.
    pub value: f64,
    /// One standard deviation of what is believed about the value, absolute, same unit.
    pub tolerance: f64,
    /// Where the value comes from.
    pub source: String,
}

/// An effect that is switched on, with its parameters in the order of [`Effect::info`].
#[derive(Clone, Debug, PartialEq)]
pub struct EffectEntry {
    /// Which effect.
    pub effect: Effect,
    /// Joint 0..5 for joint effects, `None` for the others.
    pub joint: Option<u8>,
    /// One entry per parameter of the effect.
    pub parameters: Vec<Parameter>,
}

/// A complete, valid model: every parameter has a finite value inside its range.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    name: String,
    parameters: Vec<Parameter>,
    effects: Vec<EffectEntry>,
}

impl Model {
    /// The hand-tuned column of Table II, no effects.
    #[must_use]
    pub fn hand_tuned() -> Model {
        let parameters = Key::ALL.iter().map(|key| key.info().hand_tuned()).collect();
        Model {
            name: "hand-tuned".to_owned(),
            parameters,
            effects: Vec::new(),
        }
    }

    /// The meta-optimised column of Table II, no effects.
    #[must_use]
    pub fn meta_optimised() -> Model {
        let mut model = Model::hand_tuned();
        "meta-optimised".clone_into(&mut model.name);
        for key in Key::TABLE_II {
            let parameter = &mut model.parameters[key as usize];
            parameter.value = key.info().meta_optimised;
            "paper, Table II, after meta-optimisation".clone_into(&mut parameter.source);
        }
        model
    }

    /// Reads a model file. `file_name` only appears in messages.
    ///
    /// # Errors
    /// Syntax, unknown or misplaced keys, values that are not finite or outside their range; each with file, line and what to do.
    pub fn parse(file_name: &str, text: &str) -> Result<Model, ModelError> {
        read::parse(file_name, text)
    }

    /// The model as a file that [`Model::parse`] reads back to an equal model.
    #[must_use]
    pub fn to_toml(&self) -> String {
        write::to_toml(self)
    }

    /// Name for people.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Renames the model.
    pub fn set_name(&mut self, name: &str) {
        name.clone_into(&mut self.name);
    }

    /// One parameter.
    #[must_use]
    pub fn parameter(&self, key: Key) -> &Parameter {
        &self.parameters[key as usize]
    }

    /// The value of one parameter, in the unit of its key.
    #[must_use]
    pub fn value(&self, key: Key) -> f64 {
        self.parameters[key as usize].value
    }

    /// Changes the value of one parameter; tolerance and source stay.
    ///
    /// # Errors
    /// [`ModelError::ValueOutOfRange`] when the value is not finite or outside the range of the key.
    pub fn set(&mut self, key: Key, value: f64) -> Result<(), ModelError> {
        let info = key.info();
        if !(value >= info.min && value <= info.max) {
            return Err(ModelError::ValueOutOfRange {
                key: info.path(),
                value,
                min: info.min,
                max: info.max,
            });
        }
        self.parameters[key as usize].value = value;
        Ok(())
    }

    /// Changes a whole parameter.
    ///
    /// # Errors
    /// As [`Model::set`], and for a tolerance that is negative or not finite.
    pub fn set_parameter(&mut self, key: Key, parameter: Parameter) -> Result<(), ModelError> {
        if !(parameter.tolerance >= 0.0 && parameter.tolerance.is_finite()) {
            return Err(ModelError::ToleranceOutOfRange {
                key: key.info().path(),
                value: parameter.tolerance,
            });
        }
        self.set(key, parameter.value)?;
        self.parameters[key as usize] = parameter;
        Ok(())
    }

    /// Effects that are switched on, sorted by effect, then joint.
    #[must_use]
    pub fn effects(&self) -> &[EffectEntry] {
        &self.effects
    }

    /// One parameter of an effect; `None` when the effect is off or has no such parameter.
    #[must_use]
    pub fn effect(&self, effect: Effect, joint: Option<u8>, parameter: &str) -> Option<f64> {
        let entry = self
            .effects
            .iter()
            .find(|e| e.effect == effect && e.joint == joint)?;
        let at = effect
            .info()
            .parameters
            .iter()
            .position(|p| p.key == parameter)?;
        entry.parameters.get(at).map(|p| p.value)
    }

    /// Switches an effect on, or replaces it, with values in the order of [`Effect::info`].
    ///
    /// # Errors
    /// Wrong number of values, a joint where none belongs or none where one does, a value outside its range.
    pub fn set_effect(
        &mut self,
        effect: Effect,
        joint: Option<u8>,
        values: &[f64],
    ) -> Result<(), ModelError> {
        let parameters = values
            .iter()
            .map(|value| Parameter {
                value: *value,
                tolerance: 0.0,
                source: String::new(),
            })
            .collect();
        self.set_effect_entry(EffectEntry {
            effect,
            joint,
            parameters,
        })
    }

    /// Switches an effect on, or replaces it.
    ///
    /// # Errors
    /// As [`Model::set_effect`].
    pub fn set_effect_entry(&mut self, entry: EffectEntry) -> Result<(), ModelError> {
        let info = entry.effect.info();
        if entry.joint.is_some() != info.per_joint() || entry.joint.is_some_and(|j| j >= JOINTS) {
            return Err(ModelError::EffectJoint {
                effect: info.name,
                per_joint: info.per_joint(),
            });
        }
        if entry.parameters.len() != info.parameters.len() {
            return Err(ModelError::EffectParameters {
                effect: info.name,
                expected: info.parameters.len(),
                found: entry.parameters.len(),
            });
        }
        for (p, d) in entry.parameters.iter().zip(info.parameters) {
            if !(p.value >= d.min && p.value <= d.max) {
                return Err(ModelError::ValueOutOfRange {
                    key: format!("effect.{}.{}", info.name, d.key),
                    value: p.value,
                    min: d.min,
                    max: d.max,
                });
            }
        }
        self.effects
            .retain(|e| (e.effect, e.joint) != (entry.effect, entry.joint));
        self.effects.push(entry);
        self.effects.sort_by_key(|e| (e.effect, e.joint));
        Ok(())
    }

    /// Switches an effect off.
    pub fn remove_effect(&mut self, effect: Effect, joint: Option<u8>) {
        self.effects
            .retain(|e| (e.effect, e.joint) != (effect, joint));
    }
}

#[cfg(test)]
mod tests;
