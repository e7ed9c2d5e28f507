//! Gaits the tests share.

use control::gait::{self, Gait, Oscillator, RawGait};

pub(crate) fn raw(
    name: &str,
    amplitudes_deg: [f32; 6],
    offsets_deg: [f32; 6],
    lags_deg: [f32; 5],
) -> RawGait {
    let mut raw = RawGait {
        name: name.try_into().expect("short name"),
        frequency_hz: 0.2,
        rate_a_per_s: 2.0,
        duration_s: 30.0,
        oscillators: amplitudes_deg
            .iter()
            .zip(offsets_deg)
            .map(|(r, x)| Oscillator {
                amplitude_rad: r.to_radians(),
                offset_rad: x.to_radians(),
                initial_phase_rad: 0.0,
            })
            .collect(),
        links: gait::chain(0.5, &lags_deg.map(f32::to_radians)),
    };
    raw.lock_phases();
    raw
}

pub(crate) fn gait(
    name: &str,
    amplitudes_deg: [f32; 6],
    offsets_deg: [f32; 6],
    lags_deg: [f32; 5],
) -> Gait {
    raw(name, amplitudes_deg, offsets_deg, lags_deg)
        .try_into()
        .expect("valid gait")
}

/// Stays far from itself.
pub(crate) fn crawl() -> Gait {
    gait(
        "crawl",
        [40.0; 6],
        [0.0; 6],
        [90.0, -90.0, 180.0, 90.0, -90.0],
    )
}

/// Folds C1 onto C4: blocked for a part of every period.
pub(crate) fn clash() -> Gait {
    gait(
        "clash",
        [0.0, 0.0, 60.0, 60.0, 0.0, 0.0],
        [0.0, 0.0, -90.0, -90.0, 0.0, 0.0],
        [0.0; 5],
    )
}
