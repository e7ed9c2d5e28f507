//! The patch: the nominal model with the found effects switched on, used at once by simulator and gait search.

use std::collections::BTreeMap;

use files::model::{EffectEntry, Model, Parameter};
use physics::Params;

use crate::verdict::Estimate;
use crate::vocabulary::Effect;

/// An effect, its joint, its parameters.
pub(super) type Part<'a> = (Effect, Option<usize>, &'a BTreeMap<String, Estimate>);

/// `model` with every effect of `parts` that the simulator knows, found by `command`.
pub(super) fn patched<'a>(
    model: &Model,
    parts: impl IntoIterator<Item = Part<'a>>,
    command: &str,
) -> Model {
    let mut out = model.clone();
    out.set_name(&format!("{}, patched", model.name()));
    for (effect, joint, values) in parts {
        let info = effect.info();
        let parameters = info
            .parameters
            .iter()
            .map(|p| {
                let found = values.get(p.key);
                Parameter {
                    value: found.map_or(p.neutral, |e| e.value).clamp(p.min, p.max),
                    tolerance: found.map_or(0.0, |e| (e.ci95[1] - e.ci95[0]) / 3.92),
                    source: command.into(),
                }
            })
            .collect();
        let joint = joint
            .and_then(|k| u8::try_from(k).ok())
            .filter(|_| info.per_joint());
        let mut next = out.clone();
        let entry = EffectEntry {
            effect,
            joint,
            parameters,
        };
        // What the body simulator refuses (stages that it leaves to others) stays out, so that the file can be used at once.
        if next.set_effect_entry(entry).is_ok() && Params::try_from(&next).is_ok() {
            out = next;
        }
    }
    out
}
