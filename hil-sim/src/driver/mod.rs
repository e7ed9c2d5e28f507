//! One motor driver: registers, supervision and the 1 kHz position loop.
//!
//! The driver sees what its electronics would: encoder edges since its own reset, winding current, bus voltage, case
//! temperature, its own clock. It never sees true angles or time.

pub mod control;
pub mod feetech;
mod params;
pub mod registers;
pub mod transport;
pub mod unit;

use control::{ControlParams, ControlState};
use transport::Transport;

pub use params::{ConventionParams, DriverParams, GuardParams, NoiseParams};

use crate::motor::Bridge;
use crate::rng::Rng;

/// Hardware errors as bits of register 70 (X-series bit numbers).
pub mod error_bit {
    /// Bus voltage outside its limits.
    pub const INPUT_VOLTAGE: u8 = 1 << 0;
    /// Case too hot.
    pub const OVERHEATING: u8 = 1 << 2;
    /// No encoder edges although driven.
    pub const ENCODER: u8 = 1 << 3;
    /// Too long at the current limit.
    pub const OVERLOAD: u8 = 1 << 5;
}

/// What the driver does with its motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Multi-turn position loop (X-series operating mode 4; 3 is treated alike, there are no end stops).
    Position,
    /// Duty straight from the goal (X-series operating mode 16).
    Pwm,
}

/// State of the bus watchdog (register 98).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Watchdog {
    /// Not watching.
    Off,
    /// Errors after this much silence [driver us].
    Armed {
        /// Allowed silence [us].
        limit_us: u64,
    },
    /// The silence was too long: goals are read-only until 0 is written.
    Expired,
}

/// Why a set-point was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalError {
    /// The watchdog has expired and was not cleared.
    WatchdogExpired,
    /// Not a number that a gait can hold: not finite or too far from the present position.
    Implausible,
}

/// What the sensors of one driver say at a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sensors {
    /// True gear angle plus encoder faults [rad].
    pub gear_rad: f64,
    /// Output angle of one encoder edge [rad].
    pub edge_rad: f64,
    /// Winding current [A].
    pub current_a: f64,
    /// Duty that the bridge applied, -1..=1.
    pub applied_duty: f64,
    /// Bus voltage [V].
    pub bus_v: f64,
    /// Case temperature [degC].
    pub case_c: f64,
    /// Current limit of the bridge [A].
    pub limit_a: f64,
}

/// What one driver reports of itself, in SI units and wire conventions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Readings {
    /// Driver clock at the measurement [us since its reset].
    pub at_us: u64,
    /// Set-point that the loop follows [rad], the position while there is none.
    pub applied_setpoint_rad: f64,
    /// Position [rad].
    pub position_rad: f64,
    /// Speed [rad/s].
    pub velocity_rad_s: f64,
    /// Winding current [A].
    pub current_a: f64,
    /// Applied duty, -1..=1.
    pub duty: f64,
    /// Bus voltage [V].
    pub bus_v: f64,
    /// Case temperature [degC].
    pub case_c: f64,
}

/// Period of the position loop on the driver's clock [us].
pub const LOOP_PERIOD_US: u64 = 1_000;

/// Stream number of sensor noise.
const PURPOSE_NOISE: u64 = 0x5E;

/// State of one driver.
#[derive(Clone, Debug)]
pub struct Driver {
    params: DriverParams,
    control: ControlState,
    transport: Transport,
    boots: u32,
    boot_ns: u64,
    next_tick_us: u64,
    last_heard_us: u64,
    edges_at_reset: Option<i64>,
    edges: i64,
    home_rad: f64,
    torque_on: bool,
    mode: Mode,
    goal_duty: f64,
    goal_rad: Option<f64>,
    applied_rad: Option<f64>,
    watchdog: Watchdog,
    hardware_error: u8,
    overload_us: u64,
    encoder_us: u64,
    readings: Readings,
    duty: f64,
    homed: bool,
    limit_a: f64,
    limited: bool,
    shutdown: u8,
    noise: Rng,
}

impl Driver {
    /// A driver that has just been powered at `now_ns`.
    #[must_use]
    pub fn new(params: DriverParams, seed: u64, joint: usize, now_ns: u64) -> Self {
        Self {
            transport: Transport::new(seed, joint),
            params,
            control: ControlState::default(),
            boots: 0,
            boot_ns: now_ns,
            next_tick_us: 0,
            last_heard_us: 0,
            edges_at_reset: None,
            edges: 0,
            home_rad: 0.0,
            torque_on: false,
            mode: Mode::Position,
            goal_duty: 0.0,
            goal_rad: None,
            applied_rad: None,
            watchdog: Watchdog::Off,
            hardware_error: 0,
            overload_us: 0,
            encoder_us: 0,
            readings: Readings::default(),
            duty: 0.0,
            homed: false,
            limit_a: f64::INFINITY,
            limited: false,
            shutdown: u8::MAX,
            noise: Rng::new(seed, PURPOSE_NOISE, joint as u64),
        }
    }

    /// Restart: torque off, zero lost, errors and watchdog cleared, clock from 0.
    pub fn reboot(&mut self, now_ns: u64) {
        let boots = self.boots.wrapping_add(1);
        let mut fresh = Self::new(self.params.clone(), 0, 0, now_ns);
        std::mem::swap(&mut fresh.transport, &mut self.transport);
        std::mem::swap(&mut fresh.noise, &mut self.noise);
        fresh.transport.clear();
        fresh.boots = boots;
        *self = fresh;
    }

    /// Parameters.
    #[must_use]
    pub fn params(&self) -> &DriverParams {
        &self.params
    }

    /// Gains and limits, writable through registers.
    pub fn control_params_mut(&mut self) -> &mut ControlParams {
        &mut self.params.control
    }

    /// Guard limits, writable through registers.
    pub fn guard_mut(&mut self) -> &mut GuardParams {
        &mut self.params.guard
    }

    /// Current limit for the bridge, beside the joint's own [A].
    pub fn set_current_limit(&mut self, limit_a: f64) {
        self.limit_a = limit_a;
    }

    /// Which hardware errors release the motor (register 63); all are latched.
    pub fn set_shutdown(&mut self, mask: u8) {
        self.shutdown = mask;
    }

    /// True once a zero was set since the last restart.
    #[must_use]
    pub fn homed(&self) -> bool {
        self.homed
    }

    /// True while current or duty stands at its limit.
    #[must_use]
    pub fn limited(&self) -> bool {
        self.limited
    }

    /// Declares the present position to be zero.
    pub fn zero_here(&mut self) {
        self.set_home(self.home_rad - self.readings.position_rad);
        self.homed = true;
    }

    /// Restarts since power-up of the emulation.
    #[must_use]
    pub fn boots(&self) -> u32 {
        self.boots
    }

    /// The driver's own clock [us since its reset].
    #[must_use]
    pub fn clock_us(&self, now_ns: u64) -> u64 {
        let elapsed_ns = now_ns.saturating_sub(self.boot_ns);
        if self.params.transport.clock_ratio == 1.0 {
            return elapsed_ns / 1_000;
        }
        (elapsed_ns as f64 * 1e-3 * self.params.transport.clock_ratio) as u64
    }

    /// What the driver last measured.
    #[must_use]
    pub fn readings(&self) -> &Readings {
        &self.readings
    }

    /// What the bridge is told; its voltage is the plant's to fill in.
    #[must_use]
    pub fn bridge(&self) -> Bridge {
        Bridge {
            duty: self.duty,
            enabled: self.torque_on,
            limit_a: self.limit_a,
            bus_v: 0.0,
        }
    }

    /// True while the motor is driven.
    #[must_use]
    pub fn torque_on(&self) -> bool {
        self.torque_on
    }

    /// Latched hardware errors ([`error_bit`]).
    #[must_use]
    pub fn hardware_error(&self) -> u8 {
        self.hardware_error
    }

    /// The bus watchdog.
    #[must_use]
    pub fn watchdog(&self) -> Watchdog {
        self.watchdog
    }

    /// Arms (limit in driver microseconds) or, with `None`, clears the watchdog.
    pub fn set_watchdog(&mut self, limit_us: Option<u64>, now_ns: u64) {
        self.last_heard_us = self.clock_us(now_ns);
        self.watchdog = limit_us.map_or(Watchdog::Off, |limit_us| Watchdog::Armed { limit_us });
    }

    /// Operating mode.
    #[must_use]
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Changes the mode; only with torque off (the registers see to it).
    pub fn set_mode(&mut self, mode: Mode) {
        self.mode = mode;
        self.goal_rad = None;
        self.goal_duty = 0.0;
    }

    /// Switches the motor. On: holds the present position. Refused (false) while a hardware error is latched.
    pub fn set_torque(&mut self, on: bool) -> bool {
        if on && self.hardware_error != 0 {
            return false;
        }
        if on != self.torque_on {
            self.transport.clear();
            self.control.release();
            self.goal_duty = 0.0;
            self.goal_rad = None;
            self.applied_rad = on.then_some(self.readings.position_rad);
            self.duty = 0.0;
        }
        self.torque_on = on;
        true
    }

    /// The last goal accepted [rad].
    #[must_use]
    pub fn goal_rad(&self) -> f64 {
        self.goal_rad.unwrap_or(self.readings.applied_setpoint_rad)
    }

    /// The last duty goal.
    #[must_use]
    pub fn goal_duty(&self) -> f64 {
        self.goal_duty
    }

    /// Offset added to encoder angles: the home position [rad].
    #[must_use]
    pub fn home_rad(&self) -> f64 {
        self.home_rad
    }

    /// Moves the zero. Positions and the set-point in force shift together, so nothing moves.
    pub fn set_home(&mut self, home_rad: f64) {
        let shift = home_rad - self.home_rad;
        self.home_rad = home_rad;
        self.readings.position_rad += shift;
        self.readings.applied_setpoint_rad += shift;
        self.applied_rad = self.applied_rad.map(|rad| rad + shift);
        self.goal_rad = self.goal_rad.map(|rad| rad + shift);
        self.transport.clear();
        self.control.forget_positions();
    }

    /// Every byte addressed to this driver feeds the watchdog.
    pub fn heard(&mut self, now_ns: u64) {
        self.last_heard_us = self.clock_us(now_ns);
    }

    /// Whether a set-point would be believed.
    ///
    /// # Errors
    /// Expired watchdog, or an implausible angle.
    pub fn check_goal(&self, goal_rad: f64) -> Result<(), GoalError> {
        if self.watchdog == Watchdog::Expired {
            return Err(GoalError::WatchdogExpired);
        }
        let step = (goal_rad - self.readings.position_rad).abs();
        let far = self.torque_on && step > self.params.guard.largest_step_rad;
        if !goal_rad.is_finite() || far {
            return Err(GoalError::Implausible);
        }
        Ok(())
    }

    /// Takes a set-point [rad, wire convention].
    ///
    /// # Errors
    /// See [`Self::check_goal`].
    pub fn set_goal(&mut self, goal_rad: f64, now_ns: u64) -> Result<(), GoalError> {
        self.check_goal(goal_rad)?;
        self.goal_rad = Some(goal_rad);
        if self.torque_on {
            self.transport
                .submit(&self.params.transport, now_ns, goal_rad);
        }
        Ok(())
    }

    /// Takes a duty goal (PWM mode).
    ///
    /// # Errors
    /// Expired watchdog, or a duty beyond 1.
    pub fn set_duty_goal(&mut self, duty: f64) -> Result<(), GoalError> {
        if self.watchdog == Watchdog::Expired {
            return Err(GoalError::WatchdogExpired);
        }
        if !duty.is_finite() || duty.abs() > 1.0 {
            return Err(GoalError::Implausible);
        }
        self.goal_duty = duty;
        Ok(())
    }

    /// Instant of the next loop tick [ns].
    #[must_use]
    pub fn next_tick_ns(&self) -> u64 {
        let ratio = self.params.transport.clock_ratio;
        let after_us = self.next_tick_us;
        let after_ns = if ratio == 1.0 {
            after_us * 1_000
        } else {
            (after_us as f64 * 1e3 / ratio) as u64
        };
        self.boot_ns + after_ns
    }

    /// One tick of the loop at `now_ns`. Returns false when the supply is too low for the electronics: the caller
    /// reboots the driver.
    pub fn tick(&mut self, now_ns: u64, sensors: &Sensors) -> bool {
        let period_us = LOOP_PERIOD_US;
        self.next_tick_us += period_us;
        let dt_s = period_us as f64 * 1e-6;
        let moved = self.read_encoder(sensors);
        let seen_rad = self
            .control
            .measure(&self.params.control, self.readings.position_rad, dt_s);
        self.readings.at_us = self.clock_us(now_ns);
        self.readings.velocity_rad_s = self.control.velocity_rad_s();
        self.readings.current_a = self.noisy(sensors.current_a, self.params.noise.current_a)
            * self.params.convention.sign;
        self.readings.duty = sensors.applied_duty * self.params.convention.sign;
        self.readings.bus_v = self
            .noisy(sensors.bus_v, self.params.noise.voltage_v)
            .max(0.0);
        self.readings.case_c = sensors.case_c;
        if sensors.bus_v < self.params.guard.brownout_v {
            return false;
        }
        self.guard(sensors, moved, period_us);
        self.watch();
        self.drive(now_ns, seen_rad, dt_s);
        true
    }

    /// A reading with its noise; without noise nothing is drawn.
    fn noisy(&mut self, value: f64, sigma: f64) -> f64 {
        if sigma > 0.0 {
            value + sigma * self.noise.normal()
        } else {
            value
        }
    }

    /// Counts edges; returns true if any passed since the last tick.
    fn read_encoder(&mut self, sensors: &Sensors) -> bool {
        let edges = libm::floor(sensors.gear_rad / sensors.edge_rad) as i64;
        let whole_turns = || {
            let turns = libm::floor(sensors.gear_rad / core::f64::consts::TAU);
            libm::round(turns * core::f64::consts::TAU / sensors.edge_rad) as i64
        };
        let first = if self.params.absolute() {
            whole_turns()
        } else {
            edges
        };
        let zero = *self.edges_at_reset.get_or_insert(first);
        let moved = edges != self.edges;
        self.edges = edges;
        let convention = &self.params.convention;
        let since_reset_rad = (edges - zero) as f64 * sensors.edge_rad;
        self.readings.position_rad = convention.wire_rad(since_reset_rad) + self.home_rad;
        moved
    }

    /// Latches hardware errors; any of them releases the motor.
    fn guard(&mut self, sensors: &Sensors, moved: bool, period_us: u64) {
        let guard = &self.params.guard;
        let mut error = 0;
        if sensors.bus_v < guard.undervolt_v || sensors.bus_v > guard.overvolt_v {
            error |= error_bit::INPUT_VOLTAGE;
        }
        if sensors.case_c > guard.overheat_c {
            error |= error_bit::OVERHEATING;
        }
        // 95 % and 50 %: "at the limit" and "driven hard", apart from rounding and ripple.
        let at_limit = sensors.current_a.abs() >= 0.95 * sensors.limit_a.min(self.limit_a);
        self.overload_us = if at_limit && self.torque_on {
            self.overload_us + period_us
        } else {
            0
        };
        let blind = self.torque_on && !moved && !at_limit && sensors.applied_duty.abs() > 0.5;
        self.encoder_us = if blind {
            self.encoder_us + period_us
        } else {
            0
        };
        if self.overload_us as f64 * 1e-6 > guard.overload_s {
            error |= error_bit::OVERLOAD;
        }
        if self.encoder_us as f64 * 1e-6 > guard.encoder_s {
            error |= error_bit::ENCODER;
        }
        self.limited = at_limit || sensors.applied_duty.abs() >= self.params.control.duty_limit;
        if self.torque_on {
            self.hardware_error |= error;
            if self.hardware_error & self.shutdown != 0 {
                self.set_torque(false);
            }
        }
    }

    fn watch(&mut self) {
        if let Watchdog::Armed { limit_us } = self.watchdog
            && self.readings.at_us.saturating_sub(self.last_heard_us) > limit_us
        {
            self.watchdog = Watchdog::Expired;
            self.transport.clear();
            self.control.release();
        }
    }

    fn drive(&mut self, now_ns: u64, seen_rad: f64, dt_s: f64) {
        if let Some(setpoint_rad) = self.transport.due(now_ns) {
            self.applied_rad = Some(setpoint_rad);
        }
        let wire_sign = self.params.convention.sign;
        self.duty = match (self.torque_on, self.watchdog, self.mode, self.applied_rad) {
            (false, ..) => 0.0,
            // Bridge on at duty 0: the winding is shorted and the joint is damped.
            (true, Watchdog::Expired, ..) | (true, _, Mode::Position, None) => 0.0,
            (true, _, Mode::Position, Some(setpoint_rad)) => {
                wire_sign
                    * self
                        .control
                        .position_loop(&self.params.control, setpoint_rad, seen_rad, dt_s)
            }
            (true, _, Mode::Pwm, _) => {
                wire_sign
                    * self
                        .control
                        .open_loop(&self.params.control, self.goal_duty, dt_s)
            }
        };
        self.readings.applied_setpoint_rad = match (self.torque_on, self.applied_rad) {
            (true, Some(setpoint_rad)) => setpoint_rad,
            _ => self.readings.position_rad,
        };
    }
}
