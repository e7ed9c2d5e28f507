//! Start-up test of a hardware random number generator, and the seed of challenges drawn from it.
//!
//! A generator that stands still would give the same challenges at every boot, and a recorded order would be valid again. So a boot draws
//! [`WORDS`] words, tests them and hashes them; a board whose generator fails gives no challenge and starts no run.

use sha2::Digest as _;

/// Words drawn at boot: 2048 bits, twice the window of the adaptive proportion test of NIST SP 800-90B for binary sources (1024 samples).
pub const WORDS: usize = 64;
/// Ones among the 2048 bits may differ from half by six standard deviations (22.6 each): a good generator fails once in 5 x 10^8 boots.
const MAX_BIAS: u32 = 136;

/// Why there is no seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EntropyError {
    /// The generator gave no word in time.
    Timeout,
    /// It reports an error of its seed, and a restart of it did not help.
    Seed,
    /// It reports an error of its clock.
    Clock,
    /// Two words in a row were equal, or a word was 0 (repetition count test: once in 6 x 10^7 boots by chance).
    Repeats,
    /// Too many or too few ones (adaptive proportion test).
    Biased,
}

/// Draws, tests and hashes: 16 bytes that differ at every boot.
///
/// # Errors
/// [`EntropyError`], the generator's own or that of the test.
pub fn collect(
    mut next: impl FnMut() -> Result<u32, EntropyError>,
) -> Result<[u8; 16], EntropyError> {
    let mut hash = sha2::Sha256::new_with_prefix(b"rb entropy");
    let (mut last, mut ones) = (0, 0_u32);
    for _ in 0..WORDS {
        let word = next()?;
        if word == 0 || word == last {
            return Err(EntropyError::Repeats);
        }
        last = word;
        ones = ones.saturating_add(word.count_ones());
        hash.update(word.to_le_bytes());
    }
    if ones.abs_diff(WORDS as u32 * u32::BITS / 2) > MAX_BIAS {
        return Err(EntropyError::Biased);
    }
    let mut seed = [0; 16];
    for (place, byte) in seed.iter_mut().zip(hash.finalize()) {
        *place = byte;
    }
    Ok(seed)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// xorshift32, a good enough generator for the test.
    fn good(mut state: u32) -> impl FnMut() -> Result<u32, EntropyError> {
        move || {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            Ok(state)
        }
    }

    #[test]
    fn a_good_generator_passes_and_gives_different_seeds() {
        let mut seeds = std::collections::BTreeSet::new();
        for state in 1..=2000_u32 {
            let seed = collect(good(state.wrapping_mul(0x9E37_79B9))).expect("good");
            assert!(seeds.insert(seed));
        }
    }

    #[test]
    fn every_kind_of_broken_generator_is_refused() {
        let stuck = collect(|| Ok(0xDEAD_BEEF));
        assert_eq!(stuck, Err(EntropyError::Repeats));
        assert_eq!(collect(|| Ok(0)), Err(EntropyError::Repeats));
        let mut late = good(7);
        let mut drawn = 0;
        let sticks_later = collect(|| {
            drawn += 1;
            if drawn < 60 { late() } else { Ok(5) }
        });
        assert_eq!(sticks_later, Err(EntropyError::Repeats));
        let mut counter = 0;
        let counts = collect(|| {
            counter += 1;
            Ok(counter)
        });
        assert_eq!(counts, Err(EntropyError::Biased), "a counter has few ones");
        let mut noise = good(9);
        let biased = collect(|| Ok(noise()? | 0xFF));
        assert_eq!(biased, Err(EntropyError::Biased));
        for error in [
            EntropyError::Timeout,
            EntropyError::Seed,
            EntropyError::Clock,
        ] {
            let mut noise = good(3);
            let mut drawn = 0;
            let fails = collect(|| {
                drawn += 1;
                if drawn == 40 { Err(error) } else { noise() }
            });
            assert_eq!(fails, Err(error));
        }
    }
}
