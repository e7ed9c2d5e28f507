//! Fits over a growing horizon. A late encoder can make the loop swing by itself; then the phase at the end of a run hangs on every
//! parameter, and the valley of the whole run is too narrow to be met by any start. Over the first fraction of a second it is
//! wide, and the valley of every horizon leads into that of twice as long a one.

use super::{Considered, Found, Node, Search, Try, with};
use crate::candidates::Candidate;
use crate::fit::{Model, Objective};
use crate::joint::Problem;
use crate::vocabulary::Effect;

/// The first horizon is that part of the longest run.
const FIRST: f64 = 1.0 / 32.0;

/// Steps of the fit at every horizon.
const STEPS: usize = 8;

/// Starts that go on beyond each horizon, of those that came to it.
const ON: f64 = 0.6;

/// A model from here takes another's place if it leaves less than this share of what that one leaves.
const CLEARLY: f64 = 0.7;

/// Whether an effect makes a loop swing by itself whose frequency hangs on its size.
fn swings(e: Effect) -> bool {
    e == Effect::FeedbackDelay
}

impl Search<'_> {
    /// `node` with an effect that makes the loop swing, found over a growing horizon, if it is believed and clearly better than
    /// `best`.
    pub(super) fn grown(
        &self,
        node: &Node,
        best: Option<&(f64, Node)>,
        first: f64,
        log: &mut Vec<Considered>,
    ) -> Option<(f64, Node)> {
        let left = best.map_or_else(|| node.held_out(), |b| b.1.held_out());
        let limit = self.floor_cost + self.options.model_error * first;
        if left < super::CLOSED * limit {
            return None;
        }
        let (candidate, c) = (self.library.iter().enumerate())
            .find(|(_, c)| swings(c.effect) && !self.taken(&node.model, &node.found, c))?;
        let model = self.over_horizons(&node.model, c)?;
        // While the effect was missing the priors weighed what they should beside an error that is gone now.
        let o = self.tuned(&model);
        let t = Try {
            score: self.score(o.cost(&model), c),
            model,
            candidate,
        };
        let (mut considered, held) = self.consider(&o, node, &t, first);
        considered.believed &= held.iter().sum::<f64>() < CLEARLY * left;
        if considered.believed {
            // What came out better on the way from the stated values is no merit of the effect.
            let rest = self.bare(&o, node, &t.model, c);
            considered.believed = self.consider(&o, &rest, &t, first).0.believed;
        }
        log.push(considered.clone());
        if !considered.believed {
            return None;
        }
        let mut found = node.found.clone();
        found.push(Found {
            candidate: c.clone(),
            gain: considered.gain,
        });
        let (score, model) = (t.score, t.model);
        Some((score, Node { model, found, held }))
    }

    /// `node` with what is left of `model` when it is refitted without `c`.
    fn bare(&self, o: &Objective<'_>, node: &Node, model: &Model, c: &Candidate) -> Node {
        let mut model = self.without(model, c);
        o.polish(&mut model, STEPS);
        let held = self.held_out(o, &model);
        let found = node.found.clone();
        Node { model, found, held }
    }

    /// The best of the starts of `c` beside `model`, with nominal values as stated at first.
    fn over_horizons(&self, model: &Model, c: &Candidate) -> Option<Model> {
        let problem = self.objective.problem;
        let steps = problem.runs.iter().map(|r| r.steps).max()?;
        let longest_s = steps as f64 * problem.dt_s;
        let mut models: Vec<Model> = (c.starts.iter())
            .map(|s| with(model, c, s).as_stated())
            .collect();
        let mut part = FIRST;
        while part < 1.0 {
            let short = problem.beginning(part * longest_s);
            models = self.improved(&short, part, models);
            models.truncate((ON * models.len() as f64).ceil() as usize);
            part *= 2.0;
        }
        let models = self.improved(problem, 1.0, models);
        models.into_iter().next()
    }

    /// `models` fitted to `problem`, a `part` of the recordings, best first.
    fn improved(&self, problem: &Problem, part: f64, mut models: Vec<Model>) -> Vec<Model> {
        let o = Objective {
            problem,
            prior_weight: self.floor_cost / (self.independent * part),
            ..self.objective.clone()
        };
        let costs = o.polish_all(&mut models, STEPS);
        let mut all: Vec<(f64, Model)> = costs.into_iter().zip(models).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        all.into_iter().map(|x| x.1).collect()
    }
}
