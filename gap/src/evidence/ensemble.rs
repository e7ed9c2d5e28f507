//! What robots without a cause differ by from the nominal model: the standard deviation of every column's coefficient,
//! learned from many of them.
//!
//! Errors of a robot without a cause are `y = X theta + n` with `theta_c ~ N(0, s_c^2)`: contacts of other simulators,
//! servos of another make, tolerances. Expectation and maximisation over all robots gives the `s_c` of most
//! likelihood (automatic relevance: MacKay 1992, Tipping 2001); a column that no robot needs goes to zero.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::alike::Alike;
use super::block::{Block, Column, Meaning, Site, White};
use super::cause::{Cause, Entries, always};
use super::linear::{backward, cholesky, dot, forward, inverse, inverse_diagonal, log_determinant};
use crate::vocabulary::Stage;

/// Passes; the slowest columns move by 1 % in the last one.
const PASSES: usize = 40;
/// Spread from which a column starts, as a share of its size where the effect is there.
const START: f64 = 0.3;
/// Fewest blocks that show how a column differs: one robot's joints.
const FEWEST: usize = 6;
/// Share of a column's size below which its spread is nothing.
const NOTHING: f64 = 1e-3;

/// Model error that learning starts from, as a share of the noise, and that of blocks without a calibration.
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
/// What robots have alike is looked for again after so many passes.
const COMMON: usize = 10;
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

    /// Logarithm of the likelihood of the moments under standard deviations `sd` around `mean`, where products count by
    /// the share `by`; but for what neither changes.
    fn likelihood(&self, [sd, mean]: [&[f64]; 2], by: f64) -> f64 {
        let c = mean.len();
        let n = c + 1;
        let (own, l, half) = factored_around(self.block, sd, mean, by);
        let explained: f64 = half.iter().map(|z| z * z).sum();
        let row = |a: usize| -> f64 {
            let by: f64 = (0..c)
                .map(|b| mean[b] * self.block.products[a * n + b])
                .sum();
            mean[a] * (2.0 * self.block.products[a * n + c] - by)
        };
        let taken: f64 = (0..c).map(row).sum();
        0.5 * (self.rank * libm::log(by) - log_determinant(&l, own.len()) + explained
            - by * (self.full - taken))
    }
}

/// Columns with a standard deviation `sd`, the factor of `1 + S G S` of them, and its half-solved moments; `by` is the
/// share by which products count.
pub(super) fn factored(block: &White, sd: &[f64], by: f64) -> (Vec<usize>, Vec<f64>, Vec<f64>) {
    factored_around(block, sd, &[], by)
}

/// The same where coefficients have a `mean`.
fn factored_around(
    block: &White,
    sd: &[f64],
    mean: &[f64],
    by: f64,
) -> (Vec<usize>, Vec<f64>, Vec<f64>) {
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
        let row = &block.products[p * n..p * n + n];
        z[i] = by * sd[*p] * (row[c] - dot(mean, &row[..mean.len()]));
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
    /// of its errors. A kind of block that no robot of the calibration had does not count.
    pub(super) fn share(&self, block: &White, explained: f64) -> f64 {
        let learned = self.model_error.get(&kind(&block.site)).copied();
        let error = learned.unwrap_or(FIRST_ERROR);
        match block.site.stage {
            _ if block.columns.len() == 1 => 1.0,
            // What healthy robots leave in such blocks is not known.
            _ if learned.is_none() && !self.model_error.is_empty() => 0.0,
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
        let mut count: BTreeMap<String, usize> = BTreeMap::new();
        for b in robots.iter().flatten().filter(|b| b.columns.len() > 1) {
            out.model_error.insert(kind(&b.site), FIRST_ERROR);
            for c in &b.columns {
                if let Some(n) = name(&b.site, c) {
                    *count.entry(n.clone()).or_default() += 1;
                    out.columns.insert(n, START * size(c));
                }
            }
        }
        out.columns.retain(|n, _| count[n] >= FEWEST);
        out.passes(robots, PASSES);
        for b in robots.iter().flatten() {
            for c in &b.columns {
                if let Some(n) = name(&b.site, c)
                    && out.columns.get(&n).is_some_and(|s| *s < NOTHING * size(c))
                {
                    out.columns.remove(&n);
                }
            }
        }
        out
    }

    /// What all but a few of the robots show, from what all of them showed.
    #[must_use]
    pub fn of_most(&self, robots: &[Vec<White>]) -> Self {
        let mut out = self.clone();
        out.passes(robots, COMMON);
        out
    }

    fn passes(&mut self, robots: &[Vec<White>], passes: usize) {
        let healthy: Vec<Vec<Healthy<'_>>> = robots
            .par_iter()
            .map(|r| {
                let own = r.iter().filter(|b| b.columns.len() > 1);
                own.map(Healthy::new).collect()
            })
            .collect();
        for pass in 1..=passes {
            self.pass(&healthy);
            if pass % AGAIN == 0 {
                self.look_for_error(&healthy);
            }
            if pass % COMMON == 0 {
                self.shared = self.common(robots);
            }
        }
    }

    /// One step of expectation and maximisation.
    fn pass(&mut self, robots: &[Vec<Healthy<'_>>]) {
        let seconds: Vec<Vec<(String, f64)>> =
            robots.par_iter().map(|r| self.expected(r)).collect();
        let mut sums: BTreeMap<String, (f64, f64)> = BTreeMap::new();
        for (n, square) in seconds.into_iter().flatten() {
            let slot = sums.entry(n).or_default();
            *slot = (slot.0 + square, slot.1 + 1.0);
        }
        for (n, (sum, count)) in sums {
            self.columns.insert(n, (sum / count).sqrt());
        }
    }

    /// What a block's coefficients are around, and by how much, where what robots have alike counts as the joint's own.
    fn around(&self, block: &White) -> [Vec<f64>; 2] {
        let mut sd = self.of(block);
        let mut mean = vec![0.0; sd.len()];
        for cause in always(std::iter::once((&block.site, &*block.columns)), self) {
            cause.latents[0]
                .iter()
                .for_each(|(_, c, w)| sd[*c] = libm::hypot(sd[*c], *w));
            cause.mean.iter().for_each(|(_, c, w)| mean[*c] += w);
        }
        [sd, mean]
    }

    /// The model error of most likelihood, near the last one.
    fn look_for_error(&mut self, robots: &[Vec<Healthy<'_>>]) {
        let own = robots.par_iter().flatten();
        let blocks: Vec<(&Healthy<'_>, [Vec<f64>; 2])> =
            own.map(|h| (h, self.around(h.block))).collect();
        let kinds: Vec<(String, f64)> = self.model_error.clone().into_iter().collect();
        for (kind, last) in kinds {
            let likelihood = |error: f64| -> f64 {
                let own = blocks.par_iter().filter(|h| h.0.kind == kind);
                let each: Vec<f64> = own
                    .map(|(h, [sd, mean])| h.likelihood([sd, mean], h.block.tempering(error, 0.0)))
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

    /// Expected squares of the coefficients that each joint of a robot has by itself.
    fn expected(&self, robot: &[Healthy<'_>]) -> Vec<(String, f64)> {
        let columns = robot.iter().map(|h| (&h.block.site, &*h.block.columns));
        let always = always(columns, self);
        let blocks: Vec<Taken> = robot
            .iter()
            .enumerate()
            .map(|(b, h)| {
                let (sd, by) = (self.of(h.block), self.share(h.block, 0.0));
                Taken::new(h.block, (sd, by), b, &always)
            })
            .collect();
        let k = always.len();
        let mut precision = vec![0.0; k * k];
        let mut moments = vec![0.0; k];
        (0..k).for_each(|i| precision[i * k + i] = 1.0);
        for taken in &blocks {
            taken.told(&mut precision, &mut moments, k);
        }
        let covariance = inverse(&cholesky(&precision, k), k);
        let mean: Vec<f64> = (0..k)
            .map(|i| dot(&covariance[i * k..(i + 1) * k], &moments))
            .collect();
        robot
            .iter()
            .zip(&blocks)
            .flat_map(|(h, taken)| taken.squares(h.block, &mean, &covariance))
            .collect()
    }
}

/// A block of a robot with what its joint has by itself taken out, for what the robot has alike.
struct Taken {
    sd: Vec<f64>,
    by: f64,
    own: Vec<usize>,
    l: Vec<f64>,
    /// Half-solved moments.
    half: Vec<f64>,
    /// What is alike here: its number, half-solved products, products with the others here, moment.
    alike: Vec<(usize, Vec<f64>, Vec<f64>, f64)>,
}

impl Taken {
    fn new(block: &White, (sd, by): (Vec<f64>, f64), at: usize, always: &[Cause]) -> Self {
        let c = block.columns.len();
        let n = c + 1;
        let of = |entries: &Entries| -> Vec<(usize, f64)> {
            let own = entries.iter().filter(|e| e.0 == at);
            own.map(|e| (e.1, e.2)).collect()
        };
        let mut mean = vec![0.0; c];
        for (i, w) in always.iter().flat_map(|a| of(&a.mean)) {
            mean[i] += w;
        }
        let (own, l, half) = factored_around(block, &sd, &mean, by);
        let latents = always.iter().enumerate();
        let here: Vec<(usize, Vec<(usize, f64)>)> = latents
            .map(|(k, a)| (k, of(&a.latents[0])))
            .filter(|h| !h.1.is_empty())
            .collect();
        let along = |entries: &[(usize, f64)], a: usize| -> f64 {
            let each = entries.iter().map(|(b, w)| w * block.products[a * n + b]);
            by * each.sum::<f64>()
        };
        let alike = here
            .iter()
            .map(|(k, entries)| {
                let mut z: Vec<f64> = own.iter().map(|p| sd[*p] * along(entries, *p)).collect();
                forward(&l, own.len(), &mut z);
                let with = |other: &[(usize, f64)]| -> f64 {
                    other.iter().map(|(a, w)| w * along(entries, *a)).sum()
                };
                let products = here.iter().map(|(_, other)| with(other)).collect();
                let moment: f64 = entries
                    .iter()
                    .map(|(a, w)| {
                        let row = &block.products[a * n..a * n + n];
                        w * by * (row[c] - dot(&mean, &row[..c]))
                    })
                    .sum();
                (*k, z, products, moment)
            })
            .collect();
        Self {
            sd,
            by,
            own,
            l,
            half,
            alike,
        }
    }

    /// Adds what the block says of what is alike to its precision and moments.
    fn told(&self, precision: &mut [f64], moments: &mut [f64], k: usize) {
        for (i, z, products, moment) in &self.alike {
            moments[*i] += moment - dot(z, &self.half);
            for ((j, other, _, _), product) in self.alike.iter().zip(products) {
                precision[i * k + j] += product - dot(z, other);
            }
        }
    }

    /// Expected squares of what the joint has by itself, where what is alike has this mean and covariance.
    fn squares(&self, block: &White, mean: &[f64], covariance: &[f64]) -> Vec<(String, f64)> {
        let (m, k) = (self.own.len(), mean.len());
        let mut off = self.half.clone();
        for (i, z, _, _) in &self.alike {
            off.iter_mut().zip(z).for_each(|(o, z)| *o -= mean[*i] * z);
        }
        backward(&self.l, m, &mut off);
        let mut variance = inverse_diagonal(&self.l, m);
        let responses: Vec<(usize, Vec<f64>)> = self
            .alike
            .iter()
            .map(|(i, z, _, _)| {
                let mut z = z.clone();
                backward(&self.l, m, &mut z);
                (*i, z)
            })
            .collect();
        for (i, a) in &responses {
            for (j, b) in &responses {
                let by = covariance[i * k + j];
                let both = a.iter().zip(b).map(|(a, b)| by * a * b);
                variance.iter_mut().zip(both).for_each(|(v, x)| *v += x);
            }
        }
        let n = block.columns.len() + 1;
        let own = self.own.iter().zip(off.iter().zip(&variance));
        own.filter_map(|(p, (mean, variance))| {
            let column = &block.columns[*p];
            // What a column cannot show in this block says nothing about its spread.
            let shows = block.products[p * n + p] * self.by * size(column).powi(2) > 1.0;
            let n = name(&block.site, column).filter(|_| shows)?;
            Some((n, self.sd[*p] * self.sd[*p] * (mean * mean + variance)))
        })
        .collect()
    }
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
        assert!((alike.spread - 0.5).abs() < 0.1, "{found:?}");
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
        assert!((alike.mean / 0.6 - 1.0).abs() < 0.05, "{found:?}");
        assert!((alike.spread - 0.1).abs() < 0.03, "{found:?}");
        // It is no joint's own.
        let own = found.columns.get("drivetrain.viscous_friction.nm_s_rad.0");
        assert!(own.is_none_or(|s| *s < 0.1), "{found:?}");
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
