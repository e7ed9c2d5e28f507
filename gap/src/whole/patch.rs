//! The patch: the nominal model with the found effects switched on, used at once by simulator and gait search.

use files::model::{Effect as ModelEffect, EffectEntry, Model, Parameter};
use physics::Params;

use crate::verdict::EffectRow;

/// `model` with every effect of `rows` that the simulator knows.
pub(super) fn patched(model: &Model, rows: &[EffectRow]) -> Model {
    let mut out = model.clone();
    out.set_name(&format!("{}, patched", model.name()));
    for row in rows {
        let Some(effect) = ModelEffect::by_name(row.effect.name()) else {
            continue;
        };
        let info = effect.info();
        let parameters = info
            .parameters
            .iter()
            .map(|p| {
                let found = row.parameters.get(p.key);
                Parameter {
                    value: found.map_or(p.neutral, |e| e.value).clamp(p.min, p.max),
                    tolerance: found.map_or(0.0, |e| (e.ci95[1] - e.ci95[0]) / 3.92),
                    source: "gap report".into(),
                }
            })
            .collect();
        let joint = row
            .joint
            .and_then(|k| u8::try_from(k).ok())
            .filter(|_| info.per_joint);
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
