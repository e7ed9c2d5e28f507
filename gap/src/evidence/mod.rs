//! One likelihood for the search of causes.
//!
//! The chain is cut wherever something was measured. Every cut gives a block of prediction errors over short
//! horizons; each is linear in the coefficients of its columns, an effect of a fixed shape being one column or
//! some. A block is whitened by a model of its own correlation ([`noise`]); what simulators and parts differ by is
//! a column with a small prior ([`block`]), learned from robots without a cause ([`ensemble`]). A servo's block is linear around
//! the stated numbers that fit best ([`settle`]). A cause is a Gaussian prior over coefficients of one block or many
//! ([`cause`]); the evidence of a set of causes has a closed form ([`search`]).

pub mod alike;
pub mod block;
pub mod cause;
pub mod ensemble;
pub mod kept;
pub mod linear;
pub mod noise;
mod plays;
pub mod search;
pub mod settle;
