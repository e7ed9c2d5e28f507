//! Every member of a set against all others in its place.

use super::super::data::Data;
use super::super::model::Point;
use super::weigh::Weighed;
use super::{Ask, Found, RANKS, Rival, STAYS, Search, Set};
use crate::decide::CLASS;

/// Rivals that are tried in the place of members.
const EXCHANGES: usize = 8;
/// Rivals that are fitted from where the set stands.
const SWAPPED: usize = 4;

impl Search<'_> {
    /// Every member against all others in its place, the other members known; `last` is the set as it grew last.
    pub(super) fn exchanged(
        &mut self,
        data: &Data<'_>,
        best: Set,
        last: Option<Weighed>,
        ask: Ask<'_>,
    ) -> Found {
        let (mut best, mut last) = (best, last);
        let (mut gains, mut rivals, mut without) = (Vec::new(), Vec::new(), Vec::new());
        let mut exchanges = 0;
        while gains.len() < best.members.len() && !data.stop.asked() {
            let at = gains.len();
            let grew = last.take_if(|w| at + 1 == w.with.set.members.len());
            let weighed = grew.unwrap_or_else(|| self.member(data, &best, at));
            if self.above(&weighed.with.set, ask) <= self.above(&weighed.without, ask) {
                best = self.settled(data, &weighed.without);
                last = None;
                (gains, rivals, without) = (Vec::new(), Vec::new(), Vec::new());
                continue;
            }
            self.noise = weighed.with.noise.clone();
            let (with, bare) = (&weighed.with.set, &weighed.without);
            let mut others = self.grown(data, bare, &self.scan(data, bare));
            others.extend(self.swapped(data, with));
            others.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
            self.one_a_kind(&mut others);
            let kind = |s: &Set| s.members.last().map(|m| self.hypotheses[*m].kind);
            let own = kind(with);
            let rival = others.iter().position(|s| kind(s) != own);
            if let Some(at) = rival.filter(|_| exchanges < EXCHANGES) {
                exchanges += 1;
                others[at] = self.closest(data, &others[at], with);
                if let Some(other) = self.beats(data, &others[at], &weighed, ask) {
                    best = other.with.set.clone();
                    self.noise = other.with.noise.clone();
                    last = Some(other);
                    (gains, rivals, without) = (Vec::new(), Vec::new(), Vec::new());
                    continue;
                }
            }
            gains.push(weighed.adds());
            without.push(weighed.without.fit.point());
            rivals.push(self.rivals(with, &others));
        }
        Found {
            best,
            gains,
            without,
            rivals,
            next: None,
            steps: Vec::new(),
            partial: false,
        }
    }

    /// A member of a set, weighed as if it had come last.
    fn member(&mut self, data: &Data<'_>, set: &Set, at: usize) -> Weighed {
        let mut with = set.clone();
        let own = with.members.remove(at);
        let bare = self.fitted(data, with.members.clone(), &set.fit.point(), STAYS);
        with.members.push(own);
        self.weighed(data, &bare, &with)
    }

    /// Sets with another cause in the place of the last member, fitted from where the set stands: one that is fitted
    /// without the member imitates it with all other numbers, and a rival may not come back from there.
    fn swapped(&self, data: &Data<'_>, set: &Set) -> Vec<Set> {
        let mut members = set.members.clone();
        let Some(own) = members.pop() else {
            return Vec::new();
        };
        let own = &self.hypotheses[own];
        let mut here = set.fit.point();
        own.axes().for_each(|a| here.set(a, self.base.get(a)));
        let other =
            |h: &usize| self.hypotheses[*h].kind != own.kind && self.compatible(&members, *h);
        let all = (0..self.hypotheses.len()).filter(other);
        let starts: Vec<(usize, Point)> = all
            .flat_map(|h| {
                let own = &self.hypotheses[h];
                own.starts.iter().map(move |s| (h, own.on(&here, s)))
            })
            .collect();
        let points: Vec<Point> = starts.iter().map(|s| s.1).collect();
        let mut costs: Vec<(f64, usize)> = data
            .errors(&points)
            .iter()
            .map(|e| self.noise.left(&self.noise.white(e)).0)
            .zip(0..)
            .collect();
        costs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut kinds = Vec::new();
        costs.retain(|(_, i)| {
            let kind = self.hypotheses[starts[*i].0].kind;
            let new = !kinds.contains(&kind);
            kinds.push(kind);
            new
        });
        costs
            .iter()
            .take(SWAPPED)
            .map(|(_, i)| {
                let (h, start) = &starts[*i];
                let with = members.iter().copied().chain([*h]);
                self.fitted(data, with.collect(), start, RANKS)
            })
            .collect()
    }

    /// A rival, fitted as far as the set in whose place it would stand, from there too.
    fn closest(&self, data: &Data<'_>, rival: &Set, set: &Set) -> Set {
        let own = self.under(data, &self.noise, rival);
        self.better(data, own, &set.fit.point())
    }

    /// A rival that is to stand in the place of the last member of a set, as it is weighed. It has more evidence under
    /// the noise of the set, or a likelihood under its own that is no chance of two noises.
    fn beats(
        &mut self,
        data: &Data<'_>,
        rival: &Set,
        set: &Weighed,
        ask: Ask<'_>,
    ) -> Option<Weighed> {
        let bar = set.with.total() + CLASS;
        let likelier = rival.evidence > set.with.set.evidence;
        let explains = rival.evidence > set.without.evidence;
        let may = likelier || (explains && self.may_beat(rival, bar));
        if !may {
            return None;
        }
        let other = self.larger(data, set.without.members.len(), rival);
        self.note(&other);
        if !likelier && other.total() <= bar {
            return None;
        }
        let other = self.beside(data, &set.without, other);
        let stands = self.above(&other.with.set, ask) > self.above(&other.without, ask);
        (stands && (likelier || other.with.total() > bar)).then_some(other)
    }

    /// What could stand in the place of the last member.
    fn rivals(&self, set: &Set, others: &[Set]) -> Vec<Rival> {
        let kind = |m: usize| self.hypotheses[m].kind;
        let own = set.members.last().map(|m| kind(*m));
        let last = others.iter().filter_map(|s| Some((*s.members.last()?, s)));
        last.filter(|(m, _)| Some(kind(*m)) != own)
            .map(|(hypothesis, other)| Rival {
                hypothesis,
                margin: set.evidence - other.evidence,
                point: other.fit.point(),
            })
            .collect()
    }
}
