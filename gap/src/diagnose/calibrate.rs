//! The nominal model: what is known as it stands, what is unknown fitted; then all within tolerances.

use crate::fit::{Free, Model, Objective};
use crate::joint::Params;
use crate::math::Rng;

/// Global starts for unknown nominal values, and how many of them are refined.
const STARTS: usize = 160;
const REFINED: usize = 4;

/// Sets the prior weight for the present cost and improves.
pub(super) fn polish(
    o: &Objective<'_>,
    model: &mut Model,
    independent: f64,
    iterations: usize,
) -> f64 {
    let mut o = o.clone();
    o.prior_weight = o.data_cost(&model.params) / independent;
    o.polish(model, iterations)
}

fn global(o: &Objective<'_>, free: &[Free], independent: f64, seed: u64) -> Model {
    let start = Model {
        params: Params::default(),
        free: free.to_vec(),
    };
    if free.is_empty() {
        return start;
    }
    let mut rng = Rng::new(seed);
    let models: Vec<Model> = (0..STARTS)
        .map(|i| {
            let mut m = start.clone();
            for f in free {
                // Three e-foldings to each side of the reference; the first try is the reference itself.
                let x = if i == 0 {
                    0.0
                } else {
                    3.0 * (2.0 * rng.uniform() - 1.0)
                };
                m.params.set(f.p, f.to_value(x));
            }
            m
        })
        .collect();
    let mut tries: Vec<(f64, Model)> = o.costs(&models).into_iter().zip(models).collect();
    tries.sort_by(|a, b| a.0.total_cmp(&b.0));
    tries.truncate(REFINED);
    tries
        .iter_mut()
        .for_each(|(c, m)| *c = polish(o, m, independent, 15));
    tries.sort_by(|a, b| a.0.total_cmp(&b.0));
    tries.into_iter().next().map_or(start, |t| t.1)
}

/// The nominal parameters (unknown ones fitted, known ones untouched) and the calibrated model.
pub(super) fn calibrate(
    o: &Objective<'_>,
    free: Vec<Free>,
    independent: f64,
    seed: u64,
) -> (Params, Model) {
    let unknown: Vec<Free> = free
        .iter()
        .copied()
        .filter(|f| f.tolerance.is_none())
        .collect();
    let nominal = global(o, &unknown, independent, seed).params;
    let mut model = Model {
        params: nominal,
        free,
    };
    polish(o, &mut model, independent, 12);
    polish(o, &mut model, independent, 8);
    (nominal, model)
}
