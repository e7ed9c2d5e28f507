//! When things happened within a run.
//!
//! The firmware reads all drivers at the begin of a cycle and sends new set-points after it. A sample therefore shows the
//! set-points sent one sample period earlier, together with what the joints had made of them by now.

use super::reader::RunData;
use super::rows::SampleRow;

/// Sample period where a recording does not say its rate: 20 Hz.
const DEFAULT_RATE_HZ: f64 = 20.0;

/// Instants of a run on the device clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timing {
    /// Between two samples.
    pub period_us: u64,
    /// The first set-points of the gait left: t = 0 of the run.
    pub start_us: u64,
    /// The last set-points of the gait had been held for their cycle.
    pub end_us: u64,
}

impl Timing {
    /// Works out the instants of a run, if any of its samples belongs to the gait.
    #[must_use]
    pub fn of(run: &RunData) -> Option<Self> {
        let rate_hz = run
            .start
            .as_ref()
            .map(|s| s.rate_hz)
            .filter(|r| *r > 0.0)
            .unwrap_or(DEFAULT_RATE_HZ);
        let period_us = (1e6 / rate_hz).round() as u64;
        let first = run.samples.iter().find(|s| is_first_of_cycle(s))?;
        let start_us = start_us(first, period_us);
        let last_cycle = run.samples.iter().map(|s| s.cycle).max().unwrap_or(0);
        Some(Self {
            period_us,
            start_us,
            end_us: start_us + u64::from(last_cycle) * control::CYCLE_US,
        })
    }

    /// When the set-points that a sample shows were sent, without the bus time of the drivers' answers before them.
    #[must_use]
    pub fn sent_us(&self, sample: &SampleRow) -> u64 {
        sample.t_us.saturating_sub(self.period_us)
    }

    /// Whether the set-points of a sample come from the gait, not from the way to the start pose or the stop.
    #[must_use]
    pub fn is_gait(&self, sample: &SampleRow) -> bool {
        !sample.approach && sample.cycle > 0 && self.sent_us(sample) < self.end_us
    }
}

/// Whether a sample is the first to show new set-points of the gait.
#[must_use]
pub fn is_first_of_cycle(sample: &SampleRow) -> bool {
    sample.new_setpoint && !sample.approach && sample.cycle > 0
}

/// t = 0 of the run from a sample that shows new set-points of the gait.
#[must_use]
pub fn start_us(sample: &SampleRow, period_us: u64) -> u64 {
    let before = u64::from(sample.cycle.saturating_sub(1)) * control::CYCLE_US;
    sample.t_us.saturating_sub(period_us).saturating_sub(before)
}
