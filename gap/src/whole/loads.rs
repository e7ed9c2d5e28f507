//! What all joints' loads say together: the robot's mass, and the ground's friction.
//!
//! On closed chains of contacts the torques grow with the friction of the ground as they grow with the weight, alike at all joints. So the
//! friction is settled first (module `friction`); what the loads are off by on that ground is the mass.

use std::sync::Arc;

use files::model::{Key, Model};
use physics::Params;

use super::conventions::Conventions;
use super::data::{Data, JOINTS};
use super::direct::{Reading, exact};
use super::joints::{Found, Tier};
use super::least::solve;
use super::servo::Load;
use super::windows::{LinkMap, Window};
use super::{body, friction, servo, windows};
use crate::math;
use crate::verdict::Estimate;
use crate::vocabulary::Effect;

/// What the loads are replayed with.
pub(super) struct Replay<'a> {
    pub(super) data: &'a Data,
    pub(super) model: &'a Model,
    pub(super) fit_runs: &'a [usize],
    pub(super) conventions: &'a Conventions,
    pub(super) joints: &'a [Found],
    /// The joints moved in another order than they were told.
    pub(super) mixed: bool,
}

/// Least joints whose loads are judged together.
pub(super) const JOINTLY: usize = 4;
/// Relative error of the loads of all joints together: null robots show 0.97 to 1.07 (emulated robots, eight seeds); without an inertial
/// sensor those of another engine 0.87 and, with contacts that rub less, 0.72. Where the clock is skewed a robot shows 1.16 that shows 1.08
/// without. Perhaps rows that drift through the period of the set-points meet peaks of the torques that rows in step with them miss. Joints
/// that move in another order show 1.15 for 1.02.
const LOAD_ERROR: f64 = 0.035;
const LOAD_ERROR_ROUGH: f64 = 0.07;
/// Standard deviations by which a mass must be off to be named: of 130 emulated robots without another one one shows 3.07, the next 2.63.
const MASS_DEVIATIONS: f64 = 3.3;
/// Share of that which every five of the joints must show without the sixth.
const WITHOUT: f64 = 0.6;

/// Sums of squares and products over torque samples, (N m)2: of measured torques less the joint's friction, and of replayed loads.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    measured: f64,
    both: f64,
    replayed: f64,
}

impl std::iter::Sum for Moments {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |a, b| Self {
            measured: a.measured + b.measured,
            both: a.both + b.both,
            replayed: a.replayed + b.replayed,
        })
    }
}

impl Moments {
    /// From the products of torque, load, speed and direction with one another; `bare` of what speed and direction explain.
    pub(super) fn new(gram: &[[f64; 4]; 4], bare: bool) -> Self {
        let [t, l, s, d] = gram;
        // A joint that stands has neither.
        let square = [s[2] + 1e-9, s[3], s[3], d[3] + 1e-9];
        let product = |a: &[f64; 4], b: &[f64; 4], own: f64| {
            let weights = solve(&square, &[b[2], b[3]]);
            let follows = if bare {
                weights[0] * a[2] + weights[1] * a[3]
            } else {
                0.0
            };
            own - follows
        };
        Self {
            measured: product(t, t, t[0]),
            both: product(t, l, t[1]),
            replayed: product(l, l, l[1]),
        }
    }

    /// Measured over replayed load. Where windows start from an inertial sensor's speeds the replay chatters and the measured torque does
    /// not, so the load is what regresses; else both hold errors of one size, so that neither regression is right and their ratio is.
    fn ratio(&self, inertial: bool) -> f64 {
        if inertial {
            self.measured / self.both.max(1e-12)
        } else {
            (self.measured / self.replayed.max(1e-12)).sqrt()
        }
    }

    /// Share of the measured torque that replayed loads of whatever size leave.
    pub(super) fn left(&self) -> f64 {
        let follows = self.both.powi(2) / (self.measured * self.replayed).max(1e-12);
        (1.0 - follows).clamp(1e-6, 1.0)
    }
}

impl Replay<'_> {
    /// Whether windows start from an inertial sensor's speeds.
    fn inertial(&self) -> bool {
        let bases = self.data.runs.iter().filter_map(|r| r.base.as_ref());
        bases.into_iter().any(|b| b.reckoned.is_some())
    }

    /// The joints whose torques show their loads: one at its limit bears what its torque does not show.
    fn strong(&self) -> impl Iterator<Item = &Found> {
        self.joints.iter().filter(|f| !f.limited())
    }

    /// Moments of the joints as they were found, under the loads of a body and its links.
    pub(super) fn moments(
        &self,
        windows: &mut [Window],
        with: (&Arc<Params>, &[LinkMap; JOINTS]),
    ) -> Vec<Moments> {
        let loads = replay(self.data, windows, with);
        let one = |f: &Found| {
            let (runs, k) = (self.fit_runs, f.tier.joint);
            let tier = Tier::new(self.data, self.model, k, runs, self.conventions, &loads)?;
            tier.moments(&f.answer.last().theta, false)
        };
        self.strong().filter_map(one).collect()
    }

    /// Measured over replayed load of all joints, with the ground's friction `ratio` times the nominal one.
    pub(super) fn ratio(&self, found: &body::Found, windows: &mut [Window], ratio: f64) -> f64 {
        let theta = friction::with(found, ratio);
        let params = Arc::new(found.tier.params(&theta));
        let all = self.moments(windows, (&params, &found.tier.links(&theta)));
        all.into_iter().sum::<Moments>().ratio(self.inertial())
    }

    /// Friction over the nominal one at which the replayed loads are as large as the measured ones.
    fn balance(&self, found: &body::Found, windows: &mut [Window]) -> f64 {
        const ENDS: [f64; 2] = [0.1, 4.0];
        const BISECTIONS: usize = 7;
        let [mut low, mut high] = ENDS.map(libm::log);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            // Replayed loads grow with the friction, so the ratio falls.
            if self.ratio(found, windows, libm::exp(middle)) > 1.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        libm::exp(0.5 * (low + high))
    }

    /// The mass of the whole robot, where the loads of all joints, and of all but any one, are larger or smaller than those of the nominal
    /// body.
    pub(super) fn mass(&self) -> Option<Reading> {
        let own = |f: &Found| f.tier.moments(&f.answer.last().theta, false);
        let all: Vec<Moments> = self.strong().filter_map(own).collect();
        if all.len() < JOINTLY {
            return None;
        }
        let without = |k: usize| -> f64 {
            let others = all.iter().enumerate().filter(|m| m.0 != k);
            others.map(|m| *m.1).sum::<Moments>().ratio(self.inertial())
        };
        let ratio = all.iter().copied().sum::<Moments>().ratio(self.inertial());
        let parts: Vec<f64> = (0..all.len()).map(without).collect();
        let half = self.model.parameter(Key::Mass1);
        // Eight half-spheres that vary alone.
        let tolerance = half.tolerance / half.value / 8.0_f64.sqrt();
        // Jackknife: joints left out one at a time.
        let moved: Vec<f64> = parts.iter().map(|p| p - math::mean(&parts)).collect();
        let apart = math::rms(&moved) * (parts.len() as f64 - 1.0).sqrt();
        let own = if self.inertial() && !self.conventions.skewed() && !self.mixed {
            LOAD_ERROR
        } else {
            LOAD_ERROR_ROUGH
        };
        // Whether a nominal robot shows such a ratio, and how well a ratio of another one is known.
        let [null, error] = [own, own * ratio].map(|e| libm::hypot(e, apart));
        let least = MASS_DEVIATIONS * libm::hypot(tolerance, null);
        let beyond = |r: &f64, share: f64| (r - 1.0) * (ratio - 1.0).signum() > share * least;
        let all_beyond = parts.iter().all(|r| beyond(r, WITHOUT));
        let gain = ((ratio - 1.0) / libm::hypot(tolerance, null)).powi(2);
        let estimate = exact(ratio, 1.96 * error);
        (beyond(&ratio, 1.0) && all_beyond).then(|| reading(Effect::Mass, "ratio", estimate, gain))
    }

    /// What would make the loads as large as what is named, where that is the one of mass and ground friction: the other one.
    pub(super) fn instead(
        &self,
        named: Effect,
        found: &body::Found,
        windows: &mut [Window],
    ) -> Option<Reading> {
        match named {
            Effect::Mass => {
                let value = self.model.value(Key::Friction) * self.balance(found, windows);
                let key = "coefficient";
                Some(reading(Effect::GroundFriction, key, exact(value, 0.0), 0.0))
            }
            Effect::GroundFriction => {
                let ratio = self.ratio(found, windows, 1.0);
                Some(reading(Effect::Mass, "ratio", exact(ratio, 0.0), 0.0))
            }
            _ => None,
        }
    }
}

/// A reading of what the robot has once.
pub(super) fn reading(effect: Effect, key: &'static str, estimate: Estimate, gain: f64) -> Reading {
    Reading {
        effect,
        joint: None,
        key,
        estimate,
        gain,
    }
}

/// Loads of all joints by run.
pub(super) fn replay(
    data: &Data,
    windows: &[Window],
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
    windows: &[Window],
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
