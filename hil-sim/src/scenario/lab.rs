//! The tables of a scenario that belong to the robot on the ground: where it starts and what watches it.

use super::error::{ScenarioError, ScenarioProblem};
use super::reader::Table;
use crate::ground::Place;
use crate::lab::{CameraParams, CameraSetup, ClockParams, ImuParams, LabParams, TrackerParams};

/// Where the robot is put down, and how well.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StartParams {
    /// Mean place.
    pub place: Place,
    /// Standard deviation of each coordinate [m].
    pub sigma_m: f64,
    /// Standard deviation of the turn [rad].
    pub sigma_rad: f64,
}

/// The Kinect's depth image, 640 x 480 and 57 degrees across, over the middle; at the middle of Table II's range of heights.
const KINECT: CameraSetup = CameraSetup {
    height_m: 2.25,
    x_m: 0.0,
    y_m: 0.0,
    yaw_rad: 0.0,
    width_px: 640,
    height_px: 480,
    focal_px: 580.0,
    rate_hz: 30.0,
};
/// Chosen: what marker trackers reach over a few metres.
const TRACKER: TrackerParams = TrackerParams {
    rate_hz: 30.0,
    sigma_m: 0.0005,
    sigma_rad: 0.002,
};
/// Chosen: noise density of a cheap MEMS sensor over a bandwidth of 50 Hz.
const IMU: ImuParams = ImuParams {
    rate_hz: 100.0,
    gyro_sigma_rad_s: 0.001,
    accel_sigma_m_s2: 0.02,
};
/// Largest rate of an instrument [Hz]: one sample per step of the body.
const FASTEST_HZ: f64 = 1000.0;

/// Reads `[start]`, `[camera]`, `[tracker]` and `[imu]`; all of them need the robot on the ground.
pub(super) fn read(
    top: &mut Table<'_>,
    on_ground: bool,
) -> Result<(StartParams, LabParams), ScenarioError> {
    let mut tables = [None, None, None, None];
    for (slot, key) in tables.iter_mut().zip(["start", "camera", "tracker", "imu"]) {
        *slot = top.table(key)?;
        if let Some(table) = slot.as_ref().filter(|_| !on_ground) {
            return Err(table.error(table.start(), ScenarioProblem::NeedsGround { table: key }));
        }
    }
    let [start_table, camera_table, tracker_table, imu_table] = tables;
    let start = start_table.map(start).transpose()?.unwrap_or_default();
    let mut lab = LabParams::default();
    if let Some(table) = camera_table {
        let (camera, clock) = camera(table)?;
        lab.camera = Some(camera);
        lab.clock = clock;
    }
    lab.tracker = tracker_table.map(tracker).transpose()?;
    lab.imu = imu_table.map(imu).transpose()?;
    Ok((start, lab))
}

fn start(mut table: Table<'_>) -> Result<StartParams, ScenarioError> {
    let mut angle = |key, max: f64| {
        table
            .number(key, -max, max)
            .map(|deg| deg.unwrap_or(0.0).to_radians())
    };
    let (yaw_rad, sigma_rad) = (angle("yaw_deg", 360.0)?, angle("sigma_deg", 90.0)?.abs());
    let mut length = |key, min, max| table.number(key, min, max).map(|m| m.unwrap_or(0.0));
    let params = StartParams {
        place: Place {
            x_m: length("x_m", -10.0, 10.0)?,
            y_m: length("y_m", -10.0, 10.0)?,
            yaw_rad,
        },
        sigma_m: length("sigma_m", 0.0, 1.0)?,
        sigma_rad,
    };
    table.finish()?;
    Ok(params)
}

fn camera(mut table: Table<'_>) -> Result<(CameraParams, ClockParams), ScenarioError> {
    let mut number = |key, min, max, default: f64| {
        table
            .number(key, min, max)
            .map(|value| value.unwrap_or(default))
    };
    let setup = CameraSetup {
        height_m: number("height_m", 0.5, 10.0, KINECT.height_m)?,
        x_m: number("x_m", -10.0, 10.0, KINECT.x_m)?,
        y_m: number("y_m", -10.0, 10.0, KINECT.y_m)?,
        yaw_rad: number("yaw_deg", -360.0, 360.0, KINECT.yaw_rad)?.to_radians(),
        width_px: number("width_px", 16.0, 4096.0, KINECT.width_px as f64)? as usize,
        height_px: number("height_px", 16.0, 4096.0, KINECT.height_px as f64)? as usize,
        focal_px: number("focal_px", 10.0, 10_000.0, KINECT.focal_px)?,
        rate_hz: number("rate_hz", 1.0, FASTEST_HZ, KINECT.rate_hz)?,
    };
    let clock = ClockParams {
        ahead_s: number("clock_ahead_s", 0.0, 1e6, 0.0)?,
        ratio: number("clock_ratio", 0.99, 1.01, 1.0)?,
    };
    let camera = CameraParams::try_from(setup)
        .map_err(|error| table.error(table.start(), ScenarioProblem::View(error)))?;
    table.finish()?;
    Ok((camera, clock))
}

fn tracker(mut table: Table<'_>) -> Result<TrackerParams, ScenarioError> {
    let sigma_deg = table.number("sigma_deg", 0.0, 90.0)?;
    let params = TrackerParams {
        rate_hz: table
            .number("rate_hz", 1.0, FASTEST_HZ)?
            .unwrap_or(TRACKER.rate_hz),
        sigma_m: table
            .number("sigma_m", 0.0, 1.0)?
            .unwrap_or(TRACKER.sigma_m),
        sigma_rad: sigma_deg.map_or(TRACKER.sigma_rad, f64::to_radians),
    };
    table.finish()?;
    Ok(params)
}

fn imu(mut table: Table<'_>) -> Result<ImuParams, ScenarioError> {
    let params = ImuParams {
        rate_hz: table
            .number("rate_hz", 1.0, FASTEST_HZ)?
            .unwrap_or(IMU.rate_hz),
        gyro_sigma_rad_s: table
            .number("gyro_sigma_rad_s", 0.0, 10.0)?
            .unwrap_or(IMU.gyro_sigma_rad_s),
        accel_sigma_m_s2: table
            .number("accel_sigma_m_s2", 0.0, 100.0)?
            .unwrap_or(IMU.accel_sigma_m_s2),
    };
    table.finish()?;
    Ok(params)
}
