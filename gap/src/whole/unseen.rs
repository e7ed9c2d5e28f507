//! What these signals could not show, and up to which size.

use super::drive::INERTIA_KG_M2;
use super::found::items;
use super::joints::Found;
use super::servo::{J, JointRun};
use super::{Parts, Settings};
use crate::math;
use crate::verdict::Unseen;
use crate::vocabulary::{Effect, Stage};

/// Largest plausible ratio of an inertia, and share that heat may take off a torque limit.
const INERTIA: f64 = 5.0;
const DERATED: f64 = 0.6;

/// Whether the signals tell of `e` without a fit: what was read off them and not found is not there.
fn read_off(d: &Parts, e: Effect) -> bool {
    let mut joints = d.data.runs.iter().flat_map(|r| &r.joints);
    match e {
        Effect::Latency
        | Effect::Jitter
        | Effect::PacketLoss
        | Effect::Quantisation
        | Effect::ClockSkew => joints.any(|j| j.applied.is_some()),
        Effect::ThermalDerating => joints.any(|j| j.current.is_some()),
        Effect::MotorConstant | Effect::WindingResistance => {
            joints.any(|j| j.current.is_some() && j.duty.is_some())
        }
        Effect::SupplyVoltage | Effect::SupplySag => d.data.runs.iter().any(|r| r.bus_v.is_some()),
        _ => false,
    }
}

/// Largest torque over its limit of the joint that came nearest to it; `None` without torque.
fn nearest_limit(d: &Parts) -> Option<f64> {
    let of = |f: &Found| {
        let limit = f.tier.nominal.max_torque_nm * f.answer.last().theta[J::MaxTorque as usize];
        let tops: Vec<f64> = f
            .tier
            .runs
            .iter()
            .filter_map(|r| r.strongest_nm())
            .collect();
        (!tops.is_empty()).then(|| tops.iter().fold(0.0, |a: f64, x| a.max(*x)) / limit)
    };
    let all: Vec<f64> = d.joints.iter().filter_map(of).collect();
    (!all.is_empty()).then(|| all.iter().fold(0.0, |a: f64, x| a.max(*x)))
}

/// Torque of the weight on a joint's distal side and what the joint's model leaves open, of the joint where it shows most.
fn weight_nm(d: &Parts) -> Option<[f64; 2]> {
    let of = |f: &Found| {
        let all: Vec<f64> = f.tier.runs.iter().map(JointRun::weight_nm).collect();
        f.tier
            .torque
            .then(|| [math::mean(&all), f.tier.torque_tolerance_nm()])
    };
    shown_most(d.joints.iter().filter_map(of))
}

/// The torque that stands highest above what its joint's model leaves open.
fn shown_most(torques: impl Iterator<Item = [f64; 2]>) -> Option<[f64; 2]> {
    let share = |x: &[f64; 2]| x[0] / x[1].max(1e-9);
    torques.max_by(|a, b| share(a).total_cmp(&share(b)))
}

/// Torque that the largest plausible inertia would take, and what its joint's model leaves open, of the joint where it shows most.
fn inertia_nm(d: &Parts) -> Option<[f64; 2]> {
    let of = |f: &Found| {
        let all: Vec<f64> = f
            .tier
            .runs
            .iter()
            .map(|r| r.acceleration_rad_s2())
            .collect();
        let extra = (INERTIA - 1.0) * INERTIA_KG_M2 * math::mean(&all);
        f.tier.torque.then(|| [extra, f.tier.torque_tolerance_nm()])
    };
    shown_most(d.joints.iter().filter_map(of))
}

/// Longest delay of the feedback, or lag of the motor, that a gain within its tolerance hides, s.
fn hidden_delay_s(d: &Parts) -> f64 {
    let of = |f: &Found| {
        let gain = f.tier.nominal.gain_per_s * f.answer.last().theta[J::Gain as usize];
        f.answer.limits.beyond * f.tier.nominal.gain_tolerance / gain.max(1e-9)
    };
    d.joints.iter().map(of).fold(0.0, f64::max)
}

/// Why an effect could not be seen, from what was measured; `None` where it would have been.
fn measured(d: &Parts, e: Effect) -> Option<String> {
    match e {
        Effect::FeedbackDelay | Effect::MotorLag if !d.joints.is_empty() => Some(format!(
            "up to {:.0} ms it acts like a loop gain within its tolerance",
            1e3 * hidden_delay_s(d)
        )),
        // A current shows it whatever the load.
        Effect::ThermalDerating if d.joints.iter().all(|f| !f.tier.ampere) => {
            let share = nearest_limit(d)?;
            (share < 1.0 - DERATED).then(|| {
                format!(
                    "no joint took more than {:.0} % of its torque limit; heat would have to take off more than {:.0} %",
                    100.0 * share,
                    100.0 * (1.0 - share)
                )
            })
        }
        Effect::GravityLoad => {
            let [weight, open] = weight_nm(d)?;
            (weight < open).then(|| {
                format!("the weight beyond a joint takes {weight:.2} N m at most; loads are known to {open:.2} N m only")
            })
        }
        Effect::Inertia => {
            let [extra, open] = inertia_nm(d)?;
            (extra < open).then(|| {
                format!("{INERTIA} times the inertia of a joint would take {extra:.2} N m; its loads are known to {open:.2} N m only")
            })
        }
        _ => None,
    }
}

/// Effects that these signals could not show.
pub(super) fn unseen(d: &Parts, settings: &Settings) -> Vec<Unseen> {
    let torque = d.joints.iter().any(|f| f.tier.torque);
    let found = items(d);
    let filmed = d.data.filmed();
    let mut out = Vec::new();
    for e in Effect::ALL
        .iter()
        .filter(|e| !settings.withhold.contains(e))
    {
        if found.iter().any(|i| i.effect == *e) {
            continue;
        }
        let known = d
            .joints
            .iter()
            .map(|f| &f.answer)
            .chain(d.body.iter().map(|b| &b.answer))
            .chain(d.camera.iter().map(|c| &c.answer))
            .any(|a| a.candidates.iter().any(|c| c.effect == *e));
        if let Some(why) = measured(d, *e) {
            out.push(Unseen { effect: *e, why });
            continue;
        }
        let why = match e {
            Effect::JointOrder | Effect::JointSign => continue,
            Effect::CoulombFriction
            | Effect::ViscousFriction
            | Effect::StribeckFriction
            | Effect::LoadDependentFriction
            | Effect::AsymmetricFriction
            | Effect::QuadraticFriction
            | Effect::TorqueRipple
                if !torque =>
            {
                "a servo that is strong enough hides it; record effort_nm or current_a"
            }
            _ if known || read_off(d, *e) => continue,
            Effect::Inertia => {
                "no law of it is fitted on the whole robot; a bench run of that joint shows it"
            }
            Effect::Mass => {
                "the same mass everywhere moves the robot the same way; needs effort_nm"
            }
            _ if d.body.is_none() && e.stage() == Stage::Body => {
                "no run has the base pose and all six positions"
            }
            _ if e.stage() == Stage::Camera && filmed => {
                "the base pose was read off the film itself; record base_* to judge the camera"
            }
            _ => "no signal of this data set shows it, or the model holds no nominal value for it",
        };
        out.push(Unseen {
            effect: *e,
            why: why.into(),
        });
    }
    out
}
