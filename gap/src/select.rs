//! Which effects: forward selection on held-out gaits, backward pruning, rivals.

use crate::candidates::Candidate;
use crate::fit::{Model, Objective};
use crate::joint::{P, Params};
use crate::vocabulary::Effect;

/// Settings of the search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Least gain of the held-out cost, as a share of what is left above the floor, for an effect to be believed.
    /// Calibrated on data without an effect.
    pub least_gain: f64,
    /// Least gain in absolute cost (squared tolerances).
    pub least_cost: f64,
    /// Least gain as a share of the cost before any effect: the errors between two simulators of one law grow with the law.
    pub least_share: f64,
    /// Most effects.
    pub most: usize,
    /// Candidates refined per step.
    pub refined: usize,
    /// Try every start with a fit of its own instead of the linear screen (needed when nominal values are unknown).
    pub thorough: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            least_gain: 0.12,
            least_cost: 0.5,
            least_share: 0.005,
            most: 5,
            refined: 5,
            thorough: false,
        }
    }
}

/// An effect in the model.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// The effect and its parameters.
    pub candidate: Candidate,
    /// Gain of the held-out cost when it came in.
    pub gain: f64,
}

/// A rival that was tried in an effect's place.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// Which.
    pub effect: Effect,
    /// Cost with the rival over cost with the effect.
    pub cost_ratio: f64,
}

/// A stage of the search: the model and its held-out cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Effect that came in; `None` for the calibrated nominal model.
    pub added: Option<Effect>,
    /// Model after it.
    pub model: Model,
    /// Held-out cost.
    pub held_out: f64,
}

/// Result of the search.
#[derive(Debug, Clone, PartialEq)]
pub struct Selection {
    /// Final model.
    pub model: Model,
    /// Effects in it.
    pub found: Vec<Found>,
    /// The way there.
    pub steps: Vec<Step>,
    /// Best candidates that were not believed, with their relative gain.
    pub refused: Vec<(Effect, f64)>,
    /// Held-out cost at the end.
    pub held_out: f64,
}

/// The search.
pub struct Search<'a> {
    /// Cost over all fit runs.
    pub objective: Objective<'a>,
    /// Runs of each fold.
    pub folds: Vec<Vec<usize>>,
    /// Candidates.
    pub library: Vec<Candidate>,
    /// Cost of a perfect model.
    pub floor_cost: f64,
    /// Independent samples, for the weight of priors.
    pub independent: f64,
    /// Settings.
    pub options: Options,
}

/// `model` with `c` added, at one of its starts.
fn with(model: &Model, c: &Candidate, start: &[f64]) -> Model {
    let mut m = model.clone();
    m.free.retain(|g| !c.free.iter().any(|f| f.p == g.p));
    m.free.extend(c.free.iter().copied());
    for (f, v) in c.free.iter().zip(start) {
        m.params.set(f.p, *v);
    }
    m
}

impl Search<'_> {
    fn tuned(&self, cost: f64) -> Objective<'_> {
        // At a model error of size `cost` per sample a squared tolerance weighs one independent sample.
        let mut o = self.objective.clone();
        o.prior_weight = cost.max(self.floor_cost) / self.independent;
        o
    }

    /// Held-out cost of each fold: fitted on the others, from `model`.
    fn held_out(&self, o: &Objective<'_>, model: &Model) -> Vec<f64> {
        if self.folds.len() < 2 {
            return vec![o.data_cost(&model.params)];
        }
        let one = |fold: &Vec<usize>| {
            let train: Vec<usize> = o
                .runs
                .iter()
                .copied()
                .filter(|r| !fold.contains(r))
                .collect();
            let mut m = model.clone();
            o.on(train).polish(&mut m, 2);
            // Share of the fold, so that the folds add up to a mean over runs.
            o.on(fold.clone()).data_cost(&m.params) * fold.len() as f64 / o.runs.len() as f64
        };
        self.folds.iter().map(one).collect()
    }

    fn overlaps(&self, model: &Model, c: &Candidate, nominal: &[P]) -> bool {
        c.free.iter().any(|f| {
            model
                .free
                .iter()
                .any(|g| g.p == f.p && (g.tolerance.is_none() || !nominal.contains(&g.p)))
        })
    }

    /// Candidates ranked by their cost after a first, cheap adaptation.
    fn ranked(
        &self,
        o: &Objective<'_>,
        model: &Model,
        skip: &[Effect],
        nominal: &[P],
    ) -> Vec<(f64, Model, usize)> {
        let linear = o.linearise(model);
        let mut out = Vec::new();
        for (k, c) in self.library.iter().enumerate() {
            if skip.contains(&c.effect) || self.overlaps(model, c, nominal) {
                continue;
            }
            let mut tries: Vec<(f64, Model)> = c
                .starts
                .iter()
                .map(|s| {
                    let m = with(model, c, s);
                    let cost = if self.options.thorough {
                        o.cost(&m)
                    } else {
                        o.screen(&linear, &m.params)
                    };
                    (cost, m)
                })
                .collect();
            tries.sort_by(|a, b| a.0.total_cmp(&b.0));
            if self.options.thorough {
                tries.truncate(3);
                tries
                    .iter_mut()
                    .for_each(|(cost, m)| *cost = o.polish(m, 5));
                tries.sort_by(|a, b| a.0.total_cmp(&b.0));
            }
            if let Some((cost, m)) = tries.into_iter().next() {
                out.push((cost, m, k));
            }
        }
        out.sort_by(|a, b| a.0.total_cmp(&b.0));
        out
    }

    /// Runs the search from the calibrated nominal model.
    #[must_use]
    pub fn run(&self, calibrated: Model) -> Selection {
        let nominal: Vec<P> = calibrated.free.iter().map(|f| f.p).collect();
        let mut model = calibrated;
        let mut found: Vec<Found> = Vec::new();
        let mut held: Vec<f64> =
            self.held_out(&self.tuned(self.objective.data_cost(&model.params)), &model);
        let mut steps = vec![Step {
            added: None,
            model: model.clone(),
            held_out: held.iter().sum(),
        }];
        let mut refused = Vec::new();
        while found.len() < self.options.most {
            let o = self.tuned(self.objective.data_cost(&model.params));
            let skip: Vec<Effect> = found.iter().map(|f| f.candidate.effect).collect();
            let mut best: Vec<(f64, Model, usize)> = self.ranked(&o, &model, &skip, &nominal);
            best.truncate(self.options.refined);
            best.iter_mut()
                .for_each(|(cost, m, _)| *cost = o.polish(m, 8));
            best.sort_by(|a, b| a.0.total_cmp(&b.0));
            let least = self
                .options
                .least_cost
                .max(self.options.least_share * steps[0].held_out);
            let accepted = self.first_believed(&o, &best, &held, least, &mut refused);
            let Some((candidate, next, next_held, gain)) = accepted else {
                break;
            };
            model = next;
            held = next_held;
            steps.push(Step {
                added: Some(candidate.effect),
                model: model.clone(),
                held_out: held.iter().sum(),
            });
            found.push(Found { candidate, gain });
            self.prune(&nominal, &mut model, &mut found, &mut held);
        }
        Selection {
            held_out: held.iter().sum(),
            model,
            found,
            steps,
            refused,
        }
    }

    /// The best candidate whose gain holds on gaits it was not fitted to.
    fn first_believed(
        &self,
        o: &Objective<'_>,
        best: &[(f64, Model, usize)],
        held: &[f64],
        least: f64,
        refused: &mut Vec<(Effect, f64)>,
    ) -> Option<(Candidate, Model, Vec<f64>, f64)> {
        let before: f64 = held.iter().sum();
        refused.clear();
        for (_, m, k) in best.iter().take(2) {
            let c = &self.library[*k];
            let next = self.held_out(o, m);
            let after: f64 = next.iter().sum();
            let gain = (before - after)
                / (before - self.floor_cost)
                    .max(0.25 * self.floor_cost)
                    .max(1e-9);
            let wins = next.iter().zip(held).filter(|(a, b)| a < b).count();
            let outside = c
                .free
                .iter()
                .all(|f| !c.effect.is_base() || self.beyond_tolerance(f.p, &m.params));
            let majority = 2 * wins > held.len() || held.len() < 3;
            if gain > self.options.least_gain && before - after > least && majority && outside {
                return Some((c.clone(), m.clone(), next, gain));
            }
            refused.push((c.effect, gain));
        }
        None
    }

    /// Whether a base parameter left its tolerance (three sigma); always so where no tolerance is known.
    fn beyond_tolerance(&self, p: P, params: &Params) -> bool {
        let known = crate::candidates::nominal(self.objective.problem);
        known
            .iter()
            .find(|f| f.p == p)
            .is_none_or(|f| f.tolerance.is_none() || f.pull(params.get(p)).abs() > 3.0)
    }

    /// Takes effects out again that a later one made needless.
    fn prune(&self, nominal: &[P], model: &mut Model, found: &mut Vec<Found>, held: &mut Vec<f64>) {
        while found.len() > 1 {
            let o = self.tuned(self.objective.data_cost(&model.params));
            let now: f64 = held.iter().sum();
            let mut weakest: Option<(f64, usize, Model, Vec<f64>)> = None;
            // The last one came in just now and stays.
            let earlier = found.iter().enumerate().take(found.len() - 1);
            for (i, effect) in earlier {
                let mut m = self.without(model, &effect.candidate, nominal);
                o.polish(&mut m, 4);
                let h = self.held_out(&o, &m);
                let cost: f64 = h.iter().sum();
                if weakest.as_ref().is_none_or(|w| cost < w.0) {
                    weakest = Some((cost, i, m, h));
                }
            }
            let Some((cost, i, m, h)) = weakest else {
                return;
            };
            let loss = (cost - now)
                / (cost - self.floor_cost)
                    .max(0.25 * self.floor_cost)
                    .max(1e-9);
            if loss > 0.7 * self.options.least_gain && cost - now > 0.7 * self.options.least_cost {
                return;
            }
            found.remove(i);
            (*model, *held) = (m, h);
        }
    }

    /// `model` with the parameters of `c` back at neutral, nominal ones back under their priors.
    fn without(&self, model: &Model, c: &Candidate, nominal: &[P]) -> Model {
        let mut m = model.clone();
        for f in &c.free {
            m.params.set(f.p, Params::neutral(f.p));
            m.free.retain(|g| g.p != f.p);
            if nominal.contains(&f.p) {
                m.free.extend(
                    crate::candidates::nominal(self.objective.problem)
                        .into_iter()
                        .filter(|g| g.p == f.p),
                );
            }
        }
        m
    }

    /// Tries the best rivals in the place of every found effect.
    #[must_use]
    pub fn rivals(&self, s: &Selection, nominal: &[P], most: usize) -> Vec<Vec<Rival>> {
        let cost = self.objective.data_cost(&s.model.params);
        let o = self.tuned(cost);
        let reference = o.cost(&s.model);
        let all: Vec<Effect> = s.found.iter().map(|f| f.candidate.effect).collect();
        let one = |f: &Found| {
            let mut bare = self.without(&s.model, &f.candidate, nominal);
            o.polish(&mut bare, 3);
            let mut best = self.ranked(&o, &bare, &all, nominal);
            best.truncate(most);
            let mut out: Vec<Rival> = best
                .iter_mut()
                .map(|(_, m, k)| {
                    let c = o.polish(m, 6);
                    Rival {
                        effect: self.library[*k].effect,
                        cost_ratio: c / reference.max(1e-12),
                    }
                })
                .collect();
            out.sort_by(|a, b| a.cost_ratio.total_cmp(&b.cost_ratio));
            out.dedup_by_key(|r| r.effect);
            out
        };
        s.found.iter().map(one).collect()
    }

    /// Model with only one of the found effects, and model with all but one.
    #[must_use]
    pub fn alone_and_removed(
        &self,
        s: &Selection,
        calibrated: &Model,
        nominal: &[P],
    ) -> Vec<(Model, Model)> {
        let o = self.tuned(self.objective.data_cost(&s.model.params));
        let one = |f: &Found| {
            let values: Vec<f64> = f
                .candidate
                .free
                .iter()
                .map(|x| s.model.params.get(x.p))
                .collect();
            let mut alone = with(calibrated, &f.candidate, &values);
            let mut removed = self.without(&s.model, &f.candidate, nominal);
            o.polish(&mut alone, 5);
            o.polish(&mut removed, 5);
            (alone, removed)
        };
        s.found.iter().map(one).collect()
    }
}
