//! The whole robot without hardware: the firmware's own tasks on a virtual clock, over emulated bus, motors, link and flash.

pub mod executor;
pub mod flash;
