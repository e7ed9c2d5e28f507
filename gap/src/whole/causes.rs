//! Causes of a robot's gap: blocks of the chain, groups of joints, the search.

use std::sync::Arc;

use files::model::{Key, Model};
use physics::Params;
use rayon::prelude::*;

use super::blocks::body::Move;
use super::blocks::{self, body as body_block, position, torque};
use super::conventions::Conventions;
use super::data::{Data, JOINTS, Run, Track};
use super::direct::Reading;
use super::nominal::{Nominal, inter, nominal};
use super::windows::{self, LinkMap, PERIOD_S, Window};
use super::{body, servo};
use crate::evidence::block::{Block, Column, Meaning, Owner, Segment, Site};
use crate::evidence::cause::{Cause, Group, Scope, causes, shared_slack};
use crate::evidence::search::{Found, Problem};
use crate::vocabulary::{Effect, Stage};

/// Order of the autoregression that whitens: 0.12 s of angles, 0.24 s of torques.
const ORDER: usize = 6;
/// Evidence that a cause must add.
const LEAST: f64 = 6.0;
/// Most causes.
const MOST: usize = 8;

/// Loads of all joints by run, on a grid of `PERIOD_S`.
type ByRun = Vec<[Vec<f64>; JOINTS]>;

/// Loads along the measured motion.
struct Loads {
    /// By make of the contacts, the nominal one first.
    makes: Vec<ByRun>,
    /// The part that balances weight.
    gravity: ByRun,
    /// Change per coefficient of the body's parameters, with their columns.
    body: Vec<(Column, ByRun, f64)>,
}

fn difference(a: &ByRun, b: &ByRun, by: f64) -> ByRun {
    let one = |(a, b): (&[Vec<f64>; JOINTS], &[Vec<f64>; JOINTS])| {
        std::array::from_fn(|k| a[k].iter().zip(&b[k]).map(|(a, b)| (a - b) / by).collect())
    };
    a.iter().zip(b).map(one).collect()
}

impl Loads {
    fn new(data: &Data, params: &Arc<Params>, maps: &[LinkMap; JOINTS]) -> Self {
        let mut windows = windows::cut(data, 1.0, 0.9);
        let mut play = |p: Params| windows::replay(data, &mut windows, &Arc::new(p), maps, PERIOD_S);
        let own = Params::clone(params);
        let nominal = play(own.clone());
        let mut heavy = own.clone();
        heavy.joints.iter_mut().for_each(|j| j.gravity_ratio += 1.0);
        let twice = play(heavy);
        let mut creeping = own.clone();
        (creeping.pyramid, creeping.slip_m_s_n) = (!own.pyramid, 0.002);
        let other = play(creeping);
        let gravity = difference(&twice, &nominal, 1.0);
        Self {
            makes: vec![nominal, other],
            gravity,
            body: Vec::new(),
        }
    }

    /// With what the body's parameters change.
    fn with_body(mut self, data: &Data, tier: &body::Tier, moves: &[Move], theta: &[f64], start: &[(usize, f64)]) -> Self {
        let windows = windows::cut(data, 1.0, 0.9);
        let play = |theta: &[f64]| {
            let (params, maps) = (Arc::new(tier.params(theta)), tier.links(theta));
            windows::replay(data, &mut windows.clone(), &params, &maps, PERIOD_S)
        };
        let here = play(theta);
        self.body = moves
            .par_iter()
            .enumerate()
            .filter(|(_, m)| m.loads)
            .map(|(i, m)| {
                let mut column = m.column.clone();
                if column.owner == Owner::Block {
                    column.owner = Owner::Robot;
                }
                let at = start.iter().find(|s| s.0 == i).map_or(0.0, |s| s.1);
                let step = if at.abs() > 1e-9 { -at } else { m.step };
                let change = difference(&play(&m.from(theta, step)), &here, step);
                (column, change, at)
            })
            .collect();
        self
    }
}

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

fn env(name: &str, or: f64) -> f64 {
    std::env::var(name).ok().and_then(|x| x.parse().ok()).unwrap_or(or)
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
}

impl Asked<'_> {
    fn limit_nm(&self, k: usize, servo: &Nominal) -> (f64, Option<f64>) {
        let all: Vec<f64> = self
            .runs
            .iter()
            .filter_map(|r| effort(&self.data.runs[*r], k, servo.nm_per_a))
            .flat_map(|e| e.v.into_iter().map(f64::abs))
            .collect();
        let top = crate::math::quantile(&all, 0.995);
        let plain = 0.95 * servo.max_torque_nm;
        let near = all.iter().filter(|x| **x > 0.95 * top && **x < 1.02 * top).count() as f64;
        let below = all.iter().filter(|x| **x > 0.85 * top && **x <= 0.95 * top).count() as f64;
        let plateau = near > 3.0 * below && near > 0.01 * all.len() as f64;
        (if plateau { 0.95 * top } else { plain }, plateau.then_some(top))
    }

    fn position(&self, k: usize, loads: &Loads, start: &[(usize, f64)]) -> Option<Block> {
        let c = self.conventions;
        let servo = nominal(self.model, k);
        let echo = &c.echo[c.order[k]];
        let speed = self.model.parameter(if inter(k) { Key::InterSpeed } else { Key::IntraSpeed });
        if std::env::var("RB_DEBUG").is_ok() { eprintln!("echo {k} {echo:?} slope {:?} off {}", c.slope[k], c.offset_rad[k]); }
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
                let shift_s = echo.late_s.map_or(0.0, |[low, high]| (0.5 * (low + high)).max(0.0));
                let _ = shift_s;
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
        Some(Block::new(position::raw(k, &inputs, &known, start)?, ORDER).with_model_error(env("DS", 0.12)))
    }

    fn torque(&self, k: usize, loads: &Loads) -> Option<Block> {
        let servo = nominal(self.model, k);
        let tracked = self.data.runs.iter().any(|r| r.base.is_some());
        let mass = Column::linear(Effect::Mass, "ratio", 1.0, 0.4)
            .of_robot()
            .with_shared_slack("mass", if tracked { env("SM", 0.12) } else { 1.0 });
        let known = torque::Known {
            damping_nm_s: servo.damping_nm_s_rad,
            body: std::iter::once(mass).chain(loads.body.iter().map(|b| b.0.clone())).collect(),
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
                    body_nm: std::iter::once(load.as_slice()).chain(loads.body.iter().map(|b| b.1[*r][k].as_slice())).collect(),
                    body_at: std::iter::once(0.0).chain(loads.body.iter().map(|b| b.2)).collect(),
                    load_step_s: PERIOD_S,
                })
            })
            .collect();
        Some(Block::new(torque::raw(k, &inputs, &known)?, ORDER).with_model_error(if tracked { env("DT", 0.03) } else { 0.3 }))
    }

    fn readings(&self) -> Vec<Block> {
        let mut out: Vec<Block> = self.direct.iter().map(reading).collect();
        for k in 0..JOINTS {
            let servo = nominal(self.model, k);
            let (_, plateau) = self.limit_nm(k, &servo);
            if let Some(nm) = plateau.filter(|nm| *nm < servo.at_limit_nm()[0]) {
                let half = 0.04 * nm;
                let estimate = super::direct::exact(nm, half);
                out.push(reading(&Reading { effect: Effect::TorqueLimit, joint: Some(k), key: "limit_nm", estimate, gain: 0.0 }));
            }
        }
        if self.conventions.mixed() {
            out.push(sure(Effect::JointOrder, None, "permutation"));
        }
        for (k, slope) in self.conventions.slope.iter().enumerate() {
            if slope.is_some_and(|s| s < -0.3) {
                out.push(sure(Effect::JointSign, Some(k), "sign"));
            }
        }
        out.retain(|b| {
            let effect = |c: &Column| matches!(c.meaning, Meaning::Effect(e) if self.withhold.contains(&e));
            !b.columns.iter().any(effect)
        });
        out
    }

    /// All blocks around `theta` of the body.
    fn blocks(&self, loads: &Loads, body: Option<Block>, starts: &[Vec<(usize, f64)>]) -> Vec<Block> {
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

/// A convention that set-points and angles show at once, as a block of one row.
fn sure(effect: Effect, joint: Option<usize>, key: &'static str) -> Block {
    let segment = Segment {
        y: vec![SURE],
        x: vec![vec![SURE]],
        weight: vec![1.0],
    };
    let site = Site {
        stage: effect.stage(),
        joint,
    };
    let column = Column::linear(effect, key, 0.0, 1.0).shaped(200, &[]);
    Block::whitened(site, vec![column], &[segment], [1.0, SURE])
}

/// Standard deviations by which a joint that follows another set-point, or turns the other way, stands out.
const SURE: f64 = 20.0;

/// A number that was read off the signals, as a block of one row.
fn reading(r: &Reading) -> Block {
    let neutral = match r.key {
        "limit_nm" => r.estimate.value + 5.0 * (r.estimate.ci95[1] - r.estimate.value),
        "ratio" => 1.0,
        "value_v" => 12.0,
        _ => 0.0,
    };
    let error = ((r.estimate.ci95[1] - r.estimate.value) / 1.96).max(0.02 * (r.estimate.value - neutral).abs());
    let off = r.estimate.value - neutral;
    let sd = off.abs().max(1e-6);
    let segment = Segment {
        y: vec![off / error],
        x: vec![vec![1.0 / error]],
        weight: vec![1.0],
    };
    let site = Site {
        stage: r.effect.stage(),
        joint: r.joint,
    };
    let column = Column::linear(r.effect, r.key, neutral, sd).shaped(200, &[]);
    Block::whitened(site, vec![column], &[segment], [1.0, off.abs() / error])
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
    let _ = servo::STEP_S;
    let neutral: Vec<f64> = super::body_library::coordinates(asked.model)
        .iter()
        .map(|c| c.neutral)
        .collect();
    let moves = body_block::moves(asked.model, tier.as_ref().is_some_and(|t| t.link_measured));
    let plain = [LinkMap::default(); JOINTS];
    let mut starts = Starts::default();
    let mut out: Option<Explained> = None;
    let mut tier = tier;
    let mut world: Option<(Vec<(usize, f64)>, Loads, Option<Block>)> = None;
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
                body = Some(block.with_model_error(env("DB", 0.03)));
            }
            world = Some((starts.body.clone(), loads, body));
        }
        let Some((_, loads, body)) = &world else { break };
        let blocks = asked.blocks(loads, body.clone(), &starts.joints);
        let all = causes(&blocks, &groups(), asked.withhold);
        let always = shared_slack(&blocks);
        let problem = Problem {
            blocks: &blocks,
            causes: &all,
            always: &always,
        };
        let found = problem.search(LEAST, MOST);
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
                (Stage::Driver, Some(k)) if problem.blocks[block].columns.len() > 1 => &mut out.joints[k],
                (Stage::Body, None) if problem.blocks[block].columns.len() > 1 => &mut out.body,
                _ => continue,
            };
            list.push((column, value));
        }
        out
    }
}

impl Explained {
    /// Effects and joints found.
    fn names(&self) -> Vec<(Option<Effect>, Vec<usize>, Vec<(&'static str, f64)>)> {
        let one = |m: &usize| {
            let c = &self.causes[*m];
            (c.effect, c.joints.clone(), c.fixed.clone())
        };
        self.found.best.members.iter().map(one).collect()
    }

    fn name(&self, cause: usize) -> String {
        let c = &self.causes[cause];
        let effect = c.effect.map_or("open", Effect::name);
        format!("{effect} {:?} {:?} {:?}", c.scope, c.joints, c.fixed)
    }

    /// Text for those who develop the diagnosis.
    pub(super) fn text(&self) -> String {
        use std::fmt::Write as _;
        let problem = Problem {
            blocks: &self.blocks,
            causes: &self.causes,
            always: &self.always,
        };
        let mut out = String::new();
        for b in &self.blocks {
            let _ = writeln!(
                out,
                "block {:?} {:?} rows {:.0} square/row {:.3} noise {:.2e} before {:.2e}",
                b.site.stage,
                b.site.joint,
                b.rows,
                b.square / b.rows.max(1.0),
                b.noise,
                b.before
            );
        }
        let posterior = problem.posterior(&self.found.best.members);
        let _ = writeln!(out, "evidence {:.1} of {} causes", self.found.best.evidence, self.causes.len());
        for (i, m) in self.found.best.members.iter().enumerate() {
            let _ = writeln!(out, "* {} gain {:.1}", self.name(*m), self.found.gains[i]);
            let n = posterior.mean.len();
            for number in &self.causes[*m].numbers {
                let (mut mean, mut var) = (number.mean, 0.0);
                for (l, w) in &number.of_latents {
                    let at = posterior.first[i] + l;
                    mean += w * posterior.mean[at];
                    for (l2, w2) in &number.of_latents {
                        var += w * w2 * posterior.covariance[at * n + posterior.first[i] + l2];
                    }
                }
                let _ = writeln!(
                    out,
                    "    {:?} {} = {:.4} +- {:.4}",
                    number.joint,
                    number.key,
                    number.neutral + number.scale * mean,
                    (number.scale * var.sqrt()).abs()
                );
            }
            for r in self.found.rivals[i].iter().take(4) {
                let _ = writeln!(out, "      rival {} margin {:.1}", self.name(r.cause), r.margin);
            }
        }
        for (i, m) in self.found.best.members.iter().enumerate() {
            let c = &self.causes[*m];
            let effect = c.effect.map_or("open", Effect::name);
            let near = self.found.rivals[i].first().map_or(String::new(), |r| format!("{} {:.1}", self.name(r.cause), r.margin));
            let _ = writeln!(out, "=> {effect}|{:?}|{:?}|{:.1}|{near}", c.scope, c.joints, self.found.gains[i]);
        }
        if let Some((c, gain)) = self.found.next {
            let _ = writeln!(out, "next {} gain {:.1}", self.name(c), gain);
        }
        out
    }
}

/// The blocks' grid is that of the loads.
#[allow(dead_code)]
fn grid(track: &Track) -> Vec<f64> {
    blocks::resampled(track, 0.0, PERIOD_S, 1)
}

#[allow(dead_code)]
type Unused = Window;

#[allow(dead_code)]
const STAGE: Stage = Stage::Body;
