//! System tests: one binary, one module per promise.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod foreign_clients;
mod keys;
mod layers;
mod readable;
mod tidy;
