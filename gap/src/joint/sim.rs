//! Channels, and the forward model for one parameter set.

use super::data::{CHANNELS, RunData};
use super::lanes::{Level, simulate_at};
use super::param::Params;

/// A simulated signal that may have been measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Channel {
    /// Encoder angle.
    Position,
    /// Motor current.
    Current,
    /// Controller output as a share of the supply.
    Duty,
    /// Bus voltage.
    BusVoltage,
    /// Link angle.
    Link,
    /// Motor effort.
    Effort,
    /// Set-point as applied.
    Applied,
}

impl Channel {
    /// All channels, in the order of [`super::Sample::measured`].
    pub const ALL: [Self; CHANNELS] = [
        Self::Position,
        Self::Current,
        Self::Duty,
        Self::BusVoltage,
        Self::Link,
        Self::Effort,
        Self::Applied,
    ];
}

/// Simulated channels at the rows of a run.
pub type Trace = Vec<[f64; CHANNELS]>;

/// Simulates a run with step `dt_s`; one entry per row. A run that blows up gives large finite values.
pub fn simulate(run: &RunData, p: &Params, dt_s: f64, trace: &mut Trace) {
    let one = std::slice::from_ref(p);
    simulate_at(Level::detect(), run, one, dt_s, std::slice::from_mut(trace));
}

/// [`simulate`] for many parameter sets; a trace for each.
#[must_use]
pub fn simulate_all(run: &RunData, sets: &[Params], dt_s: f64) -> Vec<Trace> {
    let mut traces = vec![Trace::new(); sets.len()];
    simulate_at(Level::detect(), run, sets, dt_s, &mut traces);
    traces
}
