//! One run, from the start order to the end of the hold.

use control::gait::Gait;
use control::motion::Planner;
use control::supervisor::{State, StopReason};
use protocol::crc::Crc32c;
use protocol::link::{Digest, EndReason, RunEnd, StartOrder, TelemetryRate, WireGait};

/// Cycles between two checks of the gait in RAM against its fingerprint: one second.
const CHECK_CYCLES: u32 = 20;
/// Cycles in which at most one block of the record goes out; what a tick then takes prints `hil-sim`'s example `board_worst`.
const BLOCK_CYCLES: u32 = 2;
// No block goes out in the cycle of a check.
const _: () = assert!(CHECK_CYCLES.is_multiple_of(BLOCK_CYCLES));

/// A run.
pub struct Run {
    /// Number since boot.
    pub number: u16,
    /// The slot it came from.
    pub slot: u8,
    /// Fingerprint of the gait that governs the set-points.
    pub digest: Digest,
    /// Fingerprint of the gait that takes over at the end of the planner's queue.
    pub next_digest: Option<Digest>,
    /// The link that ordered it.
    pub link: usize,
    /// What is recorded of this run; nothing but the start order sets it.
    pub rate: TelemetryRate,
    gait: Gait,
    /// From the first cycle with torque on.
    pub planner: Option<Planner>,
    /// CPG cycles so far.
    pub cycles: u32,
    /// Cycles since torque was asked for.
    pub age_cycles: u32,
    /// The planner said in the last cycle that the start pose is reached.
    pub in_position: bool,
    /// The next cycle repeats the last set-point: the last one was an overrun.
    pub hold_next: bool,
    /// Length of the hold under way, cycles.
    pub hold_cycles: u32,
    /// A set-point went out since the last sample.
    pub new_setpoint: bool,
    crc: Crc32c,
    reason: Option<EndReason>,
}

impl Run {
    /// A run that has been ordered; nothing moves yet.
    #[must_use]
    pub fn new(number: u16, gait: Gait, order: &StartOrder, link: usize) -> Self {
        Self {
            number,
            slot: order.slot,
            digest: order.digest,
            next_digest: None,
            link,
            rate: order.rate,
            gait,
            planner: None,
            cycles: 0,
            age_cycles: 0,
            in_position: false,
            hold_next: false,
            hold_cycles: 0,
            new_setpoint: false,
            crc: Crc32c::new(),
            reason: None,
        }
    }

    /// The gait.
    #[must_use]
    pub fn gait(&self) -> &Gait {
        &self.gait
    }

    /// Counts one CPG cycle and its set-points.
    pub fn count(&mut self, set_point_rad: &[f32]) {
        self.cycles = self.cycles.saturating_add(1);
        for angle in set_point_rad {
            self.crc.update(&angle.to_le_bytes());
        }
    }

    /// Whether this is the cycle of [`Run::is_intact`]: one of every second.
    #[must_use]
    pub fn is_to_check(&self) -> bool {
        self.age_cycles.is_multiple_of(CHECK_CYCLES)
    }

    /// Whether a block of the record may go out in this cycle: one is filled in ten cycles, or in a few instants of the grid.
    #[must_use]
    pub fn may_send_block(&self) -> bool {
        self.rate == TelemetryRate::Fast || !self.age_cycles.is_multiple_of(BLOCK_CYCLES)
    }

    /// Whether gait and planner still hold what was ordered.
    pub fn is_intact(&mut self) -> bool {
        let planned = self.planner.as_ref().map_or(&self.gait, Planner::gait);
        let found = WireGait::from(planned).digest();
        if self.next_digest == Some(found) {
            self.digest = found;
            self.next_digest = None;
        }
        found == self.digest
    }

    /// Notes why the run ends; the first reason stays.
    pub fn note_end(&mut self, state: &State) {
        let reason = match state {
            State::Stopping { reason, .. } => match reason {
                StopReason::Ordered => EndReason::Stopped,
                StopReason::DurationOver => EndReason::Completed,
                StopReason::LeaseOver => EndReason::HostLost,
                StopReason::ApproachBlocked => EndReason::ApproachBlocked,
                StopReason::ArmTimeout => EndReason::ArmTimeout,
                StopReason::Fault(fault) => EndReason::Fault((*fault).into()),
            },
            State::Fault { fault, .. } => EndReason::Fault((*fault).into()),
            State::EStop => EndReason::StopInput,
            State::Boot
            | State::Unhomed
            | State::Idle
            | State::Armed { .. }
            | State::Run { .. } => return,
        };
        // A fault during a ramp is worth more than the order that began it.
        let worse = matches!(reason, EndReason::Fault(_) | EndReason::StopInput)
            && matches!(
                self.reason,
                Some(EndReason::Completed | EndReason::Stopped | EndReason::HostLost)
            );
        if self.reason.is_none() || worse {
            self.reason = Some(reason);
        }
    }

    /// The account of the run.
    #[must_use]
    pub fn end(&self, samples: u32, dropped: u32) -> RunEnd {
        RunEnd {
            run: self.number,
            reason: self.reason.unwrap_or(EndReason::Stopped),
            cycles: self.cycles,
            holds: self.planner.as_ref().map_or(0, Planner::held_cycles),
            samples,
            dropped,
            setpoint_crc32c: self.crc.value(),
        }
    }
}
