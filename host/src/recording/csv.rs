//! A run as CSV with the columns of the data set format (docs/recording.md).
//!
//! Time is the device clock, counted from the first CPG tick of the run. Set-points have the row of the instant they were
//! sent; each measurement has the row of its own instant. The way to the start pose and the stop are left out: they are not
//! the gait.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use control::robot::JOINTS;

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

/// From the instant of the measurement to the end of the packet with the new set-points, us: six answers of 30 bytes and one
/// packet of 44 bytes at 10 us a byte (1 Mbaud), the same in every cycle.
const EXCHANGE_US: u64 = (6 * 30 + 44) * 10;

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
    let mut out = header();
    let Some(timing) = Timing::of(run) else {
        return out;
    };
    let mut torque = false;
    for (t_us, row) in &rows(run, &timing) {
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
        );
    }
    out
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
fn rows(run: &RunData, timing: &Timing) -> BTreeMap<u64, Row> {
    let mut rows: BTreeMap<u64, Row> = BTreeMap::new();
    for sample in run.samples.iter().filter(|s| timing.is_gait(s)) {
        if sample.new_setpoint {
            let measured_us = sample
                .joints
                .iter()
                .flat_map(|j| j.feedback)
                .map(|f| f.t_us.saturating_sub(sample.t_us));
            let bus_us = measured_us.max().unwrap_or(0) + EXCHANGE_US;
            let row = rows.entry(timing.sent_us(sample) + bus_us).or_default();
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
