//! Causes: an effect with a scope, as a Gaussian prior over coefficients.

use std::collections::{BTreeMap, BTreeSet};

use super::block::{Block, Column, Meaning, Owner, Site};
use super::ensemble::{Spreads, kind};
use crate::vocabulary::Effect;

/// Who has a cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// Every joint.
    All,
    /// The joints of one kind of motor.
    Kind,
    /// The joints of one module.
    Module,
    /// One joint.
    Joint,
    /// What the robot has once.
    Robot,
}

/// A group of joints that may share a cause.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// What they are together.
    pub scope: Scope,
    /// Joints, in order.
    pub joints: Vec<usize>,
}

/// A coefficient: a column of a block, or the same coefficient in several.
pub type Entries = Vec<(usize, usize, f64)>;

/// One number that a cause sets.
#[derive(Debug, Clone, PartialEq)]
pub struct Number {
    /// Joint; `None` for what the robot has once.
    pub joint: Option<usize>,
    /// Key of the effect's parameter.
    pub key: &'static str,
    /// Value without the cause.
    pub neutral: f64,
    /// Change of the value per coefficient.
    pub scale: f64,
    /// Prior mean of the coefficient.
    pub mean: f64,
    /// Weights of the latent numbers in the coefficient.
    pub of_latents: Vec<(usize, f64)>,
}

/// A cause.
#[derive(Debug, Clone, PartialEq)]
pub struct Cause {
    /// Effect; `None` is a shape that no effect of the library has.
    pub effect: Option<Effect>,
    /// Who has it.
    pub scope: Scope,
    /// Joints that have it, in order; empty for what the robot has once.
    pub joints: Vec<usize>,
    /// Parameters that the shape fixes.
    pub fixed: Vec<(&'static str, f64)>,
    /// Latent numbers, each standard normal, as coefficients.
    pub latents: Vec<Entries>,
    /// Prior mean of the coefficients.
    pub mean: Entries,
    /// What it sets.
    pub numbers: Vec<Number>,
    /// No coefficient can be negative.
    pub positive: bool,
    /// Logarithm of its prior probability over that of its absence.
    pub log_prior: f64,
    /// Kinds of the blocks that its effect stands in, with a plus between them; of an open shape its own blocks.
    pub shown_by: String,
}

impl Cause {
    /// Block and column of every coefficient that it moves.
    pub fn columns(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let all = self.latents.iter().flatten().chain(&self.mean);
        all.map(|e| (e.0, e.1))
    }
}

/// Spread of a shared cause between joints, as a share of its size: parts from one drawer, and parts that wear.
const SPREADS: [f64; 3] = [0.02, 0.3, 1.0];
/// Expected number of causes of a robot; the prior probability of one is this over the number of its kind. Two to
/// three findings are what reviews of servos and robots report (gap methods: PACE, BAM).
const EXPECTED: f64 = 2.0;

/// Coefficients of one effect and one shape at one joint.
struct Part {
    joint: Option<usize>,
    /// Column, by parameter.
    columns: Vec<(Entries, Column)>,
}

/// Parts of all blocks by effect and shape; an entry may stand in several blocks of one joint.
fn parts(blocks: &[Block]) -> Vec<Parts> {
    let mut out: Vec<Parts> = Vec::new();
    for (b, block) in blocks.iter().enumerate() {
        for (c, column) in block.columns.iter().enumerate() {
            let effect = match column.meaning {
                Meaning::Effect(e) => Some(e),
                Meaning::Open => None,
                Meaning::Nuisance => continue,
            };
            // A column that nothing moves says nothing.
            if block.product(c, c) < 1e-9 {
                continue;
            }
            // An effect is the same in every block; open shapes of different stages have nothing in common.
            let same = |p: &Part| {
                let mut own = p.columns.iter().flat_map(|c| &c.0);
                effect.is_some() || own.any(|e| blocks[e.0].site.stage == block.site.stage)
            };
            let own = out
                .iter_mut()
                .find(|o| o.0 == effect && o.1 == column.shape && o.2.iter().any(same));
            let parts = match own {
                Some(own) => &mut own.2,
                None => {
                    out.push((effect, column.shape, Vec::new()));
                    &mut out.last_mut().expect("just pushed").2
                }
            };
            let joint = match column.owner {
                Owner::Block => block.site.joint,
                Owner::Joint(k) => Some(k),
                Owner::Robot => None,
            };
            let at = parts.iter().position(|p| p.joint == joint);
            let part = match at {
                Some(at) => &mut parts[at],
                None => {
                    parts.push(Part {
                        joint,
                        columns: Vec::new(),
                    });
                    parts.last_mut().expect("just pushed")
                }
            };
            part.columns.push((vec![(b, c, 1.0)], column.clone()));
        }
    }
    out
}

/// Puts the columns of parameters with one key together: one coefficient in several blocks.
fn merged(part: &mut Part) {
    let mut out: Vec<(Entries, Column)> = Vec::new();
    for (entries, column) in part.columns.drain(..) {
        let twin = out
            .iter_mut()
            .find(|o| o.1.parameter.key == column.parameter.key);
        match twin {
            Some(twin) => {
                let ratio = twin.1.parameter.scale / column.parameter.scale;
                twin.0
                    .extend(entries.iter().map(|(b, c, w)| (*b, *c, w * ratio)));
            }
            None => out.push((entries, column)),
        }
    }
    part.columns = out;
}

fn scaled(entries: &Entries, by: f64) -> Entries {
    entries.iter().map(|(b, c, w)| (*b, *c, w * by)).collect()
}

/// The cause of one part alone.
fn single(effect: Option<Effect>, part: &Part, log_prior: f64) -> Cause {
    let first = &part.columns[0].1;
    let mut out = Cause {
        effect,
        scope: part.joint.map_or(Scope::Robot, |_| Scope::Joint),
        joints: part.joint.into_iter().collect(),
        fixed: first.fixed.clone(),
        latents: Vec::new(),
        mean: Vec::new(),
        numbers: Vec::new(),
        positive: first.positive,
        log_prior,
        shown_by: String::new(),
    };
    for (i, (entries, column)) in part.columns.iter().enumerate() {
        let [mean, sd] = column.prior;
        out.latents.push(scaled(entries, sd));
        out.mean.extend(scaled(entries, mean));
        out.numbers.push(Number {
            joint: part.joint,
            key: column.parameter.key,
            neutral: column.parameter.neutral,
            scale: column.parameter.scale,
            mean,
            of_latents: vec![(i, sd)],
        });
    }
    out
}

/// The cause that `parts` share, with a `spread` between them.
fn shared(
    effect: Option<Effect>,
    scope: Scope,
    parts: &[&Part],
    spread: f64,
    log_prior: f64,
) -> Cause {
    let first = &parts[0].columns[0].1;
    let per_joint = parts[0].columns.len();
    let mut out = Cause {
        effect,
        scope,
        joints: parts.iter().filter_map(|p| p.joint).collect(),
        fixed: first.fixed.clone(),
        latents: vec![Vec::new(); per_joint],
        mean: Vec::new(),
        numbers: Vec::new(),
        positive: first.positive,
        log_prior,
        shown_by: String::new(),
    };
    for part in parts {
        for (i, (entries, column)) in part.columns.iter().enumerate() {
            let [mean, sd] = column.prior;
            // Around a mean of 0 the size is the standard deviation, else the mean.
            let apart = spread * if mean == 0.0 { 0.5 * sd } else { 2.0 * sd };
            out.latents[i].extend(scaled(entries, sd));
            out.latents.push(scaled(entries, apart));
            out.mean.extend(scaled(entries, mean));
            out.numbers.push(Number {
                joint: part.joint,
                key: column.parameter.key,
                neutral: column.parameter.neutral,
                scale: column.parameter.scale,
                mean,
                of_latents: vec![(i, sd), (out.latents.len() - 1, apart)],
            });
        }
    }
    out
}

/// What blocks share whatever the causes: one coefficient per key of the columns that are the robot's, with their
/// slack: what the model states, and what robots without a cause show.
#[must_use]
pub fn shared_slack(blocks: &[Block], spreads: &Spreads) -> Vec<Cause> {
    always(blocks.iter().map(|b| (&b.site, &*b.columns)), spreads)
}

/// The same of the columns of blocks at their sites.
pub(super) fn always<'a>(
    blocks: impl Iterator<Item = (&'a Site, &'a [Column])>,
    spreads: &Spreads,
) -> Vec<Cause> {
    // By key, means and spreads of the columns.
    let mut keys: Vec<(String, [Entries; 2])> = Vec::new();
    let mut add = |key: &str, (b, c): (usize, usize), [mean, spread]: [f64; 2]| {
        let at = keys.iter().position(|k| k.0 == key).unwrap_or_else(|| {
            keys.push((key.to_owned(), [Entries::new(), Entries::new()]));
            keys.len() - 1
        });
        let [means, latents] = &mut keys[at].1;
        latents.push((b, c, spread));
        if mean != 0.0 {
            means.push((b, c, mean));
        }
    };
    for (b, (site, columns)) in blocks.enumerate() {
        for (c, column) in columns.iter().enumerate() {
            if column.shared_slack > 0.0 {
                add(&column.slack_key(), (b, c), [0.0, column.shared_slack]);
            }
            if let Some(own) = spreads.alike(site, column) {
                add(&own.name, (b, c), [own.mean, own.spread]);
            }
        }
    }
    let one = |(_, [mean, latent]): (String, [Entries; 2])| Cause {
        effect: None,
        scope: Scope::Robot,
        joints: Vec::new(),
        fixed: Vec::new(),
        latents: vec![latent],
        mean,
        numbers: Vec::new(),
        positive: false,
        log_prior: 0.0,
        shown_by: String::new(),
    };
    keys.into_iter().map(one).collect()
}

/// Whether a shape that is open, or an effect of one joint by its nature, cannot be shared.
fn alone(effect: Option<Effect>) -> bool {
    matches!(effect, None | Some(Effect::JointOrder))
}

/// Every cause that `blocks` can show, in the `groups` of joints that may share one.
#[must_use]
pub fn causes(blocks: &[Block], groups: &[Group], withheld: &[Effect]) -> Vec<Cause> {
    let mut all = parts(blocks);
    all.retain(|(effect, _, _)| effect.is_none_or(|e| !withheld.contains(&e)));
    let mut kinds: Vec<Option<Effect>> = all.iter().map(|a| a.0).collect();
    kinds.sort_unstable();
    kinds.dedup();
    let shown: BTreeMap<Option<Effect>, BTreeSet<String>> = shown_by(blocks, &all);
    let mut out: Vec<Cause> = Vec::new();
    for (effect, _, parts) in &mut all {
        parts.iter_mut().for_each(merged);
        let first = out.len();
        // Shared by a group as often as by one joint: half of the prior probability each.
        let of_kind = libm::log(EXPECTED / kinds.len() as f64);
        let one = of_kind - libm::log(2.0 * parts.len() as f64);
        let jointly: Vec<&Group> = groups
            .iter()
            .filter(|g| {
                let has = |k: &usize| parts.iter().any(|p| p.joint == Some(*k));
                g.joints.len() > 1 && g.joints.iter().all(has) && !alone(*effect)
            })
            .collect();
        for part in parts.iter() {
            let own = if part.joint.is_none() { of_kind } else { one };
            let cost: f64 = part.columns.iter().map(|c| c.1.cost).sum();
            out.push(single(*effect, part, own - cost));
        }
        let many = of_kind - libm::log(2.0 * (jointly.len() * SPREADS.len()).max(1) as f64);
        for group in jointly {
            let members: Vec<&Part> = group
                .joints
                .iter()
                .filter_map(|k| parts.iter().find(|p| p.joint == Some(*k)))
                .collect();
            let cost: f64 = members
                .iter()
                .flat_map(|p| &p.columns)
                .map(|c| c.1.cost)
                .sum();
            for spread in SPREADS {
                out.push(shared(*effect, group.scope, &members, spread, many - cost));
            }
        }
        for cause in &mut out[first..] {
            let kinds: BTreeSet<String> = match effect {
                Some(_) => shown[effect].clone(),
                None => cause.columns().map(|c| kind(&blocks[c.0].site)).collect(),
            };
            cause.shown_by = Vec::from_iter(kinds).join("+");
        }
    }
    out
}

/// Parts of every effect and shape.
type Parts = (Option<Effect>, usize, Vec<Part>);

/// Kinds of the blocks that each effect stands in.
fn shown_by(blocks: &[Block], all: &[Parts]) -> BTreeMap<Option<Effect>, BTreeSet<String>> {
    let mut out: BTreeMap<_, BTreeSet<String>> = BTreeMap::new();
    for (effect, _, parts) in all {
        let columns = parts.iter().flat_map(|p| &p.columns);
        let own = columns.flat_map(|c| &c.0).map(|e| kind(&blocks[e.0].site));
        out.entry(*effect).or_default().extend(own);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::block::{Segment, White};
    use crate::vocabulary::Stage;

    /// A block of joint 0 with an offset and the open shape number `open`.
    fn block(stage: Stage, open: usize) -> Block {
        let site = Site {
            stage,
            joint: Some(0),
            blind: false,
            coarse: false,
        };
        let columns = vec![
            Column::linear(Effect::JointOffset, "offset_rad", 0.0, 0.1),
            Column::open(open, 0.1),
        ];
        let segment = Segment {
            y: vec![1.0; 3],
            x: vec![vec![1.0, 0.0, 2.0], vec![0.0, 1.0, 1.0]],
            weight: vec![1.0; 3],
        };
        White::whitened(site, columns, &[segment], [1.0, 1.0]).plain()
    }

    #[test]
    fn an_effect_is_shown_by_all_its_blocks_and_an_open_shape_by_its_own() {
        // By accident both shapes have one number.
        let blocks = [block(Stage::Driver, 1), block(Stage::Drivetrain, 1)];
        let shown: BTreeSet<(Option<Effect>, String)> = causes(&blocks, &[], &[])
            .into_iter()
            .map(|c| (c.effect, c.shown_by))
            .collect();
        let offset = Some(Effect::JointOffset);
        let expected = [
            (None, "driver"),
            (None, "drivetrain"),
            (offset, "driver+drivetrain"),
        ];
        assert_eq!(shown, expected.map(|(e, by)| (e, by.to_owned())).into());
    }
}
