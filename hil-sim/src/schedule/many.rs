//! Many schedules on many threads. The sum does not depend on their number.

use super::fault::KINDS;
use super::laws::{Counts, Law, Violation};
use super::plan::{Cut, Plan};
use super::stage::{Outcome, play};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// A schedule in which a law did not hold.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// Its seed.
    pub seed: u64,
    /// What was seen; `None` = the code panicked.
    pub broken: Option<Violation>,
}

/// What many schedules came to.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Summary {
    /// Schedules played.
    pub schedules: u64,
    /// Virtual time, us.
    pub virtual_us: u64,
    /// Sum of the hashes of the traces, each with its seed.
    pub trace: u64,
    /// Faults that struck, by kind.
    pub struck: [u64; KINDS],
    /// How much was looked at.
    pub counts: Counts,
    /// By seed.
    pub failures: Vec<Failure>,
}

impl Summary {
    fn add(&mut self, seed: u64, outcome: Option<Outcome>) {
        self.schedules += 1;
        let Some(outcome) = outcome else {
            self.failures.push(Failure { seed, broken: None });
            return;
        };
        self.virtual_us += outcome.virtual_us;
        let place = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.trace = self
            .trace
            .wrapping_add(outcome.trace.rotate_left(17) ^ place);
        for (sum, n) in self.struck.iter_mut().zip(outcome.struck) {
            *sum += u64::from(n);
        }
        self.counts.add(&outcome.counts);
        if outcome.broken.is_some() {
            let broken = outcome.broken;
            self.failures.push(Failure { seed, broken });
        }
    }

    fn join(&mut self, other: Self) {
        self.schedules += other.schedules;
        self.virtual_us += other.virtual_us;
        self.trace = self.trace.wrapping_add(other.trace);
        for (sum, n) in self.struck.iter_mut().zip(other.struck) {
            *sum += n;
        }
        self.counts.add(&other.counts);
        self.failures.extend(other.failures);
    }

    /// Failures of one law.
    #[must_use]
    pub fn of_law(&self, law: Law) -> usize {
        let broken = self.failures.iter().filter_map(|f| f.broken.as_ref());
        broken.filter(|broken| broken.law == law).count()
    }
}

/// Plays the schedules of `count` seeds from `first` on, on `threads` threads. `go_on` is asked before every seed;
/// with `stop` the first
/// broken law is the end.
#[must_use]
pub fn many(
    first: u64,
    count: u64,
    threads: usize,
    cut: &Cut,
    stop: bool,
    go_on: &(dyn Fn() -> bool + Sync),
) -> Summary {
    let (next, broken) = (AtomicU64::new(0), AtomicBool::new(false));
    let all = Mutex::new(Summary::default());
    let work = || {
        let mut own = Summary::default();
        while go_on() && !(stop && broken.load(Ordering::Relaxed)) {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count {
                break;
            }
            let seed = first.wrapping_add(number);
            let played = catch_unwind(AssertUnwindSafe(|| play(&Plan::with(seed, cut))));
            own.add(seed, played.ok());
            broken.fetch_or(!own.failures.is_empty(), Ordering::Relaxed);
        }
        if let Ok(mut all) = all.lock() {
            all.join(own);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..threads.max(1) {
            scope.spawn(work);
        }
    });
    let mut all = all.into_inner().unwrap_or_default();
    all.failures.sort_by_key(|failure| failure.seed);
    all
}
