//! Limits, plays and springs that whole runs refute.
//!
//! Along the measured angles a joint whose set-points come late or never is held back as by a limit of its torque. Where an echo or a torque was recorded they tell the two
//! apart. Without them whole runs do: a robot with such a limit carries its weight with it from the first step on, and comes down where the robot on the floor did not.
//!
//! Windows are led along the measured angles and leave somewhat less with a small play or spring that the robot has not. Whole runs are led by the set-points, and go
//! elsewhere with it.

use files::model::Model;

use super::joints::Found;
use super::patch::parts;
use super::predict::Runs;
use super::score::Score;
use super::search::Answer;
use super::{Parts, last_word};
use crate::math;
use crate::verdict::{EffectRow, Verdict};
use crate::vocabulary::Effect;

/// Times the error of whole runs without a limit that one is none with: right limits made runs up to 2.2 times worse, lost set-points that looked like one 3.2 times and
/// more. Where echo and torque are recorded right ones made runs 0.1 to 0.8 times as wrong, a clock's skew and a zero that must not be named 1.5 to 4.8 times.
const COLLAPSED: f64 = 2.5;

/// Times the error of whole runs without a play or a spring that one is none with, unless windows of these runs end so much nearer with it.
/// Right ones made runs 0.2 to 0.95 times as wrong, one 1.26 times with windows 0.44 times. False ones made them 1.2 to 1.5 times with windows 0.83
/// to 0.99 times, one 0.83 times (16 of the one and 4 of the other, emulated robots of six suites).
const STRAYED: f64 = 1.1;
const NEARER: f64 = 0.7;

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

/// Whether an effect gives between a reading and a link, or between two modules.
pub(super) const fn gives(effect: Effect) -> bool {
    matches!(
        effect,
        Effect::Backlash | Effect::Compliance | Effect::ConnectorPlay | Effect::ConnectorCompliance
    )
}

/// Whether whole runs strayed with an effect that windows do not bear out, from the errors [without it, with it] of both, m.
fn strayed(runs_m: [f64; 2], windows_m: [f64; 2]) -> bool {
    let over = |[without, with]: [f64; 2], times: f64| with > times * without;
    over(runs_m, STRAYED) && over(windows_m, NEARER)
}

/// Takes away what the scored `runs` refute when they are simulated whole. Whether something went.
pub(super) fn refuted(
    d: &mut Parts,
    verdict: &Verdict,
    model: &Model,
    (score, runs): (&Score, &[usize]),
) -> bool {
    let whole = Runs { model, runs };
    limited(d, verdict, &whole) || given(d, verdict, &whole, score)
}

/// Takes a play or a spring away with which whole runs stray.
fn given(d: &mut Parts, verdict: &Verdict, whole: &Runs<'_>, score: &Score) -> bool {
    let (Some(found), Some(tier)) = (&mut d.body, &score.body) else {
        return false;
    };
    let end_m = |theta: &[f64]| {
        let ends: Vec<f64> = tier.errors(theta).iter().map(|e| e[0]).collect();
        math::mean(&ends)
    };
    let held = |m: &usize| {
        let own = &found.answer.candidates[*m];
        let named = |r: &&EffectRow| (r.effect, r.joint) == (own.effect, own.joint);
        let row = verdict.effects.iter().find(named)?;
        gives(row.effect).then_some((row.effect, row.joint))
    };
    let gone = |(at, m): (usize, &usize)| {
        let effect = held(m)?;
        let mut rows = verdict.effects.clone();
        rows.retain(|r| (r.effect, r.joint) != effect);
        let error_m = |rows: &[EffectRow]| whole.error_m(&d.data, parts(rows));
        let runs_m = [error_m(&rows)?, error_m(&verdict.effects)?];
        let (last, without) = (found.answer.last(), &found.answer.removed_alone[at].0);
        let windows_m = [&without.theta, &last.theta].map(|theta| end_m(theta));
        strayed(runs_m, windows_m).then(|| (at, without.clone()))
    };
    let members = found.answer.last().members.iter();
    let Some((at, without)) = members.enumerate().find_map(gone) else {
        return false;
    };
    found.answer.drop_member(at, without);
    found.weigh_rest(d.data.filmed());
    true
}

/// Takes limits away with which whole runs are foretold far worse than without. Set-points of a joint that shows neither echo nor torque come otherwise than they
/// were sent then; any other joint keeps what its limit bent to. Whether one went.
fn limited(d: &mut Parts, verdict: &Verdict, whole: &Runs<'_>) -> bool {
    let held = |f: &Found| {
        let row = |r: &&EffectRow| limits(r.effect) && r.joint == Some(f.tier.joint);
        verdict.effects.iter().any(|r| row(&r))
    };
    let held: Vec<usize> = (0..d.joints.len())
        .filter(|k| held(&d.joints[*k]))
        .collect();
    if held.is_empty() {
        return false;
    }
    let Some(with) = whole.error_m(&d.data, parts(&verdict.effects)) else {
        return false;
    };
    let collapsed = |at: &usize| {
        let joint = Some(d.joints[*at].tier.joint);
        let mut rows = verdict.effects.clone();
        rows.retain(|r| !(limits(r.effect) && r.joint == joint));
        let without = whole.error_m(&d.data, parts(&rows));
        without.is_some_and(|without| with > COLLAPSED * without)
    };
    let gone: Vec<usize> = held.into_iter().filter(collapsed).collect();
    if gone.is_empty() {
        return false;
    }
    for at in &gone {
        let silent = silent(d, &d.joints[*at]);
        let f = &mut d.joints[*at];
        while let Some(m) = none(&f.answer) {
            let without = f.answer.removed_alone[m].0.clone();
            f.answer.drop_member(m, without);
        }
        f.look();
        if silent {
            f.late = true;
        } else {
            f.refuted = true;
        }
    }
    last_word::mark(&mut d.joints, d.body.is_some());
    true
}

#[cfg(test)]
mod tests {
    use super::strayed;

    #[test]
    fn a_play_that_leads_whole_runs_astray_is_none_unless_windows_bear_it_out() {
        for (what, runs_m, windows_m, none) in [
            ("nearer", [0.10, 0.07], [5e-3, 5e-3], false),
            ("as far", [0.10, 0.105], [5e-3, 5e-3], false),
            ("further", [0.10, 0.12], [5.5e-3, 5.4e-3], true),
            (
                "further, windows end far nearer",
                [0.10, 0.126],
                [5.5e-3, 2.4e-3],
                false,
            ),
        ] {
            assert_eq!(strayed(runs_m, windows_m), none, "{what}");
        }
    }
}
