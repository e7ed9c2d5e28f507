//! Emulated motor drivers, bus and robot: reality for every test without hardware.

pub mod robot;
