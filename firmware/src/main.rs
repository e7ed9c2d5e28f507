//! The image for the module's microcontroller. On the host it is an empty program, so that the workspace builds there.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
use embassy_stm32 as _;
#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! { loop {} }

#[cfg(not(target_os = "none"))]
fn main() {}
