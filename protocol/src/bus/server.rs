//! Driver side of the bus: packets in, register accesses on a [`DriverHandler`], packets out with the time they may be sent.
//!
//! The server hears everything on the bus, also the answers of other drivers: in a Sync Read each driver answers after the one before it in the list.
//! Times are nanoseconds of the caller's clock.

mod handler;

pub use handler::{DriverHandler, Keep};

use heapless::Vec;

use super::access::{check, read, write};
use super::group::{Group, bulk_write, sync_write};
use super::packet::{
    ALERT, BROADCAST, Builder, Instruction, Packet, PacketBuf, Parser, ParserCounters, StatusError,
};
use super::table::{RETURN_DELAY_NS, Register};
use crate::crc::crc16;

/// Drivers in one Sync Read that are waited for.
const MAX_AHEAD: usize = 32;
/// Longest pause inside a packet. A USB converter may pause for its 1 ms frame; the 20 Hz cycle pauses for 40 ms.
const MAX_GAP_NS: u64 = 10_000_000;
/// How long a silent driver ahead in a Sync Read is waited for. Longer than the longest return delay (508 us).
pub const SKIP_NS: u64 = 600_000;
/// Bytes of an answer to a ping, for the order of answers to a broadcast ping.
const PING_ANSWER: u64 = 14;
/// Longest write that a Reg Write keeps for its Action: more than the largest block of writable registers.
const MAX_REGISTERED: usize = 64;
/// Parameters of Clear that mean the turns of the position (Robotis e-manual, Protocol 2.0, Clear).
const CLEAR_TURNS: [u8; 5] = [0x01, 0x44, 0x58, 0x4C, 0x22];

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
    /// A Reg Write that waits for its Action: address and bytes.
    registered: Option<(u16, Vec<u8, MAX_REGISTERED>)>,
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
            registered: None,
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
        if !self.parser.is_due() {
            self.wait_on(now_ns);
            return None;
        }
        let reply = self.hear_packets(now_ns, handler);
        self.wait_on(now_ns);
        reply
    }

    /// How many bytes, heard from `now_ns` on without a pause, certainly bring no answer.
    #[must_use]
    pub fn quiet_bytes(&self, now_ns: u64) -> usize {
        let paused = now_ns.saturating_sub(self.last_byte_ns) > MAX_GAP_NS;
        if paused || matches!(self.turn, Some(Turn::Fast { .. })) {
            return 0;
        }
        self.parser.quiet_bytes()
    }

    /// Takes at once as many as [`DriverServer::quiet_bytes`] says, or fewer. The last is whole at `now_ns`.
    pub fn push_quiet(&mut self, bytes: &[u8], now_ns: u64) {
        self.last_byte_ns = now_ns;
        self.parser.extend(bytes);
        self.wait_on(now_ns);
    }

    /// The bus is not silent: drivers ahead in a Sync Read are waited for anew.
    fn wait_on(&mut self, now_ns: u64) {
        if let Some(Turn::Sync {
            ahead, deadline_ns, ..
        }) = &mut self.turn
        {
            *deadline_ns = now_ns.saturating_add(SKIP_NS.saturating_mul(ahead.len() as u64));
        }
    }

    fn hear_packets<H: DriverHandler>(&mut self, now_ns: u64, handler: &mut H) -> Option<Reply> {
        let mut reply = None;
        // Each packet has at least 10 bytes, so a full buffer holds at most 32.
        for _ in 0..32 {
            let Some(packet) = self.parser.next_packet() else {
                break;
            };
            let answer_of = (packet.instruction == Instruction::Status as u8).then_some(packet.id);
            let next = match answer_of {
                Some(id) => self.hear_answer(id, now_ns, handler),
                None => {
                    let request = Request::of(&packet);
                    let fresh = self.parser.is_empty();
                    self.hear(&request, fresh, now_ns, handler)
                }
            };
            if next.is_some() {
                reply = next;
            }
        }
        reply
    }

    /// One whole packet. `fresh`: it ended with the last byte, so an answer comes in time.
    fn hear<H: DriverHandler>(
        &mut self,
        request: &Request,
        fresh: bool,
        now_ns: u64,
        handler: &mut H,
    ) -> Option<Reply> {
        self.turn = None;
        let own = handler.read(Register::Id) as u8;
        if request.id != own && request.id != BROADCAST {
            return None;
        }
        if request.is_for_several() {
            if request.id == BROADCAST {
                return self.several(request, own, fresh, now_ns, handler);
            }
            return None;
        }
        let send_at_ns = now_ns.saturating_add(return_delay_ns(handler));
        handler.latch(now_ns);
        let answer = self.carry_out(request, own, handler)?;
        let wait = if request.id == BROADCAST {
            u64::from(own).saturating_mul(self.ping_slot_ns())
        } else {
            0
        };
        fresh.then_some(Reply {
            bytes: answer,
            send_at_ns: send_at_ns.saturating_add(wait),
        })
    }

    /// Instructions that name several drivers, each perhaps with registers of its own.
    fn several<H: DriverHandler>(
        &mut self,
        request: &Request,
        own: u8,
        fresh: bool,
        now_ns: u64,
        handler: &mut H,
    ) -> Option<Reply> {
        let params = request.params.as_slice();
        match request.instruction {
            Some(Instruction::SyncWrite) => sync_write(params, own, now_ns, handler),
            Some(Instruction::BulkWrite) => bulk_write(params, own, now_ns, handler),
            Some(Instruction::SyncRead) if fresh => {
                return self.group_read(&Group::sync(params)?, own, now_ns, handler);
            }
            Some(Instruction::BulkRead) if fresh => {
                return self.group_read(&Group::bulk(params), own, now_ns, handler);
            }
            Some(Instruction::FastSyncRead) if fresh => {
                return self.fast_read(&Group::sync(params)?, own, now_ns, handler);
            }
            Some(Instruction::FastBulkRead) if fresh => {
                return self.fast_read(&Group::bulk(params), own, now_ns, handler);
            }
            _ => {}
        }
        None
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

    fn group_read<H: DriverHandler>(
        &mut self,
        group: &Group<'_>,
        own: u8,
        now_ns: u64,
        handler: &mut H,
    ) -> Option<Reply> {
        let place = group.place(own)?;
        let (_, address, len) = group.get(place)?;
        handler.latch(now_ns);
        if handler.read(Register::StatusReturnLevel) < 1 {
            return None;
        }
        let mut data = PacketBuf::new();
        let result = read(address, len, self.registered.is_some(), handler, &mut data);
        let bytes = status(own, result, &data, handler)?;
        let mut ahead = Vec::new();
        for other in 0..place {
            ahead.push(group.get(other)?.0).ok()?;
        }
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

    fn fast_read<H: DriverHandler>(
        &mut self,
        group: &Group<'_>,
        own: u8,
        now_ns: u64,
        handler: &mut H,
    ) -> Option<Reply> {
        let place = group.place(own)?;
        let (_, address, len) = group.get(place)?;
        handler.latch(now_ns);
        if handler.read(Register::StatusReturnLevel) < 1 {
            return None;
        }
        let mut data = PacketBuf::new();
        let result = read(address, len, self.registered.is_some(), handler, &mut data);
        // Error, id, data and checksum of each.
        let blocks = |count: usize| {
            (0..count).try_fold(0_usize, |sum, k| {
                sum.checked_add(usize::from(group.get(k)?.2))?
                    .checked_add(4)
            })
        };
        let mut part = PacketBuf::new();
        if place == 0 {
            let length = blocks(group.count())?.checked_add(1)?;
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
            blocks(place)?.checked_add(8)?
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

impl Request {
    /// Whether it names several drivers in its parameters.
    fn is_for_several(&self) -> bool {
        matches!(
            self.instruction,
            Some(
                Instruction::SyncRead
                    | Instruction::FastSyncRead
                    | Instruction::SyncWrite
                    | Instruction::BulkRead
                    | Instruction::FastBulkRead
                    | Instruction::BulkWrite
            )
        )
    }
}

impl DriverServer {
    /// Instructions for one driver or all. `None`: no answer.
    fn carry_out<H: DriverHandler>(
        &mut self,
        request: &Request,
        own: u8,
        handler: &mut H,
    ) -> Option<PacketBuf> {
        let level = handler.read(Register::StatusReturnLevel);
        let broadcast = request.id == BROADCAST;
        let params = request.params.as_slice();
        let mut data = PacketBuf::new();
        let (result, needed_level) = match request.instruction {
            Some(Instruction::Ping) => {
                let [low, high] = (handler.read(Register::ModelNumber) as u16).to_le_bytes();
                let version = handler.read(Register::FirmwareVersion) as u8;
                data.extend_from_slice(&[low, high, version]).ok()?;
                return status(own, Ok(()), &data, handler);
            }
            Some(Instruction::Read) => match params {
                &[a0, a1, l0, l1] => {
                    let (address, len) =
                        (u16::from_le_bytes([a0, a1]), u16::from_le_bytes([l0, l1]));
                    let registered = self.registered.is_some();
                    (read(address, len, registered, handler, &mut data), 1)
                }
                _ => (Err(StatusError::DataLength), 1),
            },
            Some(Instruction::Write) => match params.split_first_chunk::<2>() {
                Some((address, bytes)) => (write(u16::from_le_bytes(*address), bytes, handler), 2),
                None => (Err(StatusError::DataLength), 2),
            },
            Some(Instruction::RegWrite) => (self.register(params, handler), 2),
            Some(Instruction::Action) => match self.registered.take() {
                Some((address, bytes)) => (write(address, &bytes, handler), 2),
                None => (Err(StatusError::Instruction), 2),
            },
            Some(Instruction::Clear) if params == CLEAR_TURNS => (handler.clear_turns(), 2),
            Some(Instruction::Clear) => (Err(StatusError::DataRange), 2),
            Some(Instruction::Reboot) => {
                // The answer is built with what the driver knew before.
                let answer = status(own, Ok(()), &[], handler);
                self.registered = None;
                handler.reboot();
                return answer.filter(|_| level >= 2 && !broadcast);
            }
            Some(Instruction::FactoryReset) => {
                let before = status(own, Ok(()), &[], handler);
                let keep = Keep::from_params(params, broadcast).ok_or(StatusError::DataRange);
                match keep.and_then(|keep| handler.factory_reset(keep)) {
                    Ok(()) => {
                        self.registered = None;
                        return before.filter(|_| level >= 2 && !broadcast);
                    }
                    Err(error) => (Err(error), 2),
                }
            }
            _ => (Err(StatusError::Instruction), 2),
        };
        if broadcast || level < needed_level {
            return None;
        }
        status(own, result, &data, handler)
    }

    /// Keeps a write for the Action that follows. A refused one leaves the one before.
    fn register<H: DriverHandler>(
        &mut self,
        params: &[u8],
        handler: &H,
    ) -> Result<(), StatusError> {
        let (address, bytes) = params
            .split_first_chunk::<2>()
            .ok_or(StatusError::DataLength)?;
        let address = u16::from_le_bytes(*address);
        check(address, bytes, handler)?;
        let bytes = Vec::from_slice(bytes).map_err(|_| StatusError::DataLength)?;
        self.registered = Some((address, bytes));
        Ok(())
    }
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
