//! The position loop of a driver, once per millisecond of the driver's own clock.
//!
//! Duty = kp kv (set-point - position) - kv speed + integral, limited: the "cascade" law of the data set format. The
//! velocity limit bounds the speed of the set-point that the loop follows (X-series profile velocity).

use std::collections::VecDeque;

/// Gains, limits and the effects of the driver stage.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlParams {
    /// Position gain [1/s].
    pub kp_1_s: f64,
    /// Speed gain, duty per rad/s at the output [s/rad].
    pub kv_s_rad: f64,
    /// Damping beside `kv_s_rad`, which also damps [s/rad]; position D gain.
    pub kv_damping_s_rad: f64,
    /// Integral gain, duty per rad s [1/(rad s)].
    pub ki_1_rad_s: f64,
    /// Largest duty, 0..=1.
    pub duty_limit: f64,
    /// `velocity_limit`: largest speed of the followed set-point [rad/s]; neutral infinite.
    pub velocity_limit_rad_s: f64,
    /// `loop_gain`: share of the error path's gain; neutral 1.
    pub loop_gain_ratio: f64,
    /// `damping_gain`: share of the speed path's gain; neutral 1.
    pub damping_gain_ratio: f64,
    /// `deadband`: half width of the error that counts as none [rad]; neutral 0.
    pub deadband_half_width_rad: f64,
    /// `feedback_delay`: age of the encoder reading in the loop [s]; neutral 0.
    pub feedback_delay_s: f64,
    /// `motor_lag`: first-order lag from computed to applied duty [s]; neutral 0.
    pub motor_lag_s: f64,
}

impl Default for ControlParams {
    fn default() -> Self {
        Self {
            // The hand-tuned control parameter P of Table II.
            kp_1_s: 10.0,
            // Chosen: speed loop of about 50 Hz on the reflected rotor inertia, five times the position loop's rate
            // and a phase margin above 50 degrees with the 1 kHz sampling and the two-tick speed estimate.
            kv_s_rad: 0.8,
            // Chosen: a proportional drive as the simulator's servo; integral action is there to be switched on.
            kv_damping_s_rad: 0.0,
            ki_1_rad_s: 0.0,
            duty_limit: 1.0,
            velocity_limit_rad_s: f64::INFINITY,
            loop_gain_ratio: 1.0,
            damping_gain_ratio: 1.0,
            deadband_half_width_rad: 0.0,
            feedback_delay_s: 0.0,
            motor_lag_s: 0.0,
        }
    }
}

/// Memory of the loop.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ControlState {
    integral_duty: f64,
    duty: f64,
    /// Set-point under the velocity limit [rad].
    followed_rad: Option<f64>,
    /// Speed estimate [rad/s].
    velocity_rad_s: f64,
    /// Newest position last.
    history: VecDeque<f64>,
}

/// Ticks between the two positions of the speed estimate. Two: one tick of delay, half the quantisation noise of one.
const SPEED_TICKS: usize = 2;

impl ControlState {
    /// Speed estimate [rad/s].
    #[must_use]
    pub fn velocity_rad_s(&self) -> f64 {
        self.velocity_rad_s
    }

    /// Forgets integral and duty (torque switched off); keeps the position history.
    pub fn release(&mut self) {
        self.integral_duty = 0.0;
        self.duty = 0.0;
        self.followed_rad = None;
    }

    /// Takes in an encoder position and updates the speed estimate. Called every tick, torque on or off.
    /// Returns the position that the loop sees.
    pub fn measure(&mut self, params: &ControlParams, position_rad: f64, dt_s: f64) -> f64 {
        let delay_ticks = libm::round(params.feedback_delay_s / dt_s) as usize;
        let keep = delay_ticks + SPEED_TICKS + 1;
        self.history.push_back(position_rad);
        while self.history.len() > keep {
            self.history.pop_front();
        }
        let newest = self.history.len() - 1;
        let seen_at = newest.saturating_sub(delay_ticks);
        let before_at = seen_at.saturating_sub(SPEED_TICKS);
        let seen = self.history[seen_at];
        let ticks = seen_at - before_at;
        self.velocity_rad_s = if ticks == 0 {
            0.0
        } else {
            (seen - self.history[before_at]) / (ticks as f64 * dt_s)
        };
        seen
    }

    /// Forgets positions (the zero moved).
    pub fn forget_positions(&mut self) {
        self.history.clear();
        self.velocity_rad_s = 0.0;
        self.followed_rad = None;
    }

    /// One tick of the position loop: duty for a set-point and the position from [`Self::measure`].
    pub fn position_loop(
        &mut self,
        params: &ControlParams,
        setpoint_rad: f64,
        seen_rad: f64,
        dt_s: f64,
    ) -> f64 {
        let raw_error = self.follow(params, setpoint_rad, seen_rad, dt_s) - seen_rad;
        let half = params.deadband_half_width_rad;
        let error = if raw_error > half {
            raw_error - half
        } else if raw_error < -half {
            raw_error + half
        } else {
            0.0
        };
        let damping = params.damping_gain_ratio * params.kv_s_rad + params.kv_damping_s_rad;
        let proportional = params.loop_gain_ratio * params.kp_1_s * params.kv_s_rad * error
            - damping * self.velocity_rad_s;
        let integral = self.integral_duty + params.ki_1_rad_s * error * dt_s;
        let wanted = proportional + integral;
        let limited = wanted.clamp(-params.duty_limit, params.duty_limit);
        // Anti-windup: the integral moves only while the output is free, or towards freedom.
        if wanted == limited || (wanted - limited) * error < 0.0 {
            self.integral_duty = integral.clamp(-params.duty_limit, params.duty_limit);
        }
        self.lag(params, limited, dt_s)
    }

    /// Duty demanded directly (PWM mode), through the same limit and lag.
    pub fn open_loop(&mut self, params: &ControlParams, duty: f64, dt_s: f64) -> f64 {
        self.integral_duty = 0.0;
        self.lag(
            params,
            duty.clamp(-params.duty_limit, params.duty_limit),
            dt_s,
        )
    }

    /// The set-point that the loop follows under the velocity limit [rad].
    fn follow(
        &mut self,
        params: &ControlParams,
        setpoint_rad: f64,
        seen_rad: f64,
        dt_s: f64,
    ) -> f64 {
        let most = params.velocity_limit_rad_s * dt_s;
        if most.is_infinite() {
            self.followed_rad = Some(setpoint_rad);
            return setpoint_rad;
        }
        let from = self.followed_rad.unwrap_or(seen_rad);
        let next = from + (setpoint_rad - from).clamp(-most, most);
        self.followed_rad = Some(next);
        next
    }

    fn lag(&mut self, params: &ControlParams, duty: f64, dt_s: f64) -> f64 {
        self.duty = if params.motor_lag_s > 0.0 {
            // Exact step answer of a first-order lag.
            duty + (self.duty - duty) * libm::exp(-dt_s / params.motor_lag_s)
        } else {
            duty
        };
        self.duty
    }
}
