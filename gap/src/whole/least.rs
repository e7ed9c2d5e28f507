//! Robust least squares: costs, normal equations by group, their solution.

/// Residuals beyond this many tolerances count linearly (Huber).
const HUBER: f64 = 3.0;

/// Normal equations of one group.
#[derive(Debug, Clone)]
pub(super) struct Block {
    pub(super) a: Vec<f64>,
    pub(super) b: Vec<f64>,
    pub(super) c: f64,
    pub(super) n: f64,
}

fn huber(r: f64) -> f64 {
    let x = r.abs();
    if x <= HUBER {
        x * x
    } else {
        2.0 * HUBER * x - HUBER * HUBER
    }
}

/// Mean robust cost over groups; every group counts the same.
pub(super) fn cost(residuals: &[Vec<f64>]) -> f64 {
    let used: Vec<&Vec<f64>> = residuals.iter().filter(|g| !g.is_empty()).collect();
    let one = |g: &&Vec<f64>| g.iter().map(|r| huber(*r)).sum::<f64>() / g.len() as f64;
    used.iter().map(one).sum::<f64>() / used.len().max(1) as f64
}

/// Mean robust cost of every group.
pub(super) fn group_costs(residuals: &[Vec<f64>]) -> Vec<f64> {
    let one = |g: &Vec<f64>| g.iter().map(|r| huber(*r)).sum::<f64>() / g.len().max(1) as f64;
    residuals.iter().map(one).collect()
}

/// Lower triangular factor of a symmetric positive matrix of `n` rows.
pub(super) fn factor(a: &[f64], n: usize) -> Vec<f64> {
    let mut l = a.to_vec();
    for j in 0..n {
        let tiny = 1e-12 * a[j * n + j].abs().max(1e-30);
        for k in 0..j {
            let f = l[j * n + k];
            l[j * n + j] -= f * f;
        }
        let d = l[j * n + j].max(tiny).sqrt();
        l[j * n + j] = d;
        for i in j + 1..n {
            for k in 0..j {
                l[i * n + j] -= l[i * n + k] * l[j * n + k];
            }
            l[i * n + j] /= d;
        }
    }
    l
}

/// Divides errors by the factor `l` of their covariance: what remains is independent and of size one.
pub(super) fn whiten(l: &[f64], x: &mut [f64]) {
    let n = x.len();
    for i in 0..n {
        for k in 0..i {
            x[i] -= l[i * n + k] * x[k];
        }
        x[i] /= l[i * n + i];
    }
}

/// Solves `a x = b` for a symmetric positive matrix; zeros where it is singular or holds a value that is no number.
pub(super) fn solve(a: &[f64], b: &[f64]) -> Vec<f64> {
    let n = b.len();
    let l = factor(a, n);
    let mut x = b.to_vec();
    whiten(&l, &mut x);
    for i in (0..n).rev() {
        for k in i + 1..n {
            x[i] -= l[k * n + i] * x[k];
        }
        x[i] /= l[i * n + i];
    }
    if x.iter().all(|v| v.is_finite()) {
        x
    } else {
        vec![0.0; n]
    }
}

/// Normal equations of every group; `columns` are residuals after a step of each coordinate.
pub(super) fn blocks(r0: &[Vec<f64>], columns: &[Vec<Vec<f64>>], steps: &[f64]) -> Vec<Block> {
    let n = columns.len();
    let one = |(g, r): (usize, &Vec<f64>)| {
        let mut out = Block {
            a: vec![0.0; n * n],
            b: vec![0.0; n],
            c: 0.0,
            n: r.len() as f64,
        };
        let mut row = vec![0.0; n];
        for (i, r) in r.iter().enumerate() {
            let w = (HUBER / r.abs().max(HUBER)).min(1.0);
            for ((slot, column), h) in row.iter_mut().zip(columns).zip(steps) {
                *slot = (column[g][i] - r) / h;
            }
            for (j, x) in row.iter().enumerate() {
                out.b[j] += w * x * r;
                for (k, y) in row.iter().enumerate().take(j + 1) {
                    out.a[j * n + k] += w * x * y;
                }
            }
            out.c += huber(*r);
        }
        for j in 0..n {
            for k in 0..j {
                out.a[k * n + j] = out.a[j * n + k];
            }
        }
        out
    };
    r0.iter().enumerate().map(one).collect()
}

/// Sum of blocks, each divided by its samples.
pub(super) fn total(
    blocks: &[Block],
    take: &dyn Fn(usize) -> bool,
) -> (Vec<f64>, Vec<f64>, f64, f64) {
    let n = blocks.first().map_or(0, |b| b.b.len());
    let (mut a, mut b, mut c, mut groups) = (vec![0.0; n * n], vec![0.0; n], 0.0, 0.0);
    for (_, k) in blocks
        .iter()
        .enumerate()
        .filter(|(g, k)| k.n > 0.0 && take(*g))
    {
        a.iter_mut().zip(&k.a).for_each(|(x, y)| *x += y / k.n);
        b.iter_mut().zip(&k.b).for_each(|(x, y)| *x += y / k.n);
        c += k.c / k.n;
        groups += 1.0;
    }
    (a, b, c, groups)
}
