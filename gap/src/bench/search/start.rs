//! Where a search starts that does not know all of a joint.

use super::super::data::{Data, Errors};
use super::super::fit::Fit;
use super::super::model::{Coordinate, Model, Point};
use super::super::noise::Noise;
use super::{STAYS, Search};
use crate::math::Rng;

/// Draws of what is not stated, within so many standard deviations, and how many of them are fitted; their seed.
const DRAWS: usize = 160;
const WIDE: f64 = 2.0;
const REFINED: usize = 4;
const DRAWN: u64 = 1;

impl Search<'_> {
    /// What is not stated, where it fits best of many draws within its prior; all else as stated.
    pub(super) fn scattered(&self, data: &Data<'_>) -> Point {
        let all = self.nuisances.iter();
        let unstated: Vec<Coordinate> = all.filter(|c| !c.stated).copied().collect();
        if unstated.is_empty() {
            return self.base;
        }
        let mut rng = Rng::new(DRAWN);
        let mut points = vec![self.base];
        points.extend((1..DRAWS).map(|_| {
            let mut out = self.base;
            for c in &unstated {
                let z = WIDE * (2.0 * rng.uniform() - 1.0);
                out.set(c.axis, c.value(c.mean + c.sd * z));
            }
            out
        }));
        let order = |points: Vec<Point>| {
            let errors = data.errors(&points);
            let mut own: Vec<(f64, Point, Errors)> = points
                .into_iter()
                .zip(errors)
                .map(|(p, e)| (likeness(data, &e), p, e))
                .collect();
            own.sort_by(|a, b| a.0.total_cmp(&b.0));
            own
        };
        let best = order(points).into_iter().take(REFINED);
        let fitted = best.map(|(_, point, errors)| {
            let noise = Noise::plain(data, &errors);
            let model = Model {
                base: self.base,
                coordinates: unstated.clone(),
            };
            let start = model.start(&point);
            Fit::new(data, &noise, model, &start, STAYS).point()
        });
        order(fitted.collect()).remove(0).1
    }
}

/// Minus the logarithm of the likelihood of errors of which each channel has white noise of its own size.
fn likeness(data: &Data<'_>, errors: &Errors) -> f64 {
    let one = |k: usize| {
        let (mut squares, mut rows) = (0.0, 0.0);
        for s in data.series(k) {
            for (e, w) in errors[s].iter().zip(&data.weights[s]) {
                squares += w * e * e;
                rows += w;
            }
        }
        0.5 * rows * libm::log(squares / f64::max(rows, 1.0) + data.floor(k) * data.floor(k))
    };
    (0..data.channels.len()).map(one).sum()
}
