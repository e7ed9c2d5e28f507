//! A gait: the parameters of a network of phase oscillators, valid by construction.
//!
//! [`RawGait`] is what files and frames decode to; [`Gait`] is what everything else takes. A `Gait` is canonical: phases wrapped to
//! [-π, π), no negative zero, every link with `from < to`, links sorted. So equal behaviour has equal bits and one digest.

use crate::math;
use crate::robot::JointLimits;
use heapless::{String, Vec};

/// Largest number of oscillators (two meta-modules on one controller).
pub const MAX_OSCILLATORS: usize = 12;
/// Largest number of links (a chain of 12 has 11; twice that and two).
pub const MAX_LINKS: usize = 24;
/// Longest name in bytes.
pub const MAX_NAME: usize = 32;

/// An accepted closed interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Smallest accepted value.
    pub min: f32,
    /// Largest accepted value.
    pub max: f32,
}

impl Range {
    /// Whether the value is a number inside; false for NaN and infinities.
    #[must_use]
    pub fn contains(&self, value: f32) -> bool {
        value >= self.min && value <= self.max
    }
}

/// Frequency, Hz. Zero is a pose; 2 Hz has 10 samples a period at 20 Hz and asks 12.6 rad/s of 1 rad, six times the motor.
pub const FREQUENCY_HZ: Range = Range { min: 0.0, max: 2.0 };
/// Rate `a` of the amplitude and offset filter, 1/s (paper: 2). The explicit Euler step at 50 ms is monotone below 20.
pub const RATE_A_PER_S: Range = Range {
    min: 0.1,
    max: 10.0,
};
/// Duration, s: one cycle to the hour that the battery lasts (paper, Table I).
pub const DURATION_S: Range = Range {
    min: 0.05,
    max: 3600.0,
};
/// Amplitude `R`, rad: half a turn; at 0.2 Hz the no-load speed already ends at 127 deg.
pub const AMPLITUDE_RAD: Range = Range {
    min: 0.0,
    max: math::PI,
};
/// Offset `X`, rad: half a turn either way; the joints have no end stops.
pub const OFFSET_RAD: Range = Range {
    min: -math::PI,
    max: math::PI,
};
/// Initial phase and phase lag, rad: one turn either way, wrapped on entry.
pub const PHASE_RAD: Range = Range {
    min: -math::TAU,
    max: math::TAU,
};
/// Coupling weight, 1/(s rad) (paper: 0.5). The linearised chain under Euler at 50 ms is stable up to `w R` = 10.
pub const WEIGHT: Range = Range { min: 0.0, max: 3.0 };

/// One oscillator, which drives the joint of the same index.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Oscillator {
    /// `R`: amplitude the set-point approaches, rad.
    pub amplitude_rad: f32,
    /// `X`: centre of the oscillation, rad.
    pub offset_rad: f32,
    /// `phi` at t = 0, rad. Part of the gait because the phases lock slowly (7.5 s and more).
    pub initial_phase_rad: f32,
}

/// A coupling in both directions: `psi_ij` = `phase_lag_rad`, `psi_ji` = -`phase_lag_rad`, the same weight.
///
/// At phase lock `phi_to - phi_from = phase_lag_rad`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Link {
    /// Index i of an oscillator.
    pub from: u8,
    /// Index j of another oscillator.
    pub to: u8,
    /// `w`, 1/(s rad).
    pub weight: f32,
    /// `psi_ij`, rad.
    pub phase_lag_rad: f32,
}

/// A gait as decoded, not yet believed.
#[derive(Clone, Debug, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RawGait {
    /// Name for people.
    pub name: String<MAX_NAME>,
    /// Common frequency `f`, Hz.
    pub frequency_hz: f32,
    /// Filter rate `a`, 1/s.
    pub rate_a_per_s: f32,
    /// Length of a run, s.
    pub duration_s: f32,
    /// Oscillators in joint order.
    pub oscillators: Vec<Oscillator, MAX_OSCILLATORS>,
    /// Couplings.
    pub links: Vec<Link, MAX_LINKS>,
}

impl RawGait {
    /// Sets every initial phase to the phase-locked start of the link graph: the lowest oscillator of each connected part at
    /// phase 0, every other where the links put it. Links are followed breadth first in their order; a ring whose lags do not
    /// sum to a turn keeps the lags of the first path found.
    pub fn lock_phases(&mut self) {
        let mut phases: [Option<f32>; MAX_OSCILLATORS] = [None; MAX_OSCILLATORS];
        let count = self.oscillators.len();
        for root in 0..count {
            let Some(slot) = phases.get_mut(root) else {
                continue;
            };
            if slot.is_some() {
                continue;
            }
            *slot = Some(0.0);
            // Each pass settles at least the next ring of neighbours, so `count` passes reach everything.
            for _ in 0..count {
                for link in &self.links {
                    spread_phase(&mut phases, link);
                }
            }
        }
        for (oscillator, phase) in self.oscillators.iter_mut().zip(phases) {
            oscillator.initial_phase_rad = phase.unwrap_or(0.0);
        }
    }
}

fn spread_phase(phases: &mut [Option<f32>; MAX_OSCILLATORS], link: &Link) {
    let at = |i: u8| phases.get(usize::from(i)).copied();
    match (at(link.from), at(link.to)) {
        (Some(Some(phase)), Some(None)) => {
            if let Some(slot) = phases.get_mut(usize::from(link.to)) {
                *slot = Some(math::wrap_pi(phase + link.phase_lag_rad));
            }
        }
        (Some(None), Some(Some(phase))) => {
            if let Some(slot) = phases.get_mut(usize::from(link.from)) {
                *slot = Some(math::wrap_pi(phase - link.phase_lag_rad));
            }
        }
        _ => {}
    }
}

/// Field names as they stand in files and messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GaitField {
    /// `frequency_hz`.
    Frequency,
    /// `rate_a_per_s`.
    RateA,
    /// `duration_s`.
    Duration,
    /// `oscillator.amplitude_rad`.
    Amplitude,
    /// `oscillator.offset_rad`.
    Offset,
    /// `oscillator.initial_phase_rad`.
    InitialPhase,
    /// `link.weight`.
    Weight,
    /// `link.phase_lag_rad`.
    PhaseLag,
}

impl GaitField {
    /// The key as it stands in a gait file.
    #[must_use]
    pub const fn key(self) -> &'static str {
        match self {
            GaitField::Frequency => "frequency_hz",
            GaitField::RateA => "rate_a_per_s",
            GaitField::Duration => "duration_s",
            GaitField::Amplitude => "amplitude_rad",
            GaitField::Offset => "offset_rad",
            GaitField::InitialPhase => "initial_phase_rad",
            GaitField::Weight => "weight",
            GaitField::PhaseLag => "phase_lag_rad",
        }
    }
}

/// Why a gait was refused.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GaitError {
    /// A number is NaN, infinite or outside its range.
    OutOfRange {
        /// Which number.
        field: GaitField,
        /// Index of the oscillator or link; 0 for fields that exist once.
        index: u8,
        /// The refused value.
        value: f32,
        /// Smallest accepted value.
        min: f32,
        /// Largest accepted value.
        max: f32,
    },
    /// No oscillator at all.
    NoOscillators,
    /// The name is empty or holds a control character.
    Name,
    /// A link joins an oscillator to itself.
    SelfLink {
        /// Index of the link.
        link: u8,
    },
    /// A link names an oscillator that does not exist.
    LinkOutOfRange {
        /// Index of the link.
        link: u8,
        /// The oscillator it names.
        oscillator: u8,
        /// How many oscillators there are.
        count: u8,
    },
    /// Two links join the same pair; one entry already couples both directions.
    DuplicateLink {
        /// Index of the later link.
        link: u8,
        /// Index of the earlier one.
        earlier: u8,
    },
}

impl core::fmt::Display for GaitError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            GaitError::OutOfRange {
                field,
                index,
                value,
                min,
                max,
            } => {
                write!(
                    f,
                    "{} [{index}] is {value}, allowed is {min} to {max}",
                    field.key()
                )
            }
            GaitError::NoOscillators => {
                write!(f, "the gait has no oscillator, give 1 to {MAX_OSCILLATORS}")
            }
            GaitError::Name => write!(
                f,
                "the name is empty or holds a control character, give 1 to {MAX_NAME} bytes of plain text"
            ),
            GaitError::SelfLink { link } => {
                write!(f, "link [{link}] joins an oscillator to itself, remove it")
            }
            GaitError::LinkOutOfRange {
                link,
                oscillator,
                count,
            } => {
                write!(
                    f,
                    "link [{link}] names oscillator {oscillator}, there are {count}, counted from 0"
                )
            }
            GaitError::DuplicateLink { link, earlier } => {
                write!(
                    f,
                    "link [{link}] repeats link [{earlier}], one entry couples both directions"
                )
            }
        }
    }
}

impl core::error::Error for GaitError {}

/// A gait that asks more of the robot than it can do.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RobotMismatch {
    /// The robot has another number of joints than the gait has oscillators.
    JointCount {
        /// Oscillators of the gait.
        oscillators: u8,
        /// Joints of the robot.
        joints: u8,
    },
    /// A joint would have to turn faster than without load.
    TooFast {
        /// Joint index.
        joint: u8,
        /// Peak speed the gait asks for, R 2π f, rad/s.
        needed_rad_s: f32,
        /// No-load speed of the joint, rad/s.
        limit_rad_s: f32,
    },
}

impl core::fmt::Display for RobotMismatch {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            RobotMismatch::JointCount {
                oscillators,
                joints,
            } => {
                write!(
                    f,
                    "the gait has {oscillators} oscillators, the robot {joints} joints"
                )
            }
            RobotMismatch::TooFast {
                joint,
                needed_rad_s,
                limit_rad_s,
            } => write!(
                f,
                "joint {joint} would need {needed_rad_s:.3} rad/s, its no-load speed is {limit_rad_s:.3} rad/s: lower its amplitude or the frequency"
            ),
        }
    }
}

impl core::error::Error for RobotMismatch {}

/// A valid gait in canonical form.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Gait {
    raw: RawGait,
}

impl Gait {
    /// The canonical plain form, for files, frames and digests.
    #[must_use]
    pub fn raw(&self) -> RawGait {
        self.raw.clone()
    }

    /// Name for people.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.raw.name
    }

    /// Common frequency, Hz.
    #[must_use]
    pub fn frequency_hz(&self) -> f32 {
        self.raw.frequency_hz
    }

    /// Filter rate `a`, 1/s.
    #[must_use]
    pub fn rate_a_per_s(&self) -> f32 {
        self.raw.rate_a_per_s
    }

    /// Length of a run, s.
    #[must_use]
    pub fn duration_s(&self) -> f32 {
        self.raw.duration_s
    }

    /// Oscillators in joint order, 1 to [`MAX_OSCILLATORS`].
    #[must_use]
    pub fn oscillators(&self) -> &[Oscillator] {
        &self.raw.oscillators
    }

    /// Links with `from < to`, sorted.
    #[must_use]
    pub fn links(&self) -> &[Link] {
        &self.raw.links
    }

    /// Whether the robot can follow: one oscillator per joint, and amplitude times 2π f below each joint's no-load speed.
    ///
    /// # Errors
    /// [`RobotMismatch`] names the first joint that cannot, with both speeds.
    pub fn check_speed(&self, joints: &[JointLimits]) -> Result<(), RobotMismatch> {
        if self.raw.oscillators.len() != joints.len() {
            return Err(RobotMismatch::JointCount {
                oscillators: self.raw.oscillators.len() as u8,
                joints: joints.len().min(usize::from(u8::MAX)) as u8,
            });
        }
        for (k, (oscillator, joint)) in self.raw.oscillators.iter().zip(joints).enumerate() {
            let needed_rad_s = oscillator.amplitude_rad * (math::TAU * self.raw.frequency_hz);
            let limit_rad_s = joint.no_load_speed_rad_s;
            if needed_rad_s > limit_rad_s {
                return Err(RobotMismatch::TooFast {
                    joint: k as u8,
                    needed_rad_s,
                    limit_rad_s,
                });
            }
        }
        Ok(())
    }
}

impl TryFrom<RawGait> for Gait {
    type Error = GaitError;

    fn try_from(mut raw: RawGait) -> Result<Self, GaitError> {
        if raw.name.is_empty() || raw.name.chars().any(char::is_control) {
            return Err(GaitError::Name);
        }
        if raw.oscillators.is_empty() {
            return Err(GaitError::NoOscillators);
        }
        check(GaitField::Frequency, 0, raw.frequency_hz, FREQUENCY_HZ)?;
        check(GaitField::RateA, 0, raw.rate_a_per_s, RATE_A_PER_S)?;
        check(GaitField::Duration, 0, raw.duration_s, DURATION_S)?;
        for (k, o) in raw.oscillators.iter().enumerate() {
            check(GaitField::Amplitude, k, o.amplitude_rad, AMPLITUDE_RAD)?;
            check(GaitField::Offset, k, o.offset_rad, OFFSET_RAD)?;
            check(GaitField::InitialPhase, k, o.initial_phase_rad, PHASE_RAD)?;
        }
        check_links(&raw)?;
        canonicalise(&mut raw);
        Ok(Gait { raw })
    }
}

impl From<Gait> for RawGait {
    fn from(gait: Gait) -> RawGait {
        gait.raw
    }
}

fn check(field: GaitField, index: usize, value: f32, range: Range) -> Result<(), GaitError> {
    if range.contains(value) {
        Ok(())
    } else {
        Err(GaitError::OutOfRange {
            field,
            index: index as u8,
            value,
            min: range.min,
            max: range.max,
        })
    }
}

fn check_links(raw: &RawGait) -> Result<(), GaitError> {
    let count = raw.oscillators.len();
    for (k, link) in raw.links.iter().enumerate() {
        for oscillator in [link.from, link.to] {
            if usize::from(oscillator) >= count {
                return Err(GaitError::LinkOutOfRange {
                    link: k as u8,
                    oscillator,
                    count: count as u8,
                });
            }
        }
        if link.from == link.to {
            return Err(GaitError::SelfLink { link: k as u8 });
        }
        let same = |other: &Link| {
            (other.from, other.to) == (link.from, link.to)
                || (other.from, other.to) == (link.to, link.from)
        };
        if let Some(earlier) = raw.links.iter().take(k).position(same) {
            return Err(GaitError::DuplicateLink {
                link: k as u8,
                earlier: earlier as u8,
            });
        }
        check(GaitField::Weight, k, link.weight, WEIGHT)?;
        check(GaitField::PhaseLag, k, link.phase_lag_rad, PHASE_RAD)?;
    }
    Ok(())
}

/// Adding zero turns -0 into +0 and leaves every other number as it is.
fn canonicalise(raw: &mut RawGait) {
    raw.frequency_hz += 0.0;
    for o in &mut raw.oscillators {
        o.amplitude_rad += 0.0;
        o.offset_rad += 0.0;
        o.initial_phase_rad = math::wrap_pi(o.initial_phase_rad) + 0.0;
    }
    for link in &mut raw.links {
        if link.from > link.to {
            core::mem::swap(&mut link.from, &mut link.to);
            link.phase_lag_rad = -link.phase_lag_rad;
        }
        link.weight += 0.0;
        link.phase_lag_rad = math::wrap_pi(link.phase_lag_rad) + 0.0;
    }
    sort_links(&mut raw.links);
}

/// Bubble sort of at most [`MAX_LINKS`] links: `core`'s sort can panic on an inconsistent order.
fn sort_links(links: &mut [Link]) {
    for _ in 0..links.len() {
        let mut rest = links.iter_mut();
        let Some(mut lower) = rest.next() else { return };
        for upper in rest {
            if (lower.from, lower.to) > (upper.from, upper.to) {
                core::mem::swap(lower, upper);
            }
            lower = upper;
        }
    }
}

/// Links of a chain 0-1-2-…: one weight, one phase lag per neighbouring pair. At most [`MAX_LINKS`] are taken.
#[must_use]
pub fn chain(weight: f32, phase_lags_rad: &[f32]) -> Vec<Link, MAX_LINKS> {
    let mut links = Vec::new();
    for (from, lag) in (0u8..).zip(phase_lags_rad).take(MAX_LINKS) {
        let _ = links.push(Link {
            from,
            to: from + 1,
            weight,
            phase_lag_rad: *lag,
        });
    }
    links
}
