//! What a driver does when it is asked.

use crate::bus::feedback::PackedFeedback;
use crate::bus::indirect::Indirect;
use crate::bus::packet::StatusError;
use crate::bus::table::Register;

/// What a factory reset leaves as it is (Robotis e-manual, Protocol 2.0, Factory Reset).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Keep {
    /// Nothing; not for all drivers at once, because they would get one id.
    Nothing,
    /// The id.
    Id,
    /// The id and the baud rate.
    IdAndBaud,
}

impl Keep {
    pub(super) fn from_params(params: &[u8], broadcast: bool) -> Option<Self> {
        match params {
            [0xFF] if !broadcast => Some(Self::Nothing),
            [0x01] => Some(Self::Id),
            [0x02] => Some(Self::IdAndBaud),
            _ => None,
        }
    }
}

/// What a driver does.
pub trait DriverHandler {
    /// An instruction for this driver has arrived whole at `now_ns`, it feeds the bus watchdog. What is read next was measured now.
    fn latch(&mut self, now_ns: u64);
    /// Value of a register; unsigned ones with their bits in place.
    fn read(&self, register: Register) -> i32;
    /// The packed block, as latched.
    fn feedback(&mut self) -> PackedFeedback;
    /// Sets a register. Address, access and range of the table are checked already; the driver checks what depends on its state and limits.
    ///
    /// # Errors
    /// A status error: nothing was changed.
    fn write(&mut self, register: Register, value: i32) -> Result<(), StatusError>;
    /// Restart: RAM registers to defaults, torque off, zero lost.
    fn reboot(&mut self);
    /// Indirect addresses, of a driver that has the X-series table and no block of ours.
    fn indirect(&self) -> Option<&Indirect> {
        None
    }
    /// Takes other indirect addresses.
    fn set_indirect(&mut self, _map: Indirect) {}
    /// Every register back to its default but what is kept, then a restart.
    ///
    /// # Errors
    /// [`StatusError::Instruction`] of a driver that cannot.
    fn factory_reset(&mut self, _keep: Keep) -> Result<(), StatusError> {
        Err(StatusError::Instruction)
    }
    /// Takes whole turns off the position.
    ///
    /// # Errors
    /// [`StatusError::Instruction`] of a driver that cannot; [`StatusError::Result`] while torque is on.
    fn clear_turns(&mut self) -> Result<(), StatusError> {
        Err(StatusError::Instruction)
    }
}
