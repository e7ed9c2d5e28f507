//! Causes of a robot's gap, shared by joints or not: blocks of the chain, groups of joints, the search.

mod errors;
mod held_out;
mod loads;
mod open;
mod places;
mod readings;
mod refine;
mod regimes;
mod remainder;
mod rows;
mod unseen;
mod windings;

use std::collections::BTreeMap;
use std::sync::Arc;

use files::model::{Key, Model};
use physics::Params;
use rayon::prelude::*;

use super::blocks::{body as body_block, electrical, position, torque, transmission};
use super::body;
use super::conventions::{self, Conventions};
use super::data::{Data, JOINTS, Track};
use super::direct::Reading;
use super::experiment::Open;
use super::nominal::{inter, nominal};
use super::windows::{LinkMap, PERIOD_S};
use crate::decide::{Calibration, Shown};
use crate::evidence::block::{Block, Meaning, Raw, White};
use crate::evidence::cause::{Cause, Group, Scope, causes, shared_slack};
use crate::evidence::ensemble::Spreads;
use crate::evidence::search::{Found, Problem};
use crate::evidence::settle::settled;
use crate::verdict::Unseen;
use crate::vocabulary::{Effect, Stage};
use errors::{POSE, SIGNALS};
pub(super) use held_out::JointRow;
pub use held_out::{HeldOut, Shrink};
use loads::Loads;
pub use places::Place;
pub(super) use places::UNEXPLAINED;
use readings::{reading, sure};
use refine::Passes;
pub use remainder::Left;
pub(super) use remainder::lefts;
pub use rows::{Alternative, Causes, Nearest, Probabilities, Row, Value, Word};
use unseen::Recorded;
use windings::effort;
pub(super) use windings::{motor, signals};

/// Order of the autoregression that whitens: 0.12 s of angles, 0.24 s of torques.
const ORDER: usize = 6;
/// Share of the limit from which a motor counts as at it.
const AT_LIMIT: f64 = 0.95;

/// The groups of joints that may share a cause.
pub(super) fn groups() -> Vec<Group> {
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

/// What is asked.
#[derive(Clone, Copy)]
pub(super) struct Asked<'a> {
    pub(super) data: &'a Data,
    pub(super) model: &'a Model,
    pub(super) params: &'a Arc<Params>,
    pub(super) conventions: &'a Conventions,
    pub(super) direct: &'a [Reading],
    /// Column in which each joint was recorded, and whether the body shows it turned round.
    pub(super) columns: [usize; JOINTS],
    pub(super) turned: [bool; JOINTS],
    /// The block of the films, and what they show at once.
    pub(super) films: &'a (Option<White>, Option<Reading>),
    pub(super) runs: &'a [usize],
    /// Runs that no fit sees, and how they were chosen.
    pub(super) held: &'a [usize],
    pub(super) split: &'a str,
    pub(super) withhold: &'a [Effect],
    /// What a cause must add, and what robots without a cause differ by.
    pub(super) calibration: &'a Calibration,
}

impl Asked<'_> {
    /// Whether the pose of the base was recorded.
    fn tracked(&self) -> bool {
        self.data.runs.iter().any(|r| r.base.is_some())
    }

    fn position(&self, k: usize, loads: &Loads, start: &[(usize, f64)]) -> Option<White> {
        let raw = self.servo(k, loads, |inputs, known, _| {
            position::raw(k, inputs, known, start)
        })?;
        Some(White::new(raw, ORDER))
    }

    /// What `then` makes of the servo of joint `k` in its runs.
    fn servo<T>(
        &self,
        k: usize,
        loads: &Loads,
        then: impl FnOnce(&[position::Input<'_>], &position::Known, &[usize]) -> T,
    ) -> T {
        let c = self.conventions;
        let servo = nominal(self.model, k);
        let echo = &c.echo[c.order[k]];
        let speed = self.model.parameter(if inter(k) {
            Key::InterSpeed
        } else {
            Key::IntraSpeed
        });
        let limit_nm = AT_LIMIT * servo.max_torque_nm;
        let efforts: Vec<Option<Track>> = self
            .runs
            .iter()
            .map(|r| effort(&self.data.runs[*r], k, &self.motor(k)))
            .collect();
        // What the motor bears, where it was measured.
        let borne: Vec<Option<Vec<f64>>> = efforts
            .iter()
            .zip(self.runs)
            .map(|(effort, r)| {
                let steps = (self.data.runs[*r].length_s / PERIOD_S) as usize;
                let effort = effort.as_ref()?;
                Some(
                    (0..=steps)
                        .map(|i| effort.at(i as f64 * PERIOD_S))
                        .collect(),
                )
            })
            .collect();
        let mut applied = false;
        let (inputs, runs): (Vec<position::Input<'_>>, Vec<usize>) = self
            .runs
            .iter()
            .zip(&efforts)
            .zip(&borne)
            .filter_map(|((r, effort), borne)| {
                let run = &self.data.runs[*r];
                let sent = run.joints[c.order[k]].command.as_ref();
                let heard = run.joints[c.echo_at[c.order[k]]].applied.as_ref();
                applied |= (echo.uneven || sent.is_none()) && heard.is_some();
                let mut command = position::regular(echo.command(sent, heard)?);
                command.v.iter_mut().for_each(|v| *v *= c.sign[k]);
                let input = position::Input {
                    command,
                    position: run.joints[k].position.as_ref()?,
                    load_nm: borne.as_ref().unwrap_or(&loads.borne[*r][k]),
                    load_step_s: PERIOD_S,
                    limit: effort.as_ref().map(|e| (limit_nm, e)),
                };
                Some((input, *r))
            })
            .unzip();
        let known = position::Known {
            nominal: servo,
            speed_tolerance: speed.tolerance / speed.value.max(1e-9),
            late_s: echo.late_s,
            applied,
            echoed: echo.late_s.is_some() || applied,
            clocked: echo.skew != 1.0,
            row_s: inputs.first().map_or(0.02, |i| i.position.period_s()),
            loaded: borne.iter().all(Option::is_some) || self.tracked(),
        };
        then(&inputs, &known, &runs)
    }

    /// Torques less what the motion takes; friction of one direction has this `sense`, or the one that shows.
    fn torque_errors(
        &self,
        k: usize,
        loads: &Loads,
        drawn: &[Track],
        sense: Option<f64>,
    ) -> Option<Raw> {
        let servo = nominal(self.model, k);
        let motor = self.motor(k);
        let heard: Vec<Option<electrical::Signals<'_>>> = self
            .runs
            .iter()
            .map(|r| signals(&self.data.runs[*r], k))
            .collect();
        let told = |h: &electrical::Signals<'_>| h.effort.is_some() || h.current.is_some();
        let known = torque::Known {
            damping_nm_s: servo.damping_nm_s_rad,
            tolerance_nm_s: servo.damping_tolerance_nm_s_rad,
            blind: !self.tracked(),
            coarse: !heard.iter().flatten().all(told),
            sense,
            plays: loads.plays.iter().map(|p| (p.0.clone(), p.2)).collect(),
        };
        let inputs: Vec<torque::Input<'_>> = self
            .runs
            .iter()
            .zip(&heard)
            .zip(drawn)
            .filter_map(|((r, heard), drawn)| {
                let run = &self.data.runs[*r];
                let heard = heard.as_ref()?;
                let effort = effort(run, k, &motor).or_else(|| heard.torque_of_duty(&motor))?;
                let electrical = match heard.effort {
                    Some(_) => Vec::new(),
                    None => electrical::of_torque(&motor, heard, drawn),
                };
                Some(torque::Input {
                    position: run.joints[k].position.as_ref()?,
                    effort,
                    load_nm: &loads.nominal[*r][k],
                    apart_nm: &loads.plays[0].1.mean[*r][k],
                    plays_nm: loads
                        .plays
                        .iter()
                        .map(|(_, c, _)| [c.mean[*r][k].as_slice(), c.half[*r][k].as_slice()])
                        .collect(),
                    load_step_s: PERIOD_S,
                    electrical,
                })
            })
            .collect();
        torque::raw(k, &inputs, &known)
    }

    /// Runs that show the torque of joint `k`.
    fn torque_runs(&self, k: usize) -> Vec<usize> {
        let motor = self.motor(k);
        let shows = |r: &&usize| {
            let run = &self.data.runs[**r];
            let told = |h: electrical::Signals<'_>| h.torque_of_duty(&motor).is_some();
            let heard = signals(run, k);
            heard.is_some_and(|h| effort(run, k, &motor).is_some() || told(h))
        };
        self.runs.iter().filter(shows).copied().collect()
    }

    /// Runs that show the link of joint `k`.
    fn link_runs(&self, k: usize) -> Vec<usize> {
        let shows = |r: &&usize| {
            let joint = &self.data.runs[**r].joints[k];
            joint.position.is_some() && joint.link.is_some()
        };
        self.runs.iter().filter(shows).copied().collect()
    }

    /// Angles of a link less those of its motor.
    fn link_errors(&self, k: usize, loads: &Loads) -> Option<Raw> {
        let inputs: Vec<transmission::Input<'_>> = self
            .runs
            .iter()
            .filter_map(|r| {
                let joint = &self.data.runs[*r].joints[k];
                Some(transmission::Input {
                    position: joint.position.as_ref()?,
                    link: joint.link.as_ref()?,
                    load_nm: &loads.nominal[*r][k],
                    load_step_s: PERIOD_S,
                })
            })
            .collect();
        transmission::raw(k, &inputs)
    }

    fn readings(&self) -> Vec<White> {
        let neutral = |key: &str| match key {
            "ratio" => 1.0,
            "value_v" => self.model.value(Key::SupplyVoltage),
            _ => 0.0,
        };
        let read = |r: &Reading| reading(r, neutral(r.key));
        let all = self.direct.iter().chain(&self.films.1);
        let mut out: Vec<White> = all.map(read).collect();
        // Of columns in another order too, the column of each joint's set-points.
        let order = self.conventions.order.map(|from| self.columns[from]);
        if order.iter().enumerate().any(|(k, from)| k != *from) {
            let number = conventions::permutation(&order);
            out.push(sure(Effect::JointOrder, None, ("permutation", number)));
        }
        for (k, sign) in self.conventions.sign.iter().enumerate() {
            if self.turned[k] || *sign < 0.0 {
                out.push(sure(Effect::JointSign, Some(k), ("sign", -1.0)));
            }
        }
        for column in out.iter_mut().flat_map(|b| &mut b.columns) {
            if matches!(column.meaning, Meaning::Effect(e) if self.withhold.contains(&e)) {
                // What it shows is there, whatever its name.
                column.meaning = Meaning::Open;
            }
        }
        out
    }

    /// The blocks of a robot around its nominal model.
    pub(super) fn nominal_blocks(&self, tier: Option<&mut body::Tier>) -> Vec<White> {
        let moves = body_block::moves(self.model, tier.as_ref().is_some_and(|t| t.link_measured));
        let (loads, body) = self.world(tier, &moves, &Posed::nominal(self.model));
        self.blocks(&loads, body, &self.settled(&loads))
    }

    /// Where the nominal numbers of each servo fit best.
    fn settled(&self, loads: &Loads) -> [Vec<(usize, f64)>; JOINTS] {
        let one = |k: usize| {
            let block = self.position(k, loads, &[]);
            let own = block.map_or_else(Vec::new, |b| settled(&b, &self.calibration.spreads));
            self.within(k, loads, own)
        };
        let each: Vec<_> = (0..JOINTS).into_par_iter().map(one).collect();
        each.try_into().unwrap_or_default()
    }

    /// Nominal numbers of the servo of joint `k`, each within its tolerance.
    fn within(&self, k: usize, loads: &Loads, own: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
        self.servo(k, loads, |_, known, _| position::within(known, own))
    }

    /// Loads of the joints and block of the base around `theta` of the body.
    fn world(
        &self,
        tier: Option<&mut body::Tier>,
        moves: &[body_block::Move],
        at: &Posed,
    ) -> World {
        let Some(tier) = tier else {
            let plain = [LinkMap::default(); JOINTS];
            return (Loads::new(self.data, self.params, &plain), None);
        };
        let (theta, start) = (&at.theta, &at.moved);
        tier.among(theta);
        let params = Arc::new(tier.params(theta));
        let loads = Loads::new(self.data, &params, &tier.links(theta));
        let loads = loads.with_body(self.data, tier, moves, theta, start);
        (loads, Some(body_block::block(tier, moves, theta, start)))
    }

    /// All blocks around `theta` of the body.
    fn blocks(
        &self,
        loads: &Loads,
        body: Option<White>,
        starts: &[Vec<(usize, f64)>],
    ) -> Vec<White> {
        let mut out: Vec<White> = (0..JOINTS)
            .into_par_iter()
            .filter_map(|k| self.position(k, loads, &starts[k]))
            .collect();
        let drawn = self.drawn();
        let torques: Vec<White> = (0..JOINTS)
            .into_par_iter()
            .filter_map(|k| {
                Some(White::new(
                    self.torque_errors(k, loads, &drawn, None)?,
                    ORDER,
                ))
            })
            .collect();
        out.extend(torques);
        out.extend(self.electrical(&drawn));
        let links = (0..JOINTS).filter_map(|k| self.link_errors(k, loads));
        out.extend(links.map(|raw| White::new(raw, ORDER)));
        out.extend(body);
        out.extend(self.films.0.clone());
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
    /// Damping of a soft ground with its standard deviation, N s/m: no column has it.
    pub(super) damping: [f64; 2],
    /// Block, column and coefficient of each servo's causes where its runs, played, fit best.
    pub(super) fitted: Vec<(usize, usize, f64)>,
}

/// Largest evidence that the `blocks` of a robot show for each effect.
pub(super) fn strongest(blocks: &[White], spreads: &Spreads) -> BTreeMap<Shown, f64> {
    let blocks: Vec<Block> = blocks.iter().map(|w| spreads.taken_from(w, 0.0)).collect();
    let all = causes(&blocks, &groups(), &[]);
    let problem = Problem {
        blocks: &blocks,
        causes: &all,
        always: &shared_slack(&blocks, spreads),
    };
    let none = problem.evidence(&[]);
    let adds: Vec<f64> = (0..all.len())
        .into_par_iter()
        .map(|c| problem.evidence(&[c]) - none)
        .collect();
    let mut out = BTreeMap::new();
    for (cause, adds) in all.iter().zip(adds) {
        let slot = out.entry(Shown::from(cause)).or_insert(adds);
        *slot = slot.max(adds);
    }
    out
}

/// What a report shows beside the causes.
pub(super) struct Beside {
    /// Effects that these signals could not show.
    pub(super) unseen: Vec<Unseen>,
    /// What a further experiment on the ground should decide.
    pub(super) open: Option<Open>,
    /// Noise of each signal; of the base, what its measured starts explain.
    pub(super) noise: BTreeMap<&'static str, f64>,
    /// Error of a torque by joint, where torques were measured, N m.
    pub(super) torque_nm: Vec<(usize, f64)>,
    /// Set-points were recorded as drivers echo them.
    pub(super) echoed: bool,
}

/// Searches the causes; `begins` hears the numbers 1 and 2 as search and comparison begin.
pub(super) fn explain(
    asked: &Asked<'_>,
    tier: Option<&mut body::Tier>,
    begins: &dyn Fn(usize),
) -> (Causes, Beside) {
    begins(1);
    let mut search = Passes::new(asked, tier);
    let mut out = search.pass();
    // Causes in the pass before, and whether what is found is linearised around itself.
    let (mut nothing, mut settled) = (true, false);
    for _ in 1..PASSES {
        let still = nothing;
        nothing = out.found.best.members.is_empty();
        if settled || (still && nothing) {
            break;
        }
        search.refine(&out);
        let next = search.pass();
        settled = out.names() == next.names();
        out = next;
    }
    let none = nothing && out.found.best.members.is_empty();
    if !settled && !none {
        search.refine(&out);
    }
    out.damping = search.posed.damping();
    out.fitted = search.fitted_servos();
    begins(2);
    let held_out = search.held_out(&out);
    let beside = search.beside(&out);
    (out.rows(asked.calibration, held_out), beside)
}

impl Passes<'_> {
    /// What a report shows beside the causes `found`.
    fn beside(&self, found: &Explained) -> Beside {
        let (asked, tier) = (self.asked, self.tier.as_deref());
        let runs = || asked.data.runs.iter();
        let recorded = Recorded {
            tracked: tier.is_some(),
            filmed: asked.data.filmed(),
            films: asked.films.0.is_some(),
            echoed: runs().any(|r| r.joints.iter().any(|j| j.applied.is_some())),
        };
        let worst = tier.and_then(|tier| tier.worst(&self.posed.theta));
        let of = |stage: Stage| {
            let own = self.whites.iter().filter(move |w| w.site.stage == stage);
            own.filter(|w| w.columns.len() > 1)
        };
        let stages = [Stage::Driver, Stage::Drivetrain, Stage::Transmission];
        let mut noise: BTreeMap<&'static str, f64> = BTreeMap::new();
        for (signal, stage) in SIGNALS.iter().zip(stages) {
            let all: Vec<f64> = of(stage).map(|w| w.noise).collect();
            if !all.is_empty() {
                noise.insert(signal.0, crate::math::mean(&all));
            }
        }
        noise.extend(tier.map(|t| (SIGNALS[POSE].0, t.tolerance_m())));
        let torque = |w: &White| Some((w.site.joint?, w.noise * libm::hypot(1.0, w.left)));
        Beside {
            unseen: found.unseen(asked.calibration, asked.withhold, recorded),
            open: found.open(asked, worst),
            noise,
            torque_nm: of(Stage::Drivetrain).filter_map(torque).collect(),
            echoed: recorded.echoed,
        }
    }
}

/// Loads, and the block of the base.
type World = (Loads, Option<White>);

/// What a patch takes of a cause: effect, joint, parameters.
use crate::verdict::causes::Part;

/// Effect, joints and fixed parameters of a cause.
type Name = (Option<Effect>, Vec<usize>, Vec<(&'static str, f64)>);

/// Passes of search and linearisation.
const PASSES: usize = 3;

/// Where body and loads are played.
#[derive(Debug, Clone, PartialEq)]
struct Posed {
    /// Coordinates of the body.
    theta: Vec<f64>,
    /// Their standard deviations.
    spread: Vec<f64>,
    /// Coefficients of the moves there.
    moved: Vec<(usize, f64)>,
}

impl Posed {
    fn nominal(model: &Model) -> Self {
        let all = super::body_library::coordinates(model);
        Self {
            theta: all.iter().map(|c| c.neutral).collect(),
            spread: all.iter().map(|c| c.sigma).collect(),
            moved: Vec::new(),
        }
    }

    /// Damping of a contact point and its standard deviation, N s/m; implicit steps damp a spring of their own accord.
    fn damping(&self) -> [f64; 2] {
        let at = body::B::GroundDamping as usize;
        let give = self.theta[body::B::GroundGive as usize].max(1e-9);
        let lent = 0.5 * super::windows::options(false).time_step_s / give;
        [self.theta[at], libm::hypot(self.spread[at], lent / 1.96)]
    }
}

/// Coefficients that blocks are linearised around.
#[derive(Debug, Clone, Default, PartialEq)]
struct Starts {
    joints: [Vec<(usize, f64)>; JOINTS],
    body: Vec<(usize, f64)>,
}

impl Starts {
    /// Where the set found has its coefficients; the nominal numbers of a servo that has none. Beside a cause they stay as
    /// stated: what it leaves would move them, as two emulated robots of development showed (seed 7, 2 and 32).
    fn of(problem: &Problem<'_>, found: &Found, whites: &[White], spreads: &Spreads) -> Self {
        let mut out = Self::default();
        let coefficients = problem.coefficients(&found.best.members);
        for (block, column, value) in coefficients {
            let site = problem.blocks[block].site;
            if problem.blocks[block].columns[column].meaning == Meaning::Open {
                // What no effect has cannot be played.
                continue;
            }
            let list = match (site.stage, site.joint) {
                (Stage::Driver, Some(k)) if problem.blocks[block].columns.len() > 1 => {
                    &mut out.joints[k]
                }
                (Stage::Body, None) if problem.blocks[block].columns.len() > 1 => &mut out.body,
                _ => continue,
            };
            list.push((column, value));
        }
        for white in whites.iter().filter(|w| w.columns.len() > 1) {
            if let (Stage::Driver, Some(k)) = (white.site.stage, white.site.joint)
                && out.joints[k].is_empty()
            {
                out.joints[k] = settled(white, spreads);
            }
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
