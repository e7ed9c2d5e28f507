//! Where the nominal numbers of a block, within their tolerances, fit best: the point around which it is computed again.

use super::block::White;
use super::ensemble::{BENT, factored, size};
use super::linear::backward;

/// Share of its size that a coefficient may have which is no nominal number: what both explain is the nominal number's.
/// Chosen before any robot was diagnosed with it, by no calibration; what healthy robots differ by should take its place.
const ELSE: f64 = 0.3;
/// Share of its tolerance below which a nominal number stays where it is: slopes over less would be rounding. Chosen as
/// [`ELSE`] was.
const STAYS: f64 = 0.2;

/// Column and coefficient of the nominal numbers of `block`.
#[must_use]
pub fn settled(block: &White) -> Vec<(usize, f64)> {
    let sd: Vec<f64> = block
        .columns
        .iter()
        .map(|column| match column.slack {
            slack if slack > 0.0 => slack,
            _ => ELSE * size(column),
        })
        .collect();
    let (own, l, mut mean) = factored(block, &sd, block.tempering(BENT, 0.0));
    backward(&l, own.len(), &mut mean);
    let nominal = own
        .iter()
        .zip(&mean)
        .filter(|(i, by)| block.columns[**i].slack > 0.0 && by.abs() > STAYS);
    nominal.map(|(i, by)| (*i, sd[*i] * by)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::block::{Column, Segment, Site};
    use crate::vocabulary::{Effect, Stage};

    #[test]
    fn nominal_numbers_go_where_they_fit_and_leave_causes_alone() {
        let rows = 400;
        let wave = |speed: f64| -> Vec<f64> {
            (0..rows)
                .map(|i| 30.0 * crate::math::sin(speed * f64::from(i)))
                .collect()
        };
        let x = vec![wave(0.31), wave(0.83)];
        let sizes = [0.15, 0.7];
        let y = (0..rows as usize)
            .map(|i| sizes[0] * x[0][i] + sizes[1] * x[1][i])
            .collect();
        let segment = Segment {
            y,
            x,
            weight: vec![1.0; rows as usize],
        };
        let site = Site {
            stage: Stage::Driver,
            joint: Some(0),
            blind: false,
            coarse: false,
        };
        let columns = vec![
            Column::linear(Effect::LoopGain, "ratio", 1.0, 0.5).with_slack(0.1),
            Column::linear(Effect::JointScale, "ratio", 1.0, 0.5),
        ];
        let block = White::whitened(site, columns, &[segment], [1.0, 1.0]);
        let found = settled(&block);
        let [(0, gain)] = found.as_slice() else {
            panic!("{found:?}");
        };
        assert!((gain - 0.15).abs() < 0.01, "{gain}");
    }
}
