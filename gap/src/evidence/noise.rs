//! Whitening: an autoregression fitted to what all columns together leave.

use super::block::{Column, Segment, products, root_mean_square};
use super::linear::solve;

/// Passes between coefficients and noise; the second changes little, the third nothing that counts.
const PASSES: usize = 3;
/// Whitened errors beyond this many standard deviations count linearly (Huber 1981, 95 % efficiency at 1.345;
/// wider, because rare blows are a part of the motion).
pub(crate) const HUBER: f64 = 3.0;
/// Least noise that the passes start from, as a share of the errors: where no floor is known.
const LEAST: f64 = 1e-3;

/// Coefficients of all columns at once under their priors: the fit that leaves least.
fn saturated(segments: &[Segment], columns: &[Column]) -> Vec<f64> {
    saturated_by(&products(segments, columns.len()), columns)
}

/// The same from the products of columns and errors.
pub(super) fn saturated_by(all: &[f64], columns: &[Column]) -> Vec<f64> {
    let c = columns.len();
    let n = c + 1;
    let mut a = vec![0.0; c * c];
    let mut b = vec![0.0; c];
    for i in 0..c {
        a[i * c..(i + 1) * c].copy_from_slice(&all[i * n..i * n + c]);
        let sd = columns[i].prior[1]
            .max(columns[i].slack)
            .max(columns[i].prior[0]);
        a[i * c + i] += 1.0 / (sd * sd);
        b[i] = all[i * n + c];
    }
    solve(&a, &b)
}

fn residuals(segment: &Segment, theta: &[f64]) -> Vec<f64> {
    let mut out = segment.y.clone();
    for (x, t) in segment.x.iter().zip(theta) {
        out.iter_mut().zip(x).for_each(|(o, x)| *o -= t * x);
    }
    out
}

/// Autocovariances up to `order` over rows that count.
fn autocovariance(all: &[(Vec<f64>, &[f64])], order: usize) -> Vec<f64> {
    (0..=order)
        .map(|lag| {
            let (mut sum, mut n) = (0.0, 0.0);
            for (e, w) in all {
                for i in lag..e.len() {
                    let weight = w[i] * w[i - lag];
                    sum += weight * e[i] * e[i - lag];
                    n += weight;
                }
            }
            if n > 0.0 { sum / n } else { 0.0 }
        })
        .collect()
}

/// Levinson and Durbin: coefficients of the prediction from the past, and the variance of its errors.
fn levinson(r: &[f64]) -> (Vec<f64>, f64) {
    let order = r.len() - 1;
    let mut a: Vec<f64> = Vec::with_capacity(order);
    let mut e = r[0];
    for m in 1..=order {
        if e <= 1e-12 * r[0] {
            break;
        }
        let dot: f64 = a.iter().zip(r[1..m].iter().rev()).map(|(a, r)| a * r).sum();
        let k = (r[m] - dot) / e;
        // Rows that do not count leave covariances of no process: the shorter past that is one stands.
        if k.abs() > 0.995 {
            break;
        }
        let before = a.clone();
        for (x, y) in a.iter_mut().zip(before.iter().rev()) {
            *x -= k * y;
        }
        a.push(k);
        e *= 1.0 - k * k;
    }
    (a, e)
}

/// `v[i]` less its prediction from the past; the first rows see a shorter past.
fn filtered(v: &[f64], a: &[f64], scale: f64) -> Vec<f64> {
    let mut out = v.to_vec();
    for (lag, a) in a.iter().enumerate() {
        let late = out.iter_mut().skip(lag + 1);
        late.zip(v).for_each(|(out, v)| *out -= a * v);
    }
    out.iter_mut().for_each(|out| *out *= scale);
    out
}

/// A filter that makes errors independent and of size one.
#[derive(Debug, Clone, PartialEq)]
pub struct Whitening {
    /// Coefficients of the prediction from the past.
    past: Vec<f64>,
    /// Standard deviation of one-step prediction errors, in the unit of the signal.
    pub noise: f64,
    /// Root mean square of what no column explains and its own past predicts, in the unit of the signal: slower than noise.
    pub slow: f64,
}

impl Whitening {
    /// Independent errors of one size.
    #[must_use]
    pub fn plain(noise: f64) -> Self {
        Self {
            past: Vec::new(),
            noise,
            slow: 0.0,
        }
    }

    /// `v` as independent errors; the first rows see a shorter past.
    #[must_use]
    pub fn apply(&self, v: &[f64]) -> Vec<f64> {
        filtered(v, &self.past, 1.0 / self.noise)
    }

    /// Rows whose past is not known.
    #[must_use]
    pub fn order(&self) -> usize {
        self.past.len()
    }

    /// The filter of what all `columns` together leave of the errors.
    #[must_use]
    pub fn fit(segments: &[Segment], columns: &[Column], order: usize, floor: f64) -> Self {
        whiten(segments, columns, order, floor).1
    }
}

/// Errors and columns of `segments`, filtered into `out`.
fn whitened(out: &mut [Segment], segments: &[Segment], white: &Whitening) {
    for (to, from) in out.iter_mut().zip(segments) {
        to.y = white.apply(&from.y);
        for (to, from) in to.x.iter_mut().zip(&from.x) {
            *to = white.apply(from);
        }
    }
}

/// Errors and columns filtered to independent errors of size one, and the filter.
pub(super) fn whiten(
    segments: &[Segment],
    columns: &[Column],
    order: usize,
    floor: f64,
) -> (Vec<Segment>, Whitening) {
    let mut out = segments.to_vec();
    // Errors as large as the floor at first: what columns explain is theirs, and the filter is fitted to the rest.
    // From large errors the priors would hold the coefficients, and the filter would take the signal for noise.
    let mut white = Whitening::plain(floor.max(LEAST * root_mean_square(segments)));
    whitened(&mut out, segments, &white);
    for _ in 0..PASSES {
        let theta = saturated(&out, columns);
        let left: Vec<(Vec<f64>, &[f64])> = segments
            .iter()
            .map(|s| (residuals(s, &theta), s.weight.as_slice()))
            .collect();
        let mut r = autocovariance(&left, order);
        r[0] += floor * floor;
        let (past, variance) = levinson(&r);
        white = Whitening {
            past,
            noise: variance.max(1e-300).sqrt(),
            slow: (r[0] - variance).max(0.0).sqrt(),
        };
        whitened(&mut out, segments, &white);
        for ((to, from), (left, _)) in out.iter_mut().zip(segments).zip(&left) {
            let z = white.apply(left);
            for ((w, own), z) in to.weight.iter_mut().zip(&from.weight).zip(&z) {
                *w = own * (HUBER / z.abs().max(HUBER));
            }
            // The past of the first rows is not known.
            to.weight.iter_mut().take(order).for_each(|w| *w = 0.0);
        }
    }
    (out, white)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    #[test]
    fn an_autoregression_is_found_again() {
        let mut rng = Rng::new(3);
        let mut y = vec![0.0; 20_000];
        for i in 2..y.len() {
            y[i] = 1.2 * y[i - 1] - 0.5 * y[i - 2] + 0.1 * rng.normal();
        }
        let segment = Segment {
            weight: vec![1.0; y.len()],
            y,
            x: Vec::new(),
        };
        let (white, filter) = whiten(&[segment], &[], 4, 0.0);
        let noise = filter.noise;
        assert!((noise - 0.1).abs() < 0.003, "{noise}");
        // Yule and Walker: a variance of 0.01 (1 + 0.5) / (1 - 0.5) / (1.5^2 - 1.2^2), less that of the noise.
        let slow = (0.03 / 0.81 - 0.01_f64).sqrt();
        assert!((filter.slow / slow - 1.0).abs() < 0.05, "{}", filter.slow);
        let r = autocovariance(&[(white[0].y.clone(), &white[0].weight)], 3);
        assert!(r[1..].iter().all(|x| x.abs() < 0.03), "{r:?}");
    }

    #[test]
    fn a_slow_signal_is_its_columns_and_not_the_noise() {
        let mut rng = Rng::new(4);
        let wave: Vec<f64> = (0..3000)
            .map(|i| crate::math::sin(0.05 * f64::from(i)))
            .collect();
        let segment = Segment {
            y: wave
                .iter()
                .map(|w| 0.02 * w + 1e-3 * rng.normal())
                .collect(),
            x: vec![wave],
            weight: vec![1.0; 3000],
        };
        let columns = [Column::open(0, 0.05)];
        let (white, filter) = whiten(&[segment], &columns, 6, 5e-4);
        let all = products(&white, 1);
        let size = all[1] / all[0];
        assert!((size - 0.02).abs() < 2e-3, "{size}");
        assert!(filter.noise < 1.5e-3, "{}", filter.noise);
        // Errors of 1e-3 over 3,000 rows know the size of the wave to 2.6e-5.
        let error = 1.0 / all[0].sqrt();
        assert!(error < 5e-5, "{error}");
    }
}
