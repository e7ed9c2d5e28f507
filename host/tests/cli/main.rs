//! rb-host from the outside: exit codes, messages, files, and a robot at the other end of the wire.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod bad_gaits;
mod bench;
mod browser;
mod camera;
mod change;
mod commands;
mod docs;
mod dropout;
mod everyday;
mod filmed;
mod foreign_reality;
mod foreign_robot;
mod gap_data;
mod gap_files;
mod gap_film;
mod gap_runs;
mod gap_withheld;
mod gap_without;
mod hybrid;
mod joints;
mod killed;
mod matching;
mod model;
mod python;
mod recordings;
#[cfg(unix)]
mod rfcomm;
mod rig;
mod search;
mod servos;
#[cfg(target_os = "linux")]
mod terminal;
mod tether;
mod untrusted;
