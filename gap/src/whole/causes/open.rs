//! What is still open about the body, as models: the same patch with one cause exchanged.

use files::model::Model;

use super::super::experiment::{Explanation, Open};
use super::super::patch::patched;
use super::rows::parts;
use super::{Asked, Explained, Part};
use crate::decide::CLASS;
use crate::evidence::cause::Cause;
use crate::vocabulary::{Effect, Stage};

/// Rivals of a cause that an experiment is to tell it from.
const RIVALS: usize = 2;

fn of_body(cause: &Cause) -> bool {
    let stage = cause.effect.map(Effect::stage);
    stage == Some(Stage::Body) && cause.joints.is_empty()
}

impl Explained {
    /// The parts of a patch that the causes `members` give.
    fn parts_of(&self, members: &[usize]) -> Vec<(usize, Vec<Part>)> {
        let posterior = self.problem().posterior(members);
        let one = |(m, first): (&usize, &usize)| {
            let cause = &self.causes[*m];
            let values = self.values(cause, &posterior, *first, 0.0);
            let own = cause.effect.map(|e| parts(e, &cause.joints, &values));
            (*m, own.unwrap_or_default())
        };
        members.iter().zip(&posterior.first).map(one).collect()
    }

    /// The model with the causes `members`, what one of them is called and its values.
    fn explanation(&self, members: &[usize], of: usize, model: &Model) -> Option<Explanation> {
        let all = self.parts_of(members);
        let own = all.iter().find(|p| p.0 == of)?.1.first()?;
        let each = all.iter().flat_map(|p| &p.1);
        Some(Explanation {
            effect: own.0,
            parameters: own.2.clone(),
            model: patched(model, each.map(|(e, k, v)| (*e, *k, v)), "gap report"),
        })
    }

    /// Explanations of the strongest cause that the data cannot tell apart, where the body alone holds them.
    fn class(&self, model: &Model) -> Option<Vec<Explanation>> {
        let members = &self.found.best.members;
        let open = |i: &usize| self.found.rivals[*i].iter().any(|r| r.margin <= CLASS);
        let at = (0..members.len())
            .filter(open)
            .max_by(|a, b| self.found.gains[*a].total_cmp(&self.found.gains[*b]))?;
        let own = members[at];
        let mut others: Vec<usize> = Vec::new();
        for rival in self.found.rivals[at].iter().filter(|r| r.margin <= CLASS) {
            let effect = self.causes[rival.cause].effect;
            let seen = others
                .iter()
                .chain([&own])
                .any(|o| self.causes[*o].effect == effect);
            if !seen && others.len() < RIVALS {
                others.push(rival.cause);
            }
        }
        if !others
            .iter()
            .chain([&own])
            .all(|c| of_body(&self.causes[*c]))
        {
            return None;
        }
        let exchanged = |c: &usize| {
            let mut set = members.clone();
            set[at] = *c;
            self.explanation(&set, *c, model)
        };
        let all: Vec<Explanation> = [own].iter().chain(&others).filter_map(exchanged).collect();
        (all.len() > 1).then_some(all)
    }

    /// What a further experiment on the ground should decide; `None` where nothing is open about the body. Of windows that
    /// leave too much, `worst` is the gait with its cost.
    pub(super) fn open(&self, asked: &Asked<'_>, worst: Option<(usize, f64)>) -> Option<Open> {
        let class = self.class(asked.model).map(Open::Class);
        let remainder = || {
            let left = self.left(asked.calibration);
            let body = left.first().is_some_and(|l| l.stage == Stage::Body.name());
            let (gait, cost) = worst.filter(|_| body)?;
            Some(Open::Remainder { gait, cost })
        };
        class.or_else(remainder)
    }
}
