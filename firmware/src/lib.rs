//! The module firmware without its board: application core, slot store, tasks generic over the traits in [`ports`].
//!
//! The same code runs on the STM32 (the binary of this crate), in QEMU, and natively in the emulated robot.
//! Layers, inside out:
//!
//! * [`app`]: the sans-I/O core. Messages and driver replies in, set-points, replies and telemetry out. Reads no clock.
//! * [`slots`], [`crash`]: flash records and the fault block as bytes.
//! * [`entropy`]: the test of the random number generator and the seed of challenges.
//! * [`tasks`]: async loops that move bytes between the core and the traits; [`tasks::run`] joins them all.
//! * [`ports`]: the traits that a board implements.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::indexing_slicing,
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable
    )
)]

pub mod app;
pub mod crash;
pub mod entropy;
pub mod ports;
pub mod shared;
pub mod slots;
pub mod tasks;

/// Name and version of the application, as told on the link.
pub const FIRMWARE_ID: &str = concat!("rb-firmware ", env!("CARGO_PKG_VERSION"));
