//! Numbers that signals show without a simulation: set-points on their way ([`super::echo`]), frames that a film lacks.

use crate::verdict::Estimate;
use crate::vocabulary::Effect;

/// An effect read off the signals.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Reading {
    pub(super) effect: Effect,
    pub(super) joint: Option<usize>,
    pub(super) key: &'static str,
    pub(super) estimate: Estimate,
}

pub(super) fn exact(value: f64, half: f64) -> Estimate {
    Estimate {
        value,
        ci95: [value - half, value + half],
    }
}
