//! Where the nominal numbers of a block, within their tolerances, fit best: the point around which it is computed again.

use super::block::White;
use super::ensemble::{Spreads, factored};
use super::linear::backward;

/// Share of its tolerance below which a nominal number stays where it is: slopes over less would be rounding. Chosen
/// before any robot was diagnosed with it, by no calibration.
const STAYS: f64 = 0.2;
/// Tolerances within which a nominal number is still the one that is stated; beyond them it is a cause, as labels of suites count it.
pub(crate) const REACH: f64 = 3.0;

/// Column and coefficient of the nominal numbers of `block`, under what robots without a cause differ by.
#[must_use]
pub fn settled(block: &White, spreads: &Spreads) -> Vec<(usize, f64)> {
    let sd = spreads.of(block);
    let (own, l, mut mean) = factored(block, &sd, spreads.share(block, 0.0));
    backward(&l, own.len(), &mut mean);
    let nominal = own.iter().zip(&mean).filter_map(|(i, by)| {
        let tolerance = block.columns[*i].slack;
        let value = (sd[*i] * by).clamp(-REACH * tolerance, REACH * tolerance);
        (value.abs() > STAYS * tolerance).then_some((*i, value))
    });
    nominal.collect()
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
        let mut spreads = Spreads::default();
        let healthy = [("driver.joint_scale.ratio.0".to_owned(), 0.3)];
        spreads.columns.extend(healthy);
        let found = settled(&block, &spreads);
        let [(0, gain)] = found.as_slice() else {
            panic!("{found:?}");
        };
        assert!((gain - 0.15).abs() < 0.01, "{gain}");
    }
}
