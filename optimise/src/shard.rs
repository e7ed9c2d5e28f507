//! Trials spread over processes that all run the same search.
//!
//! Every process holds the whole search and steps it in the same way; only the trials are divided. Process `rank` of `size` takes
//! the jobs with index = rank modulo size, all exchange their outcomes, and each puts them back in job order. So a search has
//! the same bits for any number of processes, and any process can write the checkpoint.

use crate::score::TrialOutcome;
use crate::search::{GaitJob, GaitTrials};

/// A group of processes that can gather bytes from all to all (MPI's all-gather).
pub trait Exchange {
    /// This process, from 0.
    fn rank(&self) -> usize;
    /// Number of processes, at least 1.
    fn size(&self) -> usize;
    /// What every process gave, by rank. All processes call it the same number of times.
    fn all_gather(&self, mine: &[u8]) -> Vec<Vec<u8>>;
}

/// The only process of a search.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl Exchange for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn all_gather(&self, mine: &[u8]) -> Vec<Vec<u8>> {
        vec![mine.to_vec()]
    }
}

/// [`GaitTrials`] over all processes of an [`Exchange`].
#[derive(Debug)]
pub struct Sharded<T, E> {
    local: T,
    exchange: E,
}

impl<T: GaitTrials, E: Exchange> Sharded<T, E> {
    /// `local` runs this process's share.
    pub fn new(local: T, exchange: E) -> Self {
        Self { local, exchange }
    }

    /// Whether this process is the one that writes files and shows progress.
    pub fn is_first(&self) -> bool {
        self.exchange.rank() == 0
    }

    /// Whether it holds in any process. All processes ask the same questions in the same order, and all get the same answer. A search
    /// that one of them must end (Ctrl-C, a full disk) ends in all of them, instead of leaving the others to wait for it.
    pub fn any(&self, here: bool) -> bool {
        let all = self.exchange.all_gather(&[u8::from(here)]);
        all.iter().any(|said| said.first() != Some(&0))
    }
}

impl<T: GaitTrials, E: Exchange> GaitTrials for Sharded<T, E> {
    fn run(&self, jobs: &[GaitJob<'_>]) -> Vec<TrialOutcome> {
        let size = self.exchange.size().max(1);
        let mine: Vec<GaitJob<'_>> = jobs
            .iter()
            .skip(self.exchange.rank())
            .step_by(size)
            .copied()
            .collect();
        // Serialising numbers into a growing buffer cannot fail.
        let bytes = postcard::to_allocvec(&self.local.run(&mine)).unwrap_or_default();
        let gathered: Vec<Vec<TrialOutcome>> = self
            .exchange
            .all_gather(&bytes)
            .iter()
            .map(|bytes| postcard::from_bytes(bytes).unwrap_or_default())
            .collect();
        (0..jobs.len())
            .map(|job| {
                let outcome = gathered
                    .get(job % size)
                    .and_then(|share| share.get(job / size));
                outcome.cloned().unwrap_or_else(lost)
            })
            .collect()
    }

    fn stopped(&self) -> bool {
        self.any(self.local.stopped())
    }
}

/// An outcome that a process did not deliver: it counts as failed and is seen in the search's counts.
fn lost() -> TrialOutcome {
    TrialOutcome {
        path_m: Vec::new(),
        period_s: 1.0,
        collided: false,
        impact_m_s: 0.0,
        failed_at_step: Some(0),
    }
}
