//! The course of a selection: forward, backward, two that are one, and once more from what nearly came first.

use super::search::{Given, Search};
use super::terms::{Evaluate, Fit};
use crate::vocabulary::Stage;

/// Share of the best first effect's gain from which another one may be the right one. Then the cost above which, over the floor, that is
/// asked, and what that one must leave at most of what the best leaves. A velocity limit that leaves a law of its motor is none of the
/// frictions that nearly gain as much.
const NEARLY: f64 = 0.9;
const LEFT: f64 = 1.5;
const BETTER: f64 = 0.5;

/// The steps of a selection, the gain over its threshold of the best candidate that was not taken, and what nearly was the first effect.
struct Course {
    steps: Vec<Fit>,
    nearest: f64,
    others: Vec<Fit>,
}

impl<E: Evaluate> Search<'_, E> {
    /// The steps of a selection, and the gain of the best candidate that was not taken, over its threshold. Where something is left, the selection is made
    /// again from what nearly was its first effect: two effects that explain the same need not leave the same open.
    pub(super) fn run(&self, base: Fit, given: Given) -> (Vec<Fit>, f64) {
        let mut taken = self.course(vec![base], given);
        for other in std::mem::take(&mut taken.others) {
            let last = &taken.steps[taken.steps.len() - 1];
            if self.limits.rough || last.cost < LEFT * self.limits.floor {
                break;
            }
            let settled = self.fit(&other.theta, &other.members, 2 * self.limits.iterations);
            let again = self.course(vec![taken.steps[0].clone(), settled], Given::Nothing);
            let end = &again.steps[again.steps.len() - 1];
            let foretells = self.told(last) - self.told(end) > self.threshold(last);
            if foretells && end.cost < BETTER * last.cost {
                taken = again;
            }
        }
        (taken.steps, taken.nearest)
    }

    /// Forward selection after `steps`, then backward pruning of all but the members that are known before.
    fn course(&self, mut steps: Vec<Fit>, given: Given) -> Course {
        let kept = given.shown();
        let mut hint = None;
        match given {
            Given::Nothing => {}
            Given::Shown(fit) => steps.push(fit),
            Given::Hint(fit) => hint = Some(fit),
        }
        let mut others = Vec::new();
        let mut nearest;
        loop {
            let base = &steps[steps.len() - 1];
            let mut believed;
            (believed, nearest) = self.forward(base, self.exact(&steps), hint.take().as_ref());
            if believed.is_empty() {
                break;
            }
            let next = believed.remove(0);
            if steps.len() == 1 {
                others = self.nearly(base, &next, believed);
            }
            // Everything settles before a further effect is looked at.
            let settled = self.fit(&next.theta, &next.members, 2 * self.limits.iterations);
            steps.push(settled);
            if steps.len() > self.limits.most {
                break;
            }
        }
        while let Some(next) = self.backward(&steps[steps.len() - 1], &kept) {
            steps.push(next);
        }
        while let Some(next) = self.merged(&steps[steps.len() - 1], &kept) {
            steps.push(next);
        }
        Course {
            steps,
            nearest,
            others,
        }
    }

    /// Held-out cost from which two simulators of the effects found may differ: a straight line between angles is the same in all. Where the cost is rough, what
    /// a start is wrong by grows with any effect.
    fn exact(&self, steps: &[Fit]) -> f64 {
        let line = |m: &usize| self.candidates[*m].effect.stage() == Stage::Conventions;
        let straight = |s: &&Fit| !self.limits.rough && s.members.iter().all(line);
        let after = steps.iter().rev().find(straight);
        after.unwrap_or(&steps[0]).held_out
    }

    /// Those `believed` beside `base` that gain nearly as much as `best` by other numbers.
    fn nearly(&self, base: &Fit, best: &Fit, believed: Vec<Fit>) -> Vec<Fit> {
        let own = |f: &Fit| self.candidates[f.members[f.members.len() - 1]].free.clone();
        let most = base.held_out - best.held_out;
        let mut seen = own(best);
        let mut out = believed;
        out.retain(|f| {
            let numbers = own(f);
            let new = !numbers.iter().any(|i| seen.contains(i));
            seen.extend(numbers);
            new && base.held_out - f.held_out > NEARLY * most
        });
        out
    }

    /// The fit without the member that is missed least, if it is missed less than the threshold.
    fn backward(&self, full: &Fit, kept: &[usize]) -> Option<Fit> {
        if full.members.len() < 2 {
            return None;
        }
        let mut best: Option<Fit> = None;
        for m in full.members.iter().filter(|m| !kept.contains(m)) {
            let fit = self.without(full, *m);
            let least = self.threshold(&fit);
            if self.told(&fit) - self.told(full) < least
                && best.as_ref().is_none_or(|b| fit.held_out < b.held_out)
            {
                best = Some(fit);
            }
        }
        best
    }

    /// The fit with a single torque in the place of two of a joint, where they are missed less than the threshold: a friction that falls with the speed
    /// and one that grows with it are a dry one.
    pub(super) fn merged(&self, full: &Fit, kept: &[usize]) -> Option<Fit> {
        let lost = |c: &usize| {
            let own = &self.candidates[*c];
            own.effect.stage() == Stage::Drivetrain && own.joint.is_some()
        };
        let open = full.members.iter().copied();
        let pair: Vec<usize> = open.filter(|m| lost(m) && !kept.contains(m)).collect();
        let [a, b] = *pair.as_slice() else {
            return None;
        };
        let single = |c: &usize| lost(c) && self.candidates[*c].free.len() == 1;
        let both = self.without(&self.without(full, a), b);
        let one = |c: usize| {
            let start = |s: &Vec<f64>| {
                let mut theta = both.theta.clone();
                theta[self.candidates[c].free[0]] = s[0];
                self.fit(
                    &theta,
                    &[&both.members[..], &[c]].concat(),
                    self.limits.iterations,
                )
            };
            let fits = self.candidates[c].starts.iter().map(start);
            fits.min_by(|a, b| self.told(a).total_cmp(&self.told(b)))
        };
        let all = (0..self.candidates.len()).filter(single).filter_map(one);
        let best = all.min_by(|a, b| self.told(a).total_cmp(&self.told(b)))?;
        let missed = self.told(&best) - self.told(full) >= self.threshold(&best);
        // With fewer numbers it must only leave no more.
        (best.cost <= full.cost || !missed).then_some(best)
    }
}
