//! What the best set leaves, against what the recording's own noise leaves.

use super::data::{Data, Errors};
use super::drive_of;
use super::library::column;
use super::model::Point;
use crate::decide::Calibration;
use crate::joint::Channel;

/// What is left, by itself and as a part of what was there.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Remainder {
    /// What is left of each column over its noise, dB, none below zero; by the column, whether positions are predicted
    /// over the joint's horizon or whole runs, and what its controller puts out.
    pub(super) left_db: Vec<(String, f64)>,
    /// Share of the squares beyond the noise that stays, in the channel that showed most.
    pub(super) share: f64,
}

/// Mean square of a channel.
fn square(data: &Data<'_>, errors: &Errors, k: usize) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for s in data.series(k) {
        for (e, w) in errors[s].iter().zip(&data.weights[s]) {
            sum += w * e * e;
            n += w;
        }
    }
    if n > 0.0 { sum / n } else { 0.0 }
}

/// Compares the joint before and after, over the horizon of `data` and over whole runs: causes that predict the next rows
/// alone leave the rest.
pub(super) fn remainder(data: &Data<'_>, before: &Point, after: &Point) -> Remainder {
    let mut out = Remainder {
        left_db: Vec::new(),
        share: 1.0,
    };
    let mut most = 0.0;
    let all = data.over(f64::INFINITY);
    let output = data.problem.runs.first().map(|r| r.nominal.output);
    let by = output.map_or("", drive_of);
    for (data, over) in [(data, "its horizon"), (&all, "whole runs")] {
        let [before, after] = [before, after].map(|p| data.errors(&[*p]).remove(0));
        for k in 0..data.channels.len() {
            let noise = data.own_noise(k).max(1e-300);
            let noise = noise * noise;
            let [was, is] = [&before, &after].map(|e| square(data, e, k));
            let left = beyond_db(is, noise);
            let column = column(Channel::ALL[data.channels[k]]);
            out.left_db
                .push((format!("{column} over {over} by {by}"), left));
            if was / noise > most {
                most = was / noise;
                out.share = (is - noise).max(0.0) / (was - noise).max(1e-3 * noise);
            }
        }
    }
    out
}

/// What squares are over those of their noise, dB: no more than noise is nothing.
fn beyond_db(squares: f64, noise: f64) -> f64 {
    10.0 * libm::log10((squares / noise).max(1.0))
}

impl Remainder {
    /// Chance that a joint without a cause leaves as much of any column beyond its noise, in units of what such joints
    /// leave of it.
    pub(super) fn p_value(&self, calibration: &Calibration) -> f64 {
        calibration.remainder_p(calibration.most_left(&self.left_db))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decide::{LEAST, LEVEL, ORDINARY};

    /// Healthy joints whose encoders leave half of their noise, and whose positions leave up to 12 dB.
    fn healthy() -> Calibration {
        let joint = |i: usize| {
            let position = 12.0 * i as f64 / 199.0;
            let link = beyond_db(0.5, 1.0);
            vec![("position".into(), position), ("link".into(), link)]
        };
        let joints: Vec<_> = (0..200).map(joint).collect();
        Calibration::new(vec![0.0; LEAST], "test", "numbers")
            .expect("enough")
            .with_lefts(&joints)
    }

    fn p_value(link: f64, position: f64) -> f64 {
        let left_db = vec![("link".into(), link), ("position".into(), position)];
        let own = Remainder {
            left_db,
            share: 0.0,
        };
        own.p_value(&healthy())
    }

    #[test]
    fn a_column_below_its_noise_counts_as_nothing() {
        // More than healthy joints leave of it, and less than its noise.
        assert!(p_value(beyond_db(0.8, 1.0), 0.0) >= ORDINARY);
        assert!(p_value(beyond_db(0.2, 1.0), 0.0) >= ORDINARY);
        assert!(p_value(beyond_db(4.0, 1.0), 0.0) < LEVEL);
        assert!(p_value(beyond_db(0.8, 1.0), 20.0) < LEVEL);
    }
}
