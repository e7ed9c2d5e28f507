//! What neither causes nor nuisances explain, against what robots without a cause leave.

use std::collections::BTreeSet;

use serde::Serialize;

use super::Explained;
use super::places::Place;
use crate::decide::{Calibration, LEVEL};
use crate::evidence::block::{Column, Meaning, Site, White};
use crate::evidence::ensemble::kind;
use crate::vocabulary::Effect;

/// A block of prediction errors that leaves more than blocks of robots without a cause do.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Left {
    /// Stage whose output is compared.
    pub stage: &'static str,
    /// Joint; `null` for what the robot has once.
    pub joint: Option<usize>,
    /// Root mean square of what is left, in units of the noise of a row.
    pub left: f64,
    /// The same in the middle of robots without a cause.
    pub usual: f64,
    /// Chance that a robot without a cause leaves as much anywhere.
    pub p_value: f64,
    /// Whether a cause is named that shows in this block.
    pub named: bool,
    /// The place in words.
    #[serde(skip)]
    pub plain: String,
}

/// Least that counts as left, in units of the noise.
const LEAST: f64 = 1e-6;

fn decibel(left: f64) -> f64 {
    20.0 * libm::log10(left.max(LEAST))
}

/// Blocks that leave alike: of one kind, moved by the same effects. A torque that currents give and a duty are both electrical, and
/// leave different things.
fn alike(site: &Site, columns: &[Column]) -> String {
    let effects: BTreeSet<&str> = columns
        .iter()
        .filter_map(|c| match c.meaning {
            // Rows that show a clock leave its column out; the motion of a servo is the same.
            Meaning::Effect(Effect::ClockSkew) => None,
            Meaning::Effect(e) => Some(e.name()),
            Meaning::Open | Meaning::Nuisance => None,
        })
        .collect();
    let list: Vec<&str> = effects.into_iter().collect();
    format!("{}: {}", kind(site), list.join(" "))
}

/// Blocks of many numbers by what leaves alike, and what each leaves, dB.
pub(in crate::whole) fn lefts(blocks: &[White]) -> Vec<(String, f64)> {
    let many = blocks.iter().filter(|b| b.columns.len() > 1);
    many.map(|b| (alike(&b.site, &b.columns), decibel(b.left)))
        .collect()
}

impl Explained {
    /// Blocks that leave too much, the most unusual first.
    pub(super) fn left(&self, calibration: &Calibration) -> Vec<Left> {
        let members = &self.found.best.members;
        let mut out: Vec<(f64, Left)> = Vec::new();
        for (i, block) in self.blocks.iter().enumerate() {
            let many = block.columns.len() > 1;
            let kind = alike(&block.site, &block.columns);
            let standard = calibration.standard_left(&kind, decibel(block.left));
            let Some(standard) = standard.filter(|_| many) else {
                continue;
            };
            let p_value = calibration.remainder_p(standard);
            if p_value > LEVEL {
                continue;
            }
            let usual = calibration.lefts[&kind].middle;
            let place = Place::new(Some(block.site.stage), block.site.joint, 1.0);
            let shows = |m: &usize| self.causes[*m].columns().any(|c| c.0 == i);
            out.push((
                standard,
                Left {
                    stage: place.stage,
                    joint: place.joint,
                    left: block.left,
                    usual: libm::pow(10.0, usual / 20.0),
                    p_value,
                    named: members.iter().any(shows),
                    plain: place.plain,
                },
            ));
        }
        out.sort_by(|a, b| b.0.total_cmp(&a.0));
        out.into_iter().map(|l| l.1).collect()
    }
}

/// Where the gap lies if no cause is named: by the squares of what is left, in units of what robots without a cause leave.
pub(super) fn places(left: &[Left]) -> Vec<Place> {
    let square = |l: &Left| (l.left / l.usual).powi(2);
    let all: f64 = left.iter().map(square).sum();
    let one = |l: &Left| Place {
        stage: l.stage,
        joint: l.joint,
        share: square(l) / all,
        ci95: None,
        plain: l.plain.clone(),
    };
    left.iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::block::{Raw, Segment};
    use crate::evidence::cause::causes;
    use crate::evidence::search::{Found, Set};
    use crate::math::{Rng, sin};
    use crate::vocabulary::{Effect, Stage};

    const ROWS: usize = 600;

    /// Angles of joint `k` that hold a slow wave of the size `wave_rad`, which no column has.
    fn joint(k: usize, wave_rad: f64, rng: &mut Rng) -> White {
        let side = |i: usize| if i % 40 < 20 { 1.0 } else { -1.0 };
        let wave = |i: usize| wave_rad * 2_f64.sqrt() * sin(0.11 * i as f64);
        let segment = Segment {
            y: (0..ROWS).map(|i| wave(i) + 1e-3 * rng.normal()).collect(),
            x: vec![(0..ROWS).map(side).collect(), vec![1.0; ROWS]],
            weight: vec![1.0; ROWS],
        };
        let columns = vec![
            Column::linear(Effect::JointScale, "ratio", 1.0, 0.01),
            Column::linear(Effect::JointOffset, "offset_rad", 0.0, 0.01),
        ];
        let site = Site {
            stage: Stage::Driver,
            joint: Some(k),
            blind: false,
            coarse: false,
        };
        let raw = Raw {
            site,
            columns,
            segments: vec![segment],
            floor: 5e-4,
            noisy: Vec::new(),
        };
        White::new(raw, 6)
    }

    fn explained(whites: &[White], members: Vec<usize>) -> Explained {
        let blocks: Vec<_> = whites.iter().map(White::plain).collect();
        Explained {
            causes: causes(&blocks, &[], &[]),
            blocks,
            always: Vec::new(),
            found: Found {
                best: Set {
                    members,
                    evidence: 0.0,
                },
                gains: Vec::new(),
                rivals: Vec::new(),
                next: None,
            },
            damping: [0.0; 2],
            fitted: Vec::new(),
        }
    }

    #[test]
    fn what_no_column_has_is_left_in_its_place_with_its_size() {
        let mut rng = Rng::new(11);
        let mut robot = |waves: [f64; 3]| -> Vec<White> {
            (0..3).map(|k| joint(k, waves[k], &mut rng)).collect()
        };
        let healthy: Vec<_> = (0..200).map(|_| lefts(&robot([2e-4; 3]))).collect();
        let evidence = (0..200).map(f64::from).collect();
        let calibration = Calibration::new(evidence, "test", "waves").expect("enough");
        let calibration = calibration.with_lefts(&healthy);
        let off = robot([2e-4, 4e-3, 2e-4]);
        let found = explained(&off, Vec::new()).left(&calibration);
        let [left] = found.as_slice() else {
            panic!("{found:?}");
        };
        assert_eq!(
            (left.stage, left.joint, left.named),
            ("driver", Some(1), false)
        );
        let rms = left.left * off[1].noise;
        assert!((rms / 4e-3 - 1.0).abs() < 0.1, "{left:?}");
        assert!((places(&found)[0].share - 1.0).abs() < 1e-12);
        // A cause that shows there is named: the rest is part of what it leaves.
        let all = explained(&off, Vec::new());
        let there = all
            .causes
            .iter()
            .position(|c| c.joints == [1])
            .expect("a cause");
        assert!(explained(&off, vec![there]).left(&calibration)[0].named);
        let accused = (0..200).filter(|_| {
            let same = explained(&robot([2e-4; 3]), Vec::new());
            !same.left(&calibration).is_empty()
        });
        assert!(accused.count() <= 6, "one in a hundred");
    }
}
