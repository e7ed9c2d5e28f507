//! Drives a world over its bus as the module does and records what comes back: data sets with a known truth.
//!
//! Columns are those of the data set folder (`dataset.toml` and CSV). Set-point rows carry the master's clock,
//! measured rows the driver's, so that a skewed driver clock shows as it would on a robot. The link angle, which no
//! driver can measure, is written only when asked for.

use std::fmt::Write as _;

use protocol::bus::{Exchange, PackedFeedback, Register, Request};
use protocol::units;
use thiserror::Error;

use crate::driver::LOOP_PERIOD_US;
use crate::world::World;

/// What to record.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Set-points per second.
    pub setpoint_hz: u32,
    /// Readings per second, a multiple of the set-points'.
    pub feedback_hz: u32,
    /// Length of the record [s].
    pub duration_s: f64,
    /// Time to come to the first set-point before the record begins [s].
    pub approach_s: f64,
    /// Whether the link angle is recorded too (a camera or a second encoder saw it).
    pub link: bool,
}

impl Default for Plan {
    fn default() -> Self {
        // 20 Hz as the CPG; 100 Hz as the telemetry on request.
        Self {
            setpoint_hz: 20,
            feedback_hz: 100,
            duration_s: 20.0,
            approach_s: 3.0,
            link: false,
        }
    }
}

/// One joint at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// What the driver reported.
    pub feedback: PackedFeedback,
    /// True link angle [rad].
    pub link_rad: f64,
}

/// A row: a set-point or a reading.
#[derive(Clone, Debug, PartialEq)]
pub enum Row {
    /// Set-points sent at this time of the master's clock.
    SetPoints {
        /// [s] since the record began.
        t_s: f64,
        /// Per joint [rad].
        setpoint_rad: Vec<f64>,
    },
    /// Readings of the joints whose driver measured at this time of its own clock.
    Reading {
        /// [s] since the record began.
        t_s: f64,
        /// Per joint; `None` = no answer, or measured at another instant.
        joints: Vec<Option<Measured>>,
    },
}

impl Row {
    /// Time of the row [s].
    #[must_use]
    pub fn t_s(&self) -> f64 {
        match self {
            Self::SetPoints { t_s, .. } | Self::Reading { t_s, .. } => *t_s,
        }
    }
}

/// Why nothing could be recorded.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum RecordError {
    /// A driver refused torque or did not answer.
    #[error("driver {id} did not switch its torque on: is it faulty in this scenario?")]
    NoTorque {
        /// Address.
        id: u8,
    },
    /// The rates do not fit each other.
    #[error(
        "{feedback_hz} readings per second are no multiple of {setpoint_hz} set-points per second"
    )]
    Rates {
        /// Readings per second.
        feedback_hz: u32,
        /// Set-points per second.
        setpoint_hz: u32,
    },
    /// More joints than one request can address.
    #[error("{joints} joints do not fit one request")]
    TooMany {
        /// Joints.
        joints: usize,
    },
}

/// How long drivers may take to answer [ns]: six silent ones at the longest return delay.
const ANSWER_NS: u64 = 4_000_000;

/// Runs `setpoints` (time since the record began to one angle per joint [rad]) on the drivers at `ids`, joint order.
///
/// # Errors
/// Unusable rates or too many joints; a driver that does not switch on.
pub fn record(
    world: &mut World,
    ids: &[u8],
    plan: &Plan,
    setpoints: &mut dyn FnMut(f64) -> Vec<f64>,
) -> Result<Vec<Row>, RecordError> {
    let Plan {
        setpoint_hz,
        feedback_hz,
        ..
    } = *plan;
    if setpoint_hz == 0 || feedback_hz == 0 || !feedback_hz.is_multiple_of(setpoint_hz) {
        return Err(RecordError::Rates {
            feedback_hz,
            setpoint_hz,
        });
    }
    let too_many = |_| RecordError::TooMany { joints: ids.len() };
    let request = Request::feedback(ids).map_err(too_many)?;
    for &id in ids {
        switch_on(world, id)?;
    }
    approach(world, ids, plan, &setpoints(0.0)).map_err(too_many)?;
    let period_ns = 1_000_000_000 / u64::from(feedback_hz);
    let every = u64::from(feedback_hz / setpoint_hz);
    let begun_ns = world.now_ns();
    // A reading may be one loop period old: no time may be negative.
    let origin_ns = begun_ns.saturating_sub(LOOP_PERIOD_US * 1_000);
    let cycles = (plan.duration_s * f64::from(feedback_hz)) as u64;
    let mut rows = Vec::new();
    for cycle in 0..cycles {
        world.advance_to(begun_ns + cycle * period_ns);
        if cycle % every == 0 {
            let t_s = (cycle * period_ns) as f64 * 1e-9;
            let setpoint_rad = setpoints(t_s);
            let sent_ns = send(world, ids, &setpoint_rad).map_err(too_many)?;
            rows.push(Row::SetPoints {
                t_s: (sent_ns - origin_ns) as f64 * 1e-9,
                setpoint_rad,
            });
        }
        read(world, &request, origin_ns, &mut rows);
    }
    rows.sort_by(|a, b| a.t_s().total_cmp(&b.t_s()));
    Ok(rows)
}

fn switch_on(world: &mut World, id: u8) -> Result<(), RecordError> {
    let refused = RecordError::NoTorque { id };
    let request = Request::write(id, Register::TorqueEnable, 1).map_err(|_| refused.clone())?;
    let answers = ask(world, &request);
    if answers.first().is_some_and(|(_, ok, _)| *ok) {
        Ok(())
    } else {
        Err(refused)
    }
}

/// Sends a request and collects (id, no error, packed block) of every answer.
fn ask(world: &mut World, request: &Request) -> Vec<(u8, bool, Option<PackedFeedback>)> {
    let sent_ns = world.write_bytes(world.now_ns(), request.bytes());
    let mut exchange = Exchange::new(request.clone());
    let mut answers = Vec::new();
    while !exchange.is_complete()
        && let Some(arrival) = world.advance_to_byte(sent_ns + ANSWER_NS)
    {
        exchange.push(arrival.byte);
        while let Some(answer) = exchange.next_answer() {
            answers.push((answer.id, answer.error.is_none(), answer.feedback()));
        }
    }
    answers
}

/// A set-point on the wire, in micro-radians.
fn urad(angle_rad: f64) -> i32 {
    libm::round(angle_rad * 1e6) as i32
}

fn send(world: &mut World, ids: &[u8], goals_rad: &[f64]) -> Result<u64, protocol::bus::TooLong> {
    let goals: Vec<_> = ids
        .iter()
        .zip(goals_rad)
        .map(|(id, rad)| (*id, urad(*rad)))
        .collect();
    let request = Request::set_points(&goals)?;
    Ok(world.write_bytes(world.now_ns(), request.bytes()))
}

/// Straight to the first set-point in small steps, then a rest of a third of the time.
fn approach(
    world: &mut World,
    ids: &[u8],
    plan: &Plan,
    first_rad: &[f64],
) -> Result<(), protocol::bus::TooLong> {
    let steps = ((plan.approach_s * f64::from(plan.setpoint_hz)) as u64).max(1);
    let moving = (steps * 2 / 3).max(1);
    let period_ns = 1_000_000_000 / u64::from(plan.setpoint_hz);
    let start: Vec<f64> = (0..ids.len())
        .map(|k| {
            world
                .driver(k)
                .map_or(0.0, |driver| driver.readings().position_rad)
        })
        .collect();
    let begun_ns = world.now_ns();
    for step in 1..=steps {
        let share = (step.min(moving) as f64) / moving as f64;
        let goals: Vec<f64> = start
            .iter()
            .zip(first_rad)
            .map(|(from, to)| from + share * (to - from))
            .collect();
        send(world, ids, &goals)?;
        world.advance_to(begun_ns + step * period_ns);
    }
    Ok(())
}

fn read(world: &mut World, request: &Request, origin_ns: u64, rows: &mut Vec<Row>) {
    let ids = request.ids();
    let asked_ns = world.now_ns();
    let links: Vec<f64> = (0..ids.len())
        .map(|k| world.joint(k).map_or(0.0, |joint| joint.link_rad))
        .collect();
    let mut by_time: Vec<(f64, Vec<Option<Measured>>)> = Vec::new();
    for (id, _, feedback) in ask(world, request) {
        let Some((joint, feedback)) = ids.iter().position(|&other| other == id).zip(feedback)
        else {
            continue;
        };
        let t_s = (device_time_us(feedback.tick_4us, asked_ns) - origin_ns as f64 * 1e-3) * 1e-6;
        let measured = Measured {
            feedback,
            link_rad: links.get(joint).copied().unwrap_or(0.0),
        };
        let place = match by_time.iter().position(|(at, _)| (at - t_s).abs() < 1e-9) {
            Some(place) => place,
            None => {
                by_time.push((t_s, vec![None; ids.len()]));
                by_time.len() - 1
            }
        };
        if let Some(cell) = by_time
            .get_mut(place)
            .and_then(|(_, joints)| joints.get_mut(joint))
        {
            *cell = Some(measured);
        }
    }
    by_time.sort_by(|a, b| a.0.total_cmp(&b.0));
    rows.extend(
        by_time
            .into_iter()
            .map(|(t_s, joints)| Row::Reading { t_s, joints }),
    );
}

/// Full driver time of a 16-bit tick that was taken near `now_ns` [us]. Drivers were powered at time 0.
fn device_time_us(tick_4us: u16, now_ns: u64) -> f64 {
    let wrap_us = f64::from(units::US_PER_TICK) * 65_536.0;
    let tick_us = f64::from(tick_4us) * f64::from(units::US_PER_TICK);
    let now_us = now_ns as f64 * 1e-3;
    tick_us + wrap_us * libm::round((now_us - tick_us) / wrap_us)
}

/// The record as CSV of the data set folder. One joint has no suffix, several have `_0`, `_1`, ...
#[must_use]
pub fn to_csv(rows: &[Row], joints: usize, link: bool) -> String {
    let suffix = |k: usize| {
        if joints == 1 {
            String::new()
        } else {
            format!("_{k}")
        }
    };
    let mut columns = vec![
        "setpoint_rad",
        "enable",
        "applied_setpoint_rad",
        "position_rad",
        "velocity_rad_s",
    ];
    columns.extend(["current_a", "duty", "temperature_c"]);
    if link {
        columns.push("link_position_rad");
    }
    let mut text = "t_s,bus_v".to_owned();
    for k in 0..joints {
        for column in &columns {
            let _ = write!(text, ",{column}{}", suffix(k));
        }
    }
    text.push('\n');
    for row in rows {
        csv_row(&mut text, row, joints, link);
    }
    text
}

fn csv_row(text: &mut String, row: &Row, joints: usize, link: bool) {
    match row {
        Row::SetPoints { t_s, setpoint_rad } => {
            let _ = write!(text, "{t_s:.6},");
            for rad in setpoint_rad.iter().take(joints) {
                let _ = write!(text, ",{rad:.6},1,,,,,,{}", if link { "," } else { "" });
            }
        }
        Row::Reading { t_s, joints: cells } => {
            let volts = cells
                .iter()
                .flatten()
                .next()
                .map(|m| units::v_from_voltage(m.feedback.voltage_5mv));
            let _ = write!(text, "{t_s:.6},{:.3}", volts.unwrap_or(0.0));
            for cell in cells.iter().take(joints) {
                match cell {
                    Some(measured) => csv_cell(text, measured, link),
                    None => text.push_str(if link { ",,,,,,,,," } else { ",,,,,,,," }),
                }
            }
        }
    }
    text.push('\n');
}

fn csv_cell(text: &mut String, measured: &Measured, link: bool) {
    let f = &measured.feedback;
    let enable = u8::from(f.status & protocol::bus::feedback::status::TORQUE != 0);
    let _ = write!(
        text,
        ",,{enable},{:.6},{:.6},{:.4},{:.3},{:.4},{}",
        f64::from(f.applied_urad) * 1e-6,
        f64::from(f.position_urad) * 1e-6,
        f64::from(f.velocity) * units::RAD_S_PER_VELOCITY_COUNT,
        f64::from(f.current_ma) * 1e-3,
        f64::from(f.duty) * units::DUTY_PER_COUNT,
        f.temperature_c,
    );
    if link {
        let _ = write!(text, ",{:.6}", measured.link_rad);
    }
}
