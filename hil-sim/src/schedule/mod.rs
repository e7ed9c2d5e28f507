//! Seeded schedules of the whole chain: firmware application, drivers, both wires, flash and hosts in one thread
//! on a virtual clock, and the laws that
//! hold whatever strikes.
//!
//! A [`Plan`] follows from a seed. [`play`] runs it and looks at the laws ([`Law`]) after each step of at most 5
//! ms and at every packet that the module
//! sends. Nothing reads a clock or shares a random stream, so equal seeds give equal traces on any number of
//! threads. [`shrink`] takes faults and time
//! away from a failing schedule while it still breaks the same law.
//!
//! The firmware is the same code as on the board. Its processor is not: a restart strikes between two polls of its
//! tasks, not between two
//! instructions, and the flash fails at any of its erase and program operations.

mod channel;
mod desk;
mod fault;
mod gaits;
mod laws;
mod many;
mod plan;
mod reading;
mod script;
mod stage;
mod table;
mod wire;

pub use fault::{BadFaults, Fault, KINDS, Kind};
pub use laws::{Counts, Law, Violation};
pub use many::{Failure, Summary, many};
pub use plan::{Cut, Plan};
pub use stage::{Outcome, play};
pub use table::{LOSSES, Row, table};

/// Shrinking ends when the time is known this closely, us.
const SHORT_US: u64 = 20_000;

/// Shortens a failing schedule: as few faults and as short a time as still break the same law.
#[must_use]
pub fn shrink(seed: u64, cut: &Cut, law: Law) -> Cut {
    shrink_while(seed, cut, |cut| {
        let outcome = play(&Plan::with(seed, cut));
        outcome.broken.is_some_and(|broken| broken.law == law)
    })
}

/// As few faults and as short a time of a schedule as `breaks` still holds of. It holds of `cut`.
fn shrink_while(seed: u64, cut: &Cut, breaks: impl Fn(&Cut) -> bool) -> Cut {
    let mut best = cut.clone();
    let mut keep = Plan::with(seed, cut).numbers;
    for number in keep.clone() {
        let fewer: Vec<usize> = keep.iter().copied().filter(|n| *n != number).collect();
        let tried = Cut {
            keep: Some(fewer.clone()),
            ..best.clone()
        };
        if breaks(&tried) {
            (keep, best) = (fewer, tried);
        }
    }
    let (mut low_us, mut high_us) = (plan::FROM_US, best.active_us.unwrap_or(plan::ACTIVE_US));
    while high_us - low_us > SHORT_US {
        let active_us = Some(low_us.midpoint(high_us));
        let tried = Cut {
            active_us,
            ..best.clone()
        };
        if breaks(&tried) {
            high_us = low_us.midpoint(high_us);
            best = tried;
        } else {
            low_us = low_us.midpoint(high_us);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    /// Whether a fault of this kind strikes.
    fn strikes(seed: u64, cut: &Cut, kind: Kind) -> bool {
        let faults = Plan::with(seed, cut).faults;
        faults
            .iter()
            .any(|fault| fault.kind == kind && fault.to_us > fault.from_us)
    }

    #[test]
    fn what_one_kind_of_fault_breaks_shrinks_to_one_fault_and_its_beginning() {
        let mut tried = 0;
        for seed in 0..200 {
            let plan = Plan::of(seed);
            for kind in plan.faults.iter().map(|fault| fault.kind) {
                let asked = Cell::new(0);
                let breaks = |cut: &Cut| {
                    asked.set(asked.get() + 1);
                    strikes(seed, cut, kind)
                };
                let cut = shrink_while(seed, &Cut::default(), breaks);
                let small = Plan::with(seed, &cut);
                let [fault] = small.faults.as_slice() else {
                    panic!("seed {seed}: {small}");
                };
                assert_eq!(fault.kind, kind, "seed {seed}");
                let after_us = small.active_us - fault.from_us;
                assert!(after_us <= SHORT_US, "seed {seed}: {after_us} us");
                assert_eq!(small.faults[0].seed, plan.faults[small.numbers[0]].seed);
                // Each fault once, and nine halves of six seconds.
                assert!(asked.get() <= plan.faults.len() + 9, "seed {seed}");
                let again = shrink_while(seed, &Cut::default(), |cut| strikes(seed, cut, kind));
                assert_eq!(cut, again, "seed {seed}");
                tried += 1;
            }
        }
        assert!(tried > 500, "{tried}");
    }

    #[test]
    fn what_needs_two_faults_keeps_both_and_what_needs_none_keeps_none() {
        let seed = (0..).find(|seed| Plan::of(*seed).faults.len() == 7);
        let seed = seed.expect("one in eight");
        let both = |cut: &Cut| {
            let numbers = Plan::with(seed, cut).numbers;
            numbers.contains(&2) && numbers.contains(&5)
        };
        let cut = shrink_while(seed, &Cut::default(), both);
        assert_eq!(cut.keep, Some(vec![2, 5]));
        let cut = shrink_while(seed, &Cut::default(), |_| true);
        assert_eq!(cut.keep, Some(vec![]));
        assert!(
            cut.active_us
                .is_some_and(|us| us <= plan::FROM_US + SHORT_US)
        );
    }

    #[test]
    fn what_was_cut_before_stays_cut() {
        let seed = (0..).find(|seed| Plan::of(*seed).faults.len() == 7);
        let seed = seed.expect("one in eight");
        let cut = Cut {
            keep: Some(vec![1, 4]),
            active_us: Some(2_000_000),
            ..Cut::default()
        };
        let small = shrink_while(seed, &cut, |cut| {
            Plan::with(seed, cut).active_us >= 1_000_000
                && Plan::with(seed, cut).numbers.contains(&4)
        });
        assert_eq!(small.keep, Some(vec![4]));
        let until_us = small.active_us.expect("shortened");
        assert!((1_000_000..=1_000_000 + SHORT_US).contains(&until_us));
    }
}
