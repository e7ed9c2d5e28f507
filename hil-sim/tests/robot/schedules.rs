//! Seeded random schedules of faults and orders: nothing unsafe is ever sent, nothing moves without an order, and when
//! the faults are gone the robot is usable again without a power cycle.

use crate::common::{check_set_points, ready};
use firmware::ports::{PortError, ResetCause};
use hil_sim::robot::EmulatedRobot;
use hil_sim::robot::host::{AskError, SimHost};
use hil_sim::robot::ideal::Trouble;
use protocol::link::{Digest, EndReason, FromModule, ModuleState, Tag, TelemetryRate, ToModule};

/// SplitMix64: every schedule follows from its seed.
struct Dice(u64);

impl Dice {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % n
    }
}

struct Schedule {
    robot: EmulatedRobot,
    host: SimHost,
    digest: Digest,
    dice: Dice,
    struck: [u32; 12],
}

impl Schedule {
    fn new(seed: u64) -> Self {
        let (robot, host, digest) = ready((seed % 4) as u8);
        Self {
            robot,
            host,
            digest,
            dice: Dice(seed),
            struck: [0; 12],
        }
    }

    fn positions(&self) -> [i32; 6] {
        std::array::from_fn(|joint| self.robot.motors().borrow().position_urad(joint))
    }

    fn state(&mut self) -> ModuleState {
        match self.host.ask(&mut self.robot, &ToModule::GetInfo) {
            Ok(FromModule::Info(info)) => info.state,
            other => panic!("{other:?}"),
        }
    }

    /// One thing happens.
    fn strike(&mut self) {
        let kind = self.dice.below(12) as usize;
        let joint = self.dice.below(6) as usize;
        self.struck[kind] += 1;
        let on = self.dice.below(2) == 0;
        match kind {
            0 | 1 => {
                let troubles = [
                    Trouble::None,
                    Trouble::Missing,
                    Trouble::Mute,
                    Trouble::Jump(300_000),
                    Trouble::Frozen,
                    Trouble::WrongGoal(-40_000),
                ];
                let trouble = troubles[self.dice.below(6) as usize];
                self.robot.motors().borrow_mut().trouble(joint, trouble);
            }
            2 => self.robot.motors().borrow_mut().restart(joint),
            3 => self.robot.motors().borrow_mut().babble(on),
            4 => self.robot.board().set_stop_input(on),
            5 => self
                .robot
                .board()
                .set_battery_mv([None, Some(7_400), Some(6_000)][self.dice.below(3) as usize]),
            6 => self
                .robot
                .link()
                .disturb([PortError::Noise, PortError::Overrun][usize::from(on)]),
            7 => drop(self.host.ask(&mut self.robot, &ToModule::Stop)),
            8 => {
                let cause = [ResetCause::Watchdog, ResetCause::BrownOut][usize::from(on)];
                self.robot.reset(cause);
            }
            9 => self.robot.motors().borrow_mut().drop_every(if on {
                500 + self.dice.below(2_000)
            } else {
                0
            }),
            10 => self
                .robot
                .motors()
                .borrow_mut()
                .hardware_error(joint, 0b100),
            _ => {
                let stall_us = self.dice.below(180_000);
                self.robot.motors().borrow_mut().stall_once(stall_us);
            }
        }
    }

    fn heal(&mut self) {
        self.robot.board().set_stop_input(false);
        self.robot.board().set_battery_mv(Some(7_400));
        let mut motors = self.robot.motors().borrow_mut();
        motors.babble(false);
        motors.drop_every(0);
        for joint in 0..6 {
            motors.trouble(joint, Trouble::None);
            motors.hardware_error(joint, 0);
        }
    }

    /// Orders of a patient user: after faults are gone, clear, home, start.
    fn bring_up(&mut self) -> Result<(), AskError> {
        self.host.hello(&mut self.robot)?;
        if matches!(self.state(), ModuleState::Fault | ModuleState::EStop) {
            self.host
                .ask(&mut self.robot, &ToModule::ClearFault { tag: Tag::NONE })?;
        }
        if self.state() == ModuleState::Unhomed {
            self.host.ask(
                &mut self.robot,
                &ToModule::Zero {
                    joint_mask: 63,
                    tag: Tag::NONE,
                },
            )?;
        }
        self.host
            .start(&mut self.robot, 0, self.digest, 3_000, TelemetryRate::Off)
            .map(|_| ())
    }

    fn run(&mut self, label: &str) {
        for round in 0..8 {
            let started = self.bring_up().is_ok();
            for _ in 0..self.dice.below(4) {
                let wait_us = self.dice.below(900_000);
                self.robot.run_for(wait_us);
                self.strike();
            }
            self.robot.run_for(12_000_000);
            self.host.receive(None);
            self.heal();
            self.robot.run_for(400_000);
            let state = self.state();
            assert!(
                matches!(
                    state,
                    ModuleState::Idle
                        | ModuleState::Unhomed
                        | ModuleState::Fault
                        | ModuleState::EStop
                ),
                "{label} round {round} (started {started}): still {state:?} after lease, ramp and hold"
            );
            let resting = self.positions();
            self.robot.run_for(500_000);
            assert_eq!(
                resting,
                self.positions(),
                "{label} round {round}: moved without an order"
            );
            assert!((0..6).all(|joint| !self.robot.motors().borrow().is_driving(joint)));
        }
        check_set_points(&self.robot);
        self.host.ends.clear();
        self.bring_up()
            .unwrap_or_else(|error| panic!("{label}: not usable again: {error:?}"));
        let end = self
            .host
            .wait_for_end(&mut self.robot, 20_000_000)
            .expect("the lease ends");
        assert_eq!(end.reason, EndReason::Completed, "{label}");
    }
}

#[test]
fn random_schedules_keep_the_invariants_and_the_robot_comes_back() {
    let mut struck = [0; 12];
    for seed in 0..40 {
        let mut schedule = Schedule::new(seed);
        schedule.run(&format!("seed {seed}"));
        for (sum, n) in struck.iter_mut().zip(schedule.struck) {
            *sum += n;
        }
    }
    println!("40 schedules of 8 runs; strikes per kind: {struck:?}");
    assert!(struck.iter().all(|n| *n > 15));
}

#[test]
fn a_schedule_replays_to_the_byte() {
    let life = |seed| {
        let mut schedule = Schedule::new(seed);
        schedule.run("replay");
        let taken: Vec<_> = (0..6)
            .flat_map(|joint| schedule.robot.motors().borrow().taken(joint))
            .collect();
        (
            schedule.robot.now_us(),
            schedule.robot.polls(),
            taken,
            format!("{:?}", schedule.host.events),
        )
    };
    assert_eq!(life(11), life(11));
}
