//! The nominal model: what is known as it stands, what is unknown fitted; then all within tolerances.

use crate::fit::{Free, Model, Objective};
use crate::joint::Params;
use crate::math::Rng;

/// Global starts for unknown nominal values, and how many of them are refined.
const STARTS: usize = 160;
const REFINED: usize = 4;

/// Draws within the tolerances, and how much better one must become to be another valley.
const DRAWS: usize = 96;
const BETTER: f64 = 0.8;
/// A cost of so many floors is in the right valley.
const NEAR: f64 = 4.0;

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

/// The best of many models within the tolerances, beside `stated` itself.
fn within(o: &Objective<'_>, stated: &Model, independent: f64, seed: u64) -> Vec<Model> {
    let mut rng = Rng::new(seed ^ 0x5eed);
    let known: Vec<&Free> = (stated.free.iter())
        .filter(|f| f.tolerance.is_some() && !f.fixed())
        .collect();
    let models: Vec<Model> = (0..DRAWS)
        .map(|_| {
            let mut m = stated.clone();
            for f in &known {
                let away = 2.0 * (2.0 * rng.uniform() - 1.0) * f.tolerance.unwrap_or(0.0);
                let x = f.to_x(Params::neutral(f.p)) + away;
                m.params.set(f.p, f.to_value(x));
            }
            m
        })
        .collect();
    let mut tries: Vec<(f64, Model)> = o.costs(&models).into_iter().zip(models).collect();
    tries.sort_by(|a, b| a.0.total_cmp(&b.0));
    tries.truncate(6);
    (tries.iter_mut()).for_each(|(c, m)| *c = polish(o, m, independent, 3));
    tries.sort_by(|a, b| a.0.total_cmp(&b.0));
    tries.truncate(2);
    tries.into_iter().map(|t| t.1).collect()
}

/// The nominal parameters (unknown ones fitted, known ones untouched) and the calibrated model.
pub(super) fn calibrate(
    o: &Objective<'_>,
    free: Vec<Free>,
    independent: f64,
    floor: f64,
    seed: u64,
) -> (Params, Model) {
    let unknown: Vec<Free> = free
        .iter()
        .copied()
        .filter(|f| f.tolerance.is_none())
        .collect();
    let nominal = global(o, &unknown, independent, seed).params;
    let stated = Model {
        params: nominal,
        free,
    };
    let mut model = stated.clone();
    polish(o, &mut model, independent, 12);
    let mut cost = polish(o, &mut model, independent, 8);
    // A joint that swings freely is out of step within a tolerance or two: the valley may be another one's.
    let mut others = if cost > NEAR * floor {
        within(o, &stated, independent, seed)
    } else {
        Vec::new()
    };
    for other in &mut others {
        polish(o, other, independent, 10);
        let next = polish(o, other, independent, 8);
        if next < BETTER * cost {
            (cost, model) = (next, other.clone());
        }
    }
    (nominal, model)
}
