//! Columns that are means of plays which differ, as the expectation of what they would be without that.
//!
//! From the mean itself a size would come out too small, and what the column shares with another one would be taken for
//! that one. Regression calibration (Carroll et al. 2006, chapter 4), by lags: the expectation is the linear filter of
//! least square over a while around each row (Wiener 1949), because plays differ fast and bodies move slowly.

use super::block::{Raw, Segment};
use super::linear::solve;

/// Rows on each side that the expectation is taken from: as long as the errors remember.
const LAGS: usize = 6;
/// Share of a column's square that is added to it, so that columns which are one another can be solved for.
const RIDGE: f64 = 1e-6;

/// A column that is the mean of two plays.
#[derive(Debug, Clone, PartialEq)]
pub struct Noisy {
    /// The column.
    pub column: usize,
    /// Half of what the two differ by, by segment and row: as large as the error of their mean.
    pub half: Vec<Vec<f64>>,
    /// Coefficient with which the column is already part of the errors.
    pub at: f64,
}

/// Rows of `v` around row `i`, its ends held.
fn around(v: &[f64], i: usize) -> impl Iterator<Item = f64> + '_ {
    let last = v.len() - 1;
    (0..=2 * LAGS).map(move |lag| v[(i + lag).saturating_sub(LAGS).min(last)])
}

/// Sums of products of all that stands around each row: `of` gives a segment's series.
fn products<'a>(segments: usize, of: impl Fn(usize) -> Vec<&'a [f64]>) -> (usize, Vec<f64>) {
    let mut out = Vec::new();
    let mut n = 0;
    for s in 0..segments {
        let series = of(s);
        n = series.len() * (2 * LAGS + 1);
        out.resize(n * n, 0.0);
        for i in 0..series[0].len() {
            let row: Vec<f64> = series.iter().flat_map(|v| around(v, i)).collect();
            for (a, left) in row.iter().enumerate() {
                let into = &mut out[a * n..(a + 1) * n];
                into.iter_mut().zip(&row).for_each(|(o, r)| *o += left * r);
            }
        }
    }
    (n, out)
}

/// The expectation of `own` by row, from it and `beside`, the column that it is most like.
fn expected(segments: &[Segment], own: &Noisy, beside: &Noisy) -> Vec<Vec<f64>> {
    let both = |s: usize| -> Vec<&[f64]> {
        let columns = [own.column, beside.column];
        let series = columns.map(|c| segments[s].x[c].as_slice());
        series[..1 + usize::from(own.column != beside.column)].to_vec()
    };
    let halves = |s: usize| -> Vec<&[f64]> {
        let series = [own, beside].map(|c| c.half[s].as_slice());
        series[..1 + usize::from(own.column != beside.column)].to_vec()
    };
    let (n, mut all) = products(segments.len(), both);
    let (_, noise) = products(segments.len(), halves);
    let wanted: Vec<f64> = (0..n)
        .map(|a| all[a * n + LAGS] - noise[a * n + LAGS])
        .collect();
    for i in 0..n {
        all[i * n + i] *= 1.0 + RIDGE;
    }
    let filter = solve(&all, &wanted);
    let row = |s: usize, i: usize| -> f64 {
        let series = both(s);
        let values = series.iter().flat_map(|v| around(v, i));
        values.zip(&filter).map(|(v, f)| v * f).sum()
    };
    let rows = |s: usize| (0..segments[s].y.len()).map(|i| row(s, i)).collect();
    (0..segments.len()).map(rows).collect()
}

impl Raw {
    /// The same with the expectation of each column of plays in its place; what of it is in the errors is taken along.
    #[must_use]
    pub(crate) fn calibrated(mut self) -> Self {
        let noisy = std::mem::take(&mut self.noisy);
        let Some(first) = noisy.first() else {
            return self;
        };
        let columns: Vec<Vec<Vec<f64>>> = noisy
            .iter()
            .map(|own| expected(&self.segments, own, first))
            .collect();
        for (own, rows) in noisy.iter().zip(columns) {
            for (s, rows) in self.segments.iter_mut().zip(rows) {
                let x = &mut s.x[own.column];
                for ((y, x), row) in s.y.iter_mut().zip(x).zip(rows) {
                    *y += own.at * (row - *x);
                    *x = row;
                }
            }
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::block::{Column, Site, White};
    use crate::math::Rng;
    use crate::vocabulary::Stage;

    const ROWS: usize = 4000;

    /// Two slow motions, each of its own.
    fn motions(rng: &mut Rng) -> [Vec<f64>; 2] {
        [0; 2].map(|_| {
            let (mut fast, mut slow) = (0.0, 0.0);
            (0..ROWS)
                .map(|_| {
                    fast = 0.8 * fast + rng.normal();
                    slow = 0.8 * slow + 0.1 * fast;
                    slow
                })
                .collect()
        })
    }

    /// Mean and half difference of two plays of `truth`.
    fn played(truth: &[f64], noise: f64, rng: &mut Rng) -> [Vec<f64>; 2] {
        let mut play = || -> Vec<f64> { truth.iter().map(|x| x + noise * rng.normal()).collect() };
        let (a, b) = (play(), play());
        [0.5, -0.5].map(|w| a.iter().zip(&b).map(|(a, b)| 0.5 * a + w * b).collect())
    }

    /// Sizes that a fit of all columns finds in [`raw`].
    fn found(truths: &[Vec<f64>], sizes: &[f64], at: f64, rng: &mut Rng) -> Vec<f64> {
        fitted(raw(truths, sizes, at, rng))
    }

    fn fitted(raw: Raw) -> Vec<f64> {
        let n = raw.columns.len();
        let white = White::new(raw, 6);
        let gram: Vec<f64> = (0..n * n)
            .map(|i| white.products[i / n * (n + 1) + i % n])
            .collect();
        let moments: Vec<f64> = (0..n).map(|i| white.products[i * (n + 1) + n]).collect();
        solve(&gram, &moments)
    }

    /// Errors that hold `sizes` of what the columns stand for, with these as means of two plays.
    fn raw(truths: &[Vec<f64>], sizes: &[f64], at: f64, rng: &mut Rng) -> Raw {
        let plays: Vec<[Vec<f64>; 2]> = truths.iter().map(|t| played(t, 0.5, rng)).collect();
        let y = (0..ROWS).map(|i| {
            let own: f64 = truths.iter().zip(sizes).map(|(t, s)| s * t[i]).sum();
            // The first is played with the coefficient `at` already, and counts from where nothing is by its own column.
            own - at * truths[0][i] + at * plays[0][0][i] + 0.1 * rng.normal()
        });
        let segment = Segment {
            y: y.collect(),
            x: plays.iter().map(|p| p[0].clone()).collect(),
            weight: vec![1.0; ROWS],
        };
        let noisy = plays.iter().enumerate().map(|(column, p)| Noisy {
            column,
            half: vec![p[1].clone()],
            at: if column == 0 { at } else { 0.0 },
        });
        let column = Column {
            prior: [0.0, 10.0],
            ..Column::nuisance(0.0)
        };
        Raw {
            site: Site {
                stage: Stage::Drivetrain,
                joint: Some(0),
                blind: false,
                coarse: false,
            },
            columns: vec![column; truths.len()],
            segments: vec![segment],
            floor: 0.0,
            noisy: noisy.collect(),
        }
    }

    #[test]
    fn a_noisy_column_gives_the_size_that_the_true_one_has() {
        let mut rng = Rng::new(7);
        let [wave, _] = motions(&mut rng);
        let mut plain = raw(std::slice::from_ref(&wave), &[3.0], 0.0, &mut rng);
        plain.noisy.clear();
        let size = fitted(plain)[0];
        assert!(size < 2.0, "the mean itself gives {size}");
        for at in [0.0, 3.0] {
            let size = found(std::slice::from_ref(&wave), &[3.0], at, &mut rng)[0];
            assert!((size - 3.0).abs() < 0.45, "{size} around {at}");
        }
    }

    /// Most of what the friction of the ground changes about a load is like the load.
    #[test]
    fn what_two_columns_share_goes_to_the_one_that_is_there() {
        let mut rng = Rng::new(8);
        let [load, other] = motions(&mut rng);
        let load: Vec<f64> = load.iter().map(|x| 3.0 * x).collect();
        let alike = load.iter().zip(&other).map(|(l, o)| 0.5 * l + 0.5 * o);
        let truths = [load.clone(), alike.collect()];
        for (sizes, what) in [([0.0, 0.6], "friction"), ([0.3, 0.0], "mass")] {
            let found = found(&truths, &sizes, 0.0, &mut rng);
            for (found, size) in found.iter().zip(sizes) {
                assert!((found - size).abs() < 0.05, "{what}: {found} for {size}");
            }
        }
    }
}
