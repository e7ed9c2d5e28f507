//! What faults of a servo bus come to: how soon the module says so, and how often the robot runs again afterwards, by
//! the share of packets that the bus loses.

use super::gaits;
use super::wire::{PacketFaults, Watched};
use crate::rng::Rng;
use crate::robot::host::{AskError, SimHost};
use crate::robot::ideal::{IdealMotors, Noise, Trouble};
use crate::robot::{EmulatedRobot, Setup};
use protocol::link::{
    Digest, EndReason, EventKind, FromModule, ModuleState, Tag, TelemetryRate, ToModule,
};

/// Shares of packets lost, each way.
pub const LOSSES: [f64; 6] = [0.0, 0.01, 0.05, 0.10, 0.20, 0.30];
/// A fault lasts this long, us.
const FAULT_US: u64 = 1_000_000;
/// What is not noticed in this time counts as not noticed, us.
const NOTICED_US: u64 = 3_000_000;
/// Tries to bring the robot up again.
const TRIES: u32 = 5;

/// A fault of the servo bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Strike {
    Nothing,
    Missing,
    Mute,
    Restart,
    Error,
    Freeze,
    Jump,
    WrongGoal,
    Babble,
    Corruption,
}

const STRIKES: [(Strike, &str); 10] = [
    (Strike::Nothing, "none"),
    (Strike::Missing, "driver off the bus"),
    (Strike::Mute, "driver does not answer"),
    (Strike::Restart, "driver restarts"),
    (Strike::Error, "driver reports a hardware error"),
    (Strike::Freeze, "measurement stands still"),
    (Strike::Jump, "encoder jumps 0.5 rad"),
    (Strike::WrongGoal, "driver applies a set-point 0.05 rad off"),
    (Strike::Babble, "somebody talks all the time"),
    (Strike::Corruption, "1 byte in 100 damaged"),
];

/// One cell of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// The fault.
    pub fault: &'static str,
    /// Share of packets lost, each way.
    pub loss: f64,
    /// Runs.
    pub runs: u32,
    /// Runs still under way when the fault struck.
    pub struck: u32,
    /// Of these, runs in which the module told a fault.
    pub noticed: u32,
    /// Median time to that, ms; 0 without any.
    pub median_ms: f64,
    /// Longest, ms.
    pub most_ms: f64,
    /// Runs to their end after the fault was gone, the loss going on.
    pub recovered: u32,
}

/// All faults at all losses, `runs` times each.
#[must_use]
pub fn table(runs: u32) -> Vec<Row> {
    let of = move |(strike, fault)| LOSSES.map(|loss| row(strike, fault, loss, runs));
    let faults = STRIKES.map(|strike| std::thread::spawn(move || of(strike)));
    let rows = faults.into_iter().map(|rows| rows.join());
    rows.flatten().flatten().collect()
}

fn row(strike: Strike, fault: &'static str, loss: f64, runs: u32) -> Row {
    let (mut times_ms, mut struck, mut recovered) = (Vec::new(), 0, 0);
    for number in 0..runs {
        let seed = u64::from(number) << 8 | strike as u64;
        let (running, noticed_us, back) = once(strike, loss, seed);
        struck += u32::from(running);
        times_ms.extend(noticed_us.map(|us| us as f64 * 1e-3));
        recovered += u32::from(back);
    }
    times_ms.sort_by(f64::total_cmp);
    Row {
        fault,
        loss,
        runs,
        struck,
        noticed: times_ms.len() as u32,
        median_ms: times_ms.get(times_ms.len() / 2).copied().unwrap_or(0.0),
        most_ms: times_ms.last().copied().unwrap_or(0.0),
        recovered,
    }
}

type Robot = EmulatedRobot<Watched>;

/// One run with one fault: whether it was under way, when the fault was told after it began, us, and whether the
/// robot ran again.
fn once(strike: Strike, loss: f64, seed: u64) -> (bool, Option<u64>, bool) {
    let setup = Setup {
        seed,
        link_byte_ns: 0,
        ..Setup::default()
    };
    let mut robot = EmulatedRobot::with_motors(setup, Watched::new(seed));
    let mut host = SimHost::new(robot.link());
    let Ok(digest) = ready(&mut robot, &mut host) else {
        return (false, None, false);
    };
    let mut rng = Rng::new(seed, 0x7A, 0);
    set_bus(&robot, loss, None);
    let started = (0..TRIES).any(|_| start(&mut robot, &mut host, digest, 60_000).is_ok());
    // Into the run, at any phase of a cycle.
    robot.run_for(2_500_000 + rng.next_u64() % 500_000);
    host.receive(None);
    let running = started && host.ends.is_empty();
    let joint = (rng.next_u64() % 6) as usize;
    let (struck_us, before) = (robot.now_us(), host.events.len());
    if running {
        begin(&mut robot, strike, joint, loss);
        robot.run_for(FAULT_US);
        end(&robot, strike, joint, loss);
        robot.run_for(NOTICED_US - FAULT_US);
    }
    host.receive(None);
    let noticed = host.events[before..]
        .iter()
        .find(|event| matches!(event.kind, EventKind::Fault(_)))
        .map(|event| event.t_us.saturating_sub(struck_us));
    let noticed = noticed.filter(|_| running);
    (running, noticed, comes_back(&mut robot, &mut host, digest))
}

fn ready(robot: &mut Robot, host: &mut SimHost) -> Result<Digest, AskError> {
    host.home(robot)?;
    host.upload(robot, 0, gaits::gait(0))
}

fn start(
    robot: &mut Robot,
    host: &mut SimHost,
    digest: Digest,
    duration_ms: u32,
) -> Result<FromModule, AskError> {
    robot.run_for(100_000);
    host.start(robot, 0, digest, duration_ms, TelemetryRate::Off)
}

/// After STOP and with the fault gone: whether one of a few tries ends in a whole run. The loss goes on.
fn comes_back(robot: &mut Robot, host: &mut SimHost, digest: Digest) -> bool {
    let _ = host.ask(robot, &ToModule::Stop);
    robot.run_for(6_000_000);
    for _ in 0..TRIES {
        host.receive(None);
        host.ends.clear();
        if run_again(robot, host, digest) {
            return true;
        }
        robot.run_for(1_000_000);
    }
    false
}

fn run_again(robot: &mut Robot, host: &mut SimHost, digest: Digest) -> bool {
    let tag = Tag::NONE;
    // Refused where there is nothing to clear or to home.
    let _ = host.ask(robot, &ToModule::ClearFault { tag });
    robot.run_for(100_000);
    if let Ok(FromModule::Info(info)) = host.ask(robot, &ToModule::GetInfo)
        && info.state == ModuleState::Unhomed
    {
        for joint in 0..6 {
            robot.motors().borrow_mut().motors.place(joint, 0);
        }
        robot.run_for(150_000);
        let joint_mask = 63;
        let _ = host.ask(robot, &ToModule::Zero { joint_mask, tag });
    }
    if start(robot, host, digest, 2_000).is_err() {
        return false;
    }
    let end = host.wait_for_end(robot, 45_000_000);
    end.is_some_and(|end| end.reason == EndReason::Completed)
}

/// The wire from now on: packets lost, and what the fault does to it.
fn set_bus(robot: &Robot, loss: f64, strike: Option<Strike>) {
    let packets = PacketFaults {
        loss,
        ..PacketFaults::default()
    };
    let noise = Noise {
        reply_loss: loss,
        corruption: if strike == Some(Strike::Corruption) {
            0.01
        } else {
            0.0
        },
        babble: strike == Some(Strike::Babble),
    };
    robot.motors().borrow_mut().set_faults(packets, noise);
}

fn begin(robot: &mut Robot, strike: Strike, joint: usize, loss: f64) {
    set_bus(robot, loss, Some(strike));
    let motors: &mut IdealMotors = &mut robot.motors().borrow_mut().motors;
    match strike {
        Strike::Missing => motors.trouble(joint, Trouble::Missing),
        Strike::Mute => motors.trouble(joint, Trouble::Mute),
        Strike::Restart => motors.restart(joint),
        Strike::Error => motors.hardware_error(joint, 0b10_0000),
        Strike::Freeze => motors.trouble(joint, Trouble::Frozen),
        Strike::Jump => motors.trouble(joint, Trouble::Jump(500_000)),
        Strike::WrongGoal => motors.trouble(joint, Trouble::WrongGoal(50_000)),
        Strike::Nothing | Strike::Babble | Strike::Corruption => {}
    }
}

fn end(robot: &Robot, strike: Strike, joint: usize, loss: f64) {
    set_bus(robot, loss, None);
    let motors: &mut IdealMotors = &mut robot.motors().borrow_mut().motors;
    motors.trouble(joint, Trouble::None);
    if strike == Strike::Error {
        motors.hardware_error(joint, 0);
    }
}
