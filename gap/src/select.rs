//! Which effects: forward selection on held-out gaits, backward pruning, exchange against rivals.

mod course;
mod exchange;
mod horizon;
mod material;
mod propose;

use crate::candidates::{self, Candidate, Scales};
use crate::fit::{Model, Objective};
use crate::joint::{P, Params};
use crate::vocabulary::{Effect, Stage};

pub use course::Watch;
pub use exchange::Rival;

/// Settings of the search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Least gain of the held-out cost for an effect to be believed, as a share of what is left after it plus the model
    /// error that is allowed for.
    pub least_gain: f64,
    /// Least evidence: independent samples times the logarithm of one plus the gain, twice a log-likelihood ratio.
    /// Calibrated on emulated joints without an effect, where the best of all candidates reaches 18.
    pub least_evidence: f64,
    /// Model error that is allowed for, as a share of the cost before any effect: what two simulators of one law differ
    /// by grows with the law.
    pub model_error: f64,
    /// Most effects.
    pub most: usize,
    /// Candidates refined per step.
    pub refined: usize,
    /// Two starts of every candidate are refitted (needed when nominal values are unknown).
    pub thorough: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            least_gain: 0.12,
            least_evidence: 26.0,
            model_error: 0.001,
            most: 5,
            refined: 6,
            thorough: false,
        }
    }
}

/// A base parameter beyond this many tolerances is a gap.
pub(crate) const PULL: f64 = 3.0;

/// Gain of the cost with priors at which a base parameter that left its tolerance against its prior is believed: what
/// three tolerances cost, at a hundred independent samples.
const STRAINED: f64 = 0.09;

/// Share of the usual evidence that is asked of an effect which unknown nominal values hide: it must improve every fold.
/// Chosen on parts of one measured servo.
const HIDDEN: f64 = 0.65;

/// Other branches that are looked at when a second effect comes in: the greedy first one may be half of two.
const BRANCHES: usize = 2;

/// Below so many floors nothing is left for another branch to explain. Forty emulated joints got the same verdicts as with all
/// branches followed.
const CLOSED: f64 = 1.2;

/// An effect in the model.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// The effect and its parameters.
    pub candidate: Candidate,
    /// Gain of the held-out cost when it came in.
    pub gain: f64,
}

/// A candidate that was put to the test of held-out gaits.
#[derive(Debug, Clone, PartialEq)]
pub struct Considered {
    /// Which.
    pub effect: Effect,
    /// Effects already in the model.
    pub step: usize,
    /// Held-out cost before.
    pub before: f64,
    /// Held-out cost after.
    pub after: f64,
    /// Gain as the threshold sees it.
    pub gain: f64,
    /// Folds that it improves.
    pub wins: usize,
    /// Distance of its base parameters from nominal, in tolerances; infinite for structural effects.
    pub pull: f64,
    /// Whether it was believed.
    pub believed: bool,
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
    /// Candidates that were put to the test, in order.
    pub considered: Vec<Considered>,
    /// Held-out cost that the model error allowed for is a share of: what there is to explain by laws that two simulators
    /// may put differently.
    pub first: f64,
    /// Held-out cost at the end.
    pub held_out: f64,
    /// Cost of the final model on what it was fitted to.
    pub fitted: f64,
    /// Best rivals per effect found.
    pub rivals: Vec<Vec<Rival>>,
    /// Whether someone stopped the search before its end.
    pub partial: bool,
}

/// The search.
#[derive(Clone)]
pub struct Search<'a> {
    /// Cost over all fit runs.
    pub objective: Objective<'a>,
    /// Cost over runs that no fit sees, where there are any.
    pub check: Option<Objective<'a>>,
    /// Runs of each fold.
    pub folds: Vec<Vec<usize>>,
    /// Candidates.
    pub library: Vec<Candidate>,
    /// Typical sizes in the data set.
    pub scales: Scales,
    /// Cost of a perfect model.
    pub floor_cost: f64,
    /// Independent samples, for the weight of priors.
    pub independent: f64,
    /// Where unknown nominal values stand once dry friction and a weight are fitted along with them.
    pub rich: Option<Params>,
    /// Nominal parameters that may move.
    pub nominal: Vec<P>,
    /// Settings.
    pub options: Options,
}

/// A model with its effects.
#[derive(Clone)]
struct Node {
    model: Model,
    found: Vec<Found>,
    /// Held-out cost per fold.
    held: Vec<f64>,
}

impl Node {
    fn held_out(&self) -> f64 {
        self.held.iter().sum()
    }
}

/// Effects that every simulator puts alike: numbers on their way to the controller.
fn exact(e: Effect) -> bool {
    matches!(e.stage(), Stage::Conventions | Stage::Transport)
}

/// A refitted candidate.
struct Try {
    /// Cost with priors, and a price per parameter.
    score: f64,
    model: Model,
    candidate: usize,
}

/// `model` with `c` added, at one of its starts.
fn with(model: &Model, c: &Candidate, start: &[f64]) -> Model {
    let mut m = model.clone();
    m.free.retain(|g| !c.free.iter().any(|f| f.p == g.p));
    m.free.extend(c.free.iter().filter(|f| !f.fixed()).copied());
    for (f, v) in c.free.iter().zip(start) {
        m.params.set(f.p, *v);
    }
    m
}

impl Search<'_> {
    fn tuned(&self, model: &Model) -> Objective<'_> {
        // At a model error of size `cost` per sample a squared tolerance weighs one independent sample.
        let mut o = self.objective.clone();
        o.prior_weight = o.data_cost(&model.params).max(self.floor_cost) / self.independent;
        o
    }

    /// Held-out cost of each fold.
    fn held_out(&self, o: &Objective<'_>, model: &Model) -> Vec<f64> {
        if self.folds.len() < 2 {
            return vec![o.data_cost(&model.params)];
        }
        o.fold_costs(model, &self.folds)
    }

    /// Cost with the price of a candidate's parameters (Schwarz), for independent samples.
    fn score(&self, cost: f64, c: &Candidate) -> f64 {
        let n = c.moving() as f64;
        cost * libm::exp(n * libm::log(self.independent) / self.independent)
    }

    /// Whether `c` would move what is already free without a prior, or what an effect in the model moves.
    fn taken(&self, model: &Model, found: &[Found], c: &Candidate) -> bool {
        let moves = |p: P| {
            model.free.iter().any(|g| g.p == p && g.tolerance.is_none())
                || found
                    .iter()
                    .any(|f| f.candidate.free.iter().any(|g| g.p == p))
        };
        found.iter().any(|f| f.candidate.effect == c.effect) || c.free.iter().any(|f| moves(f.p))
    }

    /// Improves all and sorts them by score.
    fn refit(&self, o: &Objective<'_>, all: &mut [Try], iterations: usize) {
        let mut models: Vec<Model> = all.iter().map(|x| x.model.clone()).collect();
        let costs = o.polish_all(&mut models, iterations);
        for ((x, m), c) in all.iter_mut().zip(models).zip(costs) {
            x.score = self.score(c, &self.library[x.candidate]);
            x.model = m;
        }
        all.sort_by(|a, b| a.score.total_cmp(&b.score));
    }

    /// What gains are measured against: the cost that is left, never below the floor, and the model error allowed for.
    fn scale(&self, left: f64, first: f64) -> f64 {
        (left.max(self.floor_cost) + self.options.model_error * first).max(1e-12)
    }

    /// Largest distance of the base parameters of `c` from nominal, in tolerances; infinite where it has none.
    fn pull(&self, c: &Candidate, params: &Params) -> f64 {
        if !c.effect.is_base() {
            return f64::INFINITY;
        }
        let known = candidates::nominal(self.objective.problem);
        let one = |p: P| candidates::pull(&known, p, params).unwrap_or(f64::INFINITY);
        c.free.iter().map(|f| one(f.p)).fold(0.0, f64::max)
    }

    /// Puts `t` to the test of held-out gaits against `node`.
    fn consider(
        &self,
        o: &Objective<'_>,
        node: &Node,
        t: &Try,
        first: f64,
    ) -> (Considered, Vec<f64>) {
        let c = &self.library[t.candidate];
        let held = self.held_out(o, &t.model);
        let before = node.held_out() + o.prior_cost(&node.model);
        let after = held.iter().sum::<f64>() + o.prior_cost(&t.model);
        let gain = (before - after) / self.scale(after, first);
        let wins = held.iter().zip(&node.held).filter(|(a, b)| a < b).count();
        let pull = self.pull(c, &t.model.params);
        let majority = 2 * wins > held.len() || held.len() < 3 || c.effect.is_base();
        // A base parameter that left its tolerance even against its prior is evidence of its own.
        let off = c.effect.is_base() && self.pull(c, &node.model.params) > PULL;
        let relief = (o.cost(&node.model) - o.cost(&t.model)) / self.scale(after, first);
        let enough = self.enough(gain) || (off && gain.max(relief) > STRAINED);
        let something = !self.is_nothing(&t.model, c.effect);
        let believed = enough && majority && pull > PULL && something;
        let out = Considered {
            effect: c.effect,
            step: node.found.len(),
            before,
            after,
            gain,
            wins,
            pull,
            believed,
        };
        (out, held)
    }

    /// The best candidate whose gain holds on gaits it was not fitted to, as a new node.
    fn believed(
        &self,
        o: &Objective<'_>,
        node: &Node,
        tries: &mut [Try],
        first: f64,
        log: &mut Vec<Considered>,
    ) -> Option<(f64, Node)> {
        let linear = o.linearise(&node.model);
        let mut strained = self.strained(o, node, tries);
        for t in tries.iter_mut().take(2).chain(&mut strained) {
            self.deepen(o, node, &linear, t);
            let (c, held) = self.consider(o, node, t, first);
            log.push(c.clone());
            if c.believed {
                let mut found = node.found.clone();
                found.push(Found {
                    candidate: self.library[t.candidate].clone(),
                    gain: c.gain,
                });
                let next = Node {
                    model: t.model.clone(),
                    found,
                    held,
                };
                return Some((t.score, next));
            }
        }
        None
    }

    /// Whether `next` is better than `node` by what an effect must gain.
    fn gains(&self, o: &Objective<'_>, node: &Node, next: &Node, first: f64) -> bool {
        let before = node.held_out() + o.prior_cost(&node.model);
        let after = next.held_out() + o.prior_cost(&next.model);
        self.enough((before - after) / self.scale(after, first))
    }

    /// Whether any effect could still gain enough.
    fn room(&self, held_out: f64, first: f64) -> bool {
        self.enough((held_out - 0.5 * self.floor_cost) / self.scale(0.0, first))
    }

    /// Whether the first effect leaves more than the right one would.
    fn open(&self, node: &Node, first: f64) -> bool {
        node.held_out() > CLOSED * (self.floor_cost + self.options.model_error * first)
    }

    /// Whether a gain is large enough to be believed.
    fn enough(&self, gain: f64) -> bool {
        let evidence = self.independent * libm::log1p(gain.max(0.0));
        gain > self.options.least_gain && evidence > self.options.least_evidence
    }

    /// Refits a node with priors that weigh what they should at its present error: while a large effect was missing they
    /// weighed too much.
    fn settle(&self, node: &mut Node) {
        let mut last = f64::INFINITY;
        for _ in 0..4 {
            let o = self.tuned(&node.model);
            let cost = o.polish(&mut node.model, 4);
            node.held = self.held_out(&o, &node.model);
            if cost > 0.9 * last {
                return;
            }
            last = cost;
        }
    }

    /// The next best first effects, as nodes of their own.
    fn branches(&self, node: &Node, tries: &[Try], chosen: Option<Effect>) -> Vec<Node> {
        let others = tries
            .iter()
            .filter(|t| Some(self.library[t.candidate].effect) != chosen);
        others
            .take(BRANCHES)
            .map(|t| {
                let mut branch = Node {
                    model: t.model.clone(),
                    found: vec![Found {
                        candidate: self.library[t.candidate].clone(),
                        gain: 0.0,
                    }],
                    held: Vec::new(),
                };
                self.settle(&mut branch);
                branch
            })
            .filter(|n| n.held_out() < node.held_out())
            .collect()
    }

    /// Where nominal values are unknown they bend to hide the first effect: one that improves every fold needs less evidence,
    /// else two are tried of which neither is believed alone. They must improve every fold, too.
    fn hidden(
        &self,
        o: &Objective<'_>,
        node: &Node,
        tries: &[Try],
        first: f64,
        log: &mut Vec<Considered>,
    ) -> Option<(f64, Node)> {
        let everywhere = |held: &[f64]| held.iter().zip(&node.held).all(|(a, b)| a < b);
        for t in tries.iter().take(2) {
            let (c, held) = self.consider(o, node, t, first);
            let evidence = self.independent * libm::log1p(c.gain.max(0.0));
            let weaker = evidence > HIDDEN * self.options.least_evidence && c.pull > PULL;
            if weaker && self.folds.len() > 2 && everywhere(&held) {
                let (candidate, gain) = (self.library[t.candidate].clone(), c.gain);
                let found = vec![Found { candidate, gain }];
                let model = t.model.clone();
                return Some((t.score, Node { model, found, held }));
            }
        }
        let mut best: Option<(f64, Node)> = None;
        for branch in self.branches(node, tries, None) {
            let own = self.tuned(&branch.model);
            let mut tries = self.expand(&own, &branch.model, &branch.found);
            let pick = self.believed(&own, &branch, &mut tries, first, log);
            let limit = best.as_ref().map_or(f64::INFINITY, |b| b.0);
            let better = |p: &(f64, Node)| {
                p.0 < limit && everywhere(&p.1.held) && self.gains(o, node, &p.1, first)
            };
            best = pick.filter(better).or(best);
        }
        if let Some((_, next)) = &mut best {
            // What the two gain together is the evidence for either.
            let gain = next.found.last().map_or(0.0, |f| f.gain);
            next.found.iter_mut().for_each(|f| f.gain = gain);
        }
        best
    }

    /// Takes effects out again that a later one made needless.
    fn prune(&self, node: &mut Node, first: f64) {
        while node.found.len() > 1 {
            let o = self.tuned(&node.model);
            let now = node.held_out() + o.prior_cost(&node.model);
            // The last one came in just now and stays.
            let mut models: Vec<Model> = node.found[..node.found.len() - 1]
                .iter()
                .map(|f| self.without(&node.model, &f.candidate))
                .collect();
            o.polish_all(&mut models, 4);
            let mut weakest: Option<(f64, usize, Vec<f64>)> = None;
            for (i, m) in models.iter().enumerate() {
                let held = self.held_out(&o, m);
                let cost = held.iter().sum::<f64>() + o.prior_cost(m);
                if weakest.as_ref().is_none_or(|w| cost < w.0) {
                    weakest = Some((cost, i, held));
                }
            }
            let Some((cost, i, held)) = weakest else {
                return;
            };
            if self.enough((cost - now) / self.scale(now, first)) {
                return;
            }
            node.found.remove(i);
            node.model = models.swap_remove(i);
            node.held = held;
        }
    }

    /// `model` with the parameters of `c` back at neutral, nominal ones back under their priors.
    fn without(&self, model: &Model, c: &Candidate) -> Model {
        let mut m = model.clone();
        for f in &c.free {
            m.params.set(f.p, Params::neutral(f.p));
            m.free.retain(|g| g.p != f.p);
            if self.nominal.contains(&f.p) {
                // In front: the parameters of effects stay last.
                let known = candidates::nominal(self.objective.problem);
                if let Some(g) = known.into_iter().find(|g| g.p == f.p) {
                    m.free.insert(0, g);
                }
            }
        }
        m
    }
}
