//! Small dense linear algebra: row-major square matrices.

/// Lower Cholesky factor of a symmetric positive matrix of `n` rows; a pivot below `1e-12` of its diagonal is
/// lifted to that.
#[must_use]
pub fn cholesky(a: &[f64], n: usize) -> Vec<f64> {
    let mut l = vec![0.0; n * n];
    for j in 0..n {
        for i in j..n {
            let dot: f64 = (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum();
            let left = a[i * n + j] - dot;
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
        let dot: f64 = (0..i).map(|k| l[i * n + k] * x[k]).sum();
        x[i] = (x[i] - dot) / l[i * n + i];
    }
}

/// Solves `l^T x = b` in place.
pub fn backward(l: &[f64], n: usize, x: &mut [f64]) {
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| l[k * n + i] * x[k]).sum();
        x[i] = (x[i] - dot) / l[i * n + i];
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
    }
}
