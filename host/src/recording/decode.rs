//! Rows to CDR messages and back.

use control::machine::MAX_JOINTS;

use super::cdr::{CdrError, CdrReader, CdrWriter};
use super::rows::{EventRow, Feedback, JointRow, SampleRow, joint_names};

/// `std_msgs/Header`, with the recording time as stamp.
fn header(w: &mut CdrWriter, time_ns: u64) {
    // Seconds fit until 2038, as in every ROS 2 header.
    w.i32(i32::try_from(time_ns / 1_000_000_000).unwrap_or(i32::MAX));
    w.u32((time_ns % 1_000_000_000) as u32);
    w.string("");
}

fn skip_header(r: &mut CdrReader<'_>) -> Result<(), CdrError> {
    r.i32()?;
    r.u32()?;
    r.string().map(drop)
}

fn names(w: &mut CdrWriter, joints: usize) {
    w.sequence(joint_names(joints).iter(), |w, name| w.string(name));
}

/// `sensor_msgs/JointState`: positions and speeds; no effort, because drivers measure none.
pub(super) fn joint_state(row: &SampleRow, time_ns: u64) -> Vec<u8> {
    let mut w = CdrWriter::default();
    header(&mut w, time_ns);
    names(&mut w, row.joints.len());
    numbers(&mut w, row, |f| f.position_rad);
    numbers(&mut w, row, |f| f.velocity_rad_s);
    w.sequence(core::iter::empty::<f64>(), CdrWriter::f64);
    w.finish()
}

/// A list of one field of the feedback, NaN where a driver did not answer.
fn numbers(w: &mut CdrWriter, row: &SampleRow, field: impl Fn(&Feedback) -> f64) {
    let values = row
        .joints
        .iter()
        .map(|j| j.feedback.as_ref().map_or(f64::NAN, &field));
    w.sequence(values, CdrWriter::f64);
}

/// `rb_msgs/Motors`.
pub(super) fn motors(row: &SampleRow, time_ns: u64) -> Vec<u8> {
    let mut w = CdrWriter::default();
    header(&mut w, time_ns);
    w.u32(row.run);
    w.u32(row.cycle);
    w.u64(row.t_us);
    for flag in [row.hold, row.approach, row.torque, row.new_setpoint] {
        w.bool(flag);
    }
    names(&mut w, row.joints.len());
    let joints = &row.joints;
    w.sequence(joints.iter(), |w, j| w.bool(j.feedback.is_some()));
    w.sequence(joints.iter(), |w, j| {
        w.u64(j.feedback.map_or(0, |f| f.t_us))
    });
    w.sequence(joints.iter(), |w, j| w.f64(j.setpoint_rad));
    numbers(&mut w, row, |f| f.applied_setpoint_rad);
    numbers(&mut w, row, |f| f.position_rad);
    numbers(&mut w, row, |f| f.velocity_rad_s);
    numbers(&mut w, row, |f| f.current_a);
    numbers(&mut w, row, |f| f.duty);
    numbers(&mut w, row, |f| f.voltage_v);
    numbers(&mut w, row, |f| f.temperature_c);
    w.sequence(joints.iter(), |w, j| {
        w.u16(j.feedback.map_or(0, |f| f.status))
    });
    w.finish()
}

/// Reads what [`motors`] wrote.
pub(super) fn read_motors(message: &[u8]) -> Result<SampleRow, CdrError> {
    let mut r = CdrReader::new(message)?;
    skip_header(&mut r)?;
    let mut row = SampleRow {
        run: r.u32()?,
        cycle: r.u32()?,
        t_us: r.u64()?,
        hold: r.bool()?,
        approach: r.bool()?,
        torque: r.bool()?,
        new_setpoint: r.bool()?,
        joints: Vec::new(),
    };
    r.sequence(5, CdrReader::string)?;
    let answered = r.sequence(1, CdrReader::bool)?;
    let joints = answered.len();
    let t_us = per_joint(joints, r.sequence(8, CdrReader::u64)?)?;
    let mut fields = Vec::new();
    for _ in 0..8 {
        fields.push(per_joint(joints, r.sequence(8, CdrReader::f64)?)?);
    }
    let status = per_joint(joints, r.sequence(2, CdrReader::u16)?)?;
    for k in 0..joints {
        let field = |index: usize| fields[index][k];
        row.joints.push(JointRow {
            setpoint_rad: field(0),
            feedback: answered[k].then(|| Feedback {
                t_us: t_us[k],
                applied_setpoint_rad: field(1),
                position_rad: field(2),
                velocity_rad_s: field(3),
                current_a: field(4),
                duty: field(5),
                voltage_v: field(6),
                temperature_c: field(7),
                status: status[k],
            }),
        });
    }
    Ok(row)
}

/// A list with one entry for each joint, of a robot that can be.
fn per_joint<T>(joints: usize, list: Vec<T>) -> Result<Vec<T>, CdrError> {
    if list.len() == joints && (1..=MAX_JOINTS).contains(&joints) {
        Ok(list)
    } else {
        Err(CdrError::Length)
    }
}

/// `rb_msgs/Cpg`.
pub(super) fn cpg(run: u32, cycle: u32, setpoints_rad: &[f64], time_ns: u64) -> Vec<u8> {
    let mut w = CdrWriter::default();
    header(&mut w, time_ns);
    w.u32(run);
    w.u32(cycle);
    names(&mut w, setpoints_rad.len());
    w.sequence(setpoints_rad.iter(), |w, v| w.f64(*v));
    w.finish()
}

/// `rb_msgs/Event`.
pub(super) fn event(row: &EventRow, time_ns: u64) -> Vec<u8> {
    let mut w = CdrWriter::default();
    header(&mut w, time_ns);
    w.u32(row.run);
    w.u32(row.seq);
    w.u64(row.t_us);
    w.string(&row.source);
    w.string(&row.kind);
    w.string(&row.text);
    w.finish()
}

/// Reads what [`event`] wrote.
pub(super) fn read_event(message: &[u8]) -> Result<EventRow, CdrError> {
    let mut r = CdrReader::new(message)?;
    skip_header(&mut r)?;
    Ok(EventRow {
        run: r.u32()?,
        seq: r.u32()?,
        t_us: r.u64()?,
        source: r.string()?,
        kind: r.string()?,
        text: r.string()?,
    })
}
