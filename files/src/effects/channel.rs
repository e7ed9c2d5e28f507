//! What a recording may hold, as the registry names it.

use crate::dataset::Signal;

/// A signal that may show an effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// A signal that every joint has.
    Joint(Signal),
    /// Bus voltage.
    BusVoltage,
    /// Pose of body 3 in the world.
    BasePose,
    /// Gyroscope and accelerometer of body 3.
    Imu,
    /// Silhouettes from above.
    Film,
}

impl Channel {
    /// Columns of the data set, without joint index; `frames` for a film.
    #[must_use]
    pub fn columns(self) -> &'static str {
        use crate::dataset::{Motion, header_name};
        match self {
            Channel::Joint(signal) => header_name(signal, Motion::Rotary),
            Channel::BusVoltage => "bus_v",
            Channel::BasePose => "base_*",
            Channel::Imu => "gyro_*, accel_*",
            Channel::Film => "frames",
        }
    }
}

pub(super) const APPLIED: Channel = Channel::Joint(Signal::AppliedSetpoint);
pub(super) const POSITION: Channel = Channel::Joint(Signal::Position);
pub(super) const LINK: Channel = Channel::Joint(Signal::LinkPosition);
pub(super) const VELOCITY: Channel = Channel::Joint(Signal::Velocity);
pub(super) const CURRENT: Channel = Channel::Joint(Signal::Current);
pub(super) const EFFORT: Channel = Channel::Joint(Signal::Effort);
pub(super) const DUTY: Channel = Channel::Joint(Signal::Duty);
pub(super) const TEMPERATURE: Channel = Channel::Joint(Signal::Temperature);
