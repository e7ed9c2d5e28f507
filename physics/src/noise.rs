//! Counter-based noise: a number is a pure function of seed, stream and counter.
//!
//! Philox 4x32 with 10 rounds (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011).

const MULTIPLIERS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];

/// One block of four 32-bit words.
#[must_use]
pub fn philox(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for _ in 0..10 {
        let product = |k: usize, word: u32| u64::from(MULTIPLIERS[k]) * u64::from(word);
        let (a, b) = (product(0, counter[0]), product(1, counter[2]));
        let (high, low) = (|x: u64| (x >> 32) as u32, |x: u64| x as u32);
        counter = [
            high(b) ^ counter[1] ^ key[0],
            low(b),
            high(a) ^ counter[3] ^ key[1],
            low(a),
        ];
        key = [key[0].wrapping_add(WEYL[0]), key[1].wrapping_add(WEYL[1])];
    }
    counter
}

/// Two independent normal numbers (Box and Muller) for a seed, tick and pair of joints.
#[must_use]
pub fn normal_pair(seed: u64, tick: u32, pair: u32) -> [f32; 2] {
    let words = philox([tick, pair, 0, 0], [seed as u32, (seed >> 32) as u32]);
    // (0, 1]: the logarithm stays finite.
    let unit = |word: u32| (f64::from(word) + 1.0) / 4_294_967_296.0;
    let radius = (-2.0 * libm::log(unit(words[0]))).sqrt();
    let (sin, cos) = libm::sincos(std::f64::consts::TAU * unit(words[1]));
    [(radius * cos) as f32, (radius * sin) as f32]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers of the reference implementation (Random123, `kat_vectors`).
    #[test]
    fn philox_known_answers() {
        let cases = [
            (
                [0; 4],
                [0; 2],
                [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8],
            ),
            (
                [u32::MAX; 4],
                [u32::MAX; 2],
                [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd],
            ),
            (
                [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344],
                [0xa409_3822, 0x299f_31d0],
                [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1],
            ),
        ];
        for (counter, key, expected) in cases {
            assert_eq!(philox(counter, key), expected);
        }
    }

    #[test]
    fn normal_numbers_have_mean_zero_and_variance_one() {
        let n = 20_000;
        let (mut sum, mut squares) = (0.0, 0.0);
        for tick in 0..n {
            for x in normal_pair(7, tick, 3) {
                sum += f64::from(x);
                squares += f64::from(x) * f64::from(x);
            }
        }
        let count = f64::from(2 * n);
        assert!((sum / count).abs() < 0.02, "{}", sum / count);
        assert!((squares / count - 1.0).abs() < 0.03, "{}", squares / count);
    }
}
