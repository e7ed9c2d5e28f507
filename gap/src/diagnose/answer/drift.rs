//! A zero of the encoder that moves in time is no offset.

use crate::diagnose::Diagnosis;
use crate::fit::{Free, Model, Objective, Stop};
use crate::joint::{P, Params};

/// Part of an offset by which its values in the two halves of the runs may differ. A zero that wanders at an even pace from
/// the start of every run is off by a quarter of its way in the first half on average and by three quarters in the second.
/// They differ by the whole of their mean.
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
    let params = d.selection.model.params;
    let [early, late] = [true, false].map(|e| half(d, params, *free, e));
    let ratio = (early.common + late.common) / (early.own + late.own).max(1e-12);
    let offset = params.get(P::MechOffset);
    (late.offset - early.offset).abs() > STEADY * offset.abs()
        && d.independent * libm::log(ratio.max(1.0)) > CHANCE
}

/// Share of the squared gap of the nominal model that a zero of its own for each half of the runs takes away. What calibration and effects bend to imitate
/// the drift is part of it.
pub(super) fn share(d: &Diagnosis) -> f64 {
    let free = d.selection.model.free.iter();
    let Some(free) = free.into_iter().find(|f| f.p == P::MechOffset) else {
        return 0.0;
    };
    let [early, late] = [true, false].map(|e| half(d, d.nominal, *free, e));
    let common = early.common + late.common;
    (1.0 - (early.own + late.own) / common.max(1e-300)).clamp(0.0, 1.0)
}

fn half(d: &Diagnosis, params: Params, free: Free, early: bool) -> Half {
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
        stop: Stop::NEVER,
    };
    let mut model = Model {
        params,
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
