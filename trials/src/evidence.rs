//! How much of a cause a recording shows, once the nominal numbers were fitted in its place.

/// What every cause adds to chi-square, and what stays of that. `causes` and `nuisances` are differences that leaving
/// one out, or shifting one nominal number by its tolerance, makes, in units of the noise.
///
/// The nominal numbers are fitted linearly, each held by its tolerance.
#[must_use]
pub fn remaining(causes: &[Vec<f64>], nuisances: &[Vec<f64>]) -> Vec<(f64, f64)> {
    let n = nuisances.len();
    let mut normal = vec![vec![0.0; n]; n];
    for i in 0..n {
        for j in 0..n {
            normal[i][j] = dot(&nuisances[i], &nuisances[j]) + f64::from(u8::from(i == j));
        }
    }
    let factor = cholesky(normal);
    causes
        .iter()
        .map(|d| {
            let full = dot(d, d);
            let right: Vec<f64> = nuisances.iter().map(|j| dot(j, d)).collect();
            // What the fit takes away: |L^-1 J'd|^2.
            let taken: f64 = forward(&factor, &right).iter().map(|x| x * x).sum();
            (full, (full - taken).max(0.0))
        })
        .collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Lower factor of a positive definite matrix.
fn cholesky(mut a: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    for i in 0..a.len() {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| a[i][k] * a[j][k]).sum();
            let left = a[i][j] - sum;
            a[i][j] = if i == j {
                libm::sqrt(left.max(f64::MIN_POSITIVE))
            } else {
                left / a[j][j]
            };
        }
    }
    a
}

fn forward(factor: &[Vec<f64>], right: &[f64]) -> Vec<f64> {
    let mut out: Vec<f64> = Vec::with_capacity(right.len());
    for (i, r) in right.iter().enumerate() {
        let sum: f64 = (0..i).map(|k| factor[i][k] * out[k]).sum();
        out.push((r - sum) / factor[i][i]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::remaining;

    #[test]
    fn what_a_nominal_number_imitates_stays_no_evidence_but_for_its_tolerance() {
        // A cause of 10 sigma along one nominal number's direction, and across it.
        let nuisance = vec![vec![1.0, 0.0], vec![0.0, 0.0]];
        let causes = [vec![10.0, 0.0], vec![0.0, 10.0]];
        let found = remaining(&causes, &nuisance);
        // Minimum of (10 - x)^2 + x^2 is 50.
        assert!((found[0].0 - 100.0).abs() < 1e-9 && (found[0].1 - 50.0).abs() < 1e-9);
        assert!((found[1].1 - 100.0).abs() < 1e-9);
        assert_eq!(remaining(&causes, &[])[0], (100.0, 100.0));
    }
}
