//! The encoder given the set-points: the angle less that of the nominal servo, which is stable and forgets its
//! start in 0.3 s.
//!
//! What is measured of the joint stands on one side only. With the measured angle in the loop its noise would be a
//! regressor, and a late encoder would explain the noise (seen: 100 times the evidence of any planted cause).

mod lost;
mod played;
mod servo;
mod shapes;

use crate::evidence::block::{Column, Raw, Segment, Site};
use crate::evidence::settle::REACH;
use crate::vocabulary::{Effect, Stage};

use super::super::data::Track;
use super::super::nominal::Nominal;
use lost::Lost;
pub(in crate::whole) use played::{Played, errors_rad};
use servo::Grid;
pub(in crate::whole) use servo::Law;
use shapes::{Change, Shape, shape};

/// What two simulators of one servo differ by from one angle to the next: rad, and share of the angle's spread. The
/// old servo of the diagnosis and the emulated driver of `hil-sim`, both at their own steps, differ by 0.2 mrad on
/// 0.8 rad.
const LEAST_RAD: f64 = 1.0e-4;
const SHARE: f64 = 5.0e-4;

/// Steps of coarse set-points that are played, rad: 4 % apart, because steps of another size fall out of time after
/// a few.
const COARSEST_RAD: f64 = 0.25;
const FINEST_RAD: f64 = 0.004;
const APART: f64 = 1.04;
/// Steps that are kept of them.
const KEPT: usize = 3;

/// What one run of a joint holds.
pub(in crate::whole) struct Input<'a> {
    /// Set-points in force.
    pub(in crate::whole) command: Track,
    /// Encoder.
    pub(in crate::whole) position: &'a Track,
    /// Torque that the joint bears, N m, on a grid of `load_step_s`; empty where it is not known.
    pub(in crate::whole) load_nm: &'a [f64],
    /// Step of that grid, s.
    pub(in crate::whole) load_step_s: f64,
    /// Torque from which the motor is at its limit, N m, and the measured torque.
    pub(in crate::whole) limit: Option<(f64, &'a Track)>,
}

/// What is known of a joint's servo and its set-points.
pub(in crate::whole) struct Known {
    pub(in crate::whole) nominal: Nominal,
    /// Between which delays set-points come in force, s; `None` where nothing tells.
    pub(in crate::whole) late_s: Option<[f64; 2]>,
    /// The set-points are those that the driver applied.
    pub(in crate::whole) applied: bool,
    /// Tolerance of the largest speed, as a share of it.
    pub(in crate::whole) speed_tolerance: f64,
    /// The echo tells losses and rounding.
    pub(in crate::whole) echoed: bool,
    /// Set-points are on the robot's clock already: the echo shows how far it drifts.
    pub(in crate::whole) clocked: bool,
    /// Time between rows, s.
    pub(in crate::whole) row_s: f64,
    /// The loads are measured, or replayed from a measured pose of the base.
    pub(in crate::whole) loaded: bool,
}

fn less(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// Spread of the angle, rad.
fn spread_rad(grids: &[Grid]) -> f64 {
    let mut all = Vec::new();
    for g in grids {
        let mean = crate::math::mean(&g.q);
        all.extend(g.q.iter().map(|q| q - mean));
    }
    crate::math::rms(&all)
}

/// Coarse set-points: the steps that explain most of the errors, by themselves.
fn steps_rad(grids: &[Grid], base: Law) -> Vec<f64> {
    let steps: Vec<f64> = std::iter::successors(Some(FINEST_RAD), |s| Some(s * APART))
        .take_while(|s| *s < COARSEST_RAD)
        .collect();
    let laws: Vec<Law> = std::iter::once(base)
        .chain(steps.iter().map(|step| Law {
            step: *step,
            ..base
        }))
        .collect();
    let mut sums = vec![[0.0, 1e-12]; steps.len()];
    for g in grids {
        let all = g.all_compared(&laws);
        let left = less(&g.angles(), &all[0]);
        for ([xy, xx], moved) in sums.iter_mut().zip(&all[1..]) {
            for (x, left) in less(moved, &all[0]).iter().zip(&left) {
                *xy += x * left;
                *xx += x * x;
            }
        }
    }
    let score = |[xy, xx]: &[f64; 2]| if *xy > 0.0 { xy * xy / xx } else { 0.0 };
    let mut scored: Vec<(f64, f64)> = sums.iter().map(score).zip(steps).collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored.iter().take(KEPT).map(|s| s.1).collect()
}

/// Set-points at the instants of the control tick, where rows show each of them late by a part of a row.
pub(in crate::whole) fn regular(track: Track) -> Track {
    let tick_s = 1.0 / physics::CONTROL_RATE_HZ;
    let row_s = track.period_s();
    let mut events: Vec<(f64, f64)> = Vec::new();
    for (t, v) in track.t_s.iter().zip(&track.v) {
        if events.last().is_none_or(|l| l.1 != *v) {
            events.push((*t, *v));
        }
    }
    let phases: Vec<f64> = events.iter().skip(1).map(|e| e.0 / tick_s).collect();
    let Some(first) = phases.first().copied() else {
        return track;
    };
    // Distance of each event to the ticks through the first one; the earliest is the least late.
    let off: Vec<f64> = phases
        .iter()
        .map(|p| (p - first) - (p - first).round())
        .collect();
    let [low, high] = [
        crate::math::quantile(&off, 0.0),
        crate::math::quantile(&off, 1.0),
    ];
    if (high - low) * tick_s > 1.05 * row_s || row_s >= tick_s {
        return track;
    }
    let phase = first + low;
    let mut out = Track::default();
    for (t, v) in events {
        let tick = ((t / tick_s - phase) + 1e-6).floor();
        out.t_s.push(((tick + phase) * tick_s).max(0.0));
        out.v.push(v);
    }
    out
}

/// What may be different about the servo of these runs.
fn shapes(known: &Known, grids: &[Grid]) -> Vec<Shape> {
    let loads = grids.iter().flat_map(|g| &g.load);
    let load_nm = if known.loaded {
        loads.fold(0.0, |a: f64, x| a.max(x.abs()))
    } else {
        0.0
    };
    let mut all = shapes::shapes(known, load_nm);
    if !known.echoed && !known.applied {
        let steps = steps_rad(grids, Law::nominal(&known.nominal));
        for (i, step) in steps.into_iter().enumerate() {
            let column = Column {
                prior: [1.0, 0.05],
                ..Column::played(Effect::Quantisation, "step_rad", 0.0, step, i)
            };
            all.push(shape(column, Change::Step(step), 1.0));
        }
    }
    all
}

/// Coefficients of nominal numbers, of which those of the speed limit together stay within its tolerance: it has a column
/// for each of several sizes.
pub(in crate::whole) fn within(known: &Known, mut start: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    let all = shapes::shapes(known, 0.0);
    let size = |c: usize| match all.get(c) {
        Some(s) if s.column.slack > 0.0 => s.change.limits(),
        _ => 0.0,
    };
    let lost: f64 = start.iter().map(|(c, by)| size(*c) * by).sum();
    let most = REACH * known.speed_tolerance.max(shapes::LEAST_TOLERANCE);
    if lost.abs() > most {
        for (c, by) in &mut start {
            if size(*c) != 0.0 {
                *by *= most / lost.abs();
            }
        }
    }
    start
}

/// Laws to play, that with all coefficients of `start` first, and for each shape the two between which its slope is
/// taken with the coefficient between them.
fn slopes(
    all: &[Shape],
    start: &[(usize, f64)],
    there: Law,
) -> (Vec<Law>, Vec<(usize, usize, f64)>) {
    let mut laws = vec![there];
    let mut place = |law: Law| match laws.iter().position(|l| *l == law) {
        Some(at) => at,
        None => {
            laws.push(law);
            laws.len() - 1
        }
    };
    let slope = |(c, s): (usize, &Shape)| {
        // What is in the law already is taken away, so that the errors with and without it are as they are
        // played; another shape of its effect stands in its place.
        let within = start.iter().find(|x| x.0 == c && x.1.abs() > 1e-9);
        let step = within.map_or(s.step, |x| -x.1);
        let alike = |x: &&(usize, f64)| {
            all[x.0].column.slack == 0.0 && all[x.0].column.meaning == s.column.meaning
        };
        let rivals = start.iter().filter(|x| within.is_none() && alike(x));
        let from = rivals.fold(there, |law, (c, by)| all[*c].change.on(law, -by));
        (place(from), place(s.change.on(from, step)), step)
    };
    let slopes = all.iter().enumerate().map(slope).collect();
    (laws, slopes)
}

/// The block of joint `joint` around the coefficients `start`; `None` without a run that is long enough.
pub(in crate::whole) fn raw(
    joint: usize,
    inputs: &[Input<'_>],
    known: &Known,
    start: &[(usize, f64)],
) -> Option<Raw> {
    let grids: Vec<Grid> = inputs.iter().filter_map(Grid::new).collect();
    let base = Law::nominal(&known.nominal);
    let all = shapes(known, &grids);
    let heard = known.echoed || known.applied;
    // Lost set-points are found again beside the rest: their column stands behind all others.
    let there_already: Vec<(usize, f64)> =
        start.iter().copied().filter(|s| s.0 < all.len()).collect();
    let start = there_already.as_slice();
    let there = start
        .iter()
        .fold(base, |law, (c, by)| all[*c].change.on(law, *by));
    let (laws, slopes) = slopes(&all, start, there);
    let mut segments = Vec::new();
    let lost: Vec<Lost> = grids.iter().map(|g| g.lost(&there)).collect();
    let loses = lost::share(&lost).filter(|_| !heard);
    for (grid, lost) in grids.iter().zip(&lost) {
        let played = grid.all_compared(&laws);
        let plain = &played[0];
        let column = |(from, to, step): &(usize, usize, f64)| -> Vec<f64> {
            let change = less(&played[*to], &played[*from]);
            change.iter().map(|x| x / step).collect()
        };
        let mut x: Vec<Vec<f64>> = slopes.iter().map(column).collect();
        if loses.is_some() {
            let came = grid.compared(&grid.answer(&there, &lost.command));
            x.push(less(&came, plain));
        }
        let mut y = less(&grid.angles(), plain);
        for (c, by) in start {
            y.iter_mut().zip(&x[*c]).for_each(|(y, x)| *y += by * x);
        }
        segments.push(Segment {
            y,
            weight: grid.weights(&there),
            x,
        });
    }
    let spread = spread_rad(&grids);
    let mut columns: Vec<Column> = all.into_iter().map(|a| a.column).collect();
    if let Some((share, ways)) = loses {
        columns.push(Column {
            prior: [1.0, 0.1],
            cost: ways,
            ..Column::played(Effect::PacketLoss, "probability", 0.0, share, 0)
        });
    }
    (!segments.is_empty()).then_some(Raw {
        site: Site {
            stage: Stage::Driver,
            joint: Some(joint),
            blind: false,
            coarse: false,
        },
        columns,
        segments,
        floor: LEAST_RAD + SHARE * spread,
        noisy: Vec::new(),
    })
}

#[cfg(test)]
mod tests;
