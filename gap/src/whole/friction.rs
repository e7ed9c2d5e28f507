//! The friction of the ground, from the motion of the base and the torques of all joints together.
//!
//! Either alone tells it roughly: the windows' cost is rough in it, and replayed loads grow with the friction as they grow with the mass. How
//! well the loads follow the measured torques, whatever their size, does not hang on the mass, and is rough in another way.

use std::sync::Arc;

use files::model::{Key, Model};
use physics::Params;

use super::body::{self, B};
use super::data::JOINTS;
use super::direct::{Reading, exact};
use super::least;
use super::loads::{Moments, reading};
use super::search::Evaluate;
use super::windows::LinkMap;
use crate::verdict::Estimate;
use crate::vocabulary::{Effect, Stage};

/// Frictions tried: logarithms of their ratios to the nominal one, in steps of this many from the lowest to the highest.
const STEP: f64 = 0.2;
const STEPS: std::ops::RangeInclusive<i32> = -7..=4;
/// Distance from the best one within which the costs are smoothed by a parabola.
const NEAR: f64 = 0.65;
/// Least gain over the nominal friction, as a logarithm of both costs together. Robots with other causes or none show up to 0.03, one of
/// them 0.083. With a friction of 0.75 or less, or 1.3 or more, they show 0.09 and more (emulated robots, sixteen of the one and eight of
/// the other).
const GAIN: f64 = 0.085;
/// The same of a friction below the nominal one: thirty robots without one show up to 0.026.
const GAIN_LESS: f64 = 0.055;
/// The same where the clock is skewed: a robot whose only cause that was showed 0.15.
const GAIN_SKEWED: f64 = 2.0 * GAIN;
/// The same beside another effect of the body, which bends to a friction and a friction to it: without one nine robots show up to 0.044, one of 0.36
/// beside a centre of mass 0.73.
const GAIN_BESIDE: f64 = 3.0 * GAIN;
/// Relative error of the friction found: the same eight differ from the truth by 0.09, root mean square.
const ERROR: f64 = 0.09;
/// Standard deviations, of tolerance and error together, by which it must be off.
const DEVIATIONS: f64 = 2.5;

/// Coordinates of the body with a friction of `ratio` times the nominal one.
pub(super) fn with(found: &body::Found, ratio: f64) -> Vec<f64> {
    let mut theta = found.answer.last().theta.clone();
    theta[B::Friction as usize] = ratio;
    theta
}

/// Where a parabola through those of the costs `at` that lie `within` so much of the least is least, and by how much less than at nought.
pub(super) fn least_of(at: &[(f64, f64)], within: f64) -> Option<(f64, f64)> {
    let best = at.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1))?;
    let near: Vec<(f64, f64)> = at
        .iter()
        .copied()
        .filter(|p| (p.0 - best.0).abs() < within)
        .collect();
    let (mut a, mut b) = ([0.0; 9], [0.0; 3]);
    for (x, y) in &near {
        let row = [1.0, *x, x * x];
        for i in 0..3 {
            b[i] += row[i] * y;
            (0..3).for_each(|j| a[3 * i + j] += row[i] * row[j]);
        }
    }
    let p = least::solve(&a, &b);
    let value = |x: f64| p[0] + p[1] * x + p[2] * x * x;
    let ends = near
        .iter()
        .fold([f64::INFINITY, f64::NEG_INFINITY], |e, n| {
            [e[0].min(n.0), e[1].max(n.0)]
        });
    let x = if p[2] > 0.0 {
        (-0.5 * p[1] / p[2]).clamp(ends[0], ends[1])
    } else {
        best.0
    };
    Some((x, value(0.0) - value(x)))
}

/// A friction that motion and torques agree on.
struct Agreed {
    /// Over the nominal one.
    ratio: f64,
    /// Standard deviations, of tolerance and error together, by which it is off.
    off: f64,
    /// Whether it is another one than the nominal.
    far: bool,
    /// Whether it is so beside other effects of the body too.
    plain: bool,
}

/// Weighs frictions by what the windows and the joints' `moments` leave, the latter under the loads of a body and its links; the clock may be `skewed`.
fn agreed(
    found: &body::Found,
    model: &Model,
    skewed: bool,
    moments: impl Fn((&Arc<Params>, &[LinkMap; JOINTS])) -> Vec<Moments>,
) -> Option<Agreed> {
    let cost = |step: i32| {
        let x = STEP * f64::from(step);
        let theta = with(found, libm::exp(x));
        let params = Arc::new(found.tier.params(&theta));
        let all = moments((&params, &found.tier.links(&theta)));
        let torques = (all.len() >= super::loads::JOINTLY)
            .then(|| all.into_iter().sum::<Moments>().left())?;
        let motion = least::cost(&found.tier.residuals(&theta)).max(1e-6);
        Some((x, libm::log(motion) + libm::log(torques)))
    };
    let at: Vec<(f64, f64)> = STEPS.map(cost).collect::<Option<_>>()?;
    let (x, gain) = least_of(&at, NEAR)?;
    let ratio = libm::exp(x);
    let nominal = model.parameter(Key::Friction);
    let spread = libm::hypot(nominal.tolerance / nominal.value, ERROR * ratio);
    let off = (ratio - 1.0).abs() / spread;
    let least = match (skewed, ratio < 1.0) {
        (true, _) => GAIN_SKEWED,
        (false, true) => GAIN_LESS,
        (false, false) => GAIN,
    };
    Some(Agreed {
        ratio,
        off,
        far: gain > least && off > DEVIATIONS,
        plain: gain > least.max(GAIN_BESIDE) && off > DEVIATIONS,
    })
}

fn estimate(model: &Model, ratio: f64) -> Estimate {
    let value = model.value(Key::Friction) * ratio;
    exact(value, 1.96 * ERROR * value)
}

/// Puts the friction that motion and torques agree on in the place of the one found, or takes a ground friction out of `found` that they do
/// not bear out. Returned are what they agree on, over the nominal friction, however near to it, and a friction that the motion alone did not show.
// On a film (`rough`) replayed loads are too rough to better a value that the windows found; where the clock is `skewed` they follow worse.
pub(super) fn settle(
    found: &mut body::Found,
    model: &Model,
    [rough, skewed]: [bool; 2],
    moments: impl Fn((&Arc<Params>, &[LinkMap; JOINTS])) -> Vec<Moments>,
) -> (Option<f64>, Option<Reading>) {
    let Some(a) = agreed(found, model, skewed, moments) else {
        return (None, None);
    };
    let answer = &mut found.answer;
    let named = |of: &dyn Fn(Effect) -> bool| {
        let mut members = answer.last().members.iter();
        members.position(|m| of(answer.candidates[*m].effect))
    };
    let own = named(&|e| e == Effect::GroundFriction);
    let other = named(&|e| e.stage() == Stage::Body && e != Effect::GroundSlope);
    if let (Some(at), false) = (own, a.far) {
        let without = answer.removed_alone[at].0.clone();
        answer.drop_member(at, without);
        return (Some(a.ratio), None);
    }
    let beside = own.is_none() && other.is_some();
    if !a.far || (beside && !a.plain) || (own.is_some() && rough) {
        return (Some(a.ratio), None);
    }
    found.put(B::Friction, a.ratio, ERROR * a.ratio);
    let key = "coefficient";
    let estimate = estimate(model, a.ratio);
    let read = reading(Effect::GroundFriction, key, estimate, a.off * a.off);
    (Some(a.ratio), Some(read).filter(|_| own.is_none()))
}

/// The same friction once more, where one was settled and the joints' own frictions are known since.
pub(super) fn again(
    found: &mut body::Found,
    model: &Model,
    skewed: bool,
    moments: impl Fn((&Arc<Params>, &[LinkMap; JOINTS])) -> Vec<Moments>,
) -> Option<Estimate> {
    let a = agreed(found, model, skewed, moments).filter(|a| a.far)?;
    found.put(B::Friction, a.ratio, ERROR * a.ratio);
    Some(estimate(model, a.ratio))
}
