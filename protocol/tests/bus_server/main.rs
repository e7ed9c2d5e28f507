//! Driver servers and the master on one simulated bus: who answers what, and when.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

#[path = "../common/mod.rs"]
mod common;
mod several;

use common::*;
use protocol::bus::indirect::Indirect;
use protocol::bus::server::Keep;
use protocol::bus::table::{self, Access};
use protocol::bus::*;

const BYTE_NS: u64 = 10_000;

/// A driver that only remembers.
struct Driver {
    registers: RegisterFile,
    writes: Vec<(Register, i32)>,
    latched_ns: Vec<u64>,
    refuse: bool,
    reboots: u32,
    indirect: Option<Indirect>,
    resets: Vec<Keep>,
    turns: i32,
}

impl Driver {
    fn new(id: u8) -> Self {
        let mut registers = RegisterFile::new();
        registers.set(Register::Id, i32::from(id));
        registers.set(Register::PresentPosition, 1000 + i32::from(id));
        Self {
            registers,
            writes: vec![],
            latched_ns: vec![],
            refuse: false,
            reboots: 0,
            indirect: None,
            resets: vec![],
            turns: 3,
        }
    }
}

impl DriverHandler for Driver {
    fn latch(&mut self, now_ns: u64) {
        self.latched_ns.push(now_ns);
    }
    fn read(&self, register: Register) -> i32 {
        self.registers.get(register)
    }
    fn feedback(&mut self) -> PackedFeedback {
        feedback(self.registers.get(Register::Id))
    }
    fn write(&mut self, register: Register, value: i32) -> Result<(), StatusError> {
        if self.refuse {
            return Err(StatusError::DataLimit);
        }
        self.writes.push((register, value));
        self.registers.set(register, value);
        Ok(())
    }
    fn reboot(&mut self) {
        self.reboots += 1;
        self.registers.restart();
    }
    fn indirect(&self) -> Option<&Indirect> {
        self.indirect.as_ref()
    }
    fn set_indirect(&mut self, map: Indirect) {
        self.indirect = Some(map);
    }
    fn factory_reset(&mut self, keep: Keep) -> Result<(), StatusError> {
        self.resets.push(keep);
        Ok(())
    }
    fn clear_turns(&mut self) -> Result<(), StatusError> {
        self.turns = 0;
        Ok(())
    }
}

/// Who answered, with which error and data.
type Heard = (u8, Option<StatusError>, Vec<u8>);

/// Drivers on a wire where every byte takes its time and everybody hears everything but himself.
struct Bus {
    drivers: Vec<(DriverServer, Driver)>,
    now_ns: u64,
    /// Overlapping answers.
    collisions: u32,
}

impl Bus {
    fn new(ids: &[u8]) -> Self {
        let drivers = ids
            .iter()
            .map(|id| (DriverServer::new(BYTE_NS), Driver::new(*id)))
            .collect();
        Self {
            drivers,
            now_ns: 0,
            collisions: 0,
        }
    }

    fn byte(&mut self, byte: u8, from: Option<usize>, waiting: &mut Vec<(u64, usize, PacketBuf)>) {
        self.now_ns += BYTE_NS;
        let now_ns = self.now_ns;
        for (k, (server, driver)) in self.drivers.iter_mut().enumerate() {
            if from != Some(k)
                && let Some(reply) = server.push(byte, now_ns, driver)
            {
                assert!(reply.send_at_ns >= now_ns);
                waiting.push((reply.send_at_ns, k, reply.bytes));
            }
        }
    }

    /// Sends a request; returns everything heard after it.
    fn exchange(&mut self, request: &[u8]) -> Vec<u8> {
        let mut waiting = Vec::new();
        for &byte in request {
            self.byte(byte, None, &mut waiting);
        }
        let mut heard = Vec::new();
        loop {
            let deadline = self
                .drivers
                .iter()
                .enumerate()
                .filter_map(|(k, (server, _))| server.deadline_ns().map(|at| (at, k)))
                .min();
            waiting.sort_by_key(|(at, k, _)| (*at, *k));
            let next = waiting.first().map(|(at, ..)| *at);
            match (next, deadline) {
                (None, None) => return heard,
                (next, Some((at, k))) if next.is_none_or(|next| at < next) => {
                    self.now_ns = self.now_ns.max(at);
                    let now_ns = self.now_ns;
                    if let Some(reply) = self.drivers[k].0.poll(now_ns) {
                        waiting.push((reply.send_at_ns, k, reply.bytes));
                    }
                }
                _ => {
                    let (at, k, bytes) = waiting.remove(0);
                    self.collisions += u32::from(at < self.now_ns);
                    self.now_ns = self.now_ns.max(at);
                    for &byte in &bytes {
                        self.byte(byte, Some(k), &mut waiting);
                    }
                    heard.extend_from_slice(&bytes);
                }
            }
        }
    }

    fn ask(&mut self, request: Request) -> (Vec<Heard>, Exchange) {
        let heard = self.exchange(request.bytes());
        let mut exchange = Exchange::new(request);
        let mut answers = Vec::new();
        for byte in heard {
            exchange.push(byte);
            while let Some(answer) = exchange.next_answer() {
                answers.push((answer.id, answer.error, answer.data.to_vec()));
            }
        }
        assert_eq!(self.collisions, 0);
        (answers, exchange)
    }

    fn driver(&mut self, id: u8) -> &mut Driver {
        &mut self
            .drivers
            .iter_mut()
            .find(|(_, driver)| driver.read(Register::Id) == i32::from(id))
            .unwrap()
            .1
    }

    fn pause(&mut self, ns: u64) {
        self.now_ns += ns;
    }
}

#[test]
fn ping_one_and_all() {
    let mut bus = Bus::new(&[1, 2, 250]);
    let (answers, exchange) = bus.ask(Request::ping(2).unwrap());
    assert_eq!(answers, [(2, None, vec![0x52, 0x42, 1])]);
    assert!(exchange.is_complete());
    let (answers, _) = bus.ask(Request::ping(BROADCAST).unwrap());
    assert_eq!(
        answers.iter().map(|answer| answer.0).collect::<Vec<_>>(),
        [1, 2, 250]
    );
    let (answers, exchange) = bus.ask(Request::ping(3).unwrap());
    assert_eq!(
        (answers.len(), exchange.missing().collect::<Vec<_>>()),
        (0, vec![3])
    );
}

#[test]
fn set_points_reach_each_driver_and_feedback_comes_back_in_order() {
    let ids = [1, 2, 3, 4, 5, 6];
    for fast in [false, true] {
        let mut bus = Bus::new(&ids);
        let goals = ids.map(|id| (id, -111_111 * i32::from(id)));
        assert!(
            bus.exchange(Request::set_points(&goals).unwrap().bytes())
                .is_empty()
        );
        let read = if fast {
            Request::fast_feedback(&ids)
        } else {
            Request::feedback(&ids)
        }
        .unwrap();
        let begin = bus.now_ns;
        let expected = read.answer_bytes();
        let asked = read.bytes().len();
        let (answers, exchange) = bus.ask(read);
        assert!(exchange.is_complete());
        assert_eq!(
            bus.now_ns - begin,
            (asked + expected) as u64 * BYTE_NS,
            "no byte time lost, fast {fast}"
        );
        for ((id, goal), answer) in goals.iter().zip(&answers) {
            assert_eq!(
                answer,
                &(*id, None, feedback(i32::from(*id)).to_bytes().to_vec())
            );
            let driver = bus.driver(*id);
            assert_eq!(driver.writes, [(Register::GoalAngle, *goal)]);
            assert_eq!(
                driver.latched_ns.last(),
                Some(&(begin + asked as u64 * BYTE_NS)),
                "all measure at one instant"
            );
        }
    }
}

#[test]
fn every_subset_of_missing_drivers() {
    let ids = [1, 2, 3, 4, 5, 6];
    for mask in 0..64_u32 {
        let there: Vec<u8> = ids
            .into_iter()
            .filter(|id| mask & (1 << (id - 1)) != 0)
            .collect();
        let gone: Vec<u8> = ids
            .into_iter()
            .filter(|id| mask & (1 << (id - 1)) == 0)
            .collect();
        let mut bus = Bus::new(&there);
        let begin = bus.now_ns;
        let (answers, exchange) = bus.ask(Request::feedback(&ids).unwrap());
        assert_eq!(
            answers.iter().map(|answer| answer.0).collect::<Vec<_>>(),
            there,
            "mask {mask:06b}"
        );
        assert_eq!(exchange.missing().collect::<Vec<_>>(), gone);
        let request = Request::feedback(&ids).unwrap();
        let patience_ns = request.bytes().len() as u64 * BYTE_NS + request.patience_ns(BYTE_NS);
        assert!(
            bus.now_ns - begin <= patience_ns && patience_ns < 6_000_000,
            "{} ns",
            bus.now_ns - begin
        );

        // A common answer ends at the first gap; the next request is answered as if nothing had been.
        let (_, exchange) = bus.ask(Request::fast_feedback(&ids).unwrap());
        assert_eq!(exchange.is_complete(), mask == 63);
        bus.pause(20_000_000);
        let (answers, _) = bus.ask(Request::feedback(&ids).unwrap());
        assert_eq!(answers.len(), there.len());
    }
}

#[test]
fn return_delay_and_status_return_level() {
    let mut bus = Bus::new(&[1, 2]);
    bus.driver(1).registers.set(Register::ReturnDelay, 250);
    bus.driver(2).registers.set(Register::ReturnDelay, 250);
    let begin = bus.now_ns;
    let (answers, _) = bus.ask(Request::sync_read(132, 4, &[1, 2]).unwrap());
    assert_eq!(answers.len(), 2);
    assert_eq!(bus.now_ns - begin, (16 + 2 * 15) * BYTE_NS + 2 * 500_000);

    for (level, ping, read, write) in [(0, 1, 0, 0), (1, 1, 1, 0), (2, 1, 1, 1)] {
        bus.driver(1)
            .registers
            .set(Register::StatusReturnLevel, level);
        assert_eq!(bus.ask(Request::ping(1).unwrap()).0.len(), ping);
        assert_eq!(bus.ask(Request::read(1, 132, 4).unwrap()).0.len(), read);
        assert_eq!(
            bus.ask(Request::write(1, Register::Led, 1).unwrap())
                .0
                .len(),
            write
        );
    }
}

#[test]
fn access_range_length_and_limit_errors() {
    let mut bus = Bus::new(&[1]);
    let mut error = |params: &[u8], instruction| {
        let packet = packet::Builder::new(1, instruction)
            .params(params)
            .finish()
            .unwrap();
        let heard = bus.exchange(&packet);
        assert!(!heard.is_empty());
        let writes = bus.driver(1).writes.len();
        (StatusError::from_byte(heard[8]), writes)
    };
    use Instruction::{Action, Read, Write};
    let cases: &[(&str, Instruction, &[u8], Option<StatusError>)] = &[
        (
            "read only",
            Write,
            &[132, 0, 1, 0, 0, 0],
            Some(StatusError::Access),
        ),
        ("no register", Write, &[14, 0, 1], Some(StatusError::Access)),
        (
            "middle of a register",
            Write,
            &[117, 0, 1],
            Some(StatusError::Access),
        ),
        (
            "two of four bytes",
            Write,
            &[116, 0, 1, 0],
            Some(StatusError::DataLength),
        ),
        ("no data", Write, &[116, 0], Some(StatusError::DataLength)),
        ("no address", Write, &[116], Some(StatusError::DataLength)),
        (
            "goal beyond range",
            Write,
            &[116, 0, 0, 0, 0, 0x7F],
            Some(StatusError::DataRange),
        ),
        ("id 253", Write, &[7, 0, 253], Some(StatusError::DataRange)),
        (
            "one good, one bad",
            Write,
            &[64, 0, 1, 9],
            Some(StatusError::DataRange),
        ),
        (
            "watchdog -1 cannot be written",
            Write,
            &[98, 0, 0xFF],
            Some(StatusError::DataRange),
        ),
        (
            "zero wants its magic",
            Write,
            &[0x1A, 4, 1],
            Some(StatusError::DataRange),
        ),
        (
            "packed block is read only",
            Write,
            &[0x28, 4, 1],
            Some(StatusError::Access),
        ),
        ("hole", Read, &[0, 2, 4, 0], Some(StatusError::Access)),
        (
            "across the end",
            Read,
            &[144, 0, 8, 0],
            Some(StatusError::Access),
        ),
        ("nothing", Read, &[0, 0, 0, 0], Some(StatusError::Access)),
        (
            "wrap",
            Read,
            &[0xFF, 0xFF, 0xFF, 0xFF],
            Some(StatusError::Access),
        ),
        ("short", Read, &[0, 0, 1], Some(StatusError::DataLength)),
        (
            "action without reg write",
            Action,
            &[],
            Some(StatusError::Instruction),
        ),
        ("everything of the X series", Read, &[0, 0, 148, 0], None),
    ];
    for (what, instruction, params, expected) in cases {
        assert_eq!(error(params, *instruction), (*expected, 0), "{what}");
    }
    assert_eq!(error(&[64, 0, 1], Write), (None, 1));
    assert_eq!(
        error(&[7, 0, 9], Write),
        (Some(StatusError::Access), 1),
        "EEPROM while torque is on"
    );
    bus.driver(1).refuse = true;
    bus.driver(1).registers.set(Register::HardwareError, 0x20);
    let heard = bus.exchange(Request::write(1, Register::GoalAngle, 5).unwrap().bytes());
    assert_eq!(heard[8], packet::ALERT | StatusError::DataLimit as u8);
}

#[test]
fn reads_of_any_range_agree_with_the_registers() {
    let mut bus = Bus::new(&[1]);
    let mut image = vec![0; usize::from(table::OWN_END)];
    for info in table::TABLE {
        let bytes = bus.driver(1).read(info.register).to_le_bytes();
        let at = usize::from(info.address);
        image[at..at + usize::from(info.len)].copy_from_slice(&bytes[..usize::from(info.len)]);
    }
    let packed = usize::from(table::PACKED_FEEDBACK);
    image[packed..packed + PACKED_LEN].copy_from_slice(&feedback(1).to_bytes());
    for (from, to) in [(0, table::X_END), (table::OWN_START, table::OWN_END)] {
        for address in from..to {
            for len in [1, 2, 3, 4, 19] {
                if address + len <= to {
                    let (answers, _) = bus.ask(Request::read(1, address, len).unwrap());
                    let (at, end) = (usize::from(address), usize::from(address + len));
                    assert_eq!(
                        answers[0],
                        (1, None, image[at..end].to_vec()),
                        "{address} {len}"
                    );
                }
            }
        }
    }
}

#[test]
fn the_table_is_consistent() {
    let mut end = 0;
    for info in table::TABLE {
        assert!(info.address >= end, "{} overlaps", info.name);
        end = info.address + u16::from(info.len);
        assert!(
            end <= table::X_END
                || (info.address >= table::OWN_START && end <= table::PACKED_FEEDBACK)
        );
        assert_eq!(Register::at(info.address), Some(info.register));
        assert_eq!(info.register.info(), info);
        assert!(info.min <= info.max);
        if info.access != Access::Read && info.register != Register::ZeroHere {
            assert!(
                (info.min..=info.max).contains(&info.default),
                "{}",
                info.name
            );
        }
        let smallest = info.min.to_le_bytes();
        assert_eq!(info.register.value_of(&smallest), info.min, "{}", info.name);
    }
    // Where foreign clients look (design page, X series).
    for (register, address) in [
        (Register::ReturnDelay, 9),
        (Register::OperatingMode, 11),
        (Register::TorqueEnable, 64),
        (Register::HardwareError, 70),
        (Register::PositionDGain, 80),
        (Register::PositionIGain, 82),
        (Register::PositionPGain, 84),
        (Register::BusWatchdog, 98),
        (Register::GoalPwm, 100),
        (Register::GoalCurrent, 102),
        (Register::GoalPosition, 116),
        (Register::RealtimeTick, 120),
        (Register::PresentPwm, 124),
        (Register::PresentCurrent, 126),
        (Register::PresentVelocity, 128),
        (Register::PresentPosition, 132),
        (Register::PresentInputVoltage, 144),
        (Register::PresentTemperature, 146),
    ] {
        assert_eq!(register.address(), address);
    }
}

#[test]
fn reboot_forgets_ram_and_keeps_eeprom() {
    let mut bus = Bus::new(&[4]);
    bus.ask(Request::write(4, Register::ReturnDelay, 10).unwrap());
    bus.ask(Request::write(4, Register::TorqueEnable, 1).unwrap());
    let (answers, _) = bus.ask(Request::reboot(4).unwrap());
    assert_eq!(answers, [(4, None, vec![])]);
    let driver = bus.driver(4);
    assert_eq!(driver.reboots, 1);
    assert_eq!(
        (
            driver.read(Register::TorqueEnable),
            driver.read(Register::ReturnDelay)
        ),
        (0, 10)
    );
    assert!(
        bus.exchange(Request::reboot(BROADCAST).unwrap().bytes())
            .is_empty()
    );
    assert_eq!(bus.driver(4).reboots, 2);
}

#[test]
fn a_damaged_request_is_not_answered_and_the_next_one_is() {
    let request = Request::feedback(&[1, 2]).unwrap();
    let next = Request::ping(2).unwrap();
    let good = request.bytes();
    let (mut wrong, mut lost) = (0, 0);
    for at in 0..good.len() {
        for bit in 0..8 {
            let mut bus = Bus::new(&[1, 2]);
            let mut damaged = good.to_vec();
            damaged[at] ^= 1 << bit;
            wrong += u32::from(!bus.exchange(&damaged).is_empty());
            bus.pause(20_000_000);
            lost += u32::from(bus.ask(next.clone()).0.len() != 1);
        }
    }
    assert_eq!((wrong, lost), (0, 0));
}

#[test]
fn what_is_found_late_is_never_answered() {
    // A false header with a length that swallows a read request and the answer of another driver to it.
    let mut bus = Bus::new(&[1]);
    let mut stream = vec![0xFF, 0xFF, 0xFD, 0x00, 0x07, 30, 0x00];
    stream.extend_from_slice(Request::read(1, 132, 4).unwrap().bytes());
    stream.extend_from_slice(&[0x55; 20]);
    assert!(bus.exchange(&stream).is_empty());
}

#[test]
fn a_common_answer_that_stopped_does_not_swallow_the_next_request() {
    let mut server = DriverServer::new(BYTE_NS);
    let mut driver = Driver::new(2);
    let mut now_ns = 0;
    // Driver 1 is missing, and nobody polls.
    for &byte in Request::fast_feedback(&[1, 2]).unwrap().bytes() {
        now_ns += BYTE_NS;
        assert_eq!(server.push(byte, now_ns, &mut driver), None);
    }
    now_ns += 1_000_000;
    let mut replies = 0;
    for &byte in Request::ping(2).unwrap().bytes() {
        now_ns += BYTE_NS;
        replies += u32::from(server.push(byte, now_ns, &mut driver).is_some());
    }
    assert_eq!(replies, 1);
}
