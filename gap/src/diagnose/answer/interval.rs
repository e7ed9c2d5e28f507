//! Values of an effect's parameters with 95 % intervals.

use crate::candidates::Candidate;
use crate::diagnose::Diagnosis;
use crate::fit::{self, Objective, Spread, Stop};
use crate::joint::arrival::regularity;
use crate::joint::{P, Params, Problem};
use crate::names;
use crate::verdict::Estimate;
use crate::vocabulary::Effect;

/// How far the model's parameters may be off; `None` where the data leaves some of them free altogether.
pub(super) fn spread(d: &Diagnosis) -> Option<Spread> {
    let o = Objective {
        problem: &d.problem,
        runs: d.fit_runs.clone(),
        weight: d.floor.weights(),
        prior_weight: 1.0 / d.independent,
        robust: d.floor.repeat.is_some(),
        stop: Stop::NEVER,
    };
    let gaits: Vec<usize> = (d.fit_runs.iter())
        .map(|r| d.problem.runs[*r].gait)
        .collect();
    fit::spread(&o, &d.selection.model, d.independent, &gaits)
}

/// Every parameter of an effect under the vocabulary's key.
pub(super) fn estimates(
    d: &Diagnosis,
    c: &Candidate,
    spread: Option<&Spread>,
) -> Vec<(String, Estimate)> {
    let values = names::parameters(&d.problem, c, &d.selection.model.params);
    let one = |(i, (key, value)): (usize, (&'static str, f64))| {
        let ci95 = counted(&d.problem, c.effect, value)
            .or_else(|| spread.map(|s| fitted(d, c, s, i, value)))
            .unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
        let found = Estimate { value, ci95 };
        (key.to_string(), within_tick(d, c.effect, found))
    };
    values.into_iter().enumerate().map(one).collect()
}

/// Interval of parameter `i`: the model moved to both ends, along the direction of the free parameters that moves the
/// value most for its probability.
fn fitted(d: &Diagnosis, c: &Candidate, spread: &Spread, i: usize, value: f64) -> [f64; 2] {
    /// Step of the slopes in the fit's variables.
    const STEP: f64 = 1e-4;
    let model = &d.selection.model;
    let moved = |shift: &dyn Fn(usize) -> f64| {
        let mut p: Params = model.params;
        for (k, f) in model.free.iter().enumerate() {
            p.set(f.p, f.to_value(f.to_x(p.get(f.p)) + shift(k)));
        }
        let all = names::parameters(&d.problem, c, &p);
        all.get(i).map_or(value, |v| near(v.0, v.1, value))
    };
    let slope = |k: usize| {
        let by = |sign: f64| moved(&|j| if j == k { sign * STEP } else { 0.0 });
        (by(1.0) - by(-1.0)) / (2.0 * STEP)
    };
    let slopes: Vec<f64> = (0..model.free.len()).map(slope).collect();
    let end = spread.end(&slopes);
    let (a, b) = (moved(&|k| -end[k]), moved(&|k| end[k]));
    [a.min(b).min(value), a.max(b).max(value)]
}

/// An angle's turn that lies nearest to `value`.
fn near(key: &str, x: f64, value: f64) -> f64 {
    if key.starts_with("phase") {
        let turn = std::f64::consts::TAU;
        x - turn * ((x - value) / turn).round()
    } else {
        x
    }
}

/// Interval of what was counted rather than fitted: a binomial share of losses, the spread of delays.
fn counted(problem: &Problem, effect: Effect, value: f64) -> Option<[f64; 2]> {
    /// Part of the time between rows to which the shortest delay is known: it is the zero of the others.
    const ZERO: f64 = 0.05;
    let r = regularity(&problem.runs)?;
    let n = r.sent.max(1.0);
    match effect {
        Effect::PacketLoss => {
            let e = 1.96 * (value * (1.0 - value).max(0.0) / n).sqrt();
            Some([(value - e).max(0.0), value + e])
        }
        Effect::Jitter => {
            let e = 1.96 * libm::hypot(r.spread_s / (2.0 * n).sqrt(), ZERO * r.doubt_s);
            Some([-e, e].map(|e| names::jitter_s(problem, &r, e)))
        }
        _ => None,
    }
}

/// A controller that looks once a period does not tell when within the last one a set-point came: the fit puts it at the
/// end, the middle is nearest on average.
fn within_tick(d: &Diagnosis, effect: Effect, found: Estimate) -> Estimate {
    let nominal = d.problem.runs.first().map(|r| r.nominal.period_s);
    let period_s = nominal.filter(|p| p.is_finite() && *p > 0.0).unwrap_or(0.0);
    if effect != Effect::Latency || d.selection.model.params.get(P::Delay) < period_s {
        return found;
    }
    let [a, b] = found.ci95;
    Estimate {
        value: found.value - 0.5 * period_s,
        ci95: [a - period_s, b],
    }
}
