//! All hypotheses around a fit, as changes of its errors: what each would gain, and the noise that all together leave.

use rayon::prelude::*;

use super::data::{Data, Errors};
use super::fit::{Fit, Normal, normal};
use super::library::{Hypothesis, Kind, SITE};
use super::model::{Coordinate, Point};
use super::noise::{Direction, Noise, Seen};
use super::search::{Search, Set, model_error};
use crate::evidence::block::{Column, Segment, White};
use crate::evidence::ensemble::name;
use crate::evidence::linear::{cholesky, dot, forward};
use crate::vocabulary::Stage;

/// Starts of one hypothesis that are kept after the first scan.
const KEPT: usize = 8;
/// Standard deviation of the share of a start that is there: neighbours stand a factor of 1.5 to 3 apart.
const BETWEEN: f64 = 0.5;

/// A hypothesis around a fit: its best start, what it gains there, and the errors it changes.
pub(super) struct Scanned {
    pub(super) hypothesis: usize,
    pub(super) start: Vec<f64>,
    pub(super) gain: f64,
    change: Errors,
}

impl Search<'_> {
    /// Every hypothesis around a set at its best start, best first, one a kind and way.
    pub(super) fn scan(&self, data: &Data<'_>, set: &Set) -> Vec<Scanned> {
        let mut all = self.scan_all(data, set);
        self.one_a_way(&mut all);
        all
    }

    /// Leaves of each kind and way the best.
    pub(super) fn one_a_way(&self, all: &mut Vec<Scanned>) {
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
    }

    /// Leaves of many starts those that gain most.
    pub(super) fn thin(&mut self, scanned: &[Scanned]) {
        for (h, own) in self.hypotheses.iter_mut().enumerate() {
            if own.starts.len() > KEPT {
                let best = scanned.iter().filter(|s| s.hypothesis == h).take(KEPT);
                own.starts = best.map(|s| s.start.clone()).collect();
            }
        }
    }

    /// Every start of every hypothesis, best first.
    pub(super) fn scan_all(&self, data: &Data<'_>, set: &Set) -> Vec<Scanned> {
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
    fn differs(&self, data: &Data<'_>, set: &Set) -> Vec<Direction> {
        let here = set.fit.point();
        let neutral = self.base;
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

    /// The noise of what all that was scanned leaves around a set, of whose members the first `stand` are known.
    pub(super) fn listen(&mut self, data: &Data<'_>, set: &Set, scanned: &[Scanned], stand: usize) {
        let directions = self.directions(data, set, scanned, stand);
        let error = model_error(self.spreads);
        self.noise = Noise::new(data, &set.fit.errors, &directions, error);
    }

    /// Directions around a set, of whose members the first `stand` are known.
    pub(super) fn directions(
        &self,
        data: &Data<'_>,
        set: &Set,
        scanned: &[Scanned],
        stand: usize,
    ) -> Vec<Direction> {
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
        self.off_law(set, stand, &mut directions);
        directions
    }

    /// The law of a cause is off by a share: that share of what the cause changes may look like any other direction. So a
    /// second cause is no remainder of the first.
    fn off_law(&self, set: &Set, stand: usize, directions: &mut [Direction]) {
        let first = directions.len() - set.members.len();
        let white: Vec<Errors> = directions
            .iter()
            .map(|d| self.noise.white(&d.errors))
            .collect();
        for (m, own) in set.members.iter().enumerate().take(stand) {
            let law = self.law(self.hypotheses[*own].kind.stage());
            for (i, d) in directions.iter_mut().enumerate() {
                if law > 0.0 && i != first + m {
                    let share = self.noise.share(&white[first + m], &white[i]);
                    d.healthy = libm::hypot(d.healthy, law * share);
                }
            }
        }
    }

    /// A joint without a cause as a block: what all that was scanned changes, and what its own numbers do.
    pub(super) fn block(&self, data: &Data<'_>, set: &Set) -> White {
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

    /// Hypotheses whose numbers the fit moves already, as they are: what their own priors would cost less.
    pub(super) fn absorbed(&self, set: &Set) -> Vec<Scanned> {
        let model = &set.fit.model;
        let squares = |own: &[Coordinate], x: &[f64]| -> f64 {
            let z = own.iter().zip(x).map(|(c, x)| (x - c.mean) / c.sd);
            z.map(|z| z * z).sum()
        };
        let one = |(number, h): (usize, &Hypothesis)| {
            let at = |c: &Coordinate| model.coordinates.iter().position(|o| o.axis == c.axis);
            let places = h.coordinates.iter().map(at).collect::<Option<Vec<_>>>()?;
            let own: Vec<Coordinate> = places.iter().map(|i| model.coordinates[*i]).collect();
            let x: Vec<f64> = places.iter().map(|i| set.fit.x[*i]).collect();
            let start: Vec<f64> = own.iter().zip(&x).map(|(c, x)| c.value(*x)).collect();
            let fits = h.fixed.is_empty() && self.compatible(&set.members, number);
            let all = h.coordinates.iter().zip(&start);
            let moved: Vec<f64> = all.map(|(c, v)| c.variable(*v)).collect();
            fits.then(|| Scanned {
                hypothesis: number,
                gain: 0.5 * (squares(&own, &x) - squares(&h.coordinates, &moved)),
                start,
                change: Errors::new(),
            })
        };
        self.hypotheses.iter().enumerate().filter_map(one).collect()
    }
}

fn add(to: &mut Errors, direction: &Errors, by: f64) {
    for (to, d) in to.iter_mut().zip(direction) {
        to.iter_mut().zip(d).for_each(|(to, d)| *to += by * d);
    }
}

/// Evidence of a generic cause in each stage, and what one could see: both from what was scanned around a set.
impl Search<'_> {
    /// Parts of what a set leaves, by the stage whose effects together would take them off; `None` for what is in doubt
    /// between stages. They add up to one. Errors count as they are, as in [`super::remainder`]: noise that follows its
    /// own past would have what is slow.
    pub(super) fn left(&self, data: &Data<'_>, set: &Set) -> Vec<(Option<Stage>, f64)> {
        let mut plain = self.clone();
        plain.noise = Noise::plain(data, &set.fit.errors);
        let scanned = plain.scan(data, set);
        let around = Around::new(&plain.noise, &set.fit);
        let of = |stage: Option<Stage>| {
            let own = |s: &&Scanned| {
                let kind = self.hypotheses[s.hypothesis].kind;
                stage.is_none_or(|stage| kind.stage() == stage)
            };
            let changes: Vec<&Errors> = scanned.iter().filter(own).map(|s| &s.change).collect();
            around.together(&changes)
        };
        let all = of(None);
        let stages = Stage::JOINT.map(|s| (s, of(Some(s))));
        let sum: f64 = stages.iter().map(|s| s.1).sum();
        let most = stages.iter().map(|s| s.1).fold(0.0, f64::max);
        if sum <= 0.0 || all <= 0.0 {
            return vec![(None, 1.0)];
        }
        let sure = (most / all).min(1.0);
        let parts = stages.into_iter().filter(|s| s.1 > 0.0);
        let mut out: Vec<(Option<Stage>, f64)> = parts
            .map(|(stage, own)| (Some(stage), sure * own / sum))
            .collect();
        out.push((None, 1.0 - sure));
        out
    }

    /// For each kind of cause the evidence that its largest start would have around a set.
    pub(super) fn visible(&self, data: &Data<'_>, set: &Set) -> Vec<(Kind, f64)> {
        let around = Around::new(&self.noise, &set.fit);
        let mut out: Vec<(Kind, f64)> = Vec::new();
        for s in self.scan_all(data, set) {
            let kind = self.hypotheses[s.hypothesis].kind;
            let seen = around.square(&s.change);
            match out.iter_mut().find(|o| o.0 == kind) {
                Some(o) => o.1 = o.1.max(seen),
                None => out.push((kind, seen)),
            }
        }
        out
    }
}

/// What a change of the errors gains around a fit, whose own coordinates give way.
struct Around<'a> {
    noise: &'a Noise,
    normal: Normal,
    factor: Vec<f64>,
    /// Products of slopes and errors, solved; and what the priors pull.
    solved: Vec<f64>,
}

impl<'a> Around<'a> {
    fn new(noise: &'a Noise, fit: &Fit) -> Self {
        let white = noise.white(&fit.errors);
        let normal = normal(noise, &fit.model, &fit.x, white, &fit.slopes);
        let n = fit.x.len();
        let factor = cholesky(&normal.a, n);
        let mut solved = normal.gradient.clone();
        forward(&factor, n, &mut solved);
        Self {
            noise,
            normal,
            factor,
            solved,
        }
    }

    /// Half the squares of a change beyond what the fit's own coordinates imitate.
    fn square(&self, change: &Errors) -> f64 {
        let weights = &self.normal.weights;
        let d = self.noise.seen(self.noise.white(change), weights);
        let slopes = self.normal.slopes.iter();
        let mut along: Vec<f64> = slopes.map(|s| self.noise.product(s, &d, weights)).collect();
        forward(&self.factor, along.len(), &mut along);
        0.5 * (self.noise.product(&d, &d, weights) - dot(&along, &along))
    }

    /// Half the squares that changes gain together, each of a share around none of what was scanned.
    fn together(&self, changes: &[&Errors]) -> f64 {
        let weights = &self.normal.weights;
        let product = |a: &Seen, b: &Seen| self.noise.product(a, b, weights);
        let seen = |c: &&Errors| self.noise.seen(self.noise.white(c), weights);
        let all: Vec<Seen> = changes.iter().map(seen).collect();
        let along = |d: &Seen| {
            let mut out: Vec<f64> = self.normal.slopes.iter().map(|s| product(s, d)).collect();
            forward(&self.factor, self.solved.len(), &mut out);
            out
        };
        let own: Vec<Vec<f64>> = all.iter().map(along).collect();
        let n = all.len();
        let mut a = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let p = product(&all[i], &all[j]) - dot(&own[i], &own[j]);
                a[i * n + j] = p;
                a[j * n + i] = p;
            }
            a[i * n + i] += 1.0;
        }
        let moment = |(d, along): (&Seen, &Vec<f64>)| {
            product(d, &self.normal.errors) - dot(along, &self.solved)
        };
        let mut z: Vec<f64> = all.iter().zip(&own).map(moment).collect();
        let l = cholesky(&a, n);
        forward(&l, n, &mut z);
        0.5 * dot(&z, &z)
    }

    /// Half the squares that `share * change` gains, the share being about one.
    fn gain(&self, change: &Errors) -> f64 {
        let weights = &self.normal.weights;
        let d = self.noise.seen(self.noise.white(change), weights);
        let product = |a: &Seen, b: &Seen| self.noise.product(a, b, weights);
        let n = self.solved.len();
        let mut along: Vec<f64> = self.normal.slopes.iter().map(|s| product(s, &d)).collect();
        forward(&self.factor, n, &mut along);
        let stiff = 1.0 / (BETWEEN * BETWEEN);
        let square = product(&d, &d) - dot(&along, &along) + stiff;
        let moment = product(&d, &self.normal.errors) - dot(&along, &self.solved);
        // The share's prior: one, give or take BETWEEN.
        let toward = stiff - moment;
        0.5 * (toward * toward / square - stiff)
    }
}
