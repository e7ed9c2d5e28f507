//! Sets of causes by their evidence: all hypotheses scanned around a fit, the best of them fitted, one more at a time.

use rayon::prelude::*;

use super::data::{Data, Errors};
use super::fit::{Direction, Fit, Noise};
use super::library::{Hypothesis, Kind, library, nuisances};
use super::model::{Axis, Coordinate, Model, Point};
use crate::evidence::linear::{cholesky, forward};
use crate::vocabulary::Effect;

/// Hypotheses that are fitted of those that were scanned.
const FITTED: usize = 8;
/// Starts of one hypothesis that are kept after the first scan.
const KEPT: usize = 8;
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
    /// The best gain of a cause that was not taken.
    pub(super) next: f64,
}

/// Everything that sets are made of.
pub(super) struct Search {
    pub(super) hypotheses: Vec<Hypothesis>,
    nuisances: Vec<Coordinate>,
    pub(super) noise: Noise,
    log_prior: f64,
    base: Point,
}

/// A hypothesis around a fit: its best start, what it gains there, and the errors it changes.
struct Scanned {
    hypothesis: usize,
    start: Vec<f64>,
    gain: f64,
    change: Errors,
}

impl Search {
    pub(super) fn new(data: &Data, withhold: &[Effect], cut: bool) -> Self {
        let base = Point::default();
        let nuisances = nuisances(data, cut);
        let errors = data.errors(&[base]).remove(0);
        let noise = Noise::new(data, &errors, &[]);
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

    /// Evidence of a set under the present noise.
    fn weigh(&self, set: &mut Set) {
        set.fit.weigh(&self.noise);
        set.evidence = set.fit.evidence + self.log_prior * set.members.len() as f64;
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

    /// The noise of what all that was scanned leaves around a set.
    fn listen(&mut self, data: &Data, set: &Set, scanned: &[Scanned]) {
        let mut directions: Vec<Direction> = scanned
            .iter()
            .map(|s| Direction {
                errors: s.change.clone(),
                prior: [1.0, BETWEEN],
            })
            .collect();
        for (slope, c) in set.fit.slopes.iter().zip(&set.fit.model.coordinates) {
            directions.push(Direction {
                errors: slope.clone(),
                prior: [0.0, c.sd],
            });
        }
        let all: Vec<&Direction> = directions.iter().collect();
        self.noise = Noise::new(data, &set.fit.errors, &all);
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

    /// Searches; a cause must add `least`.
    pub(super) fn run(&mut self, data: &Data, least: f64) -> Found {
        let least = least.min(1e9);
        let mut best = self.fitted(data, Vec::new(), &self.base.clone(), STAYS);
        let all = self.scan_all(data, &best);
        self.thin(&all);
        let scanned = self.scan(data, &best);
        self.listen(data, &best, &scanned);
        best = self.fitted(data, Vec::new(), &best.fit.point(), STAYS);
        let before = best.fit.errors.clone();
        let mut beam = vec![best.clone()];
        let mut next = f64::NEG_INFINITY;
        for _ in 0..MOST {
            let mut all: Vec<Set> = Vec::new();
            for set in &beam {
                let scanned = self.scan(data, set);
                all.extend(self.grown(data, set, &scanned));
            }
            all.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
            let Some(first) = all.first().cloned() else {
                break;
            };
            // Under the noise that the larger set leaves.
            let old = self.noise.clone();
            let scanned = self.scan(data, &first);
            self.listen(data, &first, &scanned);
            let first = self.fitted(data, first.members.clone(), &first.fit.point(), STAYS);
            best = self.fitted(data, best.members.clone(), &best.fit.point(), STAYS);
            next = first.evidence - best.evidence;
            if next <= least {
                self.noise = old;
                self.weigh(&mut best);
                break;
            }
            best = first;
            all.truncate(BEAM);
            all[0] = best.clone();
            beam = all;
        }
        Found {
            before,
            ..self.exchanged(data, best, least, next)
        }
    }

    /// Every member against all others in its place.
    fn exchanged(&mut self, data: &Data, best: Set, least: f64, next: f64) -> Found {
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
            let better = others.first().filter(|s| s.evidence > best.evidence + 0.5);
            rounds += 1;
            if rounds < 8 {
                if bare_gain <= least {
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
            next,
        }
    }
}

/// What a change of the errors gains around a fit, whose own coordinates give way.
struct Around<'a> {
    noise: &'a Noise,
    white: Errors,
    slopes: Vec<Errors>,
    factor: Vec<f64>,
    /// Products of slopes and errors, solved; and what the priors pull.
    solved: Vec<f64>,
}

impl<'a> Around<'a> {
    fn new(noise: &'a Noise, fit: &Fit) -> Self {
        let white = noise.white(&fit.errors);
        let slopes: Vec<Errors> = fit.slopes.iter().map(|s| noise.white(s)).collect();
        let n = slopes.len();
        let mut a = vec![0.0; n * n];
        let mut solved = vec![0.0; n];
        for i in 0..n {
            for j in 0..=i {
                let p = noise.product(&slopes[i], &slopes[j], &white);
                a[i * n + j] = p;
                a[j * n + i] = p;
            }
            let c = &fit.model.coordinates[i];
            let stiff = 1.0 / (c.sd * c.sd);
            a[i * n + i] += stiff;
            solved[i] = noise.product(&slopes[i], &white, &white) + stiff * (fit.x[i] - c.mean);
        }
        let factor = cholesky(&a, n);
        forward(&factor, n, &mut solved);
        Self {
            noise,
            white,
            slopes,
            factor,
            solved,
        }
    }

    /// Half the squares that `share * change` gains, the share being about one.
    fn gain(&self, change: &Errors) -> f64 {
        let d = self.noise.white(change);
        let n = self.solved.len();
        let mut along: Vec<f64> = self
            .slopes
            .iter()
            .map(|s| self.noise.product(s, &d, &self.white))
            .collect();
        forward(&self.factor, n, &mut along);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let stiff = 1.0 / (BETWEEN * BETWEEN);
        let square = self.noise.product(&d, &d, &self.white) - dot(&along, &along) + stiff;
        let moment = self.noise.product(&d, &self.white, &self.white) - dot(&along, &self.solved);
        // The share's prior: one, give or take BETWEEN.
        let toward = stiff - moment;
        0.5 * (toward * toward / square - stiff)
    }
}
