//! Processes of an MPI job as an exchange of bytes.

use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives};
use optimise::shard::Exchange;

/// All processes that `mpirun` or `srun` started together.
pub struct World {
    // Ends MPI when dropped, so it lives as long as the communicator.
    _universe: Universe,
    world: SimpleCommunicator,
}

impl World {
    /// Joins the others; `None` when MPI was already joined in this process.
    #[must_use]
    pub fn join() -> Option<Self> {
        let universe = mpi::initialize()?;
        let world = universe.world();
        Some(Self {
            _universe: universe,
            world,
        })
    }
}

impl Exchange for World {
    fn rank(&self) -> usize {
        usize::try_from(self.world.rank()).unwrap_or(0)
    }

    fn size(&self) -> usize {
        usize::try_from(self.world.size()).unwrap_or(1)
    }

    fn all_gather(&self, mine: &[u8]) -> Vec<Vec<u8>> {
        // One iteration's outcomes are far below MPI's 2 GiB count limit.
        let length = i32::try_from(mine.len()).unwrap_or(i32::MAX);
        let mut counts = vec![0i32; self.size()];
        self.world.all_gather_into(&length, &mut counts[..]);
        let starts: Vec<i32> = counts
            .iter()
            .scan(0, |at, count| {
                let start = *at;
                *at += count;
                Some(start)
            })
            .collect();
        let total = counts.iter().sum::<i32>();
        let mut bytes = vec![0u8; usize::try_from(total).unwrap_or(0)];
        {
            let mut parts = PartitionMut::new(&mut bytes[..], &counts[..], &starts[..]);
            self.world.all_gather_varcount_into(mine, &mut parts);
        }
        let part = |(&start, &count): (&i32, &i32)| {
            let (start, count) = (usize::try_from(start).ok()?, usize::try_from(count).ok()?);
            bytes.get(start..start + count).map(<[u8]>::to_vec)
        };
        starts
            .iter()
            .zip(&counts)
            .map(|pair| part(pair).unwrap_or_default())
            .collect()
    }
}
