//! Everything that is fixed about a driver.

use protocol::bus::Profile;

use super::control::ControlParams;
use super::transport::TransportParams;

/// Conventions between the wire and the joint, `joint = sign * scale * wire + offset`; neutral +1, 1, 0.
#[derive(Clone, Debug, PartialEq)]
pub struct ConventionParams {
    /// `joint_sign`: -1 mirrors set-points and readings.
    pub sign: f64,
    /// `joint_scale`: true angle over wire angle; not zero.
    pub scale: f64,
    /// `joint_offset`: true angle at the wire's zero [rad].
    pub offset_rad: f64,
}

impl ConventionParams {
    /// Angle on the wire of a joint at `joint_rad` [rad].
    #[must_use]
    pub fn wire_rad(&self, joint_rad: f64) -> f64 {
        (joint_rad - self.offset_rad) * self.sign / self.scale
    }
}

impl Default for ConventionParams {
    fn default() -> Self {
        Self {
            sign: 1.0,
            scale: 1.0,
            offset_rad: 0.0,
        }
    }
}

/// When the driver protects itself.
#[derive(Clone, Debug, PartialEq)]
pub struct GuardParams {
    /// Case temperature that latches an overheating error [degC].
    pub overheat_c: f64,
    /// Bus voltage below which the motor errors (input voltage) [V].
    pub undervolt_v: f64,
    /// Bus voltage above which the motor errors (input voltage) [V].
    pub overvolt_v: f64,
    /// Bus voltage below which the electronics reset [V].
    pub brownout_v: f64,
    /// Time at the current limit that latches an overload error [s].
    pub overload_s: f64,
    /// Time without an encoder edge under strong duty and little current that latches an encoder error [s].
    pub encoder_s: f64,
    /// Farthest set-point from the present position that is believed while torque is on [rad].
    pub largest_step_rad: f64,
}

impl Default for GuardParams {
    fn default() -> Self {
        Self {
            overheat_c: 80.0, // X-series factory temperature limit (register 31)
            undervolt_v: 6.0, // two LiPo cells at 3.0 V: empty
            overvolt_v: 16.8, // four LiPo cells at 4.2 V: full
            brownout_v: 4.5,  // chosen: a 3.3 V regulator's drop-out with margin
            overload_s: 3.0,  // chosen: longer than any stance of a 0.2 Hz gait holds the limit
            encoder_s: 0.5,   // chosen: 1.4 rad at no-load speed, far more than any stiction
            // A set-point moves at most 0.139 rad per 50 ms; half a turn off the position is no gait.
            largest_step_rad: core::f64::consts::PI,
        }
    }
}

/// Noise of the driver's analogue inputs, white per tick; neutral 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NoiseParams {
    /// Standard deviation of the current reading [A].
    pub current_a: f64,
    /// Standard deviation of the bus voltage reading [V].
    pub voltage_v: f64,
}

/// Everything that is fixed about a driver.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DriverParams {
    /// Position loop.
    pub control: ControlParams,
    /// Set-point path and clock.
    pub transport: TransportParams,
    /// Sign, scale, zero.
    pub convention: ConventionParams,
    /// Self-protection.
    pub guard: GuardParams,
    /// Noise of what it reports.
    pub noise: NoiseParams,
    /// From the last byte of a request to the first of the reply [ns].
    pub return_delay_ns: u64,
    /// Table and frames that it offers.
    pub profile: Profile,
}

impl DriverParams {
    /// Whether the encoder sits at the output and knows the angle within a turn after a restart: every off-the-shelf servo here. Ours counts
    /// edges at the motor.
    #[must_use]
    pub fn absolute(&self) -> bool {
        self.profile != Profile::Packed
    }
}
