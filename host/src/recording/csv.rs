//! A run as CSV with the columns of the data set format (docs/how-to/record.md).
//!
//! Time is the device clock, counted from the first CPG tick of the run. Set-points have the row of the instant they were
//! sent; each measurement has the row of its own instant. The way to the start pose and the stop are left out: they are not
//! the gait.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use super::beside::{BaseRow, ImuRow};
use super::reader::RunData;
use super::rows::Feedback;
use super::timing::Timing;

/// Measured columns of a joint, in file order.
const MEASURED: [&str; 6] = [
    "applied_setpoint_rad",
    "position_rad",
    "velocity_rad_s",
    "current_a",
    "duty",
    "temperature_c",
];

/// From the instant of the measurement to the end of the packet with the new set-points, us, the same in every cycle. Each joint answers with
/// 30 bytes; the packet has 14 bytes and 5 for each joint. A byte takes 10 us (1 Mbaud).
const fn exchange_us(joints: u64) -> u64 {
    (joints * 30 + 14 + joints * 5) * 10
}

/// Values that belong to one instant.
#[derive(Debug, Clone, Default)]
struct Row {
    setpoints_rad: Option<Vec<f64>>,
    torque: bool,
    /// Empty, or one entry for each joint.
    feedback: Vec<Option<Feedback>>,
    base: Option<[f64; 7]>,
    imu: Option<[f64; 6]>,
}

/// Columns of a base pose.
const BASE: [&str; 7] = [
    "base_x_m", "base_y_m", "base_z_m", "base_qw", "base_qx", "base_qy", "base_qz",
];
/// Columns of the inertial sensor.
const IMU: [&str; 6] = [
    "gyro_rad_s_x",
    "gyro_rad_s_y",
    "gyro_rad_s_z",
    "accel_m_s2_x",
    "accel_m_s2_y",
    "accel_m_s2_z",
];

/// Writes the run. The same recording gives the same bytes.
#[must_use]
pub fn to_csv(run: &RunData) -> String {
    to_csv_beside(run, &[], &[])
}

/// Writes the run with base poses and inertial readings on the time of the run; columns of what is empty are left out.
#[must_use]
pub fn to_csv_beside(run: &RunData, base: &[BaseRow], imu: &[ImuRow]) -> String {
    let columns = Columns {
        joints: run.samples.first().map_or(0, |sample| sample.joints.len()),
        base: !base.is_empty(),
        imu: !imu.is_empty(),
    };
    let mut out = header(&columns);
    let Some(timing) = Timing::of(run) else {
        return out;
    };
    let mut rows = rows(run, &timing);
    let at_us = |t_s: f64| {
        timing
            .start_us
            .saturating_add((t_s * 1e6).round().max(0.0) as u64)
    };
    for row in base {
        let [x, y, z] = row.position_m;
        let [qw, qx, qy, qz] = row.quaternion;
        rows.entry(at_us(row.t_s)).or_default().base = Some([x, y, z, qw, qx, qy, qz]);
    }
    for row in imu {
        let ([a, b, c], [d, e, f]) = (row.gyro_rad_s, row.accel_m_s2);
        rows.entry(at_us(row.t_s)).or_default().imu = Some([a, b, c, d, e, f]);
    }
    let mut torque = false;
    for (t_us, row) in &rows {
        torque = if row.setpoints_rad.is_some() {
            row.torque
        } else {
            torque
        };
        line(
            &mut out,
            *t_us as i128 - i128::from(timing.start_us),
            row,
            torque,
            &columns,
        );
    }
    out
}

/// How many joints, and which columns stand behind theirs.
struct Columns {
    joints: usize,
    base: bool,
    imu: bool,
}

fn header(columns: &Columns) -> String {
    let mut out = String::from("t_s,bus_v");
    for k in 0..columns.joints {
        let _ = write!(out, ",setpoint_rad_{k},enable_{k}");
        for name in MEASURED {
            let _ = write!(out, ",{name}_{k}");
        }
    }
    let imu = IMU.iter().filter(|_| columns.imu);
    for name in BASE.iter().filter(|_| columns.base).chain(imu) {
        let _ = write!(out, ",{name}");
    }
    out.push('\n');
    out
}

/// Rows by their instant.
fn rows(run: &RunData, timing: &Timing) -> BTreeMap<u64, Row> {
    let mut rows: BTreeMap<u64, Row> = BTreeMap::new();
    for sample in run.samples.iter().filter(|s| timing.is_gait(s)) {
        if sample.new_setpoint {
            let measured_us = sample
                .joints
                .iter()
                .flat_map(|j| j.feedback)
                .map(|f| f.t_us.saturating_sub(sample.t_us));
            let bus_us = measured_us.max().unwrap_or(0) + exchange_us(sample.joints.len() as u64);
            let row = rows.entry(timing.sent_us(sample) + bus_us).or_default();
            row.setpoints_rad = Some(sample.joints.iter().map(|j| j.setpoint_rad).collect());
            row.torque = sample.torque;
        }
        for (k, joint) in sample.joints.iter().enumerate() {
            let Some(feedback) = joint.feedback else {
                continue;
            };
            let row = rows.entry(feedback.t_us).or_default();
            row.feedback.resize(sample.joints.len(), None);
            row.feedback[k] = Some(feedback);
        }
    }
    rows
}

fn line(out: &mut String, t_us: i128, row: &Row, torque: bool, columns: &Columns) {
    let _ = write!(out, "{}", t_us as f64 / 1e6);
    let volts: Vec<f64> = row.feedback.iter().flatten().map(|f| f.voltage_v).collect();
    let mean = volts.iter().sum::<f64>() / volts.len() as f64;
    cell(
        out,
        (!volts.is_empty()).then_some((mean * 1e4).round() / 1e4),
    );
    for k in 0..columns.joints {
        let setpoints = row.setpoints_rad.as_ref();
        cell(out, setpoints.and_then(|s| s.get(k)).copied());
        cell(out, Some(if torque { 1.0 } else { 0.0 }));
        let f = row.feedback.get(k).copied().flatten();
        cell(out, f.map(|f| f.applied_setpoint_rad));
        cell(out, f.map(|f| f.position_rad));
        cell(out, f.map(|f| f.velocity_rad_s));
        cell(out, f.map(|f| f.current_a));
        cell(out, f.map(|f| f.duty));
        cell(out, f.map(|f| f.temperature_c));
    }
    if columns.base {
        for k in 0..BASE.len() {
            cell(out, row.base.map(|b| b[k]));
        }
    }
    if columns.imu {
        for k in 0..IMU.len() {
            cell(out, row.imu.map(|i| i[k]));
        }
    }
    out.push('\n');
}

fn cell(out: &mut String, value: Option<f64>) {
    out.push(',');
    if let Some(value) = value.filter(|v| v.is_finite()) {
        let _ = write!(out, "{value}");
    }
}
