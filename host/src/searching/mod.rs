//! Folders, curves and engines of the searches (`rb-host optimise`).

pub mod curve;
pub mod films;
pub mod folder;
pub mod frames;
#[cfg(feature = "mpi")]
pub mod mpi_engine;
pub mod tables;
