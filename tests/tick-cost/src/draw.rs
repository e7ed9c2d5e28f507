//! Gaits whose ticks are counted: drawn ones. `hil-sim/examples/board_worst.rs` has this file too.

use control::gait::{Gait, Oscillator, RawGait, chain};
use control::robot::RobotModel;

/// Knuth's linear congruential generator (MMIX), the upper bits.
pub(crate) struct Rng(pub(crate) u64);

impl Rng {
    pub(crate) fn between(&mut self, low: f32, high: f32) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((self.0 >> 40) as f32 / 16_777_216.0)
    }
}

/// A gait drawn from all that the joints can follow.
/// A folded one swings about a pose in which the robot nearly meets itself.
pub(crate) fn random(rng: &mut Rng, folded: bool) -> Gait {
    let model = RobotModel::default();
    loop {
        let amplitudes = [0.0; 6].map(|_: f32| rng.between(0.0, 120.0));
        let mut offsets = [0.0; 6].map(|_: f32| rng.between(-120.0, 120.0));
        if folded {
            offsets = [0.0, 0.0, -90.0, -90.0, 0.0, 0.0].map(|x| x + rng.between(-20.0, 20.0));
        }
        let lags = [0.0; 5].map(|_: f32| rng.between(-180.0, 180.0));
        if let Some(gait) = gait(amplitudes, offsets, lags)
            && gait.check_speed(model.joints()).is_ok()
        {
            return gait;
        }
    }
}

pub(crate) fn gait(
    amplitudes_deg: [f32; 6],
    offsets_deg: [f32; 6],
    lags_deg: [f32; 5],
) -> Option<Gait> {
    let mut raw = RawGait {
        frequency_hz: 0.2,
        rate_a_per_s: 2.0,
        duration_s: 30.0,
        ..RawGait::default()
    };
    let _ = raw.name.push_str("cost");
    for (r, x) in amplitudes_deg.into_iter().zip(offsets_deg) {
        let [amplitude_rad, offset_rad] = [r, x].map(f32::to_radians);
        let _ = raw.oscillators.push(Oscillator {
            amplitude_rad,
            offset_rad,
            initial_phase_rad: 0.0,
        });
    }
    raw.links = chain(0.5, &lags_deg.map(f32::to_radians));
    raw.lock_phases();
    Gait::try_from(raw).ok()
}
