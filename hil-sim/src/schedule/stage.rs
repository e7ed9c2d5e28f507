//! The engine of a schedule: moves faults, hosts, links and the robot through virtual time.

mod strikes;

use super::channel::Channel;
use super::desk::{Desk, Hand};
use super::fault::{Fault, KINDS, Kind};
use super::gaits;
use super::laws::{Counts, Law, Laws, Violation};
use super::plan::Plan;
use super::wire::Watched;
use crate::robot::flash::RamFlash;
use crate::robot::host::SimHost;
use crate::robot::ideal::IdealMotors;
use crate::robot::{EmulatedRobot, Setup};
use firmware::ports::ResetCause;
use firmware::slots::Slots;
use protocol::link::{Digest, KEY_LEN, Key, ToModule, WireGait};
use std::cell::RefCell;
use std::future::Future;
use std::pin::Pin;
use std::rc::Rc;
use std::sync::LazyLock;
use std::task::{Context, Waker};

/// The key of the robots that have one.
const KEY: Key = Key([0x5C; KEY_LEN]);
/// Longest step, us: how late a host sees its bytes.
const STEP_US: u64 = 5_000;
/// After the faults: long enough for the longest lease, ramp and hold, us.
const TAIL_US: u64 = 3_400_000;
/// Time a robot gets to run again after the faults, us.
const BACK_US: u64 = 40_000_000;
/// After a stall the watchdog may still bite for this time, us.
const WATCHDOG_US: u64 = 450_000;
/// What is held back on the bus arrives no later than this, us: 15 ms at the most, and a look of 5 ms.
const HELD_BACK_US: u64 = 20_000;
/// A cycle that stood still goes on to its end and sees no STOP before the next, us: packets rest on its readings for half a cycle.
const REST_OF_CYCLE_US: u64 = 25_000;
/// Battery without trouble, mV.
const BATTERY_MV: f64 = 7_400.0;

/// What came of a schedule.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// The first law that did not hold.
    pub broken: Option<Violation>,
    /// Hash over every packet of the module and everything the hosts noted.
    pub trace: u64,
    /// Virtual time, us.
    pub virtual_us: u64,
    /// Faults that struck, by kind.
    pub struck: [u32; KINDS],
    /// How much was looked at.
    pub counts: Counts,
}

type Life = Pin<Box<dyn Future<Output = ()>>>;

/// A host program, or the place of one that is dead.
struct Host {
    desk: Rc<RefCell<Desk>>,
    life: Option<Life>,
    link: usize,
    lives: u64,
}

struct Stage<'a> {
    plan: &'a Plan,
    robot: EmulatedRobot<Watched>,
    channels: [Channel; 2],
    hosts: Vec<Host>,
    laws: Laws,
    active: Vec<bool>,
    stop_us: Option<u64>,
    resets: u32,
    watchdog_until_us: u64,
    trace: u64,
    struck: [u32; KINDS],
}

/// The flash of a robot that was commissioned: two gaits, and the key or none.
static BORN: LazyLock<[RamFlash; 2]> = LazyLock::new(|| [false, true].map(born));

fn born(keyed: bool) -> RamFlash {
    let mut robot = EmulatedRobot::with_motors(setup(0, 0), IdealMotors::new(false));
    let mut host = SimHost::new(robot.link());
    host.home(&mut robot).expect("a new robot");
    for slot in 0..2 {
        host.upload(&mut robot, slot, gaits::gait(usize::from(slot)))
            .expect("a clear gait");
    }
    if keyed {
        let key = ToModule::SetKey { key: KEY };
        host.ask(&mut robot, &key).expect("over the cable");
    }
    robot.flash().borrow().clone()
}

fn setup(seed: u64, link_byte_ns: u64) -> Setup {
    Setup {
        seed,
        link_byte_ns,
        radio: true,
        ..Setup::default()
    }
}

/// Plays a schedule to its end or to the first law that does not hold.
#[must_use]
pub fn play(plan: &Plan) -> Outcome {
    let mut stage = Stage::new(plan);
    stage.act(plan.active_us);
    stage.heal();
    if plan.comes_back {
        stage.come_back();
    } else {
        stage.hosts.clear();
        stage.act(plan.active_us + TAIL_US);
    }
    stage.check_flash();
    Outcome {
        broken: stage.laws.broken,
        trace: stage.trace,
        virtual_us: stage.robot.now_us(),
        struck: stage.struck,
        counts: stage.laws.counts,
    }
}

impl<'a> Stage<'a> {
    fn new(plan: &'a Plan) -> Self {
        let flash = BORN[usize::from(plan.keyed)].clone();
        let mut motors = Watched::new(plan.seed);
        for (joint, home_urad) in plan.home_urad.iter().enumerate() {
            motors.motors.place(joint, *home_urad);
        }
        let robot = EmulatedRobot::with_flash(setup(plan.seed, plan.byte_ns), motors, flash);
        robot.flash().borrow_mut().reseed(plan.seed);
        let held = [0, 1].map(|slot| (slot, WireGait::from(gaits::gait(slot)).digest()));
        let channels = [
            Channel::new(robot.link(), plan.seed, 0),
            Channel::new(robot.radio(), plan.seed, 1),
        ];
        let mut stage = Self {
            plan,
            robot,
            channels,
            hosts: Vec::new(),
            laws: Laws::new(plan.keyed, plan.home_urad, &held),
            active: vec![false; plan.faults.len()],
            stop_us: None,
            resets: 0,
            watchdog_until_us: 0,
            trace: 0xCBF2_9CE4_8422_2325,
            struck: [0; KINDS],
        };
        // With a key the owner may sit at the radio as well.
        let link = usize::from(plan.keyed && plan.seed.is_multiple_of(2));
        stage.hosts.push(stage.host(0, link));
        stage.hosts.push(stage.host(1, 1 - link));
        stage.start(0);
        stage
    }

    fn host(&self, number: u64, link: usize) -> Host {
        Host {
            desk: Rc::new(RefCell::new(Desk::new(self.plan.seed, number, 0, None))),
            life: None,
            link,
            lives: 0,
        }
    }

    /// Starts the program of a host anew.
    fn start(&mut self, number: usize) {
        let key = self.plan.keyed.then_some(KEY);
        let now_us = self.robot.now_us();
        let Some(host) = self.hosts.get_mut(number) else {
            return;
        };
        host.lives += 1;
        let mut desk = Desk::new(self.plan.seed, number as u64, host.lives, key);
        desk.clock_ratio = host.desk.borrow().clock_ratio;
        (desk.now_us, desk.resets) = (now_us, self.resets);
        host.desk = Rc::new(RefCell::new(desk));
        let hand = Hand(host.desk.clone());
        host.life = Some(match number {
            0 => Box::pin(hand.owner()),
            _ => Box::pin(hand.visitor()),
        });
    }

    /// Goes on until `until_us`.
    fn act(&mut self, until_us: u64) {
        while self.robot.now_us() < until_us && self.laws.broken.is_none() {
            self.step(until_us);
        }
    }

    fn step(&mut self, until_us: u64) {
        let now_us = self.robot.now_us();
        self.switch_faults(now_us);
        self.move_bytes(now_us);
        self.move_hosts(now_us);
        let next_us = self.next_us(now_us, until_us);
        self.robot.run_until_cut(next_us);
        self.note_power();
        self.look();
    }

    fn next_us(&self, now_us: u64, until_us: u64) -> u64 {
        let edges = self.plan.faults.iter().flat_map(|f| [f.from_us, f.to_us]);
        let channels = self.channels.iter().filter_map(Channel::next_us);
        let hosts = self.hosts.iter().filter(|host| host.life.is_some());
        let hosts = hosts.map(|host| host.desk.borrow().wake_us);
        let all = edges.chain(channels).chain(hosts).filter(|at| *at > now_us);
        all.min()
            .unwrap_or(u64::MAX)
            .min(now_us + STEP_US)
            .min(until_us)
            .max(now_us + 1)
    }

    fn move_bytes(&mut self, now_us: u64) {
        for (index, channel) in self.channels.iter_mut().enumerate() {
            let mut bytes = Vec::new();
            for delivered in channel.step(now_us, &mut bytes) {
                self.laws.delivered(index, &delivered, self.resets);
            }
            for host in self.hosts.iter().filter(|host| host.link == index) {
                host.desk.borrow_mut().receive(&bytes);
            }
        }
    }

    fn move_hosts(&mut self, now_us: u64) {
        for (number, host) in self.hosts.iter_mut().enumerate() {
            {
                let mut desk = host.desk.borrow_mut();
                (desk.now_us, desk.resets) = (now_us, self.resets);
            }
            let due = host.desk.borrow().is_due();
            if due && let Some(life) = host.life.as_mut() {
                let mut context = Context::from_waker(Waker::noop());
                if life.as_mut().poll(&mut context).is_ready() {
                    host.life = None;
                }
            }
            let mut desk = host.desk.borrow_mut();
            for frame in std::mem::take(&mut desk.outbox) {
                self.channels[host.link].send(now_us, frame);
            }
            for note in std::mem::take(&mut desk.notes) {
                mix(&mut self.trace, format!("{note:?}").as_bytes());
                self.laws.noted(number, &note, &desk.record, now_us);
            }
            if std::mem::take(&mut desk.place) {
                place(&self.robot, &mut self.laws, self.plan);
            }
        }
    }

    /// A cut of the flash takes the power of the module.
    fn note_power(&mut self) {
        let cut = !self.robot.flash().borrow().is_powered();
        if cut {
            self.robot.flash().borrow_mut().power_on();
            self.robot.reset(ResetCause::PowerOn);
            self.restarted();
            self.check_flash();
        } else if self.robot.resets() != self.resets {
            let now_us = self.robot.now_us();
            if now_us > self.watchdog_until_us {
                let what = "nobody asked for it".to_owned();
                self.laws.break_law(Law::Alive, now_us, what);
            }
            self.restarted();
        }
    }

    fn restarted(&mut self) {
        self.look_at_packets();
        self.resets = self.robot.resets();
        self.laws.restarted(self.robot.now_us());
    }

    fn look_at_packets(&mut self) {
        let troubled = troubles(&self.plan.faults, &self.active);
        let motors = &mut *self.robot.motors().borrow_mut();
        for packet in &motors.sent {
            mix(&mut self.trace, &packet.at_us.to_le_bytes());
            mix(&mut self.trace, &packet.bytes);
        }
        self.laws.sent(motors, |joint| troubled[joint]);
    }

    fn look(&mut self) {
        let now_us = self.robot.now_us();
        let on_the_bus = |fault: &Fault| fault.kind.is_on_the_bus();
        let mut active = self.plan.faults.iter().zip(&self.active);
        if active.any(|(fault, on)| *on && on_the_bus(fault)) {
            self.laws.disturb(now_us + HELD_BACK_US);
        }
        let stalled_until_us = self.robot.motors().borrow().stalled_until_us;
        self.laws.disturb(stalled_until_us + REST_OF_CYCLE_US);
        self.look_at_packets();
        let mut deaf = [false; 6];
        for fault in self.active() {
            deaf[fault.joint] |= fault.kind == Kind::DriverMissing;
        }
        let motors = self.robot.motors().borrow();
        self.laws
            .look(now_us, &motors.motors, self.stop_us, |joint| deaf[joint]);
    }

    /// What the slots hold, read by a module of its own from a copy of the flash.
    fn check_flash(&mut self) {
        let mut flash = self.robot.flash().borrow().clone();
        let mut slots = Slots::new();
        slots.recover(&mut flash);
        for slot in 0..2 {
            let mut bytes = [0; 1024];
            let held = slots.read(&mut flash, slot, &mut bytes).ok();
            let digest: Option<Digest> = held
                .and_then(|length| WireGait::from_bytes(&bytes[..length]))
                .map(|gait| gait.digest());
            self.laws.holds(self.robot.now_us(), slot, digest);
        }
    }

    fn heal(&mut self) {
        for index in 0..self.active.len() {
            if self.active[index] {
                self.switch(index, false);
            }
        }
        // A cut that was planned and did not come.
        self.robot.flash().borrow_mut().power_on();
    }

    fn come_back(&mut self) {
        self.hosts.truncate(1);
        self.start(0);
        let hand = Hand(self.hosts[0].desk.clone());
        self.hosts[0].life = Some(Box::pin(hand.comes_back()));
        let until_us = self.plan.active_us + BACK_US;
        let before = self.laws.counts.completed;
        while self.hosts[0].life.is_some()
            && self.robot.now_us() < until_us
            && self.laws.broken.is_none()
        {
            self.step(until_us);
        }
        if self.laws.counts.completed == before {
            let what = "no run to its end after the faults".to_owned();
            self.laws
                .break_law(Law::ComesBack, self.robot.now_us(), what);
        }
    }

    fn switch_faults(&mut self, now_us: u64) {
        for index in 0..self.active.len() {
            let fault = self.plan.faults[index];
            let on = now_us >= fault.from_us && now_us < fault.to_us;
            if on != self.active[index] {
                self.switch(index, on);
            }
        }
    }

    fn active(&self) -> impl Iterator<Item = &Fault> {
        let faults = self.plan.faults.iter().zip(&self.active);
        faults.filter(|(_, on)| **on).map(|(fault, _)| fault)
    }
}

/// The user moves joints into the home pose. One that drives he leaves alone; one whose watchdog has tripped gives way to his hand, whatever
/// its torque register says.
fn place(robot: &EmulatedRobot<Watched>, laws: &mut Laws, plan: &Plan) {
    let motors = &mut robot.motors().borrow_mut().motors;
    for joint in 0..6 {
        if !motors.is_driving(joint) {
            motors.place(joint, plan.home_urad[joint]);
            laws.placed(joint, plan.home_urad[joint]);
        }
    }
}

/// Drivers that hear or say nothing, or say what is not so.
fn troubles(faults: &[Fault], active: &[bool]) -> [bool; 6] {
    let mut troubled = [false; 6];
    for (fault, _) in faults.iter().zip(active).filter(|(_, on)| **on) {
        troubled[fault.joint] |= matches!(
            fault.kind,
            Kind::DriverMissing
                | Kind::DriverMute
                | Kind::SensorFreeze
                | Kind::SensorJump
                | Kind::WrongSetPoint
        );
    }
    troubled
}

/// FNV-1a, 64 bits.
fn mix(hash: &mut u64, bytes: &[u8]) {
    for byte in bytes {
        *hash = (*hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3);
    }
}
