//! When the next cycle is due, and what a late one costs.
//!
//! Control cycles start on a fixed 50 ms grid. On request four more readings stand between them, 10 ms apart.
//! A cycle that is not over when the next is due is an overrun: the grid instants it covered are skipped, never caught
//! up in a burst. One overrun holds the pose for the next cycle; [`STOP_AFTER`] in a row stop the robot.

use control::CYCLE_US;

/// Readings per control cycle at the fast rate: 100 Hz.
pub const READINGS: u64 = 5;
/// Distance of readings at the fast rate, us.
pub const READING_US: u64 = CYCLE_US / READINGS;
/// Overruns in a row that stop the robot.
pub const STOP_AFTER: u8 = 3;

/// What an instant is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Slot {
    /// Full cycle: reading, decision, set-points.
    Control,
    /// Reading only.
    Reading,
}

/// What became of a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Next {
    /// Next instant, us.
    pub due_us: u64,
    /// Control instants that were skipped.
    pub skipped: u32,
    /// Length of the cycle from its grid instant, us.
    pub took_us: u64,
}

/// The grid.
#[derive(Debug)]
pub struct Timing {
    control_us: u64,
    slot: u64,
    in_row: u8,
    overruns: u32,
}

impl Timing {
    /// The first instant given to [`Timing::begin`] fixes the grid.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            control_us: 0,
            slot: READINGS,
            in_row: 0,
            overruns: 0,
        }
    }

    /// Enters the instant `due_us`, as returned by [`Timing::end`].
    pub fn begin(&mut self, due_us: u64) -> Slot {
        let ahead = due_us.saturating_sub(self.control_us);
        if self.slot >= READINGS || ahead >= CYCLE_US {
            self.control_us = due_us;
            self.slot = 0;
        } else {
            self.slot = ahead / READING_US;
        }
        if self.slot == 0 {
            Slot::Control
        } else {
            Slot::Reading
        }
    }

    /// Leaves the instant at `now_us` and says when the next is due. `fast` asks for the readings in between.
    pub fn end(&mut self, now_us: u64, fast: bool) -> Next {
        let took_us = now_us.saturating_sub(self.control_us);
        // First reading instant that is not past.
        let next_slot = (took_us.saturating_add(READING_US - 1) / READING_US).max(self.slot + 1);
        if fast && next_slot < READINGS {
            return Next {
                due_us: self.control_us + next_slot * READING_US,
                skipped: 0,
                took_us,
            };
        }
        self.slot = READINGS;
        // First control instant that is not past; the next one if all went well.
        let periods = (took_us.saturating_add(CYCLE_US - 1) / CYCLE_US).max(1);
        let skipped = u32::try_from(periods - 1).unwrap_or(u32::MAX);
        if skipped > 0 {
            self.in_row = self.in_row.saturating_add(1);
            self.overruns = self.overruns.saturating_add(1);
        } else {
            self.in_row = 0;
        }
        Next {
            due_us: self.control_us + periods * CYCLE_US,
            skipped,
            took_us,
        }
    }

    /// What the present instant is for.
    #[must_use]
    pub fn slot(&self) -> Slot {
        if self.slot == 0 {
            Slot::Control
        } else {
            Slot::Reading
        }
    }

    /// Overruns in a row up to now.
    #[must_use]
    pub fn in_row(&self) -> u8 {
        self.in_row
    }

    /// Overruns since boot.
    #[must_use]
    pub fn overruns(&self) -> u32 {
        self.overruns
    }
}

impl Default for Timing {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_instants_keep_the_grid_whatever_the_cycle_takes() {
        let mut timing = Timing::new();
        let mut due = 7;
        for took in (0..500_000).step_by(333) {
            assert_eq!(timing.begin(due), Slot::Control);
            let next = timing.end(due + took, false);
            assert_eq!((next.due_us - 7) % CYCLE_US, 0);
            assert!(next.due_us >= due + took && next.due_us - (due + took) <= CYCLE_US);
            assert_eq!(next.skipped > 0, took > CYCLE_US);
            due = next.due_us;
        }
        assert!(timing.in_row() >= STOP_AFTER);
    }

    #[test]
    fn fast_readings_stand_between_control_cycles_and_give_way_when_late() {
        let mut timing = Timing::new();
        let mut due = 0;
        let mut slots = Vec::new();
        for took in [3_000, 2_000, 2_000, 2_000, 2_000, 23_000, 1_000, 1_000] {
            slots.push((due, timing.begin(due)));
            due = timing.end(due + took, true).due_us;
        }
        let readings = [0, 10, 20, 30, 40, 50, 80, 90].map(|ms| ms * 1000);
        assert_eq!(
            slots.iter().map(|(at, _)| *at).collect::<Vec<_>>(),
            readings
        );
        assert!(
            slots
                .iter()
                .all(|(at, slot)| (*slot == Slot::Control) == (at % CYCLE_US == 0))
        );
        assert_eq!(timing.overruns(), 0);
    }
}
