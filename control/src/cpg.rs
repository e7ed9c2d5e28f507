//! The central pattern generator: a network of phase oscillators with filtered amplitude and offset.
//!
//! ```text
//! dphi_i  = 2 pi f + sum_j w_ij r_j sin(phi_j - phi_i - psi_ij)        paper (1), with "+" where the paper prints a product
//! dr_i    = a (R_i - r_i)                                              paper (2)
//! dx_i    = a (X_i - x_i)                                              the same filter, so that a changed offset does not jump
//! theta_i = r_i sin(phi_i) + x_i                                       paper (3), without the dot the paper prints on theta
//! ```
//!
//! The two misprints: the product form of (1) stops oscillating within seconds, because its frequency is proportional to the coupling sum,
//! which phase lock takes to zero. A dot on theta would make the set-point an integral that drifts with every offset. The standard form above is
//! the one of the lab's other publications and code.
//!
//! Order of one tick: set-points from the state, one explicit Euler step from that same state, then phases wrapped to [-π, π). At
//! the start r = 0, x = X and phi is the gait's initial phase, so the first set-points are the offsets.

use crate::gait::{Gait, MAX_OSCILLATORS};
use crate::machine::Angles;
use crate::math;
use crate::robot::JOINTS;
use heapless::Vec;

/// State of one oscillator.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OscillatorState {
    /// `phi`, rad, in [-π, π).
    pub phase_rad: f32,
    /// `r`: amplitude reached, rad.
    pub amplitude_rad: f32,
    /// `x`: offset reached, rad.
    pub offset_rad: f32,
}

/// State of the network; one entry per oscillator of the gait it was started with.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CpgState {
    oscillators: Vec<OscillatorState, MAX_OSCILLATORS>,
}

impl CpgState {
    /// The oscillators in joint order.
    #[must_use]
    pub fn oscillators(&self) -> &[OscillatorState] {
        &self.oscillators
    }

    /// `r_i sin(phi_i) + x_i` for every oscillator, rad.
    #[must_use]
    pub fn set_points(&self) -> SetPoints {
        // Not `collect`: that could panic as far as the compiler knows.
        let mut out = Vec::new();
        for o in &self.oscillators {
            let _ = out.push(o.amplitude_rad * math::sin(o.phase_rad) + o.offset_rad);
        }
        SetPoints(out)
    }
}

/// Joint set-points, rad, in joint order.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SetPoints(Vec<f32, MAX_OSCILLATORS>);

impl SetPoints {
    /// The angles, rad.
    #[must_use]
    pub fn as_slice(&self) -> &[f32] {
        &self.0
    }

    /// The angles of a robot of any number of joints, rad; `None` where there is none.
    #[must_use]
    pub fn angles(&self) -> Option<Angles> {
        Angles::new(self.as_slice())
    }

    /// The angles of a six-joint robot, rad; `None` for another number of oscillators.
    #[must_use]
    pub fn joints(&self) -> Option<[f32; JOINTS]> {
        <[f32; JOINTS]>::try_from(self.as_slice()).ok()
    }
}

/// A gait cannot take over from another with a different number of oscillators.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CountMismatch {
    /// Oscillators running.
    pub running: u8,
    /// Oscillators of the new gait.
    pub offered: u8,
}

/// The state at t = 0: amplitudes 0, offsets and phases of the gait.
#[must_use]
pub fn start(gait: &Gait) -> CpgState {
    let mut oscillators = Vec::new();
    for o in gait.oscillators() {
        let _ = oscillators.push(OscillatorState {
            phase_rad: o.initial_phase_rad,
            amplitude_rad: 0.0,
            offset_rad: o.offset_rad,
        });
    }
    CpgState { oscillators }
}

/// Checks that `gait` can take over the running `state`. The state itself stays: from the next step on amplitudes and offsets pass to
/// the new values at rate `a`, phases go on from where they are, so nothing jumps.
///
/// # Errors
/// [`CountMismatch`] when the numbers of oscillators differ.
pub fn retarget(gait: &Gait, state: &CpgState) -> Result<(), CountMismatch> {
    let (running, offered) = (state.oscillators.len(), gait.oscillators().len());
    if running == offered {
        Ok(())
    } else {
        Err(CountMismatch {
            running: running as u8,
            offered: offered as u8,
        })
    }
}

/// One tick of `dt_s` seconds: the set-points of the present state, then the state `dt_s` later.
pub fn step(gait: &Gait, state: &mut CpgState, dt_s: f32) -> SetPoints {
    let out = state.set_points();
    advance(gait, state, dt_s, 1.0);
    out
}

/// Advances the state alone, with every amplitude target scaled by `amplitude_scale` (0 brings the robot to rest at its offsets).
#[inline(never)] // instruction counts of the image begin at this symbol
pub fn advance(gait: &Gait, state: &mut CpgState, dt_s: f32, amplitude_scale: f32) {
    let pull = coupling(gait, state);
    let rate = gait.rate_a_per_s();
    let own = math::TAU * gait.frequency_hz();
    for ((o, target), pull) in state
        .oscillators
        .iter_mut()
        .zip(gait.oscillators())
        .zip(pull)
    {
        o.phase_rad = math::wrap_pi(o.phase_rad + dt_s * (own + pull));
        o.amplitude_rad +=
            dt_s * (rate * (target.amplitude_rad * amplitude_scale - o.amplitude_rad));
        o.offset_rad += dt_s * (rate * (target.offset_rad - o.offset_rad));
    }
}

/// The coupling sum of paper (1) for every oscillator, rad/s. The sine is odd to the bit, so one per link serves both directions.
fn coupling(gait: &Gait, state: &CpgState) -> [f32; MAX_OSCILLATORS] {
    let mut pull = [0.0f32; MAX_OSCILLATORS];
    for link in gait.links() {
        let (i, j) = (usize::from(link.from), usize::from(link.to));
        let (Some(a), Some(b)) = (state.oscillators.get(i), state.oscillators.get(j)) else {
            continue;
        };
        let s = math::sin(b.phase_rad - a.phase_rad - link.phase_lag_rad);
        let (on_i, on_j) = (
            link.weight * b.amplitude_rad * s,
            link.weight * a.amplitude_rad * s,
        );
        if let Some(p) = pull.get_mut(i) {
            *p += on_i;
        }
        if let Some(p) = pull.get_mut(j) {
            *p -= on_j;
        }
    }
    pull
}
