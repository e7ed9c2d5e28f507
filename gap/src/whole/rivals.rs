//! What is still open about the body, as models: the same patch with one effect exchanged.

use std::collections::BTreeMap;

use files::model::Model;

use super::Parts;
use super::found::{self, Item, Place};
use super::intervals::estimates;
use super::patch::{parts, patched};
use super::steady::Change;
use crate::verdict::{EffectRow, Estimate, Verdict, Word};
use crate::vocabulary::{Effect, Stage};

/// One of several explanations.
#[derive(Debug, Clone)]
pub(super) struct Explanation {
    pub(super) effect: Effect,
    pub(super) parameters: BTreeMap<String, Estimate>,
    pub(super) model: Model,
}

/// What is open.
#[derive(Debug, Clone)]
pub(super) enum Open {
    /// Explanations that the data cannot tell apart.
    Class(Vec<Explanation>),
    /// A remainder that nothing explains.
    Remainder {
        /// Gait whose windows leave most.
        gait: usize,
        /// What they leave, squared tolerances per sample.
        cost: f64,
        /// What is another one late in a run than early.
        changes: Option<Change>,
    },
}

/// Values of the rival `effect` of `item`, as fitted in its place.
fn values(d: &Parts, item: &Item, effect: Effect) -> Option<BTreeMap<String, Estimate>> {
    if effect == item.effect {
        return Some(item.parameters.clone());
    }
    let Place::Body(m) = item.place else {
        let twin = d.twin.as_ref().filter(|t| t.effect == effect)?;
        return Some(BTreeMap::from([(twin.key.into(), twin.estimate.clone())]));
    };
    let answer = &d.body.as_ref()?.answer;
    let found = answer.rivals.get(m)?.iter().find_map(|r| {
        let candidate = &answer.candidates[r.candidate];
        let same = (candidate.effect, candidate.joint) == (effect, None);
        same.then_some((candidate, &r.fit))
    });
    let (candidate, fit) = found?;
    let parameters = found::body_parameters(effect, None, d.friction);
    Some(estimates(&parameters, &candidate.free, fit))
}

/// The first class of the verdict, where the body alone holds it.
fn class(d: &Parts, v: &Verdict, model: &Model) -> Option<Vec<Explanation>> {
    let class = v.ambiguous.first()?;
    let members = class.members.iter();
    let body = |stage: &str, joint: Option<usize>| stage == Stage::Body.name() && joint.is_none();
    if !members.clone().all(|m| body(&m.stage, m.joint)) {
        return None;
    }
    let items = found::items(d);
    let first = class.effects.first()?;
    let item = items
        .iter()
        .find(|i| i.effect == *first && i.joint.is_none())?;
    let explain = |effect: Effect| {
        let parameters = values(d, item, effect)?;
        let exchange = |row: &EffectRow| {
            let mut row = row.clone();
            if row.effect == item.effect && row.joint.is_none() {
                row.effect = effect;
                row.parameters.clone_from(&parameters);
            }
            row
        };
        let rows: Vec<EffectRow> = v.effects.iter().map(exchange).collect();
        Some(Explanation {
            effect,
            parameters,
            model: patched(model, parts(&rows), "gap report"),
        })
    };
    let all: Vec<Explanation> = members.filter_map(|m| explain(m.effect)).collect();
    (all.len() > 1).then_some(all)
}

/// A remainder of the body's windows, where the verdict puts one there.
fn remainder(d: &Parts, v: &Verdict) -> Option<Open> {
    let place = v.place.iter().find(|p| p.stage != "unexplained")?;
    let body = d.body.as_ref()?;
    let own = place.stage == Stage::Body.name() || body.changes.is_some();
    if v.verdict != Word::Unknown || !own || !v.ambiguous.is_empty() {
        return None;
    }
    let groups = body.answer.last().groups.iter().enumerate();
    let (worst, cost) = groups.max_by(|a, b| a.1.total_cmp(b.1))?;
    let at = body.tier.group.iter().position(|g| *g == worst)?;
    Some(Open::Remainder {
        gait: body.tier.windows[at].gait,
        cost: *cost,
        changes: body.changes,
    })
}

/// What a further experiment on the ground should decide; `None` where nothing is open about the body.
pub(super) fn open(d: &Parts, v: &Verdict, model: &Model) -> Option<Open> {
    let class = class(d, v, model).map(Open::Class);
    class.or_else(|| remainder(d, v))
}
