//! The image for the module's microcontroller. On the host it is an empty program, so that the workspace builds there.
//!
//! A board is one file `board_<chip>.rs` that implements the traits of `firmware::ports` and has a function `start`.
//! The other `board_*` files hold what any Cortex-M board can share.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod board_clock;
#[cfg(target_os = "none")]
mod board_executor;
#[cfg(target_os = "none")]
mod board_fault;
#[cfg(target_os = "none")]
mod board_l475vg;
#[cfg(target_os = "none")]
mod board_log;
#[cfg(target_os = "none")]
mod board_rng;
#[cfg(target_os = "none")]
mod board_store;
#[cfg(target_os = "none")]
mod board_uart;

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    board_executor::run(board_l475vg::start)
}

#[cfg(not(target_os = "none"))]
fn main() {}
