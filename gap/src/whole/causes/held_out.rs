//! How far the gap shrinks on runs that no fit saw.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::super::blocks::position::{Played, errors_rad};
use super::super::blocks::torque::sense_in;
use super::super::body::Tier;
use super::super::conventions::Conventions;
use super::super::data::JOINTS;
use super::refine::Passes;
use super::{Asked, Explained, Posed};
use crate::evidence::block::Raw;
use crate::vocabulary::{Effect, Stage};

/// Error of one signal on the held-out runs: root mean square over joints, runs and time; of the pose at the end of windows
/// of a second.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Shrink {
    /// Unit.
    pub unit: &'static str,
    /// Under the nominal model.
    pub before: f64,
    /// With nominal numbers where they fit best within their tolerances.
    pub calibrated: f64,
    /// With the causes too.
    pub after: f64,
}

/// The gap on runs that no fit saw.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeldOut {
    /// Names of the runs.
    pub runs: Vec<String>,
    /// How they were chosen.
    pub split: String,
    /// By signal.
    pub errors: BTreeMap<&'static str, Shrink>,
    /// By cause, in the order of the search: the same errors with all other causes.
    #[serde(skip)]
    pub without: Vec<BTreeMap<&'static str, f64>>,
}

/// Signals, with their units.
const SIGNALS: [(&str, &str); 4] = [
    ("position_rmse_rad", "rad"),
    ("effort_rmse_nm", "N m"),
    ("link_rmse_rad", "rad"),
    ("pose_rmse_m", "m"),
];

/// Squares and their count by signal.
#[derive(Default)]
struct Sums([(f64, f64); 4]);

impl Sums {
    fn add(&mut self, signal: usize, square: f64) {
        self.0[signal].0 += square;
        self.0[signal].1 += 1.0;
    }

    fn roots(&self) -> BTreeMap<&'static str, f64> {
        let all = SIGNALS.iter().zip(&self.0);
        let known = all.filter(|(_, s)| s.1 > 0.0);
        known.map(|(n, s)| (n.0, (s.0 / s.1).sqrt())).collect()
    }
}

/// The held-out runs, ready to be compared with any state of the model.
struct Trial<'a> {
    /// What is asked, of the held-out runs; of set-points as they were sent.
    asked: Asked<'a>,
    as_sent: Asked<'a>,
    passes: &'a Passes<'a>,
    servos: Vec<Played>,
    /// Signal, number of the block that it was fitted in, errors and columns.
    linear: Vec<(usize, usize, Raw)>,
    body: Option<Tier>,
}

/// A state of the model: coefficients of the servos and of the body, and of the columns of all other blocks.
#[derive(Clone)]
struct State {
    joints: [Vec<(usize, f64)>; JOINTS],
    body: Vec<f64>,
    columns: Vec<(usize, usize, f64)>,
    /// Set-points come as they were sent.
    as_sent: bool,
}

impl Trial<'_> {
    fn errors(&self, state: &State) -> BTreeMap<&'static str, f64> {
        let mut sums = Sums::default();
        for (k, servo) in self.servos.iter().enumerate() {
            let law = servo.law(state.joints[k].iter().copied());
            let asked = if state.as_sent {
                &self.as_sent
            } else {
                &self.asked
            };
            let of = asked.servo(k, self.passes.loads(), |inputs, _| errors_rad(inputs, &law));
            let all = of.into_iter().flatten();
            all.for_each(|rad| sums.add(0, rad * rad));
        }
        for (signal, block, raw) in &self.linear {
            let own = state.columns.iter().filter(|c| c.0 == *block);
            let by: Vec<(usize, f64)> = own.map(|c| (c.1, c.2)).collect();
            for s in &raw.segments {
                for (row, y) in s.y.iter().enumerate().filter(|r| s.weight[r.0] > 0.0) {
                    let there: f64 = by.iter().map(|(c, v)| v * s.x[*c][row]).sum();
                    sums.add(*signal, (y - there).powi(2));
                }
            }
        }
        if let Some(tier) = &self.body {
            let ends = tier.errors(&state.body);
            ends.iter().for_each(|e| sums.add(3, e[0] * e[0]));
        }
        sums.roots()
    }
}

impl<'a> Passes<'a> {
    /// Errors of the held-out runs before and after, and without each cause of `found`.
    pub(super) fn held_out(&self, found: &Explained) -> HeldOut {
        let conventions = self.asked.conventions.as_sent();
        let named = &found.found.best.members;
        let owned: Vec<BTreeSet<(usize, usize)>> = named
            .iter()
            .map(|m| found.causes[*m].columns().collect())
            .collect();
        let trial = self.trial(
            &conventions,
            owned.iter().flatten().any(|c| self.of_body(c.0)),
        );
        let on_the_way = |m: &usize| {
            let stage = found.causes[*m].effect.map(Effect::stage);
            matches!(stage, Some(Stage::Conventions | Stage::Transport))
        };
        let nominal = State {
            joints: Default::default(),
            body: Posed::nominal(self.asked.model).theta,
            columns: Vec::new(),
            as_sent: named.iter().any(on_the_way),
        };
        let calibrated = State {
            joints: self.settled.clone(),
            ..nominal.clone()
        };
        let after = State {
            joints: std::array::from_fn(|k| {
                let from = if self.caused[k] {
                    &self.joints
                } else {
                    &self.settled
                };
                from[k].clone()
            }),
            body: self.posed.theta.clone(),
            columns: self.explained.clone(),
            as_sent: false,
        };
        let without = owned.iter().zip(named).map(|(own, m)| {
            let mut state = self.without(&after, &nominal, own);
            state.as_sent = on_the_way(m);
            trial.errors(&state)
        });
        let runs = self.asked.held.iter();
        HeldOut {
            runs: runs
                .map(|r| self.asked.data.runs[*r].name.clone())
                .collect(),
            split: self.asked.split.to_owned(),
            errors: shrinks([&nominal, &calibrated, &after].map(|s| trial.errors(s))),
            without: without.collect(),
        }
    }

    /// The held-out runs; windows of the base only where a cause `moves` it.
    fn trial<'b>(&'b self, as_sent: &'b Conventions, moves: bool) -> Trial<'b> {
        let asked = Asked {
            runs: self.asked.held,
            ..*self.asked
        };
        let held = |tier: &Tier| {
            let mut held = Tier::new(asked.data, asked.model, asked.params, asked.held)?;
            held.adopt(tier);
            Some(held)
        };
        Trial {
            asked,
            as_sent: Asked {
                conventions: as_sent,
                ..asked
            },
            passes: self,
            servos: (0..JOINTS).map(|k| self.played(k)).collect(),
            linear: self.linear(&asked),
            body: self.tier.as_deref().filter(|_| moves).and_then(held),
        }
    }

    /// Whether block `b` is that of the base.
    fn of_body(&self, b: usize) -> bool {
        let white = &self.whites[b];
        white.site.stage == Stage::Body && white.columns.len() > 1
    }

    /// A state without the columns `own`.
    fn without(&self, state: &State, nominal: &State, own: &BTreeSet<(usize, usize)>) -> State {
        let mut out = state.clone();
        out.columns.retain(|c| !own.contains(&(c.0, c.1)));
        for (b, c) in own {
            let site = self.whites[*b].site;
            if let (Stage::Driver, Some(k)) = (site.stage, site.joint) {
                out.joints[k].retain(|x| x.0 != *c);
            }
            if self.of_body(*b) {
                for (at, _) in &self.moves[*c].along {
                    out.body[*at] = nominal.body[*at];
                }
            }
        }
        out
    }

    /// Torques and links of the held-out runs, where their columns are those of the blocks that were fitted.
    fn linear(&self, asked: &Asked<'_>) -> Vec<(usize, usize, Raw)> {
        let (loads, drawn) = (self.loads(), asked.drawn());
        let mut out = Vec::new();
        for (b, white) in self.whites.iter().enumerate() {
            let Some(k) = white.site.joint else {
                continue;
            };
            let (signal, raw) = match white.site.stage {
                Stage::Drivetrain => {
                    let sense = sense_in(&white.columns);
                    (1, asked.torque_errors(k, loads, &drawn, sense))
                }
                Stage::Transmission => (2, asked.link_errors(k, loads)),
                _ => continue,
            };
            if let Some(raw) = raw.filter(|r| r.columns == white.columns) {
                out.push((signal, b, raw));
            }
        }
        out
    }
}

/// Signals that all three states have.
fn shrinks(
    [before, calibrated, after]: [BTreeMap<&'static str, f64>; 3],
) -> BTreeMap<&'static str, Shrink> {
    let one = |(name, unit): &(&'static str, &'static str)| {
        let shrink = Shrink {
            unit,
            before: *before.get(name)?,
            calibrated: *calibrated.get(name)?,
            after: *after.get(name)?,
        };
        Some((*name, shrink))
    };
    SIGNALS.iter().filter_map(one).collect()
}
