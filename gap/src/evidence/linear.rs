//! Small dense linear algebra: row-major square matrices.

/// Sums that a product keeps side by side, so that a processor adds several at once; the order is that of the code.
const LANES: usize = 8;

/// Scalar product of two rows of one length.
#[must_use]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (x, last_x) = a.as_chunks::<LANES>();
    let (y, last_y) = b.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for (x, y) in x.iter().zip(y) {
        sums = std::array::from_fn(|i| sums[i] + x[i] * y[i]);
    }
    let last: f64 = last_x.iter().zip(last_y).map(|(x, y)| x * y).sum();
    sums.iter().sum::<f64>() + last
}

/// Scalar product of two rows whose elements have weights, all of one length.
#[must_use]
pub fn weighted_dot(w: &[f64], a: &[f64], b: &[f64]) -> f64 {
    let (v, last_v) = w.as_chunks::<LANES>();
    let (x, last_x) = a.as_chunks::<LANES>();
    let (y, last_y) = b.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for ((v, x), y) in v.iter().zip(x).zip(y) {
        sums = std::array::from_fn(|i| sums[i] + v[i] * x[i] * y[i]);
    }
    let last = last_v.iter().zip(last_x).zip(last_y);
    sums.iter().sum::<f64>() + last.map(|((v, x), y)| v * x * y).sum::<f64>()
}

/// Lower Cholesky factor of a symmetric positive matrix of `n` rows; a pivot below `1e-12` of its diagonal is
/// lifted to that.
#[must_use]
pub fn cholesky(a: &[f64], n: usize) -> Vec<f64> {
    let mut l = vec![0.0; n * n];
    for j in 0..n {
        for i in j..n {
            let known = dot(&l[i * n..i * n + j], &l[j * n..j * n + j]);
            let left = a[i * n + j] - known;
            if i == j {
                let least = 1e-12 * a[j * n + j].abs().max(1e-300);
                l[j * n + j] = left.max(least).sqrt();
            } else {
                l[i * n + j] = left / l[j * n + j];
            }
        }
    }
    l
}

/// Solves `l x = b` in place.
pub fn forward(l: &[f64], n: usize, x: &mut [f64]) {
    for i in 0..n {
        x[i] = (x[i] - dot(&l[i * n..i * n + i], &x[..i])) / l[i * n + i];
    }
}

/// Solves `l^T x = b` in place.
pub fn backward(l: &[f64], n: usize, x: &mut [f64]) {
    for i in (0..n).rev() {
        let (before, own) = x.split_at_mut(i);
        own[0] /= l[i * n + i];
        let row = &l[i * n..i * n + i];
        before
            .iter_mut()
            .zip(row)
            .for_each(|(x, l)| *x -= l * own[0]);
    }
}

/// Solves `a x = b` for a symmetric positive matrix.
#[must_use]
pub fn solve(a: &[f64], b: &[f64]) -> Vec<f64> {
    let n = b.len();
    let l = cholesky(a, n);
    let mut x = b.to_vec();
    forward(&l, n, &mut x);
    backward(&l, n, &mut x);
    x
}

/// Inverse of a symmetric positive matrix from its factor.
#[must_use]
pub fn inverse(l: &[f64], n: usize) -> Vec<f64> {
    let mut out = vec![0.0; n * n];
    let mut column = vec![0.0; n];
    for j in 0..n {
        column.fill(0.0);
        column[j] = 1.0;
        forward(l, n, &mut column);
        backward(l, n, &mut column);
        for i in 0..n {
            out[i * n + j] = column[i];
        }
    }
    out
}

/// Diagonal of the inverse of a symmetric positive matrix from its factor.
#[must_use]
pub fn inverse_diagonal(l: &[f64], n: usize) -> Vec<f64> {
    // Rows of the transposed inverse of the factor: their squares are the diagonal.
    let one = |j: usize| {
        let mut x = vec![0.0; n - j];
        x[0] = 1.0 / l[j * n + j];
        for i in j + 1..n {
            x[i - j] = -dot(&l[i * n + j..i * n + i], &x[..i - j]) / l[i * n + i];
        }
        dot(&x, &x)
    };
    (0..n).map(one).collect()
}

/// Twice the sum of the logarithms of the diagonal: the logarithm of the determinant of the factored matrix.
#[must_use]
pub fn log_determinant(l: &[f64], n: usize) -> f64 {
    (0..n).map(|i| 2.0 * libm::log(l[i * n + i])).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_known_system_is_solved_and_inverted() {
        let a = [4.0, 2.0, 0.0, 2.0, 5.0, 1.0, 0.0, 1.0, 3.0];
        let x = solve(&a, &[8.0, 15.0, 11.0]);
        for (x, known) in x.iter().zip([1.0, 2.0, 3.0]) {
            assert!((x - known).abs() < 1e-12, "{x}");
        }
        let l = cholesky(&a, 3);
        // By hand: 4 (15 - 1) - 2 (6 - 0) = 44.
        assert!((log_determinant(&l, 3) - libm::log(44.0)).abs() < 1e-12);
        let inverse = inverse(&l, 3);
        let one: f64 = (0..3).map(|k| a[k] * inverse[k * 3]).sum();
        assert!((one - 1.0).abs() < 1e-12);
        for (k, d) in inverse_diagonal(&l, 3).iter().enumerate() {
            assert!((d - inverse[k * 3 + k]).abs() < 1e-12, "{d}");
        }
    }

    #[test]
    fn a_large_matrix_times_its_inverse_is_one() {
        let n = 37;
        let mut rng = crate::math::Rng::new(5);
        let root: Vec<f64> = (0..n * n).map(|_| rng.normal()).collect();
        let product = |i: usize, j: usize| -> f64 {
            let own: f64 = (0..n).map(|k| root[i * n + k] * root[j * n + k]).sum();
            own + if i == j { 1.0 } else { 0.0 }
        };
        let a: Vec<f64> = (0..n * n).map(|i| product(i / n, i % n)).collect();
        let l = cholesky(&a, n);
        let inverse = inverse(&l, n);
        let diagonal = inverse_diagonal(&l, n);
        for i in 0..n {
            assert!((diagonal[i] - inverse[i * n + i]).abs() < 1e-10);
            for j in 0..n {
                let one: f64 = (0..n).map(|k| a[i * n + k] * inverse[k * n + j]).sum();
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((one - expected).abs() < 1e-9, "{i} {j}: {one}");
            }
        }
    }
}
