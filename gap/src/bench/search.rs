//! Sets of causes by their evidence: of all hypotheses scanned around a fit the best are fitted, one more at a time.

mod exchange;
mod start;
mod weigh;

use std::collections::BTreeMap;

use super::Asked;
use super::data::Data;
use super::fit::Fit;
use super::library::{Hypothesis, Kind, SITE, library, nuisances};
use super::model::{Axis, Coordinate, Model, Point};
use super::noise::Noise;
use super::scan::Scanned;
use crate::evidence::ensemble::{Spreads, kind};
use crate::vocabulary::{Effect, Stage};
use crate::watch::Watch;
use weigh::Weighed;

/// Hypotheses that are fitted of those that were scanned.
const FITTED: usize = 8;
/// Sets that explain most of the errors as they are, which are weighed too.
const PLAINLY: usize = 2;
/// Standard deviations of a prior within which two fits are one.
const SAME: f64 = 0.1;
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

impl Set {
    /// Whether both have the same causes at the same sizes, as far as their priors tell sizes apart.
    fn is_at(&self, other: &Self) -> bool {
        let [own, theirs] = [self, other].map(|s| (&s.fit.model.coordinates, &s.fit.x));
        let same = |(c, x): (&Coordinate, &f64)| {
            let at = theirs.0.iter().position(|o| o.axis == c.axis);
            at.is_some_and(|i| (x - theirs.1[i]).abs() < SAME * c.sd)
        };
        self.members == other.members && own.0.iter().zip(own.1).all(same)
    }
}

/// Another cause in the place of a member.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rival {
    pub(super) hypothesis: usize,
    /// Evidence of the set less that with the rival.
    pub(super) margin: f64,
    /// The joint with it.
    pub(super) point: Point,
}

/// What a search found.
pub(super) struct Found {
    pub(super) best: Set,
    /// Evidence that each member adds.
    pub(super) gains: Vec<f64>,
    /// The set without each member; of a search that was ended, of the first ones.
    pub(super) without: Vec<Point>,
    /// Rivals of each member, nearest first.
    pub(super) rivals: Vec<Vec<Rival>>,
    /// What each step of the search added.
    pub(super) steps: Vec<Step>,
    /// Whether the search was ended before its end.
    pub(super) partial: bool,
    /// The cause of those that were not taken which comes nearest to what is asked of it, and what it adds.
    pub(super) next: Option<(Kind, f64)>,
}

/// A cause that came in.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Step {
    pub(super) kind: Kind,
    /// All that were in then.
    pub(super) members: Vec<usize>,
    /// The joint with it.
    pub(super) point: Point,
}

/// A search as it grew.
#[derive(Default)]
struct Grown {
    steps: Vec<Step>,
    /// Evidence that each member added, by its number, and the set without it.
    added: Vec<(usize, f64, Point)>,
}

impl Grown {
    fn add(&mut self, search: &Search<'_>, taken: &Weighed) {
        let with = &taken.with.set;
        if let Some(last) = with.members.last() {
            self.steps.push(Step {
                kind: search.hypotheses[*last].kind,
                members: with.members.clone(),
                point: with.fit.point(),
            });
            let without = taken.without.fit.point();
            self.added.push((*last, taken.adds(), without));
        }
    }

    /// What was found before its members were exchanged.
    fn found(self, best: Set, next: Option<(Kind, f64)>) -> Found {
        let own = |m: &usize| self.added.iter().rev().find(|a| a.0 == *m);
        let gains = best.members.iter().map(|m| own(m).map_or(0.0, |a| a.1));
        let here = best.fit.point();
        let without = best.members.iter().map(|m| own(m).map_or(here, |a| a.2));
        Found {
            gains: gains.collect(),
            without: without.collect(),
            rivals: vec![Vec::new(); best.members.len()],
            next,
            steps: self.steps,
            partial: false,
            best,
        }
    }
}

/// What a calibration says beside what a cause must add.
#[derive(Clone, Copy)]
pub(super) struct Known<'a> {
    pub(super) spreads: &'a Spreads,
    pub(super) laws: &'a BTreeMap<String, f64>,
}

/// Everything that sets are made of.
#[derive(Clone)]
pub(super) struct Search<'a> {
    pub(super) hypotheses: Vec<Hypothesis>,
    nuisances: Vec<Coordinate>,
    pub(super) noise: Noise,
    log_prior: f64,
    pub(super) base: Point,
    /// The same with what is not stated where it fits best.
    pub(super) start: Point,
    /// What healthy joints differ by.
    pub(super) spreads: &'a Spreads,
    /// Effects that the library must not contain.
    pub(super) withhold: Vec<Effect>,
    /// By what share the laws of causes are off, by stage.
    laws: &'a BTreeMap<String, f64>,
    /// Sets that were weighed under the noise that they leave, with their totals.
    tried: BTreeMap<Vec<usize>, f64>,
}

impl<'a> Search<'a> {
    fn of(data: &Data<'_>, asked: &Asked<'_, '_>, cut: bool, known: Known<'a>) -> Self {
        let mut base = Point::default();
        if let Some(before) = asked.baseline {
            (base.params, base.columns) = (before.params, before.columns);
        }
        let nuisances = nuisances(data, &base, cut);
        let errors = data.errors(&[base]).remove(0);
        let noise = Noise::new(data, &errors, &[], MODEL_ERROR);
        let hypotheses = library(data, &base, asked.withhold, cut);
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
            start: base,
            spreads: known.spreads,
            withhold: asked.withhold.to_vec(),
            laws: known.laws,
            tried: BTreeMap::new(),
        }
    }

    /// A search of `data` from where what is not stated fits best.
    pub(super) fn new(data: &Data<'_>, asked: &Asked<'_, '_>, cut: bool, known: Known<'a>) -> Self {
        let start = Self::of(data, asked, cut, known).scattered(data);
        Self::from(data, asked, cut, known, start)
    }

    /// A search of `data` from `start` on, under the noise that all hypotheses together leave.
    pub(super) fn from(
        data: &Data<'_>,
        asked: &Asked<'_, '_>,
        cut: bool,
        known: Known<'a>,
        start: Point,
    ) -> Self {
        let mut own = Self::of(data, asked, cut, known);
        own.start = start;
        let errors = data.errors(&[own.start]).remove(0);
        own.noise = Noise::new(data, &errors, &[], MODEL_ERROR);
        let bare = own.fitted(data, Vec::new(), &own.start, RANKS);
        let mut scanned = own.scan_all(data, &bare);
        own.thin(&scanned);
        own.one_a_way(&mut scanned);
        own.listen(data, &bare, &scanned, 0);
        own
    }

    /// By what share the laws of a stage are off.
    pub(super) fn law(&self, stage: Stage) -> f64 {
        self.laws.get(stage.name()).copied().unwrap_or(0.0)
    }

    /// Parameters and priors of a set.
    pub(super) fn model(&self, members: &[usize]) -> Model {
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

    fn fitted(&self, data: &Data<'_>, members: Vec<usize>, point: &Point, most: usize) -> Set {
        let model = self.model(&members);
        let start = model.start(point);
        let fit = Fit::new(data, &self.noise, model, &start, most);
        self.set(members, fit)
    }

    /// A set, fitted from a point.
    pub(super) fn set_at(&self, data: &Data<'_>, members: Vec<usize>, start: &Point) -> Set {
        self.fitted(data, members, start, STAYS)
    }

    /// Where a set stands that is fitted from a point.
    pub(super) fn point(&self, data: &Data<'_>, members: Vec<usize>, start: &Point) -> Point {
        self.set_at(data, members, start).fit.point()
    }

    /// The search on other data, under the noise that a set leaves there, and the set as it is there.
    pub(super) fn around(&self, data: &Data<'_>, set: &Set) -> (Self, Set) {
        let mut out = self.clone();
        out.tried.clear();
        let point = set.fit.point();
        let errors = data.errors(&[point]).remove(0);
        out.noise = Noise::new(data, &errors, &[], MODEL_ERROR);
        let here = out.fitted(data, set.members.clone(), &point, 0);
        let here = out.settled(data, &here);
        (out, here)
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
    fn grown(&self, data: &Data<'_>, set: &Set, scanned: &[Scanned]) -> Vec<Set> {
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
    fn stated(&self, data: &Data<'_>) -> Vec<Set> {
        let stated = self.fitted(data, Vec::new(), &self.start, 0);
        let scanned = self.scan(data, &stated);
        self.grown(data, &stated, &scanned)
    }

    /// What each kind of cause that a search would fit adds to a set without any, under the noise that it leaves.
    pub(super) fn alone(&mut self, data: &Data<'_>, bare: &Set) -> Vec<(Kind, f64)> {
        let mut out = Vec::new();
        let all = self.candidates(data, std::slice::from_ref(bare));
        let plainly = self.plainly(data, bare);
        for set in self.worth_weighing(&all, bare, &plainly) {
            let own = set.members.last().map(|h| self.hypotheses[*h].kind);
            let adds = self.weighed(data, bare, set).adds();
            out.extend(own.map(|own| (own, adds)));
        }
        out
    }

    /// Sets with one cause more than those of `beam`, one a kind, best first.
    fn candidates(&self, data: &Data<'_>, beam: &[Set]) -> Vec<Set> {
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

    /// Sets with one cause more that explain most of the errors as they are. Noise that follows its own past takes a slow
    /// error of any size for itself, and hides what causes it.
    fn plainly(&self, data: &Data<'_>, set: &Set) -> Vec<Set> {
        let mut own = self.clone();
        own.noise = Noise::plain(data, &set.fit.errors);
        let start = if set.members.is_empty() {
            self.start
        } else {
            set.fit.point()
        };
        let here = own.fitted(data, set.members.clone(), &start, STAYS);
        let mut all = own.grown(data, &here, &own.scan(data, &here));
        all.retain(|s| s.evidence > here.evidence);
        own.one_a_kind(&mut all);
        all.truncate(PLAINLY);
        all
    }

    /// A set from where it stands on, under another noise.
    fn under(&self, data: &Data<'_>, noise: &Noise, set: &Set) -> Set {
        let fit = set.fit.clone().under(data, noise, STAYS);
        self.set(set.members.clone(), fit)
    }

    fn set(&self, members: Vec<usize>, fit: Fit) -> Set {
        Set {
            evidence: fit.evidence + self.log_prior * members.len() as f64,
            members,
            fit,
        }
    }

    /// A set under the noise that it leaves itself.
    fn settled(&mut self, data: &Data<'_>, set: &Set) -> Set {
        let scanned = self.scan(data, set);
        self.listen(data, set, &scanned, set.members.len());
        self.under(data, &self.noise, set)
    }

    /// A set as it is or as fitted from another point, whichever is likelier.
    fn better(&self, data: &Data<'_>, set: Set, start: &Point) -> Set {
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
    pub(super) fn bare(&mut self, data: &Data<'_>) -> Set {
        let mut best = self.fitted(data, Vec::new(), &self.start.clone(), STAYS);
        for _ in 0..ROUNDS {
            let scanned = self.scan(data, &best);
            self.listen(data, &best, &scanned, 0);
            best = self.under(data, &self.noise, &best);
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

    /// Searches from a set on; a cause of a kind must add what `ask` says.
    /// When `watch` ends the search, what was going on is dropped.
    pub(super) fn run(
        &mut self,
        data: &Data<'_>,
        from: &Set,
        ask: Ask<'_>,
        watch: Watch<'_>,
    ) -> Found {
        let mut best = from.clone();
        let mut beam = vec![best.clone()];
        let mut next: Option<(Kind, f64)> = None;
        let mut last = None;
        let mut grown = Grown::default();
        for number in best.members.len() + 1..=MOST {
            if !watch.goes_on(&format!("searching effect {number}")) {
                break;
            }
            let mut all = self.candidates(data, &beam);
            let plainly = self.plainly(data, &best);
            let sets = self.worth_weighing(&all, &best, &plainly);
            let (taken, nearest) = self.likeliest(data, &best, &sets, ask);
            if data.stop.asked() {
                break;
            }
            next = nearest;
            let Some(taken) = taken else { break };
            self.noise = taken.with.noise.clone();
            best = taken.with.set.clone();
            all.retain(|s| s.members != best.members);
            all.insert(0, best.clone());
            all.truncate(BEAM);
            grown.add(self, &taken);
            last = Some(taken);
            beam = all;
        }
        let as_grown = grown.found(best.clone(), next);
        if best.members.is_empty() || !watch.goes_on("trying rivals") {
            return Found {
                partial: data.stop.asked(),
                ..as_grown
            };
        }
        let noise = self.noise.clone();
        let steps = as_grown.steps.clone();
        let exchanged = self.exchanged(data, best, last, ask);
        if data.stop.asked() {
            self.noise = noise;
            return Found {
                partial: true,
                ..as_grown
            };
        }
        Found {
            next,
            steps,
            ..exchanged
        }
    }
}

/// Model error in any one direction, as a share of the noise: of healthy joints, where any were learned from.
pub(super) fn model_error(spreads: &Spreads) -> f64 {
    let learned = spreads.model_error.get(&kind(&SITE)).copied();
    learned.unwrap_or(MODEL_ERROR)
}
