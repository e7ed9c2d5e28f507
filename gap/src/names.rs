//! From fitted parameters to the keys of the vocabulary, and words for people.

use std::f64::consts::TAU;

use crate::candidates::{Candidate, Scales};
use crate::joint::arrival::Regularity;
use crate::joint::{P, Params, Problem};
use crate::vocabulary::Effect;

/// Parameters of an effect as the vocabulary names them.
#[must_use]
pub fn parameters(problem: &Problem, c: &Candidate, params: &Params) -> Vec<(&'static str, f64)> {
    let g = |p| params.get(p);
    let first = c.free.first().map_or(0.0, |f| g(f.p));
    let supply = problem.runs.first().map_or(1.0, |r| r.nominal.supply_v);
    match c.effect {
        Effect::JointSign => vec![("sign", -1.0)],
        Effect::SupplyVoltage => vec![("value_v", supply * g(P::Supply))],
        Effect::ClockSkew => vec![("ratio", 1.0 + g(P::Skew))],
        Effect::Compliance => vec![("stiffness_nm_rad", 1.0 / g(P::Flexibility).max(1e-12))],
        Effect::AsymmetricFriction => {
            vec![
                ("difference_nm", 2.0 * g(P::Asymmetry)),
                ("difference_nm_s_rad", 2.0 * g(P::AsymmetryViscous)),
            ]
        }
        Effect::TorqueRipple => {
            let (s, k) = (g(P::RippleSin), g(P::RippleCos));
            vec![
                ("amplitude_nm", libm::hypot(s, k)),
                ("periods", g(P::RipplePeriods)),
                ("phase_rad", libm::atan2(k, s).rem_euclid(TAU)),
            ]
        }
        Effect::ThermalDerating => vec![
            ("time_constant_s", g(P::DerateTime)),
            ("fraction", g(P::DerateShare)),
        ],
        Effect::StribeckFriction => vec![
            ("static_nm", g(P::Static)),
            ("velocity_rad_s", g(P::StribeckSpeed)),
        ],
        Effect::GravityLoad if c.free.iter().any(|f| f.p == P::Weight) => {
            vec![("torque_nm", g(P::Weight))]
        }
        e => e
            .parameters()
            .iter()
            .take(1)
            .map(|k| (k.key, first))
            .collect(),
    }
}

/// Spread of the delays.
#[must_use]
pub fn jitter_s(problem: &Problem, r: &Regularity) -> f64 {
    // The halfway instants of rows add a spread of their own.
    let seen = r.spread_s * r.spread_s - r.doubt_s * r.doubt_s / 12.0;
    sent_jitter(seen.max(0.0).sqrt(), interval_s(problem))
}

/// Usual time between changed set-points, s.
fn interval_s(problem: &Problem) -> f64 {
    let mut all = Vec::new();
    for run in &problem.runs {
        all.extend(run.command_t_s.windows(2).map(|w| w[1] - w[0]));
    }
    crate::math::median(&all)
}

/// Spread of the delays that made a spread of `seen` among the set-points that came into force. One that comes after the next
/// is never seen, and the late are the ones that do: so the seen spread is too small where it nears the interval.
fn sent_jitter(seen: f64, interval_s: f64) -> f64 {
    if interval_s.is_nan() || seen <= 0.0 {
        return seen;
    }
    // Root mean square of seen delays that are halves of a normal distribution of spread `sigma`.
    let shown = |sigma: f64| {
        let later = |x: f64| libm::erfc(x.max(0.0) / (sigma * std::f64::consts::SQRT_2));
        let (mut sum, mut square) = (0.0, 0.0);
        for k in 0..400 {
            let d = 0.0125 * sigma * (f64::from(k) + 0.5);
            let behind = (1..=8).map(|n| later(d - f64::from(n) * interval_s));
            let weight = libm::exp(-0.5 * (d / sigma) * (d / sigma)) * behind.product::<f64>();
            sum += weight;
            square += weight * d * d;
        }
        (square / sum.max(1e-300)).sqrt()
    };
    let mut sigma = seen;
    for _ in 0..30 {
        // Beyond three times the interval hardly anything is seen of the spread.
        sigma = (sigma * seen / shown(sigma)).min(3.0 * interval_s.max(seen));
    }
    sigma
}

/// Whether the values are physically plausible.
#[must_use]
pub fn plausible(c: &Candidate, params: &Params, s: &Scales) -> bool {
    let v = |p: P| params.get(p);
    c.free.iter().all(|f| {
        let x = v(f.p);
        match f.p {
            // Beyond a factor 2 no data sheet is off; the story of impossible motors in fitted models.
            P::Inertia
            | P::Gravity
            | P::Motor
            | P::Resistance
            | P::Supply
            | P::LoopGain
            | P::Damping => f.tolerance.is_some() || (0.5..=2.0).contains(&x),
            P::Delay | P::FeedbackDelay | P::Lag => x < 0.5,
            P::Coulomb | P::Static => x < 2.0 * s.effort,
            P::LoadShare => x < 0.9,
            P::Skew => x.abs() < 0.05,
            P::DerateTime => x > 2.0,
            P::DerateShare => x < 0.7,
            // Eight bits a turn is the coarsest set-point a servo takes.
            P::Quantum => x < 0.025,
            // Units may be mixed up; no gear or horn is wrong by more than a factor 2.
            P::Scale => {
                let degrees = x.abs() * 180.0 / std::f64::consts::PI;
                let near = |r: f64| (0.5..=2.0).contains(&r);
                near(x.abs()) || near(degrees) || near(x.abs() * std::f64::consts::PI / 180.0)
            }
            P::Deadband | P::Play | P::OutputPlay => x < 0.5 * s.range,
            P::Weight => x.abs() < 3.0 * s.effort,
            _ => true,
        }
    })
}

/// What to record to separate a class.
#[must_use]
pub fn separate_by(effects: &[Effect], problem: &Problem) -> &'static str {
    let has = |e| effects.contains(&e);
    let channel = |c| crate::candidates::measured(problem, c);
    let dead_zone = [Effect::Deadband, Effect::Backlash, Effect::StribeckFriction];
    if dead_zone.iter().filter(|e| has(**e)).count() > 1 {
        if !channel(crate::joint::Channel::Duty) && !channel(crate::joint::Channel::Current) {
            return "record duty or signed current during slow reversals: a controller that ignores small errors puts out nothing, a stuck gear is pushed against, loose play is not";
        }
        return "record link_position behind the gear during slow reversals";
    }
    if has(Effect::CurrentLimit) || has(Effect::TorqueLimit) {
        return "record signed current in a stalled and in a fast motion";
    }
    if has(Effect::Latency) || has(Effect::FeedbackDelay) || has(Effect::MotorLag) {
        return "record the driver's applied set-point and its duty, each with its own time stamp";
    }
    if has(Effect::SupplySag) || has(Effect::SupplyVoltage) {
        return "record bus voltage with the motors idle and under load";
    }
    if has(Effect::CoulombFriction)
        || has(Effect::LoadDependentFriction)
        || has(Effect::StribeckFriction)
    {
        return "repeat one motion with a second payload, and one slow constant-speed triangle";
    }
    if has(Effect::LoopGain) || has(Effect::ViscousFriction) || has(Effect::MotorConstant) {
        return "record signed current and duty during a chirp";
    }
    "record signed current, duty and bus voltage, and add a chirp and a slow triangle"
}

#[cfg(test)]
mod tests {
    use super::sent_jitter;
    use crate::math::Rng;

    /// Spread of the delays seen among set-points sent every 50 ms, each late by half a normal distribution, in order.
    fn seen(sigma: f64) -> f64 {
        let mut rng = Rng::new(7);
        let mut normal = || {
            let (u, v) = (1.0 - rng.uniform(), rng.uniform());
            ((-2.0 * libm::log(u)).sqrt() * libm::cos(std::f64::consts::TAU * v)).abs()
        };
        let arrivals: Vec<f64> = (0..20_000)
            .map(|k| 0.05 * f64::from(k) + sigma * normal())
            .collect();
        let (mut square, mut count) = (0.0, 0.0_f64);
        for k in 0..arrivals.len() - 10 {
            if arrivals[k + 1..k + 10]
                .iter()
                .all(|later| *later > arrivals[k])
            {
                let delay = arrivals[k] - 0.05 * k as f64;
                (square, count) = (square + delay * delay, count + 1.0);
            }
        }
        (square / count).sqrt()
    }

    #[test]
    fn set_points_overtaken_on_the_way_count_too() {
        for sigma in [0.005, 0.02, 0.035, 0.05] {
            let found = sent_jitter(seen(sigma), 0.05);
            assert!((found / sigma - 1.0).abs() < 0.03, "{sigma}: {found}");
        }
        assert_eq!(sent_jitter(0.0, 0.05), 0.0);
    }
}
