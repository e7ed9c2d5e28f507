//! Loads of the joints along the measured motion, and what the body's parameters change about them.

use std::sync::Arc;

use physics::Params;
use rayon::prelude::*;

use crate::evidence::block::{Column, Owner};
use crate::vocabulary::Effect;
use crate::whole::blocks::body::Move;
use crate::whole::body;
use crate::whole::data::{Data, JOINTS};
use crate::whole::windows::{self, LinkMap, PERIOD_S};

/// Length of the windows that a servo's loads are replayed in where no torque was measured, s, and time from one to the
/// next. At its limit the largest loads count, and the start of a window has the largest errors.
/// Kept by hand as they were when shorter ones read a limit of 1 N m as 1.5 in a test; no calibration says so.
const LONG_S: [f64; 2] = [1.0, 0.2];
/// Length of the windows that loads are replayed in, s. Of three compared on 6 to 30 healthy robots of the calibration: the
/// one that leaves least noise in the torques.
const WINDOW_S: f64 = 0.4;
/// Time from one to the next, s: each load is the mean of a dozen, because feet land earlier or later in each.
const EVERY_S: f64 = 0.025;
/// The same of the windows in which changes are played, twice, and how much later each begins. The loads of these are no
/// part of the errors: a column that shared their noise would explain it.
const CHANGE_EVERY_S: f64 = 0.2;
const LATER_S: [f64; 2] = [0.05, 0.15];
/// Creep of the other make of contacts, m/s per N (that of MuJoCo's default contact, see `body::contacts`).
const CREEP_M_S_N: f64 = 0.002;
/// How much of another make a robot's contacts may have, and of its own at each joint: one standard deviation.
const MAKE: f64 = 0.7;
const OWN_MAKE: f64 = 0.2;

/// Loads of all joints by run, on a grid of `PERIOD_S`.
pub(super) type ByRun = Vec<[Vec<f64>; JOINTS]>;

/// Loads along the measured motion.
pub(super) struct Loads {
    /// Of the nominal model.
    pub(super) nominal: ByRun,
    /// The same in longer windows, for servos.
    pub(super) borne: ByRun,
    /// Changes per coefficient with their columns and the coefficients that are in the loads already. The first is the
    /// load itself, in other windows than those of the errors.
    pub(super) plays: Vec<(Column, Change, f64)>,
}

/// Mean of two plays, and half of what they differ by.
pub(super) struct Change {
    pub(super) mean: ByRun,
    pub(super) half: ByRun,
}

impl Change {
    fn new([a, b]: &[ByRun; 2]) -> Self {
        Self {
            mean: combined(a, b, [0.5, 0.5]),
            half: combined(a, b, [0.5, -0.5]),
        }
    }

    /// Per coefficient, over a step for each play.
    fn between(there: &[ByRun; 2], here: &[ByRun; 2], steps: [f64; 2]) -> Self {
        let slope = |i: usize| combined(&there[i], &here[i], [1.0 / steps[i], -1.0 / steps[i]]);
        Self::new(&std::array::from_fn(slope))
    }
}

/// Windows in which changes are played.
fn later(data: &Data) -> [Vec<windows::Window>; 2] {
    LATER_S.map(|from_s| windows::cut_from(data, WINDOW_S, CHANGE_EVERY_S, from_s))
}

fn combined(a: &ByRun, b: &ByRun, [p, q]: [f64; 2]) -> ByRun {
    let one = |(a, b): (&[Vec<f64>; JOINTS], &[Vec<f64>; JOINTS])| {
        std::array::from_fn(|k| {
            let rows = a[k].iter().zip(&b[k]);
            rows.map(|(a, b)| p * a + q * b).collect()
        })
    };
    a.iter().zip(b).map(one).collect()
}

impl Loads {
    pub(super) fn new(data: &Data, params: &Arc<Params>, maps: &[LinkMap; JOINTS]) -> Self {
        let windows = windows::cut(data, WINDOW_S, EVERY_S);
        let later = later(data);
        let play = |p: Params, windows: &[windows::Window]| {
            windows::replay(data, windows, &Arc::new(p), maps, PERIOD_S)
        };
        let own = Params::clone(params);
        let nominal = play(own.clone(), &windows);
        let [length_s, every_s] = LONG_S;
        let borne = play(own.clone(), &windows::cut(data, length_s, every_s));
        let mut creeping = own.clone();
        creeping.slip_m_s_n = CREEP_M_S_N;
        let mut other_cone = own.clone();
        other_cone.pyramid = !own.pyramid;
        let mut heavy = own.clone();
        heavy.joints.iter_mut().for_each(|j| j.gravity_ratio += 1.0);
        let twice = |p: &Params| [0, 1].map(|i| play(p.clone(), &later[i]));
        let own = twice(&own);
        let changed = |there: &Params| Change::between(&twice(there), &own, [1.0; 2]);
        let mass = Column::linear(Effect::Mass, "ratio", 1.0, 0.4).of_robot();
        let weight = Column::linear(Effect::GravityLoad, "ratio", 1.0, 0.5);
        let make = |key| Column::nuisance(OWN_MAKE).with_shared_slack(key, MAKE);
        let plays = vec![
            (mass, Change::new(&own), 0.0),
            (weight, changed(&heavy), 0.0),
            (make("creep"), changed(&creeping), 0.0),
            (make("cone"), changed(&other_cone), 0.0),
        ];
        Self {
            nominal,
            borne,
            plays,
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
        let windows = later(data);
        let play = |theta: &[f64], side: usize| {
            let (params, maps) = (Arc::new(tier.params(theta)), tier.links(theta));
            windows::replay(data, &windows[side], &params, &maps, PERIOD_S)
        };
        let here = [0, 1].map(|side| play(theta, side));
        let of_body: Vec<_> = moves
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
                let steps = m.shares.map(|share| share * step);
                let there = [0, 1].map(|side| play(&m.from(theta, steps[side]), side));
                let change = Change::between(&there, &here, steps);
                (column, change, at)
            })
            .collect();
        self.plays.extend(of_body);
        self
    }
}
