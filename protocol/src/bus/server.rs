//! Driver side of the bus: packets in, register accesses on a [`DriverHandler`], packets out with the time they may be sent.
//!
//! The server hears everything on the bus, also the answers of other drivers: in a Sync Read each driver answers after the one before it in the list.
//! Times are nanoseconds of the caller's clock.

use heapless::Vec;

use super::feedback::{PACKED_LEN, PackedFeedback};
use super::packet::{
    ALERT, BROADCAST, Builder, Instruction, Packet, PacketBuf, Parser, ParserCounters, StatusError,
};
use super::table::{
    Access, OWN_END, OWN_START, PACKED_FEEDBACK, RETURN_DELAY_NS, Register, TABLE, X_END,
};
use crate::crc::crc16;

/// Drivers in one Sync Read that are waited for.
const MAX_AHEAD: usize = 32;
/// Longest pause inside a packet. A USB converter may pause for its 1 ms frame; the 20 Hz cycle pauses for 40 ms.
const MAX_GAP_NS: u64 = 10_000_000;
/// How long a silent driver ahead in a Sync Read is waited for. Longer than the longest return delay (508 us).
pub const SKIP_NS: u64 = 600_000;
/// Bytes of an answer to a ping, for the order of answers to a broadcast ping.
const PING_ANSWER: u64 = 14;

/// What a driver does.
pub trait DriverHandler {
    /// An instruction for this driver has arrived whole at `now_ns`, it feeds the bus watchdog. What is read next was measured now.
    fn latch(&mut self, now_ns: u64);
    /// Value of a register; unsigned ones with their bits in place.
    fn read(&self, register: Register) -> i32;
    /// The packed block, as latched.
    fn feedback(&mut self) -> PackedFeedback;
    /// Sets a register. Address, access and range of the table are checked already; the driver checks what depends on its state and limits.
    ///
    /// # Errors
    /// A status error: nothing was changed.
    fn write(&mut self, register: Register, value: i32) -> Result<(), StatusError>;
    /// Restart: RAM registers to defaults, torque off, zero lost.
    fn reboot(&mut self);
}

/// An answer to be sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// The bytes.
    pub bytes: PacketBuf,
    /// When the first start bit may leave.
    pub send_at_ns: u64,
}

/// Waiting for the drivers ahead in a Sync Read.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant, reason = "no heap to box into")]
enum Turn {
    Sync {
        ahead: Vec<u8, MAX_AHEAD>,
        bytes: PacketBuf,
        deadline_ns: u64,
    },
    /// Fast Sync Read: bytes still to be heard, the bytes so far, own part without checksum.
    Fast {
        left: usize,
        heard: PacketBuf,
        part: PacketBuf,
        deadline_ns: u64,
    },
}

/// One driver's end of the bus.
#[derive(Debug, Clone)]
pub struct DriverServer {
    parser: Parser,
    turn: Option<Turn>,
    last_byte_ns: u64,
    byte_ns: u64,
}

impl DriverServer {
    /// `byte_ns`: time of one byte on the wire, 10_000 at 1 Mbaud.
    #[must_use]
    pub const fn new(byte_ns: u64) -> Self {
        Self {
            parser: Parser::new(),
            turn: None,
            last_byte_ns: 0,
            byte_ns,
        }
    }

    /// What was received and discarded so far.
    #[must_use]
    pub fn counters(&self) -> &ParserCounters {
        self.parser.counters()
    }

    /// When [`DriverServer::poll`] wants to be called, if no byte comes before.
    #[must_use]
    pub fn deadline_ns(&self) -> Option<u64> {
        match self.turn {
            Some(Turn::Sync { deadline_ns, .. } | Turn::Fast { deadline_ns, .. }) => {
                Some(deadline_ns)
            }
            None => None,
        }
    }

    /// Drivers ahead stayed silent until now: answers in a Sync Read, gives up in a Fast Sync Read.
    pub fn poll(&mut self, now_ns: u64) -> Option<Reply> {
        if self.deadline_ns()? > now_ns {
            return None;
        }
        match self.turn.take()? {
            Turn::Sync { bytes, .. } => Some(Reply {
                bytes,
                send_at_ns: now_ns,
            }),
            Turn::Fast { .. } => None,
        }
    }

    /// Takes one byte heard on the bus, whole at `now_ns`. Own bytes may be left out or come back as echo.
    pub fn push<H: DriverHandler>(
        &mut self,
        byte: u8,
        now_ns: u64,
        handler: &mut H,
    ) -> Option<Reply> {
        if now_ns.saturating_sub(self.last_byte_ns) > MAX_GAP_NS {
            self.parser.clear();
        }
        self.last_byte_ns = now_ns;
        // A common answer that stopped: this byte belongs to something new.
        if matches!(self.turn, Some(Turn::Fast { deadline_ns, .. }) if deadline_ns < now_ns) {
            self.turn = None;
        }
        if let Some(Turn::Fast { .. }) = self.turn {
            return self.hear_fast(byte, now_ns, handler);
        }
        self.parser.push(byte);
        let mut reply = None;
        // Each packet has at least 10 bytes, so a full buffer holds at most 32.
        for _ in 0..32 {
            let Some(packet) = self.parser.next_packet() else {
                break;
            };
            let request = Request::of(&packet);
            let fresh = self.parser.is_empty();
            reply = self.hear(request, fresh, now_ns, handler).or(reply);
        }
        if let Some(Turn::Sync {
            ahead, deadline_ns, ..
        }) = &mut self.turn
        {
            *deadline_ns = now_ns.saturating_add(SKIP_NS.saturating_mul(ahead.len() as u64));
        }
        reply
    }

    /// One whole packet. `fresh`: it ended with the last byte, so an answer comes in time.
    fn hear<H: DriverHandler>(
        &mut self,
        request: Request,
        fresh: bool,
        now_ns: u64,
        handler: &mut H,
    ) -> Option<Reply> {
        if request.instruction == Some(Instruction::Status) {
            return self.hear_answer(request.id, now_ns, handler);
        }
        self.turn = None;
        let own = handler.read(Register::Id) as u8;
        let sync = matches!(
            request.instruction,
            Some(Instruction::SyncRead | Instruction::FastSyncRead | Instruction::SyncWrite)
        );
        if request.id != own && request.id != BROADCAST {
            return None;
        }
        let send_at_ns = now_ns.saturating_add(return_delay_ns(handler));
        if !sync {
            handler.latch(now_ns);
            let answer = carry_out(&request, own, handler)?;
            let wait = if request.id == BROADCAST {
                u64::from(own).saturating_mul(self.ping_slot_ns())
            } else {
                0
            };
            return fresh.then_some(Reply {
                bytes: answer,
                send_at_ns: send_at_ns.saturating_add(wait),
            });
        }
        if request.id != BROADCAST {
            return None;
        }
        match request.instruction {
            Some(Instruction::SyncWrite) => {
                sync_write(&request.params, own, now_ns, handler);
                None
            }
            Some(Instruction::SyncRead) if fresh => {
                self.sync_read(&request.params, own, now_ns, handler)
            }
            Some(Instruction::FastSyncRead) if fresh => {
                self.fast_sync_read(&request.params, own, now_ns, handler)
            }
            _ => None,
        }
    }

    fn ping_slot_ns(&self) -> u64 {
        // One answer and a tenth, so that neighbours never touch.
        self.byte_ns.saturating_mul(PING_ANSWER).saturating_mul(11) / 10
    }

    fn hear_answer<H: DriverHandler>(&mut self, id: u8, now_ns: u64, handler: &H) -> Option<Reply> {
        let Some(Turn::Sync { ahead, .. }) = &mut self.turn else {
            return None;
        };
        let heard = ahead.iter().position(|other| *other == id)?;
        let later: Vec<u8, MAX_AHEAD> =
            Vec::from_slice(ahead.get(heard.saturating_add(1)..)?).ok()?;
        *ahead = later;
        if !ahead.is_empty() {
            return None;
        }
        match self.turn.take()? {
            Turn::Sync { bytes, .. } => Some(Reply {
                bytes,
                send_at_ns: now_ns.saturating_add(return_delay_ns(handler)),
            }),
            Turn::Fast { .. } => None,
        }
    }

    fn sync_read<H: DriverHandler>(
        &mut self,
        params: &[u8],
        own: u8,
        now_ns: u64,
        handler: &mut H,
    ) -> Option<Reply> {
        let (address, len, ids) = sync_params(params)?;
        let place = ids.iter().position(|id| *id == own)?;
        handler.latch(now_ns);
        if handler.read(Register::StatusReturnLevel) < 1 {
            return None;
        }
        let mut data = PacketBuf::new();
        let result = read(address, len, handler, &mut data);
        let bytes = status(own, result, &data, handler)?;
        let ahead = Vec::from_slice(ids.get(..place)?).ok()?;
        if ahead.is_empty() {
            return Some(Reply {
                bytes,
                send_at_ns: now_ns.saturating_add(return_delay_ns(handler)),
            });
        }
        self.turn = Some(Turn::Sync {
            ahead,
            bytes,
            deadline_ns: u64::MAX,
        });
        None
    }

    fn fast_sync_read<H: DriverHandler>(
        &mut self,
        params: &[u8],
        own: u8,
        now_ns: u64,
        handler: &mut H,
    ) -> Option<Reply> {
        let (address, len, ids) = sync_params(params)?;
        let place = ids.iter().position(|id| *id == own)?;
        handler.latch(now_ns);
        if handler.read(Register::StatusReturnLevel) < 1 {
            return None;
        }
        let mut data = PacketBuf::new();
        let result = read(address, len, handler, &mut data);
        let block = usize::from(len).checked_add(4)?;
        let mut part = PacketBuf::new();
        if place == 0 {
            let length = block.checked_mul(ids.len())?.checked_add(1)?;
            part = Builder::new(BROADCAST, Instruction::Status)
                .open_ended(u16::try_from(length).ok()?)
                .ok()?;
        }
        part.push(error_byte(result, handler)).ok()?;
        part.push(own).ok()?;
        // A refused read still fills its place, or the length of the whole answer would be wrong.
        data.resize(usize::from(len), 0).ok()?;
        part.extend_from_slice(&data).ok()?;
        let left = if place == 0 {
            0
        } else {
            block.checked_mul(place)?.checked_add(8)?
        };
        let deadline_ns = now_ns.saturating_add(SKIP_NS);
        self.turn = Some(Turn::Fast {
            left,
            heard: PacketBuf::new(),
            part,
            deadline_ns,
        });
        self.fast_answer(now_ns, handler)
    }

    fn hear_fast<H: DriverHandler>(&mut self, byte: u8, now_ns: u64, handler: &H) -> Option<Reply> {
        if let Some(Turn::Fast {
            left,
            heard,
            deadline_ns,
            ..
        }) = &mut self.turn
        {
            *left = left.saturating_sub(1);
            *deadline_ns = now_ns.saturating_add(SKIP_NS);
            if heard.push(byte).is_err() {
                self.turn = None;
            }
        }
        self.fast_answer(now_ns, handler)
    }

    /// Own part of the common answer, when everything ahead was heard. The checksum runs over everything from the header on.
    fn fast_answer<H: DriverHandler>(&mut self, now_ns: u64, handler: &H) -> Option<Reply> {
        let Some(Turn::Fast {
            left: 0,
            heard,
            part,
            ..
        }) = &mut self.turn
        else {
            return None;
        };
        let begun = heard.len();
        heard.extend_from_slice(part).ok()?;
        let crc = crc16(heard).to_le_bytes();
        heard.extend_from_slice(&crc).ok()?;
        let bytes = PacketBuf::from_slice(heard.get(begun..)?).ok()?;
        self.turn = None;
        // Only the first part waits for the return delay; the others continue its packet.
        let wait = if begun == 0 {
            return_delay_ns(handler)
        } else {
            0
        };
        Some(Reply {
            bytes,
            send_at_ns: now_ns.saturating_add(wait),
        })
    }
}

/// A packet copied out of the parser.
struct Request {
    id: u8,
    instruction: Option<Instruction>,
    params: PacketBuf,
}

impl Request {
    fn of(packet: &Packet<'_>) -> Self {
        let mut params = PacketBuf::new();
        // Parameters are shorter than the packet they came in.
        let _ = params.extend_from_slice(packet.params);
        Self {
            id: packet.id,
            instruction: Instruction::from_byte(packet.instruction),
            params,
        }
    }
}

/// Instructions for one driver or all. `None`: no answer.
fn carry_out<H: DriverHandler>(request: &Request, own: u8, handler: &mut H) -> Option<PacketBuf> {
    let level = handler.read(Register::StatusReturnLevel);
    let broadcast = request.id == BROADCAST;
    let mut data = PacketBuf::new();
    let (result, needed_level) = match request.instruction {
        Some(Instruction::Ping) => {
            let [low, high] = (handler.read(Register::ModelNumber) as u16).to_le_bytes();
            let version = handler.read(Register::FirmwareVersion) as u8;
            data.extend_from_slice(&[low, high, version]).ok()?;
            return status(own, Ok(()), &data, handler);
        }
        Some(Instruction::Read) => match request.params.as_slice() {
            &[a0, a1, l0, l1] => {
                let len = u16::from_le_bytes([l0, l1]);
                (
                    read(u16::from_le_bytes([a0, a1]), len, handler, &mut data),
                    1,
                )
            }
            _ => (Err(StatusError::DataLength), 1),
        },
        Some(Instruction::Write) => match request.params.split_first_chunk::<2>() {
            Some((address, bytes)) => (write(u16::from_le_bytes(*address), bytes, handler), 2),
            None => (Err(StatusError::DataLength), 2),
        },
        Some(Instruction::Reboot) => {
            // The answer is built with what the driver knew before.
            let answer = status(own, Ok(()), &[], handler);
            handler.reboot();
            return answer.filter(|_| level >= 2 && !broadcast);
        }
        _ => (Err(StatusError::Instruction), 2),
    };
    if broadcast || level < needed_level {
        return None;
    }
    status(own, result, &data, handler)
}

fn sync_write<H: DriverHandler>(params: &[u8], own: u8, now_ns: u64, handler: &mut H) {
    let Some((&[a0, a1, l0, l1], entries)) = params.split_first_chunk::<4>() else {
        return;
    };
    let len = usize::from(u16::from_le_bytes([l0, l1]));
    for entry in entries.chunks_exact(len.saturating_add(1)) {
        if let Some((id, bytes)) = entry.split_first()
            && *id == own
        {
            handler.latch(now_ns);
            // A Sync Write is never answered; the refusal shows in the status bits.
            let _ = write(u16::from_le_bytes([a0, a1]), bytes, handler);
        }
    }
}

fn sync_params(params: &[u8]) -> Option<(u16, u16, &[u8])> {
    let (&[a0, a1, l0, l1], ids) = params.split_first_chunk::<4>()?;
    Some((
        u16::from_le_bytes([a0, a1]),
        u16::from_le_bytes([l0, l1]),
        ids,
    ))
}

/// Bytes of any range that begins and ends in one part of the table. Addresses without register read 0.
fn read<H: DriverHandler>(
    address: u16,
    len: u16,
    handler: &mut H,
    data: &mut PacketBuf,
) -> Result<(), StatusError> {
    let end = address.checked_add(len).ok_or(StatusError::Access)?;
    let inside = end <= X_END || (address >= OWN_START && end <= OWN_END);
    if len == 0 || !inside {
        return Err(StatusError::Access);
    }
    data.resize(usize::from(len), 0)
        .map_err(|_| StatusError::DataLength)?;
    for info in TABLE {
        let bytes = handler.read(info.register).to_le_bytes();
        overlay(
            data,
            address,
            info.address,
            bytes.get(..usize::from(info.len)).unwrap_or(&[]),
        );
    }
    if address < PACKED_FEEDBACK + PACKED_LEN as u16 && end > PACKED_FEEDBACK {
        overlay(
            data,
            address,
            PACKED_FEEDBACK,
            &handler.feedback().to_bytes(),
        );
    }
    Ok(())
}

/// Copies what of `bytes` (at `at`) lies inside `data` (at `address`).
fn overlay(data: &mut [u8], address: u16, at: u16, bytes: &[u8]) {
    for (index, byte) in bytes.iter().enumerate() {
        let place = usize::from(at)
            .saturating_add(index)
            .checked_sub(usize::from(address));
        if let Some(place) = place.and_then(|place| data.get_mut(place)) {
            *place = *byte;
        }
    }
}

/// Whole registers one after the other; all are checked against the table before the first is written.
fn write<H: DriverHandler>(address: u16, bytes: &[u8], handler: &mut H) -> Result<(), StatusError> {
    let torque = handler.read(Register::TorqueEnable) != 0;
    each_register(address, bytes, |register, value| {
        let info = register.info();
        match info.access {
            Access::Read => Err(StatusError::Access),
            Access::Eeprom if torque => Err(StatusError::Access),
            _ if value < info.min || value > info.max => Err(StatusError::DataRange),
            _ => Ok(()),
        }
    })?;
    each_register(address, bytes, |register, value| {
        handler.write(register, value)
    })
}

fn each_register(
    address: u16,
    bytes: &[u8],
    mut visit: impl FnMut(Register, i32) -> Result<(), StatusError>,
) -> Result<(), StatusError> {
    if bytes.is_empty() {
        return Err(StatusError::DataLength);
    }
    let mut at = address;
    let mut rest = bytes;
    // Every pass takes at least one byte.
    while !rest.is_empty() {
        let register = Register::at(at).ok_or(StatusError::Access)?;
        let (value, after) = rest
            .split_at_checked(usize::from(register.size()))
            .ok_or(StatusError::DataLength)?;
        visit(register, register.value_of(value))?;
        at = at.saturating_add(register.size());
        rest = after;
    }
    Ok(())
}

fn error_byte<H: DriverHandler>(result: Result<(), StatusError>, handler: &H) -> u8 {
    let alert = if handler.read(Register::HardwareError) != 0 {
        ALERT
    } else {
        0
    };
    let number = match result {
        Ok(()) => 0,
        Err(error) => error as u8,
    };
    alert | number
}

fn status<H: DriverHandler>(
    own: u8,
    result: Result<(), StatusError>,
    data: &[u8],
    handler: &H,
) -> Option<PacketBuf> {
    let data = if result.is_ok() { data } else { &[] };
    Builder::new(own, Instruction::Status)
        .params(&[error_byte(result, handler)])
        .params(data)
        .finish()
        .ok()
}

fn return_delay_ns<H: DriverHandler>(handler: &H) -> u64 {
    u64::from(handler.read(Register::ReturnDelay) as u8).saturating_mul(RETURN_DELAY_NS)
}
