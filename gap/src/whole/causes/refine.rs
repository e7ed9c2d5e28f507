//! Passes of linearisation and search, and the point that the next one is linearised around: where the causes found fit
//! best when they are played.

use rayon::prelude::*;

use super::super::blocks::body::{self as body_block, Move, placed};
use super::super::blocks::position::Played;
use super::super::body::Tier;
use super::super::body_library::coordinates;
use super::super::data::JOINTS;
use super::super::fit::{Coordinate, Fit};
use super::loads::Loads;
use super::{Asked, Explained, Posed, Starts, World, groups};
use crate::evidence::block::{Block, White};
use crate::evidence::cause::{causes, shared_slack};
use crate::evidence::search::Problem;
use crate::vocabulary::Stage;

/// Most causes.
const MOST: usize = 8;
/// Shares of a size that are tried before a fit: neighbours of a played shape stand a factor of three apart.
const SHARES: [f64; 4] = [0.5, 0.7, 1.4, 2.0];
/// Most steps of a fit of the body.
const STEPS: usize = 6;

/// The search of a robot's causes, pass by pass.
pub(super) struct Passes<'a> {
    pub(super) asked: &'a Asked<'a>,
    pub(super) tier: Option<&'a mut Tier>,
    coordinates: Vec<Coordinate>,
    pub(super) moves: Vec<Move>,
    /// Servos that have a cause.
    pub(super) caused: [bool; JOINTS],
    /// Coefficients of the servos.
    pub(super) joints: [Vec<(usize, f64)>; JOINTS],
    pub(super) posed: Posed,
    world: Option<(Posed, World)>,
    pub(super) whites: Vec<White>,
    /// Nominal numbers of the servos where they fit best without a cause.
    pub(super) settled: [Vec<(usize, f64)>; JOINTS],
    /// Block, column and coefficient of what the last pass found.
    pub(super) explained: Vec<(usize, usize, f64)>,
}

impl<'a> Passes<'a> {
    pub(super) fn new(asked: &'a Asked<'a>, tier: Option<&'a mut Tier>) -> Self {
        let linked = tier.as_ref().is_some_and(|t| t.link_measured);
        Self {
            asked,
            tier,
            coordinates: coordinates(asked.model),
            moves: body_block::moves(asked.model, linked),
            caused: [false; JOINTS],
            joints: Default::default(),
            posed: Posed::nominal(asked.model),
            world: None,
            whites: Vec::new(),
            settled: Default::default(),
            explained: Vec::new(),
        }
    }

    /// Loads of the last pass.
    pub(super) fn loads(&self) -> &Loads {
        &self.world.as_ref().expect("a pass was made").1.0
    }

    /// The servo of joint `k` on the runs that are fitted.
    pub(super) fn played(&self, k: usize) -> Played {
        self.asked.servo(k, self.loads(), |inputs, known, _| {
            Played::new(inputs, known)
        })
    }

    /// Linearises and searches.
    pub(super) fn pass(&mut self) -> Explained {
        let first = self.world.is_none();
        if self.world.as_ref().is_none_or(|w| w.0 != self.posed) {
            let tier = self.tier.as_deref_mut();
            let world = self.asked.world(tier, &self.moves, &self.posed);
            self.world = Some((self.posed.clone(), world));
        }
        let (_, (loads, body)) = self.world.as_ref().expect("just made");
        if first {
            self.settled = self.asked.settled(loads);
            self.joints = self.settled.clone();
        }
        self.whites = self.asked.blocks(loads, body.clone(), &self.joints);
        let blocks: Vec<Block> = (0..self.whites.len()).map(|i| self.block(i)).collect();
        let all = causes(&blocks, &groups(), self.asked.withhold);
        let always = shared_slack(&blocks, &self.asked.calibration.spreads);
        let problem = Problem {
            blocks: &blocks,
            causes: &all,
            always: &always,
        };
        let calibration = self.asked.calibration;
        let asks: Vec<f64> = all.iter().map(|c| calibration.ask(&c.into())).collect();
        let found = problem.search(&asks, MOST);
        self.explained = problem.coefficients(&found.best.members);
        Explained {
            blocks,
            causes: all,
            always,
            found,
            damping: self.posed.damping(),
            fitted: Vec::new(),
        }
    }

    /// Block `i` as robots without a cause differ, with the error of what is explained in it.
    fn block(&self, i: usize) -> Block {
        let own = self.explained.iter().filter(|e| e.0 == i);
        let by: Vec<(usize, f64)> = own.map(|e| (e.1, e.2)).collect();
        let white = &self.whites[i];
        let spreads = &self.asked.calibration.spreads;
        spreads.taken_from(white, white.explained(&by))
    }

    /// Block, column and coefficient of the servos that have a cause, where their runs, played, fit best.
    pub(super) fn fitted_servos(&self) -> Vec<(usize, usize, f64)> {
        let own = |(i, w): (usize, &White)| {
            let played = w.site.stage == Stage::Driver && w.columns.len() > 1;
            let k = w.site.joint.filter(|k| played && self.caused[*k])?;
            Some(self.joints[k].iter().map(move |(c, x)| (i, *c, *x)))
        };
        let all = self.whites.iter().enumerate();
        all.filter_map(own).flatten().collect()
    }

    /// Moves the point of linearisation to where the causes `found` fit best.
    pub(super) fn refine(&mut self, found: &Explained) {
        let spreads = &self.asked.calibration.spreads;
        let starts = Starts::of(&found.problem(), &found.found, &self.whites, spreads);
        let sites = self.explained.iter().map(|e| self.whites[e.0].site);
        let own = sites.filter(|s| s.stage == Stage::Driver);
        let driven: Vec<usize> = own.filter_map(|s| s.joint).collect();
        self.caused = std::array::from_fn(|k| driven.contains(&k));
        let fit = |k: usize| {
            let start = &starts.joints[k];
            if self.caused[k] {
                self.played(k).fitted(start)
            } else {
                self.asked.within(k, self.loads(), start.clone())
            }
        };
        let joints: Vec<_> = (0..JOINTS).into_par_iter().map(fit).collect();
        self.joints = joints.try_into().unwrap_or_default();
        self.posed = match self.tier.as_deref() {
            Some(tier) if !starts.body.is_empty() => self.fitted(tier, &starts.body),
            _ => Posed::nominal(self.asked.model),
        };
    }

    /// The coefficients of `start`, each at the share of its own that windows fit best with, one after the other: from far
    /// away a slope leads astray.
    fn scaled(&self, tier: &Tier, start: &[(usize, f64)], nominal: &[f64]) -> Vec<(usize, f64)> {
        let mut best = start.to_vec();
        let cost = |s: &[(usize, f64)]| tier.thinned(&placed(&self.moves, nominal, s), 1);
        let mut least = cost(&best);
        for i in 0..best.len() {
            let tried = SHARES.map(|share| {
                let mut other = best.clone();
                other[i].1 *= share;
                (cost(&other), other)
            });
            for (cost, other) in tried {
                if cost < least {
                    (least, best) = (cost, other);
                }
            }
        }
        best
    }

    /// The body where windows fit best: coefficients of the causes in `start`, and what the model leaves open.
    fn fitted(&self, tier: &Tier, start: &[(usize, f64)]) -> Posed {
        let (moves, own) = (&self.moves, &self.coordinates);
        let nominal = Posed::nominal(self.asked.model).theta;
        let along = start.iter().flat_map(|s| &moves[s.0].along);
        let freed: Vec<usize> = along.map(|a| a.0).collect();
        let fit = Fit {
            model: tier,
            coordinates: own,
            freed: &freed,
            independent: tier.len() as f64,
        };
        let start = self.scaled(tier, start, &nominal);
        let fit = fit.from(&placed(moves, &nominal, &start), STEPS);
        let theta = fit.theta;
        let open = |m: &Move| match m.along.as_slice() {
            [(at, _)] => own[*at].sigma > 0.0 && theta[*at] != nominal[*at],
            _ => false,
        };
        let named = |m: usize| start.iter().any(|s| s.0 == m);
        let all = moves.iter().enumerate();
        let moved = all.filter(|(i, m)| named(*i) || open(m));
        Posed {
            moved: moved
                .map(|(i, m)| (i, m.coefficient(&theta, &nominal)))
                .collect(),
            theta,
            spread: fit.spread,
        }
    }
}
