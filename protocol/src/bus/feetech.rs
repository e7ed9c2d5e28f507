//! Packets of Feetech servos: `FF FF id length instruction parameters checksum` (Feetech, "Communication Protocol User Manual").
//!
//! The length counts what follows it. The checksum is the complement of the sum of all bytes behind the header. A status packet has the same form,
//! with its error bits in the place of the instruction. One wrong byte in 256 passes the checksum, so readings are compared with the ones before.

use heapless::Vec;

use super::packet::{BROADCAST, MAX_ID, ParserCounters, TooLong};

/// Start of every packet.
pub const HEADER: [u8; 2] = [0xFF, 0xFF];
/// Longest packet this crate sends or understands: a Sync Write of six bytes to twelve drivers is 92 bytes.
pub const MAX_PACKET: usize = 160;
/// Bytes before the instruction: header, id, length.
const PREFIX: usize = 4;

/// A packet as it goes on the wire.
pub type PacketBuf = Vec<u8, MAX_PACKET>;

/// Instruction byte (protocol manual, 1.3; `INST_*` of the Feetech SDK).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Instruction {
    /// Who is there.
    Ping = 0x01,
    /// Read registers.
    Read = 0x02,
    /// Write registers.
    Write = 0x03,
    /// Write at the next Action.
    RegWrite = 0x04,
    /// Do the registered write.
    Action = 0x05,
    /// Every register but id and baud rate back to its default.
    FactoryReset = 0x06,
    /// Restart.
    Reboot = 0x08,
    /// Read the same registers of several drivers. Not of SCS.
    SyncRead = 0x82,
    /// Write the same registers of several drivers.
    SyncWrite = 0x83,
}

impl Instruction {
    /// The instruction of a byte.
    #[must_use]
    pub fn from_byte(byte: u8) -> Option<Self> {
        [
            Self::Ping,
            Self::Read,
            Self::Write,
            Self::RegWrite,
            Self::Action,
            Self::FactoryReset,
            Self::Reboot,
            Self::SyncRead,
            Self::SyncWrite,
        ]
        .into_iter()
        .find(|instruction| *instruction as u8 == byte)
    }
}

/// Builds a packet: `code` is the instruction, or the error bits of an answer.
///
/// # Errors
/// [`TooLong`].
pub fn packet(id: u8, code: u8, parts: &[&[u8]]) -> Result<PacketBuf, TooLong> {
    let count: usize = parts.iter().map(|part| part.len()).sum();
    let length = u8::try_from(count.saturating_add(2)).map_err(|_| TooLong)?;
    let mut packet = PacketBuf::new();
    let head = [0xFF, 0xFF, id, length, code];
    packet.extend_from_slice(&head).map_err(|_| TooLong)?;
    for part in parts {
        packet.extend_from_slice(part).map_err(|_| TooLong)?;
    }
    let sum = checksum(packet.get(2..).unwrap_or(&[]));
    packet.push(sum).map_err(|_| TooLong)?;
    Ok(packet)
}

/// Complement of the sum.
#[must_use]
pub fn checksum(bytes: &[u8]) -> u8 {
    !bytes.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte))
}

/// A received packet with a good checksum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Addressee, or sender of an answer.
    pub id: u8,
    /// Instruction byte, or error bits of an answer.
    pub code: u8,
    /// Parameters or data.
    pub params: &'a [u8],
    /// The whole packet as received.
    pub bytes: &'a [u8],
}

/// Finds packets in a stream of bytes. A damaged packet costs no other: the bytes after its header are searched again.
#[derive(Debug, Clone, Default)]
pub struct Parser {
    bytes: PacketBuf,
    /// Bytes at the front that were handed out.
    done: usize,
    /// No more bytes will come: what is incomplete is damaged.
    ended: bool,
    counters: ParserCounters,
}

impl Parser {
    /// Nothing received.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// What was received and discarded so far.
    #[must_use]
    pub fn counters(&self) -> &ParserCounters {
        &self.counters
    }

    /// Forgets everything received.
    pub fn clear(&mut self) {
        self.bytes.clear();
        self.done = 0;
    }

    /// Whether no byte waits for more.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.done >= self.bytes.len()
    }

    /// Takes one byte. Then call [`Parser::next_packet`] until it returns `None`.
    pub fn push(&mut self, byte: u8) {
        if self.bytes.is_full() {
            self.compact();
        }
        // There is room: no packet of this size waits for more.
        let _ = self.bytes.push(byte);
    }

    /// No more bytes will come: [`Parser::next_packet`] takes what is incomplete for damaged, and finds whole packets behind it.
    pub fn end(&mut self) {
        self.ended = true;
    }

    /// The next whole packet, if there is one.
    pub fn next_packet(&mut self) -> Option<Packet<'_>> {
        let total = self.scan()?;
        let from = self.done;
        self.done = from.saturating_add(total);
        self.counters.packets = self.counters.packets.saturating_add(1);
        let bytes = self.bytes.get(from..self.done)?;
        let (&[_, _, id, _, code], rest) = bytes.split_first_chunk::<5>()?;
        Some(Packet {
            id,
            code,
            params: rest.get(..rest.len().checked_sub(1)?)?,
            bytes,
        })
    }

    /// Length of the packet that begins at `done`; skips what cannot be one.
    fn scan(&mut self) -> Option<usize> {
        // Every pass but the last skips a byte.
        for _ in 0..=MAX_PACKET {
            let view = self.bytes.get(self.done..)?;
            let Some((&[first, second, id, length], _)) = view.split_first_chunk::<PREFIX>() else {
                if view.is_empty() || (!self.ended && view.iter().take(2).all(|b| *b == 0xFF)) {
                    return None;
                }
                self.skip_byte();
                continue;
            };
            let total = usize::from(length).saturating_add(PREFIX);
            // FF is no id: three FF in a row begin with a stray one.
            let plausible = (id <= MAX_ID || id == BROADCAST) && length >= 2 && total <= MAX_PACKET;
            if [first, second] != HEADER || !plausible {
                let counted = u32::from([first, second] == HEADER && id != 0xFF);
                self.counters.bad_length = self.counters.bad_length.saturating_add(counted);
                self.skip_byte();
                continue;
            }
            match view.get(..total).and_then(<[u8]>::split_last) {
                Some((sum, body)) if checksum(body.get(2..).unwrap_or(&[])) == *sum => {
                    return Some(total);
                }
                Some(_) => {
                    self.counters.bad_crc = self.counters.bad_crc.saturating_add(1);
                    self.skip_byte();
                }
                None if self.ended => self.skip_byte(),
                None => return None,
            }
        }
        None
    }

    fn skip_byte(&mut self) {
        self.done = self.done.saturating_add(1);
        self.counters.stray_bytes = self.counters.stray_bytes.saturating_add(1);
    }

    /// Moves what is left to the front. A buffer full of one candidate cannot happen, but would be dropped.
    fn compact(&mut self) {
        if self.done == 0 {
            self.clear();
            return;
        }
        let rest = PacketBuf::from_slice(self.bytes.get(self.done..).unwrap_or(&[]));
        self.bytes = rest.unwrap_or_default();
        self.done = 0;
    }
}
