//! Other physics engines on the same robot and the same gaits: what the body simulator is measured against.
//!
//! MuJoCo and ODE are driven by small C programs of ours, built on the spot where the library is found; what they lack is an error that says
//! what to install. This crate writes files and starts programs; nothing that computes a result for a user depends on it.

mod foreign;
mod gaits;
#[cfg(feature = "rapier")]
pub mod rapier;
mod speed;
mod track;

pub use foreign::{Cone, Mujoco, Ode, PeerError, Workplace, mujoco_package};
pub use gaits::{bounceless, clear_trials, random_gait, with_effects};
pub use speed::{MUJOCO_TRIALS, Quality, Share, SpeedRow, SpeedTable, profile, speed_table};
pub use track::{JOINTS, Report, TICKS, Track, ours, set_points};
