//! The law every part links: gait, CPG, kinematics, collision pre-check, supervisor. `no_std`, no I/O, no clock.
//!
//! Firmware, emulator and simulator call the same functions with the same f32 arithmetic, so the same input gives the same bits
//! on every host and on the Cortex-M4F: no fused multiply-add, no `f64`, own sine ([`math`]).
//!
//! Reading order: [`gait`] (what is uploaded) → [`cpg`] (set-points from a gait) → [`machine`] (which robot) → [`kinematics`] and
//! [`geometry`] (where its bodies are) → [`precheck`] (may this move be made) → [`motion`] (what leaves for the motors) →
//! [`supervisor`] (may anything move).
//!
//! Nothing here can panic: a `thumbv7em` image links with the panic handler's symbol undefined.
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

#[cfg(test)]
extern crate std;

pub mod cpg;
mod distance;
pub mod gait;
pub mod geometry;
pub mod kinematics;
pub mod linalg;
pub mod machine;
pub mod math;
pub mod motion;
mod motion_types;
pub mod precheck;
pub mod robot;
pub mod supervisor;
mod supervisor_types;

/// Length of one control cycle, s: the CPG runs at 20 Hz (paper, section III).
pub const CYCLE_S: f32 = 0.05;

/// Length of one control cycle in microseconds of the module's clock.
pub const CYCLE_US: u64 = 50_000;
