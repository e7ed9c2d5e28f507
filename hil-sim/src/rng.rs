//! Seeded random streams: SplitMix64, one independent stream per purpose.
//!
//! Faults and noise draw from streams named by (seed, purpose, joint), so that switching one fault on never shifts
//! the draws of another, and results do not depend on the order in which drivers are stepped.

/// A small deterministic generator (SplitMix64, Steele, Lea and Flood 2014).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rng {
    state: u64,
}

/// Weyl increment of SplitMix64: the odd integer closest to 2^64 / golden ratio.
const GOLDEN_GAMMA: u64 = 0x9E37_79B9_7F4A_7C15;

impl Rng {
    /// A stream for `purpose` (any number that names the use) on joint or driver `index`.
    #[must_use]
    pub fn new(seed: u64, purpose: u64, index: u64) -> Self {
        let mut rng = Self { state: seed };
        rng.state = rng.next_u64() ^ purpose.wrapping_mul(GOLDEN_GAMMA);
        rng.state = rng.next_u64() ^ index.wrapping_mul(GOLDEN_GAMMA);
        rng.next_u64();
        rng
    }

    /// The next 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GOLDEN_GAMMA);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1), 53 bits.
    pub fn uniform(&mut self) -> f64 {
        // 2^-53: the spacing of doubles in [0.5, 1).
        (self.next_u64() >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }

    /// True with `probability`. Draws nothing at probability 0, so "off" leaves the stream untouched.
    pub fn chance(&mut self, probability: f64) -> bool {
        probability > 0.0 && self.uniform() < probability
    }

    /// Normal with mean 0 and standard deviation 1 (Box and Muller 1958, one of the pair).
    pub fn normal(&mut self) -> f64 {
        let u = 1.0 - self.uniform();
        let v = self.uniform();
        libm::sqrt(-2.0 * libm::log(u)) * libm::cos(core::f64::consts::TAU * v)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_by_purpose_and_index_and_repeat_by_seed() {
        let first = |s, p, i| Rng::new(s, p, i).next_u64();
        assert_eq!(first(1, 2, 3), first(1, 2, 3));
        assert_ne!(first(1, 2, 3), first(2, 2, 3));
        assert_ne!(first(1, 2, 3), first(1, 3, 3));
        assert_ne!(first(1, 2, 3), first(1, 2, 4));
    }

    #[test]
    fn moments_of_uniform_and_normal() {
        let mut rng = Rng::new(7, 1, 0);
        let n = 100_000;
        let mean: f64 = (0..n).map(|_| rng.uniform()).sum::<f64>() / f64::from(n);
        // Standard error of the mean of a uniform variable: 0.2887 / sqrt(n) = 0.0009.
        assert!((mean - 0.5).abs() < 0.005, "{mean}");
        let (mut sum, mut square) = (0.0, 0.0);
        for _ in 0..n {
            let x = rng.normal();
            sum += x;
            square += x * x;
        }
        assert!((sum / f64::from(n)).abs() < 0.02);
        assert!((square / f64::from(n) - 1.0).abs() < 0.03);
    }
}
