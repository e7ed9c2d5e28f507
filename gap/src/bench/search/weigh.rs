//! Sets weighed with and without their last cause, under the noise that they leave.

use super::super::data::Data;
use super::super::library::{Hypothesis, Kind};
use super::super::noise::Noise;
use super::{Ask, Search, Set, model_error};

/// Sets of those that grew, best first, that are weighed under the noise they leave.
const TRIED: usize = 3;

/// A set under the noise that it leaves.
pub(super) struct Larger {
    pub(super) set: Set,
    pub(super) noise: Noise,
}

impl Larger {
    /// Evidence of the set with the likelihood of its noise: sets that leave different noises are compared by it, as by
    /// a likelihood whose noise is fitted with each.
    pub(super) fn total(&self) -> f64 {
        self.noise.log_likelihood() + self.set.evidence
    }
}

/// A set with one cause more and the set without it, under the noise that the larger one leaves.
pub(super) struct Weighed {
    pub(super) with: Larger,
    pub(super) without: Set,
}

impl Weighed {
    /// Evidence that the cause adds.
    pub(super) fn adds(&self) -> f64 {
        self.with.set.evidence - self.without.evidence
    }
}

impl Search<'_> {
    /// The best set, of the next those that have more evidence than the one without their cause, and those of `plainly`
    /// that are none of these.
    pub(super) fn worth_weighing<'s>(
        &self,
        all: &'s [Set],
        without: &Set,
        plainly: &'s [Set],
    ) -> Vec<&'s Set> {
        let more = |(n, s): &(usize, &Set)| *n == 0 || s.evidence > without.evidence;
        let best = all.iter().take(TRIED).enumerate();
        let mut out: Vec<&Set> = best.filter(more).map(|s| s.1).collect();
        let new = |s: &&Set| !out.iter().any(|o| o.is_at(s));
        let others: Vec<&Set> = plainly.iter().filter(new).collect();
        out.extend(others);
        out
    }

    /// A set under the noise that it leaves or under the present one, whichever makes it likelier; its first `stand`
    /// members are known.
    pub(super) fn larger(&self, data: &Data<'_>, stand: usize, with: &Set) -> Larger {
        let scanned = self.scan(data, with);
        let directions = self.directions(data, with, &scanned, stand);
        let error = model_error(self.spreads);
        let own = Noise::new(data, &with.fit.errors, &directions, error);
        // What all hypotheses together leave may have another colour than what the set leaves.
        let kept = self.noise.clone().with_healthy(&directions);
        let under = |noise: Noise| Larger {
            set: self.under(data, &noise, with),
            noise,
        };
        let (own, kept) = (under(own), under(kept));
        if kept.total() > own.total() {
            kept
        } else {
            own
        }
    }

    /// The same beside the set without its cause, under one noise; each from where either was.
    pub(super) fn beside(&mut self, data: &Data<'_>, set: &Set, larger: Larger) -> Weighed {
        let old = std::mem::replace(&mut self.noise, larger.noise);
        let with = larger.set;
        let less = self.under(data, &self.noise, set);
        let less = self.better(data, less, &with.fit.point());
        let added = with.members.last().map(|h| &self.hypotheses[*h]);
        let neutral = added.map_or(Vec::new(), Hypothesis::neutral);
        let start = added.map_or(less.fit.point(), |h| h.on(&less.fit.point(), &neutral));
        let set = self.better(data, with, &start);
        let noise = std::mem::replace(&mut self.noise, old);
        Weighed {
            with: Larger { set, noise },
            without: less,
        }
    }

    /// A set with one cause more and the set without it, weighed.
    pub(super) fn weighed(&mut self, data: &Data<'_>, set: &Set, with: &Set) -> Weighed {
        let larger = self.larger(data, set.members.len(), with);
        self.beside(data, set, larger)
    }

    /// Whether a set may have a higher total: it was not weighed, or had one.
    pub(super) fn may_beat(&self, set: &Set, total: f64) -> bool {
        let known = self.tried.get(&sorted(&set.members));
        known.is_none_or(|own| *own > total)
    }

    /// Keeps the total of a set that was weighed.
    pub(super) fn note(&mut self, weighed: &Larger) {
        let members = sorted(&weighed.set.members);
        self.tried.insert(members, weighed.total());
    }

    /// The likeliest of sets with one cause more than `best` that add what is asked; of the others the cause that comes
    /// nearest to it.
    pub(super) fn likeliest(
        &mut self,
        data: &Data<'_>,
        best: &Set,
        sets: &[&Set],
        ask: Ask<'_>,
    ) -> (Option<Weighed>, Option<(Kind, f64)>) {
        let stand = best.members.len();
        let mut all: Vec<Larger> = sets.iter().map(|s| self.larger(data, stand, s)).collect();
        all.sort_by(|a, b| b.total().total_cmp(&a.total()));
        all.iter().for_each(|l| self.note(l));
        let mut nearest = None;
        for larger in all {
            let weighed = self.beside(data, best, larger);
            // From where the smaller set is, it may have become likelier.
            self.note(&weighed.with);
            if self.above(&weighed.with.set, ask) > self.above(&weighed.without, ask) {
                return (Some(weighed), nearest);
            }
            let own = weighed.with.set.members.last();
            let own = own.map(|h| self.hypotheses[*h].kind);
            let adds = weighed.adds();
            let share = |(kind, adds): (Kind, f64)| adds / ask(kind);
            if let Some(own) = own
                && nearest.is_none_or(|n| share((own, adds)) > share(n))
            {
                nearest = Some((own, adds));
            }
        }
        (None, nearest)
    }
}

/// A set of hypotheses, whichever came first.
fn sorted(members: &[usize]) -> Vec<usize> {
    let mut out = members.to_vec();
    out.sort_unstable();
    out
}
