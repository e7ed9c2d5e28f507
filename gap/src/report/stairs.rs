//! How far: the error before, once calibrated, with the causes that were kept, and the floor.

use super::subject::Subject;
use super::words::shown_in;
use crate::sentence::{Cause, causes};
use crate::verdict::Verdict;

/// One step down.
pub(super) struct Step {
    pub(super) name: String,
    /// In the unit of the staircase.
    pub(super) error: f64,
    /// The floor, which no model reaches.
    pub(super) rest: bool,
}

/// Unit, and steps of what was kept only.
pub(super) fn steps(v: &Verdict) -> (&str, Vec<Step>) {
    let g = &v.gap;
    let (factor, unit) = shown_in(&g.unit, g.before.max(g.after));
    let step = |name: &str, error: f64| Step {
        name: name.into(),
        error: factor * error,
        rest: false,
    };
    let mut out = vec![
        step("before", g.before),
        step("known values calibrated", g.after_calibration),
    ];
    let names: Vec<&str> = causes(v).iter().map(Cause::plain).collect();
    match names.as_slice() {
        [] => {}
        [one] => out.push(step(&format!("with {one}"), g.after)),
        _ => {
            // The search adds effects one by one; what it threw out again is no step.
            let kept = v.staircase.iter().filter_map(|s| {
                let row = v.effects.iter().find(|e| e.effect.name() == s.step)?;
                Some((row.effect.plain(), s.gap))
            });
            let kept: Vec<(&str, f64)> = kept.collect();
            let falls = kept.windows(2).all(|w| w[1].1 <= w[0].1)
                && kept
                    .iter()
                    .all(|k| (g.after..=g.after_calibration).contains(&k.1));
            let whole = kept.len() == names.len() && falls;
            match kept.split_last().filter(|_| whole) {
                Some(((name, _), first)) => {
                    out.extend(
                        first
                            .iter()
                            .map(|(name, gap)| step(&format!("with {name}"), *gap)),
                    );
                    out.push(step(&format!("and with {name}"), g.after));
                }
                None => out.push(step(&format!("with all {} causes", names.len()), g.after)),
            }
        }
    }
    out.push(Step {
        rest: true,
        ..step("floor", g.floor)
    });
    (unit, out)
}

/// What the error before is the error of.
pub(super) fn before(subject: &Subject) -> String {
    format!("Before is {}.", subject.before)
}
