//! The body simulator: seven bodies, six joints, contacts, named effects, many trials side by side.
//!
//! [`Params`] come from a `files::model::Model`; a [`Trial`] adds how it starts and what drives it; [`run`] gives an [`Outcome`] per trial.
//!
//! ```
//! use physics::{Drive, Options, Params, Start, Trial, run};
//! use std::sync::Arc;
//!
//! let params = Arc::new(Params::try_from(&files::model::Model::hand_tuned()).unwrap());
//! let trial = Trial {
//!     params,
//!     start: Start::HomeAtOnce,
//!     drive: Drive::SetPoints { period_s: 1.0, values_rad: Arc::from([0.0; 6]) },
//!     duration_s: 0.2,
//! };
//! let outcome = &run(&[trial], &Options::default()).unwrap()[0];
//! assert!(outcome.not_finite.is_none());
//! assert!(outcome.distance_m < 1e-4);
//! ```
#![deny(unsafe_code)]

mod body;
mod dispatch;
mod drive;
mod engine;
mod lane;
pub mod laws;
mod linear;
pub mod mjcf;
pub mod noise;
mod params;
mod robot;
mod rollout;
mod trial;

pub use body::{Body, Imu, JointDrive};
pub use dispatch::{Level, run, run_at, run_probed};
pub use engine::{Probe, Stage};
pub use params::{GRAVITY_M_S2, JointParams, Params, ParamsError};
pub use robot::{HalfShape, JointClass, MAX_JOINTS, RawBody, RawHalf, RawRobot, Robot, RobotError};
pub use trial::{
    CONTROL_RATE_HZ, Drive, NotFinite, Options, Outcome, Pose, RunError, Start, Trial, Twist,
};
