//! Rivals: every found effect against the best others in its place.

use super::{Found, Node, Search, with};
use crate::candidates::Candidate;
use crate::fit::Model;
use crate::joint::P;
use crate::vocabulary::Effect;

/// A rival that was tried in an effect's place.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// Which.
    pub effect: Effect,
    /// Cost with the rival over cost with the effect, each with a price per parameter.
    pub cost_ratio: f64,
    /// The model with the rival in the effect's place.
    pub model: Model,
}

/// Rounds of exchange: a second one settles what the first one moved.
const ROUNDS: usize = 2;

/// A rival takes an effect's place when it is better by this share.
const BETTER: f64 = 0.98;

impl Search<'_> {
    /// Tries rivals in the place of every found effect, lets better ones in, and returns the rivals that were left.
    pub(super) fn exchange(&self, node: &mut Node) -> Vec<Vec<Rival>> {
        let mut rivals = Vec::new();
        for round in 0..ROUNDS {
            let mut changed = false;
            rivals.clear();
            for k in 0..node.found.len() {
                let (list, better) = self.rivals(node, k);
                rivals.push(list);
                if let Some((found, model)) = better.filter(|_| round + 1 < ROUNDS) {
                    node.found[k] = found;
                    node.model = model;
                    self.settle(node);
                    changed = true;
                }
            }
            if !changed {
                break;
            }
        }
        rivals
    }

    /// Rivals of effect `k`, best first, and the best one if it is better than the effect itself.
    fn rivals(&self, node: &Node, k: usize) -> (Vec<Rival>, Option<(Found, Model)>) {
        let o = self.tuned(&node.model);
        let mine = &node.found[k];
        let mut present = node.model.clone();
        let reference = self.score(o.polish(&mut present, 3), &mine.candidate);
        let mut others = node.found.clone();
        others.remove(k);
        // Not polished: an equivalent rival wants the other parameters as they are, the others are refitted anyway.
        let bare = self.without(&present, &mine.candidate);
        let mut tries = self.expand(&o, &bare, &others);
        self.twin(&o, &bare, &present, mine, &mut tries);
        let mut out: Vec<Rival> = Vec::new();
        let mut better = None;
        for t in tries {
            let c = &self.library[t.candidate];
            if c.effect == mine.candidate.effect {
                continue;
            }
            let ratio = t.score / reference.max(1e-12);
            let outside = self.pull(c, &t.model.params) > 3.0;
            if ratio < BETTER && outside && better.is_none() {
                let found = Found {
                    candidate: c.clone(),
                    gain: mine.gain,
                };
                better = Some((found, t.model.clone()));
            }
            if outside && out.iter().all(|r| r.effect != c.effect) {
                out.push(Rival {
                    effect: c.effect,
                    cost_ratio: ratio,
                    model: t.model,
                });
            }
        }
        (out, better)
    }

    /// A limit of current and one of torque are the same law: the other one starts from where this one is.
    fn twin(
        &self,
        o: &crate::fit::Objective<'_>,
        bare: &Model,
        present: &Model,
        mine: &Found,
        tries: &mut Vec<super::Try>,
    ) {
        let kt = crate::candidates::effort_per_ampere(o.problem, &present.params);
        let (effect, value) = match mine.candidate.effect {
            Effect::CurrentLimit => (
                Effect::TorqueLimit,
                present.params.get(P::CurrentLimit) * kt,
            ),
            Effect::TorqueLimit => (
                Effect::CurrentLimit,
                present.params.get(P::TorqueLimit) / kt,
            ),
            _ => return,
        };
        let Some(candidate) = self.library.iter().position(|c| c.effect == effect) else {
            return;
        };
        tries.retain(|t| self.library[t.candidate].effect != effect);
        tries.push(super::Try {
            score: f64::INFINITY,
            model: with(bare, &self.library[candidate], &[value]),
            candidate,
        });
        self.refit(o, tries, 3);
    }

    /// `model` with `effect` in the place of `mine`, fitted from all its starts; `None` if the library has no such effect.
    #[must_use]
    pub fn stand_in(&self, model: &Model, mine: &Candidate, effect: Effect) -> Option<Model> {
        let o = self.tuned(model);
        let bare = self.without(model, mine);
        let candidates = self.library.iter().filter(|c| c.effect == effect);
        let mut tries: Vec<Model> = candidates
            .flat_map(|c| c.starts.iter().map(|s| with(&bare, c, s)))
            .collect();
        let costs = o.polish_all(&mut tries, 4);
        let best = costs.into_iter().zip(tries);
        best.min_by(|a, b| a.0.total_cmp(&b.0)).map(|t| t.1)
    }

    /// Model with only one of the found effects, and model with all but one. Without a base effect its parameter is what is
    /// stated: as a prior it would come back to where the effect had it.
    #[must_use]
    pub fn alone_and_removed(
        &self,
        found: &[Found],
        model: &Model,
        calibrated: &Model,
    ) -> Vec<(Model, Model)> {
        let o = self.tuned(model);
        let mut models = Vec::new();
        for f in found {
            let value = |x: &crate::fit::Free| model.params.get(x.p);
            let values: Vec<f64> = f.candidate.free.iter().map(value).collect();
            models.push(with(calibrated, &f.candidate, &values));
            let mut removed = self.without(model, &f.candidate);
            let mine = |p: P| f.candidate.free.iter().any(|x| x.p == p);
            removed.free.retain(|x| !mine(x.p));
            models.push(removed);
        }
        o.polish_all(&mut models, 3);
        let mut all = models.into_iter();
        std::iter::from_fn(|| Some((all.next()?, all.next()?))).collect()
    }
}
