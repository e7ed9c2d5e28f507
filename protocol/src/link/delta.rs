//! The delta code of one sample against the ones before it. Exact: every residual wraps, whatever the numbers are.
//!
//! Per sample: cycle and time as differences, flags and mask as they are. Per motor: a 16-bit mask of the fields whose residual is not zero,
//! then these residuals as zigzag varints. Predictors: position and tick go on in a straight line; a set-point that changes makes the same step as
//! at its last change; the applied set-point keeps its distance to the set-point; everything else stays.

use super::JOINTS;
use super::telemetry::{MotorSample, Sample};
use crate::bus::PackedFeedback;

/// Fields of a motor.
const FIELDS: usize = 12;

/// Largest code of one motor: mask, then 5 bytes for each of dt, set-point, applied, position, 3 for each of tick, velocity, current, duty,
/// voltage, temperature and 2 for status and boots.
const MAX_MOTOR: usize = 2 + 4 * 5 + 6 * 3 + 2 * 2;

/// Largest code of one sample: cycle 5, time 10, flags 1, mask 1, motors.
pub(super) const MAX_SAMPLE: usize = 17 + JOINTS * MAX_MOTOR;

/// What encoder and decoder remember; both start from zeros.
#[derive(Debug, Clone, Copy)]
pub(super) struct SampleDelta {
    last: Sample,
    motors: [MotorHistory; JOINTS],
}

#[derive(Debug, Clone, Copy)]
struct MotorHistory {
    /// Last difference of the tick.
    tick_step: i32,
    /// Last difference of the position.
    position_step: i32,
    /// Last difference of the set-point that was not zero.
    setpoint_step: i32,
}

impl SampleDelta {
    /// Nothing seen.
    #[must_use]
    pub(super) const fn new() -> Self {
        let nothing = MotorHistory {
            tick_step: 0,
            position_step: 0,
            setpoint_step: 0,
        };
        Self {
            last: Sample::ZERO,
            motors: [nothing; JOINTS],
        }
    }

    /// Writes the code of `sample`; returns its length.
    pub(super) fn encode(&mut self, sample: &Sample, out: &mut [u8; MAX_SAMPLE]) -> usize {
        let mut writer = Writer { out, len: 0 };
        writer.varint(u64::from(zigzag(
            sample.cycle.wrapping_sub(self.last.cycle) as i32,
        )));
        writer.varint(zigzag64(sample.t_us.wrapping_sub(self.last.t_us) as i64));
        writer.byte(sample.flags);
        writer.byte(sample.valid_mask);
        let histories = self.motors.iter_mut().zip(&self.last.motors);
        for (motor, (history, last)) in sample.motors.iter().zip(histories) {
            let residuals = history.residuals(last, motor);
            let mut mask = 0_u16;
            for (bit, residual) in residuals.iter().enumerate() {
                mask |= u16::from(*residual != 0) << bit;
            }
            let [low, high] = mask.to_le_bytes();
            writer.byte(low);
            writer.byte(high);
            for residual in residuals {
                if residual != 0 {
                    writer.varint(u64::from(zigzag(residual)));
                }
            }
            history.follow(last, motor);
        }
        self.last = *sample;
        writer.len
    }

    /// Reads one sample; `None` when the bytes end early or a number is impossible.
    pub(super) fn decode<'a>(&mut self, bytes: &'a [u8]) -> Option<(Sample, &'a [u8])> {
        let mut reader = Reader { rest: bytes };
        let mut sample = Sample {
            cycle: self
                .last
                .cycle
                .wrapping_add(unzigzag(reader.varint32()?) as u32),
            t_us: self
                .last
                .t_us
                .wrapping_add(unzigzag64(reader.varint()?) as u64),
            flags: reader.byte()?,
            valid_mask: reader.byte()?,
            motors: self.last.motors,
        };
        let histories = self.motors.iter_mut().zip(&self.last.motors);
        for (motor, (history, last)) in sample.motors.iter_mut().zip(histories) {
            let mask = u16::from_le_bytes([reader.byte()?, reader.byte()?]);
            if mask >> FIELDS != 0 {
                return None;
            }
            let mut residuals = [0; FIELDS];
            for (bit, residual) in residuals.iter_mut().enumerate() {
                if mask & (1 << bit) != 0 {
                    *residual = unzigzag(reader.varint32()?);
                }
            }
            *motor = history.restore(last, &residuals)?;
            history.follow(last, motor);
        }
        self.last = sample;
        Some((sample, reader.rest))
    }
}

impl MotorHistory {
    fn residuals(&self, last: &MotorSample, now: &MotorSample) -> [i32; FIELDS] {
        let (was, is) = (&last.feedback, &now.feedback);
        let setpoint = if now.setpoint_urad == last.setpoint_urad {
            0
        } else {
            // Zero must mean "unchanged", so a step equal to the last one is coded as the last step's own complement: see `changed_setpoint`.
            changed_setpoint(
                now.setpoint_urad.wrapping_sub(last.setpoint_urad),
                self.setpoint_step,
            )
        };
        [
            is.position_urad
                .wrapping_sub(was.position_urad)
                .wrapping_sub(self.position_step),
            i32::from(is.velocity.wrapping_sub(was.velocity)),
            i32::from(is.current_ma.wrapping_sub(was.current_ma)),
            i32::from(is.duty.wrapping_sub(was.duty)),
            setpoint,
            now.dt_us.wrapping_sub(last.dt_us) as i32,
            i32::from(is.voltage_5mv.wrapping_sub(was.voltage_5mv) as i16),
            i32::from(
                is.tick_4us
                    .wrapping_sub(was.tick_4us)
                    .wrapping_sub(self.tick_step as u16) as i16,
            ),
            is.applied_urad
                .wrapping_sub(now.setpoint_urad)
                .wrapping_sub(was.applied_urad.wrapping_sub(last.setpoint_urad)),
            i32::from(is.temperature_c.wrapping_sub(was.temperature_c)),
            i32::from(is.status.wrapping_sub(was.status) as i8),
            i32::from(is.boots.wrapping_sub(was.boots) as i8),
        ]
    }

    fn restore(&self, last: &MotorSample, residuals: &[i32; FIELDS]) -> Option<MotorSample> {
        let was = &last.feedback;
        let [
            position,
            velocity,
            current,
            duty,
            setpoint,
            dt,
            voltage,
            tick,
            applied,
            temperature,
            status,
            boots,
        ] = *residuals;
        let setpoint_urad = if setpoint == 0 {
            last.setpoint_urad
        } else {
            last.setpoint_urad
                .wrapping_add(setpoint_step(setpoint, self.setpoint_step))
        };
        Some(MotorSample {
            dt_us: last.dt_us.wrapping_add(dt as u32),
            setpoint_urad,
            feedback: PackedFeedback {
                tick_4us: was
                    .tick_4us
                    .wrapping_add(self.tick_step as u16)
                    .wrapping_add(i16::try_from(tick).ok()? as u16),
                applied_urad: setpoint_urad
                    .wrapping_add(was.applied_urad.wrapping_sub(last.setpoint_urad))
                    .wrapping_add(applied),
                position_urad: was
                    .position_urad
                    .wrapping_add(self.position_step)
                    .wrapping_add(position),
                velocity: was.velocity.wrapping_add(i16::try_from(velocity).ok()?),
                current_ma: was.current_ma.wrapping_add(i16::try_from(current).ok()?),
                duty: was.duty.wrapping_add(i16::try_from(duty).ok()?),
                voltage_5mv: was
                    .voltage_5mv
                    .wrapping_add(i16::try_from(voltage).ok()? as u16),
                temperature_c: was
                    .temperature_c
                    .wrapping_add(i16::try_from(temperature).ok()?),
                status: was.status.wrapping_add(i8::try_from(status).ok()? as u8),
                boots: was.boots.wrapping_add(i8::try_from(boots).ok()? as u8),
            },
        })
    }

    fn follow(&mut self, last: &MotorSample, now: &MotorSample) {
        let (was, is) = (&last.feedback, &now.feedback);
        self.tick_step = i32::from(is.tick_4us.wrapping_sub(was.tick_4us));
        self.position_step = is.position_urad.wrapping_sub(was.position_urad);
        if now.setpoint_urad != last.setpoint_urad {
            self.setpoint_step = now.setpoint_urad.wrapping_sub(last.setpoint_urad);
        }
    }
}

/// Residual of a set-point step that is not zero. Residual 0 is taken by "unchanged", and a step of 0 never happens here, so the residual that a
/// step of 0 would have had, `-expected`, stands for the step that was expected exactly.
fn changed_setpoint(step: i32, expected: i32) -> i32 {
    if step == expected {
        expected.wrapping_neg()
    } else {
        step.wrapping_sub(expected)
    }
}

/// Inverse of [`changed_setpoint`].
fn setpoint_step(residual: i32, expected: i32) -> i32 {
    if residual == expected.wrapping_neg() {
        expected
    } else {
        residual.wrapping_add(expected)
    }
}

struct Writer<'a> {
    out: &'a mut [u8; MAX_SAMPLE],
    len: usize,
}

impl Writer<'_> {
    fn byte(&mut self, byte: u8) {
        // MAX_SAMPLE is the sum of all maxima, so there is always a place.
        if let Some(place) = self.out.get_mut(self.len) {
            *place = byte;
            self.len = self.len.saturating_add(1);
        }
    }

    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.byte(value as u8 | 0x80);
            value >>= 7;
        }
        self.byte(value as u8);
    }
}

struct Reader<'a> {
    rest: &'a [u8],
}

impl Reader<'_> {
    fn byte(&mut self) -> Option<u8> {
        let (first, rest) = self.rest.split_first()?;
        self.rest = rest;
        Some(*first)
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            let part = u64::from(byte & 0x7F);
            // The tenth byte may hold one bit only.
            if shift == 63 && part > 1 {
                return None;
            }
            value |= part << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }

    fn varint32(&mut self) -> Option<u32> {
        u32::try_from(self.varint()?).ok()
    }
}

fn zigzag(value: i32) -> u32 {
    ((value << 1) ^ (value >> 31)) as u32
}

fn unzigzag(code: u32) -> i32 {
    (code >> 1) as i32 ^ -((code & 1) as i32)
}

fn zigzag64(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)) as u64
}

fn unzigzag64(code: u64) -> i64 {
    (code >> 1) as i64 ^ -((code & 1) as i64)
}
