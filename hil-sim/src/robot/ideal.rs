//! Drivers without motors behind them: they answer at once and stand where they are told. Fast, for tests of everything
//! but motion; the real emulation is [`crate::world::World`].

mod driver;

use super::wire::{MotorBus, Received};
use crate::bus::{Bus, BusParams, Talker};
use crate::rng::Rng;
use driver::Ideal;
use protocol::bus::Register;
use protocol::bus::server::{DriverHandler, DriverServer};
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

/// What the wire does to everything on it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Noise {
    /// Share of answers that are lost whole.
    pub reply_loss: f64,
    /// Share of bytes in which one bit flips, for everybody on the wire.
    pub corruption: f64,
    /// Somebody sends bursts that nobody asked for.
    pub babble: bool,
}

impl Noise {
    /// Whether the wire carries everything as it is.
    #[must_use]
    pub fn is_quiet(&self) -> bool {
        *self == Self::default()
    }
}

/// Stream number of the noise on the wire.
const PURPOSE_NOISE: u64 = 0x1D;
/// Bytes of a burst of babble: a short packet.
const BURST_BYTES: usize = 12;
/// From one burst to the next, ns.
const BURST_EVERY_NS: u64 = 700_000;

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

/// Ideal drivers, ids from 1 on, on a bus with byte times.
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
    noise: Noise,
    rng: Rng,
    burst_ns: u64,
    /// Bytes that pass at once.
    run: Vec<u8>,
}

impl IdealMotors {
    /// Six of them, all present, at their zero, torque off.
    #[must_use]
    pub fn new(echo: bool) -> Self {
        Self::of(6, echo)
    }

    /// So many of them, all present, at their zero, torque off.
    #[must_use]
    pub fn of(drivers: u8, echo: bool) -> Self {
        let params = BusParams {
            echo,
            ..BusParams::default()
        };
        Self {
            bus: Bus::new(params, 0),
            drivers: (1..=drivers)
                .map(|id| (DriverServer::new(10_000), Ideal::new(id)))
                .collect(),
            inbox: VecDeque::new(),
            now_ns: 0,
            babbling: false,
            drop_every: 0,
            heard: 0,
            stall_ns: 0,
            noise: Noise::default(),
            rng: Rng::new(0, PURPOSE_NOISE, 0),
            burst_ns: 0,
            run: Vec::new(),
        }
    }

    /// Other chance from here on.
    pub fn reseed(&mut self, seed: u64) {
        self.rng = Rng::new(seed, PURPOSE_NOISE, 0);
    }

    /// What the wire does from now on.
    pub fn set_noise(&mut self, noise: Noise) {
        self.noise = noise;
        self.burst_ns = self.now_ns;
    }

    /// The drivers take their time to where they are told, rad/s.
    pub fn set_speed(&mut self, speed_rad_s: u32) {
        for (_, driver) in &mut self.drivers {
            driver.speed_rad_s = Some(speed_rad_s);
        }
    }

    /// The clock of a driver against true time.
    pub fn set_clock(&mut self, joint: usize, ratio: f64) {
        self.drivers[joint].1.clock_ratio = ratio;
    }

    /// Packets that set the watchdog of a driver are lost from now on, or no longer.
    pub fn forget_watchdogs(&mut self, joint: usize, lost: bool) {
        self.drivers[joint].1.forgets_watchdogs = lost;
    }

    /// Packets that take the torque of a driver are lost from now on, or no longer.
    pub fn keep_torque(&mut self, joint: usize, lost: bool) {
        self.drivers[joint].1.keeps_torque = lost;
    }

    /// Whether a driver lets go by itself when nobody talks to it any more.
    #[must_use]
    pub fn has_watchdog(&self, joint: usize) -> bool {
        self.drivers[joint].1.watchdog_ns.is_some()
    }

    /// The module's next packet keeps its task this much longer: an overrun of the cycle.
    pub fn stall_once(&mut self, stall_us: u64) {
        self.stall_ns = stall_us * 1000;
    }

    /// How much longer the packet that was just sent keeps the module's task, ns.
    pub(crate) fn take_stall(&mut self) -> u64 {
        std::mem::take(&mut self.stall_ns)
    }

    /// A packet of the master on the wire. Returns the end of its last stop bit, ns.
    pub(crate) fn put(&mut self, now_ns: u64, bytes: &[u8]) -> u64 {
        self.run_to(now_ns);
        self.bus.send(now_ns, Talker::Master, bytes)
    }

    /// Gives a driver a trouble, or takes it away.
    pub fn trouble(&mut self, joint: usize, trouble: Trouble) {
        self.drivers[joint].1.trouble = trouble;
        self.drivers[joint].1.frozen = None;
    }

    /// As [`IdealMotors::trouble`], but a trouble that goes on goes on as it is.
    pub fn set_trouble(&mut self, joint: usize, trouble: Trouble) {
        if self.drivers[joint].1.trouble != trouble {
            self.trouble(joint, trouble);
        }
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
        driver.torque && !driver.tripped && !driver.starves(self.now_ns)
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

    /// Puts a burst of babble on the wire.
    fn burst(&mut self) {
        let burst: [u8; BURST_BYTES] = std::array::from_fn(|_| self.rng.next_u64() as u8);
        let stranger = Talker::Driver(usize::MAX);
        self.bus.send(self.burst_ns, stranger, &burst);
        self.burst_ns += BURST_EVERY_NS;
    }

    /// The byte as everybody on the wire receives it.
    fn disturb(&mut self, byte: u8) -> u8 {
        let flipped = if self.rng.chance(self.noise.corruption) {
            1 << (self.rng.next_u64() % 8)
        } else {
            0
        };
        byte ^ flipped ^ if self.babbling { 0x5A } else { 0 }
    }

    /// Everything until `now_ns`, in order of time: however often somebody looks, the same happens.
    fn run_to(&mut self, now_ns: u64) {
        loop {
            let burst_ns = self.burst_due_ns().unwrap_or(u64::MAX);
            let deadline_ns = self.deadline_ns().unwrap_or(u64::MAX);
            let byte_ns = self.bus.next_delivery_ns().unwrap_or(u64::MAX);
            if burst_ns.min(deadline_ns).min(byte_ns) > now_ns {
                break;
            }
            if burst_ns <= byte_ns.min(deadline_ns) {
                self.burst();
            } else if byte_ns <= deadline_ns {
                let before_ns = burst_ns.min(deadline_ns).saturating_sub(1);
                if !self.pass_run(byte_ns, before_ns.min(now_ns)) {
                    self.pass_byte(byte_ns);
                }
            } else {
                self.answer_late(deadline_ns);
            }
        }
        self.now_ns = self.now_ns.max(now_ns);
    }

    fn burst_due_ns(&self) -> Option<u64> {
        self.noise.babble.then_some(self.burst_ns)
    }

    fn deadline_ns(&self) -> Option<u64> {
        let deadlines = self.drivers.iter();
        deadlines
            .filter_map(|(server, _)| server.deadline_ns())
            .min()
    }

    /// Bytes to which nobody can answer yet pass at once. False where they have to pass one by one.
    fn pass_run(&mut self, first_ns: u64, until_ns: u64) -> bool {
        if self.babbling || self.drop_every != 0 || self.noise.corruption > 0.0 {
            return false;
        }
        let Some(from) = self.bus.next_talker() else {
            return false;
        };
        let hears = |(index, (_, driver)): &(usize, &mut (DriverServer, Ideal))| {
            from != Talker::Driver(*index) && driver.trouble != Trouble::Missing
        };
        let hearing = self.drivers.iter_mut().enumerate().filter(hears);
        let quiet = hearing.map(|(_, (server, _))| server.quiet_bytes(first_ns));
        let most = quiet.min().unwrap_or(0);
        self.run.clear();
        let Some(last_ns) = self.bus.deliver_run(until_ns, most, &mut self.run) else {
            return false;
        };
        for (_, (server, _)) in self.drivers.iter_mut().enumerate().filter(hears) {
            server.push_quiet(&self.run, last_ns);
        }
        if from != Talker::Master || self.bus.params().echo {
            self.heard += self.run.len() as u64;
            let bytes = self.run.iter();
            self.inbox
                .extend(bytes.map(|byte| (last_ns, Received::Byte(*byte))));
        }
        true
    }

    /// The next byte on the wire has passed.
    fn pass_byte(&mut self, at_ns: u64) {
        let Some(delivery) = self.bus.deliver(at_ns) else {
            return;
        };
        let byte = self.disturb(delivery.byte);
        for index in 0..self.drivers.len() {
            let own = delivery.from == Talker::Driver(index);
            let (server, driver) = &mut self.drivers[index];
            if own || driver.trouble == Trouble::Missing {
                continue;
            }
            let mute = driver.trouble == Trouble::Mute;
            let Some(reply) = server.push(byte, delivery.at_ns, driver) else {
                continue;
            };
            if !mute && !self.rng.chance(self.noise.reply_loss) {
                let send_at_ns = reply.send_at_ns.max(delivery.at_ns);
                self.bus
                    .send(send_at_ns, Talker::Driver(index), &reply.bytes);
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

    /// Drivers that have waited long enough for those ahead of them.
    fn answer_late(&mut self, at_ns: u64) {
        for index in 0..self.drivers.len() {
            let (server, driver) = &mut self.drivers[index];
            let quiet = matches!(driver.trouble, Trouble::Missing | Trouble::Mute);
            if let Some(reply) = server.poll(at_ns).filter(|_| !quiet) {
                let send_at_ns = reply.send_at_ns.max(at_ns);
                self.bus
                    .send(send_at_ns, Talker::Driver(index), &reply.bytes);
            }
        }
    }
}

impl MotorBus for IdealMotors {
    fn transmit(&mut self, now_ns: u64, bytes: &[u8]) -> u64 {
        self.put(now_ns, bytes) + self.take_stall()
    }

    fn receive(&mut self, now_ns: u64, into: &mut VecDeque<Received>) {
        self.run_to(now_ns);
        into.extend(self.inbox.drain(..).map(|(_, received)| received));
    }

    fn advance(&mut self, now_ns: u64) {
        self.run_to(now_ns);
    }

    fn next_event_ns(&self) -> Option<u64> {
        [
            self.deadline_ns(),
            self.burst_due_ns(),
            self.bus.next_delivery_ns(),
        ]
        .into_iter()
        .flatten()
        .filter(|at| *at > self.now_ns)
        .min()
    }

    fn next_pause_ns(&self, count: usize, idle_ns: u64) -> Option<u64> {
        if self.babbling {
            return self.next_event_ns();
        }
        [
            self.deadline_ns(),
            self.burst_due_ns(),
            self.bus.pause_ns(count, idle_ns),
        ]
        .into_iter()
        .flatten()
        .filter(|at| *at > self.now_ns)
        .min()
    }

    fn wire(&self) -> Option<&Bus> {
        (self.drop_every == 0 && !self.babbling && self.noise.is_quiet()).then_some(&self.bus)
    }
}
