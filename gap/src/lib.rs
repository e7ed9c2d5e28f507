//! Diagnosis of the sim-to-real gap: where, which effect, how far it shrinks.

pub mod bench;
pub mod candidates;
pub mod decide;
pub mod evidence;
pub mod experiment;
pub mod floor;
pub mod joint;
pub mod locate;
pub mod math;
pub mod names;
pub mod patch;
pub mod predict;
pub mod regimes;
pub mod report;
mod sentence;
pub mod verdict;
pub mod vocabulary;
pub mod watch;
pub mod whole;
