//! Plays and springs that windows show by half and whole runs bear out.
//!
//! A window is too short for a small play or spring to show much in it. Over a whole run it takes the robot elsewhere, and always to the same side: with the right one in
//! the simulator most gaits end far nearer, with a false one they do not.

use std::collections::BTreeMap;

use files::model::Model;

use super::Parts;
use super::body::Tier;
use super::body_answer::{Found, limits};
use super::body_library::coordinates;
use super::collapse::gives;
use super::found::body_parameters;
use super::intervals::estimates;
use super::patch::{Part, parts};
use super::predict::Runs;
use super::search::{Answer, Coordinate, Fit, Limits, Search};
use super::terms::on_all;
use crate::math;
use crate::verdict::Verdict;
use crate::vocabulary::Stage;

/// Share of the windows' thresholds from which whole runs are asked.
const HALF: f64 = 0.5;
/// Half play, rad, and twist, rad/(N m), from which a fit starts: smaller ones than the search starts from.
const SMALL: f64 = 0.008;
/// Share of its size by which such a play or spring may be off (1 sigma): three planted ones were by 0.19 to 0.5. Whole runs do not tell: from half to twice the size they
/// end as near.
const COARSE: f64 = 0.3;
/// Mean logarithm of the whole runs' error with a play or spring over that without, below which they bear it out, and the same over its
/// standard error. Planted ones: -0.26 to -0.60, 2.1 to 3.1 standard errors. What windows of 59 robots without a cause show a quarter of:
/// -0.16 to 0.70, 0.9 at most; false ones beside true ones: -0.20, 1.9 (emulated robots that walk all seventeen gaits).
const NEARER: f64 = -0.22;
const SURE: f64 = -2.0;
/// Fewest gaits that can bear anything out.
const GAITS: usize = 8;

/// Names the play or spring, if any, that windows show by half and the whole `runs`, those that were fitted, bear out. Whether there is one.
pub(super) fn borne_out(d: &mut Parts, verdict: &Verdict, model: &Model, runs: &[usize]) -> bool {
    let Some(found) = d.body.as_ref().filter(|f| telling(d, f)) else {
        return false;
    };
    let half_shown = half_shown(found);
    if half_shown.is_empty() {
        return false;
    }
    let whole = Runs { model, runs };
    let before = whole.by_gait_m(&d.data, parts(&verdict.effects));
    let borne = |fit: Fit| {
        let own = &found.answer.candidates[*fit.members.last()?];
        let parameters = body_parameters(own.effect, own.joint, d.friction);
        let values = estimates(&parameters, &own.free, &fit);
        let part: Part<'_> = (own.effect, own.joint, &values);
        let with = parts(&verdict.effects).chain([part]);
        let nearer = nearer(&before, &whole.by_gait_m(&d.data, with))?;
        Some((nearer, fit))
    };
    let all = half_shown.into_iter().filter_map(borne);
    let Some((_, fit)) = all.min_by(|a, b| a.0.total_cmp(&b.0)) else {
        return false;
    };
    let answer = with(found, &fit);
    // What a rival explains better is not what whole runs were asked about.
    if answer.last().members != fit.members {
        return false;
    }
    if let Some(found) = &mut d.body {
        found.answer = answer;
        found.weigh_rest(d.data.filmed());
    }
    true
}

/// Whether whole runs can tell: from starts that are exact, on contacts that the simulator knows, with no number that was read off elsewhere.
fn telling(d: &Parts, found: &Found) -> bool {
    let told = d.direct.iter().any(|r| r.effect.stage() == Stage::Body);
    !d.data.filmed() && found.tier.exact() && found.changes.is_none() && !told
}

/// The search with thresholds times `share`.
fn search<'a>(found: &'a Found, of: &'a [Coordinate], share: f64) -> Search<'a, Tier> {
    let told = limits(&found.tier);
    Search {
        model: &found.tier,
        coordinates: of,
        candidates: &found.answer.candidates,
        limits: Limits {
            share: share * told.share,
            least: share * told.least,
            relative: share * told.relative,
            of_first: share * told.of_first,
            ..told
        },
    }
}

/// What was found with each play or spring besides that windows show by half, on every gait.
fn half_shown(found: &Found) -> Vec<Fit> {
    let coordinates = coordinates(&found.tier.model);
    let search = search(found, &coordinates, HALF);
    let candidates = &found.answer.candidates;
    let last = found.answer.last();
    let base = search.fit(&last.theta, &last.members, search.limits.iterations);
    let least = search.threshold(&base);
    let open = |c: &usize| {
        let own = &candidates[*c];
        let freed = |m: &usize| candidates[*m].free.iter().any(|i| own.free.contains(i));
        gives(own.effect) && !base.members.iter().any(freed)
    };
    let shown = |c: usize| {
        let mut theta = base.theta.clone();
        for i in &candidates[c].free {
            theta[*i] = SMALL;
        }
        let members = [base.members.as_slice(), &[c]].concat();
        let mut fit = search.fit(&theta, &members, search.limits.iterations);
        let gains = search.told(&base) - search.told(&fit) >= least && on_all(&base, &fit);
        let shown = gains && search.significant(&fit, c);
        for i in &candidates[c].free {
            fit.spread[*i] = libm::hypot(fit.spread[*i], COARSE * fit.theta[*i]);
        }
        shown.then_some(fit)
    };
    (0..candidates.len())
        .filter(open)
        .filter_map(shown)
        .collect()
}

/// The answer that ends with `fit`.
fn with(found: &Found, fit: &Fit) -> Answer {
    let coordinates = coordinates(&found.tier.model);
    let own = &found.answer;
    let mut steps = own.steps.clone();
    steps.push(fit.clone());
    search(found, &coordinates, 1.0).summed_up((steps, own.nearest), &own.nominal, &[])
}

/// Mean logarithm of the errors `after` over those `before`, by gait, where most are so much nearer that it is no chance.
fn nearer(before: &BTreeMap<usize, f64>, after: &BTreeMap<usize, f64>) -> Option<f64> {
    let both = |(gait, b): (&usize, &f64)| Some(libm::log(after.get(gait)? / b));
    let logs: Vec<f64> = before.iter().filter_map(both).collect();
    if logs.len() < GAITS {
        return None;
    }
    let mean = math::mean(&logs);
    let apart: Vec<f64> = logs.iter().map(|l| l - mean).collect();
    let error = math::rms(&apart) / (logs.len() as f64 - 1.0).sqrt();
    (mean <= NEARER && mean <= SURE * error).then_some(mean)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::nearer;

    #[test]
    fn whole_runs_bear_out_what_brings_most_gaits_far_nearer() {
        let before: BTreeMap<usize, f64> = (0..12).map(|g| (g, 0.05)).collect();
        for (what, ratios, gaits, borne) in [
            ("all by a third", [0.67, 0.67, 0.67], 12, true),
            (
                "two of three by half, one further by a sixth",
                [0.5, 0.5, 1.17],
                12,
                true,
            ),
            ("all by a tenth", [0.9, 0.9, 0.9], 12, false),
            ("as many further as nearer", [0.3, 3.0, 1.0], 12, false),
            (
                "some far nearer, most a little further",
                [0.05, 1.5, 1.5],
                12,
                false,
            ),
            ("all by a third, of few gaits", [0.67, 0.67, 0.67], 6, false),
        ] {
            let after = |(g, e): (&usize, &f64)| (*g, e * ratios[*g % 3]);
            let after: BTreeMap<usize, f64> = before.iter().take(gaits).map(after).collect();
            assert_eq!(nearer(&before, &after).is_some(), borne, "{what}");
        }
    }
}
