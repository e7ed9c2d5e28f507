//! The evidence about the diagnosis: robots and joints with known causes, and how right the diagnosis is about them.
//!
//! - [`joint`], [`robot`]: data set folders of the emulated joint and robot; `trials/foreign` has those of other
//!   engines
//! - [`graft`]: exact faults put onto real recordings
//! - [`label`]: what was planted, one format for every generator; [`evidence`]: how much of it a recording shows
//! - [`score`]: verdicts against labels
//! - [`cli`]: the commands of `rb-trials`
//!
//! The diagnosis is a program here, `rb-host gap report`, that is given a folder and nothing else: this crate does not
//! link it.

#![forbid(unsafe_code)]

pub mod cli;
pub mod evidence;
pub mod gaits;
pub mod graft;
pub mod joint;
pub mod label;
pub mod robot;
pub mod score;
