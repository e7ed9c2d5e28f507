//! What boards with an STM32 share: everything but pins, clocks, memory map and reset flags, which [`parts::BoardFile`] asks of a board.

pub(crate) mod clock;
pub(crate) mod executor;
pub(crate) mod fault;
pub(crate) mod log;
pub(crate) mod parts;
pub(crate) mod rng;
pub(crate) mod start;
pub(crate) mod store;
pub(crate) mod uart;
