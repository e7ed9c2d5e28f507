//! Random numbers by name: the stream depends on what it is for, never on who asked first.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// What the numbers of a stream are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Start position and velocity of a particle.
    Start,
    /// r1 and r2 of equation (4).
    Flight,
    /// Noise inside the objective, one stream per repetition (up to 2^14).
    Noise(u16),
}

/// The generator for (seed, iteration, particle, purpose).
#[must_use]
pub fn stream(seed: u64, iteration: u32, particle: usize, purpose: Purpose) -> ChaCha8Rng {
    // 16 bits of purpose, 24 of particle, 24 of iteration: swarms and searches stay far below both limits.
    let purpose = match purpose {
        Purpose::Start => 0,
        Purpose::Flight => 1,
        Purpose::Noise(repetition) => 2 + u64::from(repetition),
    };
    let name =
        (u64::from(iteration) << 40) | ((particle as u64 & 0xFF_FFFF) << 16) | (purpose & 0xFFFF);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(name);
    random
}
