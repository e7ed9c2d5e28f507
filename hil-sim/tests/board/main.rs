//! The firmware image in QEMU against the native firmware and the law. Without QEMU every test says aloud that it is
//! skipped; in CI that is a failure.
#![cfg(unix)]

mod common;
mod faults;
mod serve;
mod set_points;
mod ticks;
