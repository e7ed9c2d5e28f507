//! Overhead camera: silhouettes of the true shapes, similarity R, overlays.
