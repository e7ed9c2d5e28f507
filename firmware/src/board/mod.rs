//! The boards. Each is one file that implements [`crate::stm32::parts::BoardFile`], with its memory map `NAME.x` beside it.

#[cfg(feature = "board-l475")]
mod l475;

#[cfg(feature = "board-l475")]
pub(crate) use l475::L475 as Chosen;
