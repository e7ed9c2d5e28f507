//! Where the gap lies: what each cause explains of the errors, and what no cause explains beyond the noise.

use std::collections::BTreeMap;

use serde::Serialize;

use super::Explained;
use crate::evidence::block::{Block, Owner};
use crate::evidence::cause::Entries;
use crate::math::{self, Rng};
use crate::sentence;
use crate::vocabulary::{Effect, Stage};

/// A part of the gap.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Place {
    /// Stage of the cause; `unexplained` for what no cause explains.
    pub stage: &'static str,
    /// Joint; `null` for what the robot has once.
    pub joint: Option<usize>,
    /// Share of the squared errors, in units of their noise, which is taken off. All shares add up to one.
    pub share: f64,
    /// 95 % interval of the share, from the uncertainty of the causes' sizes; none where no cause is named.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
    /// The place in words.
    #[serde(skip)]
    pub plain: String,
}

impl Place {
    pub(super) fn new(stage: Option<Stage>, joint: Option<usize>, share: f64) -> Self {
        let which: Vec<usize> = joint.into_iter().collect();
        Self {
            stage: stage.map_or(UNEXPLAINED, Stage::name),
            joint,
            share,
            ci95: None,
            plain: sentence::place(stage, &which, true),
        }
    }
}

/// A stage, or what no cause explains, and a joint.
type Spot = (Option<Stage>, Option<usize>);

/// Draws from the posterior for an interval.
const DRAWS: usize = 100;

/// Stage of what no cause explains.
pub(in crate::whole) const UNEXPLAINED: &str = "unexplained";

impl Explained {
    /// Parts of the gap, largest first; none where no cause was found.
    pub(super) fn places(&self) -> Vec<Place> {
        let named = &self.found.best.members;
        if named.is_empty() {
            return Vec::new();
        }
        let problem = self.problem();
        let posterior = problem.posterior(named);
        let mut drawn: BTreeMap<Spot, Vec<f64>> = BTreeMap::new();
        let mut rng = Rng::new(0);
        for _ in 0..DRAWS {
            let latents = posterior.drawn(&mut rng);
            for (spot, share) in self.shares(problem.with_latents(named, &latents)) {
                drawn.entry(spot).or_default().push(share);
            }
        }
        let shares = self.shares(problem.by_member(named));
        let one = |(spot, share): (Spot, f64)| {
            let mut all = drawn.remove(&spot).unwrap_or_default();
            all.resize(DRAWS, 0.0);
            let [low, high] = [0.025, 0.975].map(|q| math::quantile(&all, q));
            Place {
                ci95: Some([low.min(share), high.max(share)]),
                ..Place::new(spot.0, spot.1, share)
            }
        };
        let mut out: Vec<Place> = shares.into_iter().map(one).collect();
        out.sort_by(|a, b| b.share.total_cmp(&a.share));
        out
    }

    /// Shares of the gap by place under the coefficients of each member and of what is always there.
    fn shares(&self, (members, always): (Vec<Entries>, Entries)) -> BTreeMap<Spot, f64> {
        let mut totals: Vec<Vec<f64>> = self
            .blocks
            .iter()
            .map(|b| vec![0.0; b.columns.len()])
            .collect();
        for (b, c, value) in members.iter().flatten().chain(&always) {
            totals[*b][*c] += value;
        }
        let mut sums: BTreeMap<Spot, f64> = BTreeMap::new();
        for (m, parts) in self.found.best.members.iter().zip(&members) {
            let stage = self.causes[*m].effect.map(Effect::stage);
            for (b, c, value) in parts {
                let block = &self.blocks[*b];
                let joint = match block.columns[*c].owner {
                    Owner::Block => block.site.joint,
                    Owner::Joint(k) => Some(k),
                    Owner::Robot => None,
                };
                let stage = stage.unwrap_or(block.site.stage);
                *sums.entry((Some(stage), joint)).or_default() +=
                    value * pull(block, *c, &totals[*b]);
            }
        }
        for (block, total) in self.blocks.iter().zip(&totals) {
            *sums.entry((None, block.site.joint)).or_default() += left(block, total);
        }
        sums.retain(|_, sum| *sum > 0.0);
        let all: f64 = sums.values().sum();
        sums.values_mut().for_each(|sum| *sum /= all);
        sums
    }
}

/// What a unit of column `c` takes off the squared errors beside all coefficients `total`: these sums over all columns
/// are what all together take off.
fn pull(block: &Block, c: usize, total: &[f64]) -> f64 {
    let beside: f64 = total
        .iter()
        .enumerate()
        .map(|(d, t)| t * block.product(c, d))
        .sum();
    2.0 * block.moment[c] - beside
}

/// Squared errors that the coefficients `total` leave beyond the noise.
fn left(block: &Block, total: &[f64]) -> f64 {
    let all = total.iter().enumerate();
    let taken: f64 = all.map(|(c, t)| t * pull(block, c, total)).sum();
    (block.square - taken - block.rows).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::block::{Column, Segment, Site, White};
    use crate::evidence::cause::causes;
    use crate::evidence::search::{Found, Set};
    use crate::math::sin;

    const ROWS: usize = 400;

    /// A joint with dry friction of `rubs`, and a wave of the size `waves` that no cause is taken for.
    fn joint(k: usize, [rubs, waves]: [f64; 2], rng: &mut Rng) -> Block {
        let side = |i: usize| if i % 40 < 20 { 1.0 } else { -1.0 };
        let wave = |i: usize| 2_f64.sqrt() * sin(0.3 * i as f64);
        let x = vec![
            (0..ROWS).map(side).collect(),
            (0..ROWS).map(wave).collect::<Vec<f64>>(),
        ];
        let y = |i: usize| rubs * side(i) + waves * wave(i) + rng.normal();
        let segment = Segment {
            y: (0..ROWS).map(y).collect(),
            x,
            weight: vec![1.0; ROWS],
        };
        let site = Site {
            stage: Stage::Drivetrain,
            joint: Some(k),
            blind: false,
            coarse: false,
        };
        let columns = vec![
            Column::linear(Effect::CoulombFriction, "torque_nm", 0.0, 2.0),
            Column::open(0, 2.0),
        ];
        White::whitened(site, columns, &[segment], [1.0, 1.0]).plain()
    }

    fn places(sizes: [[f64; 2]; 3], named: &[(Option<Effect>, usize)]) -> Vec<Place> {
        let mut rng = Rng::new(9);
        let blocks: Vec<Block> = (0..3).map(|k| joint(k, sizes[k], &mut rng)).collect();
        let causes = causes(&blocks, &[], &[]);
        let of = |(effect, k): &(Option<Effect>, usize)| {
            let own = causes
                .iter()
                .position(|c| c.effect == *effect && c.joints == [*k]);
            own.expect("a cause")
        };
        let found = Found {
            best: Set {
                members: named.iter().map(of).collect(),
                evidence: 0.0,
            },
            gains: Vec::new(),
            rivals: Vec::new(),
            next: None,
        };
        Explained {
            blocks,
            causes,
            always: Vec::new(),
            found,
            damping: [0.0; 2],
            fitted: Vec::new(),
        }
        .places()
    }

    #[test]
    fn shares_are_those_of_the_squares_and_add_up_to_one() {
        let dry = Some(Effect::CoulombFriction);
        // Squares of 4, 1 and, of no cause, 4.
        let found = places([[2.0, 0.0], [1.0, 2.0], [0.0; 2]], &[(dry, 0), (dry, 1)]);
        let all: f64 = found.iter().map(|p| p.share).sum();
        assert!((all - 1.0).abs() < 1e-12, "{found:?}");
        let share = |stage: &str, k: usize| {
            let own = found
                .iter()
                .find(|p| p.stage == stage && p.joint == Some(k));
            own.map_or(0.0, |p| p.share)
        };
        for (stage, k, square) in [
            ("drivetrain", 0, 4.0),
            ("drivetrain", 1, 1.0),
            ("unexplained", 1, 4.0),
        ] {
            let share = share(stage, k);
            assert!((share - square / 9.0).abs() < 0.06, "{stage} {k}: {share}");
        }
        assert!(share("unexplained", 2) < 0.03, "{found:?}");
    }

    #[test]
    fn a_shape_of_no_effect_lies_where_it_shows_and_nothing_lies_nowhere() {
        let found = places([[0.0; 2], [0.0, 2.0], [0.0; 2]], &[(None, 1)]);
        assert_eq!((found[0].stage, found[0].joint), ("drivetrain", Some(1)));
        assert_eq!(found[0].plain, "gear and load of joint 1");
        assert!(found[0].share > 0.9, "{found:?}");
        assert_eq!(places([[2.0, 0.0]; 3], &[]), []);
    }
}
