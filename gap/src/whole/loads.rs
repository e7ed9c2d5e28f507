//! What all joints' loads say together: the robot's mass, and the ground's friction.
//!
//! On closed chains of contacts the torques grow with the friction of the ground as they grow with the weight, alike at all joints.
//! The motion of the base tells the two apart: where the friction that explains the torques also suits the windows of the body
//! better, it is the friction.

use std::sync::Arc;

use files::model::{Key, Model};
use physics::Params;

use super::conventions::Conventions;
use super::data::{Data, JOINTS};
use super::direct::{Reading, exact, mass};
use super::joints::{Found, Tier};
use super::search::Evaluate;
use super::servo::Load;
use super::windows::{LinkMap, Window};
use super::{body, least, servo, windows};
use crate::math;
use crate::vocabulary::Effect;

/// What the loads are replayed with.
pub(super) struct Replay<'a> {
    pub(super) data: &'a Data,
    pub(super) model: &'a Model,
    pub(super) fit_runs: &'a [usize],
    pub(super) conventions: &'a Conventions,
    pub(super) joints: &'a [Found],
}

/// Standard deviations, of tolerance and reading together, by which the friction must be off to be named.
///
/// Chosen: one null robot in a hundred shows its friction beyond 2.5.
const FRICTION_TOLERANCES: f64 = 2.5;
/// Relative error of a friction that is read off the torques: 0.05 on emulated robots with that cause, up to 0.2 where the cause is another
/// one; a robot of another engine shows 0.49 for 0.45.
const FRICTION_ERROR: f64 = 0.08;
/// Loads that differ by less than this, as a share, say nothing.
const ALIKE: f64 = 0.1;
/// Cost of the windows over that with the friction found so far, above which the friction is not what the torques show: a true
/// friction suits the windows better.
const WORSE: f64 = 1.0;
/// Frictions that are tried, as ratios to the one found so far.
const FRICTIONS: [f64; 2] = [0.1, 4.0];
const BISECTIONS: usize = 7;

impl Replay<'_> {
    /// Whether windows start from an inertial sensor's speeds.
    fn inertial(&self) -> bool {
        let bases = self.data.runs.iter().filter_map(|r| r.base.as_ref());
        bases.into_iter().any(|b| b.reckoned.is_some())
    }

    /// Median over the joints of measured over replayed load, with the ground's friction times `scale`.
    fn ratios(&self, found: &body::Found, windows: &mut [Window], scale: f64) -> Vec<f64> {
        let theta = scaled(found, scale);
        let params = Arc::new(found.tier.params(&theta));
        let loads = replay(self.data, windows, (&params, &found.tier.links(&theta)));
        let one = |f: &Found| {
            let k = f.tier.joint;
            let tier = Tier::new(
                self.data,
                self.model,
                k,
                self.fit_runs,
                self.conventions,
                &loads,
            )?;
            tier.load_ratio(&f.answer.last().theta, self.inertial())
        };
        self.joints.iter().filter_map(one).collect()
    }

    /// Friction, as a ratio to the one found so far, at which the replayed loads are as large as the measured ones.
    fn balance(&self, found: &body::Found, windows: &mut [Window]) -> f64 {
        let [mut low, mut high] = FRICTIONS.map(libm::log);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            // Replayed loads grow with the friction, so the ratio falls.
            if math::median(&self.ratios(found, windows, libm::exp(middle))) > 1.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        libm::exp(0.5 * (low + high))
    }

    /// Mass or friction, whichever the loads of all joints and the motion of the base agree on; and beside it the other one, as large as the
    /// loads would have it.
    pub(super) fn cause(&self, body: Option<&body::Found>, windows: &mut [Window]) -> Cause {
        let ratios: Vec<f64> = self
            .joints
            .iter()
            .filter_map(|f| f.tier.load_ratio(&f.answer.last().theta, self.inertial()))
            .collect();
        let half = self.model.parameter(Key::Mass1);
        // Eight half-spheres that vary alone.
        let tolerance = half.tolerance / half.value / 8.0_f64.sqrt();
        let heavier = mass(&ratios, tolerance);
        let ratio = math::median(&ratios);
        let alone = |named| Cause {
            named,
            instead: None,
        };
        let Some(found) = body.filter(|_| ratios.len() >= 4) else {
            return alone(heavier);
        };
        if (ratio - 1.0).abs() < ALIKE {
            return alone(heavier);
        }
        let scale = self.balance(found, windows);
        let worse = misfit(found, scale) / misfit(found, 1.0).max(1e-9);
        let (off, slippery) = friction(self.model, found, scale);
        if worse > WORSE {
            return Cause {
                named: heavier,
                instead: Some(slippery),
            };
        }
        Cause {
            named: Some(slippery).filter(|_| off > FRICTION_TOLERANCES),
            instead: Some(Reading {
                effect: Effect::Mass,
                joint: None,
                key: "ratio",
                estimate: exact(ratio, 0.0),
                gain: 0.0,
            }),
        }
    }
}

/// What the loads say.
pub(super) struct Cause {
    /// What is named.
    pub(super) named: Option<Reading>,
    /// What would make the loads as large.
    pub(super) instead: Option<Reading>,
}

/// Takes a ground's friction out of `found` that the torques of all joints speak against: with it the replayed loads are farther from the
/// measured ones than with the nominal friction. `ratios` are measured over replayed loads of the joints, for a body and its links.
pub(super) fn doubt(
    found: &mut body::Found,
    ratios: impl Fn((&Arc<Params>, &[LinkMap; JOINTS])) -> Vec<f64>,
) {
    // Null robots show loads between 0.85 and 1.05 of the measured ones; a friction of 0.45 halves them.
    const FARTHER: f64 = 0.2;
    let answer = &found.answer;
    let last = answer.last();
    let is = |m: &&usize| answer.candidates[**m].effect == Effect::GroundFriction;
    let Some(at) = last.members.iter().position(|m| is(&m)) else {
        return;
    };
    let far = |theta: &[f64]| {
        let params = Arc::new(found.tier.params(theta));
        let all = ratios((&params, &found.tier.links(theta)));
        (all.len() >= 4).then(|| libm::log(math::median(&all).max(1e-6)).abs())
    };
    let without = answer.removed_alone[at].0.clone();
    let (Some(with), Some(plain)) = (far(&last.theta), far(&without.theta)) else {
        return;
    };
    if with > plain + FARTHER {
        found.answer.drop_member(at, without);
    }
}

/// Loads of all joints by run.
pub(super) fn replay(
    data: &Data,
    windows: &mut [Window],
    (params, maps): (&Arc<Params>, &[LinkMap; JOINTS]),
) -> Vec<[Load; JOINTS]> {
    let plain = |nm: [Vec<f64>; JOINTS]| {
        nm.map(|nm| Load {
            nm,
            gravity_nm: Vec::new(),
        })
    };
    let all = windows::replay(data, windows, params, maps, servo::STEP_S);
    all.into_iter().map(plain).collect()
}

/// The same with the part of each that balances the weight of the joint's distal side: what the loads grow by where every joint bears that
/// weight twice.
pub(super) fn weighed(
    data: &Data,
    windows: &mut [Window],
    (params, maps): (&Arc<Params>, &[LinkMap; JOINTS]),
) -> Vec<[Load; JOINTS]> {
    let mut out = replay(data, windows, (params, maps));
    let mut heavy = Params::clone(params);
    heavy.joints.iter_mut().for_each(|j| j.gravity_ratio += 1.0);
    let twice = windows::replay(data, windows, &Arc::new(heavy), maps, servo::STEP_S);
    for (run, heavy) in out.iter_mut().zip(twice) {
        for (load, heavy) in run.iter_mut().zip(heavy) {
            load.gravity_nm = heavy.iter().zip(&load.nm).map(|(a, b)| a - b).collect();
        }
    }
    out
}

/// Coordinates of the body with the friction times `scale`.
fn scaled(found: &body::Found, scale: f64) -> Vec<f64> {
    let mut theta = found.answer.last().theta.clone();
    theta[body::B::Friction as usize] *= scale;
    theta
}

/// Cost of the windows.
fn misfit(found: &body::Found, scale: f64) -> f64 {
    least::cost(&found.tier.residuals(&scaled(found, scale)))
}

/// The friction times `scale`, and by how many standard deviations it is off.
fn friction(model: &Model, found: &body::Found, scale: f64) -> (f64, Reading) {
    let nominal = model.parameter(Key::Friction);
    let value = nominal.value * scaled(found, scale)[body::B::Friction as usize];
    let spread = libm::hypot(nominal.tolerance, FRICTION_ERROR * value);
    let off = (value - nominal.value).abs() / spread.max(1e-9);
    let reading = Reading {
        effect: Effect::GroundFriction,
        joint: None,
        key: "coefficient",
        estimate: exact(value, 1.96 * FRICTION_ERROR * value),
        gain: off * off,
    };
    (off, reading)
}
