//! Table II as evidence: which fitted values no hardware could have.

use control::robot::{INTER_NO_LOAD_RAD_S, INTRA_NO_LOAD_RAD_S};
use files::model::Key;
use rand_chacha::rand_core::Rng;
use swarm::{Purpose, stream};

/// Number of rows.
pub const ROWS: usize = Key::TABLE_II.len();

/// Nominal torques of the motors (paper, Table I), N m.
const INTRA_NOMINAL_NM: f64 = 4.9;
const INTER_NOMINAL_NM: f64 = 3.6;

/// The largest value the hardware can have, with the reason; `None` where no data sheet sets one.
#[must_use]
pub fn plausible_high(key: Key) -> Option<(f64, &'static str)> {
    const SPEED: &str = "no-load speed of the motor (Table I)";
    const TORQUE: &str = "nominal torque of the motor (Table I)";
    match key {
        Key::IntraSpeed => Some((INTRA_NO_LOAD_RAD_S.into(), SPEED)),
        Key::InterSpeed => Some((INTER_NO_LOAD_RAD_S.into(), SPEED)),
        Key::IntraTorque => Some((INTRA_NOMINAL_NM, TORQUE)),
        Key::InterTorque => Some((INTER_NOMINAL_NM, TORQUE)),
        _ => None,
    }
}

/// How many times beyond what the hardware can have a value lies; `None` when plausible. A factor is evidence that the fit
/// put an effect the model lacks into this parameter.
#[must_use]
pub fn implausible_factor(key: Key, value: f64) -> Option<f64> {
    let (limit, _) = plausible_high(key)?;
    (value > limit).then(|| value / limit)
}

/// Values drawn evenly inside the ranges of Table II: a robot to try a fit on.
#[must_use]
pub fn draw(seed: u64) -> [f64; ROWS] {
    let mut random = stream(seed, 0, 0, Purpose::Robot);
    Key::TABLE_II.map(|key| {
        let (low, high) = key.info().search;
        // 53 bits: as many as an f64 holds below 1.
        let share = (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        low + (high - low) * share
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawn_robots_lie_in_the_ranges_and_differ() {
        let robots: Vec<[f64; ROWS]> = (0..50).map(draw).collect();
        for (row, key) in Key::TABLE_II.iter().enumerate() {
            let (low, high) = key.info().search;
            let values = robots.iter().map(|robot| robot[row]);
            let (least, most) = values.fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
            assert!(low <= least && most <= high, "row {}", row + 1);
            assert!(most - least > 0.7 * (high - low), "row {}", row + 1);
        }
        assert_eq!(draw(7), draw(7));
    }
}
