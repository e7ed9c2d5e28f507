//! Runs to which sizes are fitted, and runs on which they are compared.

use files::dataset::{Manifest, Recording, Role};

use super::BenchError;
use crate::joint::Problem;

/// A data set in two parts.
pub(super) struct Split {
    /// Runs that are fitted, by their numbers in the whole.
    fit: Vec<usize>,
    /// Runs that are scored.
    pub(super) score: Vec<usize>,
    /// How they were chosen.
    pub(super) how: &'static str,
}

/// Every third of the groups, beginning with the third.
fn every_third(group: impl Fn(&usize) -> usize, usable: Vec<usize>) -> (Vec<usize>, Vec<usize>) {
    let mut groups: Vec<usize> = usable.iter().map(&group).collect();
    groups.sort_unstable();
    groups.dedup();
    let held = |r: &usize| groups.binary_search(&group(r)).is_ok_and(|i| i % 3 == 2);
    usable.into_iter().partition(|r| !held(r))
}

fn parts(problem: &Problem) -> (Vec<usize>, Vec<usize>, &'static str) {
    let measured = |r: &usize| {
        let run = &problem.runs[*r];
        let row = |s: &crate::joint::Sample| s.enabled && s.measured[0].is_finite();
        run.samples.iter().any(row)
    };
    let usable: Vec<usize> = (0..problem.runs.len()).filter(measured).collect();
    let role = |r: &usize| problem.runs[*r].role == Some(Role::Check);
    if usable.iter().any(role) {
        let (score, fit) = usable.into_iter().partition(role);
        return (fit, score, "roles of the data set");
    }
    let gait = |r: &usize| problem.runs[*r].gait;
    let (fit, score) = every_third(gait, usable.clone());
    if !score.is_empty() {
        return (fit, score, "every third gait held out");
    }
    let (fit, score) = every_third(|r| *r, usable.clone());
    if !score.is_empty() {
        return (
            fit,
            score,
            "every third run held out: fewer than three gaits",
        );
    }
    (
        usable.clone(),
        usable,
        "nothing held out: fewer than three runs",
    )
}

impl Split {
    pub(super) fn new(problem: &Problem) -> Result<Self, BenchError> {
        let (fit, score, how) = parts(problem);
        if fit.is_empty() {
            return Err(BenchError::NoFitRuns);
        }
        Ok(Self { fit, score, how })
    }

    /// What is fitted, of a data set.
    pub(super) fn fitted(
        &self,
        manifest: &Manifest,
        recordings: &[Recording],
    ) -> (Manifest, Vec<Recording>) {
        let own = self.fit.iter();
        let manifest = Manifest {
            runs: own.clone().map(|r| manifest.runs[*r].clone()).collect(),
            ..manifest.clone()
        };
        (manifest, own.map(|r| recordings[*r].clone()).collect())
    }
}
