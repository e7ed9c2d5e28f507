//! Gait search, selection of gaits, and meta-optimisation of model parameters.
//!
//! The search is the paper's section V: a swarm over the 17 numbers of a gait, three repetitions with noise on the CPG outputs.
//! Fitness is 0 on internal collision, otherwise the mean speed, less for gaits whose repetitions part and for hard impacts.
//! [`search`] owns the swarm and the archive, [`score`] the fitness, [`select`] the choice of gaits for the robot. What a trial is
//! made of stays outside: a search takes anything that implements [`search::GaitTrials`].

pub mod meta;
pub mod score;
pub mod search;
pub mod select;
pub mod settings;
pub mod shard;
pub mod simulated;
pub mod space;
pub mod table2;
