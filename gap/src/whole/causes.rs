//! Causes of a robot's gap, shared by joints or not: blocks of the chain, groups of joints, the search.

mod loads;
mod readings;
mod rows;

use std::sync::Arc;

use files::model::{Key, Model};
use physics::Params;
use rayon::prelude::*;

use super::blocks::{body as body_block, position, torque};
use super::body;
use super::conventions::Conventions;
use super::data::{Data, JOINTS, Run, Track};
use super::direct::Reading;
use super::nominal::{Nominal, inter, nominal};
use super::windows::{LinkMap, PERIOD_S};
use crate::evidence::block::{Block, Column, Meaning};
use crate::evidence::cause::{Cause, Group, Scope, causes, shared_slack};
use crate::evidence::search::{Found, Problem};
use crate::vocabulary::{Effect, Stage};
use loads::Loads;
use readings::{reading, sure};
pub use rows::{Alternative, Causes, Probabilities, Row, Value, Word};

/// Order of the autoregression that whitens: 0.12 s of angles, 0.24 s of torques.
const ORDER: usize = 6;
/// Model error in any one direction as a share of the noise: of angles, torques and the base. Robots played in
/// MuJoCo were looked at when they were chosen (development seed 1); what robots without a cause show with them stands
/// in the calibration.
const MODEL_ERROR: [f64; 3] = [0.12, 0.03, 0.03];
/// The same of torques where no base pose was recorded: the loads are then guesses.
const UNTRACKED: f64 = 0.3;
/// What the loads of all joints together may be off by, as a share of them (contacts of other makes: 0.07 to 0.12).
const MASS: f64 = 0.12;
/// A motor at its limit: quantile of the torque that counts as the top, shares of it that are at the limit and just
/// below, how many times as often it is at it as below, and the share of the time that it is there at least.
const TOP: f64 = 0.995;
const AT_LIMIT: f64 = 0.95;
const BELOW_LIMIT: f64 = 0.85;
const STEEP: f64 = 3.0;
const OFTEN: f64 = 0.01;
/// Slope of angle over set-point below which a joint turns the other way.
const TURNED: f64 = -0.3;
/// Most causes.
const MOST: usize = 8;

/// The groups of joints that may share a cause.
fn groups() -> Vec<Group> {
    let of = |scope, joints: &[usize]| Group {
        scope,
        joints: joints.to_vec(),
    };
    let (between, inside): (Vec<usize>, Vec<usize>) = (0..JOINTS).partition(|k| inter(*k));
    vec![
        of(Scope::All, &[0, 1, 2, 3, 4, 5]),
        of(Scope::Kind, &between),
        of(Scope::Kind, &inside),
        of(Scope::Module, &[0, 1, 2]),
        of(Scope::Module, &[3, 4, 5]),
    ]
}

fn effort(run: &Run, k: usize, nm_per_a: f64) -> Option<Track> {
    let j = &run.joints[k];
    if let Some(e) = &j.effort {
        return Some(e.clone());
    }
    let c = j.current.as_ref()?;
    let v = c.v.iter().map(|x| x * nm_per_a).collect();
    Some(Track {
        t_s: c.t_s.clone(),
        v,
    })
}

/// What is asked.
pub(super) struct Asked<'a> {
    pub(super) data: &'a Data,
    pub(super) model: &'a Model,
    pub(super) params: &'a Arc<Params>,
    pub(super) conventions: &'a Conventions,
    pub(super) direct: &'a [Reading],
    pub(super) runs: &'a [usize],
    pub(super) withhold: &'a [Effect],
    /// Evidence that a cause must add.
    pub(super) least: f64,
}

impl Asked<'_> {
    fn limit_nm(&self, k: usize, servo: &Nominal) -> (f64, Option<f64>) {
        let all: Vec<f64> = self
            .runs
            .iter()
            .filter_map(|r| effort(&self.data.runs[*r], k, servo.nm_per_a))
            .flat_map(|e| e.v.into_iter().map(f64::abs))
            .collect();
        let top = crate::math::quantile(&all, TOP);
        let plain = AT_LIMIT * servo.max_torque_nm;
        let near = all
            .iter()
            .filter(|x| **x > AT_LIMIT * top && **x < (2.0 - AT_LIMIT) * top)
            .count() as f64;
        let below = all
            .iter()
            .filter(|x| **x > BELOW_LIMIT * top && **x <= AT_LIMIT * top)
            .count() as f64;
        let plateau = near > STEEP * below && near > OFTEN * all.len() as f64;
        (
            if plateau { AT_LIMIT * top } else { plain },
            plateau.then_some(top),
        )
    }

    fn position(&self, k: usize, loads: &Loads, start: &[(usize, f64)]) -> Option<Block> {
        let c = self.conventions;
        let servo = nominal(self.model, k);
        let echo = &c.echo[c.order[k]];
        let speed = self.model.parameter(if inter(k) {
            Key::InterSpeed
        } else {
            Key::IntraSpeed
        });
        let (limit_nm, _) = self.limit_nm(k, &servo);
        let efforts: Vec<Option<Track>> = self
            .runs
            .iter()
            .map(|r| effort(&self.data.runs[*r], k, servo.nm_per_a))
            .collect();
        let mut applied = false;
        let inputs: Vec<position::Input<'_>> = self
            .runs
            .iter()
            .zip(&efforts)
            .filter_map(|(r, effort)| {
                let run = &self.data.runs[*r];
                let sent = run.joints[c.order[k]].command.as_ref();
                let heard = run.joints[c.echo_at[c.order[k]]].applied.as_ref();
                applied |= (echo.uneven || sent.is_none()) && heard.is_some();
                Some(position::Input {
                    command: position::regular(echo.command(sent, heard)?),
                    position: run.joints[k].position.as_ref()?,
                    load_nm: &loads.makes[0][*r][k],
                    load_step_s: PERIOD_S,
                    limit: effort.as_ref().map(|e| (limit_nm, e)),
                })
            })
            .collect();
        let known = position::Known {
            nominal: servo,
            speed_tolerance: speed.tolerance / speed.value.max(1e-9),
            late_s: echo.late_s,
            applied,
            echoed: echo.late_s.is_some() || applied,
            row_s: inputs.first().map_or(0.02, |i| i.position.period_s()),
        };
        Some(
            Block::new(position::raw(k, &inputs, &known, start)?, ORDER)
                .with_model_error(MODEL_ERROR[0]),
        )
    }

    fn torque(&self, k: usize, loads: &Loads) -> Option<Block> {
        let servo = nominal(self.model, k);
        let tracked = self.data.runs.iter().any(|r| r.base.is_some());
        let mass = Column::linear(Effect::Mass, "ratio", 1.0, 0.4)
            .of_robot()
            .with_shared_slack("mass", if tracked { MASS } else { 1.0 });
        let known = torque::Known {
            damping_nm_s: servo.damping_nm_s_rad,
            body: std::iter::once(mass)
                .chain(loads.body.iter().map(|b| b.0.clone()))
                .collect(),
        };
        let inputs: Vec<torque::Input<'_>> = self
            .runs
            .iter()
            .filter_map(|r| {
                let run = &self.data.runs[*r];
                let nm_per_a = servo.nm_per_a * self.conventions.per_ampere[k];
                let effort = effort(run, k, nm_per_a)?;
                let load = &loads.makes[0][*r][k];
                Some(torque::Input {
                    position: run.joints[k].position.as_ref()?,
                    effort,
                    load_nm: loads.makes.iter().map(|m| m[*r][k].as_slice()).collect(),
                    gravity_nm: &loads.gravity[*r][k],
                    body_nm: std::iter::once(load.as_slice())
                        .chain(loads.body.iter().map(|b| b.1[*r][k].as_slice()))
                        .collect(),
                    body_at: std::iter::once(0.0)
                        .chain(loads.body.iter().map(|b| b.2))
                        .collect(),
                    load_step_s: PERIOD_S,
                })
            })
            .collect();
        Some(
            Block::new(torque::raw(k, &inputs, &known)?, ORDER).with_model_error(if tracked {
                MODEL_ERROR[1]
            } else {
                UNTRACKED
            }),
        )
    }

    fn readings(&self) -> Vec<Block> {
        let neutral = |key: &str| match key {
            "ratio" => 1.0,
            "value_v" => self.model.value(Key::SupplyVoltage),
            _ => 0.0,
        };
        let read = |r: &Reading| reading(r, neutral(r.key));
        let mut out: Vec<Block> = self.direct.iter().map(read).collect();
        for k in 0..JOINTS {
            let servo = nominal(self.model, k);
            let (_, plateau) = self.limit_nm(k, &servo);
            if let Some(nm) = plateau.filter(|nm| *nm < servo.at_limit_nm()[0]) {
                let read = Reading {
                    effect: Effect::TorqueLimit,
                    joint: Some(k),
                    key: "limit_nm",
                    estimate: super::direct::exact(nm, (1.0 - AT_LIMIT) * nm),
                    gain: 0.0,
                };
                out.push(reading(&read, servo.max_torque_nm));
            }
        }
        if self.conventions.mixed() {
            out.push(sure(Effect::JointOrder, None, "permutation"));
        }
        for (k, slope) in self.conventions.slope.iter().enumerate() {
            if slope.is_some_and(|s| s < TURNED) {
                out.push(sure(Effect::JointSign, Some(k), "sign"));
            }
        }
        out.retain(|b| {
            let effect =
                |c: &Column| matches!(c.meaning, Meaning::Effect(e) if self.withhold.contains(&e));
            !b.columns.iter().any(effect)
        });
        out
    }

    /// All blocks around `theta` of the body.
    fn blocks(
        &self,
        loads: &Loads,
        body: Option<Block>,
        starts: &[Vec<(usize, f64)>],
    ) -> Vec<Block> {
        let mut out: Vec<Block> = (0..JOINTS)
            .into_par_iter()
            .filter_map(|k| self.position(k, loads, &starts[k]))
            .collect();
        let torques: Vec<Block> = (0..JOINTS)
            .into_par_iter()
            .filter_map(|k| self.torque(k, loads))
            .collect();
        out.extend(torques);
        out.extend(body);
        out.extend(self.readings());
        out
    }
}

/// What a search found, with all it was made of.
pub(super) struct Explained {
    pub(super) blocks: Vec<Block>,
    pub(super) causes: Vec<Cause>,
    pub(super) always: Vec<Cause>,
    pub(super) found: Found,
}

/// Searches the causes.
pub(super) fn explain(asked: &Asked<'_>, tier: Option<&mut body::Tier>) -> Explained {
    let neutral: Vec<f64> = super::body_library::coordinates(asked.model)
        .iter()
        .map(|c| c.neutral)
        .collect();
    let moves = body_block::moves(asked.model, tier.as_ref().is_some_and(|t| t.link_measured));
    let plain = [LinkMap::default(); JOINTS];
    let mut starts = Starts::default();
    let mut out: Option<Explained> = None;
    let mut tier = tier;
    let mut world: Option<World> = None;
    for _ in 0..PASSES {
        if world.as_ref().is_none_or(|w| w.0 != starts.body) {
            let theta = body_block::placed(&moves, &neutral, &starts.body);
            let (params, maps) = match tier.as_ref() {
                Some(tier) => (Arc::new(tier.params(&theta)), tier.links(&theta)),
                None => (Arc::clone(asked.params), plain),
            };
            let mut loads = Loads::new(asked.data, &params, &maps);
            let mut body = None;
            if let Some(tier) = tier.as_mut() {
                tier.among(&theta);
                loads = loads.with_body(asked.data, tier, &moves, &theta, &starts.body);
                let block = body_block::block(tier, &moves, &neutral, &starts.body);
                body = Some(block.with_model_error(MODEL_ERROR[2]));
            }
            world = Some((starts.body.clone(), loads, body));
        }
        let Some((_, loads, body)) = &world else {
            break;
        };
        let blocks = asked.blocks(loads, body.clone(), &starts.joints);
        let all = causes(&blocks, &groups(), asked.withhold);
        let always = shared_slack(&blocks);
        let problem = Problem {
            blocks: &blocks,
            causes: &all,
            always: &always,
        };
        let found = problem.search(asked.least, MOST);
        let again = Starts::of(&problem, &found);
        let next = Explained {
            blocks,
            causes: all,
            always,
            found,
        };
        let same = out.as_ref().is_some_and(|o| o.names() == next.names());
        out = Some(next);
        if same || again == starts {
            break;
        }
        starts = again;
    }
    out.expect("at least one pass")
}

/// The coefficients that body and loads were played with, and what they gave.
type World = (Vec<(usize, f64)>, Loads, Option<Block>);

/// Effect, joints and fixed parameters of a cause.
type Name = (Option<Effect>, Vec<usize>, Vec<(&'static str, f64)>);

/// Passes of search and linearisation.
const PASSES: usize = 3;

/// Coefficients that blocks are linearised around.
#[derive(Debug, Clone, Default, PartialEq)]
struct Starts {
    joints: [Vec<(usize, f64)>; JOINTS],
    body: Vec<(usize, f64)>,
}

impl Starts {
    /// Where the set found has its coefficients.
    fn of(problem: &Problem<'_>, found: &Found) -> Self {
        let mut out = Self::default();
        let coefficients = problem.coefficients(&found.best.members);
        for (block, column, value) in coefficients {
            let site = problem.blocks[block].site;
            let list = match (site.stage, site.joint) {
                (Stage::Driver, Some(k)) if problem.blocks[block].columns.len() > 1 => {
                    &mut out.joints[k]
                }
                (Stage::Body, None) if problem.blocks[block].columns.len() > 1 => &mut out.body,
                _ => continue,
            };
            list.push((column, value));
        }
        out
    }
}

impl Explained {
    fn problem(&self) -> Problem<'_> {
        Problem {
            blocks: &self.blocks,
            causes: &self.causes,
            always: &self.always,
        }
    }

    /// Effects and joints found.
    fn names(&self) -> Vec<Name> {
        let one = |m: &usize| {
            let c = &self.causes[*m];
            (c.effect, c.joints.clone(), c.fixed.clone())
        };
        self.found.best.members.iter().map(one).collect()
    }
}
