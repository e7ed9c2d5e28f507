//! Folders, curves and engines of the searches (`rb-host optimise`).

pub mod curve;
pub mod folder;
#[cfg(feature = "mpi")]
pub mod mpi_engine;
