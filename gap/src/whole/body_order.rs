//! Order and signs of joints that only the body shows: recorded and commanded in one convention, turned in another.

use super::body::{B, SOFTER, Tier};
use super::conventions::permutations;
use super::data::{Data, JOINTS};
use super::direct;
use super::nominal;
use super::search::Fit;

/// Cost below which no other order of joints and no other sign is tried: turned end cubes alone show 3.5; robots without a cause show up to
/// 1.7 (emulated robots), so that few of them try in vain.
const RIGHT: f64 = 1.6;
/// Cost from which exchanges one by one lead nowhere, and offsets may be large.
pub(super) const FAR: f64 = 4.0;

/// What a cost must fall to for another order or other signs to be taken: a robot whose joints are right gains nothing by turning one round
/// that matters, and little by one that hardly does.
const BETTER: f64 = 0.6;
/// Least fall of the cost on the way there: of three joints in a ring the first exchange puts one right.
const STEP: f64 = 0.97;
/// Of windows, one in so many is enough to see the right one of all orders.
const THIN: usize = 4;

/// Finds order and signs; `fit` fits a ground that gives.
pub(super) fn find(
    data: &Data,
    tier: &mut Tier,
    theta: &[f64],
    fit: impl Fn(&Tier, &[f64]) -> Option<Fit>,
) {
    let told = (tier.maps, tier.order);
    let first = tier.thinned(theta, 1);
    if first < RIGHT {
        return;
    }
    if let Some(kinds) = direct::displaced(data)
        && by_motors(tier, theta, &kinds)
    {
        return;
    }
    let mut last = descend(tier, theta, first, 1);
    if last > BETTER * first && first > FAR {
        // From far away exchanges lead nowhere.
        (tier.maps, tier.order) = told;
        tier.order = best_order(tier, theta, |_| true);
        let now = tier.thinned(theta, 1);
        last = descend(tier, theta, now, 1);
    }
    if last > BETTER * first {
        (tier.maps, tier.order) = told;
        if first > FAR {
            on_soft_ground(data, tier, theta, fit);
        }
    }
}

/// The same on grounds that give: on a hard one nothing mends windows of feet that stand in a soft one. What is found is judged by windows that
/// are measured with it, on the ground that fits them best.
fn on_soft_ground(
    data: &Data,
    tier: &mut Tier,
    theta: &[f64],
    fit: impl Fn(&Tier, &[f64]) -> Option<Fit>,
) {
    let told = (tier.maps, tier.order);
    let mut first = f64::INFINITY;
    let mut best = (f64::INFINITY, told, theta.to_vec());
    for give in SOFTER {
        let mut theta = theta.to_vec();
        theta[B::GroundGive as usize] = give;
        let now = tier.thinned(&theta, THIN);
        first = first.min(now);
        let last = descend(tier, &theta, now, THIN);
        if last < best.0 {
            best = (last, (tier.maps, tier.order), theta);
        }
        (tier.maps, tier.order) = told;
    }
    let (last, found, ground) = best;
    if found == told || last > STEP * first {
        return;
    }
    tier.measure(data, &ground);
    let cost = |tier: &Tier| fit(tier, &ground).map_or(f64::INFINITY, |f| f.cost);
    let as_told = cost(tier);
    (tier.maps, tier.order) = found;
    // A ground that fits the joints as they are told needs no joint turned round.
    if cost(tier) > BETTER * as_told.min(first) {
        (tier.maps, tier.order) = told;
        tier.settle(data, theta.to_vec());
    }
}

/// Turns and exchanges joints as long as the cost of every `thin`-th window falls; returns the cost.
fn descend(tier: &mut Tier, theta: &[f64], mut now: f64, thin: usize) -> f64 {
    let cost = |tier: &Tier| tier.thinned(theta, thin);
    for _ in 0..2 * JOINTS {
        if now < RIGHT {
            break;
        }
        let (maps, order) = (tier.maps, tier.order);
        let mut best = (now, maps, order);
        for a in 0..JOINTS {
            tier.maps[a].ratio = -maps[a].ratio;
            let c = cost(tier);
            if c < best.0 {
                best = (c, tier.maps, order);
            }
            tier.maps = maps;
            for b in a + 1..JOINTS {
                tier.order.swap(a, b);
                let c = cost(tier);
                if c < best.0 {
                    best = (c, maps, tier.order);
                }
                tier.order = order;
            }
        }
        if best.0 > STEP * now {
            break;
        }
        (now, tier.maps, tier.order) = best;
    }
    now
}

/// Half plays of the connector with which orders that the motors allow are tried, rad: a loose one hides which of them is right.
const LOOSER_RAD: [f64; 2] = [0.04, 0.1];

/// Takes the order that the motors allow and the windows fit best, on a hard ground, a soft one or with a loose connector; whether there is one.
/// The motors have shown that joints stand elsewhere: the windows only tell which.
fn by_motors(tier: &mut Tier, theta: &[f64], kinds: &[Option<bool>; JOINTS]) -> bool {
    let told = (tier.maps, tier.order);
    let softer = SOFTER.map(|give| (B::GroundGive, give));
    let looser = LOOSER_RAD.map(|play| (B::ConnectorPlay, play));
    let mut best = (f64::INFINITY, told);
    for (b, value) in softer.into_iter().chain(looser) {
        let mut theta = theta.to_vec();
        theta[b as usize] = value;
        let as_told = tier.thinned(&theta, THIN);
        tier.order = best_order(tier, &theta, |order| allowed(order, kinds));
        let (exchanged, now) = (tier.order, tier.thinned(&theta, THIN));
        let mut cost = descend(tier, &theta, now, THIN);
        if !allowed(&tier.order, kinds) {
            (cost, tier.maps, tier.order) = (now, told.0, exchanged);
        }
        if cost < (STEP * as_told).min(best.0) {
            best = (cost, (tier.maps, tier.order));
        }
        (tier.maps, tier.order) = told;
    }
    (tier.maps, tier.order) = best.1;
    best.0.is_finite()
}

/// Whether every joint of `order` has a motor of its own kind, as far as motors are known.
fn allowed(order: &[usize; JOINTS], kinds: &[Option<bool>; JOINTS]) -> bool {
    let own =
        |(k, from): (usize, &usize)| kinds[*from].is_none_or(|weak| weak == nominal::inter(k));
    order.iter().enumerate().all(own)
}

/// Of the orders that `may` be the one with the least cost on some of the windows.
fn best_order(
    tier: &mut Tier,
    theta: &[f64],
    may: impl Fn(&[usize; JOINTS]) -> bool,
) -> [usize; JOINTS] {
    let mut best = (f64::INFINITY, tier.order);
    for order in permutations().into_iter().filter(may) {
        tier.order = order;
        let cost = tier.thinned(theta, THIN);
        if cost < best.0 {
            best = (cost, order);
        }
    }
    best.1
}
