//! One joint: its parameters, its recording and its simulation.
//!
//! The model in one line: `J ddq = tau(u, V, dq) - G sin(q) - friction(dq, load)`, with `u` from the joint's own controller
//! and every effect of the stages conventions .. transmission as a parameter that is neutral by default. Units are those of
//! the bench: rad and N m, or m and N.

pub mod arrival;
mod command;
pub mod data;
mod instants;
pub mod lanes;
pub(crate) mod merge;
pub mod nominal;
pub mod param;
pub mod sim;
mod stop;

pub use data::{Problem, RunData, Sample};
pub use lanes::{Errors, Weights};
pub use nominal::{Known, Nominal};
pub use param::{P, Params};
pub use sim::{Channel, Trace, simulate, simulate_all};
