//! Telemetry of the wire as rows of a recording.

use protocol::link::telemetry::flags;
use protocol::link::{Event, MotorSample, Sample};
use protocol::units::{
    A_PER_CURRENT_COUNT, DUTY_PER_COUNT, RAD_S_PER_VELOCITY_COUNT, V_PER_VOLTAGE_COUNT,
};

use super::text;
use crate::recording::{EventRow, Feedback, JointRow, SampleRow};

/// A sample as a row of run `run`.
#[must_use]
pub fn row(run: u32, sample: &Sample) -> SampleRow {
    let joints = sample.motors.iter().enumerate().map(|(index, motor)| {
        let answered = sample.valid_mask & (1 << index) != 0;
        JointRow {
            setpoint_rad: rad(motor.setpoint_urad),
            feedback: answered.then(|| feedback(sample.t_us, motor)),
        }
    });
    let flag = |bit: u8| sample.flags & bit != 0;
    SampleRow {
        run,
        cycle: sample.cycle,
        t_us: sample.t_us,
        hold: flag(flags::HOLD),
        approach: flag(flags::APPROACH),
        torque: flag(flags::TORQUE),
        new_setpoint: flag(flags::NEW_SETPOINT),
        joints: joints.collect(),
    }
}

fn rad(urad: i32) -> f64 {
    f64::from(urad) / 1e6
}

fn feedback(t_us: u64, motor: &MotorSample) -> Feedback {
    let packed = &motor.feedback;
    Feedback {
        t_us: t_us.saturating_add(u64::from(motor.dt_us)),
        applied_setpoint_rad: rad(packed.applied_urad),
        position_rad: rad(packed.position_urad),
        velocity_rad_s: neat(f64::from(packed.velocity) * RAD_S_PER_VELOCITY_COUNT),
        current_a: neat(f64::from(packed.current_ma) * A_PER_CURRENT_COUNT),
        duty: neat(f64::from(packed.duty) * DUTY_PER_COUNT),
        voltage_v: neat(f64::from(packed.voltage_5mv) * V_PER_VOLTAGE_COUNT),
        temperature_c: f64::from(packed.temperature_c),
        status: u16::from(packed.status),
    }
}

/// Removes the last bits of a product of a whole number and a decimal step, so that 17 x 0.005 is written 0.085.
fn neat(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

/// An event as a row of run `run`.
#[must_use]
pub fn event_row(run: u32, event: &Event) -> EventRow {
    let (kind, words) = text::event(event);
    EventRow {
        run,
        seq: event.seq,
        t_us: event.t_us,
        source: "module".to_owned(),
        kind: kind.to_owned(),
        text: words,
    }
}
