//! From fitted parameters to the keys of the vocabulary, and words for people.

use crate::candidates::{Candidate, Scales};
use crate::joint::{P, Params, Problem};
use crate::vocabulary::Effect;

/// Parameters of an effect as the vocabulary names them.
#[must_use]
pub fn parameters(problem: &Problem, c: &Candidate, params: &Params) -> Vec<(&'static str, f64)> {
    let g = |p| params.get(p);
    let first = c.free.first().map_or(0.0, |f| g(f.p));
    let supply = problem.runs.first().map_or(1.0, |r| r.nominal.supply_v);
    match c.effect {
        Effect::JointSign => Vec::new(),
        Effect::Jitter | Effect::PacketLoss => {
            let r = crate::joint::arrival::regularity(&problem.runs);
            let value = r.map_or(0.0, |r| match c.effect {
                Effect::PacketLoss => r.lost,
                // The halfway instants of rows add a spread of their own.
                _ => (r.spread_s * r.spread_s - r.doubt_s * r.doubt_s / 12.0)
                    .max(0.0)
                    .sqrt(),
            });
            c.effect
                .parameters()
                .iter()
                .take(1)
                .map(|k| (*k, value))
                .collect()
        }
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
                ("amplitude_nm", s.hypot(k)),
                ("periods", g(P::RipplePeriods)),
                ("phase_rad", libm::atan2(k, s)),
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
        e => e.parameters().iter().take(1).map(|k| (*k, first)).collect(),
    }
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
