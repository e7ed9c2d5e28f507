//! What robots without a cause differ by from the nominal model: the standard deviation of every column's coefficient,
//! learned from many of them.
//!
//! Errors of a robot without a cause are `y = X theta + n` with `theta_c ~ N(0, s_c^2)`: contacts of other simulators,
//! servos of another make, tolerances. Expectation and maximisation over all robots gives the `s_c` of most
//! likelihood (automatic relevance: MacKay 1992, Tipping 2001); a column that no robot needs goes to zero.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::block::{Block, Column, Meaning, Site, White};
use super::linear::{backward, cholesky, forward, inverse_diagonal, log_determinant};
use crate::vocabulary::Stage;

/// Passes; the slowest columns move by 1 % in the last one.
const PASSES: usize = 40;
/// Spread from which a column starts, as a share of its size where the effect is there.
const START: f64 = 0.3;
/// Fewest blocks that show how a column differs: one robot's joints.
const FEWEST: usize = 6;
/// Share of a column's size below which its spread is nothing.
const NOTHING: f64 = 1e-3;

/// Model error that the search starts from, and that of a kind of block that no robot of the calibration had, as a share
/// of the noise.
const FIRST_ERROR: f64 = 0.03;
/// The least model error of a servo, whose limits bend what is computed around one point. Chosen with robots of MuJoCo in
/// view (development seed 1); without it the strongest of 190 nulls rises from 27 to 579.
const BENT: f64 = 0.12;
/// Model error of what causes explain of the base, in any one direction, as a share of its square: contacts and play of
/// ours are not the robot's. Of most likelihood over what is left of development robots once their causes are in
/// (emulator, seed 7; MuJoCo, seed 1): six blocks, two of which weigh most. Servos and gears of the same robots ask for none.
const OTHER_LAW: f64 = 3e-4;
/// The model error is looked for again after so many passes, and this far around the last one.
const AGAIN: usize = 5;
const AROUND: [f64; 5] = [0.5, 0.7, 1.0, 1.4, 2.0];

/// Standard deviations by column, and errors that no column has.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Spreads {
    /// By name of the column, in units of its coefficient: of each joint by itself.
    pub columns: BTreeMap<String, f64>,
    /// What all joints of a robot have alike, in the order in which they were found.
    #[serde(default)]
    pub shared: Vec<Alike>,
    /// Model error in any one direction, as a share of the noise, by kind of block.
    #[serde(default)]
    pub model_error: BTreeMap<String, f64>,
}

/// What all joints of a robot have alike in one column of theirs.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Alike {
    /// Name of the column.
    pub name: String,
    /// What robots without a cause have in the middle: where a replay is wrong in one direction, in other simulators too.
    pub mean: f64,
    /// Standard deviation around it.
    pub spread: f64,
}

/// Logarithm of the likelihood ratio over all robots from which a difference counts as one that joints share, or its
/// mean as one.
const SHARED: f64 = 10.0;
/// Most of them.
const MOST: usize = 24;

/// Name of a kind of block: its stage, and what in it is a guess.
#[must_use]
pub fn kind(site: &Site) -> String {
    let blind = if site.blind { "blind_" } else { "" };
    let coarse = if site.coarse { "coarse_" } else { "" };
    format!("{blind}{coarse}{}", site.stage.name())
}

/// Name of a column: kind of its block, effect, parameter, shape.
#[must_use]
pub fn name(site: &Site, column: &Column) -> Option<String> {
    let what = match column.meaning {
        Meaning::Effect(e) => e.name(),
        Meaning::Open => "open",
        Meaning::Nuisance => return None,
    };
    let key = column.parameter.key;
    Some(format!("{}.{what}.{key}.{}", kind(site), column.shape))
}

/// A block of a robot without a cause, and what does not change while spreads are learned: directions that its columns
/// show, and what all of them explain of its errors.
struct Healthy<'a> {
    block: &'a White,
    kind: String,
    rank: f64,
    full: f64,
}

impl<'a> Healthy<'a> {
    fn new(block: &'a White) -> Self {
        let c = block.columns.len();
        let n = c + 1;
        let gram: Vec<f64> = (0..c)
            .flat_map(|a| block.products[a * n..a * n + c].to_vec())
            .collect();
        let moment: Vec<f64> = (0..c).map(|a| block.products[a * n + c]).collect();
        let (rank, full) = explained(&gram, &moment);
        Self {
            block,
            kind: kind(&block.site),
            rank,
            full,
        }
    }

    /// Logarithm of the likelihood of the moments under standard deviations `sd`, where products count by the share
    /// `by`; but for what neither changes.
    fn likelihood(&self, sd: &[f64], by: f64) -> f64 {
        let (own, l, half) = factored(self.block, sd, by);
        let explained: f64 = half.iter().map(|z| z * z).sum();
        0.5 * (self.rank * libm::log(by) - log_determinant(&l, own.len()) + explained
            - by * self.full)
    }
}

/// Columns with a standard deviation `sd`, the factor of `1 + S G S` of them, and its half-solved moments; `by` is the
/// share by which products count.
pub(super) fn factored(block: &White, sd: &[f64], by: f64) -> (Vec<usize>, Vec<f64>, Vec<f64>) {
    let c = block.columns.len();
    let n = c + 1;
    let own: Vec<usize> = (0..c).filter(|i| sd[*i] > 0.0).collect();
    let m = own.len();
    let mut a = vec![0.0; m * m];
    let mut z = vec![0.0; m];
    for (i, p) in own.iter().enumerate() {
        for (j, q) in own.iter().enumerate() {
            a[i * m + j] = by * sd[*p] * sd[*q] * block.products[p * n + q];
        }
        a[i * m + i] += 1.0;
        z[i] = by * sd[*p] * block.products[p * n + c];
    }
    let l = cholesky(&a, m);
    forward(&l, m, &mut z);
    (own, l, z)
}

/// Rank of a matrix of products, and the square of the errors along all its directions: a Cholesky factor with pivots.
fn explained(gram: &[f64], moment: &[f64]) -> (f64, f64) {
    const LEAST: f64 = 1e-9;
    let n = moment.len();
    let scale: Vec<f64> = (0..n)
        .map(|i| 1.0 / gram[i * n + i].max(1e-300).sqrt())
        .collect();
    let mut a: Vec<f64> = (0..n * n)
        .map(|k| gram[k] * scale[k / n] * scale[k % n])
        .collect();
    let mut z: Vec<f64> = moment.iter().zip(&scale).map(|(z, s)| z * s).collect();
    let mut left: Vec<usize> = (0..n).filter(|i| gram[i * n + i] > 1e-12).collect();
    let (mut rank, mut full) = (0.0, 0.0);
    while let Some(at) = (0..left.len())
        .max_by(|x, y| a[left[*x] * n + left[*x]].total_cmp(&a[left[*y] * n + left[*y]]))
    {
        let p = left.swap_remove(at);
        let pivot = a[p * n + p];
        if pivot < LEAST {
            break;
        }
        rank += 1.0;
        full += z[p] * z[p] / pivot;
        let row: Vec<f64> = left.iter().map(|j| a[p * n + j] / pivot).collect();
        for (i, by) in left.iter().zip(&row) {
            z[*i] -= by * z[p];
            for j in &left {
                a[i * n + j] -= by * a[p * n + j];
            }
        }
    }
    (rank, full)
}

fn size(column: &Column) -> f64 {
    column.prior[0].abs().max(column.prior[1])
}

impl Spreads {
    /// Standard deviations of all columns of a block where no cause is: what its model states, and what robots without
    /// a cause show.
    #[must_use]
    pub fn of(&self, block: &White) -> Vec<f64> {
        let one = |c: &Column| {
            let learned = name(&block.site, c).and_then(|n| self.columns.get(&n).copied());
            c.slack.max(learned.unwrap_or(0.0))
        };
        block.columns.iter().map(one).collect()
    }

    /// What all joints have alike in a column of theirs.
    #[must_use]
    pub fn alike(&self, site: &Site, column: &Column) -> Option<&Alike> {
        let own = name(site, column).filter(|_| site.joint.is_some())?;
        self.shared.iter().find(|s| s.name == own)
    }

    /// Share by which the products of a block count, for its model error, where causes explain the square `explained`
    /// of its errors.
    pub(super) fn share(&self, block: &White, explained: f64) -> f64 {
        let learned = self.model_error.get(&kind(&block.site)).copied();
        let error = learned.unwrap_or(FIRST_ERROR);
        match block.site.stage {
            _ if block.columns.len() == 1 => 1.0,
            Stage::Driver => block.tempering(error.max(BENT), 0.0),
            Stage::Body => block.tempering(error, OTHER_LAW * explained),
            _ => block.tempering(error, 0.0),
        }
    }

    /// A block without its nuisances, of whose errors causes explain the square `explained`.
    #[must_use]
    pub fn taken_from(&self, block: &White, explained: f64) -> Block {
        block.without_nuisances(&self.of(block), self.share(block, explained))
    }

    /// Learned from the blocks of robots without a cause.
    #[must_use]
    pub fn learned(robots: &[Vec<White>]) -> Self {
        let mut out = Self::default();
        let own = robots.par_iter().flatten();
        let blocks: Vec<Healthy<'_>> = own
            .filter(|b| b.columns.len() > 1)
            .map(Healthy::new)
            .collect();
        let mut count: BTreeMap<String, usize> = BTreeMap::new();
        for h in &blocks {
            out.model_error.insert(h.kind.clone(), FIRST_ERROR);
            for c in &h.block.columns {
                if let Some(n) = name(&h.block.site, c) {
                    *count.entry(n.clone()).or_default() += 1;
                    out.columns.insert(n, START * size(c));
                }
            }
        }
        out.columns.retain(|n, _| count[n] >= FEWEST);
        for pass in 1..=PASSES {
            out.pass(&blocks);
            if pass % AGAIN == 0 {
                out.look_for_error(&blocks);
            }
        }
        for h in &blocks {
            for c in &h.block.columns {
                if let Some(n) = name(&h.block.site, c)
                    && out.columns.get(&n).is_some_and(|s| *s < NOTHING * size(c))
                {
                    out.columns.remove(&n);
                }
            }
        }
        out.shared = out.common(robots);
        out
    }

    /// One step of expectation and maximisation.
    fn pass(&mut self, blocks: &[Healthy<'_>]) {
        let seconds: Vec<Vec<(String, f64)>> =
            blocks.par_iter().map(|h| self.expected(h.block)).collect();
        let mut sums: BTreeMap<String, (f64, f64)> = BTreeMap::new();
        for (n, square) in seconds.into_iter().flatten() {
            let slot = sums.entry(n).or_default();
            *slot = (slot.0 + square, slot.1 + 1.0);
        }
        for (n, (sum, count)) in sums {
            self.columns.insert(n, (sum / count).sqrt());
        }
    }

    /// The model error of most likelihood, near the last one.
    fn look_for_error(&mut self, blocks: &[Healthy<'_>]) {
        let kinds: Vec<(String, f64)> = self.model_error.clone().into_iter().collect();
        for (kind, last) in kinds {
            let likelihood = |error: f64| -> f64 {
                let own = blocks.par_iter().filter(|h| h.kind == kind);
                let each: Vec<f64> = own
                    .map(|h| h.likelihood(&self.of(h.block), h.block.tempering(error, 0.0)))
                    .collect();
                each.iter().sum()
            };
            let tried = AROUND.map(|by| (likelihood(last * by), last * by));
            let best = tried.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((_, error)) = best {
                self.model_error.insert(kind, error);
            }
        }
    }

    /// What all joints of a robot have alike: the differences that explain most, one after the other.
    fn common(&self, robots: &[Vec<White>]) -> Vec<Alike> {
        let mut robots: Vec<Sums> = robots.par_iter().map(|r| self.sums(r)).collect();
        let mut names: Vec<String> = robots.iter().flat_map(|r| r.names.clone()).collect();
        names.sort_unstable();
        names.dedup();
        let mut out: Vec<Alike> = Vec::new();
        while out.len() < MOST {
            let best = names
                .par_iter()
                .map(|n| {
                    let own: Vec<[f64; 2]> = robots.iter().filter_map(|r| r.of(n)).collect();
                    let [mean, spread] = likeliest(&own);
                    (likelihood(&own, [mean, spread]), n, [mean, spread])
                })
                .max_by(|a, b| a.0.total_cmp(&b.0).then_with(|| b.1.cmp(a.1)));
            let Some((_, n, [mean, spread])) = best.filter(|b| b.0 > SHARED) else {
                break;
            };
            let found = Alike {
                name: n.clone(),
                mean,
                spread,
            };
            robots.par_iter_mut().for_each(|r| r.take(&found));
            out.push(found);
        }
        out
    }

    /// Information of a robot's joints about what they have alike, what each has by itself taken out.
    fn sums(&self, robot: &[White]) -> Sums {
        let mut out = Sums::default();
        let joints = robot
            .iter()
            .filter(|b| b.site.joint.is_some() && b.columns.len() > 1);
        let named: Vec<(Block, Vec<Option<String>>)> = joints
            .map(|w| {
                let names = w.columns.iter().map(|c| name(&w.site, c)).collect();
                (self.taken_from(w, 0.0), names)
            })
            .collect();
        out.names = named
            .iter()
            .flat_map(|b| b.1.iter().flatten().cloned())
            .collect();
        out.names.sort_unstable();
        out.names.dedup();
        let n = out.names.len();
        out.products = vec![0.0; n * n];
        out.moments = vec![0.0; n];
        for (block, names) in &named {
            let at: Vec<Option<usize>> = names
                .iter()
                .map(|x| x.as_ref().and_then(|x| out.names.binary_search(x).ok()))
                .collect();
            for (c, i) in at.iter().enumerate() {
                let Some(i) = i else { continue };
                out.moments[*i] += block.moment[c];
                for (d, j) in at.iter().enumerate() {
                    if let Some(j) = j {
                        out.products[i * n + j] += block.product(c, d);
                    }
                }
            }
        }
        out
    }

    /// Expected squares of a block's coefficients.
    fn expected(&self, block: &White) -> Vec<(String, f64)> {
        let (spread, by) = (self.of(block), self.share(block, 0.0));
        let (own, l, mut mean) = factored(block, &spread, by);
        let m = own.len();
        let variance = inverse_diagonal(&l, m);
        backward(&l, m, &mut mean);
        let n = block.columns.len() + 1;
        own.iter()
            .enumerate()
            .filter_map(|(i, p)| {
                let square = mean[i] * mean[i] + variance[i];
                // What a column cannot show in this block says nothing about its spread.
                let shows = block.products[p * n + p] * by * size(&block.columns[*p]).powi(2) > 1.0;
                let n = name(&block.site, &block.columns[*p]).filter(|_| shows)?;
                Some((n, spread[*p] * spread[*p] * square))
            })
            .collect()
    }
}

/// Products and moments of a robot's columns, each summed over its joints.
#[derive(Debug, Default)]
struct Sums {
    names: Vec<String>,
    products: Vec<f64>,
    moments: Vec<f64>,
}

impl Sums {
    /// Product and moment of one column; `None` where it shows nothing.
    fn of(&self, name: &String) -> Option<[f64; 2]> {
        let i = self.names.binary_search(name).ok()?;
        let product = self.products[i * self.names.len() + i];
        (product > 0.0).then_some([product, self.moments[i]])
    }

    /// Takes out what robots have alike.
    fn take(&mut self, alike: &Alike) {
        let Ok(k) = self.names.binary_search(&alike.name) else {
            return;
        };
        let n = self.names.len();
        let row = self.products[k * n..(k + 1) * n].to_vec();
        for (moment, product) in self.moments.iter_mut().zip(&row) {
            *moment -= alike.mean * product;
        }
        let by = 1.0 / (row[k] + 1.0 / (alike.spread * alike.spread));
        let moment = self.moments[k];
        for i in 0..n {
            self.moments[i] -= by * row[i] * moment;
            for j in 0..n {
                self.products[i * n + j] -= by * row[i] * row[j];
            }
        }
    }
}

/// Logarithm of the likelihood of a mean and a spread over that of none.
fn likelihood(robots: &[[f64; 2]], [mean, spread]: [f64; 2]) -> f64 {
    let variance = spread * spread;
    let one = |[product, moment]: &[f64; 2]| {
        let of = 1.0 + variance * product;
        let off = moment - mean * product;
        mean * moment - 0.5 * mean * mean * product + 0.5 * variance * off * off / of
            - 0.5 * libm::log(of)
    };
    robots.iter().map(one).sum()
}

/// The mean and the spread of most likelihood; no mean where it is none by far.
fn likeliest(robots: &[[f64; 2]]) -> [f64; 2] {
    let [plain, with] = [false, true].map(|free| maximised(robots, free));
    let gain = likelihood(robots, with) - likelihood(robots, plain);
    if gain > SHARED { with } else { plain }
}

/// Expectation and maximisation from a spread that shows well; the mean is `free` or none.
fn maximised(robots: &[[f64; 2]], free: bool) -> [f64; 2] {
    let count = robots.len().max(1) as f64;
    let shown: f64 = robots.iter().map(|r| r[0]).sum::<f64>() / count;
    let (mut mean, mut variance) = (0.0, 100.0 / shown.max(1e-300));
    for _ in 0..PASSES {
        let one = |[product, moment]: &[f64; 2]| {
            let of = 1.0 / (product + 1.0 / variance);
            [of * (moment + mean / variance), of]
        };
        let all: Vec<[f64; 2]> = robots.iter().map(one).collect();
        if free {
            mean = all.iter().map(|x| x[0]).sum::<f64>() / count;
        }
        let square = |x: &[f64; 2]| x[1] + (x[0] - mean) * (x[0] - mean);
        variance = all.iter().map(square).sum::<f64>() / count;
    }
    [mean, variance.sqrt()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::block::Segment;
    use crate::math::Rng;
    use crate::vocabulary::{Effect, Stage};

    const ROWS: usize = 300;

    /// A joint whose errors hold `sizes` of dry and of viscous friction beside noise of the size `noise`.
    fn joint(k: usize, sizes: [f64; 2], noise: f64, rng: &mut Rng) -> White {
        let n = ROWS;
        let side = |i: usize| if i % 40 < 20 { 1.0 } else { -1.0 };
        let speed = |i: usize| crate::math::sin(0.157 * i as f64);
        let x: Vec<Vec<f64>> = vec![(0..n).map(side).collect(), (0..n).map(speed).collect()];
        let y = |i: usize| sizes[0] * x[0][i] + sizes[1] * x[1][i] + noise * rng.normal();
        let segment = Segment {
            y: (0..n).map(y).collect(),
            x,
            weight: vec![1.0; n],
        };
        let columns = vec![
            Column::linear(Effect::CoulombFriction, "torque_nm", 0.0, 1.0),
            Column::linear(Effect::ViscousFriction, "nm_s_rad", 0.0, 1.0),
        ];
        let site = Site {
            stage: Stage::Drivetrain,
            joint: Some(k),
            blind: false,
            coarse: false,
        };
        White::whitened(site, columns, &[segment], [1.0, 1.0])
    }

    #[test]
    fn spreads_of_joints_and_of_robots_are_found_again() {
        let mut rng = Rng::new(21);
        // Dry friction differs between joints by 0.4, viscous friction between robots by 0.5.
        let robots: Vec<Vec<White>> = (0..80)
            .map(|_| {
                let alike = 0.5 * rng.normal();
                (0..6)
                    .map(|k| joint(k, [0.4 * rng.normal(), alike], 1.0, &mut rng))
                    .collect()
            })
            .collect();
        let found = Spreads::learned(&robots);
        let dry = found.columns["drivetrain.coulomb_friction.torque_nm.0"];
        assert!((dry - 0.4).abs() < 0.04, "{found:?}");
        let [alike] = found.shared.as_slice() else {
            panic!("{found:?}");
        };
        assert_eq!(alike.name, "drivetrain.viscous_friction.nm_s_rad.0");
        assert!((alike.spread - 0.5).abs() < 0.15, "{found:?}");
        assert_eq!(alike.mean, 0.0, "{found:?}");
    }

    #[test]
    fn what_all_robots_have_in_one_direction_is_their_mean() {
        let mut rng = Rng::new(23);
        let robots: Vec<Vec<White>> = (0..80)
            .map(|_| {
                let alike = 0.6 + 0.1 * rng.normal();
                (0..6)
                    .map(|k| joint(k, [0.4 * rng.normal(), alike], 1.0, &mut rng))
                    .collect()
            })
            .collect();
        let found = Spreads::learned(&robots);
        let [alike] = found.shared.as_slice() else {
            panic!("{found:?}");
        };
        // Each joint's own spread takes a part of what all have, seen joint by joint.
        assert!((alike.mean / 0.6 - 1.0).abs() < 0.15, "{found:?}");
        assert!(alike.spread < 0.2, "{found:?}");
    }

    #[test]
    fn a_model_error_is_found_again_and_none_where_there_is_none() {
        let learned = |noise: f64| {
            let mut rng = Rng::new(22);
            let mut robot = || {
                let mut own = |k| joint(k, [0.4 * rng.normal(), 0.0], noise, &mut rng);
                (0..6).map(&mut own).collect()
            };
            let robots: Vec<Vec<White>> = (0..40).map(|_| robot()).collect();
            Spreads::learned(&robots).model_error["drivetrain"]
        };
        assert!(learned(1.0) < 0.01, "{}", learned(1.0));
        // Moments of N rows spread as if the noise were (1 + N delta^2)^(1/2) times as large.
        let delta = 0.1;
        let noise = (1.0 + ROWS as f64 * delta * delta).sqrt();
        assert!(
            (learned(noise) / delta - 1.0).abs() < 0.4,
            "{}",
            learned(noise)
        );
    }
}
