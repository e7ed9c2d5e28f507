//! A host's packet for the motor bus: sent once, then listened for in slices that leave the watchdog its due.

use super::core::{BusJob, Core};
use super::types::{BUS_BUFFER, Step};
use heapless::Vec;
use protocol::link::{BusAnswer, BusStatus, Completed, Reject};

/// Longest part of a raw listening that one cycle spends, us.
const LISTEN_SLICE_US: u64 = 30_000;

/// How far the packet is.
#[derive(Debug)]
pub(super) struct Raw {
    sent: bool,
    listened_us: u64,
}

impl Raw {
    pub(super) const fn new() -> Self {
        Self {
            sent: false,
            listened_us: 0,
        }
    }

    /// Whether the packet is out and its answer is not taken yet.
    pub(super) fn is_sent(&self) -> bool {
        self.sent
    }

    /// The packet, or the next slice of listening.
    pub(super) fn next(&mut self, core: &Core, tx: &mut [u8; BUS_BUFFER]) -> Step {
        let Some(job) = core.bus_job.as_ref() else {
            return Step::Done;
        };
        let mut len = 0;
        if !self.sent {
            self.sent = true;
            self.listened_us = 0;
            len = job.packet.len();
            for (place, byte) in tx.iter_mut().zip(&job.packet) {
                *place = *byte;
            }
        }
        let gap_us = listen_us(job)
            .saturating_sub(self.listened_us)
            .min(LISTEN_SLICE_US);
        self.listened_us = self.listened_us.saturating_add(gap_us);
        Step::Exchange {
            len,
            reply_bytes: 0,
            gap_us,
        }
    }

    /// The answer, when the listening time is over.
    pub(super) fn take(&mut self, core: &mut Core) -> Option<(usize, Result<Completed, Reject>)> {
        let job = core.bus_job.as_ref()?;
        if !self.sent || self.listened_us < listen_us(job) {
            return None;
        }
        self.sent = false;
        let job = core.bus_job.take()?;
        // The own echo, whole, is not an answer.
        let heard = job
            .heard
            .strip_prefix(job.packet.as_slice())
            .unwrap_or(&job.heard);
        let status = match (heard.is_empty(), job.overflow) {
            (_, true) => BusStatus::Overflow,
            (true, false) => BusStatus::Silent,
            (false, false) => BusStatus::Heard,
        };
        // Shorter than the buffer it came from.
        let bytes = Vec::from_slice(heard).unwrap_or_default();
        Some((job.link, Ok(Completed::Bus(BusAnswer { status, bytes }))))
    }
}

fn listen_us(job: &BusJob) -> u64 {
    u64::from(job.listen_ms) * 1000
}
