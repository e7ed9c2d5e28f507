//! Table II as evidence: which fitted values no hardware could have.

use control::robot::{INTER_NO_LOAD_RAD_S, INTRA_NO_LOAD_RAD_S};
use files::model::Key;

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
