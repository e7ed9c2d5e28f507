//! A zero of the encoder that moves in time is no offset.

use crate::diagnose::Diagnosis;
use crate::fit::{Free, Model, Objective};
use crate::joint::P;

/// Part of an offset by which its values in the two halves of the runs may differ. A zero that wanders at an even pace from
/// the start of every run is off by a quarter of its way in the first half on average and by three quarters in the second:
/// they differ by the whole of their mean.
const STEADY: f64 = 0.6;

/// Twice the logarithm of the likelihood ratio from which a difference of the halves is no chance: one parameter more, once
/// in a hundred offsets.
const CHANCE: f64 = 6.6;

/// An offset fitted to one half of every run, and the costs of that half with the common one and with its own.
struct Half {
    offset: f64,
    common: f64,
    own: f64,
}

/// Whether the offset between mechanics and encoder that was found is another one early and late in the runs.
pub(super) fn drifts(d: &Diagnosis) -> bool {
    let free = d.selection.found.iter().flat_map(|f| &f.candidate.free);
    let Some(free) = free.into_iter().find(|f| f.p == P::MechOffset) else {
        return false;
    };
    let (early, late) = (half(d, *free, true), half(d, *free, false));
    let ratio = (early.common + late.common) / (early.own + late.own).max(1e-12);
    let offset = d.selection.model.params.get(P::MechOffset);
    (late.offset - early.offset).abs() > STEADY * offset.abs()
        && d.independent * libm::log(ratio.max(1.0)) > CHANCE
}

fn half(d: &Diagnosis, free: Free, early: bool) -> Half {
    let mut problem = d.problem.merged(&d.fit_runs);
    for run in &mut problem.runs {
        let middle = run.steps / 2;
        for s in &mut run.samples {
            s.enabled &= (s.step < middle) == early;
        }
    }
    let objective = Objective {
        problem: &problem,
        runs: (0..problem.runs.len()).collect(),
        weight: d.floor.weights(),
        prior_weight: 0.0,
        robust: d.floor.repeat.is_some(),
    };
    let mut model = Model {
        params: d.selection.model.params,
        free: vec![free],
    };
    let common = objective.data_cost(&model.params);
    let own = objective.polish(&mut model, 8).min(common);
    Half {
        offset: model.params.get(P::MechOffset),
        common,
        own,
    }
}
