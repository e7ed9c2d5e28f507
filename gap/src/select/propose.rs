//! Which candidates are worth a test: all are screened, the best refitted, and what strains its prior joins them.

use super::{Found, Node, PULL, Search, Try, with};
use crate::candidates::{self, Candidate};
use crate::fit::{Free, Linear, Model, Objective};
use crate::joint::{P, Params};

/// A nominal parameter beyond this many tolerances may have been bent by something else.
const BENT: f64 = 2.0;

impl Search<'_> {
    /// The best candidates beside those in the model: every start is screened with the other parameters adapted to first
    /// order, the best starts of every candidate are refitted a little, the best candidates well.
    pub(super) fn expand(&self, o: &Objective<'_>, model: &Model, found: &[Found]) -> Vec<Try> {
        let mut all = self.ranked(o, model, found);
        // What is missing may have bent the nominal values so far that no candidate finds its valley from there.
        let rich = found.is_empty().then(|| self.richer(model)).flatten();
        for other in self.stated(model).into_iter().chain(rich) {
            all.extend(self.ranked(o, &other, found));
            all.sort_by(|a, b| a.score.total_cmp(&b.score));
            let mut seen = vec![false; self.library.len()];
            all.retain(|t| !std::mem::replace(&mut seen[t.candidate], true));
        }
        all.truncate(self.options.refined);
        self.refit(o, &mut all, 5);
        all
    }

    /// `model` with its nominal parameters back at their stated values, if one of them is far off.
    fn stated(&self, model: &Model) -> Option<Model> {
        let far = |f: &&Free| f.pull(model.params.get(f.p)).abs() > BENT;
        model.free.iter().find(far)?;
        Some(model.as_stated())
    }

    /// `model` with the unknown nominal values as they are beside dry friction and a weight.
    fn richer(&self, model: &Model) -> Option<Model> {
        let rich = self.rich?;
        let mut out = model.clone();
        for f in model.free.iter().filter(|f| f.tolerance.is_none()) {
            out.params.set(f.p, rich.get(f.p));
        }
        Some(out)
    }

    /// The candidates in the order of a short refit from `model`.
    fn ranked(&self, o: &Objective<'_>, model: &Model, found: &[Found]) -> Vec<Try> {
        let mut tries: Vec<(usize, Model)> = Vec::new();
        let arrivals = candidates::irregular(o.problem);
        for (k, c) in self.library.iter().enumerate() {
            if !self.taken(model, found, c) && arrivals.admits(c.effect) {
                tries.extend(c.starts.iter().map(|s| (k, with(model, c, s))));
                let own: Vec<f64> = (c.free.iter())
                    .map(|f| self.rich.map_or(Params::neutral(f.p), |r| r.get(f.p)))
                    .collect();
                if (c.free.iter().zip(&own)).any(|(f, x)| *x != Params::neutral(f.p)) {
                    tries.push((k, with(model, c, &own)));
                }
            }
        }
        let sets: Vec<Params> = tries.iter().map(|t| t.1.params).collect();
        let linear = o.linearise(model);
        let costs = o.screen(&linear, &sets);
        let mut all: Vec<Try> = tries
            .into_iter()
            .zip(costs)
            .map(|((candidate, model), score)| Try {
                score,
                model,
                candidate,
            })
            .collect();
        all.sort_by(|a, b| a.score.total_cmp(&b.score));
        let starts = if self.options.thorough { 2 } else { 1 };
        let mut seen = vec![0; self.library.len()];
        all.retain(|t| {
            seen[t.candidate] += 1;
            seen[t.candidate] <= starts
        });
        let moved: usize = found.iter().map(|f| f.candidate.moving()).sum();
        self.refit_shared(o, &linear, &mut all, moved, 2);
        let mut seen = vec![false; self.library.len()];
        all.retain(|t| !std::mem::replace(&mut seen[t.candidate], true));
        all.truncate(2 * self.options.refined);
        self.refit_shared(o, &linear, &mut all, moved, 3);
        all
    }

    /// Improves all with the shared slopes of `linear`; the last `moved` parameters before the candidate's own are those of
    /// effects already found, which a new one may push far: they are linearised afresh too.
    fn refit_shared(
        &self,
        o: &Objective<'_>,
        linear: &Linear,
        all: &mut [Try],
        moved: usize,
        iterations: usize,
    ) {
        let mut models: Vec<Model> = all.iter().map(|x| x.model.clone()).collect();
        let own: Vec<usize> = all
            .iter()
            .map(|x| (moved + self.library[x.candidate].moving()).min(x.model.free.len()))
            .collect();
        let costs = o.polish_shared(linear, &mut models, &own, iterations);
        for ((x, m), c) in all.iter_mut().zip(models).zip(costs) {
            x.score = self.score(c, &self.library[x.candidate]);
            x.model = m;
        }
        all.sort_by(|a, b| a.score.total_cmp(&b.score));
    }

    /// Refits a candidate from all its starts: non-smooth parameters have more than one valley. And once with the nominal
    /// parameters back at their stated values, which a large effect may have pulled far away before it was known.
    pub(super) fn deepen(&self, o: &Objective<'_>, node: &Node, linear: &Linear, best: &mut Try) {
        let c = &self.library[best.candidate];
        let attempt = |model: Model| Try {
            score: f64::INFINITY,
            model,
            candidate: best.candidate,
        };
        let starts = c.starts.iter().filter(|_| c.starts.len() > 1);
        let mut all: Vec<Try> = starts.map(|s| attempt(with(&node.model, c, s))).collect();
        let effects = || node.found.iter().map(|f| &f.candidate).chain([c]);
        let moved = effects().map(Candidate::moving).sum::<usize>() - c.moving();
        self.refit_shared(o, linear, &mut all, moved, 4);
        all.truncate(1);
        all.retain(|t| t.score < 1.5 * best.score);
        all.push(attempt(best.model.as_stated()));
        self.refit(o, &mut all, 5);
        if let Some(first) = all.into_iter().next().filter(|t| t.score < best.score) {
            *best = first;
        }
        let moving: Vec<P> = effects().flat_map(|c| &c.free).map(|f| f.p).collect();
        best.score = self.score(o.jiggle(&mut best.model, &moving), c);
    }

    /// Whether a base parameter has left its tolerance against its prior.
    pub(super) fn is_strained(&self, node: &Node) -> bool {
        self.library.iter().any(|c| self.strains(node, c))
    }

    fn strains(&self, node: &Node, c: &Candidate) -> bool {
        let pull = self.pull(c, &node.model.params);
        pull.is_finite() && pull > PULL && !self.taken(&node.model, &node.found, c)
    }

    /// Base effects whose parameter has left its tolerance without being asked, beside the two best of `tries`.
    pub(super) fn strained(&self, o: &Objective<'_>, node: &Node, tries: &[Try]) -> Vec<Try> {
        let tried = |k: usize| tries.iter().take(2).any(|t| t.candidate == k);
        let params = &node.model.params;
        let mut out: Vec<Try> = (self.library.iter().enumerate())
            .filter(|(k, c)| self.strains(node, c) && !tried(*k))
            .map(|(candidate, c)| {
                let present: Vec<f64> = c.free.iter().map(|f| params.get(f.p)).collect();
                Try {
                    score: f64::INFINITY,
                    model: with(&node.model, c, &present),
                    candidate,
                }
            })
            .collect();
        self.refit(o, &mut out, 5);
        out
    }
}
