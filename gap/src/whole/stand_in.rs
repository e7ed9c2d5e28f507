//! What could stand in the place of an effect.

use super::screen::Lead;
use super::search::Search;
use super::terms::{Evaluate, Fit, Rival};
use crate::vocabulary::Effect;

/// Effects that are one to first order: an angle that is `d` late in a loop of gain `P` acts like a gain of `P / (1 - P d)`. A screening does not
/// see the second in place of the first, because a gain within its tolerance has taken most of it.
const TWINS: [Effect; 2] = [Effect::LoopGain, Effect::FeedbackDelay];

/// The members of `full` with candidate `c` in the place of `member`.
fn exchanged(full: &Fit, member: usize, c: usize) -> Vec<usize> {
    let name = |m: &usize| if *m == member { c } else { *m };
    full.members.iter().map(name).collect()
}

/// Candidate `candidate`, which leaves what `fit` leaves, beside `full`.
fn beside(full: &Fit, candidate: usize, fit: Fit) -> Rival {
    Rival {
        candidate,
        ratio: fit.cost / full.cost.max(1e-12),
        fit,
    }
}

impl<E: Evaluate> Search<'_, E> {
    /// Candidates that could stand in the place of `member`.
    fn rivals_of(&self, full: &Fit, member: usize) -> Vec<usize> {
        let own = &self.candidates[member];
        (0..self.candidates.len())
            .filter(|c| {
                let x = &self.candidates[*c];
                !full.members.contains(c)
                    && (x.effect, x.joint) != (own.effect, own.joint)
                    && !full.members.iter().any(|m| {
                        *m != member && self.candidates[*m].free.iter().any(|i| x.free.contains(i))
                    })
            })
            .collect()
    }

    /// Candidate `c` in the place of `member`, from its own starts and the nominal numbers of the member, where they are twins.
    fn twin(&self, full: &Fit, member: usize, c: usize) -> Option<Rival> {
        let (own, other) = (&self.candidates[member], &self.candidates[c]);
        if own.joint != other.joint || [own.effect, other.effect] != TWINS {
            return None;
        }
        let members = exchanged(full, member, c);
        let mut nominal = full.theta.clone();
        own.free
            .iter()
            .for_each(|i| nominal[*i] = self.coordinates[*i].neutral);
        let from = |start: &Vec<f64>| {
            let mut theta = nominal.clone();
            other
                .free
                .iter()
                .zip(start)
                .for_each(|(i, x)| theta[*i] = *x);
            self.fit(&theta, &members, self.limits.iterations)
        };
        let fits = other.starts.iter().map(from);
        let fit = fits.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        Some(beside(full, c, fit))
    }

    /// Rivals of `member`: the best other candidates in its place.
    pub(super) fn rivals(&self, full: &Fit, member: usize, most: usize) -> Vec<Rival> {
        let without = self.without(full, member);
        let own = &self.candidates[member];
        let mut open = self.rivals_of(full, member);
        // What holds all of this effect's numbers and more always fits as well; that makes it no rival.
        open.retain(|c| {
            let x = &self.candidates[*c].free;
            x.len() <= own.free.len() || !own.free.iter().all(|i| x.contains(i))
        });
        // The same numbers under another name leave the same.
        let (same, open): (Vec<usize>, Vec<usize>) = open
            .into_iter()
            .partition(|c| self.candidates[*c].free == own.free);
        let renamed = |c: usize| {
            let fit = Fit {
                members: exchanged(full, member, c),
                ..full.clone()
            };
            beside(full, c, fit)
        };
        let mut out: Vec<Rival> = same.into_iter().map(renamed).collect();
        out.extend(open.iter().filter_map(|c| self.twin(full, member, *c)));
        for Lead {
            candidate: c,
            theta,
            ..
        } in self.screen(&without, &open).0
        {
            if out.len() >= most {
                break;
            }
            if out.iter().any(|r| r.candidate == c) {
                continue;
            }
            let mut members = without.members.clone();
            members.push(c);
            let fit = self.fit(&theta, &members, self.limits.iterations);
            out.push(beside(full, c, fit));
        }
        out
    }
}
