//! The parser of what comes back to a request.

use super::{Answers, PackedFeedback, Request};
use crate::bus::feedback::PACKED_LEN;
use crate::bus::feetech;
use crate::bus::packet::{
    ALERT, BROADCAST, MAX_PACKET, PacketBuf, Parser, ParserCounters, StatusError,
};
use crate::bus::profile::Framing;
use crate::bus::table::Register;

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

    /// Takes some bytes, as [`Exchange::push`] one by one.
    pub fn extend(&mut self, bytes: &[u8]) {
        match &mut self.frames {
            Frames::Dynamixel(parser) => parser.extend(bytes),
            Frames::Feetech(parser) => bytes.iter().for_each(|byte| parser.push(*byte)),
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
