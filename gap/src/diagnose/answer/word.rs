//! The one word of the verdict, and how probable it is.

use super::drift::drifts;
use crate::diagnose::{Diagnosis, Settings};
use crate::interface;
use crate::verdict::{Gap, Probabilities, Word};
use crate::vocabulary::Stage;

/// A cost of this many floors is a significant remainder. Nulls reach 1.5, known effects once they are in the model 1.6.
pub(super) const REMAINDER: f64 = 2.2;

/// Cost of the final model over what a model without a gap may have: the floor, and a share of the first cost that two
/// simulators of one law may differ by.
pub(super) fn remainder(d: &Diagnosis, settings: &Settings) -> f64 {
    // A fold that alone shows a constant costs more when it is held out; that is no remainder.
    const OPTIMISM: f64 = 1.1;
    let first = d.selection.first;
    let left = d.selection.held_out.min(OPTIMISM * d.selection.fitted);
    left / (d.floor_cost + settings.options.model_error * first).max(1e-9)
}

/// Share of the first cost above the floor that the effects found take away.
pub(super) fn explained(d: &Diagnosis) -> f64 {
    let first = d.selection.steps.first().map_or(0.0, |s| s.held_out);
    1.0 - (d.selection.held_out - d.floor_cost).max(0.0) / (first - d.floor_cost).max(1e-9)
}

/// Whether the remainder looks like a finer law of an effect that was found. The effect takes nearly all of the gap, it is
/// the only one of its stage, and the remainder sits in that stage as far as signals tell. Two effects of one stage that
/// leave a remainder imitate a law which the library lacks.
fn coarser(d: &Diagnosis, settings: &Settings) -> bool {
    // Share of the excess that a coarser law of the right kind takes. Coulomb friction for friction that varies as much as
    // it can with position takes two thirds.
    const NEARLY_ALL: f64 = 0.88;
    // One effect that takes so much is the right one, wherever the rest sits.
    const ALL_BUT: f64 = 0.99;
    if d.selection.found.len() == 1 && explained(d) >= ALL_BUT {
        return true;
    }
    let stages: Vec<Stage> = (d.selection.found.iter())
        .map(|f| f.candidate.effect.stage())
        .collect();
    let told = interface::shares(
        &d.problem,
        &d.score_runs,
        &d.selection.model.params,
        d.independent,
        settings.seed,
    );
    let place = told.and_then(|t| t.first().and_then(|s| s.stage));
    let place = place.or(match stages.as_slice() {
        [only] => Some(*only),
        _ => None,
    });
    let inside = |s: &Stage| matches!(s, Stage::Drivetrain | Stage::Transmission | Stage::Supply);
    explained(d) >= NEARLY_ALL
        && place.is_some_and(|p| inside(&p) && stages.iter().filter(|s| **s == p).count() == 1)
}

pub(super) fn word(d: &Diagnosis, gap: &Gap, settings: &Settings) -> Word {
    let found = &d.selection.found;
    let left = remainder(d, settings);
    let repeats = d.floor.repeat.is_some();
    match (found.is_empty(), left > REMAINDER) {
        (true, false) => Word::None,
        (true, true) if repeats || gap.shrink < 0.25 => Word::Unknown,
        (true, true) => Word::PartlyExplained,
        (false, _) if drifts(d) => Word::Unknown,
        (false, true)
            if repeats
                && (explained(d) < 0.9 || left > 2.0 * REMAINDER)
                && !coarser(d, settings) =>
        {
            Word::Unknown
        }
        (false, true) => Word::PartlyExplained,
        (false, false) if found.iter().all(|f| f.candidate.effect.is_base()) => Word::Parametric,
        (false, false) => Word::Explained,
    }
}

/// Probabilities of "none" and "unknown". What they leave is the effects'; without effects nothing is left.
pub(super) fn probabilities(d: &Diagnosis, word: Word, settings: &Settings) -> Probabilities {
    let p = borders(d, word, settings);
    if !d.selection.found.is_empty() {
        return p;
    }
    let sum = p.none + p.unknown;
    Probabilities {
        none: p.none / sum,
        unknown: p.unknown / sum,
    }
}

/// Logistic in how far the data is from each border.
fn borders(d: &Diagnosis, word: Word, settings: &Settings) -> Probabilities {
    let logistic = |x: f64| 1.0 / (1.0 + libm::exp(-x));
    // Distances from the two borders, in e-foldings of the cost and of the gain.
    let r = libm::log(remainder(d, settings).max(1e-9) / REMAINDER);
    let least = settings.options.least_evidence;
    let gain = |g: f64| libm::log((d.independent * libm::log1p(g.max(0.0))).max(1e-9) / least);
    match word {
        Word::None => {
            let tried = d.selection.considered.iter().map(|c| c.gain);
            let near = logistic(2.0 * gain(tried.fold(0.0, f64::max)) - 2.0);
            let unknown = 0.3 * logistic(6.0 * r - 1.0);
            Probabilities {
                none: (1.0 - unknown) * (1.0 - 0.5 * near),
                unknown: (1.0 - unknown) * 0.5 * near + unknown,
            }
        }
        Word::Unknown => Probabilities {
            none: 0.01,
            unknown: (0.6 + 0.38 * logistic(4.0 * r - 1.0)).min(0.98),
        },
        _ => {
            let least = d.selection.found.iter().map(|f| f.gain);
            let weak = least.fold(f64::INFINITY, f64::min);
            let none = if d.selection.found.is_empty() {
                0.1
            } else {
                0.3 * logistic(-3.0 * gain(weak) - 0.5) + 0.005
            };
            let unknown = 0.02 + 0.4 * logistic(5.0 * r - 1.0);
            Probabilities { none, unknown }
        }
    }
}
