//! One driver without a motor behind it.

use super::{Taken, Trouble};
use protocol::bus::feedback::status;
use protocol::bus::server::DriverHandler;
use protocol::bus::table::{WATCHDOG_MS, WATCHDOG_TRIPPED};
use protocol::bus::{PackedFeedback, Register, RegisterFile, StatusError};

/// One count of register 98, ns.
const WATCHDOG_NS: u64 = WATCHDOG_MS as u64 * 1_000_000;

/// State of one driver.
#[derive(Debug, Clone)]
pub(super) struct Ideal {
    pub(super) registers: RegisterFile,
    pub(super) now_ns: u64,
    pub(super) boot_ns: u64,
    pub(super) goal_urad: i32,
    pub(super) position_urad: i32,
    pub(super) torque: bool,
    pub(super) boots: u8,
    pub(super) trouble: Trouble,
    pub(super) frozen: Option<PackedFeedback>,
    pub(super) joint: usize,
    pub(super) taken: Vec<Taken>,
    pub(super) heard_ns: u64,
    pub(super) watchdog_ns: Option<u64>,
    pub(super) tripped: bool,
    /// Its clock against true time.
    pub(super) clock_ratio: f64,
    /// Packets that set its watchdog are lost.
    pub(super) forgets_watchdogs: bool,
    /// Packets that take its torque are lost.
    pub(super) keeps_torque: bool,
    /// How fast it moves, rad/s; `None` = it stands at once where it is told.
    pub(super) speed_rad_s: Option<u32>,
    pub(super) moved_ns: u64,
}

impl Ideal {
    pub(super) fn new(id: u8) -> Self {
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
            clock_ratio: 1.0,
            forgets_watchdogs: false,
            keeps_torque: false,
            speed_rad_s: None,
            moved_ns: 0,
        }
    }

    /// Time on its own clock, ns.
    pub(super) fn own_ns(&self, true_ns: u64) -> u64 {
        (true_ns as f64 * self.clock_ratio) as u64
    }

    pub(super) fn starves(&self, now_ns: u64) -> bool {
        let quiet_ns = self.own_ns(now_ns.saturating_sub(self.heard_ns));
        self.watchdog_ns.is_some_and(|limit_ns| quiet_ns > limit_ns)
    }

    /// Moves on towards the goal.
    pub(super) fn go(&mut self, now_ns: u64) {
        let Some(speed_rad_s) = self.speed_rad_s else {
            return;
        };
        // 1 rad/s is 1 urad/us.
        let most = (now_ns.saturating_sub(self.moved_ns) / 1_000) as i64 * i64::from(speed_rad_s);
        if self.torque && !self.tripped && !self.starves(now_ns) {
            let way = i64::from(self.goal_urad) - i64::from(self.position_urad);
            self.position_urad += way.clamp(-most, most) as i32;
        }
        self.moved_ns = now_ns;
    }

    pub(super) fn watch(&mut self, now_ns: u64) {
        self.tripped |= self.starves(now_ns);
    }

    pub(super) fn status(&self) -> u8 {
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
        self.go(now_ns);
        self.now_ns = now_ns;
        self.heard_ns = now_ns;
    }

    fn read(&self, register: Register) -> i32 {
        match register {
            Register::TorqueEnable => i32::from(self.torque),
            Register::GoalAngle => self.goal_urad,
            Register::PresentAngle => self.position_urad,
            Register::BootCount => i32::from(self.boots),
            Register::BusWatchdog if self.tripped => WATCHDOG_TRIPPED,
            Register::BusWatchdog => {
                let counts = self.watchdog_ns.map(|ns| ns / WATCHDOG_NS);
                counts.unwrap_or(0) as i32
            }
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
            tick_4us: (self.own_ns(self.now_ns - self.boot_ns) / 4000) as u16,
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
                if self.torque && self.speed_rad_s.is_none() {
                    self.position_urad = value;
                }
            }
            Register::TorqueEnable if self.keeps_torque && value == 0 => {}
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
            Register::BusWatchdog if self.forgets_watchdogs && value > 0 => {}
            Register::BusWatchdog => {
                self.tripped = false;
                self.watchdog_ns = (value > 0).then_some(value as u64 * WATCHDOG_NS);
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
