//! Upper tails of what robots without a cause show and leave.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::{LEAST, Shown};
use crate::math;

/// Middle and upper tail of the evidence that robots without a cause show for one effect.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tail {
    /// Median of the evidence.
    pub middle: f64,
    /// Mean of its largest values ([`TAIL`] of all), less the median.
    pub reach: f64,
    /// What counts as one beyond the tail; of files that do not say so, the reach.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<f64>,
}

impl Tail {
    /// The evidence as it is.
    const PLAIN: Self = Self {
        middle: 0.0,
        reach: 1.0,
        unit: None,
    };

    fn of(evidence: &[f64]) -> Self {
        let mut sorted = evidence.to_vec();
        sorted.sort_by(|a, b| b.total_cmp(a));
        let top = ((TAIL * sorted.len() as f64) as usize).max(1);
        let middle = math::median(evidence);
        Self {
            middle,
            reach: (math::mean(&sorted[..top]) - middle).max(1.0),
            unit: Some(1.0),
        }
    }

    /// One at the end of the tail, and one more a unit beyond it.
    pub(super) fn standard(self, evidence: f64) -> f64 {
        1.0 + (evidence - self.middle - self.reach) / self.unit.unwrap_or(self.reach)
    }

    pub(super) fn evidence(self, standard: f64) -> f64 {
        self.middle + self.reach + (standard - 1.0) * self.unit.unwrap_or(self.reach)
    }
}

/// Tail of an effect by what shows it, else of the effect; the widest of all for one that no robot of the calibration
/// could show.
pub(super) fn tail(tails: &BTreeMap<String, Tail>, shown: &Shown) -> Tail {
    let widest = || {
        let reach = |t: &&Tail| t.middle + t.reach;
        let all = tails.values();
        all.max_by(|a, b| reach(a).total_cmp(&reach(b)))
    };
    let own = tails.get(&shown.key()).or_else(|| tails.get(shown.name()));
    own.or_else(widest).copied().unwrap_or(Tail::PLAIN)
}

/// All but number `i`.
fn others<T>(all: &[T], i: usize) -> Vec<&T> {
    let other = all.iter().enumerate().filter(|o| o.0 != i);
    other.map(|o| o.1).collect()
}

/// Tails of every effect, and by what shows it where enough robots have that.
pub(super) fn tails(robots: &[&BTreeMap<Shown, f64>]) -> BTreeMap<String, Tail> {
    let mut values: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    let mut effects = BTreeSet::new();
    for (shown, evidence) in robots.iter().copied().flatten() {
        effects.insert(shown.name());
        for key in [shown.name().to_owned(), shown.key()] {
            values.entry(key).or_default().push(*evidence);
        }
    }
    let all = values
        .into_iter()
        .filter(|(key, v)| v.len() >= LEAST || effects.contains(key.as_str()));
    all.map(|(key, evidence)| (key, Tail::of(&evidence)))
        .collect()
}

/// Stands between a kind of block and what puts it out, in a kind that says both.
pub(super) const BY: &str = " by ";

/// The kind of a block without what puts it out.
fn plain(kind: &str) -> &str {
    kind.split_once(BY).map_or(kind, |k| k.0)
}

/// Tails of what is left in blocks, dB, by kinds that enough robots have, and by those without what puts them out.
pub(super) fn lefts(robots: &[&Vec<(String, f64)>]) -> BTreeMap<String, Tail> {
    let mut values: BTreeMap<&str, (usize, Vec<f64>)> = BTreeMap::new();
    for robot in robots {
        let own = robot.iter();
        let both = own.flat_map(|(k, left)| {
            BTreeSet::from([k.as_str(), plain(k)])
                .into_iter()
                .map(move |k| (k, *left))
        });
        let both: Vec<(&str, f64)> = both.collect();
        let kinds: BTreeSet<&str> = both.iter().map(|r| r.0).collect();
        kinds
            .into_iter()
            .for_each(|k| values.entry(k).or_default().0 += 1);
        for (kind, left) in both {
            values.entry(kind).or_default().1.push(left);
        }
    }
    let enough = values.into_iter().filter(|v| v.1.0 >= LEAST);
    enough
        .map(|(kind, (_, all))| (kind.to_owned(), Tail::of(&all)))
        .collect()
}

/// The tail of a kind, or of the kind without what puts it out.
pub(super) fn left<'a>(lefts: &'a BTreeMap<String, Tail>, kind: &str) -> Option<&'a Tail> {
    lefts.get(kind).or_else(|| lefts.get(plain(kind)))
}

/// Largest evidence of each robot over all effects, beyond the tails of the others.
pub(super) fn beyond_tails(robots: &[BTreeMap<Shown, f64>]) -> Vec<f64> {
    let one = |(i, robot): (usize, &BTreeMap<Shown, f64>)| {
        let tails = tails(&others(robots, i));
        let standard = robot.iter().map(|(s, x)| tail(&tails, s).standard(*x));
        standard.fold(f64::NEG_INFINITY, f64::max)
    };
    robots.iter().enumerate().map(one).collect()
}

/// The most that is left over all kinds, beyond their tails. What is less by more than a unit of each counts as nothing:
/// how little is left decides nothing.
pub(super) fn most(lefts: &BTreeMap<String, Tail>, robot: &[(String, f64)]) -> f64 {
    let one = |(kind, db): &(String, f64)| Some(left(lefts, kind)?.standard(*db));
    robot.iter().filter_map(one).fold(0.0, f64::max)
}

/// The most that each robot leaves over all kinds, beyond the tails of the others.
pub(super) fn remainders(robots: &[Vec<(String, f64)>]) -> Vec<f64> {
    let one = |(i, robot): (usize, &Vec<(String, f64)>)| most(&lefts(&others(robots, i)), robot);
    robots.iter().enumerate().map(one).collect()
}

/// Share of the values that make a tail.
const TAIL: f64 = 0.05;
