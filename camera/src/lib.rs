//! Overhead camera: silhouettes of the true shapes, similarity R, overlays.
//!
//! Two ways lead to a [`Silhouette`]: [`View::draw`] draws a meta-module at given poses as the virtual camera sees it
//! ([`View::render`] any convex solids), and [`depth`] cuts the robot out of measured depth frames. [`similarity`] compares the two by the paper's
//! equations (6) to (8), [`picture`] and [`viewer`] show them, [`sync`] lays a film on the clock of the robot. Nothing here opens files: bytes in, bytes out.

pub mod depth;
mod outline;
pub mod picture;
mod silhouette;
pub mod similarity;
mod solid;
pub mod sync;
mod view;
pub mod viewer;

pub use outline::{MetaModule, Scratch};
pub use silhouette::Silhouette;
pub use solid::Solid;
pub use view::{View, ViewError};
