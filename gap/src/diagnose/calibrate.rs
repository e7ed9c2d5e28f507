//! The nominal model: what is known as it stands, what is unknown fitted; then all within tolerances.

use files::dataset::{Command, Output};

use crate::fit::{Free, Map, Model, Objective};
use crate::joint::{P, Params};
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
        .map(|i| scattered(&start, if i == 0 { None } else { Some(&mut rng) }))
        .collect();
    best(o, models, independent).unwrap_or(start)
}

/// `start` with its free parameters three e-foldings to each side of the reference; without `rng` the reference itself.
fn scattered(start: &Model, mut rng: Option<&mut Rng>) -> Model {
    let mut m = start.clone();
    for f in &start.free {
        let x = rng
            .as_mut()
            .map_or(0.0, |r| 3.0 * (2.0 * r.uniform() - 1.0));
        m.params.set(f.p, f.to_value(x));
    }
    m
}

/// The best of `models` after the best few are refined.
fn best(o: &Objective<'_>, models: Vec<Model>, independent: f64) -> Option<Model> {
    let mut tries: Vec<(f64, Model)> = o.costs(&models).into_iter().zip(models).collect();
    tries.sort_by(|a, b| a.0.total_cmp(&b.0));
    tries.truncate(REFINED);
    tries
        .iter_mut()
        .for_each(|(c, m)| *c = polish(o, m, independent, 15));
    tries.sort_by(|a, b| a.0.total_cmp(&b.0));
    tries.into_iter().next().map(|t| t.1)
}

/// Unknown nominal values fitted together with the two effects that bend them most where they are left out: dry friction,
/// and a weight where no gravity is stated. A search that starts from values bent by those never finds its valley.
/// `None` where nothing is unknown.
pub(super) fn rich(
    o: &Objective<'_>,
    free: &[Free],
    independent: f64,
    seed: u64,
) -> Option<Params> {
    let unknown: Vec<Free> = (free.iter().copied())
        .filter(|f| f.tolerance.is_none())
        .collect();
    let n = &o.problem.runs.first()?.nominal;
    if unknown.is_empty() || n.command != Command::Position {
        return None;
    }
    // Effort that the controller usually asks for, per ratio of motor constant to resistance.
    let full = if n.output == Output::Duty {
        n.supply_v
    } else {
        1.0
    };
    let asked = (n.kp * usual_error(o)).min(n.limit);
    let usual = n.stall / n.supply_v.max(1e-9) * full * asked;
    let own = |p, low: f64| Free {
        p,
        map: Map::Linear { scale: 0.1 * usual },
        low,
        high: 1e4 * usual,
        tolerance: None,
    };
    let mut added = vec![own(P::Coulomb, 0.0)];
    if n.gravity == 0.0 {
        added.push(own(P::Weight, -1e4 * usual));
    }
    let start = Model {
        params: Params::default(),
        free: (unknown.into_iter())
            .filter(|f| added.iter().all(|a| a.p != f.p))
            .collect(),
    };
    let mut rng = Rng::new(seed ^ 0x71C4);
    let models = (0..STARTS).map(|_| {
        let mut m = scattered(&start, Some(&mut rng));
        let strength = usual * m.params.get(P::Motor) / m.params.get(P::Resistance);
        for f in &added {
            let part = rng.uniform();
            let turn = if f.low < 0.0 && rng.uniform() < 0.5 {
                -1.0
            } else {
                1.0
            };
            m.params.set(f.p, turn * part * strength);
        }
        m.free.extend(&added);
        m
    });
    best(o, models.collect(), independent).map(|m| m.params)
}

/// Root mean square of set-point minus position.
fn usual_error(o: &Objective<'_>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0_f64);
    for run in o.runs.iter().map(|r| &o.problem.runs[*r]) {
        let mut k = 0;
        for s in run
            .samples
            .iter()
            .filter(|s| s.enabled && s.measured[0].is_finite())
        {
            let t = (s.step as f64 + s.part) * o.problem.dt_s;
            while run.command_t_s.get(k + 1).is_some_and(|c| *c <= t) {
                k += 1;
            }
            let e = run.command.get(k).map_or(0.0, |c| c - s.measured[0]);
            (sum, count) = (sum + e * e, count + 1.0);
        }
    }
    (sum / count.max(1.0)).sqrt().max(1e-6)
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
