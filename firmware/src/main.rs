//! The image for the module's microcontroller. On the host it is an empty program, so that the workspace builds there.
//!
//! A board is one file in `board/`, chosen by a feature of this crate. `stm32/` holds what boards share.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(boards = "none")]
compile_error!("no board is chosen: build with exactly one feature `board-NAME`");
#[cfg(boards = "several")]
compile_error!(
    "several boards are chosen: build with exactly one feature `board-NAME`; one that is not the default needs `--no-default-features`"
);

#[cfg(all(target_os = "none", boards = "one"))]
mod board;
#[cfg(all(target_os = "none", boards = "one"))]
mod stm32;

#[cfg(all(target_os = "none", boards = "one"))]
#[cortex_m_rt::entry]
fn main() -> ! {
    stm32::executor::run(stm32::start::start)
}

#[cfg(not(target_os = "none"))]
fn main() {}
