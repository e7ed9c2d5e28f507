//! What is changed about a joint's answer when the search is over.

use super::joints::Tier;
use super::search::{Answer, Coordinate, Fit};
use super::servo::{J, JointRun};

/// The first effect whose interval holds the value at which it is none, by its place among those found, and the fit without it.
pub(super) fn doubted(answer: &Answer, coordinates: &[Coordinate]) -> Option<(usize, Fit)> {
    let last = answer.last();
    let none = |i: &usize| {
        let off = (last.theta[*i] - coordinates[*i].neutral).abs();
        off <= 1.96 * last.spread[*i]
    };
    let doubted = |m: &usize| answer.candidates[*m].free.iter().all(none);
    let at = last.members.iter().position(doubted)?;
    Some((at, answer.removed_alone[at].0.clone()))
}

/// A torque limit that was found, as the measured torque itself shows it: what a joint does beyond its limit hangs on its surroundings, which
/// a joint by itself does not know.
pub(super) fn limited(mut answer: Answer, tier: &Tier) -> Answer {
    let free = J::MaxTorque as usize;
    let last = answer.last();
    let found = last
        .members
        .iter()
        .any(|m| answer.candidates[*m].free.contains(&free));
    let fitted = last.theta[free] * tier.nominal.max_torque_nm;
    let per_ampere = last.theta[J::PerAmpere as usize];
    let shown =
        JointRun::plateau_nm(&tier.runs).map(|p| p * if tier.ampere { per_ampere } else { 1.0 });
    // The fit knows the limit to a factor; another plateau is something else.
    if let Some(nm) = shown.filter(|nm| found && (0.5..2.0).contains(&(nm / fitted))) {
        let at = answer.steps.len() - 1;
        answer.steps[at].theta[free] = nm / tier.nominal.max_torque_nm;
    }
    answer
}
