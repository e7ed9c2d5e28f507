//! Gaits for the robot: the best ones, and others of medium fitness that move differently (paper, section VI).

use crate::search::Found;
use crate::space::GaitSpace;
use control::gait::Oscillator;
use control::math;
use serde::{Deserialize, Serialize};

/// How many gaits to take.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SelectSettings {
    /// Gaits in all; the paper's 17.
    pub count: usize,
    /// Of them the fastest; the rest are chosen for being different. The paper gives no number: a third.
    pub best: usize,
    /// Gaits used to fit parameters; the paper's 6.
    pub training: usize,
    /// A gait chosen for being different has at least this share of the best fitness ("medium fitness").
    pub least_fitness: f64,
    /// Two chosen gaits differ at least this much; see [`difference`].
    pub least_difference: f64,
}

impl Default for SelectSettings {
    fn default() -> Self {
        Self {
            count: 17,
            best: 6,
            training: 6,
            least_fitness: 0.4,
            least_difference: 0.05,
        }
    }
}

/// A chosen gait.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Chosen {
    /// The gait as found.
    pub found: Found,
    /// Chosen for its speed, or for being different.
    pub why: Why,
    /// Difference to the nearest gait chosen before it; `None` for the first.
    pub difference: Option<f64>,
    /// Whether it belongs to the training set.
    pub training: bool,
}

/// Why a gait was chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Why {
    /// Among the fittest.
    Best,
    /// Farthest from all chosen before, at medium fitness or better.
    Different,
}

/// How unlike the motions of two gaits are: the root mean square distance of their joint angles over one period at steady state, in units of half a
/// turn, both started at the phase of joint 0. Equal motions have 0; amplitudes near zero make offsets and lags not matter, as they should.
#[must_use]
pub fn difference(space: &GaitSpace, a: &[f64], b: &[f64]) -> f64 {
    const SAMPLES: usize = 24;
    let (a, b) = (motion(space, a, SAMPLES), motion(space, b, SAMPLES));
    let mut sum = 0.0;
    for (p, q) in a.iter().zip(&b) {
        // Joints turn without end: angles half a turn apart are as far as angles get.
        let gap = f64::from(math::wrap_pi(p - q));
        sum += gap * gap;
    }
    (sum / (SAMPLES * space.joints()) as f64).sqrt() / f64::from(math::PI)
}

/// Joint angles over one period of the locked gait, sample by sample.
fn motion(space: &GaitSpace, position: &[f64], samples: usize) -> Vec<f32> {
    let Ok(gait) = space.gait(position, "searched") else {
        return vec![f32::NAN; samples * space.joints()];
    };
    let at = |sample: usize| {
        let turn = math::TAU * sample as f32 / samples as f32;
        let angle = move |o: &Oscillator| {
            o.amplitude_rad * math::sin(turn + o.initial_phase_rad) + o.offset_rad
        };
        gait.oscillators().iter().map(angle)
    };
    (0..samples).flat_map(at).collect()
}

/// Choose gaits from an archive: first the fittest that differ from each other, then by farthest-point order. The training set takes
/// every kind: its members are spread evenly over the order of choice.
#[must_use]
pub fn select(space: &GaitSpace, archive: &[Found], settings: &SelectSettings) -> Vec<Chosen> {
    let mut order: Vec<&Found> = archive
        .iter()
        .filter(|found| found.score.fitness > 0.0)
        .collect();
    order.sort_by(|a, b| b.score.fitness.total_cmp(&a.score.fitness));
    let least = order
        .first()
        .map_or(0.0, |best| best.score.fitness * settings.least_fitness);
    let mut chosen: Vec<Chosen> = Vec::new();
    for found in &order {
        if chosen.len() >= settings.best.min(settings.count) {
            break;
        }
        let nearest = nearest(space, &chosen, found);
        if nearest.is_none_or(|d| d >= settings.least_difference) {
            chosen.push(Chosen::new(found, Why::Best, nearest));
        }
    }
    let mut candidates: Vec<(&Found, f64)> = order
        .iter()
        .take_while(|found| found.score.fitness >= least)
        .map(|found| {
            (
                *found,
                nearest(space, &chosen, found).unwrap_or(f64::INFINITY),
            )
        })
        .collect();
    while chosen.len() < settings.count {
        let farthest = candidates.iter().max_by(|a, b| a.1.total_cmp(&b.1));
        let Some(&(found, distance)) = farthest.filter(|(_, d)| *d >= settings.least_difference)
        else {
            break;
        };
        chosen.push(Chosen::new(found, Why::Different, Some(distance)));
        for (candidate, nearest) in &mut candidates {
            *nearest = nearest.min(difference(space, &candidate.position, &found.position));
        }
    }
    let (n, training) = (chosen.len(), settings.training.min(chosen.len()));
    for k in 0..training {
        chosen[k * n / training].training = true;
    }
    chosen
}

fn nearest(space: &GaitSpace, chosen: &[Chosen], found: &Found) -> Option<f64> {
    let distances = chosen
        .iter()
        .map(|c| difference(space, &c.found.position, &found.position));
    distances.min_by(f64::total_cmp)
}

impl Chosen {
    fn new(found: &Found, why: Why, difference: Option<f64>) -> Self {
        Self {
            found: found.clone(),
            why,
            difference,
            training: false,
        }
    }
}
