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

/// Shortens a failing schedule: as few faults and as short a time as still break the same law.
#[must_use]
pub fn shrink(seed: u64, cut: &Cut, law: Law) -> Cut {
    let breaks = |cut: &Cut| {
        let outcome = play(&Plan::with(seed, cut));
        outcome.broken.is_some_and(|broken| broken.law == law)
    };
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
    while high_us - low_us > 20_000 {
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
