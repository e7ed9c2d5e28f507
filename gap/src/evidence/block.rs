//! Blocks of prediction errors and their columns.

use super::linear::{cholesky, dot, forward};
use super::noise;
pub use super::plays::Noisy;
use crate::vocabulary::{Effect, Stage};

/// Where a block of prediction errors was cut out of the chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Site {
    /// Stage whose output is compared.
    pub stage: Stage,
    /// Joint; `None` for what the robot has once.
    pub joint: Option<usize>,
    /// The loads in it are guesses, because no pose of the base was recorded.
    pub blind: bool,
    /// It stands on duties, which change between two rows.
    pub coarse: bool,
}

/// What a column stands for.
#[derive(Debug, Clone, PartialEq)]
pub enum Meaning {
    /// An effect of the vocabulary.
    Effect(Effect),
    /// A shape that no effect of the library has: what it explains is a remainder.
    Open,
    /// What simulators or parts differ by.
    Nuisance,
}

/// One parameter that a coefficient moves: `value = neutral + scale * coefficient`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Key of the effect's parameter.
    pub key: &'static str,
    /// Value at which the effect is off.
    pub neutral: f64,
    /// Change of the value per coefficient.
    pub scale: f64,
}

/// One column of a block.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// What it stands for.
    pub meaning: Meaning,
    /// Number of the shape: columns of one effect and one shape belong to one cause.
    pub shape: usize,
    /// Parameters that the coefficient moves.
    pub parameter: Parameter,
    /// Parameters that the shape fixes.
    pub fixed: Vec<(&'static str, f64)>,
    /// Mean and standard deviation of the coefficient where the effect is there.
    pub prior: [f64; 2],
    /// Standard deviation of the coefficient where it is not: what simulators and parts differ by.
    pub slack: f64,
    /// The coefficient cannot be negative.
    pub positive: bool,
    /// Whose coefficient it is.
    pub owner: Owner,
    /// Standard deviation of what simulators differ by in all blocks alike, and by which key.
    pub shared_slack: f64,
    /// Name of that difference; empty where it is the parameter itself.
    pub slack_key: &'static str,
    /// What the choice of the shape costs, in units of the logarithm of the evidence.
    pub cost: f64,
}

/// Whose a coefficient is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Owner {
    /// The joint of the block.
    Block,
    /// Joint so and so, in a block that several share.
    Joint(usize),
    /// The robot's, whatever the joint of the block.
    Robot,
}

impl Column {
    /// What simulators or parts differ by, one standard deviation.
    #[must_use]
    pub fn nuisance(slack: f64) -> Self {
        Self {
            meaning: Meaning::Nuisance,
            shape: 0,
            parameter: Parameter {
                key: "",
                neutral: 0.0,
                scale: 1.0,
            },
            fixed: Vec::new(),
            prior: [0.0, slack],
            slack,
            positive: false,
            owner: Owner::Block,
            shared_slack: 0.0,
            slack_key: "",
            cost: 0.0,
        }
    }

    /// A parameter whose coefficient is its change: off at `neutral`, of the size `sd` where it is there.
    #[must_use]
    pub fn linear(effect: Effect, key: &'static str, neutral: f64, sd: f64) -> Self {
        Self {
            meaning: Meaning::Effect(effect),
            parameter: Parameter {
                key,
                neutral,
                scale: 1.0,
            },
            prior: [0.0, sd],
            slack: 0.0,
            ..Self::nuisance(1.0)
        }
    }

    /// A shape played at `value`: the coefficient is the share of it, one where the value is right.
    #[must_use]
    pub fn played(
        effect: Effect,
        key: &'static str,
        neutral: f64,
        value: f64,
        shape: usize,
    ) -> Self {
        Self {
            meaning: Meaning::Effect(effect),
            shape,
            parameter: Parameter {
                key,
                neutral,
                scale: value - neutral,
            },
            prior: [1.0, BETWEEN],
            slack: 0.0,
            positive: true,
            ..Self::nuisance(1.0)
        }
    }

    /// A shape that no effect of the library has.
    #[must_use]
    pub fn open(shape: usize, sd: f64) -> Self {
        Self {
            meaning: Meaning::Open,
            shape,
            prior: [0.0, sd],
            slack: 0.0,
            ..Self::nuisance(1.0)
        }
    }

    /// The same with what simulators and parts differ by.
    #[must_use]
    pub fn with_slack(self, slack: f64) -> Self {
        Self { slack, ..self }
    }

    /// The same with what simulators differ by in all blocks alike.
    #[must_use]
    pub fn with_shared_slack(self, slack_key: &'static str, shared_slack: f64) -> Self {
        Self {
            shared_slack,
            slack_key,
            ..self
        }
    }

    /// The same with another shape number.
    #[must_use]
    pub fn shaped(self, shape: usize, fixed: &[(&'static str, f64)]) -> Self {
        Self {
            shape,
            fixed: fixed.to_vec(),
            ..self
        }
    }

    /// The same for a coefficient that cannot be negative.
    #[must_use]
    pub fn at_least_neutral(self) -> Self {
        Self {
            positive: true,
            ..self
        }
    }

    /// The same for a coefficient of joint `k` in a block that several share.
    #[must_use]
    pub fn of_joint(self, k: usize) -> Self {
        Self {
            owner: Owner::Joint(k),
            ..self
        }
    }

    /// Name of what blocks share.
    #[must_use]
    pub fn slack_key(&self) -> String {
        let own = match self.meaning {
            Meaning::Effect(e) if self.slack_key.is_empty() => e.name(),
            _ => return self.slack_key.into(),
        };
        format!("{own}.{}.{}", self.parameter.key, self.shape)
    }

    /// The same for a coefficient that the robot has once.
    #[must_use]
    pub fn of_robot(self) -> Self {
        Self {
            owner: Owner::Robot,
            ..self
        }
    }
}

/// Standard deviation of the share of a played shape: neighbours of a grid stand a factor of 1.4 to 2 apart, and a
/// size between two of them is that share of the nearer one.
const BETWEEN: f64 = 0.25;

/// Prediction errors of one run, in order of time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Segment {
    /// Measured less predicted.
    pub y: Vec<f64>,
    /// Change of the prediction per coefficient, by column.
    pub x: Vec<Vec<f64>>,
    /// Weight of each row, 0 to 1.
    pub weight: Vec<f64>,
}

/// A block before its noise is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Raw {
    /// Where it was cut.
    pub site: Site,
    /// Its columns.
    pub columns: Vec<Column>,
    /// Its runs.
    pub segments: Vec<Segment>,
    /// What two simulators differ by from one row to the next, one standard deviation in the unit of the signal.
    pub floor: f64,
    /// Columns that are means of plays which differ.
    pub noisy: Vec<Noisy>,
}

/// A whitened block without its nuisances: products of columns and errors.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// Where it was cut.
    pub site: Site,
    /// Its columns.
    pub columns: Vec<Column>,
    /// Rows that count, by the share that the model error leaves them.
    pub rows: f64,
    /// Products of columns, row-major.
    pub gram: Vec<f64>,
    /// Products of columns and errors.
    pub moment: Vec<f64>,
    /// Square of the errors.
    pub square: f64,
    /// Standard deviation of one-step prediction errors, in the unit of the signal.
    pub noise: f64,
    /// Root mean square of the errors before whitening, in the unit of the signal.
    pub before: f64,
    /// Root mean square of what no column explains, in units of the noise; of errors that are no independent rows from the start,
    /// without the noise.
    pub left: f64,
}

/// Weighted products of all columns, the errors being the last one.
pub(super) fn products(segments: &[Segment], columns: usize) -> Vec<f64> {
    let n = columns + 1;
    let mut out = vec![0.0; n * n];
    let mut row = vec![0.0; n];
    for s in segments {
        for i in 0..s.y.len() {
            let w = s.weight[i];
            if w == 0.0 {
                continue;
            }
            let root = w.sqrt();
            for (slot, x) in row.iter_mut().zip(&s.x) {
                *slot = root * x[i];
            }
            row[columns] = root * s.y[i];
            for a in 0..n {
                let left = row[a];
                if left != 0.0 {
                    let into = &mut out[a * n..a * n + a + 1];
                    into.iter_mut().zip(&row).for_each(|(o, r)| *o += left * r);
                }
            }
        }
    }
    for a in 0..n {
        for b in a + 1..n {
            out[a * n + b] = out[b * n + a];
        }
    }
    out
}

/// Removes from `all` (of `n` columns) what columns with a slack explain within it: the Schur complement.
fn eliminate(all: &mut [f64], n: usize, slack: &[f64]) {
    let own: Vec<usize> = (0..slack.len()).filter(|c| slack[*c] > 0.0).collect();
    let m = own.len();
    if m == 0 {
        return;
    }
    let mut inner = vec![0.0; m * m];
    for (i, a) in own.iter().enumerate() {
        for (j, b) in own.iter().enumerate() {
            inner[i * m + j] = slack[*a] * slack[*b] * all[a * n + b];
        }
        inner[i * m + i] += 1.0;
    }
    let l = cholesky(&inner, m);
    let mut solved = vec![vec![0.0; m]; n];
    for (c, x) in solved.iter_mut().enumerate() {
        for (slot, a) in x.iter_mut().zip(&own) {
            *slot = slack[*a] * all[a * n + c];
        }
        forward(&l, m, x);
    }
    for a in 0..n {
        for b in 0..n {
            all[a * n + b] -= dot(&solved[a], &solved[b]);
        }
    }
}

/// Squared errors that all `columns` together leave, under their priors.
fn remainder(products: &[f64], columns: &[Column]) -> f64 {
    let n = columns.len() + 1;
    let theta = noise::saturated_by(products, columns);
    let taken: f64 = (0..columns.len())
        .map(|a| {
            let by: f64 = (0..columns.len())
                .map(|b| theta[b] * products[a * n + b])
                .sum();
            theta[a] * (2.0 * products[a * n + n - 1] - by)
        })
        .sum();
    (products[n * n - 1] - taken).max(0.0)
}

/// A whitened block with its nuisances.
#[derive(Debug, Clone, PartialEq)]
pub struct White {
    /// Where it was cut.
    pub site: Site,
    /// Its columns.
    pub columns: Vec<Column>,
    /// Rows that count.
    pub rows: f64,
    /// Products of columns and, last, of the errors: row-major.
    pub products: Vec<f64>,
    /// Standard deviation of one-step prediction errors, in the unit of the signal.
    pub noise: f64,
    /// Root mean square of the errors before whitening, in the unit of the signal.
    pub before: f64,
    /// Root mean square of what no column explains, in units of the noise; of errors that are no independent rows from the start,
    /// without the noise.
    pub left: f64,
}

impl White {
    /// Whitens `raw` by an autoregression of order `order`.
    #[must_use]
    pub fn new(raw: Raw, order: usize) -> Self {
        let before = root_mean_square(&raw.segments);
        let raw = raw.calibrated();
        let (segments, white) = noise::whiten(&raw.segments, &raw.columns, order, raw.floor);
        let noise = white.noise;
        Self {
            left: white.slow / noise,
            ..Self::whitened(raw.site, raw.columns, &segments, [noise, before])
        }
    }

    /// From errors that are independent and of size one; `noise` and `before` in the unit of the signal.
    #[must_use]
    pub fn whitened(
        site: Site,
        columns: Vec<Column>,
        segments: &[Segment],
        [noise, before]: [f64; 2],
    ) -> Self {
        let rows: f64 = segments.iter().flat_map(|s| &s.weight).sum();
        let products = products(segments, columns.len());
        Self {
            site,
            rows,
            left: (remainder(&products, &columns) / rows.max(1.0)).sqrt(),
            products,
            columns,
            noise,
            before,
        }
    }

    /// Share by which all that the block says counts where `share` of its noise may be model error in any one direction.
    /// No number of rows averages model error away: along a direction the errors have the variance
    /// `1 + rows share^2`, and `more`.
    #[must_use]
    pub fn tempering(&self, share: f64, more: f64) -> f64 {
        1.0 / (1.0 + self.rows * share * share + more)
    }

    /// Square of what columns with the coefficients `by` give, in units of the noise.
    #[must_use]
    pub fn explained(&self, by: &[(usize, f64)]) -> f64 {
        let n = self.columns.len() + 1;
        let row = |a: usize| -> f64 { by.iter().map(|(b, v)| v * self.products[a * n + b]).sum() };
        by.iter().map(|(a, v)| v * row(*a)).sum()
    }

    /// The block without its nuisances: columns have the standard deviation `slack` where no cause is; products count
    /// by the share `by`.
    #[must_use]
    pub fn without_nuisances(&self, slack: &[f64], by: f64) -> Block {
        let c = self.columns.len();
        let n = c + 1;
        let mut all: Vec<f64> = self.products.iter().map(|x| x * by).collect();
        eliminate(&mut all, n, slack);
        let mut columns = self.columns.clone();
        columns.iter_mut().for_each(|c| c.cost *= by);
        let gram = (0..c)
            .flat_map(|a| all[a * n..a * n + c].to_vec())
            .collect();
        Block {
            site: self.site,
            rows: by * self.rows,
            gram,
            moment: (0..c).map(|a| all[a * n + c]).collect(),
            square: all[n * n - 1],
            columns,
            noise: self.noise,
            before: self.before,
            left: self.left,
        }
    }

    /// The block without the nuisances that its columns name themselves.
    #[must_use]
    pub fn plain(&self) -> Block {
        let slack: Vec<f64> = self.columns.iter().map(|c| c.slack).collect();
        self.without_nuisances(&slack, 1.0)
    }
}

impl Block {
    /// Product of two columns.
    #[must_use]
    pub fn product(&self, a: usize, b: usize) -> f64 {
        self.gram[a * self.columns.len() + b]
    }
}

/// Root mean square of the errors.
pub(super) fn root_mean_square(segments: &[Segment]) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for s in segments {
        for (y, w) in s.y.iter().zip(&s.weight) {
            sum += w * y * y;
            n += w;
        }
    }
    if n > 0.0 { (sum / n).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(slack: f64) -> Column {
        Column {
            prior: [0.0, 1.0],
            ..Column::nuisance(slack)
        }
    }

    #[test]
    fn a_nuisance_of_wide_prior_takes_its_direction_out() {
        let segment = Segment {
            y: vec![3.0, 4.0],
            x: vec![vec![1.0, 0.0], vec![1.0, 1.0]],
            weight: vec![1.0, 1.0],
        };
        let site = Site {
            stage: Stage::Driver,
            joint: None,
            blind: false,
            coarse: false,
        };
        let columns = vec![column(1e6), column(0.0)];
        let block = White::whitened(site, columns, &[segment], [1.0, 1.0]).plain();
        // Only the second row is left: errors 4, second column 1.
        assert!((block.square - 16.0).abs() < 1e-4, "{}", block.square);
        assert!((block.product(1, 1) - 1.0).abs() < 1e-4);
        assert!((block.moment[1] - 4.0).abs() < 1e-4);
    }
}
