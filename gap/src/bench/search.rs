//! Sets of causes by their evidence: all hypotheses scanned around a fit, the best of them fitted, one more at a time.

use rayon::prelude::*;

use super::data::{Data, Errors};
use super::fit::Fit;
use super::library::{Hypothesis, Kind, SITE, library, nuisances};
use super::model::{Axis, Coordinate, Model, Point};
use super::noise::{Direction, Noise, Seen};
use crate::evidence::block::{Column, Segment, White};
use crate::evidence::ensemble::{Spreads, kind, name};
use crate::evidence::linear::{cholesky, dot, forward};
use crate::vocabulary::Effect;

/// Hypotheses that are fitted of those that were scanned.
const FITTED: usize = 8;
/// Starts of one hypothesis that are kept after the first scan.
const KEPT: usize = 8;
/// Sets of those that grew, best first, that are weighed under the noise they leave.
const TRIED: usize = 3;
/// Rounds in which the fit without a cause may move.
const ROUNDS: usize = 3;
/// Sets that are kept at every size.
const BEAM: usize = 2;
/// Most causes of a joint.
const MOST: usize = 4;
/// Steps of a fit that only ranks, and of one that stays.
const RANKS: usize = 5;
const STAYS: usize = 12;
/// Standard deviation of the share of a start that is there: neighbours stand a factor of 1.5 to 3 apart.
const BETWEEN: f64 = 0.5;
/// Expected number of causes of a joint, as for robots.
const EXPECTED: f64 = 2.0;
/// Model error in any one direction as a share of the noise, where no healthy joints say it: by hand.
pub(super) const MODEL_ERROR: f64 = 0.1;

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
    /// Errors of what is stated, within its tolerances.
    pub(super) before: Errors,
    /// Evidence that each member adds.
    pub(super) gains: Vec<f64>,
    /// Rivals of each member, nearest first.
    pub(super) rivals: Vec<Vec<Rival>>,
    /// The cause of those that were not taken which comes nearest to what is asked of it, and what it adds.
    pub(super) next: Option<(Kind, f64)>,
}

/// Everything that sets are made of.
pub(super) struct Search<'a> {
    pub(super) hypotheses: Vec<Hypothesis>,
    nuisances: Vec<Coordinate>,
    pub(super) noise: Noise,
    log_prior: f64,
    base: Point,
    /// What healthy joints differ by.
    spreads: &'a Spreads,
}

/// A hypothesis around a fit: its best start, what it gains there, and the errors it changes.
struct Scanned {
    hypothesis: usize,
    start: Vec<f64>,
    gain: f64,
    change: Errors,
}

impl<'a> Search<'a> {
    pub(super) fn new(data: &Data, withhold: &[Effect], cut: bool, spreads: &'a Spreads) -> Self {
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
            spreads,
        }
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
    fn compatible(&self, members: &[usize], h: usize) -> bool {
        let new = &self.hypotheses[h];
        members.iter().all(|m| {
            let own = &self.hypotheses[*m];
            own.kind != new.kind && !own.axes().any(|a| new.axes().any(|b| a == b))
        })
    }

    /// Every hypothesis around a set at its best start, best first, one a kind and way.
    fn scan(&self, data: &Data, set: &Set) -> Vec<Scanned> {
        let mut all = self.scan_all(data, set);
        let mut seen = Vec::new();
        all.retain(|s| {
            let h = &self.hypotheses[s.hypothesis];
            let way = (h.kind, h.candidate.as_ref().map(|c| c.variant));
            let new = !seen.contains(&way);
            if new {
                seen.push(way);
            }
            new
        });
        all
    }

    /// Leaves of many starts those that gain most.
    fn thin(&mut self, scanned: &[Scanned]) {
        for (h, own) in self.hypotheses.iter_mut().enumerate() {
            if own.starts.len() > KEPT {
                let best = scanned.iter().filter(|s| s.hypothesis == h).take(KEPT);
                own.starts = best.map(|s| s.start.clone()).collect();
            }
        }
    }

    /// Every start of every hypothesis, best first.
    fn scan_all(&self, data: &Data, set: &Set) -> Vec<Scanned> {
        let here = set.fit.point();
        let mut asked: Vec<(usize, &Vec<f64>)> = Vec::new();
        for (h, own) in self.hypotheses.iter().enumerate() {
            if self.compatible(&set.members, h) {
                asked.extend(own.starts.iter().map(|s| (h, s)));
            }
        }
        let points: Vec<Point> = asked
            .iter()
            .map(|(h, s)| self.hypotheses[*h].on(&here, s))
            .collect();
        let scale = Around::new(&self.noise, &set.fit);
        let mut all: Vec<Scanned> = asked
            .par_chunks(16)
            .zip(points.par_chunks(16))
            .flat_map_iter(|(asked, points)| {
                let errors = data.errors(points);
                asked
                    .iter()
                    .zip(errors)
                    .map(|((h, start), errors)| {
                        let change: Errors = errors
                            .iter()
                            .zip(&set.fit.errors)
                            .map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect())
                            .collect();
                        Scanned {
                            hypothesis: *h,
                            start: (*start).clone(),
                            gain: scale.gain(&change),
                            change,
                        }
                    })
                    .collect::<Vec<_>>()
            })
            .collect();
        all.sort_by(|a, b| {
            b.gain
                .total_cmp(&a.gain)
                .then(a.hypothesis.cmp(&b.hypothesis))
        });
        all
    }

    /// What healthy joints differ by along a column.
    fn learned(&self, column: &Column) -> f64 {
        let learned = name(&SITE, column).and_then(|n| self.spreads.columns.get(&n));
        learned.copied().unwrap_or(0.0)
    }

    /// What healthy joints differ by along the members of a set.
    fn differs(&self, data: &Data, set: &Set) -> Vec<Direction> {
        let here = set.fit.point();
        let neutral = Point::default();
        let members = set.members.iter().map(|m| &self.hypotheses[*m]);
        let mut points = Vec::new();
        let mut healthy = Vec::new();
        for member in members {
            let at: Vec<f64> = member
                .coordinates
                .iter()
                .map(|c| here.get(c.axis))
                .collect();
            let (column, unit) = member.column(&at);
            healthy.push(unit * self.learned(&column));
            let mut without = here;
            member.axes().for_each(|a| without.set(a, neutral.get(a)));
            points.push(without);
        }
        let all = data.errors(&points).into_iter().zip(healthy);
        all.map(|(mut errors, healthy)| {
            add(&mut errors, &set.fit.errors, -1.0);
            Direction {
                errors,
                prior: [0.0, BETWEEN],
                healthy,
            }
        })
        .collect()
    }

    /// The noise of what all that was scanned leaves around a set.
    fn listen(&mut self, data: &Data, set: &Set, scanned: &[Scanned]) {
        let mut directions: Vec<Direction> = scanned
            .iter()
            .map(|s| {
                let (column, unit) = self.hypotheses[s.hypothesis].column(&s.start);
                Direction {
                    errors: s.change.clone(),
                    prior: [1.0, BETWEEN],
                    healthy: unit * self.learned(&column),
                }
            })
            .collect();
        for (slope, c) in set.fit.slopes.iter().zip(&set.fit.model.coordinates) {
            directions.push(Direction {
                errors: slope.clone(),
                prior: [0.0, c.sd],
                healthy: 0.0,
            });
        }
        directions.extend(self.differs(data, set));
        let error = self.spreads.model_error.get(&kind(&SITE)).copied();
        let error = error.unwrap_or(MODEL_ERROR);
        self.noise = Noise::new(data, &set.fit.errors, &directions, error);
    }

    /// A joint without a cause as a block: what all that was scanned changes, and what its own numbers do.
    pub(super) fn block(&self, data: &Data, set: &Set) -> White {
        let scanned = self.scan(data, set);
        let mut columns = Vec::new();
        let mut x: Vec<Errors> = Vec::new();
        let mut y = set.fit.errors.clone();
        for (slope, (c, at)) in set
            .fit
            .slopes
            .iter()
            .zip(set.fit.model.coordinates.iter().zip(&set.fit.x))
        {
            columns.push(Column::nuisance(c.sd));
            add(&mut y, slope, c.mean - at);
            x.push(slope.clone());
        }
        for s in scanned {
            let (column, unit) = self.hypotheses[s.hypothesis].column(&s.start);
            columns.push(column);
            let mut change = Errors::new();
            s.change
                .iter()
                .for_each(|e| change.push(e.iter().map(|e| unit * e).collect()));
            x.push(change);
        }
        let [y, x] = [vec![y], x].map(|all| {
            let white = all.iter().map(|e| self.noise.white(e));
            white.collect::<Vec<Errors>>()
        });
        let weights = self.noise.weights(&self.noise.white(&set.fit.errors));
        let segments: Vec<Segment> = weights
            .into_iter()
            .enumerate()
            .map(|(s, weight)| Segment {
                y: y[0][s].clone(),
                x: x.iter()
                    .map(|x| x[s].iter().map(|x| -x).collect())
                    .collect(),
                weight,
            })
            .collect();
        White::whitened(SITE, columns, &segments, [1.0, 1.0])
    }

    /// Sets with one cause more, best first.
    fn grown(&self, data: &Data, set: &Set, scanned: &[Scanned]) -> Vec<Set> {
        let here = set.fit.point();
        let mut out: Vec<Set> = scanned
            .iter()
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

    /// What each kind of cause that a search would fit adds to a set without any, under the noise that it leaves.
    pub(super) fn alone(&mut self, data: &Data, bare: &Set) -> Vec<(Kind, f64)> {
        let scanned = self.scan(data, bare);
        let mut out: Vec<(Kind, f64)> = Vec::new();
        for set in self.grown(data, bare, &scanned) {
            let old = self.noise.clone();
            let [with, without] = self.larger(data, bare, &set);
            self.noise = old;
            let own = set.members.last().map(|h| self.hypotheses[*h].kind);
            let adds = with.evidence - without.evidence;
            match own.and_then(|own| out.iter_mut().find(|o| o.0 == own)) {
                Some(before) => before.1 = before.1.max(adds),
                None => out.extend(own.map(|own| (own, adds))),
            }
        }
        out
    }

    /// A set with one cause more, and the set without it, under the noise that the larger one leaves; each from where
    /// either was.
    fn larger(&mut self, data: &Data, set: &Set, with: &Set) -> [Set; 2] {
        let scanned = self.scan(data, with);
        self.listen(data, with, &scanned);
        let more = self.fitted(data, with.members.clone(), &with.fit.point(), STAYS);
        let less = self.fitted(data, set.members.clone(), &set.fit.point(), STAYS);
        let less = self.better(data, less, &more.fit.point());
        let added = with.members.last().map(|h| &self.hypotheses[*h]);
        let neutral = added.map_or(Vec::new(), Hypothesis::neutral);
        let start = added.map_or(less.fit.point(), |h| h.on(&less.fit.point(), &neutral));
        let more = self.better(data, more, &start);
        [more, less]
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
        let all = self.scan_all(data, &best);
        self.thin(&all);
        for _ in 0..ROUNDS {
            let scanned = self.scan(data, &best);
            self.listen(data, &best, &scanned);
            best = self.fitted(data, Vec::new(), &best.fit.point(), STAYS);
            let before = best.evidence;
            for other in self.grown(data, &best, &scanned) {
                best = self.better(data, best, &other.fit.point());
            }
            if best.evidence < before + 1.0 {
                break;
            }
        }
        best
    }

    /// Searches; a cause of a kind must add what `ask` says.
    pub(super) fn run(&mut self, data: &Data, ask: Ask<'_>) -> Found {
        let mut best = self.bare(data);
        let before = best.fit.errors.clone();
        let mut beam = vec![best.clone()];
        let mut next: Option<(Kind, f64)> = None;
        for _ in 0..MOST {
            let mut all: Vec<Set> = Vec::new();
            for set in &beam {
                let scanned = self.scan(data, set);
                all.extend(self.grown(data, set, &scanned));
            }
            all.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
            next = None;
            let mut taken = None;
            for set in all.iter().take(TRIED) {
                let old = self.noise.clone();
                let [with, without] = self.larger(data, &best, set);
                if self.above(&with, ask) > self.above(&without, ask) {
                    taken = Some(with);
                    break;
                }
                self.noise = old;
                let own = set.members.last().map(|h| self.hypotheses[*h].kind);
                let adds = with.evidence - without.evidence;
                let share = |(kind, adds): (Kind, f64)| adds / ask(kind);
                if let Some(own) = own
                    && next.is_none_or(|n| share((own, adds)) > share(n))
                {
                    next = Some((own, adds));
                }
            }
            let Some(taken) = taken else { break };
            all.retain(|s| s.members != taken.members);
            all.insert(0, taken.clone());
            all.truncate(BEAM);
            best = taken;
            beam = all;
        }
        Found {
            before,
            next,
            ..self.exchanged(data, best, ask)
        }
    }

    /// Every member against all others in its place.
    fn exchanged(&mut self, data: &Data, best: Set, ask: Ask<'_>) -> Found {
        let mut best = best;
        let mut gains = Vec::new();
        let mut rivals = Vec::new();
        let mut at = 0;
        let mut rounds = 0;
        while at < best.members.len() {
            let mut members = best.members.clone();
            let own = members.remove(at);
            let bare = self.fitted(data, members, &best.fit.point(), STAYS);
            let bare_gain = best.evidence - bare.evidence;
            let scanned = self.scan(data, &bare);
            let others = self.grown(data, &bare, &scanned);
            let bar = self.above(&bare, ask);
            let mut better = others.iter().filter(|s| self.above(s, ask) > bar);
            let better = better.find(|s| s.evidence > best.evidence + 0.5);
            rounds += 1;
            if rounds < 8 {
                if bare_gain <= ask(self.hypotheses[own].kind) {
                    best = bare;
                    (at, gains, rivals) = (0, Vec::new(), Vec::new());
                    continue;
                }
                if let Some(other) = better {
                    best = self.fitted(data, other.members.clone(), &other.fit.point(), STAYS);
                    (at, gains, rivals) = (0, Vec::new(), Vec::new());
                    continue;
                }
            }
            gains.push(bare_gain);
            rivals.push(
                others
                    .iter()
                    .filter_map(|s| {
                        let new = *s.members.last()?;
                        let same = self.hypotheses[new].kind == self.hypotheses[own].kind;
                        (!same).then_some(Rival {
                            hypothesis: new,
                            margin: best.evidence - s.evidence,
                        })
                    })
                    .collect(),
            );
            at += 1;
        }
        Found {
            best,
            before: Errors::new(),
            gains,
            rivals,
            next: None,
        }
    }
}

fn add(to: &mut Errors, direction: &Errors, by: f64) {
    for (to, d) in to.iter_mut().zip(direction) {
        to.iter_mut().zip(d).for_each(|(to, d)| *to += by * d);
    }
}

/// What a change of the errors gains around a fit, whose own coordinates give way.
struct Around<'a> {
    noise: &'a Noise,
    errors: Seen,
    weights: Errors,
    slopes: Vec<Seen>,
    factor: Vec<f64>,
    /// Products of slopes and errors, solved; and what the priors pull.
    solved: Vec<f64>,
}

impl<'a> Around<'a> {
    fn new(noise: &'a Noise, fit: &Fit) -> Self {
        let white = noise.white(&fit.errors);
        let (_, weights) = noise.left(&white);
        let errors = noise.seen(white, &weights);
        let all = fit.slopes.iter().map(|s| noise.white(s));
        let slopes: Vec<Seen> = all.map(|s| noise.seen(s, &weights)).collect();
        let n = slopes.len();
        let mut a = vec![0.0; n * n];
        let mut solved = vec![0.0; n];
        for i in 0..n {
            for j in 0..=i {
                let p = noise.product(&slopes[i], &slopes[j], &weights);
                a[i * n + j] = p;
                a[j * n + i] = p;
            }
            let c = &fit.model.coordinates[i];
            let stiff = 1.0 / (c.sd * c.sd);
            a[i * n + i] += stiff;
            solved[i] = noise.product(&slopes[i], &errors, &weights) + stiff * (fit.x[i] - c.mean);
        }
        let factor = cholesky(&a, n);
        forward(&factor, n, &mut solved);
        Self {
            noise,
            errors,
            weights,
            slopes,
            factor,
            solved,
        }
    }

    /// Half the squares that `share * change` gains, the share being about one.
    fn gain(&self, change: &Errors) -> f64 {
        let d = self.noise.seen(self.noise.white(change), &self.weights);
        let product = |a: &Seen, b: &Seen| self.noise.product(a, b, &self.weights);
        let n = self.solved.len();
        let mut along: Vec<f64> = self.slopes.iter().map(|s| product(s, &d)).collect();
        forward(&self.factor, n, &mut along);
        let stiff = 1.0 / (BETWEEN * BETWEEN);
        let square = product(&d, &d) - dot(&along, &along) + stiff;
        let moment = product(&d, &self.errors) - dot(&along, &self.solved);
        // The share's prior: one, give or take BETWEEN.
        let toward = stiff - moment;
        0.5 * (toward * toward / square - stiff)
    }
}
