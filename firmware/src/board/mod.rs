//! The boards. Each is one file that implements [`crate::stm32::parts::BoardFile`], with its memory map `NAME.x` beside it.

#[cfg(feature = "board-g474")]
mod g474;
#[cfg(feature = "board-l475")]
mod l475;

#[cfg(feature = "board-g474")]
pub(crate) use g474::G474 as Chosen;
#[cfg(feature = "board-l475")]
pub(crate) use l475::L475 as Chosen;
