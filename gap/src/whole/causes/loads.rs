//! Loads of the joints along the measured motion, and what the body's parameters change about them.

use std::sync::Arc;

use physics::Params;
use rayon::prelude::*;

use crate::evidence::block::{Column, Owner};
use crate::whole::blocks::body::Move;
use crate::whole::body;
use crate::whole::data::{Data, JOINTS};
use crate::whole::windows::{self, LinkMap, PERIOD_S};

/// Length of the windows that loads are replayed in, s.
const WINDOW_S: f64 = 1.0;
/// Time from one to the next, s: each load is the mean of five, because feet land earlier or later in each.
const EVERY_S: f64 = 0.2;
/// The same of the windows in which changes are played, and how much later they begin. The loads of these are no part of
/// the errors: a column that shared their noise would explain it.
const CHANGE_EVERY_S: f64 = 0.2;
const LATER_S: f64 = 0.1;
/// Creep of the other make of contacts, m/s per N (that of MuJoCo's default contact, see `body::contacts`).
const CREEP_M_S_N: f64 = 0.002;

/// Loads of all joints by run, on a grid of `PERIOD_S`.
pub(super) type ByRun = Vec<[Vec<f64>; JOINTS]>;

/// Loads along the measured motion.
pub(super) struct Loads {
    /// By make of the contacts, the nominal one first.
    pub(super) makes: Vec<ByRun>,
    /// The part that balances weight.
    pub(super) gravity: ByRun,
    /// Change per coefficient of the body's parameters, with their columns.
    pub(super) body: Vec<(Column, ByRun, f64)>,
}

fn difference(a: &ByRun, b: &ByRun, by: f64) -> ByRun {
    let one = |(a, b): (&[Vec<f64>; JOINTS], &[Vec<f64>; JOINTS])| {
        std::array::from_fn(|k| a[k].iter().zip(&b[k]).map(|(a, b)| (a - b) / by).collect())
    };
    a.iter().zip(b).map(one).collect()
}

impl Loads {
    pub(super) fn new(data: &Data, params: &Arc<Params>, maps: &[LinkMap; JOINTS]) -> Self {
        let windows = windows::cut(data, WINDOW_S, EVERY_S);
        let later = windows::cut_from(data, WINDOW_S, CHANGE_EVERY_S, LATER_S);
        let play = |p: Params, windows: &[windows::Window]| {
            windows::replay(data, &mut windows.to_vec(), &Arc::new(p), maps, PERIOD_S)
        };
        let own = Params::clone(params);
        let nominal = play(own.clone(), &windows);
        let mut creeping = own.clone();
        (creeping.pyramid, creeping.slip_m_s_n) = (!own.pyramid, CREEP_M_S_N);
        let other = play(creeping, &windows);
        let mut heavy = own.clone();
        heavy.joints.iter_mut().for_each(|j| j.gravity_ratio += 1.0);
        let gravity = difference(&play(heavy, &later), &play(own, &later), 1.0);
        Self {
            makes: vec![nominal, other],
            gravity,
            body: Vec::new(),
        }
    }

    /// With what the body's parameters change.
    pub(super) fn with_body(
        mut self,
        data: &Data,
        tier: &body::Tier,
        moves: &[Move],
        theta: &[f64],
        start: &[(usize, f64)],
    ) -> Self {
        let windows = windows::cut_from(data, WINDOW_S, CHANGE_EVERY_S, LATER_S);
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
                let step = m.step_from(at);
                let change = difference(&play(&m.from(theta, step)), &here, step);
                (column, change, at)
            })
            .collect();
        self
    }
}
