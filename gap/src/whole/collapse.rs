//! Limits that whole runs refute.
//!
//! Along the measured angles a joint whose set-points come late or never is held back as by a limit of its torque. Where an echo or a torque was recorded they tell the two
//! apart. Without them whole runs do: a robot with such a limit carries its weight with it from the first step on, and comes down where the robot on the floor did not.

use std::sync::Arc;

use files::model::Model;
use physics::Params;

use super::joints::Found;
use super::patch::patched;
use super::search::Answer;
use super::{Parts, last_word, predict};
use crate::math;
use crate::verdict::{EffectRow, Verdict};
use crate::vocabulary::Effect;

/// Times the error of whole runs without a limit that one is none with: right limits made runs up to 2.2 times worse, lost set-points that looked like one 3.2 times and
/// more.
const COLLAPSED: f64 = 2.5;

const fn limits(effect: Effect) -> bool {
    matches!(effect, Effect::TorqueLimit | Effect::CurrentLimit)
}

/// Whether neither echo nor torque was recorded of a joint.
fn silent(d: &Parts, f: &Found) -> bool {
    d.conventions.echo[f.tier.joint].late_s.is_none() && !f.tier.torque
}

/// A limit, or what is none once it is gone, by its place among the effects found.
fn none(answer: &Answer) -> Option<usize> {
    let last = answer.last();
    let of = |m: &usize| {
        let own = &answer.candidates[*m];
        let off = |i: &usize| (last.theta[*i] - answer.nominal[*i]).abs();
        limits(own.effect) || own.free.iter().all(|i| off(i) <= 1.96 * last.spread[*i])
    };
    last.members.iter().position(of)
}

/// Takes limits away with which `runs` are foretold far worse than without, of joints that show neither echo nor torque: their set-points come otherwise than they were
/// sent. Whether one went.
pub(super) fn refuted(d: &mut Parts, verdict: &Verdict, model: &Model, runs: &[usize]) -> bool {
    let held = |f: &Found| {
        let row = |r: &&EffectRow| limits(r.effect) && r.joint == Some(f.tier.joint);
        silent(d, f) && verdict.effects.iter().any(|r| row(&r))
    };
    let held: Vec<usize> = (0..d.joints.len())
        .filter(|k| held(&d.joints[*k]))
        .collect();
    if held.is_empty() {
        return false;
    }
    let error_m = |rows: &[EffectRow]| {
        let params = Params::try_from(&patched(model, rows)).ok().map(Arc::new)?;
        let errors = predict::errors(&d.data, runs, &params);
        let far: Vec<f64> = errors.iter().map(|e| e[0]).collect();
        (!far.is_empty()).then(|| math::mean(&far))
    };
    let Some(with) = error_m(&verdict.effects) else {
        return false;
    };
    let collapsed = |at: &usize| {
        let joint = Some(d.joints[*at].tier.joint);
        let mut rows = verdict.effects.clone();
        rows.retain(|r| !(limits(r.effect) && r.joint == joint));
        error_m(&rows).is_some_and(|without| with > COLLAPSED * without)
    };
    let gone: Vec<usize> = held.into_iter().filter(collapsed).collect();
    if gone.is_empty() {
        return false;
    }
    for at in &gone {
        let f = &mut d.joints[*at];
        while let Some(m) = none(&f.answer) {
            let without = f.answer.removed_alone[m].0.clone();
            f.answer.drop_member(m, without);
        }
        f.look();
        f.late = true;
    }
    last_word::mark(&mut d.joints, d.body.is_some());
    true
}
