//! Drivers without motors behind them: they answer at once and stand where they are told. Fast, for tests of everything
//! but motion; the real emulation is [`crate::world::World`].

use super::wire::{MotorBus, Received};
use crate::bus::{Bus, BusParams, Talker};
use protocol::bus::feedback::status;
use protocol::bus::server::{DriverHandler, DriverServer};
use protocol::bus::{PackedFeedback, Register, RegisterFile, StatusError};
use std::collections::VecDeque;

/// What happens to a driver or to its bytes; tests set it, at any time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trouble {
    /// Works.
    None,
    /// Unplugged: hears nothing, says nothing.
    Missing,
    /// Hears, but every answer is lost.
    Mute,
    /// Its position reading jumps by this much, urad.
    Jump(i32),
    /// The measurement stands still: same tick, same position.
    Frozen,
    /// Applies another set-point than it was sent, urad away.
    WrongGoal(i32),
}

/// One set-point that a driver took.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Taken {
    /// When, ns.
    pub at_ns: u64,
    /// Joint.
    pub joint: usize,
    /// Driver's frame, urad.
    pub goal_urad: i32,
    /// Where the joint stood, urad.
    pub from_urad: i32,
    /// Whether torque was on.
    pub torque: bool,
}

/// State of one driver.
#[derive(Debug, Clone)]
struct Ideal {
    registers: RegisterFile,
    now_ns: u64,
    boot_ns: u64,
    goal_urad: i32,
    position_urad: i32,
    torque: bool,
    boots: u8,
    trouble: Trouble,
    frozen: Option<PackedFeedback>,
    joint: usize,
    taken: Vec<Taken>,
    heard_ns: u64,
    watchdog_ns: Option<u64>,
    tripped: bool,
}

impl Ideal {
    fn new(id: u8) -> Self {
        let mut registers = RegisterFile::new();
        registers.set(Register::Id, i32::from(id));
        Self {
            registers,
            now_ns: 0,
            boot_ns: 0,
            goal_urad: 0,
            position_urad: 0,
            torque: false,
            boots: 1,
            trouble: Trouble::None,
            frozen: None,
            joint: usize::from(id) - 1,
            taken: Vec::new(),
            heard_ns: 0,
            watchdog_ns: None,
            tripped: false,
        }
    }

    fn watch(&mut self, now_ns: u64) {
        if self
            .watchdog_ns
            .is_some_and(|limit_ns| now_ns.saturating_sub(self.heard_ns) > limit_ns)
        {
            self.tripped = true;
        }
    }

    fn status(&self) -> u8 {
        let mut bits = 0;
        for (bit, set) in [
            (status::TORQUE, self.torque),
            (status::WATCHDOG, self.tripped),
            (
                status::HARDWARE_ERROR,
                self.registers.get(Register::HardwareError) != 0,
            ),
        ] {
            bits |= if set { bit } else { 0 };
        }
        bits
    }
}

impl DriverHandler for Ideal {
    fn latch(&mut self, now_ns: u64) {
        self.watch(now_ns);
        self.now_ns = now_ns;
        self.heard_ns = now_ns;
    }

    fn read(&self, register: Register) -> i32 {
        match register {
            Register::TorqueEnable => i32::from(self.torque),
            Register::GoalAngle => self.goal_urad,
            Register::PresentAngle => self.position_urad,
            Register::BootCount => i32::from(self.boots),
            other => self.registers.get(other),
        }
    }

    fn feedback(&mut self) -> PackedFeedback {
        let applied_urad = if self.torque {
            self.goal_urad
        } else {
            self.position_urad
        };
        let mut feedback = PackedFeedback {
            tick_4us: ((self.now_ns - self.boot_ns) / 4000) as u16,
            applied_urad,
            position_urad: self.position_urad,
            voltage_5mv: 1480,
            temperature_c: 25,
            status: self.status(),
            boots: self.boots & 7,
            ..PackedFeedback::default()
        };
        match self.trouble {
            Trouble::Jump(by_urad) => feedback.position_urad += by_urad,
            Trouble::WrongGoal(by_urad) => feedback.applied_urad += by_urad,
            Trouble::Frozen => feedback = *self.frozen.get_or_insert(feedback),
            Trouble::None | Trouble::Missing | Trouble::Mute => {}
        }
        feedback
    }

    fn write(&mut self, register: Register, value: i32) -> Result<(), StatusError> {
        match register {
            Register::GoalAngle if self.tripped => return Err(StatusError::Access),
            Register::GoalAngle => {
                self.goal_urad = value;
                self.taken.push(Taken {
                    at_ns: self.now_ns,
                    joint: self.joint,
                    goal_urad: value,
                    from_urad: self.position_urad,
                    torque: self.torque,
                });
                if self.torque {
                    self.position_urad = value;
                }
            }
            Register::TorqueEnable => {
                let on = value == 1;
                if on && self.registers.get(Register::HardwareError) != 0 {
                    return Err(StatusError::Access);
                }
                if on && !self.torque {
                    self.goal_urad = self.position_urad;
                }
                self.torque = on;
            }
            Register::BusWatchdog => {
                self.tripped = false;
                self.watchdog_ns = (value > 0).then_some(value as u64 * 20_000_000);
            }
            other => self.registers.set(other, value),
        }
        Ok(())
    }

    fn reboot(&mut self) {
        self.registers.restart();
        self.torque = false;
        self.boots = self.boots.wrapping_add(1);
        self.boot_ns = self.now_ns;
        self.watchdog_ns = None;
        self.tripped = false;
        self.position_urad = 0;
    }
}

/// Six ideal drivers, ids 1..=6, on a bus with byte times.
#[derive(Debug, Clone)]
pub struct IdealMotors {
    bus: Bus,
    drivers: Vec<(DriverServer, Ideal)>,
    inbox: VecDeque<(u64, Received)>,
    now_ns: u64,
    /// Bytes of master and drivers are replaced by noise.
    babbling: bool,
    /// Drop every n-th byte that the master would receive; 0 = none.
    drop_every: u64,
    heard: u64,
    stall_ns: u64,
}

impl IdealMotors {
    /// All six present, at their zero, torque off.
    #[must_use]
    pub fn new(echo: bool) -> Self {
        let params = BusParams {
            echo,
            ..BusParams::default()
        };
        Self {
            bus: Bus::new(params, 0),
            drivers: (1..=6)
                .map(|id| (DriverServer::new(10_000), Ideal::new(id)))
                .collect(),
            inbox: VecDeque::new(),
            now_ns: 0,
            babbling: false,
            drop_every: 0,
            heard: 0,
            stall_ns: 0,
        }
    }

    /// The module's next packet keeps its task this much longer: an overrun of the cycle.
    pub fn stall_once(&mut self, stall_us: u64) {
        self.stall_ns = stall_us * 1000;
    }

    /// Gives a driver a trouble, or takes it away.
    pub fn trouble(&mut self, joint: usize, trouble: Trouble) {
        self.drivers[joint].1.trouble = trouble;
        self.drivers[joint].1.frozen = None;
    }

    /// A driver restarts: torque off, zero lost.
    pub fn restart(&mut self, joint: usize) {
        self.drivers[joint].1.now_ns = self.now_ns;
        self.drivers[joint].1.reboot();
    }

    /// Latches a hardware error: torque goes off, as in a real driver.
    pub fn hardware_error(&mut self, joint: usize, bits: u8) {
        let driver = &mut self.drivers[joint].1;
        driver
            .registers
            .set(Register::HardwareError, i32::from(bits));
        driver.torque &= bits == 0;
    }

    /// Somebody talks nonsense all the time.
    pub fn babble(&mut self, on: bool) {
        self.babbling = on;
    }

    /// Loses every n-th byte towards the master; 0 = none.
    pub fn drop_every(&mut self, n: u64) {
        self.drop_every = n;
    }

    /// Places a joint, by hand.
    pub fn place(&mut self, joint: usize, position_urad: i32) {
        self.drivers[joint].1.position_urad = position_urad;
    }

    /// Where a joint stands, driver's frame, urad.
    #[must_use]
    pub fn position_urad(&self, joint: usize) -> i32 {
        self.drivers[joint].1.position_urad
    }

    /// Whether a driver's torque is on and its watchdog content.
    #[must_use]
    pub fn is_driving(&self, joint: usize) -> bool {
        let driver = &self.drivers[joint].1;
        let starved = driver
            .watchdog_ns
            .is_some_and(|limit_ns| self.now_ns.saturating_sub(driver.heard_ns) > limit_ns);
        driver.torque && !driver.tripped && !starved
    }

    /// Whether a driver's torque is on.
    #[must_use]
    pub fn torque(&self, joint: usize) -> bool {
        self.drivers[joint].1.torque
    }

    /// Every set-point a driver took while its torque was on or off, oldest first.
    #[must_use]
    pub fn taken(&self, joint: usize) -> Vec<Taken> {
        self.drivers[joint].1.taken.clone()
    }

    fn run_to(&mut self, now_ns: u64) {
        while let Some(delivery) = self.bus.deliver(now_ns) {
            let byte = if self.babbling {
                delivery.byte ^ 0x5A
            } else {
                delivery.byte
            };
            for index in 0..self.drivers.len() {
                let own = delivery.from == Talker::Driver(index);
                let (server, driver) = &mut self.drivers[index];
                if own || driver.trouble == Trouble::Missing {
                    continue;
                }
                let reply = server.push(byte, delivery.at_ns, driver);
                let mute = driver.trouble == Trouble::Mute;
                if let Some(reply) = reply.filter(|_| !mute) {
                    self.bus.send(
                        reply.send_at_ns.max(delivery.at_ns),
                        Talker::Driver(index),
                        &reply.bytes,
                    );
                }
            }
            let heard = delivery.from != Talker::Master || self.bus.params().echo || self.babbling;
            if heard {
                self.heard += 1;
                let lost = self.drop_every != 0 && self.heard.is_multiple_of(self.drop_every);
                let received = if delivery.clean {
                    Received::Byte(byte)
                } else {
                    Received::Spoiled
                };
                if !lost {
                    self.inbox.push_back((delivery.at_ns, received));
                }
            }
        }
        for index in 0..self.drivers.len() {
            let (server, driver) = &mut self.drivers[index];
            let at_ns = server.deadline_ns().unwrap_or(u64::MAX);
            let quiet = matches!(driver.trouble, Trouble::Missing | Trouble::Mute);
            if at_ns <= now_ns
                && let Some(reply) = server.poll(now_ns)
                && !quiet
            {
                self.bus.send(
                    reply.send_at_ns.max(now_ns),
                    Talker::Driver(index),
                    &reply.bytes,
                );
            }
        }
        self.now_ns = self.now_ns.max(now_ns);
    }
}

impl MotorBus for IdealMotors {
    fn transmit(&mut self, now_ns: u64, bytes: &[u8]) -> u64 {
        self.run_to(now_ns);
        self.bus.send(now_ns, Talker::Master, bytes) + std::mem::take(&mut self.stall_ns)
    }

    fn receive(&mut self, now_ns: u64, into: &mut VecDeque<Received>) {
        self.run_to(now_ns);
        into.extend(self.inbox.drain(..).map(|(_, received)| received));
    }

    fn advance(&mut self, now_ns: u64) {
        self.run_to(now_ns);
    }

    fn next_event_ns(&self) -> Option<u64> {
        let deadlines = self
            .drivers
            .iter()
            .filter_map(|(server, _)| server.deadline_ns());
        deadlines
            .chain(self.bus.next_delivery_ns())
            .filter(|at| *at > self.now_ns)
            .min()
    }

    fn wire(&self) -> Option<&Bus> {
        (self.drop_every == 0 && !self.babbling).then_some(&self.bus)
    }
}
