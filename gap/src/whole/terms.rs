//! The words of a search: what is fitted, what may be added, what came out.

use crate::vocabulary::Effect;

/// What is fitted.
pub(super) trait Evaluate: Sync {
    /// Residuals by group (gait) in units of their tolerances; the same lengths for every `theta`.
    fn residuals(&self, theta: &[f64]) -> Vec<Vec<f64>>;

    /// Some of them, evenly chosen: enough to rank candidates.
    fn glimpse(&self, theta: &[f64]) -> Vec<Vec<f64>> {
        self.residuals(theta)
    }
}

/// One number that may be moved.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Coordinate {
    /// Value at which it has no effect.
    pub(super) neutral: f64,
    /// Prior, one standard deviation; 0 = fixed unless a candidate frees it.
    pub(super) sigma: f64,
    /// Step of finite differences.
    pub(super) step: f64,
    /// Distance from the neutral value up to which it is no effect: by so much two simulators of one law may differ.
    pub(super) least: f64,
    /// Smallest and largest value.
    pub(super) range: [f64; 2],
}

/// An effect that may be added.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Candidate {
    /// Which.
    pub(super) effect: Effect,
    /// Its joint.
    pub(super) joint: Option<usize>,
    /// Coordinates it frees.
    pub(super) free: Vec<usize>,
    /// Values to start from.
    pub(super) starts: Vec<Vec<f64>>,
}

/// Thresholds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Limits {
    /// Least gain of the held-out cost as a share of what is above the floor.
    pub(super) share: f64,
    /// Least gain in squared tolerances.
    pub(super) least: f64,
    /// Least gain as a share of the held-out cost.
    pub(super) relative: f64,
    /// Least gain of a further effect as a share of the cost before the first.
    pub(super) of_first: f64,
    /// Cost of a perfect model.
    pub(super) floor: f64,
    /// Independent samples.
    pub(super) independent: f64,
    /// Most effects.
    pub(super) most: usize,
    /// Base parameters must leave their tolerance by this many standard deviations.
    pub(super) beyond: f64,
    /// Candidates that are fitted at every step.
    pub(super) refined: usize,
    /// Iterations of a fit.
    pub(super) iterations: usize,
    /// Cost above which something is left that the library does not explain.
    pub(super) remainder: f64,
    /// Whether the cost is so rough that its slope may lead nowhere: then every coordinate is tried by itself too.
    pub(super) rough: bool,
}

impl Limits {
    /// Of a fit without a selection: nominal numbers stay within three tolerances.
    pub(super) const FIT: Self = Self {
        share: 0.0,
        least: 0.0,
        relative: 0.0,
        of_first: 0.0,
        floor: 1.0,
        independent: 1.0,
        most: 0,
        beyond: 3.0,
        refined: 0,
        iterations: 0,
        remainder: 0.0,
        rough: false,
    };
}

/// A fitted state.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fit {
    /// All coordinates.
    pub(super) theta: Vec<f64>,
    /// Candidates in it, by index.
    pub(super) members: Vec<usize>,
    /// Cost on all groups, in squared tolerances per sample.
    pub(super) cost: f64,
    /// Cost on held-out folds.
    pub(super) held_out: f64,
    /// The same by fold.
    pub(super) folds: Vec<f64>,
    /// Cost by group.
    pub(super) groups: Vec<f64>,
    /// Standard deviation of each free coordinate, by coordinate; 0 where fixed.
    pub(super) deviation: Vec<f64>,
    /// The same with what gaits, borders of tolerances and two simulators of one law disagree by.
    pub(super) spread: Vec<f64>,
}

/// A rival of a found effect.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rival {
    pub(super) candidate: usize,
    /// Cost with the rival over cost with the effect.
    pub(super) ratio: f64,
    pub(super) fit: Fit,
}

/// What a search found.
#[derive(Debug, Clone)]
pub(super) struct Answer {
    pub(super) candidates: Vec<Candidate>,
    /// Calibrated nominal model, then after every step.
    pub(super) steps: Vec<Fit>,
    /// Rivals of every member of the last step.
    pub(super) rivals: Vec<Vec<Rival>>,
    /// The last step without each of its members, and with that member alone.
    pub(super) removed_alone: Vec<(Fit, Fit)>,
    /// Held-out gain of every member of the last step over the threshold that it had to pass.
    pub(super) strengths: Vec<f64>,
    /// The same of the best candidate that was not taken.
    pub(super) nearest: f64,
    /// What the tolerances that nominal parameters moved in the last step cost, in squared tolerances per sample.
    pub(super) pull: f64,
    pub(super) limits: Limits,
    /// Coordinates of the nominal model.
    pub(super) nominal: Vec<f64>,
    /// Its cost by group.
    pub(super) nominal_groups: Vec<f64>,
}

impl Answer {
    /// Goes back to `without`, the last step without its member number `at`. The other members' fits lose it too: the next one that is dropped must not
    /// bring it back.
    pub(super) fn drop_member(&mut self, at: usize, without: Fit) {
        let gone = self.last().members[at];
        self.rivals.remove(at);
        self.removed_alone.remove(at);
        self.strengths.remove(at);
        for (removed, _) in &mut self.removed_alone {
            removed.members.retain(|m| *m != gone);
            for i in &self.candidates[gone].free {
                let freed = |m: &usize| self.candidates[*m].free.contains(i);
                if !removed.members.iter().any(freed) {
                    removed.theta[*i] = self.nominal[*i];
                }
            }
        }
        self.steps.push(without);
    }

    /// The final fit.
    pub(super) fn last(&self) -> &Fit {
        &self.steps[self.steps.len() - 1]
    }
}

/// Whether an effect halves two at least of the folds above the floor and leaves none worse above it: a limit that two gaits alone reach is nothing to
/// the others.
pub(super) fn where_it_acts(base: &Fit, fit: &Fit, floor: f64) -> bool {
    const MENDED: f64 = 0.5;
    let folds = || fit.folds.iter().zip(&base.folds);
    let above = |x: f64| x > floor;
    let mended = folds().filter(|(a, b)| above(**b) && **a < MENDED * **b);
    mended.count() >= 2 && folds().all(|(a, b)| a < b || !above(*a))
}

/// Whether every fold gains.
pub(super) fn on_all(base: &Fit, fit: &Fit) -> bool {
    fit.folds.iter().zip(&base.folds).all(|(a, b)| a < b)
}

/// Whether most folds gain, and more than a twentieth of the mean `gain`: where one gait gains nearly all of it, it is that gait's. Where the mean gain is a
/// `clear` one and two folds show it, one that loses a fifth of it at most does not speak against it: it hardly moves what the effect changes.
pub(super) fn on_most(base: &Fit, fit: &Fit, gain: f64, clear: bool) -> bool {
    const SLIGHT: f64 = 0.2;
    const SOME: f64 = 0.05;
    let within = |slight: f64| {
        let folds = fit.folds.iter().zip(&base.folds);
        folds.filter(|(a, b)| **a < **b + slight).count()
    };
    let most = |n: usize| 2 * n > base.folds.len();
    let gained = within(-SOME * gain);
    most(gained) || (clear && gained >= 2 && most(within(SLIGHT * gain)))
}

/// Fits and answers for tests.
#[cfg(test)]
pub(super) mod samples {
    use super::{Answer, Candidate, Fit, Limits};

    pub(in crate::whole) fn fit(folds: &[f64]) -> Fit {
        Fit {
            theta: Vec::new(),
            members: Vec::new(),
            cost: 0.0,
            held_out: 0.0,
            folds: folds.to_vec(),
            groups: Vec::new(),
            deviation: Vec::new(),
            spread: Vec::new(),
        }
    }

    /// An answer whose last step is `last`; without each of its members it is the same.
    pub(in crate::whole) fn found(
        candidates: Vec<Candidate>,
        last: Fit,
        strengths: Vec<f64>,
    ) -> Answer {
        Answer {
            candidates,
            rivals: vec![Vec::new(); strengths.len()],
            removed_alone: vec![(last.clone(), last.clone()); strengths.len()],
            strengths,
            nearest: 0.0,
            pull: 0.0,
            limits: LIMITS,
            nominal: vec![1.0; last.theta.len()],
            nominal_groups: Vec::new(),
            steps: vec![last],
        }
    }

    pub(in crate::whole) const LIMITS: Limits = Limits {
        share: 0.1,
        least: 0.1,
        relative: 0.1,
        of_first: 0.1,
        floor: 1.0,
        independent: 10.0,
        most: 4,
        beyond: 3.0,
        refined: 1,
        iterations: 1,
        remainder: 6.0,
        rough: false,
    };
}

#[cfg(test)]
mod tests {
    use super::samples::{fit, found};
    use super::*;

    #[test]
    fn an_effect_acts_where_it_mends_two_gaits_and_spoils_none() {
        let cases: [(&str, [f64; 4], [f64; 4], bool); 5] = [
            (
                "two mended, two at the floor",
                [0.7, 0.5, 49.0, 8.8],
                [0.9, 0.8, 1.7, 0.8],
                true,
            ),
            (
                "one mended",
                [0.7, 0.5, 49.0, 0.8],
                [0.9, 0.8, 1.7, 0.8],
                false,
            ),
            (
                "two mended, one lifted above the floor",
                [0.7, 0.5, 49.0, 8.8],
                [0.7, 1.8, 1.7, 0.8],
                false,
            ),
            (
                "two mended by a third",
                [0.7, 0.5, 49.0, 8.8],
                [0.7, 0.5, 33.0, 6.0],
                false,
            ),
            (
                "nothing above the floor",
                [0.9, 0.8, 0.9, 0.7],
                [0.3, 0.2, 0.3, 0.2],
                false,
            ),
        ];
        for (what, before, after, acts) in cases {
            assert_eq!(
                where_it_acts(&fit(&before), &fit(&after), 1.0),
                acts,
                "{what}"
            );
        }
    }

    #[test]
    fn most_gaits_gain_or_hardly_speak_against_a_clear_gain() {
        const BEFORE: [f64; 4] = [3.0, 3.0, 3.0, 3.0];
        for (what, after, clear, most) in [
            ("three of four", [2.0, 2.0, 2.0, 5.0], false, true),
            ("two of four", [1.0, 1.0, 3.1, 3.1], false, false),
            ("two that are clear", [1.0, 1.0, 3.1, 3.1], true, true),
            ("two, and two that lose", [0.0, 0.0, 3.5, 3.5], true, false),
            ("one alone", [0.0, 3.1, 3.1, 3.1], true, false),
            (
                "one, and next to nothing",
                [0.4, 2.99, 2.98, 2.99],
                false,
                false,
            ),
        ] {
            let gain = 3.0 - after.iter().sum::<f64>() / 4.0;
            let is = on_most(&fit(&BEFORE), &fit(&after), gain, clear);
            assert_eq!(is, most, "{what}");
        }
    }

    #[test]
    fn what_was_taken_back_stays_away_when_the_next_goes() {
        let effects = [
            Effect::Latency,
            Effect::CoulombFriction,
            Effect::TorqueLimit,
        ];
        let candidate = |(i, effect): (usize, &Effect)| Candidate {
            effect: *effect,
            joint: Some(0),
            free: vec![i],
            starts: Vec::new(),
        };
        // Three members whose numbers are 5 with them and 1 without.
        let with = |members: &[usize]| Fit {
            theta: (0..3)
                .map(|i| if members.contains(&i) { 5.0 } else { 1.0 })
                .collect(),
            members: members.to_vec(),
            ..fit(&[])
        };
        let candidates = effects.iter().enumerate().map(candidate).collect();
        let mut answer = found(candidates, with(&[0, 1, 2]), vec![1.0; 3]);
        answer.removed_alone = vec![
            (with(&[1, 2]), with(&[0])),
            (with(&[0, 2]), with(&[1])),
            (with(&[0, 1]), with(&[2])),
        ];
        for (at, left) in [(1, &[0, 2][..]), (0, &[2]), (0, &[])] {
            let without = answer.removed_alone[at].0.clone();
            answer.drop_member(at, without);
            assert_eq!(*answer.last(), with(left));
            assert_eq!(answer.removed_alone.len(), left.len());
        }
    }
}
