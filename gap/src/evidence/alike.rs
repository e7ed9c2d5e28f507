//! What all joints of a robot have alike, and robots without a cause differ by: found one after the other.

use rayon::prelude::*;

use super::block::{Block, Column, White};
use super::ensemble::{Spreads, name};

/// Passes of expectation and maximisation.
const PASSES: usize = 40;

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

impl Spreads {
    /// What all joints of a robot have alike: the differences that explain most, one after the other.
    pub(super) fn common(&self, robots: &[Vec<White>]) -> Vec<Alike> {
        let mut robots: Vec<Sums> = robots.par_iter().map(|r| self.sums(r)).collect();
        let mut names: Vec<String> = robots.iter().flat_map(|r| r.names.clone()).collect();
        names.retain(|n| !stated(n));
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
        let named: Vec<(Block, Vec<Vec<Named>>)> = joints
            .map(|w| {
                let names = w.columns.iter().map(|c| named(w, c)).collect();
                (self.taken_from(w, 0.0), names)
            })
            .collect();
        let all = named.iter().flat_map(|b| b.1.iter().flatten());
        out.names = all.map(|n| n.0.clone()).collect();
        out.names.sort_unstable();
        out.names.dedup();
        let n = out.names.len();
        out.products = vec![0.0; n * n];
        out.moments = vec![0.0; n];
        for (block, names) in &named {
            let at: Vec<(usize, usize, f64)> = names
                .iter()
                .enumerate()
                .flat_map(|(c, names)| names.iter().map(move |(n, by)| (c, n, *by)))
                .filter_map(|(c, n, by)| Some((c, out.names.binary_search(n).ok()?, by)))
                .collect();
            for (c, i, w) in &at {
                out.moments[*i] += w * block.moment[*c];
                for (d, j, v) in &at {
                    out.products[i * n + j] += w * v * block.product(*c, *d);
                }
            }
        }
        for name in out.names.clone().into_iter().filter(|n| stated(n)) {
            let (mean, spread) = (0.0, 1.0);
            out.take(&Alike { name, mean, spread });
        }
        out
    }
}

/// What a column is part of, and its weight there.
type Named = (String, f64);

/// What begins the name of a difference that the model states.
const STATED: &str = "stated ";

fn stated(name: &str) -> bool {
    name.starts_with(STATED)
}

/// The differences that a column of `block` is part of: what each joint has by itself, and what the model states of the robot.
fn named(block: &White, column: &Column) -> Vec<Named> {
    let own = name(&block.site, column).map(|n| (n, 1.0));
    let key = || {
        (
            format!("{STATED}{}", column.slack_key()),
            column.shared_slack,
        )
    };
    own.into_iter()
        .chain((column.shared_slack > 0.0).then(key))
        .collect()
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
