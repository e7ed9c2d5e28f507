//! The wire is frozen by its bytes: one file per protocol version.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

#[path = "../common/mod.rs"]
mod common;
mod v01;
