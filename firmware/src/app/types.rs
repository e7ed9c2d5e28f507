//! What several parts of the application share: sizes of the module, the inputs of a cycle and its output. Imports no other part.

use control::machine::MAX_JOINTS;
use heapless::Vec;

/// Host links of a module: a cable and a radio, in any order.
pub const LINKS: usize = 2;
/// Time of one byte on the motor bus in us: 10 bits at 1 Mbaud.
pub const BUS_BYTE_US: u64 = 10;
/// Largest bus packet either way: sync read reply of one driver, sync write of six, or a raw packet of the host.
pub(crate) const BUS_BUFFER: usize = 320;

/// What the board reads at the begin of a cycle.
#[derive(Debug, Clone, Copy, Default)]
pub struct BoardInputs {
    /// Battery, mV; `None` = not measured.
    pub battery_mv: Option<u16>,
    /// STOP input.
    pub stop_pressed: bool,
}

/// Values for the drivers, each with its bus address.
pub(crate) type Values = Vec<(u8, i32), MAX_JOINTS>;

/// What a cycle sends and what it has to tell.
#[derive(Debug, Default)]
pub(crate) struct Outgoing {
    /// Set-points, driver's frame.
    pub goals: Values,
    /// Flags of the samples until the next decision.
    pub flags: u8,
    /// The STOP input was pressed when last read.
    pub stop_input: bool,
}

impl Outgoing {
    pub(crate) const fn new() -> Self {
        Self {
            goals: Values::new(),
            flags: 0,
            stop_input: false,
        }
    }
}

/// What the cycle task does next on the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Step {
    /// Send the first `len` bytes of the buffer (none: only listen), then listen for `reply_bytes` byte times plus `gap_us`.
    Exchange {
        /// Bytes to send.
        len: usize,
        /// Bytes that may come back.
        reply_bytes: usize,
        /// Waiting time beyond the byte times, us.
        gap_us: u64,
    },
    /// The bus is done for this instant.
    #[default]
    Done,
}
