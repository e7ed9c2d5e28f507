//! How each kind of fault strikes, and how it ends.

use super::{BATTERY_MV, Stage, WATCHDOG_US};
use crate::robot::flash::{Cut, TEARS};
use crate::robot::ideal::{Noise, Trouble};
use crate::schedule::channel::LinkFaults;
use crate::schedule::fault::{Fault, Kind};
use crate::schedule::wire::PacketFaults;
use firmware::ports::{PortError, ResetCause};

impl Stage<'_> {
    pub(super) fn switch(&mut self, index: usize, on: bool) {
        let fault = self.plan.faults[index];
        self.active[index] = on;
        self.struck[fault.kind.index()] += u32::from(on);
        match fault.kind {
            kind if kind.is_on_the_bus() => {
                self.laws.disordered |= matches!(kind, Kind::BusDelay | Kind::BusReorder);
                self.set_bus();
            }
            Kind::LinkLoss
            | Kind::LinkCorruption
            | Kind::LinkDelay
            | Kind::LinkReorder
            | Kind::LinkDuplicate
            | Kind::LinkBabble => self.set_links(),
            Kind::LinkCut | Kind::LinkUart => self.strike_link(&fault, on),
            Kind::BrownOut | Kind::Reset | Kind::StorageCut | Kind::BatterySag | Kind::Stall => {
                self.strike_module(&fault, on);
            }
            Kind::DriverReset | Kind::DriverError => self.strike_driver(&fault, on),
            Kind::ClockDrift => self.set_clocks(&fault, on),
            Kind::HostDeath => self.host_lives(0, !on),
            Kind::SecondHost => self.host_lives(1, on),
            Kind::StopInput => self.press(on),
            _ => self.set_troubles(),
        }
    }

    fn set_bus(&mut self) {
        let (mut packets, mut noise) = (PacketFaults::default(), Noise::default());
        for fault in self.active() {
            match fault.kind {
                Kind::BusLoss => {
                    packets.loss = fault.size * 0.5;
                    noise.reply_loss = fault.size * 0.5;
                }
                Kind::BusCorruption => noise.corruption = fault.size * fault.size * 0.02,
                Kind::BusDelay => packets.delay = (0.5, (fault.size * 15e6) as u64),
                Kind::BusReorder => packets.reorder = fault.size * 0.5,
                Kind::BusDuplicate => packets.duplicate = fault.size * 0.5,
                Kind::BusBabble => noise.babble = true,
                _ => {}
            }
        }
        self.robot.motors().borrow_mut().set_faults(packets, noise);
    }

    fn set_links(&mut self) {
        let mut links = [LinkFaults::default(); 2];
        for fault in self.active() {
            let link = &mut links[fault.link];
            match fault.kind {
                Kind::LinkLoss => link.loss = fault.size * 0.6,
                Kind::LinkCorruption => link.corruption = fault.size * fault.size * 0.02,
                Kind::LinkDelay => link.delay_us = fault.size * fault.size * 800e3,
                Kind::LinkReorder => link.reorder = fault.size * 0.5,
                Kind::LinkDuplicate => link.duplicate = fault.size,
                Kind::LinkBabble => link.babble = true,
                _ => {}
            }
        }
        for (channel, faults) in self.channels.iter_mut().zip(links) {
            channel.set_faults(faults);
        }
    }

    fn strike_link(&mut self, fault: &Fault, on: bool) {
        if on {
            let now_us = self.robot.now_us();
            self.laws.link_struck(fault.link, now_us);
        }
        let channel = &mut self.channels[fault.link];
        match (fault.kind, on) {
            (Kind::LinkCut, true) => channel.cut(),
            (Kind::LinkCut, false) => channel.line().reconnect(),
            (_, true) if fault.size < 0.5 => channel.line().disturb(PortError::Noise),
            (_, true) => channel.line().disturb(PortError::Overrun),
            (_, false) => {}
        }
    }

    fn strike_module(&mut self, fault: &Fault, on: bool) {
        let now_us = self.robot.now_us();
        match fault.kind {
            Kind::BatterySag => {
                let sag_mv = if on { fault.size * 2_000.0 } else { 0.0 };
                let battery_mv = (BATTERY_MV - sag_mv) as u16;
                self.robot.board().set_battery_mv(Some(battery_mv));
            }
            _ if !on => {}
            Kind::Stall => {
                let stall_us = (fault.size * 180_000.0) as u64;
                self.robot.motors().borrow_mut().motors.stall_once(stall_us);
                // The next packet may be a cycle away.
                self.watchdog_until_us = now_us + WATCHDOG_US;
            }
            Kind::StorageCut => {
                let after = (fault.size * fault.size * 90.0) as u64;
                let tear = TEARS[fault.seed as usize % TEARS.len()];
                let cut = Cut { after, tear };
                self.robot.flash().borrow_mut().plan_cut(cut);
            }
            Kind::BrownOut => {
                for joint in (0..6).filter(|_| fault.size < 0.5) {
                    self.restart_driver(joint);
                }
                self.robot.reset(ResetCause::BrownOut);
                self.restarted();
            }
            _ => {
                let causes = [ResetCause::Watchdog, ResetCause::Software, ResetCause::Pin];
                self.robot.reset(causes[fault.seed as usize % causes.len()]);
                self.restarted();
            }
        }
    }

    fn restart_driver(&mut self, joint: usize) {
        let now_us = self.robot.now_us();
        let motors = &mut self.robot.motors().borrow_mut().motors;
        self.laws
            .encoder_lost(now_us, joint, motors.position_urad(joint));
        motors.restart(joint);
    }

    fn strike_driver(&mut self, fault: &Fault, on: bool) {
        let bits = if on { 0b100 } else { 0 };
        match fault.kind {
            Kind::DriverReset if on => self.restart_driver(fault.joint),
            Kind::DriverReset => {}
            _ => {
                let motors = &mut self.robot.motors().borrow_mut().motors;
                motors.hardware_error(fault.joint, bits);
            }
        }
    }

    fn set_troubles(&mut self) {
        let mut troubles = [Trouble::None; 6];
        let active: Vec<Fault> = self.active().copied().collect();
        for fault in active {
            let size = ((fault.size - 0.5) * 2e6) as i32;
            troubles[fault.joint] = match fault.kind {
                Kind::DriverMissing => Trouble::Missing,
                Kind::DriverMute => Trouble::Mute,
                Kind::SensorFreeze => Trouble::Frozen,
                Kind::SensorJump => Trouble::Jump(size),
                Kind::WrongSetPoint => Trouble::WrongGoal(size),
                _ => continue,
            };
            self.laws.jumped |= fault.kind == Kind::SensorJump;
        }
        let motors = &mut self.robot.motors().borrow_mut().motors;
        for (joint, trouble) in troubles.into_iter().enumerate() {
            motors.set_trouble(joint, trouble);
        }
    }

    fn set_clocks(&mut self, fault: &Fault, on: bool) {
        // Ceramic oscillators and cheap crystals: up to 2 % and 1 %.
        let off = if on { fault.size - 0.5 } else { 0.0 };
        let motors = &mut self.robot.motors().borrow_mut().motors;
        for joint in 0..6 {
            let sign = if fault.seed >> joint & 1 == 0 {
                1.0
            } else {
                -1.0
            };
            motors.set_clock(joint, 1.0 + sign * off * 0.04);
        }
        for host in &self.hosts {
            host.desk.borrow_mut().clock_ratio = 1.0 + off * 0.02;
        }
    }

    fn host_lives(&mut self, number: usize, lives: bool) {
        if lives {
            self.start(number);
        } else if let Some(host) = self.hosts.get_mut(number) {
            host.life = None;
        }
    }

    fn press(&mut self, on: bool) {
        let now_us = self.robot.now_us();
        let pressed = self.plan.faults.iter().zip(&self.active);
        let mut pressed = pressed.filter(|(fault, on)| **on && fault.kind == Kind::StopInput);
        let still = pressed.next().is_some();
        self.robot.board().set_stop_input(still);
        if on {
            self.stop_us.get_or_insert(now_us);
        } else if !still && let Some(pressed_us) = self.stop_us.take() {
            // A task that stands still sees no input.
            if now_us > self.watchdog_until_us {
                self.laws.stop_released(pressed_us, now_us);
            }
        }
    }
}
