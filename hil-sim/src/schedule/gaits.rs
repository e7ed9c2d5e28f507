//! The gaits of the schedules: some in the open, two on either side of the poses in which the end cubes meet, so
//! that the way from one to the other is
//! blocked.

use control::gait::{Gait, Oscillator, RawGait, chain};
use std::sync::LazyLock;

/// Offsets of A.M2 and B.M0, rad, and the amplitude of all joints, rad.
///
/// With a twist of 90 deg the cubes 1 and 4 are closest at -140 deg each: one gait stands on either side, and the
/// straight way from home to the second
/// leads through.
const PLACES: [(f32, f32, f32); COUNT] = [
    (0.0, 0.0, 0.25),
    (0.2, -0.1, 0.15),
    (SIDE_RAD.0, SIDE_RAD.1, 0.05),
    (OTHER_SIDE_RAD.0, OTHER_SIDE_RAD.1, 0.05),
];
const SIDE_RAD: (f32, f32) = (-1.05, -2.6);
const OTHER_SIDE_RAD: (f32, f32) = (-3.1, -3.1);

/// Number of gaits.
pub(crate) const COUNT: usize = 4;

static GAITS: LazyLock<[Gait; COUNT]> = LazyLock::new(|| std::array::from_fn(make));

/// A gait by its number.
#[must_use]
pub(crate) fn gait(number: usize) -> &'static Gait {
    &GAITS[number % COUNT]
}

fn make(number: usize) -> Gait {
    let (a_m2, b_m0, amplitude_rad) = PLACES[number];
    let mut raw = RawGait {
        frequency_hz: 0.4,
        // Fast, so that a ramp is short and a schedule costs little.
        rate_a_per_s: 6.0,
        duration_s: 30.0,
        links: chain(0.5, &[0.6, -1.5, 3.1, 1.5, -1.5]),
        ..RawGait::default()
    };
    raw.name
        .push_str(&format!("schedule {number}"))
        .expect("short");
    for joint in 0..6_u8 {
        let oscillator = Oscillator {
            amplitude_rad,
            offset_rad: match joint {
                2 => a_m2,
                3 => b_m0,
                _ => 0.05 * f32::from(joint),
            },
            initial_phase_rad: 0.3 * f32::from(joint),
        };
        raw.oscillators.push(oscillator).expect("six fit");
    }
    Gait::try_from(raw).expect("within the ranges")
}
