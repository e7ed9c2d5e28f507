//! The two wires as bytes: host link and motor bus, and the server dispatch shared by real and emulated devices. no_std, no I/O.
#![no_std]
