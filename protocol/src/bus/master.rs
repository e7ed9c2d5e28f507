//! Module side of the bus: requests, and the parser of their answers.
//!
//! The parser takes whatever comes back: the own echo (whole, cut or absent), stray bytes, answers of others, answers twice. Each expected answer is
//! handed out once. Protocol 2.0 has no sequence number, so a late answer to an earlier request of the same kind cannot be told from ours by its frame:
//! the tick inside [`PackedFeedback`] tells.

mod exchange;

use heapless::Vec;

pub use exchange::{Answer, Exchange, ExchangeCounters};

use super::feedback::{PACKED_LEN, PackedFeedback};
use super::feetech;
use super::packet::{BROADCAST, Builder, Instruction, MAX_PACKET, PacketBuf, TooLong};
use super::profile::Framing;
use super::server::SKIP_NS;
use super::table::{PACKED_FEEDBACK, Register};

/// Drivers that one request can address: two meta-modules.
pub const MAX_DRIVERS: usize = 12;

/// Who answers a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Answers {
    /// Nobody.
    None,
    /// Each listed driver, a packet each.
    Each,
    /// All listed drivers, one packet.
    Together,
    /// Whoever is there: broadcast ping.
    Anyone,
}

/// A request and what it expects back.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Request {
    bytes: PacketBuf,
    framing: Framing,
    answers: Answers,
    ids: Vec<u8, MAX_DRIVERS>,
    data_len: u16,
}

impl Request {
    /// No request: no bytes, nobody answers.
    const fn nothing() -> Self {
        Self {
            bytes: PacketBuf::new(),
            framing: Framing::Dynamixel2,
            answers: Answers::None,
            ids: Vec::new(),
            data_len: 0,
        }
    }

    /// Is this driver there?
    ///
    /// # Errors
    /// [`TooLong`]; not for a single ping.
    pub fn ping(id: u8) -> Result<Self, TooLong> {
        let answers = if id == BROADCAST {
            Answers::Anyone
        } else {
            Answers::Each
        };
        let ids = if id == BROADCAST {
            &[][..]
        } else {
            core::slice::from_ref(&id)
        };
        Self::build(Builder::new(id, Instruction::Ping), answers, ids, 3)
    }

    /// Reads bytes of one driver.
    ///
    /// # Errors
    /// [`TooLong`] when the answer would be.
    pub fn read(id: u8, address: u16, len: u16) -> Result<Self, TooLong> {
        let [a0, a1] = address.to_le_bytes();
        let [l0, l1] = len.to_le_bytes();
        Self::build(
            Builder::new(id, Instruction::Read).params(&[a0, a1, l0, l1]),
            Answers::Each,
            &[id],
            len,
        )
    }

    /// Writes a register of one driver, or of all with [`BROADCAST`].
    ///
    /// # Errors
    /// [`TooLong`]; not for a single register.
    pub fn write(id: u8, register: Register, value: i32) -> Result<Self, TooLong> {
        let bytes = value.to_le_bytes();
        let data = bytes.get(..usize::from(register.size())).unwrap_or(&[]);
        let builder = Builder::new(id, Instruction::Write)
            .params(&register.address().to_le_bytes())
            .params(data);
        let (answers, ids) = if id == BROADCAST {
            (Answers::None, &[][..])
        } else {
            (Answers::Each, core::slice::from_ref(&id))
        };
        Self::build(builder, answers, ids, 0)
    }

    /// Restarts one driver, or all with [`BROADCAST`].
    ///
    /// # Errors
    /// [`TooLong`]; never.
    pub fn reboot(id: u8) -> Result<Self, TooLong> {
        let (answers, ids) = if id == BROADCAST {
            (Answers::None, &[][..])
        } else {
            (Answers::Each, core::slice::from_ref(&id))
        };
        Self::build(Builder::new(id, Instruction::Reboot), answers, ids, 0)
    }

    /// Writes one register of several drivers, each its own value. Nobody answers.
    ///
    /// # Errors
    /// [`TooLong`] for more drivers than fit a packet.
    pub fn sync_write(register: Register, values: &[(u8, i32)]) -> Result<Self, TooLong> {
        let mut builder = Builder::new(BROADCAST, Instruction::SyncWrite)
            .params(&register.address().to_le_bytes())
            .params(&register.size().to_le_bytes());
        for (id, value) in values {
            let bytes = value.to_le_bytes();
            builder = builder
                .params(&[*id])
                .params(bytes.get(..usize::from(register.size())).unwrap_or(&[]));
        }
        Self::build(builder, Answers::None, &[], 0)
    }

    /// Set-points for all drivers at once: [`Register::GoalAngle`], urad.
    ///
    /// # Errors
    /// As [`Request::sync_write`].
    pub fn set_points(goals_urad: &[(u8, i32)]) -> Result<Self, TooLong> {
        Self::sync_write(Register::GoalAngle, goals_urad)
    }

    /// Reads the same bytes of several drivers; each answers by itself.
    ///
    /// # Errors
    /// [`TooLong`] for more than [`MAX_DRIVERS`] or too much data.
    pub fn sync_read(address: u16, len: u16, ids: &[u8]) -> Result<Self, TooLong> {
        Self::sync(Instruction::SyncRead, Answers::Each, address, len, ids)
    }

    /// Reads the same bytes of several drivers; they answer with one packet. If one is missing, those after it stay silent.
    ///
    /// # Errors
    /// As [`Request::sync_read`].
    pub fn fast_sync_read(address: u16, len: u16, ids: &[u8]) -> Result<Self, TooLong> {
        Self::sync(
            Instruction::FastSyncRead,
            Answers::Together,
            address,
            len,
            ids,
        )
    }

    /// The cyclic read: the packed block of every driver.
    ///
    /// # Errors
    /// As [`Request::sync_read`].
    pub fn feedback(ids: &[u8]) -> Result<Self, TooLong> {
        Self::sync_read(PACKED_FEEDBACK, PACKED_LEN as u16, ids)
    }

    /// As [`Request::feedback`] by Fast Sync Read.
    ///
    /// # Errors
    /// As [`Request::sync_read`].
    pub fn fast_feedback(ids: &[u8]) -> Result<Self, TooLong> {
        Self::fast_sync_read(PACKED_FEEDBACK, PACKED_LEN as u16, ids)
    }

    fn sync(
        instruction: Instruction,
        answers: Answers,
        address: u16,
        len: u16,
        ids: &[u8],
    ) -> Result<Self, TooLong> {
        let builder = Builder::new(BROADCAST, instruction)
            .params(&address.to_le_bytes())
            .params(&len.to_le_bytes())
            .params(ids);
        Self::build(builder, answers, ids, len)
    }

    fn build(
        builder: Builder,
        answers: Answers,
        ids: &[u8],
        data_len: u16,
    ) -> Result<Self, TooLong> {
        let ids = Vec::from_slice(ids).map_err(|_| TooLong)?;
        Self::of_packet(
            builder.finish()?,
            Framing::Dynamixel2,
            answers,
            ids,
            data_len,
        )
    }

    /// A request from its packet and what it expects back.
    pub(super) fn of_packet(
        bytes: PacketBuf,
        framing: Framing,
        answers: Answers,
        ids: Vec<u8, MAX_DRIVERS>,
        data_len: u16,
    ) -> Result<Self, TooLong> {
        let request = Self {
            bytes,
            framing,
            answers,
            ids,
            data_len,
        };
        if request.longest_answer() > longest(framing) {
            Err(TooLong)
        } else {
            Ok(request)
        }
    }

    /// The bytes to send.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Drivers that must answer, in order. Empty for a broadcast ping.
    #[must_use]
    pub fn ids(&self) -> &[u8] {
        &self.ids
    }

    /// Whether anybody answers.
    #[must_use]
    pub fn is_answered(&self) -> bool {
        self.answers != Answers::None
    }

    /// Bytes of all answers without stuffing and echo: how long the bus is busy after the request.
    #[must_use]
    pub fn answer_bytes(&self) -> usize {
        let data = usize::from(self.data_len);
        match self.answers {
            Answers::None => 0,
            Answers::Each => self
                .ids
                .len()
                .saturating_mul(data.saturating_add(overhead(self.framing))),
            Answers::Together => self
                .ids
                .len()
                .saturating_mul(data.saturating_add(4))
                .saturating_add(8),
            Answers::Anyone => 14,
        }
    }

    /// How long to listen after the last byte was sent before giving up, ns: every answer at `byte_ns` a byte, and every driver silent that could make
    /// those after it wait.
    #[must_use]
    pub fn patience_ns(&self, byte_ns: u64) -> u64 {
        let answers = (self.answer_bytes() as u64).saturating_mul(byte_ns);
        let drivers = match self.answers {
            Answers::None => return 0,
            Answers::Each | Answers::Together => self.ids.len() as u64,
            // A broadcast ping is answered in slots of 1.1 answers by id, 0..=252.
            Answers::Anyone => return answers.saturating_mul(279),
        };
        answers.saturating_add(drivers.saturating_mul(SKIP_NS))
    }

    /// Longest single packet that may come back, stuffing and echo included.
    fn longest_answer(&self) -> usize {
        let data = usize::from(self.data_len);
        // Stuffing adds a byte per three.
        let answer = match self.answers {
            Answers::None => 0,
            Answers::Each if self.framing == Framing::Feetech => {
                data.saturating_add(overhead(self.framing))
            }
            Answers::Each | Answers::Anyone => data.saturating_add(data / 3).saturating_add(12),
            Answers::Together => self.answer_bytes(),
        };
        answer.max(self.bytes.len())
    }
}

/// Bytes of an answer beside its data.
fn overhead(framing: Framing) -> usize {
    match framing {
        Framing::Dynamixel2 => 11,
        Framing::Feetech => 6,
    }
}

/// Longest packet that the parser of a framing takes.
fn longest(framing: Framing) -> usize {
    match framing {
        Framing::Dynamixel2 => MAX_PACKET,
        Framing::Feetech => feetech::MAX_PACKET,
    }
}
