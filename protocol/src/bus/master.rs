//! Module side of the bus: requests, and the parser of their answers.
//!
//! The parser takes whatever comes back: the own echo (whole, cut or absent), stray bytes, answers of others, answers twice. Each expected answer is
//! handed out once. Protocol 2.0 has no sequence number, so a late answer to an earlier request of the same kind cannot be told from ours by its frame:
//! the tick inside [`PackedFeedback`] tells.

use heapless::Vec;

use super::feedback::{PACKED_LEN, PackedFeedback};
use super::feetech;
use super::packet::{
    ALERT, BROADCAST, Builder, Instruction, MAX_PACKET, PacketBuf, Parser, ParserCounters,
    StatusError, TooLong,
};
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

/// One answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Answer<'a> {
    /// Who.
    pub id: u8,
    /// Error of the instruction.
    pub error: Option<StatusError>,
    /// The driver has a hardware error: read register 70.
    pub alert: bool,
    /// Data; of the asked length unless `error` is set.
    pub data: &'a [u8],
}

impl Answer<'_> {
    /// The packed block, when that was asked for and the answer holds one.
    #[must_use]
    pub fn feedback(&self) -> Option<PackedFeedback> {
        PackedFeedback::from_bytes(
            self.data
                .first_chunk::<PACKED_LEN>()
                .filter(|_| self.data.len() == PACKED_LEN)?,
        )
    }

    /// The value of a register, when that was read.
    #[must_use]
    pub fn value(&self, register: Register) -> Option<i32> {
        (self.data.len() == usize::from(register.size())).then(|| register.value_of(self.data))
    }
}

/// What came back besides the answers. Counts saturate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ExchangeCounters {
    /// The own request came back unchanged.
    pub echoes: u32,
    /// Another instruction packet: a damaged echo with a good checksum, or a second master.
    pub foreign: u32,
    /// Status packets of drivers that were not asked.
    pub wrong_id: u32,
    /// Second answers.
    pub duplicates: u32,
    /// Status packets whose data is not of the asked length.
    pub wrong_length: u32,
}

/// Finds packets of one framing.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant, reason = "no heap to box into")]
enum Frames {
    Dynamixel(Parser),
    Feetech(feetech::Parser),
}

/// Collects the answers to one request.
#[derive(Debug, Clone)]
pub struct Exchange {
    frames: Frames,
    request: Request,
    /// Bit k: `ids[k]` has answered.
    seen: u16,
    /// Answer in hand: its data.
    data: PacketBuf,
    /// Rest of a common answer: error, id, data, crc of each driver.
    together: PacketBuf,
    counters: ExchangeCounters,
}

struct Found {
    id: u8,
    error: u8,
}

/// A packet that came back.
enum Heard {
    /// The own request.
    Echo,
    /// Another request.
    Foreign,
    /// An answer, its data in hand.
    Answer { id: u8, error: u8 },
    /// A common answer, its parts in hand as they were received.
    Together,
}

impl Exchange {
    /// Asks nobody anything.
    #[must_use]
    pub const fn idle() -> Self {
        Self {
            frames: Frames::Dynamixel(Parser::new()),
            request: Request::nothing(),
            seen: 0,
            data: PacketBuf::new(),
            together: PacketBuf::new(),
            counters: ExchangeCounters {
                echoes: 0,
                foreign: 0,
                wrong_id: 0,
                duplicates: 0,
                wrong_length: 0,
            },
        }
    }

    /// Begins to listen.
    #[must_use]
    pub fn new(request: Request) -> Self {
        let mut exchange = Self::idle();
        exchange.begin(request);
        exchange
    }

    /// Begins to listen for the answers to another request; nothing is left of the one before.
    pub fn begin(&mut self, request: Request) {
        match (request.framing, &mut self.frames) {
            (Framing::Dynamixel2, Frames::Dynamixel(parser)) => {
                parser.renew(request.longest_answer());
            }
            (Framing::Dynamixel2, frames) => {
                let mut parser = Parser::new();
                parser.set_longest(request.longest_answer());
                *frames = Frames::Dynamixel(parser);
            }
            (Framing::Feetech, frames) => *frames = Frames::Feetech(feetech::Parser::new()),
        }
        self.request = request;
        self.seen = 0;
        self.data.clear();
        self.together.clear();
        self.counters = ExchangeCounters::default();
    }

    /// The request.
    #[must_use]
    pub fn request(&self) -> &Request {
        &self.request
    }

    /// Takes one byte. Then call [`Exchange::next_answer`] until it returns `None`.
    pub fn push(&mut self, byte: u8) {
        match &mut self.frames {
            Frames::Dynamixel(parser) => parser.push(byte),
            Frames::Feetech(parser) => parser.push(byte),
        }
    }

    /// The time is over: searches what is left for packets behind a damaged one. Then call [`Exchange::next_answer`] until it returns `None`.
    pub fn finish(&mut self) {
        match &mut self.frames {
            Frames::Dynamixel(parser) => parser.end(),
            Frames::Feetech(parser) => parser.end(),
        }
    }

    /// The next answer, if there is one.
    pub fn next_answer(&mut self) -> Option<Answer<'_>> {
        let found = self.find()?;
        Some(Answer {
            id: found.id,
            error: StatusError::from_byte(found.error),
            alert: found.error & ALERT != 0,
            data: &self.data,
        })
    }

    /// Whether every asked driver has answered. Never for a broadcast ping, at once for a request without answers.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        match self.request.answers {
            Answers::None => true,
            Answers::Anyone => false,
            Answers::Each | Answers::Together => self.missing().next().is_none(),
        }
    }

    /// Drivers that have not answered.
    pub fn missing(&self) -> impl Iterator<Item = u8> + '_ {
        self.request
            .ids
            .iter()
            .enumerate()
            .filter(|(index, _)| self.seen & (1 << index) == 0)
            .map(|(_, id)| *id)
    }

    /// What else came.
    #[must_use]
    pub fn counters(&self) -> &ExchangeCounters {
        &self.counters
    }

    /// What the parser threw away.
    #[must_use]
    pub fn parser_counters(&self) -> &ParserCounters {
        match &self.frames {
            Frames::Dynamixel(parser) => parser.counters(),
            Frames::Feetech(parser) => parser.counters(),
        }
    }

    fn find(&mut self) -> Option<Found> {
        // Every pass takes a packet of at least 10 bytes or a part of a common answer.
        for _ in 0..MAX_PACKET {
            if !self.together.is_empty() {
                if let Some(found) = self.next_part() {
                    return Some(found);
                }
                continue;
            }
            let (id, error) = match self.next_status()? {
                Heard::Answer { id, error } => (id, error),
                Heard::Together => continue,
                Heard::Echo => {
                    self.counters.echoes = self.counters.echoes.saturating_add(1);
                    continue;
                }
                Heard::Foreign => {
                    self.counters.foreign = self.counters.foreign.saturating_add(1);
                    continue;
                }
            };
            if self.accept(id, error) {
                return Some(Found { id, error });
            }
        }
        None
    }

    /// The next packet; the data of an answer is in hand after it.
    fn next_status(&mut self) -> Option<Heard> {
        match &mut self.frames {
            Frames::Dynamixel(parser) => {
                let packet = parser.next_packet()?;
                let Some((error, data)) = packet.status() else {
                    return Some(if packet.bytes == self.request.bytes.as_slice() {
                        Heard::Echo
                    } else {
                        Heard::Foreign
                    });
                };
                if self.request.answers == Answers::Together && packet.id == BROADCAST {
                    self.together.clear();
                    let _ = self.together.extend_from_slice(packet.raw_params);
                    return Some(Heard::Together);
                }
                self.data.clear();
                let _ = self.data.extend_from_slice(data);
                Some(Heard::Answer {
                    id: packet.id,
                    error,
                })
            }
            Frames::Feetech(parser) => {
                let packet = parser.next_packet()?;
                // An answer has the form of a request: only the bytes tell the echo.
                if packet.bytes == self.request.bytes.as_slice() {
                    return Some(Heard::Echo);
                }
                self.data.clear();
                let _ = self.data.extend_from_slice(packet.params);
                // Its bits are states of the hardware; the data is good beside them.
                let error = if packet.code == 0 { 0 } else { ALERT };
                Some(Heard::Answer {
                    id: packet.id,
                    error,
                })
            }
        }
    }

    /// Takes the next driver's part off a common answer: error, id, data, crc (the last one without crc).
    fn next_part(&mut self) -> Option<Found> {
        let len = usize::from(self.request.data_len);
        let part = self.together.get(..len.saturating_add(2));
        let Some((&[error, id], data)) = part.and_then(|part| part.split_first_chunk::<2>()) else {
            self.together.clear();
            self.counters.wrong_length = self.counters.wrong_length.saturating_add(1);
            return None;
        };
        self.data.clear();
        let _ = self.data.extend_from_slice(data);
        let rest = PacketBuf::from_slice(self.together.get(len.saturating_add(4)..).unwrap_or(&[]));
        self.together = rest.unwrap_or_default();
        self.accept(id, error).then_some(Found { id, error })
    }

    fn accept(&mut self, id: u8, error: u8) -> bool {
        let complete = self.data.len() == usize::from(self.request.data_len);
        if !complete && StatusError::from_byte(error).is_none() {
            self.counters.wrong_length = self.counters.wrong_length.saturating_add(1);
            return false;
        }
        if self.request.answers == Answers::Anyone {
            return true;
        }
        let Some(index) = self.request.ids.iter().position(|asked| *asked == id) else {
            self.counters.wrong_id = self.counters.wrong_id.saturating_add(1);
            return false;
        };
        if self.seen & (1 << index) != 0 {
            self.counters.duplicates = self.counters.duplicates.saturating_add(1);
            return false;
        }
        self.seen |= 1 << index;
        true
    }
}
