//! Telemetry: one [`Sample`] per cycle, several of them delta-coded in a [`SampleBlock`], blocks kept in a [`SampleLog`] until drained.
//!
//! Numbers are the integers of [`crate::units`], as the packed feedback block carries them; nothing is rounded twice and every bit comes back.

use heapless::{Deque, Vec};
use serde::{Deserialize, Serialize};

use super::delta::{self, Form, SampleDelta};
use super::{JOINTS, MAX_JOINTS};
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
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sample {
    /// CPG cycle of the run.
    pub cycle: u32,
    /// Module clock at the begin of the cycle, us since boot.
    pub t_us: u64,
    /// [`flags`].
    pub flags: u8,
    /// Bit k: motor k answered in this cycle. Where it did not, its numbers are those of its last answer.
    pub valid_mask: u16,
    /// In joint order, as many as the robot has.
    pub motors: Vec<MotorSample, MAX_JOINTS>,
}

impl MotorSample {
    /// All zero.
    pub const ZERO: Self = Self {
        dt_us: 0,
        setpoint_urad: 0,
        feedback: PackedFeedback::ZERO,
    };
}

impl Sample {
    /// All zero, without motors.
    pub const ZERO: Self = Self {
        cycle: 0,
        t_us: 0,
        flags: 0,
        valid_mask: 0,
        motors: Vec::new(),
    };

    /// All zero, of a robot with this many motors, at most [`MAX_JOINTS`].
    #[must_use]
    pub fn of(motors: u8) -> Self {
        let mut sample = Self::ZERO;
        for _ in 0..motors {
            // More than fit are left out.
            let _ = sample.motors.push(MotorSample::ZERO);
        }
        sample
    }
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
    /// Motors of the robot; 0 where none has run yet.
    pub motors: u8,
    /// The delta code.
    #[serde(serialize_with = "as_bytes")]
    pub data: Vec<u8, MAX_BLOCK_DATA, u16>,
}

/// The same bytes on the wire as a list of numbers, moved at once.
fn as_bytes<S: serde::Serializer>(
    data: &Vec<u8, MAX_BLOCK_DATA, u16>,
    to: S,
) -> Result<S::Ok, S::Error> {
    to.serialize_bytes(data)
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
    /// Index of the sample after the last one.
    #[must_use]
    pub fn end(&self) -> u32 {
        self.first.saturating_add(u32::from(self.count))
    }

    /// The samples inside, in order.
    #[must_use]
    pub fn samples(&self) -> Samples<'_> {
        Samples {
            data: &self.data,
            left: self.count,
            state: SampleDelta::new(self.motors),
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
struct BlockWriter {
    block: SampleBlock,
    state: SampleDelta,
    /// Index of the next sample.
    next: u32,
}

impl BlockWriter {
    /// Of no robot, nothing written: a constant, so that a static can hold it.
    const BLANK: Self = Self {
        block: SampleBlock {
            run: 0,
            first: 0,
            count: 0,
            dropped: 0,
            motors: 0,
            data: Vec::new(),
        },
        state: SampleDelta::BLANK,
        next: 0,
    };

    fn new(run: u16, motors: u8) -> Self {
        Self {
            block: SampleBlock {
                run,
                motors,
                ..SampleBlock::default()
            },
            state: SampleDelta::new(motors),
            next: 0,
        }
    }

    /// Adds a sample. When it does not fit any more, returns the finished block and begins the next with this sample.
    fn push(&mut self, sample: &Sample) -> Option<SampleBlock> {
        if self.append(sample) {
            return None;
        }
        let full = self.take();
        // An empty block holds any sample: MAX_SAMPLE <= MAX_BLOCK_DATA.
        let _ = self.append(sample);
        full
    }

    /// Ends the current block, if it holds anything.
    fn take(&mut self) -> Option<SampleBlock> {
        let next = SampleBlock {
            first: self.next,
            dropped: self.block.dropped,
            run: self.block.run,
            motors: self.block.motors,
            ..SampleBlock::default()
        };
        self.state = SampleDelta::new(self.block.motors);
        let ended = core::mem::replace(&mut self.block, next);
        (ended.count > 0).then_some(ended)
    }

    fn append(&mut self, sample: &Sample) -> bool {
        if self.block.count == u8::MAX {
            return false;
        }
        let mut code = [0; delta::MAX_SAMPLE];
        // What does not fit ends the block, and the next one begins with a new state: nothing to go back to, but for the second form.
        let before = self.state.says_form().then(|| self.state.clone());
        let mut used = self.state.encode(sample, &mut code, Form::Adaptive);
        if let (None, Some(before)) = (used, before) {
            // More than six motors, most of them far from what was predicted.
            self.state = before;
            used = self.state.encode(sample, &mut code, Form::Plain);
        }
        let Some(used) = used else { return false };
        let code = code.get(..used).unwrap_or(&[]);
        if self.block.data.extend_from_slice(code).is_err() {
            return false;
        }
        self.block.count = self.block.count.saturating_add(1);
        self.next = self.next.saturating_add(1);
        true
    }
}

/// The telemetry of one run in at most `BLOCKS` blocks of 496 bytes: sent while the run goes on as the link allows, kept for a second request as long as
/// there is room.
///
/// When memory is full, the oldest block that was sent once makes room. If none was sent, the newest samples are dropped and counted: what is there
/// stays a whole beginning of the run.
#[derive(Debug, Clone)]
pub struct SampleLog<const BLOCKS: usize> {
    blocks: Deque<SampleBlock, BLOCKS>,
    /// Blocks at the front that were sent once.
    sent: usize,
    /// The last sample ended a block: it is not sent in the same cycle, which has coded that sample twice.
    fresh: bool,
    writer: BlockWriter,
}

impl<const BLOCKS: usize> Default for SampleLog<BLOCKS> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const BLOCKS: usize> SampleLog<BLOCKS> {
    /// Empty.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            blocks: Deque::new(),
            sent: 0,
            fresh: false,
            writer: BlockWriter::BLANK,
        }
    }

    /// Forgets the last run, begins one with this number on a robot with this many motors.
    pub fn begin(&mut self, run: u16, motors: u8) {
        self.blocks.clear();
        self.sent = 0;
        self.fresh = false;
        self.writer = BlockWriter::new(run, motors);
    }

    /// Takes a sample.
    pub fn push(&mut self, sample: &Sample) {
        self.fresh = false;
        if let Some(full) = self.writer.push(sample) {
            self.store(full);
            self.fresh = true;
        }
    }

    /// Ends the block that is being filled: at the end of the run, or to keep latency low.
    pub fn flush(&mut self) {
        self.fresh = false;
        if let Some(block) = self.writer.take() {
            self.store(block);
        }
    }

    /// The next block to be sent; it counts as sent now. One that the last sample has ended waits for the next sample or the end of the run.
    pub fn next_unsent(&mut self) -> Option<&SampleBlock> {
        if !self.has_unsent() {
            return None;
        }
        let block = self.blocks.iter().nth(self.sent)?;
        self.sent = self.sent.saturating_add(1);
        Some(block)
    }

    /// Whether [`SampleLog::next_unsent`] has one.
    #[must_use]
    pub fn has_unsent(&self) -> bool {
        self.sent.saturating_add(usize::from(self.fresh)) < self.blocks.len()
    }

    /// The block that holds sample `from`, or the next one kept. At the end: an empty block whose `first` is the number of samples taken.
    /// Forgets nothing, so that nobody can take a record away by asking for it. `to_recorder`: the answer goes where blocks go unasked, so the
    /// block need not be sent there again.
    pub fn drain(&mut self, from: u32, to_recorder: bool) -> SampleBlock {
        let mut kept = self.blocks.iter().enumerate();
        match kept.find(|(_, block)| block.end() > from) {
            Some((index, block)) => {
                if to_recorder && index == self.sent {
                    self.sent = self.sent.saturating_add(1);
                }
                block.clone()
            }
            None => SampleBlock {
                run: self.writer.block.run,
                first: self.writer.next,
                dropped: self.dropped(),
                motors: self.writer.block.motors,
                ..SampleBlock::default()
            },
        }
    }

    /// Number of the run.
    #[must_use]
    pub fn run(&self) -> u16 {
        self.writer.block.run
    }

    /// Samples taken in this run, dropped ones included.
    #[must_use]
    pub fn taken(&self) -> u32 {
        self.writer.next
    }

    /// Samples of this run dropped before they were ever sent.
    #[must_use]
    pub fn dropped(&self) -> u32 {
        self.writer.block.dropped
    }

    /// Blocks in memory.
    #[must_use]
    pub fn kept_blocks(&self) -> usize {
        self.blocks.len()
    }

    fn store(&mut self, block: SampleBlock) {
        if self.blocks.is_full() && self.sent > 0 {
            let _ = self.blocks.pop_front();
            self.sent = self.sent.saturating_sub(1);
        }
        if let Err(refused) = self.blocks.push_back(block) {
            let dropped = &mut self.writer.block.dropped;
            *dropped = dropped.saturating_add(u32::from(refused.count));
        }
    }
}

/// A [`Sample`] of six motors, as the wire has carried it from the start: without their number.
pub(super) mod six_sample {
    use super::{JOINTS, MotorSample, Sample, Vec};
    use serde::de::Deserializer;
    use serde::ser::{Error, Serializer};
    use serde::{Deserialize, Serialize};

    #[derive(Serialize, Deserialize)]
    struct SixSample {
        cycle: u32,
        t_us: u64,
        flags: u8,
        valid_mask: u16,
        motors: [MotorSample; JOINTS],
    }

    pub(in super::super) fn serialize<S: Serializer>(
        sample: &Sample,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        let motors = sample.motors.as_slice().try_into();
        let motors = motors.map_err(|_| S::Error::custom("not six motors"))?;
        SixSample {
            cycle: sample.cycle,
            t_us: sample.t_us,
            flags: sample.flags,
            valid_mask: sample.valid_mask,
            motors,
        }
        .serialize(to)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Sample, D::Error> {
        let six = SixSample::deserialize(from)?;
        let mut motors = Vec::new();
        for motor in six.motors {
            // Six fit.
            let _ = motors.push(motor);
        }
        Ok(Sample {
            cycle: six.cycle,
            t_us: six.t_us,
            flags: six.flags,
            valid_mask: six.valid_mask,
            motors,
        })
    }
}

/// A [`SampleBlock`] of six motors, as the wire has carried it from the start: without their number.
pub(super) mod six_block {
    use super::{JOINTS, MAX_BLOCK_DATA, SampleBlock, Vec};
    use serde::de::Deserializer;
    use serde::ser::Serializer;
    use serde::{Deserialize, Serialize};

    #[derive(Serialize)]
    struct SixBlock<'a> {
        run: u16,
        first: u32,
        count: u8,
        dropped: u32,
        #[serde(serialize_with = "super::as_bytes")]
        data: &'a Vec<u8, MAX_BLOCK_DATA, u16>,
    }

    #[derive(Deserialize)]
    struct OwnedSixBlock {
        run: u16,
        first: u32,
        count: u8,
        dropped: u32,
        data: Vec<u8, MAX_BLOCK_DATA, u16>,
    }

    pub(in super::super) fn serialize<S: Serializer>(
        block: &SampleBlock,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        SixBlock {
            run: block.run,
            first: block.first,
            count: block.count,
            dropped: block.dropped,
            data: &block.data,
        }
        .serialize(to)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<SampleBlock, D::Error> {
        let six = OwnedSixBlock::deserialize(from)?;
        Ok(SampleBlock {
            run: six.run,
            first: six.first,
            count: six.count,
            dropped: six.dropped,
            motors: JOINTS as u8,
            data: six.data,
        })
    }
}
