//! Functions that give the same bits everywhere, and small statistics.

/// Sine, by libm-free polynomial: same bits on every machine, error below 1e-9 for |x| < 1e4 rad.
#[must_use]
pub fn sin(x: f64) -> f64 {
    use std::f64::consts::{FRAC_1_PI, PI};
    let k = (x * FRAC_1_PI).round();
    let r = x - k * PI;
    let r2 = r * r;
    // Taylor series to r^15 on [-pi/2, pi/2]: remainder (pi/2)^17/17! = 6e-12.
    let p = -1.0 / 1_307_674_368_000.0;
    let p = 1.0 / 6_227_020_800.0 + r2 * p;
    let p = -1.0 / 39_916_800.0 + r2 * p;
    let p = 1.0 / 362_880.0 + r2 * p;
    let p = -1.0 / 5040.0 + r2 * p;
    let p = 1.0 / 120.0 + r2 * p;
    let p = -1.0 / 6.0 + r2 * p;
    let s = r * (1.0 + r2 * p);
    if (k as i64) % 2 == 0 { s } else { -s }
}

/// Mean of a slice, 0 when empty.
#[must_use]
pub fn mean(v: &[f64]) -> f64 {
    if v.is_empty() {
        0.0
    } else {
        v.iter().sum::<f64>() / v.len() as f64
    }
}

/// Root of the mean square, 0 when empty.
#[must_use]
pub fn rms(v: &[f64]) -> f64 {
    if v.is_empty() {
        0.0
    } else {
        (v.iter().map(|x| x * x).sum::<f64>() / v.len() as f64).sqrt()
    }
}

/// Student's t over the normal quantile, 95 %, to first order in one over the degrees of freedom `free`: what a spread that is known from
/// few values is widened by.
#[must_use]
pub fn few(free: f64) -> f64 {
    1.0 + 1.2 / free
}

/// Quantile `p` in 0..=1 of a slice by the nearest rank; 0 when empty.
#[must_use]
pub fn quantile(v: &[f64], p: f64) -> f64 {
    let mut s = v.to_vec();
    s.sort_by(f64::total_cmp);
    let last = s.len().saturating_sub(1);
    s.get(((last as f64) * p).round() as usize)
        .copied()
        .unwrap_or(0.0)
}

/// Median of a slice; 0 when empty.
#[must_use]
pub fn median(v: &[f64]) -> f64 {
    quantile(v, 0.5)
}

/// A small seeded generator (SplitMix64): the same numbers everywhere for one seed.
#[derive(Debug, Clone)]
pub struct Rng(u64);

impl Rng {
    /// Generator for one seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Next 64 bits. Constants of SplitMix64 (Steele, Lea, Flood 2014).
    pub fn next_u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform index below `n` (0 for n = 0).
    pub fn index(&mut self, n: usize) -> usize {
        ((self.uniform() * n as f64) as usize).min(n.saturating_sub(1))
    }

    /// Standard normal number, as the sum of twelve uniforms.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_is_accurate() {
        for i in -40_000..40_000 {
            let x = f64::from(i) * 0.01;
            assert!((sin(x) - libm::sin(x)).abs() < 1e-9, "{x}");
        }
    }

    #[test]
    fn quantiles_of_a_known_list() {
        let v = [5.0, 1.0, 3.0, 2.0, 4.0];
        assert_eq!(
            (quantile(&v, 0.0), median(&v), quantile(&v, 1.0)),
            (1.0, 3.0, 5.0)
        );
        assert_eq!((mean(&v), median(&[])), (3.0, 0.0));
    }
}
