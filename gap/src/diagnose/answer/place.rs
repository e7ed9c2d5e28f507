//! Where: shares of the stages, and a suspect for what no effect explains.

use super::drift;
use super::word::{REMAINDER, remainder};
use crate::candidates;
use crate::diagnose::{Diagnosis, Settings};
use crate::joint::{Channel, P, Params, Trace, simulate};
use crate::regimes::RegimeRow;
use crate::verdict::{Where, Word};
use crate::vocabulary::{Effect, Stage};
use crate::{interface, locate};

/// Errors of the nominal and of the final model by regime of the motion, on the scored runs.
pub(super) fn regimes(d: &Diagnosis) -> Vec<RegimeRow> {
    let first = (&d.nominal, d.ideal);
    locate::regimes(&d.problem, &d.score_runs, first, &d.selection.model.params)
}

pub(super) fn places(d: &Diagnosis, word: Word, settings: &Settings) -> Vec<Where> {
    let floor = if d.floor.repeat.is_some() {
        d.floor.of(0)
    } else {
        0.0
    };
    let end = &d.selection.model;
    let shares = locate::shares(
        &d.problem,
        &d.score_runs,
        &d.nominal,
        d.ideal,
        end,
        floor,
        settings.seed,
    );
    let regime = locate::regime(&d.problem, &d.score_runs, &d.nominal, d.ideal, &end.params);
    let mut rows: Vec<Where> = shares
        .into_iter()
        .filter(|s| s.share > 0.0 || s.stage.is_none())
        .map(|s| Where {
            stage: s.stage.map_or("unexplained", Stage::name).into(),
            joint: if s.stage == Some(Stage::Supply) {
                None
            } else {
                Some(d.problem.joint)
            },
            regime: regime.into(),
            share: s.share,
            ci95: s.ci95,
        })
        .collect();
    if remainder(d, settings) > REMAINDER {
        let before = before_driver(d);
        if !measured_places(d, &mut rows, regime, word, settings) && d.selection.found.is_empty() {
            suspect(d, &mut rows, regime, before);
        }
        if let Some(Some(stage)) = before {
            blame(d, &mut rows, stage, 0.9, regime);
        }
    }
    if word == Word::Unknown && drift::drifts(d) {
        blame(d, &mut rows, Stage::Conventions, drift::share(d), regime);
    }
    rows.sort_by(|a, b| b.share.total_cmp(&a.share));
    rows
}

/// Places what nothing explains by the laws that the measured signals break (see [`crate::interface`]). With nothing found the
/// calibration only bends to what it cannot explain, and the whole gap is placed so; where the word is unknown the effects found
/// only imitate it too. A zero between mechanics and encoder is an exception: no law of a stage shows it. `false` where the
/// signals cannot tell.
fn measured_places(
    d: &Diagnosis,
    rows: &mut Vec<Where>,
    regime: &str,
    word: Word,
    settings: &Settings,
) -> bool {
    let mut moved = d.selection.found.iter().flat_map(|f| &f.candidate.free);
    let zero = moved.any(|f| f.p == P::MechOffset);
    let bare = d.selection.found.is_empty() || (word == Word::Unknown && !zero);
    let model = if bare {
        &d.nominal
    } else {
        &d.selection.model.params
    };
    let told = interface::shares(
        &d.problem,
        &d.score_runs,
        model,
        d.independent,
        settings.seed,
    );
    let Some(told) = told.filter(|_| !d.ideal) else {
        return false;
    };
    let rest = if bare {
        rows.clear();
        1.0
    } else {
        let unexplained = rows.iter().filter(|r| r.stage == "unexplained");
        unexplained.map(|r| r.share).sum()
    };
    rows.retain(|r| r.stage != "unexplained");
    // What the strongest stage does not hold is in doubt.
    let doubt = 0.5 * (1.0 - told.first().map_or(0.0, |s| s.share));
    for s in &told {
        let name = s.stage.map_or("unexplained", Stage::name);
        let part = rest * (1.0 - doubt);
        match rows.iter_mut().find(|r| r.stage == name) {
            Some(r) => r.share += part * s.share,
            None => rows.push(Where {
                stage: name.into(),
                joint: (s.stage != Some(Stage::Supply)).then_some(d.problem.joint),
                regime: regime.into(),
                share: part * s.share,
                ci95: s.ci95.map(|x| part * x),
            }),
        }
    }
    rows.push(Where {
        stage: "unexplained".into(),
        joint: Some(d.problem.joint),
        regime: regime.into(),
        share: rest * doubt,
        ci95: [0.0, rest],
    });
    true
}

/// What the driver's echo says of a remainder: it arose before the driver, and in which stage; `Some(None)` if the
/// set-points arrived as the model has them, `None` without an echo. Where they arrived as stated, an effect on their way that
/// the model holds only imitates another.
fn before_driver(d: &Diagnosis) -> Option<Option<Stage>> {
    if !candidates::measured(&d.problem, Channel::Applied) {
        return None;
    }
    let stated = if d.ideal {
        None
    } else {
        Some(echo(d, &d.nominal))
    };
    Some(match stated {
        Some(None) => None,
        _ => echo(d, &d.selection.model.params),
    })
}

/// The stage before the driver in which the echo differs from what `params` makes of the set-points.
fn echo(d: &Diagnosis, params: &Params) -> Option<Stage> {
    let c = Channel::Applied as usize;
    let weight = d.floor.weights()[c];
    let (mut n, mut x, mut y, mut xx, mut xy, mut yy, mut error) =
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for r in &d.score_runs {
        let run = &d.problem.runs[*r];
        let mut trace = Trace::new();
        simulate(run, params, d.problem.dt_s, &mut trace);
        for (s, model) in run.samples.iter().zip(&trace).filter(|(s, _)| s.enabled) {
            let (a, b) = (model[c] * weight, s.measured[c] * weight);
            if b.is_finite() {
                (n, x, y, xx, xy, yy) = (n + 1.0, x + a, y + b, xx + a * a, xy + a * b, yy + b * b);
                error += (a - b) * (a - b);
            }
        }
    }
    let floor = d.floor.of(c) * weight;
    if n < 2.0 || error / n < ECHOED + 4.0 * floor * floor {
        return None;
    }
    // Another scale, sign or zero is a straight line through all instants; what comes late or never is not.
    let (sxx, sxy, syy) = (xx - x * x / n, xy - x * y / n, yy - y * y / n);
    let left = syy - sxy * sxy / sxx.max(1e-300);
    Some(if left < STRAIGHT * error {
        Stage::Conventions
    } else {
        Stage::Transport
    })
}

/// Mean square error of an echo, in tolerances, up to which it is the set-point that the model has: a tenth of one.
const ECHOED: f64 = 0.01;

/// Share of an echo's error that a straight line may leave for the error to be one of convention.
const STRAIGHT: f64 = 0.2;

/// Without an effect in the model the stages of the model say nothing of the place: the stage of the candidate that came
/// nearest to being believed takes what it gained.
fn suspect(d: &Diagnosis, rows: &mut Vec<Where>, regime: &str, before: Option<Option<Stage>>) {
    // What the echo rules out is no suspect; a zero of the mechanics it cannot see.
    let early = |e: Effect| {
        e.stage() == Stage::Transport
            || (e.stage() == Stage::Conventions && e != Effect::JointOffset)
    };
    let innocent = |e: Effect| before == Some(None) && early(e);
    let gains = d
        .selection
        .considered
        .iter()
        .filter(|c| c.step == 0 && !innocent(c.effect));
    let Some(best) = gains.max_by(|a, b| a.gain.total_cmp(&b.gain)) else {
        return;
    };
    let share = ((best.before - best.after) / best.before.max(1e-12)).clamp(0.05, 0.95);
    blame(d, rows, best.effect.stage(), share, regime);
}

/// Gives `share` of the gap to `stage`.
fn blame(d: &Diagnosis, rows: &mut Vec<Where>, stage: Stage, share: f64, regime: &str) {
    rows.iter_mut().for_each(|r| r.share *= 0.5 * (1.0 - share));
    rows.retain(|r| r.stage != "unexplained");
    let kept: f64 = rows.iter().map(|r| r.share).sum();
    let row = |stage: &str, share: f64| Where {
        stage: stage.into(),
        joint: Some(d.problem.joint),
        regime: regime.into(),
        share,
        ci95: [0.0, 1.0],
    };
    match rows.iter_mut().find(|r| r.stage == stage.name()) {
        Some(r) => r.share += share,
        None => rows.push(row(stage.name(), share)),
    }
    rows.push(row("unexplained", 1.0 - share - kept));
}
