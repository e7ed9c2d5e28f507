//! Blocks of a robot as bytes, so that a calibration that was stopped goes on: a head in JSON, a line feed, then the
//! products of all blocks, lower triangle by rows, little-endian.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use super::block::{Column, Meaning, Owner, Parameter, Site, White};
use crate::vocabulary::{Effect, Stage};

const SCHEMA: &str = "rb.blocks/2";

/// Why bytes are no blocks.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum KeptError {
    /// The head is none.
    #[error("the head is no JSON of blocks: {0}")]
    Head(String),
    /// The head is that of other blocks.
    #[error("blocks of {found}, this program keeps {SCHEMA}")]
    Schema {
        /// What the head says.
        found: String,
    },
    /// The head names an effect or a stage that is not in the vocabulary.
    #[error("no effect or stage is called `{0}`")]
    Name(String),
    /// Products are missing or too many.
    #[error("{found} bytes of products, the head asks for {wanted}")]
    Length {
        /// Bytes that there are.
        found: usize,
        /// Bytes that there must be.
        wanted: usize,
    },
}

#[derive(Serialize, Deserialize)]
struct Head {
    schema: String,
    blocks: Vec<BlockHead>,
}

#[derive(Serialize, Deserialize)]
struct BlockHead {
    stage: String,
    joint: Option<usize>,
    blind: bool,
    coarse: bool,
    rows: f64,
    noise: f64,
    before: f64,
    left: f64,
    columns: Vec<ColumnHead>,
}

#[derive(Serialize, Deserialize)]
enum Stands {
    Effect(String),
    Open,
    Nuisance,
}

#[derive(Serialize, Deserialize)]
enum Whose {
    Block,
    Joint(usize),
    Robot,
}

#[derive(Serialize, Deserialize)]
struct ColumnHead {
    meaning: Stands,
    shape: usize,
    key: String,
    neutral: f64,
    scale: f64,
    fixed: Vec<(String, f64)>,
    prior: [f64; 2],
    slack: f64,
    positive: bool,
    owner: Whose,
    shared_slack: f64,
    slack_key: String,
    cost: f64,
}

/// The one copy of a key, of which a program has a few dozen.
fn key(text: &str) -> &'static str {
    static KEYS: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let mut keys = KEYS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(own) = keys.get(text) {
        return own;
    }
    let own: &'static str = Box::leak(text.into());
    keys.insert(own);
    own
}

impl From<&Column> for ColumnHead {
    fn from(c: &Column) -> Self {
        Self {
            meaning: match c.meaning {
                Meaning::Effect(e) => Stands::Effect(e.name().into()),
                Meaning::Open => Stands::Open,
                Meaning::Nuisance => Stands::Nuisance,
            },
            shape: c.shape,
            key: c.parameter.key.into(),
            neutral: c.parameter.neutral,
            scale: c.parameter.scale,
            fixed: c.fixed.iter().map(|(k, v)| ((*k).into(), *v)).collect(),
            prior: c.prior,
            slack: c.slack,
            positive: c.positive,
            owner: match c.owner {
                Owner::Block => Whose::Block,
                Owner::Joint(k) => Whose::Joint(k),
                Owner::Robot => Whose::Robot,
            },
            shared_slack: c.shared_slack,
            slack_key: c.slack_key.into(),
            cost: c.cost,
        }
    }
}

impl TryFrom<ColumnHead> for Column {
    type Error = KeptError;

    fn try_from(c: ColumnHead) -> Result<Self, KeptError> {
        Ok(Self {
            meaning: match c.meaning {
                Stands::Effect(name) => {
                    let effect = Effect::from_name(&name);
                    Meaning::Effect(effect.ok_or(KeptError::Name(name))?)
                }
                Stands::Open => Meaning::Open,
                Stands::Nuisance => Meaning::Nuisance,
            },
            shape: c.shape,
            parameter: Parameter {
                key: key(&c.key),
                neutral: c.neutral,
                scale: c.scale,
            },
            fixed: c.fixed.iter().map(|(k, v)| (key(k), *v)).collect(),
            prior: c.prior,
            slack: c.slack,
            positive: c.positive,
            owner: match c.owner {
                Whose::Block => Owner::Block,
                Whose::Joint(k) => Owner::Joint(k),
                Whose::Robot => Owner::Robot,
            },
            shared_slack: c.shared_slack,
            slack_key: key(&c.slack_key),
            cost: c.cost,
        })
    }
}

/// Blocks as bytes.
///
/// # Panics
/// Never: a head of numbers and texts has a JSON.
#[must_use]
pub fn to_bytes(blocks: &[White]) -> Vec<u8> {
    let head = Head {
        schema: SCHEMA.into(),
        blocks: blocks
            .iter()
            .map(|b| BlockHead {
                stage: b.site.stage.name().into(),
                joint: b.site.joint,
                blind: b.site.blind,
                coarse: b.site.coarse,
                rows: b.rows,
                noise: b.noise,
                before: b.before,
                left: b.left,
                columns: b.columns.iter().map(Into::into).collect(),
            })
            .collect(),
    };
    let mut out = serde_json::to_vec(&head).expect("numbers and texts");
    out.push(b'\n');
    for b in blocks {
        let n = b.columns.len() + 1;
        for row in 0..n {
            let own = &b.products[row * n..=row * n + row];
            out.extend(own.iter().flat_map(|x| x.to_le_bytes()));
        }
    }
    out
}

/// Blocks from bytes.
///
/// # Errors
/// [`KeptError`] where they are not those of [`to_bytes`].
pub fn from_bytes(bytes: &[u8]) -> Result<Vec<White>, KeptError> {
    let end = bytes
        .iter()
        .position(|b| *b == b'\n')
        .unwrap_or(bytes.len());
    let (head, rest) = bytes.split_at(end);
    let head: Head = serde_json::from_slice(head).map_err(|e| KeptError::Head(e.to_string()))?;
    if head.schema != SCHEMA {
        return Err(KeptError::Schema { found: head.schema });
    }
    let products = rest.get(1..).unwrap_or_default();
    let triangle = |b: &BlockHead| (b.columns.len() + 1) * (b.columns.len() + 2) / 2;
    let wanted = 8 * head.blocks.iter().map(triangle).sum::<usize>();
    if products.len() != wanted {
        let found = products.len();
        return Err(KeptError::Length { found, wanted });
    }
    let mut numbers = products
        .chunks_exact(8)
        .map(|x| f64::from_le_bytes(x.try_into().unwrap_or_default()));
    head.blocks
        .into_iter()
        .map(|b| block(b, &mut numbers))
        .collect()
}

fn block(b: BlockHead, numbers: &mut impl Iterator<Item = f64>) -> Result<White, KeptError> {
    let columns: Vec<Column> = b
        .columns
        .into_iter()
        .map(TryInto::try_into)
        .collect::<Result<_, _>>()?;
    let n = columns.len() + 1;
    let mut products = vec![0.0; n * n];
    for row in 0..n {
        for (column, x) in numbers.by_ref().take(row + 1).enumerate() {
            products[row * n + column] = x;
            products[column * n + row] = x;
        }
    }
    let stage = Stage::ALL.into_iter().find(|s| s.name() == b.stage);
    Ok(White {
        site: Site {
            stage: stage.ok_or(KeptError::Name(b.stage))?,
            joint: b.joint,
            blind: b.blind,
            coarse: b.coarse,
        },
        columns,
        rows: b.rows,
        products,
        noise: b.noise,
        before: b.before,
        left: b.left,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::block::Segment;
    use crate::math::Rng;

    fn blocks() -> Vec<White> {
        let mut rng = Rng::new(3);
        let mut wave = |n: usize| -> Vec<f64> { (0..n).map(|_| rng.normal()).collect() };
        let one = |site, columns: Vec<Column>, wave: &mut dyn FnMut(usize) -> Vec<f64>| {
            let segment = Segment {
                y: wave(40),
                x: columns.iter().map(|_| wave(40)).collect(),
                weight: vec![1.0; 40],
            };
            White::whitened(site, columns, &[segment], [0.1, 0.3])
        };
        let site = |stage, joint| Site {
            stage,
            joint,
            blind: joint.is_some(),
            coarse: false,
        };
        let gear = Column::played(Effect::Backlash, "half_width_rad", 0.0, 0.03, 2).of_joint(4);
        let ripple = Column::linear(Effect::TorqueRipple, "sine_nm", 0.0, 0.2)
            .shaped(3, &[("periods", 3.0)])
            .with_shared_slack("teeth", 0.1);
        vec![
            one(
                site(Stage::Body, None),
                vec![gear, Column::nuisance(0.1).of_robot()],
                &mut wave,
            ),
            one(
                site(Stage::Drivetrain, Some(2)),
                vec![ripple, Column::open(7, 0.2)],
                &mut wave,
            ),
        ]
    }

    #[test]
    fn blocks_come_back_bit_for_bit() {
        let blocks = blocks();
        assert_eq!(from_bytes(&to_bytes(&blocks)), Ok(blocks));
    }

    #[test]
    fn bytes_that_are_no_blocks_are_refused() {
        let bytes = to_bytes(&blocks());
        let short = from_bytes(&bytes[..bytes.len() - 8]);
        assert!(matches!(short, Err(KeptError::Length { .. })), "{short:?}");
        let end = bytes.iter().position(|b| *b == b'\n').expect("a head");
        let head = |from: &str, to: &str| {
            let text = String::from_utf8_lossy(&bytes[..end]).replace(from, to);
            from_bytes(&[text.as_bytes(), &bytes[end..]].concat())
        };
        let other = head("rb.blocks/2", "rb.blocks/0");
        assert!(matches!(other, Err(KeptError::Schema { .. })), "{other:?}");
        let named = head("torque_ripple", "torque_tipple");
        assert!(matches!(named, Err(KeptError::Name(_))), "{named:?}");
        assert!(matches!(from_bytes(b"{}"), Err(KeptError::Head(_))));
    }
}
