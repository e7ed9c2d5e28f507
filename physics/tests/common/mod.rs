//! What the tests share: seeded gaits.

use control::gait::{Gait, Oscillator, RawGait, chain};
use physics::noise::philox;
use std::f32::consts::{PI, TAU};

/// Gait `k` of a seeded family: amplitudes 0.5 to 1.2 rad, offsets within 0.5 rad, any phase lags, 0.2 Hz.
pub(crate) fn random_gait(seed: u32, k: u32, amplitude: (f32, f32)) -> Gait {
    let mut words = Vec::new();
    for block in 0..6 {
        words.extend(philox([k, block, 0, 0], [seed, 1]));
    }
    let unit = |i: usize| (f64::from(words[i]) / 4_294_967_296.0) as f32;
    let mut raw = RawGait {
        frequency_hz: 0.2,
        rate_a_per_s: 2.0,
        duration_s: 30.0,
        ..RawGait::default()
    };
    raw.name.push_str("random").expect("fits");
    for i in 0..6 {
        raw.oscillators
            .push(Oscillator {
                amplitude_rad: amplitude.0 + (amplitude.1 - amplitude.0) * unit(i),
                offset_rad: unit(6 + i) - 0.5,
                initial_phase_rad: 0.0,
            })
            .expect("six fit");
    }
    let lags: Vec<f32> = (0..5).map(|i| TAU * unit(12 + i) - PI).collect();
    raw.links = chain(0.5, &lags);
    raw.lock_phases();
    Gait::try_from(raw).expect("inside the ranges")
}
