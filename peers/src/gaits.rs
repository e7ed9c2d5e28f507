//! The gaits that all engines play.

use crate::track::TICKS;
use control::gait::{Gait, Oscillator, RawGait, chain};
use files::model::{Effect, Key, Model};
use physics::noise::philox;
use physics::{Drive, Level, Options, Params, Start, Trial, run_at};
use std::f32::consts::{PI, TAU};
use std::sync::Arc;

/// Gait `k` of a seeded family: amplitudes in the given range (rad), offsets within 0.5 rad, any phase lags, 0.2 Hz.
///
/// # Panics
/// Never: all numbers lie inside a gait's ranges.
#[must_use]
pub fn random_gait(seed: u32, k: u32, amplitude_rad: (f32, f32)) -> Gait {
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
                amplitude_rad: amplitude_rad.0 + (amplitude_rad.1 - amplitude_rad.0) * unit(i),
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

/// The hand-tuned model without bounce, which MuJoCo cannot express.
///
/// # Panics
/// Never: the shipped model is valid.
#[must_use]
pub fn bounceless() -> Arc<Params> {
    let mut model = Model::hand_tuned();
    model.set(Key::Bounce, 0.0).expect("zero is in range");
    Arc::new(Params::try_from(&model).expect("the hand-tuned model is valid"))
}

/// Random gaits that do not touch themselves, as trials of 30 s from home at once, without noise.
///
/// # Panics
/// Never: the trials fit the robot.
#[must_use]
pub fn clear_trials(params: &Arc<Params>, count: usize) -> Vec<Trial> {
    let mut out = Vec::new();
    let mut k = 0;
    while out.len() < count {
        let batch: Vec<Trial> = (k..k + 16)
            .map(|k| Trial {
                params: Arc::clone(params),
                start: Start::HomeAtOnce,
                drive: Drive::Gait {
                    gait: Arc::new(random_gait(1, k, (0.5, 1.2))),
                    noise_rad: 0.0,
                    seed: 0,
                },
                duration_s: TICKS as f64 / 20.0,
            })
            .collect();
        k += 16;
        let done = run_at(Level::detect(), &batch, &Options::default()).expect("valid trials");
        let clear = batch
            .into_iter()
            .zip(done)
            .filter(|(_, o)| o.clearance_m > 0.005);
        out.extend(clear.map(|(t, _)| t));
    }
    out.truncate(count);
    out
}

/// The same trials with friction, ripple and compliance on every joint, anisotropic and torsional friction and a slope on the ground.
///
/// # Panics
/// Never: the values are in range and the body simulator holds these effects.
#[must_use]
pub fn with_effects(trials: &[Trial]) -> Vec<Trial> {
    let mut model = Model::hand_tuned();
    let mut on = |effect, joint, values: &[f64]| {
        model
            .set_effect(effect, joint, values)
            .expect("values are in range");
    };
    for joint in (0..6).map(Some) {
        on(Effect::CoulombFriction, joint, &[0.2]);
        on(Effect::StribeckFriction, joint, &[0.1, 0.05]);
        on(Effect::LoadDependentFriction, joint, &[0.1]);
        on(Effect::TorqueRipple, joint, &[0.1, 4.0, 0.0]);
        on(Effect::Compliance, joint, &[80.0]);
    }
    on(Effect::FrictionAnisotropy, None, &[1.3, 0.2]);
    on(Effect::TorsionalFriction, None, &[0.005]);
    on(Effect::GroundSlope, None, &[0.01, 0.0]);
    let params = Arc::new(Params::try_from(&model).expect("all of them are simulated"));
    let with = |t: &Trial| Trial {
        params: Arc::clone(&params),
        ..t.clone()
    };
    trials.iter().map(with).collect()
}
