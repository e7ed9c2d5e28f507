//! The clock that all joints share, read off the drift of their set-points' delays.

use rayon::prelude::*;

use super::echo::{Address, STRAY, TICK_S};
use crate::math;

/// Joints that must agree on a clock.
pub(super) const ONE_CLOCK: usize = 3;
/// Least drift over the longest run, in rows: less shows as arrivals one row late at most.
const DRIFTED: f64 = 0.7;
/// Slopes that are tried are this far apart.
const STEP: f64 = 2e-5;
/// Arrivals of one joint out of place that no damaged frame makes, and the share of them that may stay on the right clock.
const ODD: f64 = 8.0;
const MENDED: f64 = 0.2;

/// A clock that drifts by `slope`: the shortest delay beside it that places arrivals about as well as any, and the arrivals out of place.
struct Placed {
    slope: f64,
    delay_s: f64,
    stray: f64,
}

impl Placed {
    fn new(addresses: &[&Address], slope: f64, few: f64) -> Self {
        let row_s = addresses.first().map_or(0.0, |a| a.row_s);
        let delays = [0.0, 1.5 * TICK_S].into_iter();
        let tries: Vec<Self> = delays
            .chain((1..64).map(|i| 0.25 * row_s * f64::from(i)))
            .map(|delay_s| Self {
                slope,
                delay_s,
                stray: addresses.iter().map(|a| a.stray(slope, delay_s)).sum(),
            })
            .collect();
        let least = tries.iter().map(|t| t.stray).fold(f64::INFINITY, f64::min);
        let near = tries.into_iter().find(|t| t.stray <= least + few);
        near.unwrap_or(Self {
            slope,
            delay_s: 0.0,
            stray: f64::INFINITY,
        })
    }
}

/// How far a straight line through delays that rows round may be from the clock: the noise of its slope, and a clock that drifts by a row or two
/// shows as one step.
fn reach(row_s: f64, length_s: f64) -> f64 {
    80.0 * STEP + row_s / length_s
}

/// Arrivals of every joint out of place on a clock that drifts by `slope`, after the best delay of each.
fn strays(addresses: &[&Address], slope: f64) -> Vec<f64> {
    let one = |a: &&Address| Placed::new(&[a], slope, 0.0).stray;
    addresses.iter().map(one).collect()
}

/// Whether so many joints are that a clock may be the cause.
fn many(joints: impl Iterator<Item = bool>) -> bool {
    joints.filter(|x| *x).count() >= ONE_CLOCK
}

/// Drift of the delays that all joints share, and its error.
pub(super) fn clock(addresses: &[Option<Address>]) -> Option<(f64, f64)> {
    let drifts: Vec<(f64, f64)> = addresses
        .iter()
        .flatten()
        .filter_map(Address::drift)
        .collect();
    if drifts.is_empty() {
        return None;
    }
    let slope = math::median(&drifts.iter().map(|d| d.0).collect::<Vec<_>>());
    let a = addresses.iter().flatten().next()?;
    let agree = |d: &&(f64, f64)| (d.0 - slope).abs() <= 0.1 * slope.abs() + 3.0 * d.1;
    let error = math::median(&drifts.iter().map(|d| d.1).collect::<Vec<_>>());
    let seen = (slope * a.length_s).abs() > DRIFTED * a.row_s && slope.abs() > 5.0 * error;
    let seen = seen && many(drifts.iter().map(|d| agree(&d)));
    let known: Vec<&Address> = addresses.iter().flatten().collect();
    let few = STRAY * known.iter().map(|a| a.sent()).sum::<f64>();
    let still = strays(&known, 0.0);
    if !seen && !many(still.iter().map(|s| *s > ODD)) {
        return None;
    }
    // Rows beat with the drift: the slope at which fewest arrivals are out of place is better than a straight line through them. A clock
    // and a delay stand in for each other: of slopes that place arrivals alike, those with the shortest delay are taken.
    let most = (reach(a.row_s, a.length_s) / STEP) as i32;
    let tries: Vec<Placed> = (-most..=most)
        .into_par_iter()
        .map(|i| Placed::new(&known, slope + STEP * f64::from(i), few))
        .collect();
    let least = |v: &mut dyn Iterator<Item = f64>| v.fold(f64::INFINITY, f64::min);
    let fewest = least(&mut tries.iter().map(|t| t.stray));
    let near = |t: &&Placed| t.stray <= fewest + few;
    let shortest = least(&mut tries.iter().filter(near).map(|t| t.delay_s));
    let taken = |t: &&Placed| near(t) && t.delay_s <= shortest;
    let fewest = least(&mut tries.iter().filter(taken).map(|t| t.stray));
    let best: Vec<f64> = tries
        .iter()
        .filter(|t| taken(t) && t.stray <= fewest)
        .map(|t| t.slope)
        .collect();
    let best = math::mean(&best);
    let mended = |(before, after): (&f64, f64)| *before > ODD && after < MENDED * before;
    if !seen && !many(still.iter().zip(strays(&known, best)).map(mended)) {
        return None;
    }
    // Rows and ticks let a clock slip by a tick over the whole run unseen.
    Some((best, error.min(1e-4).max(TICK_S / a.length_s)))
}
