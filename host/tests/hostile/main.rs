//! Files from strangers, thousands of them: each ends with an exit code and clean text, within 512 MiB and 20 s of processor time.
//! Signals: every long command ends.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod files;
mod markup;
#[path = "../cli/rig.rs"]
#[allow(dead_code, reason = "the other test binary uses the rest")]
mod rig;
mod signals;
