//! Shared by the tests: a camera.
#![allow(unreachable_pub, reason = "each test binary has its own copy")]

use control::robot::RobotModel;
use optimise::meta::{FilmMaker, FilmSettings};

/// A small camera straight above the origin that compares every `stride`th frame.
pub fn camera(stride: usize) -> FilmMaker {
    let settings = FilmSettings {
        rate_hz: 30.0,
        x_m: 0.0,
        y_m: 0.0,
        yaw_rad: 0.0,
        width_px: 160,
        height_px: 120,
        focal_px: 145.0,
        stride,
    };
    FilmMaker::new(settings, &RobotModel::default())
}
