//! The module as master of the motor bus: which packets a cycle sends, and what the answers mean.
//!
//! ```text
//! control cycle   torque off, at rest and until it is certain ─▶
//!                 read all ─▶ read again who is missing (2 x) ─▶ error register of who complains ─▶ decide ─▶
//!                 torque off, drivers that come into use ─▶ watchdogs of new drivers, set and read back ─▶
//!                 torque on, and read who got it ─▶ set-points ─▶ torque off for who has restarted ─▶
//!                 a host's raw packet (not in motion)
//! reading         read all
//! ```
//!
//! Every phase is entered a bounded number of times per cycle, so the number of packets is bounded: at most 14, and two more
//! for each driver that complains or is new. With all six drivers silent the three tries take 18.3 ms of the 50, with twelve 34.7 ms. Servos that
//! come into use (not ours, not in motion) take [`SETUP_PACKETS`] more; a series without Sync Read is read one by one.

use super::core::Core;
use super::motors::Motor;
use super::packets::{
    FIRST_ID, collect, id_of, ids_of, set_points, sync_write, take_first, torque,
};
use super::raw::Raw;
use super::setup::Setup;
use super::timing::Slot;
use super::types::{BUS_BUFFER, BUS_BYTE_US, Step};
use crate::ports::PortError;
use control::machine::MAX_JOINTS;
use control::supervisor::Fault;
use heapless::Vec;
use protocol::bus::profile::WATCHDOG_COUNTS;
use protocol::bus::server::SKIP_NS;
use protocol::bus::{Exchange, ProfileInfo, Request};
use protocol::link::{Completed, EventKind, Reject};

/// Tries of the cyclic read: one wrong byte in 10^4 loses both of two tries once in 10^5 cycles, all three never in a day.
const TRIES: u8 = 3;
/// Wait beyond byte times and skipped drivers, us: the return delay of a driver fresh from the shop (500 us).
const ANSWER_SLACK_US: u64 = 500;
/// Packets of one cycle for drivers that come into use: 12 of at most 1.7 ms leave more than half of the cycle.
const SETUP_PACKETS: u8 = 12;
/// A set-point or torque-on leaves no later than this after the first reading it rests on was asked for, us: half a cycle. Six silent drivers keep that (18.3 ms).
/// A stalled task does not, nor do twelve drivers of which most are silent; after three such cycles they count as lost.
const FRESH_US: u64 = control::CYCLE_US / 2;
/// Tries of the reading after torque-on: one more than on a good wire. Who answers neither is read in the next cycle.
const CONFIRMS: u8 = 2;
/// Cycles in which torque-off is sent to drivers that cannot confirm it.
pub(crate) const OFF_REPEATS: u8 = 3;

/// Where in the cycle the bus is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Who is to let go hears it before the drivers are read: silent ones would delay it by 18 ms.
    OffFirst,
    /// `asked`: drivers read one by one in this try.
    Read {
        tries: u8,
        asked: u16,
    },
    Errors,
    Decide,
    TorqueOff,
    Setup {
        packets: u8,
    },
    WatchdogOff,
    WatchdogOn,
    WatchdogRead,
    GoalHere,
    TorqueOn,
    Confirm {
        tries: u8,
    },
    SetPoints,
    LetGo,
    Raw,
    Done,
}

/// State of the bus master.
#[derive(Debug)]
pub struct Master {
    phase: Phase,
    slot: Slot,
    /// What is asked now, or was asked last. It stays where it is: 1.7 KB are not moved six times a cycle.
    exchange: Exchange,
    /// The exchange is under way.
    listening: bool,
    /// When the drivers latched what the present exchange reads, us.
    latched_us: u64,
    request_len: u64,
    /// Drivers whose error register is to be read.
    ask_errors: u16,
    asking: Option<Asking>,
    /// When the first reading of the cycle was asked for, us.
    asked_us: u64,
    /// Driver whose answer brings it into use.
    setting_up: Option<usize>,
    /// Joint whose turn it is to come into use.
    setup_turn: usize,
    configure: u16,
    /// Drivers that were sent torque in this cycle, and those of them that are still to be read.
    switched: u16,
    unread: u16,
    off_repeats: u8,
    /// Torque-off was sent in this cycle.
    off_told: bool,
    garbage_cycles: u8,
    heard_anything: bool,
    raw: Raw,
}

/// One register of one joint's driver that is read for itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Asking {
    Error(usize),
    Watchdog(usize),
}

/// Cycles with bytes on the bus but no valid answer that mean a babbling or stuck line.
const GARBAGE_CYCLES: u8 = 3;

impl Master {
    pub(crate) const fn new() -> Self {
        Self {
            phase: Phase::Done,
            slot: Slot::Control,
            exchange: Exchange::idle(),
            listening: false,
            latched_us: 0,
            request_len: 0,
            ask_errors: 0,
            asking: None,
            asked_us: 0,
            setting_up: None,
            setup_turn: 0,
            configure: 0,
            switched: 0,
            unread: 0,
            off_repeats: OFF_REPEATS,
            off_told: false,
            garbage_cycles: 0,
            heard_anything: false,
            raw: Raw::new(),
        }
    }

    /// Begins an instant of the grid.
    pub(crate) fn begin(&mut self, slot: Slot, core: &Core) {
        self.slot = slot;
        self.heard_anything = false;
        let listening = self.raw.is_sent() && core.bus_job.is_some();
        self.off_told = false;
        self.phase = match slot {
            _ if listening => Phase::Raw,
            Slot::Control => Phase::OffFirst,
            Slot::Reading => Phase::Read { tries: 0, asked: 0 },
        };
    }

    /// The next packet of this cycle.
    pub(crate) fn next(&mut self, core: &mut Core, tx: &mut [u8; BUS_BUFFER], now_us: u64) -> Step {
        self.close(core);
        // Every pass moves to a later phase or takes a driver off a list; a read phase comes at most three times.
        while self.phase != Phase::Done {
            let request = self.advance(core, now_us);
            if let Some(request) = request {
                return self.send(request, tx, now_us);
            }
            if self.phase == Phase::Raw {
                self.phase = Phase::Done;
                return self.raw.next(core, tx);
            }
        }
        Step::Done
    }

    /// Builds the packet of the present phase, if it needs one, and moves on.
    fn advance(&mut self, core: &mut Core, now_us: u64) -> Option<Request> {
        let info = core.motors.info();
        let fresh = now_us.saturating_sub(self.asked_us) <= FRESH_US;
        let (request, next) = match self.phase {
            Phase::OffFirst => (self.torque_off(core), Phase::Read { tries: 0, asked: 0 }),
            Phase::Read { tries, asked } => {
                if (tries, asked) == (0, 0) {
                    self.asked_us = now_us;
                }
                return self.read(core, tries, asked);
            }
            Phase::Errors => return self.read_error(info),
            Phase::Setup { packets } => return self.set_up(core, packets),
            Phase::Decide => {
                core.decide(fresh);
                if core.command().torque {
                    self.off_repeats = OFF_REPEATS;
                }
                (None, Phase::TorqueOff)
            }
            // Before the watchdogs: one that has tripped holds back a driver that still has torque.
            Phase::TorqueOff => {
                let packets = if core.command().torque {
                    0
                } else {
                    SETUP_PACKETS
                };
                (self.torque_off(core), Phase::Setup { packets })
            }
            Phase::WatchdogOff => (self.clear_watchdogs(core), Phase::WatchdogOn),
            Phase::WatchdogOn => {
                let counts = i32::from(WATCHDOG_COUNTS);
                (self.watchdog(info, counts), Phase::WatchdogRead)
            }
            Phase::WatchdogRead => return self.read_watchdog(core),
            Phase::GoalHere => {
                let goals = if fresh && core.wants_torque_on() {
                    core.goals_here()
                } else {
                    Vec::new()
                };
                (set_points(info, &goals), Phase::TorqueOn)
            }
            Phase::TorqueOn => {
                self.switched = if fresh { core.to_switch_on() } else { 0 };
                self.unread = 0;
                (torque(info, self.switched, 1), Phase::Confirm { tries: 0 })
            }
            Phase::Confirm { tries } => return self.confirm(core, tries),
            Phase::SetPoints => (set_points(info, &core.goals()), Phase::LetGo),
            Phase::LetGo => (torque(info, core.to_let_go(), 0), Phase::Raw),
            Phase::Raw | Phase::Done => (None, self.phase),
        };
        self.phase = next;
        if self.phase == Phase::Raw && (core.bus_job.is_none() || core.in_motion()) {
            self.phase = Phase::Done;
        }
        request
    }

    fn read(&mut self, core: &Core, tries: u8, asked: u16) -> Option<Request> {
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
        let mut joints = core.motors.unread(tries == 0);
        let info = core.motors.info();
        let tries_next = tries.saturating_add(1);
        if info.sync_read {
            self.phase = Phase::Read {
                tries: tries_next,
                asked: 0,
            };
        } else {
            // One after the other: each pass adds one to `asked`, and with all asked the try is over.
            joints.retain(|joint| asked >> joint & 1 == 0);
            joints.truncate(1);
            self.phase = match joints.first() {
                Some(joint) => Phase::Read {
                    tries,
                    asked: asked | 1 << joint,
                },
                None => Phase::Read {
                    tries: tries_next,
                    asked: 0,
                },
            };
        }
        if joints.is_empty() {
            if info.sync_read {
                self.phase = next;
            }
            return None;
        }
        let ids: Vec<u8, MAX_JOINTS> = joints.iter().map(|joint| id_of(*joint)).collect();
        info.read_feedback(&ids).ok()
    }

    /// The phase stays: each pass takes one driver off its list.
    fn read_error(&mut self, info: &ProfileInfo) -> Option<Request> {
        let Some(joint) = take_first(&mut self.ask_errors) else {
            self.phase = Phase::Decide;
            return None;
        };
        self.asking = Some(Asking::Error(joint));
        info.read_field(id_of(joint), &info.hardware_error).ok()
    }

    /// A driver whose watchdog is not certain gets no torque: the packet that sets it has no answer and may be lost.
    fn read_watchdog(&mut self, core: &mut Core) -> Option<Request> {
        let Some(joint) = take_first(&mut self.configure) else {
            self.phase = Phase::GoalHere;
            return None;
        };
        let info = core.motors.info();
        let Some(field) = info.watchdog.as_ref() else {
            // A series without one.
            core.motors.get_mut(joint)?.note_guarded();
            return None;
        };
        self.asking = Some(Asking::Watchdog(joint));
        info.read_field(id_of(joint), field).ok()
    }

    /// Reads who was just sent torque: a driver may have restarted since the readings of this cycle. Who says that he has torque is not asked again.
    fn confirm(&mut self, core: &Core, tries: u8) -> Option<Request> {
        let info = core.motors.info();
        let mut tries = tries;
        if self.unread == 0 && tries < CONFIRMS {
            tries = tries.saturating_add(1);
            let silent = core.motors.mask(|motor| motor.torque() != Some(true));
            self.unread = self.switched & silent;
        }
        let asked = if info.sync_read {
            core::mem::take(&mut self.unread)
        } else {
            take_first(&mut self.unread).map_or(0, |joint| 1 << joint)
        };
        let ids: Vec<u8, MAX_JOINTS> = ids_of(asked).collect();
        if ids.is_empty() {
            self.phase = Phase::SetPoints;
            return None;
        }
        self.phase = Phase::Confirm { tries };
        info.read_feedback(&ids).ok()
    }

    /// The next packet for a driver that comes into use. Every pass takes one off the packets of this cycle, and a joint its turn.
    fn set_up(&mut self, core: &mut Core, packets: u8) -> Option<Request> {
        let due = |joint: &usize| {
            let motor = core.motors.get(*joint);
            motor.is_some_and(|motor| motor.setup().is_due())
        };
        let first = self.setup_turn;
        let joint = (first..MAX_JOINTS)
            .chain(0..first)
            .find(due)
            .filter(|_| packets > 0);
        let Some(joint) = joint else {
            self.phase = Phase::WatchdogOff;
            return None;
        };
        self.phase = Phase::Setup {
            packets: packets.saturating_sub(1),
        };
        self.setup_turn = joint.wrapping_add(1) % MAX_JOINTS;
        let info = core.motors.info();
        let motor = core.motors.get_mut(joint)?;
        let request = motor.setup().request(info, id_of(joint));
        // The answer to a write says nothing: the setting is read again.
        self.setting_up = (!motor.setup().writes()).then_some(joint);
        let next = motor.setup().sent();
        self.step_up(core, joint, next);
        request
    }

    fn step_up(&mut self, core: &mut Core, joint: usize, setup: Setup) {
        // Joints are 0..12.
        let number = joint as u8;
        let wrong = core
            .motors
            .get_mut(joint)
            .and_then(|motor| motor.set_setup(number, setup));
        if let Some(wrong) = wrong {
            core.event(EventKind::WrongDriver(wrong));
        }
    }

    /// Of drivers that are new or have tripped, and have no torque.
    fn clear_watchdogs(&mut self, core: &mut Core) -> Option<Request> {
        self.configure = 0;
        if !core.command().torque || core.wants_torque_on() {
            let wants = |motor: &Motor| motor.needs_settings() && motor.torque() == Some(false);
            self.configure = core.motors.mask(wants);
            for motor in core.motors.iter_mut().filter(|motor| wants(motor)) {
                motor.note_unguarded();
            }
        }
        self.watchdog(core.motors.info(), 0)
    }

    fn watchdog(&self, info: &ProfileInfo, counts: i32) -> Option<Request> {
        if self.configure == 0 {
            return None;
        }
        let values = ids_of(self.configure).map(|id| (id, counts));
        sync_write(info, info.watchdog.as_ref()?, &collect(values))
    }

    fn torque_off(&mut self, core: &Core) -> Option<Request> {
        let info = core.motors.info();
        if core.command().torque {
            return None;
        }
        // Once in a cycle to who cannot confirm it, and after the readings again to who has not heard it.
        let on = core.motors.mask(|motor| motor.torque() == Some(true));
        let enough = self.off_told || self.off_repeats == 0;
        if on == 0 && enough {
            return None;
        }
        if !core::mem::replace(&mut self.off_told, true) {
            self.off_repeats = self.off_repeats.saturating_sub(1);
        }
        // Nobody that is known to be of another kind is written to.
        let wrong = core.motors.mask(|motor| motor.wrong(0).is_some());
        let all = core.motion.machine().all_joints();
        torque(info, all & !wrong, 0)
    }

    fn send(&mut self, request: Request, tx: &mut [u8; BUS_BUFFER], now_us: u64) -> Step {
        let bytes = request.bytes();
        let len = bytes.len().min(BUS_BUFFER);
        for (place, byte) in tx.iter_mut().zip(bytes) {
            *place = *byte;
        }
        self.request_len = len as u64;
        self.latched_us = now_us.saturating_add(self.request_len.saturating_mul(BUS_BYTE_US));
        let skips = request.ids().len() as u64 * SKIP_NS.div_ceil(1000);
        let gap_us = if request.is_answered() {
            ANSWER_SLACK_US.saturating_add(skips)
        } else {
            0
        };
        let reply_bytes = request.answer_bytes();
        self.exchange.begin(request);
        self.listening = true;
        Step::Exchange {
            len,
            reply_bytes,
            gap_us,
        }
    }

    /// The answer of a raw packet, when its listening time is over.
    pub(crate) fn take_raw(
        &mut self,
        core: &mut Core,
    ) -> Option<(usize, Result<Completed, Reject>)> {
        if self.phase != Phase::Done {
            return None;
        }
        self.raw.take(core)
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
        if !self.listening {
            if let Some(job) = core.bus_job.as_mut() {
                job.overflow |= job.heard.extend_from_slice(bytes).is_err();
            }
            return false;
        }
        self.exchange.extend(bytes);
        let complete = self.take_answers(core);
        // What needs no answer is over when its own time is, or an echo would run into the next packet.
        complete && self.exchange.request().is_answered()
    }

    fn take_answers(&mut self, core: &mut Core) -> bool {
        if !self.listening {
            return false;
        }
        let info = core.motors.info();
        let mut setup = None;
        while let Some(answer) = self.exchange.next_answer() {
            let joint = usize::from(answer.id.wrapping_sub(FIRST_ID));
            if let Some(asking) = self.asking {
                take_asked(core, asking, answer.data);
                continue;
            }
            if let Some(joint) = self.setting_up {
                let data = answer.error.is_none().then_some(answer.data);
                let motor = core.motors.get(joint);
                setup = motor.map(|motor| (joint, motor.setup().answered(info, data)));
                continue;
            }
            if let Some(feedback) = info.decode(answer.data, self.latched_us) {
                self.garbage_cycles = 0;
                if core.absorb(joint, feedback, self.latched_us) {
                    self.ask_errors |= 1 << (joint & 15);
                }
            } else if answer.error.is_some()
                && let Some(motor) = core.motors.get_mut(joint)
            {
                motor.suspect();
            }
        }
        let complete = self.exchange.is_complete();
        if let Some((joint, setup)) = setup {
            self.step_up(core, joint, setup);
        }
        complete
    }

    /// The waiting time is over.
    pub(crate) fn silent(&mut self, core: &mut Core) {
        if self.listening {
            self.exchange.finish();
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
        if !core::mem::take(&mut self.listening) {
            return;
        }
        let exchange = &self.exchange;
        let setting_up = self.setting_up.take().is_some();
        let missing = exchange.missing().filter(|id| {
            core.motors
                .get(usize::from(id.wrapping_sub(FIRST_ID)))
                .is_some_and(Motor::present)
        });
        let missing = missing.count() as u32;
        if exchange.request().is_answered() && !setting_up {
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
        if let Some(Asking::Error(joint)) = self.asking.take()
            && missing > 0
        {
            core.hardware_error(joint, 0);
        }
    }

    /// Ends an instant: a line full of bytes without one answer is lost.
    pub(crate) fn end(&mut self, core: &mut Core) {
        self.close(core);
        let nobody = core.motors.mask(Motor::answered) == 0;
        if self.slot == Slot::Control && nobody && self.heard_anything && !self.raw.is_sent() {
            self.garbage_cycles = self.garbage_cycles.saturating_add(1);
            if self.garbage_cycles >= GARBAGE_CYCLES {
                core.fault_in_motion(Fault::BusLost);
            }
        }
    }
}

/// What a register says that was asked for.
fn take_asked(core: &mut Core, asking: Asking, data: &[u8]) {
    let info = core.motors.info();
    match asking {
        Asking::Error(joint) => {
            let bits = info.hardware_error.value_of(data);
            core.hardware_error(joint, bits as u8);
        }
        Asking::Watchdog(joint) => {
            let counts = info.watchdog.as_ref().map(|field| field.value_of(data));
            if counts == Some(i32::from(WATCHDOG_COUNTS))
                && let Some(motor) = core.motors.get_mut(joint)
            {
                motor.note_guarded();
            }
        }
    }
}
