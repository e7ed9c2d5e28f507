//! What joints without a cause differ by.

use std::collections::BTreeMap;

use crate::decide::LEAST;
use crate::evidence::block::White;
use crate::evidence::ensemble::Spreads;

/// What joints differ by: those whose controllers put out the same by themselves.
#[derive(Debug, Clone, PartialEq)]
pub struct Differ {
    /// All of them.
    pub all: Spreads,
    /// By what the controller puts out, where enough do that.
    pub drives: BTreeMap<String, Spreads>,
}

/// Blocks of each joint of a group.
type Group = Vec<Vec<White>>;

/// Blocks of all joints, and of those with each drive; of number `i` only if `of(i)`.
fn groups(
    joints: &[(&str, Vec<White>)],
    of: &dyn Fn(usize) -> bool,
) -> (Group, BTreeMap<String, Group>) {
    let (mut all, mut drives) = (Group::new(), BTreeMap::<String, Group>::new());
    for (_, (drive, blocks)) in joints.iter().enumerate().filter(|(i, _)| of(*i)) {
        all.push(blocks.clone());
        let own = drives.entry((*drive).to_owned()).or_default();
        own.push(blocks.clone());
    }
    (all, drives)
}

impl Differ {
    /// Learned from the block of each joint ([`super::null_block`]) and what its controller puts out ([`super::drive`]).
    #[must_use]
    pub fn learned(joints: &[(&str, Vec<White>)]) -> Self {
        let (all, drives) = groups(joints, &|_| true);
        let enough = drives.into_iter().filter(|own| own.1.len() >= LEAST);
        Self {
            all: Spreads::learned(&all),
            drives: enough.map(|(d, own)| (d, Spreads::learned(&own))).collect(),
        }
    }

    /// What the joints of all folds but one show: a healthy joint is weighed as one that nothing was learned from.
    #[must_use]
    pub fn without_fold(&self, joints: &[(&str, Vec<White>)], fold: usize, folds: usize) -> Self {
        let (all, others) = groups(joints, &|i| i % folds != fold);
        let none = Group::new();
        let own = self.drives.iter();
        Self {
            all: self.all.of_most(&all),
            drives: own
                .map(|(d, s)| (d.clone(), s.of_most(others.get(d).unwrap_or(&none))))
                .collect(),
        }
    }

    /// Of joints with a drive.
    #[must_use]
    pub fn of(&self, drive: &str) -> &Spreads {
        self.drives.get(drive).unwrap_or(&self.all)
    }
}
