//! Telemetry: one [`Sample`] per cycle, several of them delta-coded in a [`SampleBlock`], blocks kept in a [`SampleLog`] until drained.
//!
//! Numbers are the integers of [`crate::units`], as the packed feedback block carries them; nothing is rounded twice and every bit comes back.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::JOINTS;
use super::delta::{self, SampleDelta};
use crate::bus::PackedFeedback;

/// One motor in one cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MotorSample {
    /// Instant of the measurement on the module's clock, us after the sample's `t_us`.
    pub dt_us: u32,
    /// Set-point the module sent last before the measurement, urad.
    pub setpoint_urad: i32,
    /// What the driver measured, with its own tick and the set-point it applies.
    pub feedback: PackedFeedback,
}

/// All motors in one cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sample {
    /// CPG cycle of the run.
    pub cycle: u32,
    /// Module clock at the begin of the cycle, us since boot.
    pub t_us: u64,
    /// [`flags`].
    pub flags: u8,
    /// Bit k: motor k answered in this cycle. Where it did not, its numbers are those of its last answer.
    pub valid_mask: u8,
    /// In joint order.
    pub motors: [MotorSample; JOINTS],
}

/// Bits of [`Sample::flags`].
pub mod flags {
    /// The pre-check holds all joints.
    pub const HOLD: u8 = 1 << 0;
    /// Torque is on.
    pub const TORQUE: u8 = 1 << 1;
    /// The set-point is new in this sample (with 100 Hz telemetry, in one of five).
    pub const NEW_SETPOINT: u8 = 1 << 2;
    /// Moving to the start pose: t = 0 of the run is not yet reached.
    pub const APPROACH: u8 = 1 << 3;
}

/// Largest delta-coded part of a block. With the other fields (at most 16 bytes) and the length (2) a block fills a frame.
pub const MAX_BLOCK_DATA: usize = 474;

const _: () = assert!(MAX_BLOCK_DATA + 18 == super::MAX_PAYLOAD);
const _: () = assert!(delta::MAX_SAMPLE <= MAX_BLOCK_DATA);

/// Consecutive samples, delta-coded. The first is coded against zeros, so every block can be read without the others.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct SampleBlock {
    /// Number of the run since boot.
    pub run: u16,
    /// Index of the first sample within the run; gaps are dropped samples.
    pub first: u32,
    /// Samples inside; 0 = no more.
    pub count: u8,
    /// Samples of this run dropped so far.
    pub dropped: u32,
    /// The delta code.
    pub data: Vec<u8, MAX_BLOCK_DATA>,
}

/// Why a block cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BlockError {
    /// The delta code ends early or holds an impossible number.
    Damaged,
    /// Bytes are left after the last sample.
    TrailingBytes,
}

impl SampleBlock {
    /// The samples inside, in order.
    #[must_use]
    pub fn samples(&self) -> Samples<'_> {
        Samples {
            data: &self.data,
            left: self.count,
            state: SampleDelta::new(),
        }
    }
}

/// Iterator over the samples of a block. Ends after the first error.
#[derive(Debug, Clone)]
pub struct Samples<'a> {
    data: &'a [u8],
    left: u8,
    state: SampleDelta,
}

impl Iterator for Samples<'_> {
    type Item = Result<Sample, BlockError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.left = match self.left.checked_sub(1) {
            Some(left) => left,
            None if self.data.is_empty() => return None,
            None => {
                self.data = &[];
                return Some(Err(BlockError::TrailingBytes));
            }
        };
        let Some((sample, rest)) = self.state.decode(self.data) else {
            self.left = 0;
            self.data = &[];
            return Some(Err(BlockError::Damaged));
        };
        self.data = rest;
        Some(Ok(sample))
    }
}

/// Fills one block after the other.
#[derive(Debug, Clone)]
pub struct BlockWriter {
    block: SampleBlock,
    state: SampleDelta,
    next: u32,
}

impl BlockWriter {
    /// A writer for one run.
    #[must_use]
    pub fn new(run: u16) -> Self {
        Self {
            block: SampleBlock {
                run,
                ..SampleBlock::default()
            },
            state: SampleDelta::new(),
            next: 0,
        }
    }

    /// Adds a sample. When it does not fit any more, returns the finished block and begins the next with this sample.
    pub fn push(&mut self, sample: &Sample) -> Option<SampleBlock> {
        if self.append(sample) {
            return None;
        }
        let full = self.take();
        // An empty block holds any sample: MAX_SAMPLE <= MAX_BLOCK_DATA.
        let _ = self.append(sample);
        full
    }

    /// Counts a sample that was not kept; ends the current block, because blocks hold consecutive samples.
    pub fn skip(&mut self) -> Option<SampleBlock> {
        let ended = self.take();
        self.next = self.next.saturating_add(1);
        self.block.first = self.next;
        self.block.dropped = self.block.dropped.saturating_add(1);
        ended
    }

    /// Adds dropped samples that were already in finished blocks.
    pub fn add_dropped(&mut self, samples: u32) {
        self.block.dropped = self.block.dropped.saturating_add(samples);
    }

    /// Ends the current block, if it holds anything.
    pub fn take(&mut self) -> Option<SampleBlock> {
        let next = SampleBlock {
            run: self.block.run,
            first: self.next,
            count: 0,
            dropped: self.block.dropped,
            data: Vec::new(),
        };
        self.state = SampleDelta::new();
        let ended = core::mem::replace(&mut self.block, next);
        (ended.count > 0).then_some(ended)
    }

    /// Samples seen so far, dropped ones included.
    #[must_use]
    pub fn seen(&self) -> u32 {
        self.next
    }

    /// Samples dropped so far.
    #[must_use]
    pub fn dropped(&self) -> u32 {
        self.block.dropped
    }

    fn append(&mut self, sample: &Sample) -> bool {
        if self.block.count == u8::MAX {
            return false;
        }
        let mut code = [0; delta::MAX_SAMPLE];
        let mut state = self.state;
        let used = state.encode(sample, &mut code);
        if self
            .block
            .data
            .extend_from_slice(code.get(..used).unwrap_or(&[]))
            .is_err()
        {
            return false;
        }
        self.state = state;
        self.block.count = self.block.count.saturating_add(1);
        self.next = self.next.saturating_add(1);
        true
    }
}
