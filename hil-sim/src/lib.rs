//! Emulated motor drivers, bus and robot: reality for every test without hardware.
//!
//! - [`motor`]: one geared joint (motor, gear, friction, play, heat); [`body`]: what the joints carry
//! - [`ground`]: the whole robot on the ground behind the joints; [`lab`]: camera, tracker and inertial sensor that watch it
//! - [`drawn`]: robots drawn at random inside the ranges of the paper's Table II
//! - [`driver`]: registers and the 1 kHz loop of one motor driver
//! - [`fault`]: seeded faults; [`effects`]: effects by their shared names
//! - [`scenario`]: all of it from a file
//! - [`bus`]: the half-duplex wire, byte by byte
//! - [`world`]: drivers, joints, supply, body and bus on one virtual clock
//! - `board`: the firmware image in QEMU, on Unix
//! - [`robot`]: the firmware application run natively against all of the above
//! - [`schedule`]: seeded schedules of faults over the whole chain, and the laws that hold in each
//!
//! - [`recorder`]: data sets with a known truth
//! - [`endpoint`], [`pace`]: pseudo-terminal, TCP, serial port, and the wall clock for foreign clients
//!
//! Everything but the last line is deterministic: time and seeds are arguments.

#![forbid(unsafe_code)]

#[cfg(unix)]
pub mod board;
pub mod body;
pub mod bus;
pub mod drawn;
pub mod driver;
pub mod effects;
pub mod endpoint;
pub mod fault;
pub mod ground;
pub mod lab;
pub mod motor;
pub mod pace;
pub mod plant;
pub mod recorder;
pub mod rng;
pub mod robot;
pub mod scenario;
pub mod schedule;
pub mod supply;
pub mod world;
