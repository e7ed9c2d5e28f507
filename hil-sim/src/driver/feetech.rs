//! A Feetech servo on the bus: its frames and its table over the same loop and motor as our driver.
//!
//! Sources: Feetech, "Communication Protocol User Manual" and the memory tables of STS3215 and SCS15; headers of the Feetech SDK.

use heapless::Vec as FixedVec;
use protocol::bus::feetech::{Instruction, Parser, packet};
use protocol::bus::field::{Field, Order, Sign};
use protocol::bus::packet::BROADCAST;
use protocol::bus::server::{DriverHandler, Keep, Reply, SKIP_NS};
use protocol::bus::{PacketBuf, Profile, Register};
use protocol::units;

use super::registers::Front;

/// Bytes of the table.
const TABLE_BYTES: usize = 80;
/// First address that is forgotten at a restart.
const RAM: usize = 40;
/// Longest pause inside a packet [ns].
const MAX_GAP_NS: u64 = 10_000_000;
/// Angle of position 0 of an SCS from the middle of its 300 degrees [rad].
const SCS_MIDDLE_RAD: f64 = 150.0 * core::f64::consts::PI / 180.0;

/// Addresses of single registers.
mod at {
    pub(super) const MODEL: usize = 3;
    pub(super) const ID: usize = 5;
    pub(super) const BAUD: usize = 6;
    pub(super) const DELAY: usize = 7;
    pub(super) const LEVEL: usize = 8;
    pub(super) const LIMITS: usize = 9;
    pub(super) const TORQUE: usize = 40;
    pub(super) const GOAL: usize = 42;
    pub(super) const SPEED: usize = 46;
    pub(super) const READ_ONLY: usize = 56;
    pub(super) const POSITION: usize = 56;
    pub(super) const VELOCITY: usize = 58;
    pub(super) const LOAD: usize = 60;
    pub(super) const VOLTAGE: usize = 62;
    pub(super) const TEMPERATURE: usize = 63;
    pub(super) const REGISTERED: usize = 64;
    pub(super) const STATUS: usize = 65;
    pub(super) const MOVING: usize = 66;
    pub(super) const CURRENT: usize = 69;
}

/// Error bit of an answer to an instruction that the servo does not have or that names no register.
const ERROR_INSTRUCTION: u8 = 1 << 6;

/// Waiting for the servos ahead in a Sync Read.
#[derive(Clone, Debug)]
struct Turn {
    ahead: Vec<u8>,
    bytes: PacketBuf,
    deadline_ns: u64,
}

/// One servo's end of the bus and its table.
#[derive(Clone, Debug)]
pub struct Servo {
    profile: Profile,
    parser: Parser,
    table: [u8; TABLE_BYTES],
    /// What is kept over a restart.
    kept: [u8; RAM],
    factory: [u8; RAM],
    registered: Option<(usize, Vec<u8>)>,
    turn: Option<Turn>,
    last_byte_ns: u64,
}

impl Servo {
    /// A servo fresh from the shop, with an id.
    #[must_use]
    pub fn new(profile: Profile, id: u8) -> Self {
        let mut servo = Self {
            profile,
            parser: Parser::new(),
            table: [0; TABLE_BYTES],
            kept: [0; RAM],
            factory: [0; RAM],
            registered: None,
            turn: None,
            last_byte_ns: 0,
        };
        let model = profile.info().models.first().copied().unwrap_or(0);
        servo.put(at::MODEL, 2, Sign::None, i32::from(model));
        servo.table[at::ID] = id;
        servo.table[at::LEVEL] = 1;
        servo.put(at::LIMITS, 2, Sign::None, 0);
        servo.put(at::LIMITS + 2, 2, Sign::None, servo.counts() - 1);
        servo.kept.copy_from_slice(&servo.table[..RAM]);
        servo.factory = servo.kept;
        servo.table[servo.lock()] = 1;
        servo
    }

    /// The id it answers to.
    #[must_use]
    pub fn id(&self) -> u8 {
        self.table[at::ID]
    }

    /// Bits per second that it listens at (protocol manual, Baud Rate).
    #[must_use]
    pub fn baud(&self) -> u32 {
        match self.table[at::BAUD] {
            1 => 500_000,
            2 => 250_000,
            3 => 128_000,
            4 => 115_200,
            5 => 76_800,
            6 => 57_600,
            7 => 38_400,
            _ => 1_000_000,
        }
    }

    /// Restart of the electronics: what is not kept returns to its default.
    pub fn restart(&mut self) {
        self.table = [0; TABLE_BYTES];
        self.table[..RAM].copy_from_slice(&self.kept);
        self.table[self.lock()] = 1;
        self.registered = None;
        self.turn = None;
    }

    /// When [`Self::poll`] is due, if nobody talks before [ns].
    #[must_use]
    pub fn deadline_ns(&self) -> Option<u64> {
        self.turn.as_ref().map(|turn| turn.deadline_ns)
    }

    /// The servos ahead stayed silent until now.
    pub fn poll(&mut self, now_ns: u64) -> Option<Reply> {
        if self.deadline_ns()? > now_ns {
            return None;
        }
        let turn = self.turn.take()?;
        Some(Reply {
            bytes: turn.bytes,
            send_at_ns: now_ns,
        })
    }

    /// Takes one byte heard on the bus, whole at `now_ns`.
    pub fn push(&mut self, byte: u8, now_ns: u64, front: &mut Front<'_>) -> Option<Reply> {
        if now_ns.saturating_sub(self.last_byte_ns) > MAX_GAP_NS {
            self.parser.clear();
        }
        self.last_byte_ns = now_ns;
        self.parser.push(byte);
        let mut reply = None;
        while let Some(packet) = self.parser.next_packet() {
            let (id, code, params) = (packet.id, packet.code, packet.params.to_vec());
            let fresh = self.parser.is_empty();
            reply = self
                .hear(id, code, &params, now_ns, front)
                .filter(|_| fresh)
                .or(reply);
        }
        if let Some(turn) = &mut self.turn {
            turn.deadline_ns = now_ns + SKIP_NS * turn.ahead.len() as u64;
        }
        reply
    }

    fn hear(
        &mut self,
        id: u8,
        code: u8,
        params: &[u8],
        now_ns: u64,
        front: &mut Front<'_>,
    ) -> Option<Reply> {
        // An answer has the form of a request: who is ahead in a Sync Read can only be answering.
        if let Some(turn) = &mut self.turn
            && let Some(heard) = turn.ahead.iter().position(|other| *other == id)
        {
            turn.ahead.drain(..=heard);
            if !turn.ahead.is_empty() {
                return None;
            }
            let bytes = self.turn.take()?.bytes;
            return Some(self.reply(bytes, now_ns));
        }
        self.turn = None;
        if id != self.id() && id != BROADCAST {
            return None;
        }
        front.latch(now_ns);
        let instruction = Instruction::from_byte(code);
        match (instruction, params) {
            (Some(Instruction::SyncRead), [address, len, ids @ ..]) if id == BROADCAST => {
                return self.sync_read(*address, *len, ids, now_ns, front);
            }
            (Some(Instruction::SyncWrite), [address, len, entries @ ..]) if id == BROADCAST => {
                for entry in entries.chunks_exact(usize::from(*len) + 1) {
                    if entry[0] == self.id() {
                        self.write(usize::from(*address), &entry[1..], front);
                    }
                }
                return None;
            }
            _ => {}
        }
        let (answer, always) = self.carry_out(instruction, params, front);
        let quiet = id == BROADCAST && instruction != Some(Instruction::Ping);
        if quiet || (!always && self.table[at::LEVEL] == 0) {
            return None;
        }
        Some(self.reply(answer?, now_ns))
    }

    fn reply(&self, bytes: PacketBuf, now_ns: u64) -> Reply {
        Reply {
            bytes,
            send_at_ns: now_ns + u64::from(self.table[at::DELAY]) * 2_000,
        }
    }

    /// The answer, and whether it is given at every status return level.
    fn carry_out(
        &mut self,
        instruction: Option<Instruction>,
        params: &[u8],
        front: &mut Front<'_>,
    ) -> (Option<PacketBuf>, bool) {
        let own = self.id();
        match (instruction, params) {
            (Some(Instruction::Ping), _) => (self.status(own, &[], front), true),
            (Some(Instruction::Read), &[address, len]) => (self.read(address, len, front), true),
            (Some(Instruction::Write), [address, bytes @ ..]) => {
                self.write(usize::from(*address), bytes, front);
                // Under the id that the request named.
                (self.status(own, &[], front), false)
            }
            (Some(Instruction::RegWrite), [address, bytes @ ..]) => {
                self.registered = Some((usize::from(*address), bytes.to_vec()));
                (self.status(own, &[], front), false)
            }
            (Some(Instruction::Action), _) => {
                if let Some((address, bytes)) = self.registered.take() {
                    self.write(address, &bytes, front);
                }
                (self.status(own, &[], front), false)
            }
            (Some(Instruction::Reboot), _) => {
                let answer = self.status(own, &[], front);
                front.reboot();
                self.restart();
                (answer, false)
            }
            (Some(Instruction::FactoryReset), _) => {
                let answer = self.status(own, &[], front);
                let (id, baud) = (self.kept[at::ID], self.kept[at::BAUD]);
                self.kept = self.factory;
                (self.kept[at::ID], self.kept[at::BAUD]) = (id, baud);
                // Never refused by this driver.
                let _ = front.factory_reset(Keep::IdAndBaud);
                self.restart();
                (answer, false)
            }
            _ => (error_answer(own), false),
        }
    }

    fn sync_read(
        &mut self,
        address: u8,
        len: u8,
        ids: &[u8],
        now_ns: u64,
        front: &mut Front<'_>,
    ) -> Option<Reply> {
        if !self.profile.info().sync_read {
            return None;
        }
        let place = ids.iter().position(|id| *id == self.id())?;
        let bytes = self.read(address, len, front)?;
        if place == 0 {
            return Some(self.reply(bytes, now_ns));
        }
        self.turn = Some(Turn {
            ahead: ids[..place].to_vec(),
            bytes,
            deadline_ns: u64::MAX,
        });
        None
    }

    fn read(&mut self, address: u8, len: u8, front: &mut Front<'_>) -> Option<PacketBuf> {
        self.refresh(front);
        let from = usize::from(address);
        match self.table.get(from..from + usize::from(len)) {
            Some(bytes) => self.status(self.id(), bytes, front),
            None => error_answer(self.id()),
        }
    }

    /// An answer with the state of the hardware as its error bits.
    fn status(&self, id: u8, data: &[u8], front: &Front<'_>) -> Option<PacketBuf> {
        answer(id, hardware_bits(front), data)
    }

    /// Carries live values over into the table.
    fn refresh(&mut self, front: &Front<'_>) {
        let readings = *front.driver.readings();
        let step = self.step_rad();
        let speed = (readings.velocity_rad_s / step) as i32;
        let load = (readings.duty * 1000.0) as i32;
        let count_a = f64::from(self.profile.info().units.ma_per_100) * 1e-5;
        self.put_angle(at::POSITION, readings.position_rad);
        if front.driver.torque_on() {
            self.put_angle(at::GOAL, front.driver.goal_rad());
        }
        self.put(at::VELOCITY, 2, Sign::Magnitude(15), speed);
        self.put(at::LOAD, 2, Sign::Magnitude(10), load);
        self.put(
            at::CURRENT,
            2,
            Sign::Magnitude(15),
            (readings.current_a / count_a) as i32,
        );
        self.table[at::VOLTAGE] = libm::round(readings.bus_v * 10.0).clamp(0.0, 255.0) as u8;
        self.table[at::TEMPERATURE] = libm::round(readings.case_c).clamp(0.0, 255.0) as u8;
        self.table[at::REGISTERED] = u8::from(self.registered.is_some());
        self.table[at::STATUS] = hardware_bits(front);
        self.table[at::MOVING] = u8::from(speed != 0);
        self.table[at::TORQUE] = u8::from(front.driver.torque_on());
    }

    /// Writes bytes; those that are read only, or beyond the table, are left out, as in the servo.
    fn write(&mut self, address: usize, bytes: &[u8], front: &mut Front<'_>) {
        let end = address + bytes.len();
        for (place, byte) in (address..).zip(bytes) {
            if (at::ID..at::READ_ONLY).contains(&place) {
                self.table[place] = *byte;
                if place < RAM && self.table[self.lock()] == 0 {
                    self.kept[place] = *byte;
                }
            }
        }
        let touches = |register: usize, len: usize| address < register + len && register < end;
        if touches(at::SPEED, 2) {
            let speed = f64::from(self.get(at::SPEED, Sign::None)) * self.step_rad();
            let counts = libm::round(speed / units::X_RAD_S_PER_VELOCITY_COUNT) as i32;
            let _ = front.write(Register::ProfileVelocity, counts.clamp(0, 32_767));
        }
        if touches(at::TORQUE, 1) {
            let on = i32::from(self.table[at::TORQUE] == 1);
            // Refused while an error is latched: the torque register reads 0 then.
            let _ = front.write(Register::TorqueEnable, on);
        }
        if touches(at::GOAL, 2) {
            let _ = front.driver.set_goal(self.goal_rad(), front.now_ns());
        }
    }

    /// The goal in the table, within the angle limits where there are any [rad].
    fn goal_rad(&self) -> f64 {
        let min = self.get(at::LIMITS, Sign::None);
        let max = self.get(at::LIMITS + 2, Sign::None);
        let goal = self.get(at::GOAL, self.sign());
        let turns = self.profile == Profile::Sts && min == 0 && max == 0;
        let counts = if turns {
            goal
        } else {
            goal.clamp(min, max.max(min))
        };
        f64::from(counts) * self.step_rad() - self.middle_rad()
    }

    fn put_angle(&mut self, address: usize, angle_rad: f64) {
        let counts = libm::round((angle_rad + self.middle_rad()) / self.step_rad()) as i32;
        let units = self.profile.info().units;
        let counts = counts.clamp(units.min_counts, units.max_counts);
        self.put(address, 2, self.sign(), counts);
    }

    fn counts(&self) -> i32 {
        self.profile.info().units.counts
    }

    fn step_rad(&self) -> f64 {
        let units = self.profile.info().units;
        f64::from(units.turn_urad) * 1e-6 / f64::from(units.counts)
    }

    fn middle_rad(&self) -> f64 {
        match self.profile {
            Profile::Scs => SCS_MIDDLE_RAD,
            _ => 0.0,
        }
    }

    fn sign(&self) -> Sign {
        match self.profile {
            Profile::Scs => Sign::None,
            _ => Sign::Magnitude(15),
        }
    }

    fn order(&self) -> Order {
        match self.profile {
            Profile::Scs => Order::Big,
            _ => Order::Little,
        }
    }

    /// Address of the EEPROM lock.
    fn lock(&self) -> usize {
        match self.profile {
            Profile::Scs => 48,
            _ => 55,
        }
    }

    fn field(&self, address: usize, len: u8, sign: Sign) -> Field {
        Field {
            address: address as u16,
            len,
            order: self.order(),
            sign,
        }
    }

    fn put(&mut self, address: usize, len: u8, sign: Sign, value: i32) {
        let bytes = self.field(address, len, sign).bytes_of(value);
        let len = usize::from(len);
        self.table[address..address + len].copy_from_slice(&bytes[..len]);
    }

    fn get(&self, address: usize, sign: Sign) -> i32 {
        self.field(address, 2, sign)
            .value_of(&self.table[address..])
    }
}

/// Bits of register 65 and of answers (protocol manual, 1.3): 0 voltage, 1 angle sensor, 2 temperature, 5 overload.
fn hardware_bits(front: &Front<'_>) -> u8 {
    use super::error_bit::{ENCODER, INPUT_VOLTAGE, OVERHEATING, OVERLOAD};
    let error = front.driver.hardware_error();
    [
        (INPUT_VOLTAGE, 0),
        (ENCODER, 1),
        (OVERHEATING, 2),
        (OVERLOAD, 5),
    ]
    .into_iter()
    .fold(0, |bits, (from, to)| {
        bits | u8::from(error & from != 0) << to
    })
}

fn error_answer(id: u8) -> Option<PacketBuf> {
    answer(id, ERROR_INSTRUCTION, &[])
}

fn answer(id: u8, error: u8, data: &[u8]) -> Option<PacketBuf> {
    let bytes = packet(id, error, &[data]).ok()?;
    FixedVec::from_slice(&bytes).ok()
}
