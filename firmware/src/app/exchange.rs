//! The module as master of the motor bus: which packets a cycle sends, and what the answers mean.
//!
//! ```text
//! control cycle   read all ─▶ read again who is missing (2 x) ─▶ error register of who complains ─▶ decide ─▶
//!                 settings of new drivers ─▶ torque where it differs ─▶ set-points ─▶ a host's raw packet (not in motion)
//! reading         read all
//! ```
//!
//! Every phase is entered at most once per cycle, so the number of packets is bounded: at most 10, and with all six
//! drivers silent the three tries take 18.3 ms of the 50.

use super::core::Core;
use super::motors::Motor;
use super::timing::Slot;
use crate::ports::PortError;
use crate::tasks::BUS_BUFFER;
use control::robot::JOINTS;
use control::supervisor::Fault;
use heapless::Vec;
use protocol::bus::server::SKIP_NS;
use protocol::bus::{Exchange, PackedFeedback, Register, Request};
use protocol::link::{BusAnswer, BusStatus, Completed, Reject};

/// Tries of the cyclic read: one wrong byte in 10^4 loses both of two tries once in 10^5 cycles, all three never in a day.
const TRIES: u8 = 3;
/// Wait beyond byte times and skipped drivers, us: the return delay of a driver fresh from the shop (500 us).
const ANSWER_SLACK_US: u64 = 500;
/// Longest part of a raw listening that one cycle spends, us.
const LISTEN_SLICE_US: u64 = 30_000;
/// Bus watchdog of the drivers, 20 ms per count: 160 ms, three missed cycles.
const BUS_WATCHDOG_COUNTS: i32 = 8;
/// Times that torque-off is repeated to drivers that cannot confirm it.
pub(crate) const OFF_REPEATS: u8 = 3;

/// What the cycle task does next on the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Step {
    /// Send the first `len` bytes of the buffer (none: only listen), then listen for `reply_bytes` byte times plus `gap_us`.
    Exchange {
        /// Bytes to send.
        len: usize,
        /// Bytes that may come back.
        reply_bytes: usize,
        /// Waiting time beyond the byte times, us.
        gap_us: u64,
    },
    /// The bus is done for this instant.
    #[default]
    Done,
}

/// Where in the cycle the bus is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Read { tries: u8 },
    Errors,
    Decide,
    WatchdogOff,
    WatchdogOn,
    GoalHere,
    Torque,
    SetPoints,
    Raw,
    Done,
}

/// State of the bus master.
#[derive(Debug)]
pub struct Master {
    phase: Phase,
    slot: Slot,
    exchange: Option<Exchange>,
    /// When the drivers latched what the present exchange reads, us.
    latched_us: u64,
    request_len: u64,
    /// Drivers whose error register is to be read.
    ask_errors: u8,
    asking: Option<usize>,
    configure: u8,
    off_repeats: u8,
    garbage_cycles: u8,
    heard_anything: bool,
    listened_us: u64,
    raw_sent: bool,
}

/// Cycles with bytes on the bus but no valid answer that mean a babbling or stuck line.
const GARBAGE_CYCLES: u8 = 3;

impl Master {
    pub(crate) const fn new() -> Self {
        Self {
            phase: Phase::Done,
            slot: Slot::Control,
            exchange: None,
            latched_us: 0,
            request_len: 0,
            ask_errors: 0,
            asking: None,
            configure: 0,
            off_repeats: OFF_REPEATS,
            garbage_cycles: 0,
            heard_anything: false,
            listened_us: 0,
            raw_sent: false,
        }
    }

    /// Begins an instant of the grid.
    pub(crate) fn begin(&mut self, slot: Slot, core: &Core) {
        self.slot = slot;
        self.heard_anything = false;
        let listening = self.raw_sent && core.bus_job.is_some();
        self.phase = if listening {
            Phase::Raw
        } else {
            Phase::Read { tries: 0 }
        };
    }

    /// The next packet of this cycle.
    pub(crate) fn next(&mut self, core: &mut Core, tx: &mut [u8; BUS_BUFFER], now_us: u64) -> Step {
        self.close(core);
        // Every pass moves to a later phase; a read phase comes at most three times.
        while self.phase != Phase::Done {
            let request = self.advance(core);
            if let Some(request) = request {
                return self.send(request, tx, now_us);
            }
            if self.phase == Phase::Raw {
                return self.raw(core, tx);
            }
        }
        Step::Done
    }

    /// Builds the packet of the present phase, if it needs one, and moves on.
    fn advance(&mut self, core: &mut Core) -> Option<Request> {
        let (request, next) = match self.phase {
            Phase::Read { tries } => return self.read(core, tries),
            Phase::Errors => return self.read_error(),
            Phase::Decide => {
                core.decide();
                if core.command().torque {
                    self.off_repeats = OFF_REPEATS;
                }
                (None, Phase::WatchdogOff)
            }
            Phase::WatchdogOff => {
                self.configure = 0;
                if !core.command().torque {
                    self.configure = core.motors.mask(Motor::needs_settings);
                }
                (self.watchdog(0), Phase::WatchdogOn)
            }
            Phase::WatchdogOn => {
                let request = self.watchdog(BUS_WATCHDOG_COUNTS);
                for motor in core.motors.iter_mut().filter(|_| request.is_some()) {
                    motor.settings_sent();
                }
                (request, Phase::GoalHere)
            }
            Phase::GoalHere => {
                let goals = if core.wants_torque_on() {
                    core.goals_here()
                } else {
                    Vec::new()
                };
                (sync_write(Register::GoalAngle, &goals), Phase::Torque)
            }
            Phase::Torque => (self.torque(core), Phase::SetPoints),
            Phase::SetPoints => (sync_write(Register::GoalAngle, &core.goals()), Phase::Raw),
            Phase::Raw | Phase::Done => (None, self.phase),
        };
        self.phase = next;
        if self.phase == Phase::Raw && (core.bus_job.is_none() || core.in_motion()) {
            self.phase = Phase::Done;
        }
        request
    }

    fn read(&mut self, core: &Core, tries: u8) -> Option<Request> {
        let last = match self.slot {
            Slot::Control => TRIES,
            Slot::Reading => 1,
        };
        let next = match self.slot {
            Slot::Control => Phase::Errors,
            Slot::Reading => Phase::Done,
        };
        if tries >= last {
            self.phase = next;
            return None;
        }
        self.phase = Phase::Read { tries: tries + 1 };
        // Present ones first: a silent driver delays those behind it. Absent ones are asked once per cycle.
        let wanted = |motor: &&Motor| !motor.answered();
        let mut ids: Vec<u8, JOINTS> = Vec::new();
        let present = core
            .motors
            .iter()
            .zip(FIRST_ID..)
            .filter(|(m, _)| wanted(m) && m.present());
        let absent = core
            .motors
            .iter()
            .zip(FIRST_ID..)
            .filter(|(m, _)| wanted(m) && !m.present() && tries == 0);
        for (_, id) in present.chain(absent) {
            let _ = ids.push(id);
        }
        if ids.is_empty() {
            self.phase = next;
            return None;
        }
        Request::feedback(&ids).ok()
    }

    fn read_error(&mut self) -> Option<Request> {
        let joint = (0..JOINTS).find(|joint| self.ask_errors >> joint & 1 != 0);
        let Some(joint) = joint else {
            self.phase = Phase::Decide;
            return None;
        };
        // The phase stays: each pass takes one driver off the list.
        self.ask_errors &= !(1 << joint);
        self.asking = Some(joint);
        let register = Register::HardwareError;
        Request::read(id_of(joint), register.address(), register.size()).ok()
    }

    fn watchdog(&self, counts: i32) -> Option<Request> {
        let values = ids_of(self.configure).map(|id| (id, counts));
        sync_write(Register::BusWatchdog, &collect(values))
    }

    fn torque(&mut self, core: &Core) -> Option<Request> {
        if core.wants_torque_on() {
            let off = core.motors.mask(|motor| motor.torque() == Some(false));
            return sync_write(
                Register::TorqueEnable,
                &collect(ids_of(off).map(|id| (id, 1))),
            );
        }
        if core.command().torque {
            return None;
        }
        let on = core.motors.mask(|motor| motor.torque() == Some(true));
        if on == 0 && self.off_repeats == 0 {
            return None;
        }
        self.off_repeats = self.off_repeats.saturating_sub(1);
        let all = (0..JOINTS).map(|joint| (id_of(joint), 0));
        sync_write(Register::TorqueEnable, &collect(all))
    }

    fn send(&mut self, request: Request, tx: &mut [u8; BUS_BUFFER], now_us: u64) -> Step {
        let bytes = request.bytes();
        let len = bytes.len().min(BUS_BUFFER);
        for (place, byte) in tx.iter_mut().zip(bytes) {
            *place = *byte;
        }
        self.request_len = len as u64;
        self.latched_us =
            now_us.saturating_add(self.request_len.saturating_mul(crate::tasks::BUS_BYTE_US));
        let skips = request.ids().len() as u64 * SKIP_NS.div_ceil(1000);
        let gap_us = if request.is_answered() {
            ANSWER_SLACK_US.saturating_add(skips)
        } else {
            0
        };
        let reply_bytes = request.answer_bytes();
        self.exchange = Some(Exchange::new(request));
        Step::Exchange {
            len,
            reply_bytes,
            gap_us,
        }
    }

    /// A host's packet: sent once, then listened for in slices that leave the watchdog its due.
    fn raw(&mut self, core: &mut Core, tx: &mut [u8; BUS_BUFFER]) -> Step {
        self.phase = Phase::Done;
        let Some(job) = core.bus_job.as_mut() else {
            return Step::Done;
        };
        let mut len = 0;
        if !self.raw_sent {
            self.raw_sent = true;
            self.listened_us = 0;
            len = job.packet.len();
            for (place, byte) in tx.iter_mut().zip(&job.packet) {
                *place = *byte;
            }
        }
        let left_us = (u64::from(job.listen_ms) * 1000).saturating_sub(self.listened_us);
        let gap_us = left_us.min(LISTEN_SLICE_US);
        self.listened_us = self.listened_us.saturating_add(gap_us);
        Step::Exchange {
            len,
            reply_bytes: 0,
            gap_us,
        }
    }

    /// The answer of a raw packet, when its listening time is over.
    pub(crate) fn take_raw(
        &mut self,
        core: &mut Core,
    ) -> Option<(usize, Result<Completed, Reject>)> {
        let over = core
            .bus_job
            .as_ref()
            .is_some_and(|job| self.listened_us >= u64::from(job.listen_ms) * 1000);
        if !self.raw_sent || self.phase != Phase::Done || !over {
            return None;
        }
        self.raw_sent = false;
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

    /// The packet is on its way.
    pub(crate) fn started(&mut self, core: &mut Core, sent: Result<(), PortError>) {
        if sent.is_err() {
            core.counts.bus_stray = core.counts.bus_stray.saturating_add(1);
        }
    }

    /// Bytes came. True when everything asked for is there.
    pub(crate) fn received(&mut self, core: &mut Core, bytes: &[u8]) -> bool {
        self.heard_anything = true;
        let Some(exchange) = self.exchange.as_mut() else {
            if let Some(job) = core.bus_job.as_mut() {
                job.overflow |= job.heard.extend_from_slice(bytes).is_err();
            }
            return false;
        };
        for byte in bytes {
            exchange.push(*byte);
        }
        let complete = self.take_answers(core);
        // What needs no answer is over when its own time is, or an echo would run into the next packet.
        complete
            && self
                .exchange
                .as_ref()
                .is_some_and(|exchange| exchange.request().is_answered())
    }

    fn take_answers(&mut self, core: &mut Core) -> bool {
        let Some(exchange) = self.exchange.as_mut() else {
            return false;
        };
        while let Some(answer) = exchange.next_answer() {
            let joint = usize::from(answer.id.wrapping_sub(FIRST_ID));
            if let Some(asking) = self.asking {
                let bits = answer.value(Register::HardwareError).unwrap_or(0);
                core.hardware_error(asking, bits as u8);
                continue;
            }
            let feedback: Option<PackedFeedback> = answer.feedback();
            if let Some(feedback) = feedback {
                self.garbage_cycles = 0;
                if core.absorb(joint, feedback, self.latched_us) {
                    self.ask_errors |= 1 << (joint & 7);
                }
            }
        }
        exchange.is_complete()
    }

    /// The waiting time is over.
    pub(crate) fn silent(&mut self, core: &mut Core) {
        if let Some(exchange) = self.exchange.as_mut() {
            exchange.finish();
        }
        self.take_answers(core);
    }

    /// The UART reported an error; bytes are missing.
    pub(crate) fn error(&mut self, core: &mut Core, _error: PortError) {
        self.heard_anything = true;
        core.counts.bus_stray = core.counts.bus_stray.saturating_add(1);
    }

    /// Books the exchange that is over.
    fn close(&mut self, core: &mut Core) {
        let Some(exchange) = self.exchange.take() else {
            return;
        };
        let missing = exchange.missing().filter(|id| {
            core.motors
                .get(usize::from(id.wrapping_sub(FIRST_ID)))
                .is_some_and(Motor::present)
        });
        let missing = missing.count() as u32;
        if exchange.request().is_answered() {
            core.counts.bus_timeouts = core.counts.bus_timeouts.saturating_add(missing);
        }
        let parser = exchange.parser_counters();
        core.counts.bus_bad_crc = core.counts.bus_bad_crc.saturating_add(parser.bad_crc);
        let seen = exchange.counters();
        let stray = [
            seen.foreign,
            seen.wrong_id,
            seen.duplicates,
            seen.wrong_length,
        ];
        core.counts.bus_stray = stray
            .iter()
            .fold(core.counts.bus_stray, |sum, n| sum.saturating_add(*n));
        if let Some(joint) = self.asking.take()
            && missing > 0
        {
            core.hardware_error(joint, 0);
        }
    }

    /// Ends an instant: a line full of bytes without one answer is lost.
    pub(crate) fn end(&mut self, core: &mut Core) {
        self.close(core);
        let nobody = core.motors.mask(Motor::answered) == 0;
        if self.slot == Slot::Control && nobody && self.heard_anything && !self.raw_sent {
            self.garbage_cycles = self.garbage_cycles.saturating_add(1);
            if self.garbage_cycles >= GARBAGE_CYCLES {
                core.fault_in_motion(Fault::BusLost);
            }
        }
    }
}

/// Bus address of joint 0; joint k has this plus k.
pub const FIRST_ID: u8 = 1;

/// Bus address of a joint.
fn id_of(joint: usize) -> u8 {
    // Joints are 0..6.
    FIRST_ID.saturating_add(joint as u8)
}

fn ids_of(mask: u8) -> impl Iterator<Item = u8> {
    (0..JOINTS)
        .filter(move |joint| mask >> joint & 1 != 0)
        .map(id_of)
}

/// Values for [`Request::sync_write`].
pub(crate) type Values = Vec<(u8, i32), JOINTS>;

pub(crate) fn collect(values: impl Iterator<Item = (u8, i32)>) -> Values {
    let mut list = Values::new();
    for value in values {
        // At most one per joint.
        let _ = list.push(value);
    }
    list
}

fn sync_write(register: Register, values: &Values) -> Option<Request> {
    if values.is_empty() {
        None
    } else {
        Request::sync_write(register, values).ok()
    }
}
