//! The two wires as bytes: host link and motor bus, and the server dispatch shared by real and emulated devices. no_std, no I/O.
//!
//! * [`link`]: host to module, over USB serial, Bluetooth serial, TCP or in process.
//! * [`bus`]: module to motor drivers, Dynamixel Protocol 2.0 over RS485.
//!
//! Nothing here reads a clock, a port or a random source: time, bytes and nonces are arguments. Nothing here can panic or allocate.
//! `docs/reference/protocol.md` is the description for people.
#![no_std]
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

pub mod bus;
pub mod crc;
pub mod link;
pub mod units;
