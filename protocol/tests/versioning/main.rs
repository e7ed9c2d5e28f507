//! The wire is frozen by its bytes: one file per protocol version.

#[path = "../common/mod.rs"]
mod common;
mod v01;
