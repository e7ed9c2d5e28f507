//! Which effects: least squares with priors, forward selection on held-out gaits, backward pruning, rivals.
//!
//! Works on anything that gives residuals by gait in units of their tolerances: the joints and the body both use it.

use rayon::prelude::*;

use super::least::{Block, blocks, cost, group_costs, solve, total};
use super::optimum::Optimum;
use super::screen::Lead;
pub(super) use super::terms::{Answer, Candidate, Coordinate, Evaluate, Fit, Limits, Rival};
use super::terms::{on_all, on_most, where_it_acts};
use crate::vocabulary::{Effect, Stage};

/// Error of a fitted value as a share of its distance from the neutral one: two honest simulators of one law differ by this (time step,
/// sweeps; emulated robots).
const LAW: f64 = 0.02;
/// What a rival that foretells unseen gaits better may leave of all gaits, over what the effect itself leaves: a wrong law gets one gait right.
const NO_WORSE: f64 = 1.3;
/// Gain over its threshold from which a gait may disagree. It may do so about a play, a spring or an anisotropy where the cost is rough (robots
/// without one showed 1.7 and 1.3 on three gaits of four), and a little about any effect.
const CLEAR: f64 = 2.0;
/// Candidates of a rough cost that are fitted besides because of what was seen of them: a line that promises much may hold nothing there.
const SEEN: usize = 2;
/// Standard deviations within which a number may be none.
const NONE: f64 = 1.96;

/// What is known before a search.
pub(super) enum Given {
    Nothing,
    /// A fit whose members other evidence has shown.
    Shown(Fit),
    /// A fit with one effect that is tried first.
    Hint(Fit),
}

impl Given {
    /// Members that other evidence has shown.
    pub(super) fn shown(&self) -> Vec<usize> {
        match self {
            Self::Shown(fit) => fit.members.clone(),
            Self::Nothing | Self::Hint(_) => Vec::new(),
        }
    }
}

impl From<Option<Fit>> for Given {
    fn from(shown: Option<Fit>) -> Self {
        shown.map_or(Self::Nothing, Self::Shown)
    }
}

/// Normal equations by group, weight of the priors, and the priors.
type Quadratic = (Vec<Block>, f64, Vec<(f64, f64)>);

/// The search.
pub(super) struct Search<'a, E: Evaluate> {
    pub(super) model: &'a E,
    pub(super) coordinates: &'a [Coordinate],
    pub(super) candidates: &'a [Candidate],
    pub(super) limits: Limits,
}

impl<E: Evaluate> Search<'_, E> {
    pub(super) fn free(&self, members: &[usize]) -> Vec<usize> {
        let mut out: Vec<usize> = (0..self.coordinates.len())
            .filter(|i| self.coordinates[*i].sigma > 0.0)
            .collect();
        for m in members {
            out.extend(&self.candidates[*m].free);
        }
        out.sort_unstable();
        out.dedup();
        out
    }

    /// Whether a member removes the prior of coordinate `i`.
    pub(super) fn freed(&self, members: &[usize], i: usize) -> bool {
        members
            .iter()
            .any(|m| self.candidates[*m].free.contains(&i))
    }

    /// Where coordinate `i` may go: within its tolerance, unless a member frees it.
    pub(super) fn range(&self, members: &[usize], i: usize) -> [f64; 2] {
        let c = &self.coordinates[i];
        if c.sigma == 0.0 || self.freed(members, i) {
            return c.range;
        }
        let reach = self.limits.beyond * c.sigma;
        // What was seen (a torque above the nominal limit) goes before a tolerance.
        let low = (c.neutral - reach).max(c.range[0]);
        [low, (c.neutral + reach).min(c.range[1]).max(low)]
    }

    pub(super) fn prior_weight(&self, cost: f64) -> f64 {
        cost.max(self.limits.floor) / self.limits.independent
    }

    /// Prior pull of `free` at `theta`: diagonal and gradient of `sum z^2`.
    pub(super) fn prior(
        &self,
        members: &[usize],
        free: &[usize],
        theta: &[f64],
    ) -> Vec<(f64, f64)> {
        free.iter()
            .map(|i| {
                let c = &self.coordinates[*i];
                if c.sigma > 0.0 && !self.freed(members, *i) {
                    let w = 1.0 / (c.sigma * c.sigma);
                    (w, w * (theta[*i] - c.neutral))
                } else {
                    (0.0, 0.0)
                }
            })
            .collect()
    }

    pub(super) fn penalty(&self, members: &[usize], theta: &[f64]) -> f64 {
        let free = self.free(members);
        let z2 = |i: &usize| {
            let c = &self.coordinates[*i];
            if c.sigma > 0.0 && !self.freed(members, *i) {
                ((theta[*i] - c.neutral) / c.sigma).powi(2)
            } else {
                0.0
            }
        };
        free.iter().map(z2).sum()
    }

    fn jacobian(&self, theta: &[f64], free: &[usize]) -> (Vec<Vec<Vec<f64>>>, Vec<f64>) {
        self.slopes(theta, free, &|t| self.model.residuals(t))
    }

    /// Residuals as `seen` after a step of each of the `free`, and the steps.
    pub(super) fn slopes(
        &self,
        theta: &[f64],
        free: &[usize],
        seen: &(impl Fn(&[f64]) -> Vec<Vec<f64>> + Sync),
    ) -> (Vec<Vec<Vec<f64>>>, Vec<f64>) {
        let steps: Vec<f64> = free
            .iter()
            .map(|i| {
                let c = &self.coordinates[*i];
                if theta[*i] + c.step > c.range[1] {
                    -c.step
                } else {
                    c.step
                }
            })
            .collect();
        let columns = free
            .par_iter()
            .zip(&steps)
            .map(|(i, h)| {
                let mut t = theta.to_vec();
                t[*i] += h;
                seen(&t)
            })
            .collect();
        (columns, steps)
    }

    /// Levenberg-Marquardt from `theta` with the candidates `members`; held-out cost by the quadratic at the end.
    pub(super) fn fit(&self, theta: &[f64], members: &[usize], iterations: usize) -> Fit {
        let free = self.free(members);
        let mut theta = theta.to_vec();
        let mut residuals = self.model.residuals(&theta);
        let mut lambda = 1e-3;
        let mut last = None;
        for round in 0..=iterations {
            let (columns, steps) = self.jacobian(&theta, &free);
            let blocks = blocks(&residuals, &columns, &steps);
            let (a, b, c, groups) = total(&blocks, &|_| true);
            let weight = self.prior_weight(c / groups.max(1.0)) * groups;
            let prior = self.prior(members, &free, &theta);
            last = Some((blocks, weight, prior.clone()));
            if round == iterations {
                break;
            }
            let now = cost(&residuals) * groups + weight * self.penalty(members, &theta);
            let mut moved = false;
            for _ in 0..4 {
                let next = self.step(&theta, (members, &free), (&a, &b), &prior, weight, lambda);
                let r = self.model.residuals(&next);
                let then = cost(&r) * groups + weight * self.penalty(members, &next);
                if then < now {
                    let (next, r, then) =
                        self.further((&theta, next, r, then), members, &free, groups, weight);
                    moved = now - then > 1e-4 * now;
                    theta = next;
                    residuals = r;
                    lambda = (lambda * 0.2).max(1e-6);
                    break;
                }
                lambda *= 8.0;
            }
            if !moved && self.limits.rough {
                let scale = (groups, weight);
                (theta, residuals, moved) = self.feel(theta, residuals, (members, &free), scale);
            }
            if !moved {
                let (columns, steps) = self.jacobian(&theta, &free);
                let prior = self.prior(members, &free, &theta);
                last = Some((
                    super::least::blocks(&residuals, &columns, &steps),
                    weight,
                    prior,
                ));
                break;
            }
        }
        self.finish(theta, members, &free, &residuals, &last.unwrap_or_default())
    }

    fn step(
        &self,
        theta: &[f64],
        (members, free): (&[usize], &[usize]),
        (a, b): (&[f64], &[f64]),
        prior: &[(f64, f64)],
        weight: f64,
        lambda: f64,
    ) -> Vec<f64> {
        let n = free.len();
        let (mut a, mut b) = (a.to_vec(), b.to_vec());
        for j in 0..n {
            a[j * n + j] += weight * prior[j].0;
            b[j] += weight * prior[j].1;
            a[j * n + j] *= 1.0 + lambda;
            a[j * n + j] += 1e-15;
        }
        let d = solve(&a, &b);
        let mut out = theta.to_vec();
        for (i, d) in free.iter().zip(d) {
            let range = self.range(members, *i);
            out[*i] = (out[*i] - d).clamp(range[0], range[1]);
        }
        out
    }

    /// The fit at `theta`, with what the quadratic there says.
    fn finish(
        &self,
        theta: Vec<f64>,
        members: &[usize],
        free: &[usize],
        residuals: &[Vec<f64>],
        (blocks, weight, prior): &Quadratic,
    ) -> Fit {
        let at_border = |i: &usize| {
            let range = self.range(members, *i);
            theta[*i] <= range[0] || theta[*i] >= range[1]
        };
        let optimum = Optimum {
            blocks,
            weight: *weight,
            prior,
            held: free.iter().map(at_border).collect(),
        };
        let mut folds = optimum.folds();
        let groups = blocks.iter().filter(|b| b.n > 0.0).count().max(1) as f64;
        let cost = cost(residuals);
        if !cost.is_finite() {
            // What cannot be simulated foretells nothing.
            folds.fill(f64::INFINITY);
        }
        let scale = cost.max(self.limits.floor) * groups / self.limits.independent;
        let mut deviation = vec![0.0; theta.len()];
        let mut spread = vec![0.0; theta.len()];
        let known = optimum.variances().into_iter().zip(optimum.apart());
        for (i, ([held, open], apart)) in free.iter().zip(known) {
            let law = LAW * (theta[*i] - self.coordinates[*i].neutral);
            deviation[*i] = (held * scale).sqrt();
            if open > 0.0 {
                spread[*i] = libm::hypot((open * scale).max(apart).sqrt(), law);
            }
        }
        Fit {
            theta,
            members: members.to_vec(),
            groups: group_costs(residuals),
            cost,
            held_out: folds.iter().sum::<f64>() / groups,
            folds,
            deviation,
            spread,
        }
    }

    /// Least gain of the held-out cost for an effect to be believed.
    pub(super) fn threshold(&self, base: &Fit) -> f64 {
        let above = (base.held_out - self.limits.floor).max(0.0);
        (self.limits.share * above)
            .max(self.limits.least)
            .max(self.limits.relative * base.held_out)
    }

    /// The first effect that is believed beside `base`, if any, and the gain over its threshold of the best that is not.
    pub(super) fn first(&self, base: &Fit) -> (Option<Fit>, f64) {
        let (believed, nearest) = self.forward(base, base.held_out, None);
        (believed.into_iter().next(), nearest)
    }

    /// Selection, rivals, and every effect alone and removed.
    pub(super) fn answer(&self, base: Fit, nominal: Vec<f64>) -> Answer {
        self.answer_with(base, nominal, Given::Nothing)
    }

    /// The same with what is known before.
    pub(super) fn answer_with(&self, base: Fit, nominal: Vec<f64>, given: Given) -> Answer {
        let shown = given.shown();
        let found = self.run(base, given);
        self.summed_up(found, &nominal, &shown)
    }

    /// Rivals, and every effect alone and removed, of the steps of a selection; `nearest` is the gain over its threshold of the best candidate
    /// that was not taken, `shown` what other evidence has shown.
    pub(super) fn summed_up(
        &self,
        (mut steps, nearest): (Vec<Fit>, f64),
        nominal: &[f64],
        shown: &[usize],
    ) -> Answer {
        // What other evidence has shown has no rivals.
        let own = |fit: &Fit, m: usize| {
            if shown.contains(&m) {
                Vec::new()
            } else {
                self.rivals(fit, m, 3)
            }
        };
        let rivals_of =
            |fit: &Fit| -> Vec<Vec<Rival>> { fit.members.iter().map(|m| own(fit, *m)).collect() };
        let mut rivals = rivals_of(&steps[steps.len() - 1]);
        let last = &steps[steps.len() - 1];
        let better = rivals
            .iter()
            .flatten()
            .filter(|r| self.significant(&r.fit, r.candidate))
            .map(|r| &r.fit)
            .filter(|f| {
                let foretells = last.held_out - f.held_out > self.threshold(last);
                (foretells && f.cost < NO_WORSE * last.cost) || self.plainly(f, last)
            })
            .min_by(|a, b| a.held_out.total_cmp(&b.held_out));
        let simpler = || self.simpler(last, &rivals);
        if let Some(better) = better.or_else(simpler).cloned() {
            rivals = rivals_of(&better);
            steps.push(better);
        }
        let last = &steps[steps.len() - 1];
        let alone = |m: &usize| {
            let mut theta = steps[0].theta.clone();
            for i in &self.candidates[*m].free {
                theta[*i] = last.theta[*i];
            }
            (
                self.without(last, *m),
                self.fit(&theta, &[*m], self.limits.iterations),
            )
        };
        let removed_alone: Vec<(Fit, Fit)> = last.members.iter().map(alone).collect();
        let strength = |(without, _): &(Fit, Fit)| {
            (self.told(without) - self.told(last)) / self.threshold(without).max(1e-12)
        };
        Answer {
            strengths: removed_alone.iter().map(strength).collect(),
            nearest,
            pull: self.prior_weight(last.cost) * self.penalty(&last.members, &last.theta),
            candidates: self.candidates.to_vec(),
            rivals,
            removed_alone,
            steps,
            limits: self.limits,
            nominal_groups: group_costs(&self.model.residuals(nominal)),
            nominal: nominal.to_vec(),
        }
    }

    /// The fit with a rival that has some of a member's numbers, where those that the member has besides are none as well.
    fn simpler<'r>(&self, fit: &Fit, rivals: &'r [Vec<Rival>]) -> Option<&'r Fit> {
        let none = |i: &usize| {
            let off = (fit.theta[*i] - self.coordinates[*i].neutral).abs();
            off <= NONE * fit.spread[*i]
        };
        let part = |own: &[usize], r: &Rival| {
            let held = &self.candidates[r.candidate].free;
            let besides = own.iter().filter(|i| !held.contains(i));
            held.len() < own.len()
                && held.iter().all(|i| own.contains(i))
                && besides.into_iter().all(none)
        };
        let of = |(m, all): (&usize, &'r Vec<Rival>)| {
            let own = &self.candidates[*m].free;
            all.iter().find(|r| part(own, r))
        };
        let found = fit.members.iter().zip(rivals).find_map(of)?;
        Some(&found.fit)
    }

    /// Whether `fit` is much better than `other` with hardly more numbers: held-out costs are taken to first order only.
    fn plainly(&self, fit: &Fit, other: &Fit) -> bool {
        let more = self.free(&fit.members).len() as f64 - self.free(&other.members).len() as f64;
        let part = if more <= 0.0 { 0.7 } else { 0.5 };
        more <= 1.0 && fit.cost < part * other.cost
    }

    /// The next effects that are believed, the best one first; and the gain over its threshold of the best that is not.
    pub(super) fn forward(&self, base: &Fit, first: f64, hint: Option<&Fit>) -> (Vec<Fit>, f64) {
        let taken = |c: usize| {
            base.members.iter().any(|m| {
                let (a, b) = (&self.candidates[*m], &self.candidates[c]);
                (a.effect, a.joint) == (b.effect, b.joint)
                    || b.free.iter().any(|i| a.free.contains(i))
            })
        };
        let open: Vec<usize> = (0..self.candidates.len()).filter(|c| !taken(*c)).collect();
        // Errors between two simulators of one law grow with the law.
        let least = self
            .threshold(base)
            .max(self.limits.of_first * first * f64::from(u8::from(!base.members.is_empty())));
        let mut believed: Vec<Fit> = Vec::new();
        let mut nearest = 0.0f64;
        for (c, theta) in self.tried(base, &open, least, hint) {
            let mut members = base.members.clone();
            members.push(c);
            let fit = self.fit(&self.scanned(&theta, c), &members, self.limits.iterations);
            if self.believed(base, &fit, c, least) {
                believed.push(fit);
            } else {
                nearest = nearest.max((self.told(base) - self.told(&fit)) / least);
            }
        }
        believed.sort_by(|a, b| a.held_out.total_cmp(&b.held_out));
        (believed, nearest)
    }

    /// Held-out cost, with what the nominal numbers that are off cost.
    pub(super) fn told(&self, fit: &Fit) -> f64 {
        fit.held_out + self.prior_weight(fit.cost) * self.penalty(&fit.members, &fit.theta)
    }

    /// Candidates to fit beside `base`, from where: what is given, what lines promise most of, and, where the cost is rough, what most was seen of.
    fn tried(
        &self,
        base: &Fit,
        open: &[usize],
        least: f64,
        hint: Option<&Fit>,
    ) -> Vec<(usize, Vec<f64>)> {
        let hinted = hint.and_then(|h| Some((*h.members.first()?, h.theta.clone())));
        let strained = open.iter().filter(|c| self.strained(base, **c));
        let mut out: Vec<(usize, Vec<f64>)> = hinted
            .into_iter()
            .chain(strained.map(|c| (*c, base.theta.clone())))
            .collect();
        // What is tried in any case takes no one's turn.
        let mut taken = Vec::new();
        let (mut leads, from) = self.screen(base, open);
        let mut take = |leads: &[Lead], most: usize, cost: fn(&Lead) -> f64| {
            for lead in leads {
                let gains = cost(lead) <= from - 0.3 * least;
                if gains && taken.len() < most && !taken.contains(&lead.candidate) {
                    taken.push(lead.candidate);
                    out.push((lead.candidate, lead.theta.clone()));
                }
            }
        };
        take(&leads, self.limits.refined, |l| l.promised);
        if self.limits.rough {
            leads.sort_by(|a, b| a.seen.total_cmp(&b.seen));
            take(&leads, self.limits.refined + SEEN, |l| l.seen);
        }
        out
    }

    /// Whether candidate `c` is in `fit` more than an error of what is measured, of tolerances, or of simulators of one law.
    pub(super) fn significant(&self, fit: &Fit, c: usize) -> bool {
        self.candidates[c].free.iter().any(|i| {
            let x = &self.coordinates[*i];
            let off = (fit.theta[*i] - x.neutral).abs();
            off > x.least && off > 3.0 * fit.deviation[*i] && off > self.limits.beyond * x.sigma
        })
    }

    fn believed(&self, base: &Fit, fit: &Fit, c: usize, least: f64) -> bool {
        let gain = self.told(base) - self.told(fit);
        // Where the cost is rough, some play or spring, or some direction of an anisotropy, mends a window or two everywhere: a small gain must be one on every
        // gait.
        let effect = self.candidates[c].effect;
        let one_of_many =
            effect.stage() == Stage::Transmission || effect == Effect::FrictionAnisotropy;
        let clear = gain >= CLEAR * least;
        let agreed = !(self.limits.rough && one_of_many) || clear || on_all(base, fit);
        let most = on_most(base, fit, gain, clear) || where_it_acts(base, fit, self.limits.floor);
        gain >= least && most && agreed && self.significant(fit, c)
    }

    /// The fit with one member taken out and the rest fitted again.
    pub(super) fn without(&self, full: &Fit, member: usize) -> Fit {
        let members: Vec<usize> = full
            .members
            .iter()
            .copied()
            .filter(|m| *m != member)
            .collect();
        let mut theta = full.theta.clone();
        for i in &self.candidates[member].free {
            theta[*i] = self.coordinates[*i].neutral;
        }
        self.fit(&theta, &members, self.limits.iterations)
    }
}
