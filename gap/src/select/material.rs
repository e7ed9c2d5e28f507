//! The last word on every effect: what is not worth its place in the finished model leaves it.

use super::{Found, Node, PULL, Search};
use crate::fit::{Model, Objective};
use crate::joint::P;
use crate::names;
use crate::vocabulary::Effect;

/// Share of its torque that a motor loses as it warms up without being weak: neodymium magnets lose 0.11 % per kelvin, ferrite ones 0.2 % (data
/// sheets of both materials), and cases warm up by some 40 K.
const MAGNETS: f64 = 0.08;
/// Least gain of an effect on runs that no fit has seen, as a share of what is left: it may be small, but no loss.
const UNSEEN_GAIN: f64 = 0.02;
/// The same where the effect has a size that no robot has: it may stand for another law, and must be needed for it.
const UNSEEN_GAIN_IMPLAUSIBLE: f64 = 0.10;

impl Search<'_> {
    /// Takes out every effect without which the refitted model is as good: on held-out gaits, or on the runs that the
    /// figures are taken on. The least useful one goes first; the others are judged anew after it.
    pub(super) fn clear(&self, node: &mut Node, first: f64) {
        while !node.found.is_empty() {
            let o = self.tuned(&node.model);
            let now = node.held_out() + o.prior_cost(&node.model);
            let mut models: Vec<Model> = node
                .found
                .iter()
                .map(|f| self.without(&node.model, &f.candidate))
                .collect();
            o.polish_all(&mut models, 8);
            let mut least: Option<(f64, usize, Vec<f64>)> = None;
            let scale = self.scale(now, first);
            for (i, m) in models.iter().enumerate() {
                let held = self.held_out(&o, m);
                let loss = held.iter().sum::<f64>() + o.prior_cost(m) - now;
                node.found[i].gain = loss / scale;
                let needless = !self.worth(&o, node, &node.found[i], m, loss, first);
                if needless && least.as_ref().is_none_or(|l| loss < l.0) {
                    least = Some((loss, i, held));
                }
            }
            let Some((_, i, held)) = least else { return };
            node.found.remove(i);
            node.model = models.swap_remove(i);
            node.held = held;
            self.settle(node);
        }
    }

    /// Whether `found` earns its place in `node` against the refitted model `bare` without it, which costs `loss` more.
    fn worth(
        &self,
        o: &Objective<'_>,
        node: &Node,
        found: &Found,
        bare: &Model,
        loss: f64,
        first: f64,
    ) -> bool {
        let now = node.held_out() + o.prior_cost(&node.model);
        let base = found.candidate.effect.is_base();
        // A base parameter has shown beforehand that it left its tolerance.
        let gains = self.enough(loss / self.scale(now, first)) || base && loss > 0.0;
        gains
            && !self.is_nothing(&node.model, found.candidate.effect)
            && (base && self.pulls(bare, found) || self.holds(node, found, bare, first))
    }

    /// Whether an effect is too small to be one. A clock that is off by less than a step at the end of the longest run moves
    /// set-points within the doubt of their instants. A motor that loses no more than its magnets do is as strong as stated.
    pub(super) fn is_nothing(&self, model: &Model, effect: Effect) -> bool {
        match effect {
            Effect::ClockSkew => {
                let longest = self.objective.problem.runs.iter().map(|r| r.steps).max();
                model.params.get(P::Skew).abs() * longest.unwrap_or(0) as f64 <= 1.0
            }
            Effect::ThermalDerating => model.params.get(P::DerateShare) < MAGNETS,
            _ => false,
        }
    }

    /// Whether the model with an effect does better than `bare` on runs that neither was fitted to.
    fn holds(&self, node: &Node, found: &Found, bare: &Model, first: f64) -> bool {
        let Some(check) = &self.check else {
            return true;
        };
        let costs = check.data_costs(&[node.model.params, bare.params]);
        let (with, without) = (costs[0], costs[1]);
        let least = if names::plausible(&found.candidate, &node.model.params, &self.scales) {
            UNSEEN_GAIN
        } else {
            UNSEEN_GAIN_IMPLAUSIBLE
        };
        without - with > least * self.scale(with, first)
    }

    /// Whether the model without `found` holds one of its parameters by leaving that one's tolerance all the same.
    fn pulls(&self, bare: &Model, found: &Found) -> bool {
        let pull = self.pull(&found.candidate, &bare.params);
        pull.is_finite() && pull > PULL
    }
}
