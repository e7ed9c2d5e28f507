//! Sets of causes by their evidence: of all hypotheses scanned around a fit the best are fitted, one more at a time.

use std::collections::BTreeMap;

use super::data::{Data, HORIZONS_S};
use super::fit::Fit;
use super::library::{Hypothesis, Kind, SITE, library, nuisances};
use super::model::{Axis, Coordinate, Model, Point};
use super::noise::Noise;
use super::scan::Scanned;
use crate::decide::CLASS;
use crate::evidence::ensemble::{Spreads, kind};
use crate::vocabulary::{Effect, Stage};

/// Hypotheses that are fitted of those that were scanned.
const FITTED: usize = 8;
/// Sets of those that grew, best first, that are weighed under the noise they leave.
const TRIED: usize = 3;
/// Rivals that are tried in the place of members.
const EXCHANGES: usize = 8;
/// Rivals that are fitted from where the set stands.
const SWAPPED: usize = 4;
/// Rounds in which the fit without a cause may move.
const ROUNDS: usize = 3;
/// Half of the squares that a hypothesis must gain to lead the fit without a cause elsewhere.
const LEADS: f64 = 1.0;
/// Sets that are kept at every size.
const BEAM: usize = 2;
/// Most causes of a joint.
const MOST: usize = 4;
/// Steps of a fit that only ranks, and of one that stays.
const RANKS: usize = 5;
const STAYS: usize = 12;
/// Expected number of causes of a joint, as for robots.
const EXPECTED: f64 = 2.0;
/// Model error in any one direction as a share of the noise, where no healthy joints say it: by hand.
const MODEL_ERROR: f64 = 0.1;

/// What a kind of cause must add.
pub(super) type Ask<'a> = &'a dyn Fn(Kind) -> f64;

/// A set of causes, fitted.
#[derive(Debug, Clone)]
pub(super) struct Set {
    /// Hypotheses by number.
    pub(super) members: Vec<usize>,
    pub(super) fit: Fit,
    /// Logarithm of the evidence, prior probability included.
    pub(super) evidence: f64,
}

/// Another cause in the place of a member.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rival {
    pub(super) hypothesis: usize,
    /// Evidence of the set less that with the rival.
    pub(super) margin: f64,
}

/// What a search found.
pub(super) struct Found {
    pub(super) best: Set,
    /// Evidence that each member adds.
    pub(super) gains: Vec<f64>,
    /// Rivals of each member, nearest first.
    pub(super) rivals: Vec<Vec<Rival>>,
    /// The cause of those that were not taken which comes nearest to what is asked of it, and what it adds.
    pub(super) next: Option<(Kind, f64)>,
}

/// A set with one cause more and the set without it, under the noise that the larger one leaves.
struct Weighed {
    with: Set,
    without: Set,
    noise: Noise,
}

impl Weighed {
    /// Evidence that the cause adds.
    fn adds(&self) -> f64 {
        self.with.evidence - self.without.evidence
    }

    /// Evidence of the larger set with the likelihood of its noise: sets that leave different noises are compared by
    /// it, as by a likelihood whose noise is fitted with each.
    fn total(&self) -> f64 {
        self.noise.log_likelihood() + self.with.evidence
    }
}

/// What a calibration says beside what a cause must add.
#[derive(Clone, Copy)]
pub(super) struct Known<'a> {
    pub(super) spreads: &'a Spreads,
    pub(super) laws: &'a BTreeMap<String, f64>,
}

/// Everything that sets are made of.
pub(super) struct Search<'a> {
    pub(super) hypotheses: Vec<Hypothesis>,
    nuisances: Vec<Coordinate>,
    pub(super) noise: Noise,
    log_prior: f64,
    base: Point,
    /// What healthy joints differ by.
    pub(super) spreads: &'a Spreads,
    /// By what share the laws of causes are off, by stage.
    laws: &'a BTreeMap<String, f64>,
    /// Sets that were weighed under the noise that they leave, with their totals.
    tried: Vec<(Vec<usize>, f64)>,
}

impl<'a> Search<'a> {
    pub(super) fn new(data: &Data, withhold: &[Effect], cut: bool, known: Known<'a>) -> Self {
        let base = Point::default();
        let nuisances = nuisances(data, cut);
        let errors = data.errors(&[base]).remove(0);
        let noise = Noise::new(data, &errors, &[], MODEL_ERROR);
        let hypotheses = library(data, &base, withhold, cut);
        let mut kinds: Vec<Kind> = Vec::new();
        for h in &hypotheses {
            if !kinds.contains(&h.kind) {
                kinds.push(h.kind);
            }
        }
        Self {
            hypotheses,
            nuisances,
            noise,
            log_prior: libm::log(EXPECTED / kinds.len().max(1) as f64),
            base,
            spreads: known.spreads,
            laws: known.laws,
            tried: Vec::new(),
        }
    }

    /// The data over the horizon at which they are likeliest, and a search of them.
    ///
    /// Each row's error is its own value less what those before predict, so likelihoods of two horizons are of the same
    /// data (prediction-error decomposition: Schweppe 1965). All hypotheses explain what they can of each.
    pub(super) fn likeliest(
        data: &Data,
        withhold: &[Effect],
        cut: bool,
        known: Known<'a>,
    ) -> (Data, Self) {
        let over = |horizon_s| {
            let data = data.over(horizon_s);
            let mut own = Self::new(&data, withhold, cut, known);
            let bare = own.fitted(&data, Vec::new(), &own.base.clone(), RANKS);
            let mut scanned = own.scan_all(&data, &bare);
            own.thin(&scanned);
            own.one_a_way(&mut scanned);
            own.listen(&data, &bare, &scanned, 0);
            (own.noise.log_likelihood(), data, own)
        };
        let [first, rest @ ..] = HORIZONS_S.map(over);
        let likelier = |a: (f64, Data, Self), b: (f64, Data, Self)| if b.0 > a.0 { b } else { a };
        let (_, data, own) = rest.into_iter().fold(first, likelier);
        (data, own)
    }

    /// By what share the laws of a stage are off.
    pub(super) fn law(&self, stage: Stage) -> f64 {
        self.laws.get(stage.name()).copied().unwrap_or(0.0)
    }

    /// Parameters and priors of a set.
    fn model(&self, members: &[usize]) -> Model {
        let mut base = self.base;
        let mut coordinates: Vec<Coordinate> = Vec::new();
        for m in members {
            let h = &self.hypotheses[*m];
            h.fixed.iter().for_each(|(a, v)| base.set(*a, *v));
            coordinates.extend(&h.coordinates);
        }
        let taken: Vec<Axis> = coordinates.iter().map(|c| c.axis).collect();
        let free = |c: &&Coordinate| !taken.contains(&c.axis);
        coordinates.extend(self.nuisances.iter().filter(free));
        Model { base, coordinates }
    }

    fn fitted(&self, data: &Data, members: Vec<usize>, point: &Point, most: usize) -> Set {
        let model = self.model(&members);
        let start: Vec<f64> = model
            .coordinates
            .iter()
            .map(|c| c.variable(point.get(c.axis)))
            .collect();
        let fit = Fit::new(data, &self.noise, model, &start, most);
        let evidence = fit.evidence + self.log_prior * members.len() as f64;
        Set {
            members,
            fit,
            evidence,
        }
    }

    /// Whether a hypothesis may stand beside the members.
    pub(super) fn compatible(&self, members: &[usize], h: usize) -> bool {
        let new = &self.hypotheses[h];
        members.iter().all(|m| {
            let own = &self.hypotheses[*m];
            own.kind != new.kind && !own.axes().any(|a| new.axes().any(|b| a == b))
        })
    }

    /// Leaves of sets of the same kinds the first.
    fn one_a_kind(&self, sets: &mut Vec<Set>) {
        let kind = |m: &usize| self.hypotheses[*m].kind;
        let mut seen: Vec<Vec<Kind>> = Vec::new();
        sets.retain(|s| {
            let own: Vec<Kind> = s.members.iter().map(kind).collect();
            let same = |a: &Vec<Kind>| a.len() == own.len() && own.iter().all(|k| a.contains(k));
            let new = !seen.iter().any(same);
            if new {
                seen.push(own);
            }
            new
        });
    }

    /// Sets with one cause more, best first.
    fn grown(&self, data: &Data, set: &Set, scanned: &[Scanned]) -> Vec<Set> {
        let here = set.fit.point();
        let absorbed = self.absorbed(set);
        let mut all: Vec<&Scanned> = scanned.iter().chain(&absorbed).collect();
        all.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        let mut out: Vec<Set> = all
            .into_iter()
            .take(FITTED)
            .map(|s| {
                let mut members = set.members.clone();
                members.push(s.hypothesis);
                let start = self.hypotheses[s.hypothesis].on(&here, &s.start);
                self.fitted(data, members, &start, RANKS)
            })
            .collect();
        out.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        out
    }

    /// Sets of one cause, fitted from what is stated. From the fit without a cause a search may not come back: its
    /// numbers imitate what they can of a large cause.
    fn stated(&self, data: &Data) -> Vec<Set> {
        let stated = self.fitted(data, Vec::new(), &self.base, 0);
        let scanned = self.scan(data, &stated);
        self.grown(data, &stated, &scanned)
    }

    /// What each kind of cause that a search would fit adds to a set without any, under the noise that it leaves.
    pub(super) fn alone(&mut self, data: &Data, bare: &Set) -> Vec<(Kind, f64)> {
        let mut out = Vec::new();
        let all = self.candidates(data, std::slice::from_ref(bare));
        for set in self.worth_weighing(&all, bare) {
            let own = set.members.last().map(|h| self.hypotheses[*h].kind);
            let adds = self.larger(data, bare, set).adds();
            out.extend(own.map(|own| (own, adds)));
        }
        out
    }

    /// Sets with one cause more than those of `beam`, one a kind, best first.
    fn candidates(&self, data: &Data, beam: &[Set]) -> Vec<Set> {
        let mut all = Vec::new();
        for set in beam {
            let scanned = self.scan(data, set);
            all.extend(self.grown(data, set, &scanned));
            if set.members.is_empty() {
                all.extend(self.stated(data));
            }
        }
        all.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        self.one_a_kind(&mut all);
        all
    }

    /// The best set, and of the next those that have more evidence than the one without their cause.
    fn worth_weighing<'s>(&self, all: &'s [Set], without: &Set) -> Vec<&'s Set> {
        let more = |(n, s): &(usize, &Set)| *n == 0 || s.evidence > without.evidence;
        let best = all.iter().take(TRIED).enumerate();
        best.filter(more).map(|s| s.1).collect()
    }

    /// A set with one cause more, and the set without it, under the noise that the larger one leaves; each from where
    /// either was.
    fn larger(&mut self, data: &Data, set: &Set, with: &Set) -> Weighed {
        let old = self.noise.clone();
        let scanned = self.scan(data, with);
        self.listen(data, with, &scanned, set.members.len());
        let more = self.fitted(data, with.members.clone(), &with.fit.point(), STAYS);
        let less = self.fitted(data, set.members.clone(), &set.fit.point(), STAYS);
        let less = self.better(data, less, &more.fit.point());
        let added = with.members.last().map(|h| &self.hypotheses[*h]);
        let neutral = added.map_or(Vec::new(), Hypothesis::neutral);
        let start = added.map_or(less.fit.point(), |h| h.on(&less.fit.point(), &neutral));
        let more = self.better(data, more, &start);
        Weighed {
            with: more,
            without: less,
            noise: std::mem::replace(&mut self.noise, old),
        }
    }

    /// Whether a set may have a higher total: it was not weighed, or had one.
    fn may_beat(&self, set: &Set, total: f64) -> bool {
        let same =
            |m: &[usize]| m.len() == set.members.len() && m.iter().all(|h| set.members.contains(h));
        let known = self.tried.iter().rev().find(|m| same(&m.0));
        known.is_none_or(|m| m.1 > total)
    }

    /// A set under the noise that it leaves itself.
    fn settled(&mut self, data: &Data, set: &Set) -> Set {
        let scanned = self.scan(data, set);
        self.listen(data, set, &scanned, set.members.len());
        self.fitted(data, set.members.clone(), &set.fit.point(), STAYS)
    }

    /// A set as it is or as fitted from another point, whichever is likelier.
    fn better(&self, data: &Data, set: Set, start: &Point) -> Set {
        let other = self.fitted(data, set.members.clone(), start, STAYS);
        if other.evidence > set.evidence {
            other
        } else {
            set
        }
    }

    /// Evidence of a set less what is asked of its members.
    fn above(&self, set: &Set, ask: Ask<'_>) -> f64 {
        let asked = set.members.iter().map(|m| ask(self.hypotheses[*m].kind));
        set.evidence - asked.sum::<f64>()
    }

    /// The fit without a cause, under the noise that all hypotheses together leave; from where the best of them lead
    /// too, so that it stands in no hollow that any of them would leave.
    pub(super) fn bare(&mut self, data: &Data) -> Set {
        let mut best = self.fitted(data, Vec::new(), &self.base.clone(), STAYS);
        for _ in 0..ROUNDS {
            let scanned = self.scan(data, &best);
            self.listen(data, &best, &scanned, 0);
            best = self.fitted(data, Vec::new(), &best.fit.point(), STAYS);
            let before = best.evidence;
            let cost = best.fit.cost;
            let all = self.grown(data, &best, &scanned);
            for other in all.iter().filter(|o| o.fit.cost < cost - LEADS) {
                best = self.better(data, best, &other.fit.point());
            }
            if best.evidence < before + 1.0 {
                break;
            }
        }
        best
    }

    /// Searches from the fit without a cause on; a cause of a kind must add what `ask` says.
    pub(super) fn run(&mut self, data: &Data, bare: &Set, ask: Ask<'_>) -> Found {
        let mut best = bare.clone();
        let mut beam = vec![best.clone()];
        let mut next: Option<(Kind, f64)> = None;
        let mut last = None;
        for _ in 0..MOST {
            let mut all = self.candidates(data, &beam);
            next = None;
            let mut taken: Option<Weighed> = None;
            for set in self.worth_weighing(&all, &best) {
                let weighed = self.larger(data, &best, set);
                self.tried.push((set.members.clone(), weighed.total()));
                if self.above(&weighed.with, ask) > self.above(&weighed.without, ask) {
                    if taken.as_ref().is_none_or(|t| weighed.total() > t.total()) {
                        taken = Some(weighed);
                    }
                    continue;
                }
                let own = set.members.last().map(|h| self.hypotheses[*h].kind);
                let adds = weighed.adds();
                let share = |(kind, adds): (Kind, f64)| adds / ask(kind);
                if let Some(own) = own
                    && next.is_none_or(|n| share((own, adds)) > share(n))
                {
                    next = Some((own, adds));
                }
            }
            let Some(taken) = taken else { break };
            self.noise = taken.noise.clone();
            all.retain(|s| s.members != taken.with.members);
            all.insert(0, taken.with.clone());
            all.truncate(BEAM);
            best = taken.with.clone();
            last = Some(taken);
            beam = all;
        }
        Found {
            next,
            ..self.exchanged(data, best, last, ask)
        }
    }

    /// Every member against all others in its place, the other members known; `last` is the set as it grew last.
    fn exchanged(&mut self, data: &Data, best: Set, last: Option<Weighed>, ask: Ask<'_>) -> Found {
        let (mut best, mut last) = (best, last);
        let (mut gains, mut rivals) = (Vec::new(), Vec::new());
        let mut exchanges = 0;
        while gains.len() < best.members.len() {
            let at = gains.len();
            let grew = last.take_if(|w| at + 1 == w.with.members.len());
            let weighed = grew.unwrap_or_else(|| self.member(data, &best, at));
            if self.above(&weighed.with, ask) <= self.above(&weighed.without, ask) {
                best = self.settled(data, &weighed.without);
                (last, gains, rivals) = (None, Vec::new(), Vec::new());
                continue;
            }
            self.noise = weighed.noise.clone();
            let bare = &weighed.without;
            let mut others = self.grown(data, bare, &self.scan(data, bare));
            others.extend(self.swapped(data, &weighed.with));
            others.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
            self.one_a_kind(&mut others);
            let kind = |s: &Set| s.members.last().map(|m| self.hypotheses[*m].kind);
            let own = kind(&weighed.with);
            let rival = others.iter().position(|s| kind(s) != own);
            if let Some(at) = rival.filter(|_| exchanges < EXCHANGES) {
                exchanges += 1;
                others[at] = self.closest(data, &others[at], &weighed.with);
                if let Some(other) = self.beats(data, &others[at], &weighed, ask) {
                    best = other.with.clone();
                    self.noise = other.noise.clone();
                    (last, gains, rivals) = (Some(other), Vec::new(), Vec::new());
                    continue;
                }
            }
            gains.push(weighed.adds());
            rivals.push(self.rivals(&weighed.with, &others));
        }
        Found {
            best,
            gains,
            rivals,
            next: None,
        }
    }

    /// A member of a set, weighed as if it had come last.
    fn member(&mut self, data: &Data, set: &Set, at: usize) -> Weighed {
        let mut with = set.clone();
        let own = with.members.remove(at);
        let bare = self.fitted(data, with.members.clone(), &set.fit.point(), STAYS);
        with.members.push(own);
        self.larger(data, &bare, &with)
    }

    /// Sets with another cause in the place of the last member, fitted from where the set stands: one that is fitted
    /// without the member imitates it with all other numbers, and a rival may not come back from there.
    fn swapped(&self, data: &Data, set: &Set) -> Vec<Set> {
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
    fn closest(&self, data: &Data, rival: &Set, set: &Set) -> Set {
        let own = self.fitted(data, rival.members.clone(), &rival.fit.point(), STAYS);
        self.better(data, own, &set.fit.point())
    }

    /// A rival that is to stand in the place of the last member of a set, as it is weighed. It has more evidence under
    /// the noise of the set, or a likelihood under its own that is no chance of two noises.
    fn beats(&mut self, data: &Data, rival: &Set, set: &Weighed, ask: Ask<'_>) -> Option<Weighed> {
        let bar = set.total() + CLASS;
        let likelier = rival.evidence > set.with.evidence;
        let explains = rival.evidence > set.without.evidence;
        let may = likelier || (explains && self.may_beat(rival, bar));
        if !may {
            return None;
        }
        let other = self.larger(data, &set.without, rival);
        self.tried.push((rival.members.clone(), other.total()));
        let stands = self.above(&other.with, ask) > self.above(&other.without, ask);
        (stands && (likelier || other.total() > bar)).then_some(other)
    }

    /// What could stand in the place of the last member.
    fn rivals(&self, set: &Set, others: &[Set]) -> Vec<Rival> {
        let kind = |m: usize| self.hypotheses[m].kind;
        let own = set.members.last().map(|m| kind(*m));
        let last = others
            .iter()
            .filter_map(|s| Some((*s.members.last()?, s.evidence)));
        last.filter(|(m, _)| Some(kind(*m)) != own)
            .map(|(hypothesis, evidence)| Rival {
                hypothesis,
                margin: set.evidence - evidence,
            })
            .collect()
    }
}

/// Model error in any one direction, as a share of the noise: of healthy joints, where any were learned from.
pub(super) fn model_error(spreads: &Spreads) -> f64 {
    let learned = spreads.model_error.get(&kind(&SITE)).copied();
    learned.unwrap_or(MODEL_ERROR)
}
