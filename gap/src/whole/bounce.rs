//! The restitution of the ground, from the shape of what the windows leave over all coefficients.
//!
//! The windows' cost is flat below the true coefficient, steep above it, and rough everywhere: few windows hold a blow, and a blow decides how a body on
//! an edge falls. Where the cost is least says little. So its whole curve is compared with those that the simulator foretells for a robot with each
//! coefficient: what that robot's windows would leave at all others follows from the same trials, with what other windows leave as its noise.

use super::body::{self, B, NUMBERS, Tier};
use super::data::Data;
use super::direct::{Reading, exact};
use super::loads::reading;
use super::{joints, least};

use crate::math;
use crate::vocabulary::{Effect, Stage};

/// Coefficients tried: multiples of this step from nought on.
const STEP: f64 = 0.05;
const STEPS: usize = 20;
/// Other windows that lend their errors to each as its noise.
const LENT: usize = 6;
/// Coefficients at which the windows' dependence on their start is measured besides: a blow of another size decides other falls.
const ELSEWHERE: [f64; 2] = [0.2, 0.8];
/// What 43 robots whose ground is nominal show too much on average, measured as the effects that were found are, and at those two.
const SHOWN: [f64; 3] = [0.0, 0.0, 0.045];
/// Distance from the nominal coefficient below which it is not looked at a second time.
const GLANCE: f64 = 0.08;
/// Distance of the mean of the three from which it may be named: the 43 differ by 0.05, root mean square, and by up to 0.10; 0.38 and 0.62 for 0.5 show
/// 0.04, 0.3 and 0.7 show 0.12 and 0.16.
const LEAST: f64 = 0.11;
/// What curves of coefficients as near as this to the nominal one are off, over what the best one is: up to 1.3 on the 43, 1.9 to 8 where it is told.
const NEAR: f64 = 0.051;
const WORSE: f64 = 1.7;
/// Distance of the true coefficient over the distance shown, below and above: a ground that bounces otherwise is told as more usual than it is
/// (nine robots of 0.05 to 0.9).
const TRUE: [f64; 2] = [1.7, 1.4];
/// Error of a coefficient: of those nine and of twelve others the fifteen that are named differ from the truth by 0.06, root mean square, those of 0.04 and
/// 0.05 by 0.17.
const ERROR: f64 = 0.1;

/// Errors of the windows at every coefficient: `[coefficient][window][number]`.
struct Played<'t> {
    tier: &'t Tier,
    errors: Vec<Vec<[f64; NUMBERS]>>,
}

/// How far the curves of all coefficients are from the measured one, and the coefficient at which that is least.
struct Shown {
    misfits: [f64; STEPS],
    coefficient: f64,
}

fn coefficient(step: usize) -> f64 {
    STEP * step as f64
}

fn least_at(all: &[f64]) -> usize {
    let steps = 0..all.len();
    steps
        .min_by(|a, b| all[*a].total_cmp(&all[*b]))
        .unwrap_or(0)
}

impl<'t> Played<'t> {
    fn new(tier: &'t Tier, theta: &[f64]) -> Self {
        let at = |step| {
            let mut theta = theta.to_vec();
            theta[B::Bounce as usize] = coefficient(step);
            tier.whitened(&theta)
        };
        Self {
            tier,
            errors: (0..STEPS).map(at).collect(),
        }
    }

    /// Logarithms of the costs at every coefficient, of errors by coefficient and window.
    fn curve(&self, errors: impl Fn(usize, usize) -> [f64; NUMBERS]) -> Vec<f64> {
        let cost = |step| {
            let mut groups = vec![Vec::new(); self.tier.groups];
            for (w, g) in self.tier.group.iter().enumerate() {
                let mut own = errors(step, w);
                body::temper(&mut own);
                groups[*g].extend(own);
            }
            libm::log(least::cost(&groups).max(1e-9))
        };
        (0..STEPS).map(cost).collect()
    }

    /// The curve of a robot whose ground has the coefficient `truth`, with the errors `noise` of windows.
    fn foretold(&self, truth: usize, noise: &[[f64; NUMBERS]]) -> Vec<f64> {
        let n = noise.len();
        let mut mean = vec![0.0; STEPS];
        for lent in 1..=LENT {
            let other = |w: usize| &noise[(w + lent * n / (LENT + 1)) % n];
            let one = self.curve(|step, w| {
                let (own, there) = (&self.errors[step][w], &self.errors[truth][w]);
                let noise = other(w);
                std::array::from_fn(|k| own[k] - there[k] + noise[k])
            });
            let parts = mean.iter_mut().zip(one);
            parts.for_each(|(m, x)| *m += x / LENT as f64);
        }
        mean
    }

    fn shown(&self) -> Shown {
        let measured = self.curve(|step, w| self.errors[step][w]);
        let noise = &self.errors[least_at(&measured)];
        let misfits: [f64; STEPS] = std::array::from_fn(|truth| {
            let foretold = self.foretold(truth, noise);
            let apart: Vec<f64> = measured.iter().zip(&foretold).map(|(a, b)| a - b).collect();
            let mean = math::mean(&apart);
            apart.iter().map(|x| (x - mean).powi(2)).sum()
        });
        Shown {
            coefficient: lowest(&misfits),
            misfits,
        }
    }
}

/// Where a parabola through the least of the misfits and its neighbours is least.
fn lowest(misfits: &[f64; STEPS]) -> f64 {
    let at = least_at(misfits);
    let shift = match (at.checked_sub(1).map(|i| misfits[i]), misfits.get(at + 1)) {
        (Some(a), Some(b)) => 0.5 * (a - b) / (a - 2.0 * misfits[at] + b).max(1e-12),
        _ => 0.0,
    };
    STEP * (at as f64 + shift.clamp(-0.5, 0.5))
}

/// The coefficient that all that is `shown` tells together, where it is another one than the `nominal`.
fn told(shown: &[Shown; 3], nominal: f64) -> Option<f64> {
    let each: Vec<f64> = shown
        .iter()
        .zip(SHOWN)
        .map(|(s, more)| s.coefficient - more)
        .collect();
    let off = math::mean(&each) - nominal;
    let sum = |step: usize| shown.iter().map(|s| s.misfits[step]).sum::<f64>();
    let all: Vec<f64> = (0..STEPS).map(sum).collect();
    let near = (0..STEPS).filter(|s| (coefficient(*s) - nominal).abs() < NEAR);
    let near = near.map(|s| all[s]).fold(f64::INFINITY, f64::min);
    let other = off.abs() > LEAST && near > WORSE * all[least_at(&all)];
    let truth = nominal + TRUE[usize::from(off > 0.0)] * off;
    other.then_some(truth.clamp(0.0, 1.0))
}

/// Whether a restitution may be read off: beside another effect of the body, a connection that gives, or joints that only the body shows to be turned round
/// (one robot showed 0.66), a blow tells of that.
fn free(found: &body::Found) -> bool {
    let members = &found.answer.last().members;
    found.tier.as_told()
        && members.iter().all(|m| {
            let effect = found.answer.candidates[*m].effect;
            effect == Effect::GroundSlope || effect.stage() == Stage::Conventions
        })
}

/// Puts the restitution that the windows show in the place of the nominal one; returns it.
pub(super) fn settle(found: &mut body::Found, data: &Data) -> Option<Reading> {
    if !found.tier.exact() || !free(found) {
        return None;
    }
    let nominal = found.answer.nominal[B::Bounce as usize];
    let theta = found.answer.last().theta.clone();
    let first = Played::new(&found.tier, &theta).shown();
    if (first.coefficient - nominal).abs() < GLANCE {
        return None;
    }
    let mut tier = found.tier.clone();
    let mut at = |coefficient: f64| {
        let mut theta = theta.clone();
        theta[B::Bounce as usize] = coefficient;
        tier.measure(data, &theta);
        Played::new(&tier, &theta).shown()
    };
    let [low, high] = ELSEWHERE.map(&mut at);
    let value = told(&[first, low, high], nominal)?;
    let mut theta = theta.clone();
    theta[B::Bounce as usize] = value;
    found.tier.measure(data, &theta);
    found.put(B::Bounce, value, ERROR);
    let gain = ((value - nominal) / ERROR).powi(2);
    let estimate = exact(value, 1.96 * ERROR);
    Some(reading(Effect::Restitution, "coefficient", estimate, gain))
}

/// Whether a restitution that was `read` below the nominal one is what a joint takes of blows that yields at its limit: between two rows of the recording it
/// gives way, and along its angles it does not. A robot with a limit of 0.9 N m showed 0.24 for 0.5.
pub(super) fn blunted(found: &body::Found, read: &Reading, joints: &[joints::Found]) -> bool {
    let nominal = found.answer.nominal[B::Bounce as usize];
    let softer = read.effect == Effect::Restitution && read.estimate.value < nominal;
    softer && joints.iter().any(joints::Found::limited)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Misfits that grow with the square of the distance from `least`, from 0.005 on.
    fn shown(least: f64) -> Shown {
        let misfits = std::array::from_fn(|i| 0.005 + (coefficient(i) - least).powi(2));
        Shown {
            coefficient: lowest(&misfits),
            misfits,
        }
    }

    #[test]
    fn the_least_lies_between_the_steps() {
        for least in [0.0, 0.312, 0.5, 0.74, 0.95] {
            let found = shown(least).coefficient;
            assert!((found - least).abs() < 1e-9, "{found} for {least}");
        }
    }

    #[test]
    fn another_bounce_is_told_where_all_show_it_and_the_nominal_one_is_far_worse() {
        for (what, shows, is) in [
            ("the nominal one", [0.5, 0.48, 0.56], None),
            (
                "as robots without a cause show it",
                [0.42, 0.38, 0.45],
                None,
            ),
            ("a soft ground", [0.33, 0.31, 0.38], Some(0.22)),
            ("a hard one", [0.71, 0.70, 0.75], Some(0.79)),
            ("one of three alone", [0.70, 0.52, 0.55], None),
            ("no more than there is", [0.9, 0.9, 0.95], Some(1.0)),
        ] {
            let told = told(&shows.map(shown), 0.5);
            assert_eq!(told.is_some(), is.is_some(), "{what}: {told:?}");
            let apart = told.unwrap_or(0.0) - is.unwrap_or(0.0);
            assert!(apart.abs() < 0.03, "{what}: {told:?}");
        }
        let flat = || Shown {
            misfits: [0.1; STEPS],
            coefficient: 0.2,
        };
        assert_eq!(
            told(&[flat(), flat(), flat()], 0.5),
            None,
            "curves that all fit alike"
        );
    }
}
