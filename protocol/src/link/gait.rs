//! A gait as it travels: plain numbers, unchecked. [`control::gait::Gait`] is the checked one.

use control::gait::{Gait, GaitError, Link, Oscillator, RawGait};
use heapless::{String, Vec};
use serde::{Deserialize, Serialize};
use sha2::Digest as _;

pub use control::gait::{MAX_LINKS, MAX_NAME, MAX_OSCILLATORS};

/// Largest serialised gait in bytes: name 1 + 32, three numbers 12, oscillators 1 + 12 x 12, links 1 + 24 x 10.
pub const MAX_GAIT: usize = 1 + MAX_NAME + 12 + 1 + MAX_OSCILLATORS * 12 + 1 + MAX_LINKS * 10;

/// One oscillator. Numbers keep their f32 bits, so the module computes with exactly what the file said.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct WireOscillator {
    /// R, rad.
    pub amplitude_rad: f32,
    /// X, rad.
    pub offset_rad: f32,
    /// phi at t = 0, rad.
    pub initial_phase_rad: f32,
}

/// One coupling entry; it acts both ways, with the opposite lag on the way back.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct WireLink {
    /// Index of the first oscillator.
    pub from: u8,
    /// Index of the second oscillator.
    pub to: u8,
    /// w.
    pub weight: f32,
    /// psi, rad.
    pub phase_lag_rad: f32,
}

/// A gait on the wire.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct WireGait {
    /// Display name.
    pub name: String<MAX_NAME>,
    /// f, Hz.
    pub frequency_hz: f32,
    /// a, 1/s.
    pub rate_a_per_s: f32,
    /// Length of the gait in its file, s. The order to start says how long it runs.
    pub duration_s: f32,
    /// In joint order.
    pub oscillators: Vec<WireOscillator, MAX_OSCILLATORS>,
    /// Coupling.
    pub links: Vec<WireLink, MAX_LINKS>,
}

/// Fingerprint of a gait: the first 8 bytes of SHA-256 over its wire bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Digest(pub [u8; 8]);

impl WireGait {
    /// Writes the gait as postcard into `out` and returns the bytes used. Never more than [`MAX_GAIT`]; the flash record keeps the same bytes.
    #[must_use]
    pub fn to_bytes<'a>(&self, out: &'a mut [u8; MAX_GAIT]) -> &'a [u8] {
        match postcard::to_slice(self, out.as_mut_slice()) {
            Ok(used) => used,
            // Not reachable: the type cannot hold more than MAX_GAIT bytes. An empty record is refused by every reader.
            Err(_) => &[],
        }
    }

    /// Reads a gait and refuses bytes left over.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        match postcard::take_from_bytes::<Self>(bytes) {
            Ok((gait, [])) => Some(gait),
            _ => None,
        }
    }

    /// Fingerprint over the wire bytes: equal on both ends of the link exactly when every bit of the gait is.
    #[must_use]
    pub fn digest(&self) -> Digest {
        let mut buffer = [0; MAX_GAIT];
        let hash = sha2::Sha256::digest(self.to_bytes(&mut buffer));
        let mut digest = [0; 8];
        for (to, from) in digest.iter_mut().zip(hash.iter()) {
            *to = *from;
        }
        Digest(digest)
    }
}

impl From<&Gait> for WireGait {
    fn from(gait: &Gait) -> Self {
        let raw = gait.raw();
        Self {
            oscillators: each(&raw.oscillators, |o| WireOscillator {
                amplitude_rad: o.amplitude_rad,
                offset_rad: o.offset_rad,
                initial_phase_rad: o.initial_phase_rad,
            }),
            links: each(&raw.links, |l| WireLink {
                from: l.from,
                to: l.to,
                weight: l.weight,
                phase_lag_rad: l.phase_lag_rad,
            }),
            name: raw.name,
            frequency_hz: raw.frequency_hz,
            rate_a_per_s: raw.rate_a_per_s,
            duration_s: raw.duration_s,
        }
    }
}

impl From<&WireGait> for RawGait {
    fn from(wire: &WireGait) -> Self {
        Self {
            name: wire.name.clone(),
            frequency_hz: wire.frequency_hz,
            rate_a_per_s: wire.rate_a_per_s,
            duration_s: wire.duration_s,
            oscillators: each(&wire.oscillators, |o| Oscillator {
                amplitude_rad: o.amplitude_rad,
                offset_rad: o.offset_rad,
                initial_phase_rad: o.initial_phase_rad,
            }),
            links: each(&wire.links, |l| Link {
                from: l.from,
                to: l.to,
                weight: l.weight,
                phase_lag_rad: l.phase_lag_rad,
            }),
        }
    }
}

/// `collect` of a heapless vector can panic as far as the compiler knows; this cannot, and both lengths are the same.
fn each<A, B, const N: usize>(from: &Vec<A, N>, convert: impl Fn(&A) -> B) -> Vec<B, N> {
    let mut out = Vec::new();
    for item in from {
        let _ = out.push(convert(item));
    }
    out
}

impl TryFrom<&WireGait> for Gait {
    type Error = GaitError;

    fn try_from(wire: &WireGait) -> Result<Self, GaitError> {
        Self::try_from(RawGait::from(wire))
    }
}
