//! What to believe: the word of the verdict, and probabilities that sum to one.
//!
//! Every probability rests on how far its evidence stands from the threshold that it passed or missed, through logistic curves. That of
//! `none` is fitted to 63 answers of three suites of emulated robots (57 right; most likely constants, to one digit). The constants of the
//! others are chosen: near a threshold four of five answers are right, far from it nearly all. What a sealed suite makes of them is its
//! calibration error (docs/diagnosis-data.md).

use super::body_rest::Rest;
use super::found::{self, Item, Place};
use super::{Parts, open, search};
use crate::math;
use crate::verdict::{Probabilities, Word};
use crate::vocabulary::Stage;

/// Share of the gap that must be explained for `explained`.
const EXPLAINED: f64 = 0.8;
/// Cost of a joint above which it leaves something, where nothing at all was named: 30 emulated robots without a cause leave less, one with a motor's lag of
/// 17 ms that must not be named 3.4.
pub(super) const BARE: f64 = 2.5;
/// Evidence, in thresholds, of a law that signals break and no effect of the library keeps.
const BROKEN: f64 = 10.0;
/// Evidence of something that changes along the runs, which is found or not found.
const UNSTEADY: f64 = 3.0;

/// Curves of the probability to be right over the evidence: log odds and their slope at the threshold. An effect and an unknown over the logarithm of
/// the evidence, `none` over the distance below the threshold.
const EFFECT: [f64; 2] = [1.5, 1.0];
const UNKNOWN: [f64; 2] = [1.0, 1.0];
const NONE: [f64; 2] = [1.7, 1.5];
/// Share of a wrong answer's probability that goes to `none`.
const NOTHING: f64 = 0.15;

/// Probabilities of nothing, of something unknown, and of every effect. They sum to one by construction.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Belief {
    none: f64,
    unknown: f64,
    effects: Vec<f64>,
}

impl Belief {
    /// Shares of the weights; without any it is something unknown.
    fn new(none: f64, unknown: f64, effects: &[f64]) -> Self {
        let clean = |x: f64| if x.is_finite() { x.max(0.0) } else { 0.0 };
        let sum = clean(none) + clean(unknown) + effects.iter().map(|x| clean(*x)).sum::<f64>();
        if sum <= 0.0 || !sum.is_finite() {
            return Self {
                none: 0.0,
                unknown: 1.0,
                effects: vec![0.0; effects.len()],
            };
        }
        Self {
            none: clean(none) / sum,
            unknown: clean(unknown) / sum,
            effects: effects.iter().map(|x| clean(*x) / sum).collect(),
        }
    }

    pub(super) fn probabilities(&self) -> Probabilities {
        Probabilities {
            none: self.none,
            unknown: self.unknown,
        }
    }

    /// Probability of every item, in their order.
    pub(super) fn effects(&self) -> &[f64] {
        &self.effects
    }
}

fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + libm::exp(-x))
}

fn curve(at: [f64; 2], x: f64) -> f64 {
    logistic(at[0] + at[1] * x)
}

/// What speaks for and against a remainder.
pub(super) struct Remainder {
    /// Largest cost that a tier keeps, over that above which something is left.
    worst: f64,
    /// The same of joints where nothing at all was named.
    bare: f64,
    /// Share of all excess that was explained.
    explained: f64,
    /// Evidence that something follows a law that the library does not hold, in thresholds; 0 = none.
    odd: f64,
    /// Evidence that the simulator misses something of the body, in thresholds; 0 = none.
    body: f64,
    /// Where that arose.
    place: (Stage, Option<usize>),
    /// Gain of the best effect that was not taken, over its threshold.
    nearest: f64,
}

fn answers(d: &Parts) -> impl Iterator<Item = &search::Answer> {
    let joints = d.joints.iter().map(|f| &f.answer);
    joints
        .chain(d.body.iter().map(|b| &b.answer))
        .chain(d.camera.iter().map(|c| &c.answer))
}

/// Evidence of laws that the library does not hold, in thresholds.
fn odd(d: &Parts) -> f64 {
    let broken = d.conventions.echo.iter().any(|e| e.odd) || !found::nameless(d).is_empty();
    let unsteady = d.body.as_ref().is_some_and(|b| b.changes.is_some());
    let laws = d
        .joints
        .iter()
        .filter(|f| f.odd)
        .map(|f| (f.law.share / open::LAW).max(1.0));
    let flags = [
        if broken { BROKEN } else { 0.0 },
        if unsteady { UNSTEADY } else { 0.0 },
    ];
    laws.chain(flags).fold(0.0, f64::max)
}

impl Remainder {
    pub(super) fn new(d: &Parts, items: &[Item]) -> Self {
        let excess = |cost: f64| (cost - 1.0).max(0.0);
        let (mut worst, mut first, mut last, mut nearest) = (0.0f64, 0.0, 0.0, 0.0f64);
        for a in answers(d) {
            worst = worst.max(a.last().cost / a.limits.remainder);
            first += excess(math::mean(&a.nominal_groups));
            last += excess(a.last().cost);
            nearest = nearest.max(a.nearest);
        }
        let rest = d.body.as_ref().map_or(Rest::NONE, |b| b.rest);
        let explained = if first > 0.0 { 1.0 - last / first } else { 1.0 };
        // The least share explained of a joint that keeps a remainder.
        let share = |a: &search::Answer| {
            1.0 - excess(a.last().cost) / excess(math::mean(&a.nominal_groups)).max(1e-12)
        };
        let left = d.joints.iter().map(|f| &f.answer);
        let least = left
            .filter(|a| a.last().cost > a.limits.remainder)
            .map(share)
            .fold(1.0, f64::min);
        let costs = d.joints.iter().map(|f| f.answer.last().cost);
        Self {
            worst,
            bare: costs.fold(0.0, f64::max) / BARE,
            explained: explained.min(least),
            odd: odd(d),
            body: rest.evidence(!items.is_empty()),
            place: rest.place,
            nearest,
        }
    }

    /// Notes the `share` of the squared gap that effects outside the tiers' models explain with the rest: no tier's cost shows it.
    pub(super) fn explain(&mut self, share: f64) {
        self.explained = self.explained.max(share);
    }

    /// The word of the verdict.
    pub(super) fn word(&self, items: &[Item]) -> Word {
        let bare = items.is_empty() && self.bare > 1.0;
        let left = self.worst > 1.0 || bare || self.odd > 0.0 || self.body > 0.0;
        // What the body keeps takes nothing from what joints and signals show, but leaves nothing explained that the body shows,
        // nor what rests on loads that were replayed with it.
        let own = |i: &Item| {
            let stage = i.effect.stage();
            let loads = [Stage::Body, Stage::Drivetrain].contains(&stage);
            // What stays in the very place where an effect was found bears that effect out as little as it is explained by it.
            let same = i.joint.is_some() && (stage, i.joint) == self.place;
            loads || same || matches!(i.place, Place::Body(_))
        };
        let elsewhere = || items.iter().any(|i| !own(i));
        let kept = self.body > 0.0 && !elsewhere();
        let explained = self.explained >= EXPLAINED && self.odd == 0.0 && !kept;
        match (items.is_empty(), left) {
            (true, false) => Word::None,
            (true, true) => Word::Unknown,
            (false, true) if !explained => Word::Unknown,
            (false, true) => Word::PartlyExplained,
            (false, false) if items.iter().all(|i| i.effect.is_base()) => Word::Parametric,
            (false, false) => Word::Explained,
        }
    }

    /// What to believe of `items` and of what they leave.
    pub(super) fn belief(&self, word: Word, items: &[Item]) -> Belief {
        let beyond = self.worst;
        let each = |i: &Item| curve(EFFECT, libm::log(i.strength.clamp(1.0, 100.0)));
        let right: Vec<f64> = items.iter().map(each).collect();
        let weights: Vec<f64> = items
            .iter()
            .zip(&right)
            .map(|(i, p)| p * i.certainty())
            .collect();
        let sum: f64 = weights.iter().sum();
        let shared = |whole: f64| -> Vec<f64> {
            weights.iter().map(|w| whole * w / sum.max(1e-12)).collect()
        };
        match word {
            Word::None => {
                let room = 1.0 - self.nearest.max(beyond).clamp(0.0, 1.0);
                let none = curve(NONE, room);
                Belief::new(none, 1.0 - none, &[])
            }
            Word::Unknown => {
                let bare = if items.is_empty() { self.bare } else { 0.0 };
                let evidence = beyond.max(bare).max(self.odd).max(self.body);
                let unknown = curve(UNKNOWN, libm::log(evidence.clamp(1.0, 100.0)));
                let rest = 1.0 - unknown;
                Belief::new(NOTHING * rest, unknown, &shared((1.0 - NOTHING) * rest))
            }
            _ => {
                let wrong: f64 = right.iter().map(|p| 1.0 - p).product();
                let open = (wrong + 0.4 * logistic(4.0 * (beyond - 1.5))).min(1.0);
                Belief::new(NOTHING * open, (1.0 - NOTHING) * open, &shared(1.0 - open))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::vocabulary::Effect;

    #[test]
    fn probabilities_sum_to_one_whatever_the_weights() {
        let odd = [0.0, 1.0, 0.88, 1e-300, 1e300, -1.0, f64::NAN, f64::INFINITY];
        for none in odd {
            for unknown in odd {
                for count in 0..4 {
                    let effects: Vec<f64> = (0..count).map(|i| odd[(i * 3 + 2) % 8]).collect();
                    let b = Belief::new(none, unknown, &effects);
                    let p = b.probabilities();
                    let sum = p.none + p.unknown + b.effects().iter().sum::<f64>();
                    assert!((sum - 1.0).abs() < 1e-12, "{none} {unknown} {effects:?}");
                    assert_eq!(b.effects().len(), count);
                }
            }
        }
    }

    #[test]
    fn every_word_states_probabilities_that_sum_to_one() {
        let words = [
            Word::None,
            Word::Unknown,
            Word::PartlyExplained,
            Word::Parametric,
            Word::Explained,
        ];
        let mut rng = math::Rng::new(3);
        for word in words {
            for _ in 0..200 {
                let r = Remainder {
                    worst: 3.0 * rng.uniform(),
                    bare: 3.0 * rng.uniform(),
                    explained: rng.uniform(),
                    odd: 3.0 * rng.uniform(),
                    body: 3.0 * rng.uniform(),
                    place: (Stage::Body, None),
                    nearest: rng.uniform(),
                };
                let b = r.belief(word, &[]);
                let p = b.probabilities();
                assert!((p.none + p.unknown - 1.0).abs() < 1e-12, "{word:?} {p:?}");
            }
        }
    }

    /// An effect of a joint or, without one, of the body.
    fn item(effect: Effect, joint: Option<usize>) -> Item {
        Item {
            effect,
            joint,
            parameters: BTreeMap::new(),
            gain: 1.0,
            strength: 2.0,
            rivals: Vec::new(),
            place: joint.map_or(Place::Body(0), |k| Place::Joint(k, 0)),
            plausible: true,
        }
    }

    #[test]
    fn the_word_follows_from_what_was_found_and_what_is_left() {
        use Effect::{CoulombFriction, GroundFriction, JointOffset, Latency};
        let rubs = [item(CoulombFriction, Some(1))];
        let late = [item(Latency, Some(1))];
        let slips = [item(GroundFriction, None)];
        let off = [item(JointOffset, Some(1))];
        // Effects, then: largest cost left, share explained by the tiers, by all, law that the library does not hold, remainder of the body.
        for (what, items, [worst, tiers, all, odd, body], word) in [
            ("nothing", &[][..], [0.5, 1.0, 1.0, 0.0, 0.0], Word::None),
            (
                "a cost alone",
                &[],
                [1.5, 0.0, 0.0, 0.0, 0.0],
                Word::Unknown,
            ),
            ("a law alone", &[], [0.5, 1.0, 1.0, 1.2, 0.0], Word::Unknown),
            (
                "an effect",
                &rubs,
                [0.5, 0.9, 0.9, 0.0, 0.0],
                Word::Explained,
            ),
            (
                "a nominal number",
                &slips,
                [0.5, 0.9, 0.9, 0.0, 0.0],
                Word::Parametric,
            ),
            (
                "most of it",
                &late,
                [1.5, 0.9, 0.9, 0.0, 0.0],
                Word::PartlyExplained,
            ),
            (
                "half of it",
                &late,
                [1.5, 0.5, 0.5, 0.0, 0.0],
                Word::Unknown,
            ),
            (
                "most of it by signals",
                &late,
                [1.5, 0.5, 0.95, 0.0, 0.0],
                Word::PartlyExplained,
            ),
            (
                "an effect beside a law",
                &late,
                [0.5, 0.9, 0.9, 1.2, 0.0],
                Word::Unknown,
            ),
            (
                "the body keeps something",
                &slips,
                [0.5, 0.9, 0.9, 0.0, 1.5],
                Word::Unknown,
            ),
            (
                "so do replayed loads",
                &rubs,
                [0.5, 0.9, 0.9, 0.0, 1.5],
                Word::Unknown,
            ),
            (
                "a signal stands beside it",
                &late,
                [0.5, 0.9, 0.9, 0.0, 1.5],
                Word::PartlyExplained,
            ),
            (
                "a zero that keeps moving",
                &off,
                [0.5, 0.9, 0.9, 0.0, 1.5],
                Word::Unknown,
            ),
        ] {
            let mut r = Remainder {
                worst,
                bare: 0.0,
                explained: tiers,
                odd,
                body,
                place: (Stage::Conventions, Some(1)),
                nearest: 0.0,
            };
            r.explain(all);
            assert_eq!(r.word(items), word, "{what}");
        }
    }

    #[test]
    fn a_joint_that_leaves_something_is_unknown_where_nothing_was_named() {
        let late = [item(Effect::Latency, Some(1))];
        for (items, bare, word) in [
            (&[][..], 0.8, Word::None),
            (&[], 1.3, Word::Unknown),
            (&late, 1.3, Word::Explained),
        ] {
            let r = Remainder {
                worst: 0.5,
                bare,
                explained: 0.9,
                odd: 0.0,
                body: 0.0,
                place: Rest::NONE.place,
                nearest: 0.0,
            };
            assert_eq!(r.word(items), word, "{bare}");
        }
    }
}
