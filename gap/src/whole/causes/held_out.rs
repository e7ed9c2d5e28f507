//! How far the gap shrinks on runs that no fit saw.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::super::blocks::position::{Played, errors_rad};
use super::super::blocks::torque::{instants, sense_in};
use super::super::blocks::transmission;
use super::super::body::Tier;
use super::super::conventions::Conventions;
use super::super::data::JOINTS;
use super::errors::{ANGLE, HEADING, LINK, POSE, SIGNALS, Sums, TORQUE};
use super::refine::Passes;
use super::regimes::Regimes;
use super::{Asked, Explained, Posed};
use crate::evidence::block::Raw;
use crate::regimes::RegimeRow;
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
    /// What a report shows besides.
    #[serde(skip)]
    pub(in crate::whole) parts: Parts,
}

/// Errors of one joint before and after.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::whole) struct JointRow {
    pub(in crate::whole) joint: usize,
    pub(in crate::whole) angle_rad: Option<[f64; 2]>,
    pub(in crate::whole) torque_nm: Option<[f64; 2]>,
}

/// What the errors of the held-out runs are made of.
#[derive(Debug, Clone, PartialEq, Default)]
pub(in crate::whole) struct Parts {
    /// By cause, in the order of the search: errors with this cause alone, on nominal numbers where they fit best.
    pub(in crate::whole) alone: Vec<BTreeMap<&'static str, f64>>,
    /// Errors of each run with the causes, by signal.
    pub(in crate::whole) by_run: BTreeMap<&'static str, Vec<f64>>,
    /// By joint.
    pub(in crate::whole) joints: Vec<JointRow>,
    /// By regime of the motion.
    pub(in crate::whole) regimes: Vec<RegimeRow>,
}

/// An error of a signal, of a joint or of the robot.
#[derive(Debug, Clone, Copy)]
pub(super) struct Error {
    /// Place in [`SIGNALS`].
    pub(super) signal: usize,
    pub(super) joint: Option<usize>,
    pub(super) run: usize,
    pub(super) t_s: f64,
    pub(super) value: f64,
}

/// A block of torques or links of the held-out runs.
struct Linear {
    signal: usize,
    joint: usize,
    /// Number of the block that its columns were fitted in.
    block: usize,
    raw: Raw,
    /// Run and instants of every segment.
    at: Vec<(usize, Vec<f64>)>,
}

/// The held-out runs, ready to be compared with any state of the model.
struct Trial<'a> {
    /// What is asked, of the held-out runs; of set-points as they were sent.
    asked: Asked<'a>,
    as_sent: Asked<'a>,
    passes: &'a Passes<'a>,
    servos: Vec<Played>,
    linear: Vec<Linear>,
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
    /// Hands every error under a state to `then`.
    fn each(&self, state: &State, then: &mut dyn FnMut(Error)) {
        for (k, servo) in self.servos.iter().enumerate() {
            let law = servo.law(state.joints[k].iter().copied());
            let asked = if state.as_sent {
                &self.as_sent
            } else {
                &self.asked
            };
            let (errors, runs) = asked.servo(k, self.passes.loads(), |inputs, _, runs| {
                (errors_rad(inputs, &law), runs.to_vec())
            });
            for (run, errors) in runs.into_iter().zip(errors) {
                for [t_s, value] in errors {
                    let joint = Some(k);
                    then(Error {
                        signal: ANGLE,
                        joint,
                        run,
                        t_s,
                        value,
                    });
                }
            }
        }
        for linear in &self.linear {
            let own = state.columns.iter().filter(|c| c.0 == linear.block);
            let by: Vec<(usize, f64)> = own.map(|c| (c.1, c.2)).collect();
            for (s, (run, t_s)) in linear.raw.segments.iter().zip(&linear.at) {
                for (row, y) in s.y.iter().enumerate().filter(|r| s.weight[r.0] > 0.0) {
                    let there: f64 = by.iter().map(|(c, v)| v * s.x[*c][row]).sum();
                    then(Error {
                        signal: linear.signal,
                        joint: Some(linear.joint),
                        run: *run,
                        t_s: t_s[row],
                        value: y - there,
                    });
                }
            }
        }
        if let Some(tier) = &self.body {
            for (w, end) in tier.windows.iter().zip(tier.ends(&state.body)) {
                for (signal, value) in [POSE, HEADING].into_iter().zip(end.into_iter().flatten()) {
                    let (run, t_s) = (w.run, w.from_s);
                    then(Error {
                        signal,
                        joint: None,
                        run,
                        t_s,
                        value,
                    });
                }
            }
        }
    }

    fn sums(&self, state: &State) -> Sums {
        self.sums_and(state, |_| {})
    }

    /// The same, of errors that `also` hears.
    fn sums_and(&self, state: &State, mut also: impl FnMut(Error)) -> Sums {
        let mut sums = Sums::default();
        self.each(state, &mut |e| {
            sums.add(e.signal, (e.joint, e.run), e.value);
            also(e);
        });
        sums
    }

    /// Errors before and after, and what they are made of; each state is played once.
    fn parts(&self, before: &State, after: &State) -> ([Sums; 2], Parts) {
        let most_nm = std::array::from_fn(|k| {
            let own = after.joints[k].iter().copied();
            self.servos[k].law(own).limit_nm()
        });
        let mut regimes = Regimes::new(&self.asked, self.passes.loads(), most_nm);
        let both = [(before, false), (after, true)]
            .map(|(state, last)| self.sums_and(state, |e| regimes.add(last, e)));
        let joint = |k: usize| {
            let pair = |signal| {
                let [before, after] = [0, 1].map(|i| both[i].of_joint(signal, k));
                Some([before?, after?])
            };
            let row = JointRow {
                joint: k,
                angle_rad: pair(ANGLE),
                torque_nm: pair(TORQUE),
            };
            (row.angle_rad.is_some() || row.torque_nm.is_some()).then_some(row)
        };
        let parts = Parts {
            alone: Vec::new(),
            by_run: both[1].by_run(),
            joints: (0..JOINTS).filter_map(joint).collect(),
            regimes: regimes.rows(),
        };
        (both, parts)
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
        let trial = self.trial(&conventions);
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
            trial.sums(&state).roots()
        });
        let alone = (0..named.len()).map(|i| {
            let mut state = after.clone();
            for (other, own) in owned.iter().enumerate().filter(|o| o.0 != i) {
                let beside: BTreeSet<_> = own.difference(&owned[i]).copied().collect();
                state = self.without(&state, &nominal, &beside);
                state.as_sent |= on_the_way(&named[other]);
            }
            trial.sums(&state).roots()
        });
        let ([first, last], parts) = trial.parts(&nominal, &after);
        let middle = trial.sums(&calibrated);
        HeldOut {
            runs: self
                .asked
                .held
                .iter()
                .map(|r| self.asked.data.runs[*r].name.clone())
                .collect(),
            split: self.asked.split.to_owned(),
            errors: shrinks([&first, &middle, &last].map(|s| s.roots())),
            without: without.collect(),
            parts: Parts {
                alone: alone.collect(),
                ..parts
            },
        }
    }

    /// The held-out runs.
    fn trial<'b>(&'b self, as_sent: &'b Conventions) -> Trial<'b> {
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
            body: self.tier.as_deref().and_then(held),
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
                for (at, _) in self.moves.get(*c).iter().flat_map(|m| &m.along) {
                    out.body[*at] = nominal.body[*at];
                }
            }
        }
        out
    }

    /// Torques and links of the held-out runs, where their columns are those of the blocks that were fitted.
    fn linear(&self, asked: &Asked<'_>) -> Vec<Linear> {
        let (loads, drawn) = (self.loads(), asked.drawn());
        let mut out = Vec::new();
        for (block, white) in self.whites.iter().enumerate() {
            let Some(joint) = white.site.joint else {
                continue;
            };
            let (signal, raw, runs) = match white.site.stage {
                Stage::Drivetrain => {
                    let sense = sense_in(&white.columns);
                    let raw = asked
                        .torque_errors(joint, loads, &drawn, sense)
                        .map(Raw::calibrated);
                    (TORQUE, raw, asked.torque_runs(joint))
                }
                Stage::Transmission => (
                    LINK,
                    asked.link_errors(joint, loads),
                    asked.link_runs(joint),
                ),
                _ => continue,
            };
            let Some(raw) = raw.filter(|r| r.columns == white.columns) else {
                continue;
            };
            let at = |r: usize| {
                let position = asked.data.runs[r].joints[joint].position.as_ref()?;
                let t_s = match signal {
                    TORQUE => instants(position),
                    _ => transmission::instants(position),
                };
                (!t_s.is_empty()).then_some((r, t_s))
            };
            out.push(Linear {
                signal,
                joint,
                block,
                raw,
                at: runs.into_iter().filter_map(at).collect(),
            });
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
