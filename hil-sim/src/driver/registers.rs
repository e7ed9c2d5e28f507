//! The control table of a driver: what the bus can read and write, in wire units.

use protocol::bus::Profile;
use protocol::bus::feedback::{PackedFeedback, status};
use protocol::bus::indirect::Indirect;
use protocol::bus::packet::StatusError;
use protocol::bus::server::{DriverHandler, Keep};
use protocol::bus::table::{
    RETURN_DELAY_NS, Register, RegisterFile, WATCHDOG_MS, WATCHDOG_TRIPPED,
};
use protocol::units;

use super::control::ControlParams;
use super::{Driver, GoalError, Mode, Watchdog};

/// Registers, and what the driver remembers between packets.
#[derive(Clone, Debug)]
pub struct Registers {
    file: RegisterFile,
    /// The file as the driver left the works: with its own address, delay and limits.
    factory: RegisterFile,
    base: ControlParams,
    profile: Profile,
    indirect: Option<Indirect>,
    alias: Option<u8>,
    refused: bool,
    now_ns: u64,
}

/// Position P gain at which the loop has its own gain; the table's default.
const NEUTRAL_P_GAIN: f64 = 800.0;
/// Duty per rad s for one count of position I gain. Ours; the X series has no such unit.
const KI_PER_COUNT: f64 = 0.01;
/// Duty per rad/s for one count of position D gain, added to the built-in damping. Ours.
const KV_PER_COUNT: f64 = 0.001;
/// Errors that release the motor from the start: all that this driver can have. The X series leaves some on.
const SHUTDOWN_ALL: i32 = 0b11_1101;
/// What differs in an X servo fresh from the shop (e-manual, "Initial Value"): position mode, 500 us of return delay.
const X_DEFAULTS: [(Register, i32); 2] = [
    (Register::OperatingMode, MODE_POSITION),
    (Register::ReturnDelay, 250),
];
/// Current limit of an X330, counts of 1 mA (e-manual XL330-M288, Current Limit).
const X330_CURRENT_LIMIT: i32 = 1_750;
/// Operating modes of the X series that this driver has.
const MODE_POSITION: i32 = 3;
const MODE_EXTENDED: i32 = 4;
const MODE_CURRENT_POSITION: i32 = 5;
const MODE_PWM: i32 = 16;

impl Registers {
    /// Defaults, with the driver's own address, return delay and guard limits.
    #[must_use]
    pub fn new(id: u8, driver: &mut Driver) -> Self {
        let params = driver.params().clone();
        let mut file = RegisterFile::new();
        file.set(Register::Id, i32::from(id));
        file.set(
            Register::ReturnDelay,
            (params.return_delay_ns / RETURN_DELAY_NS).min(254) as i32,
        );
        file.set(Register::TemperatureLimit, params.guard.overheat_c as i32);
        file.set(
            Register::MinVoltageLimit,
            libm::round(params.guard.undervolt_v * 10.0) as i32,
        );
        file.set(
            Register::MaxVoltageLimit,
            libm::round(params.guard.overvolt_v * 10.0) as i32,
        );
        file.set(Register::Shutdown, SHUTDOWN_ALL);
        let profile = params.profile;
        if let Some(model) = profile.info().models.first() {
            file.set(Register::ModelNumber, i32::from(*model));
        }
        let indirect = Indirect::of(profile);
        if indirect.is_some() {
            for (register, value) in X_DEFAULTS {
                file.set(register, value);
            }
        }
        if matches!(profile, Profile::Xl330 | Profile::Xc330) {
            file.set(Register::CurrentLimit, X330_CURRENT_LIMIT);
        }
        if profile != Profile::Packed {
            // Off-the-shelf servos believe any set-point within their limits.
            driver.guard_mut().largest_step_rad = f64::INFINITY;
        }
        let registers = Self {
            factory: file.clone(),
            file,
            base: params.control,
            profile,
            indirect,
            alias: None,
            refused: false,
            now_ns: 0,
        };
        registers.apply(driver);
        registers
    }

    /// Address on the bus, the alias of a duplicate-id fault included.
    #[must_use]
    pub fn id(&self) -> u8 {
        self.alias.unwrap_or(self.file.get(Register::Id) as u8)
    }

    /// Makes the driver answer to another address, or to its own again.
    pub fn set_alias(&mut self, alias: Option<u8>) {
        self.alias = alias;
    }

    /// Restart of the electronics.
    pub fn restart(&mut self, driver: &mut Driver, now_ns: u64) {
        self.file.restart();
        let model = self.factory.get(Register::ModelNumber);
        self.file.set(Register::ModelNumber, model);
        self.indirect = Indirect::of(self.profile);
        self.refused = false;
        driver.reboot(now_ns);
        let offset = units::urad_from_x_position(self.file.get(Register::HomingOffset));
        driver.set_home(f64::from(offset) * 1e-6);
        self.apply(driver);
    }

    /// Carries registers over into the loop and the guard.
    fn apply(&self, driver: &mut Driver) {
        let get = |register| f64::from(self.file.get(register));
        let mut control = self.base.clone();
        control.loop_gain_ratio *= get(Register::PositionPGain) / NEUTRAL_P_GAIN;
        control.ki_1_rad_s += get(Register::PositionIGain) * KI_PER_COUNT;
        control.kv_damping_s_rad += get(Register::PositionDGain) * KV_PER_COUNT;
        control.duty_limit = control
            .duty_limit
            .min(get(Register::PwmLimit) / f64::from(units::X_PWM_FULL));
        let profile = get(Register::ProfileVelocity) * units::X_RAD_S_PER_VELOCITY_COUNT;
        if profile > 0.0 {
            control.velocity_limit_rad_s = control.velocity_limit_rad_s.min(profile);
        }
        *driver.control_params_mut() = control;
        driver.set_current_limit(self.current_limit_a());
        driver.set_shutdown(self.file.get(Register::Shutdown) as u8);
        let guard = driver.guard_mut();
        guard.overheat_c = get(Register::TemperatureLimit);
        guard.undervolt_v = get(Register::MinVoltageLimit) * 0.1;
        guard.overvolt_v = get(Register::MaxVoltageLimit) * 0.1;
    }

    fn current_limit_a(&self) -> f64 {
        let fixed = self.file.get(Register::CurrentLimit);
        let counts = if self.file.get(Register::OperatingMode) == MODE_CURRENT_POSITION {
            fixed.min(self.file.get(Register::GoalCurrent).abs())
        } else {
            fixed
        };
        f64::from(counts) * self.count_a()
    }

    /// Current of one count [A].
    fn count_a(&self) -> f64 {
        match self.profile {
            // Ours has the table of the XM430.
            Profile::Packed => f64::from(units::X_MA_PER_100_CURRENT_COUNTS) * 1e-5,
            profile => f64::from(profile.info().units.ma_per_100) * 1e-5,
        }
    }

    /// Table and frames that the driver offers.
    #[must_use]
    pub fn profile(&self) -> Profile {
        self.profile
    }

    /// Bits per second that the driver listens at (e-manual, Baud Rate).
    #[must_use]
    pub fn baud(&self) -> u32 {
        match self.file.get(Register::BaudRate) {
            0 => 9_600,
            1 => 57_600,
            2 => 115_200,
            4 => 2_000_000,
            5 => 3_000_000,
            6 => 4_000_000,
            7 => 4_500_000,
            _ => 1_000_000,
        }
    }

    /// In position mode an X servo takes no goal outside of its limits (e-manual, Min and Max Position Limit).
    fn within_limits(&self, counts: i32) -> bool {
        let free =
            self.indirect.is_none() || self.file.get(Register::OperatingMode) != MODE_POSITION;
        let (min, max) = (Register::MinPositionLimit, Register::MaxPositionLimit);
        free || (self.file.get(min)..=self.file.get(max)).contains(&counts)
    }
}

/// A driver with its registers, as the bus server sees it.
#[derive(Debug)]
pub struct Front<'a> {
    /// The driver.
    pub driver: &'a mut Driver,
    /// Its registers.
    pub registers: &'a mut Registers,
}

/// Radians to micro-radians, saturating.
fn urad(rad: f64) -> i32 {
    libm::round(rad * 1e6) as i32
}

fn goal_error(error: GoalError) -> StatusError {
    match error {
        GoalError::WatchdogExpired => StatusError::Access,
        GoalError::Implausible => StatusError::DataLimit,
    }
}

impl Front<'_> {
    /// When the request under way was whole [ns].
    pub(super) fn now_ns(&self) -> u64 {
        self.registers.now_ns
    }

    fn status_bits(&self) -> u8 {
        let driver = &*self.driver;
        let mut bits = 0;
        let mut put = |bit, on: bool| bits |= if on { bit } else { 0 };
        put(status::TORQUE, driver.torque_on());
        put(status::HOMED, driver.homed());
        put(status::LIMITED, driver.limited());
        put(status::REFUSED, self.registers.refused);
        put(status::HARDWARE_ERROR, driver.hardware_error() != 0);
        put(status::WATCHDOG, driver.watchdog() == Watchdog::Expired);
        put(status::MOVING, self.moving());
        bits
    }

    fn moving(&self) -> bool {
        let threshold = f64::from(self.registers.file.get(Register::MovingThreshold))
            * units::X_RAD_S_PER_VELOCITY_COUNT;
        self.driver.readings().velocity_rad_s.abs() > threshold
    }

    /// Live values; `None` = kept in the file.
    fn live(&self, register: Register) -> Option<i32> {
        let readings = self.driver.readings();
        let x_position = |rad| units::x_position_from_urad(urad(rad));
        let duty = readings.duty * f64::from(units::X_PWM_FULL);
        let x_velocity = readings.velocity_rad_s / units::X_RAD_S_PER_VELOCITY_COUNT;
        let value = match register {
            Register::Id => i32::from(self.registers.id()),
            Register::TorqueEnable => i32::from(self.driver.torque_on()),
            Register::HardwareError => i32::from(self.driver.hardware_error()),
            Register::BusWatchdog if self.driver.watchdog() == Watchdog::Expired => {
                WATCHDOG_TRIPPED
            }
            Register::RealtimeTick => {
                (self.driver.clock_us(self.registers.now_ns) / 1_000 % 32_768) as i32
            }
            Register::Moving => i32::from(self.moving()),
            Register::MovingStatus => {
                // In position: within one X-series count.
                let error = readings.applied_setpoint_rad - readings.position_rad;
                i32::from(self.driver.torque_on() && error.abs() < 1.534e-3)
            }
            Register::PresentPwm => libm::round(duty) as i32,
            Register::PresentCurrent => {
                libm::round(readings.current_a / self.registers.count_a()) as i32
            }
            Register::PresentVelocity => libm::round(x_velocity) as i32,
            Register::PresentPosition => x_position(readings.position_rad),
            Register::VelocityTrajectory => 0,
            Register::PositionTrajectory => x_position(readings.applied_setpoint_rad),
            Register::PresentInputVoltage => libm::round(readings.bus_v * 10.0) as i32,
            Register::PresentTemperature => libm::round(readings.case_c.clamp(0.0, 255.0)) as i32,
            Register::GoalPosition => x_position(self.driver.goal_rad()),
            Register::GoalAngle => urad(self.driver.goal_rad()),
            Register::PresentAngle => urad(readings.position_rad),
            Register::AppliedAngle => urad(readings.applied_setpoint_rad),
            Register::TickUs => readings.at_us as u32 as i32,
            Register::FineVelocity => {
                i32::from(units::velocity_from_rad_s(readings.velocity_rad_s as f32))
            }
            Register::FineCurrent => i32::from(units::current_from_a(readings.current_a as f32)),
            Register::FineDuty => i32::from(units::counts_from_duty(readings.duty as f32)),
            Register::FineVoltage => i32::from(units::voltage_from_v(readings.bus_v as f32)),
            Register::BootCount => (self.driver.boots() & 0xFF) as i32,
            Register::StatusBits => i32::from(self.status_bits()),
            Register::ZeroHere => i32::from(self.driver.homed()),
            _ => return None,
        };
        Some(value)
    }

    fn set_goal(&mut self, goal_rad: f64, limited: bool) -> Result<(), StatusError> {
        let step_rad = f64::from(self.registers.file.get(Register::GoalStepLimit)) * 1e-6;
        let far = limited && (goal_rad - self.driver.goal_rad()).abs() > step_rad;
        let result = if far && self.driver.torque_on() {
            Err(GoalError::Implausible)
        } else {
            self.driver.set_goal(goal_rad, self.registers.now_ns)
        };
        self.registers.refused |= result.is_err();
        result.map_err(goal_error)
    }

    fn set_mode(&mut self, value: i32) -> Result<(), StatusError> {
        let mode = match value {
            MODE_POSITION | MODE_EXTENDED | MODE_CURRENT_POSITION => Mode::Position,
            MODE_PWM => Mode::Pwm,
            // Current and velocity loops are not built.
            _ => return Err(StatusError::DataRange),
        };
        self.driver.set_mode(mode);
        if mode == Mode::Pwm {
            // Never full duty by default.
            self.registers.file.set(Register::GoalPwm, 0);
        }
        Ok(())
    }

    /// Writes that act at once.
    fn act(&mut self, register: Register, value: i32) -> Result<(), StatusError> {
        match register {
            Register::TorqueEnable => {
                if self.driver.set_torque(value == 1) {
                    Ok(())
                } else {
                    Err(StatusError::Result)
                }
            }
            Register::GoalAngle => self.set_goal(f64::from(value) * 1e-6, true),
            Register::GoalPosition if !self.registers.within_limits(value) => {
                self.registers.refused = true;
                Err(StatusError::DataLimit)
            }
            Register::GoalPosition => {
                self.set_goal(f64::from(units::urad_from_x_position(value)) * 1e-6, false)
            }
            Register::GoalPwm => self
                .driver
                .set_duty_goal(f64::from(value) / f64::from(units::X_PWM_FULL))
                .map_err(goal_error),
            Register::GoalCurrent | Register::GoalVelocity
                if self.driver.watchdog() == Watchdog::Expired =>
            {
                Err(StatusError::Access)
            }
            Register::OperatingMode => self.set_mode(value),
            Register::BusWatchdog => {
                let limit_us = (value > 0).then(|| value as u64 * u64::from(WATCHDOG_MS) * 1_000);
                self.driver.set_watchdog(limit_us, self.registers.now_ns);
                Ok(())
            }
            Register::ZeroHere => {
                self.driver.zero_here();
                Ok(())
            }
            Register::HomingOffset => {
                let shift = value - self.registers.file.get(Register::HomingOffset);
                let home =
                    self.driver.home_rad() + f64::from(units::urad_from_x_position(shift)) * 1e-6;
                self.driver.set_home(home);
                Ok(())
            }
            _ => Ok(()),
        }
    }
}

impl DriverHandler for Front<'_> {
    fn latch(&mut self, now_ns: u64) {
        self.registers.now_ns = now_ns;
        self.driver.heard(now_ns);
    }

    fn read(&self, register: Register) -> i32 {
        self.live(register)
            .unwrap_or_else(|| self.registers.file.get(register))
    }

    fn feedback(&mut self) -> PackedFeedback {
        let readings = *self.driver.readings();
        let block = PackedFeedback {
            tick_4us: (readings.at_us / u64::from(units::US_PER_TICK)) as u16,
            applied_urad: urad(readings.applied_setpoint_rad),
            position_urad: urad(readings.position_rad),
            velocity: units::velocity_from_rad_s(readings.velocity_rad_s as f32),
            current_ma: units::current_from_a(readings.current_a as f32),
            duty: units::counts_from_duty(readings.duty as f32),
            voltage_5mv: units::voltage_from_v(readings.bus_v as f32),
            temperature_c: libm::round(readings.case_c) as i16,
            status: self.status_bits(),
            boots: (self.driver.boots() & 7) as u8,
        };
        self.registers.refused = false;
        block
    }

    fn write(&mut self, register: Register, value: i32) -> Result<(), StatusError> {
        self.act(register, value)?;
        self.registers.file.set(register, value);
        self.registers.apply(self.driver);
        Ok(())
    }

    fn reboot(&mut self) {
        let now_ns = self.registers.now_ns;
        self.registers.restart(self.driver, now_ns);
    }

    fn factory_reset(&mut self, keep: Keep) -> Result<(), StatusError> {
        let before = core::mem::replace(&mut self.registers.file, self.registers.factory.clone());
        let file = &mut self.registers.file;
        let (id, baud) = (Register::Id, Register::BaudRate);
        file.set(
            id,
            if keep == Keep::Nothing {
                1
            } else {
                before.get(id)
            },
        );
        if keep == Keep::IdAndBaud {
            file.set(baud, before.get(baud));
        }
        self.reboot();
        Ok(())
    }

    fn indirect(&self) -> Option<&Indirect> {
        self.registers.indirect.as_ref()
    }

    fn set_indirect(&mut self, map: Indirect) {
        self.registers.indirect = Some(map);
    }

    fn clear_turns(&mut self) -> Result<(), StatusError> {
        if self.driver.torque_on() {
            return Err(StatusError::Result);
        }
        let turns = libm::floor(self.driver.readings().position_rad / core::f64::consts::TAU);
        let home = self.driver.home_rad() - turns * core::f64::consts::TAU;
        self.driver.set_home(home);
        Ok(())
    }
}
