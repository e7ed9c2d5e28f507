//! Packets of Dynamixel Protocol 2.0: `FF FF FD 00 id length instruction parameters crc`, with byte stuffing (Robotis e-manual, "Protocol 2.0").

use heapless::Vec;

use crate::crc::crc16;

/// Start of every packet.
pub const HEADER: [u8; 4] = [0xFF, 0xFF, 0xFD, 0x00];
/// Highest id a device may have.
pub const MAX_ID: u8 = 252;
/// Id of all devices; also of Fast Sync Read answers.
pub const BROADCAST: u8 = 0xFE;
/// Longest packet this crate sends or understands: a Fast Sync Read answer of 12 drivers is 284 bytes, one register dump of 148 bytes is 159.
pub const MAX_PACKET: usize = 320;
/// Bytes before the instruction: header, id, length.
const PREFIX: usize = 7;

/// A packet as it goes on the wire.
pub type PacketBuf = Vec<u8, MAX_PACKET>;

/// The packet does not fit [`MAX_PACKET`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TooLong;

/// Instruction byte.
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
    /// Every register back to its default.
    FactoryReset = 0x06,
    /// Restart.
    Reboot = 0x08,
    /// Clear multi-turn information.
    Clear = 0x10,
    /// An answer.
    Status = 0x55,
    /// Read the same registers of several drivers.
    SyncRead = 0x82,
    /// Write the same registers of several drivers.
    SyncWrite = 0x83,
    /// Sync Read answered by one packet.
    FastSyncRead = 0x8A,
    /// Read different registers of several drivers.
    BulkRead = 0x92,
    /// Write different registers of several drivers.
    BulkWrite = 0x93,
    /// Bulk Read answered by one packet.
    FastBulkRead = 0x9A,
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
            Self::Clear,
            Self::Status,
            Self::SyncRead,
            Self::SyncWrite,
            Self::FastSyncRead,
            Self::BulkRead,
            Self::BulkWrite,
            Self::FastBulkRead,
        ]
        .into_iter()
        .find(|instruction| *instruction as u8 == byte)
    }
}

/// Error number of a status packet, bits 0..=6 of its error byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum StatusError {
    /// The instruction could not be carried out.
    Result = 1,
    /// Undefined instruction, or Action without RegWrite.
    Instruction = 2,
    /// Wrong checksum.
    Crc = 3,
    /// Value outside the register's range.
    DataRange = 4,
    /// Data shorter than the register.
    DataLength = 5,
    /// Value outside the limits set in other registers.
    DataLimit = 6,
    /// Read-only or unknown address, or the EEPROM area while torque is on.
    Access = 7,
    /// A number Protocol 2.0 does not define.
    Other = 0x7F,
}

/// Bit 7 of the error byte: look at register 70, hardware error status.
pub const ALERT: u8 = 0x80;

impl StatusError {
    /// The error of an error byte; the alert bit is not looked at.
    #[must_use]
    pub fn from_byte(byte: u8) -> Option<Self> {
        match byte & !ALERT {
            0 => None,
            1 => Some(Self::Result),
            2 => Some(Self::Instruction),
            3 => Some(Self::Crc),
            4 => Some(Self::DataRange),
            5 => Some(Self::DataLength),
            6 => Some(Self::DataLimit),
            7 => Some(Self::Access),
            _ => Some(Self::Other),
        }
    }
}

/// Builds one packet.
#[derive(Debug, Clone)]
pub struct Builder {
    packet: PacketBuf,
    /// Bytes FF FF seen at the end of the stuffed range.
    run: u8,
    fits: bool,
}

impl Builder {
    /// A packet without parameters so far.
    #[must_use]
    pub fn new(id: u8, instruction: Instruction) -> Self {
        let mut builder = Self {
            packet: Vec::new(),
            run: 0,
            fits: true,
        };
        for byte in HEADER {
            builder.raw(byte);
        }
        for byte in [id, 0, 0, instruction as u8] {
            builder.raw(byte);
        }
        builder
    }

    /// Appends parameters, stuffed.
    #[must_use]
    pub fn params(mut self, params: &[u8]) -> Self {
        for &byte in params {
            self.raw(byte);
            self.run = match (byte, self.run) {
                (0xFF, run) => run.saturating_add(1).min(2),
                (0xFD, 2) => {
                    self.raw(0xFD);
                    0
                }
                _ => 0,
            };
        }
        self
    }

    /// Fills in the length, appends the checksum.
    ///
    /// # Errors
    /// [`TooLong`].
    pub fn finish(mut self) -> Result<PacketBuf, TooLong> {
        // Length counts instruction, parameters and checksum; the prefix does not count, the checksum is still to come.
        let length = self.packet.len().saturating_sub(PREFIX).saturating_add(2) as u16;
        self.set_length(length);
        let crc = crc16(&self.packet).to_le_bytes();
        for byte in crc {
            self.raw(byte);
        }
        if self.fits {
            Ok(self.packet)
        } else {
            Err(TooLong)
        }
    }

    /// The packet so far with a length given from outside and without checksum: the first part of a Fast Sync Read answer.
    ///
    /// # Errors
    /// [`TooLong`].
    pub fn open_ended(mut self, length: u16) -> Result<PacketBuf, TooLong> {
        self.set_length(length);
        if self.fits {
            Ok(self.packet)
        } else {
            Err(TooLong)
        }
    }

    fn set_length(&mut self, length: u16) {
        let [low, high] = length.to_le_bytes();
        if let Some(place) = self.packet.get_mut(5) {
            *place = low;
        }
        if let Some(place) = self.packet.get_mut(6) {
            *place = high;
        }
    }

    fn raw(&mut self, byte: u8) {
        self.fits &= self.packet.push(byte).is_ok();
    }
}

/// A received packet with a good checksum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Addressee, or sender of a status packet.
    pub id: u8,
    /// Instruction byte; [`Instruction::from_byte`].
    pub instruction: u8,
    /// Parameters without stuffing. Of a status packet the first one is the error byte.
    pub params: &'a [u8],
    /// Parameters as received: what Fast Sync Read answers mean.
    pub raw_params: &'a [u8],
    /// The whole packet as received.
    pub bytes: &'a [u8],
}

impl<'a> Packet<'a> {
    /// Error byte and data of a status packet.
    #[must_use]
    pub fn status(&self) -> Option<(u8, &'a [u8])> {
        if self.instruction != Instruction::Status as u8 {
            return None;
        }
        let (error, data) = self.params.split_first()?;
        Some((*error, data))
    }
}

/// What a parser threw away. Counts saturate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParserCounters {
    /// Packets with a good checksum.
    pub packets: u32,
    /// Wrong checksum.
    pub bad_crc: u32,
    /// Impossible length or id.
    pub bad_length: u32,
    /// Bytes that belonged to no packet.
    pub stray_bytes: u32,
}

/// Finds packets in a stream of bytes. A damaged packet costs no other: the bytes after its header are searched again.
#[derive(Debug, Clone)]
pub struct Parser {
    bytes: [u8; MAX_PACKET],
    start: usize,
    end: usize,
    longest: usize,
    /// No more bytes will come: what is incomplete is damaged.
    ended: bool,
    /// Before this place is filled the packet that begins at `start` is not whole.
    whole_at: usize,
    params: PacketBuf,
    counters: ParserCounters,
}

impl Default for Parser {
    fn default() -> Self {
        Self::new()
    }
}

impl Parser {
    /// A parser for packets up to [`MAX_PACKET`].
    #[must_use]
    pub const fn new() -> Self {
        Self {
            bytes: [0; MAX_PACKET],
            start: 0,
            end: 0,
            longest: MAX_PACKET,
            ended: false,
            whole_at: 0,
            params: Vec::new(),
            counters: ParserCounters {
                packets: 0,
                bad_crc: 0,
                bad_length: 0,
                stray_bytes: 0,
            },
        }
    }

    /// Takes longer packets for damaged ones, so that a wrong length does not swallow the answers after it.
    pub fn set_longest(&mut self, longest: usize) {
        self.longest = longest.min(MAX_PACKET);
    }

    /// What was received and discarded so far.
    #[must_use]
    pub fn counters(&self) -> &ParserCounters {
        &self.counters
    }

    /// Forgets everything received.
    pub fn clear(&mut self) {
        self.start = 0;
        self.end = 0;
        self.whole_at = 0;
    }

    /// As new, in place: packets up to `longest`.
    pub(super) fn renew(&mut self, longest: usize) {
        self.clear();
        self.ended = false;
        self.counters = ParserCounters::default();
        self.set_longest(longest);
    }

    /// Whether no byte waits for more.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.start == self.end
    }

    /// Takes one byte. Then call [`Parser::next_packet`] until it returns `None`.
    pub fn push(&mut self, byte: u8) {
        if self.end >= MAX_PACKET {
            self.compact();
        }
        if let Some(place) = self.bytes.get_mut(self.end) {
            *place = byte;
            self.end = self.end.saturating_add(1);
        }
    }

    /// Bytes after which there is nothing to look for: with them the packet that has begun is still not whole.
    #[must_use]
    pub fn quiet_bytes(&self) -> usize {
        self.whole_at.saturating_sub(self.end).saturating_sub(1)
    }

    /// Takes some bytes. After [`Parser::quiet_bytes`] or fewer there is nothing to look for.
    pub fn extend(&mut self, bytes: &[u8]) {
        let end = self.end.saturating_add(bytes.len());
        if let Some(places) = self.bytes.get_mut(self.end..end) {
            for (place, byte) in places.iter_mut().zip(bytes) {
                *place = *byte;
            }
            self.end = end;
        } else {
            // Near the end of the buffer: `push` moves what is there.
            bytes.iter().for_each(|byte| self.push(*byte));
        }
    }

    /// Whether [`Parser::next_packet`] has anything to do: false while bytes of a packet are still to come.
    #[must_use]
    pub fn is_due(&self) -> bool {
        self.end >= self.whole_at || self.ended
    }

    /// The next whole packet, if there is one.
    pub fn next_packet(&mut self) -> Option<Packet<'_>> {
        let total = self.scan()?;
        let from = self.start;
        let to = from.saturating_add(total);
        self.start = to;
        self.counters.packets = self.counters.packets.saturating_add(1);
        let bytes = self.bytes.get(from..to)?;
        let body = bytes.get(PREFIX..)?;
        let (&instruction, rest) = body.split_first()?;
        // Without the CRC. `split_last_chunk` keeps a panic that the optimiser does not always remove.
        let raw_params = rest.get(..rest.len().checked_sub(2)?)?;
        unstuff(raw_params, &mut self.params);
        Some(Packet {
            id: bytes.get(4).copied()?,
            instruction,
            params: &self.params,
            raw_params,
            bytes,
        })
    }

    /// No more bytes will come: [`Parser::next_packet`] takes what is incomplete for damaged, and finds whole packets behind it.
    pub fn end(&mut self) {
        self.ended = true;
    }

    /// Length of the packet that begins at `start`; skips what cannot be one.
    fn scan(&mut self) -> Option<usize> {
        if !self.is_due() {
            return None;
        }
        self.whole_at = 0;
        // Every pass but the last skips at least one byte.
        for _ in 0..=MAX_PACKET {
            let view = self.bytes.get(self.start..self.end)?;
            let Some(&[id, low, high]) = view.get(4..PREFIX) else {
                let may_go_on = !self.ended && view.iter().zip(HEADER).all(|(a, b)| *a == b);
                if may_go_on || view.is_empty() {
                    self.whole_at = self.start.saturating_add(PREFIX);
                    return None;
                }
                self.skip_byte();
                continue;
            };
            let total = usize::from(u16::from_le_bytes([low, high])).saturating_add(PREFIX);
            if !view.starts_with(&HEADER) {
                self.skip_byte();
            } else if (id > MAX_ID && id != BROADCAST) || total < PREFIX + 3 || total > self.longest
            {
                self.counters.bad_length = self.counters.bad_length.saturating_add(1);
                self.skip_byte();
            } else {
                let Some((checked, crc)) = view
                    .get(..total)
                    .and_then(|whole| whole.split_last_chunk::<2>())
                else {
                    if self.ended {
                        self.skip_byte();
                        continue;
                    }
                    self.whole_at = self.start.saturating_add(total);
                    return None;
                };
                if crc16(checked) == u16::from_le_bytes(*crc) {
                    return Some(total);
                }
                self.counters.bad_crc = self.counters.bad_crc.saturating_add(1);
                self.skip_byte();
            }
        }
        None
    }

    fn skip_byte(&mut self) {
        self.start = self.start.saturating_add(1);
        self.counters.stray_bytes = self.counters.stray_bytes.saturating_add(1);
    }

    /// Moves what is left to the front. A buffer full of one candidate cannot happen (`longest`), but would be dropped.
    fn compact(&mut self) {
        if self.start == 0 {
            self.clear();
        }
        let mut to = 0;
        for from in self.start..self.end {
            let byte = self.bytes.get(from).copied().unwrap_or(0);
            if let Some(place) = self.bytes.get_mut(to) {
                *place = byte;
            }
            to += 1;
        }
        self.start = 0;
        self.end = to;
        self.whole_at = 0;
    }
}

/// Removes the FD that follows every FF FF FD.
fn unstuff(raw: &[u8], out: &mut PacketBuf) {
    out.clear();
    if !raw.contains(&0xFD) {
        let _ = out.extend_from_slice(raw);
        return;
    }
    let mut run = 0_u8;
    for &byte in raw {
        if run == 3 {
            run = 0;
            if byte == 0xFD {
                continue;
            }
        }
        run = match (byte, run) {
            (0xFF, run) => run.saturating_add(1).min(2),
            (0xFD, 2) => 3,
            _ => 0,
        };
        // The output is never longer than the input, which fits.
        let _ = out.push(byte);
    }
}
