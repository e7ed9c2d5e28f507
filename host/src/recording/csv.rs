//! A run as CSV with the columns of the data set format (docs/recording.md).
//!
//! Time is the device clock, counted from the first CPG tick of the run. Set-points have the row of the instant they were
//! sent; each measurement has the row of its own instant. The approach to the start pose is left out: it is not the gait.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use control::robot::JOINTS;

use super::reader::RunData;
use super::rows::Feedback;

/// Measured columns of a joint, in file order.
const MEASURED: [&str; 6] = [
    "applied_setpoint_rad",
    "position_rad",
    "velocity_rad_s",
    "current_a",
    "duty",
    "temperature_c",
];

/// Values that belong to one instant.
#[derive(Debug, Clone, Default)]
struct Row {
    setpoints_rad: Option<[f64; JOINTS]>,
    torque: bool,
    feedback: [Option<Feedback>; JOINTS],
}

/// Writes the run. The same recording gives the same bytes.
#[must_use]
pub fn to_csv(run: &RunData) -> String {
    let rows = rows(run);
    let mut out = header();
    let start_us = start_us(run);
    let mut torque = false;
    for (t_us, row) in &rows {
        torque = if row.setpoints_rad.is_some() {
            row.torque
        } else {
            torque
        };
        line(&mut out, *t_us as i128 - i128::from(start_us), row, torque);
    }
    out
}

/// Device time of the first CPG tick that was recorded.
#[must_use]
pub fn start_us(run: &RunData) -> u64 {
    let first = run.samples.iter().find(|s| !s.approach);
    // A sample that was dropped at the start still counts: cycles are 50 ms apart.
    first.map_or(0, |s| {
        s.t_us
            .saturating_sub(u64::from(s.cycle) * control::CYCLE_US)
    })
}

fn header() -> String {
    let mut out = String::from("t_s,bus_v");
    for k in 0..JOINTS {
        let _ = write!(out, ",setpoint_rad_{k},enable_{k}");
        for name in MEASURED {
            let _ = write!(out, ",{name}_{k}");
        }
    }
    out.push('\n');
    out
}

/// Rows by their instant.
fn rows(run: &RunData) -> BTreeMap<u64, Row> {
    let mut rows: BTreeMap<u64, Row> = BTreeMap::new();
    for sample in run.samples.iter().filter(|s| !s.approach) {
        if sample.new_setpoint {
            let row = rows.entry(sample.t_us).or_default();
            row.setpoints_rad = Some(sample.joints.map(|j| j.setpoint_rad));
            row.torque = sample.torque;
        }
        for (k, joint) in sample.joints.iter().enumerate() {
            let Some(feedback) = joint.feedback else {
                continue;
            };
            rows.entry(feedback.t_us).or_default().feedback[k] = Some(feedback);
        }
    }
    rows
}

fn line(out: &mut String, t_us: i128, row: &Row, torque: bool) {
    let _ = write!(out, "{}", t_us as f64 / 1e6);
    let volts: Vec<f64> = row.feedback.iter().flatten().map(|f| f.voltage_v).collect();
    let mean = volts.iter().sum::<f64>() / volts.len() as f64;
    cell(
        out,
        (!volts.is_empty()).then_some((mean * 1e4).round() / 1e4),
    );
    for k in 0..JOINTS {
        cell(out, row.setpoints_rad.map(|s| s[k]));
        cell(out, Some(if torque { 1.0 } else { 0.0 }));
        let f = row.feedback[k];
        cell(out, f.map(|f| f.applied_setpoint_rad));
        cell(out, f.map(|f| f.position_rad));
        cell(out, f.map(|f| f.velocity_rad_s));
        cell(out, f.map(|f| f.current_a));
        cell(out, f.map(|f| f.duty));
        cell(out, f.map(|f| f.temperature_c));
    }
    out.push('\n');
}

fn cell(out: &mut String, value: Option<f64>) {
    out.push(',');
    if let Some(value) = value.filter(|v| v.is_finite()) {
        let _ = write!(out, "{value}");
    }
}
