//! The code of one sample against the ones before it. Exact: every difference wraps, whatever the numbers are.
//!
//! Each number is predicted; the difference is coded as zigzag, then Golomb-Rice with a parameter that follows the last differences of that number
//! (Rice 1979; adaptation as in lossless audio codecs). A number that does not change costs one bit, a noisy one about log2 of its noise plus two.
//!
//! Predictors: position goes on with the same acceleration; a set-point that changes does so with the same acceleration as at its last changes; the tick
//! follows the module's clock; the applied set-point keeps its distance to the set-point; everything else stays.

use super::JOINTS;
use super::telemetry::{MotorSample, Sample};
use crate::bus::PackedFeedback;

/// Numbers of a motor, in the order of `MotorHistory::residuals`.
const FIELDS: usize = 12;
/// Numbers of a sample besides the motors: cycle, time, flags, mask.
const HEAD: usize = 4;

/// Ones that announce a number written plainly, in 32 bits: no number costs more than 44 bits.
const ESCAPE: u32 = 12;
const PLAIN_BITS: u32 = 32;

/// Largest code of one sample in bytes.
pub(super) const MAX_SAMPLE: usize =
    ((HEAD + FIELDS * JOINTS) * (ESCAPE + PLAIN_BITS) as usize + TIME_HIGH_BITS).div_ceil(8);
/// Upper half of a time that does not follow the last one.
const TIME_HIGH_BITS: usize = 32;

/// Typical sizes (log2) of the first sample of a block, which is coded against zeros: position, velocity, current, duty, set-point, dt, voltage, tick,
/// applied, temperature, status, boots.
const FIRST: [u8; FIELDS] = [20, 10, 8, 8, 20, 10, 10, 14, 2, 5, 2, 2];
/// Typical sizes of the second.
const SECOND: [u8; FIELDS] = [14, 7, 5, 5, 14, 4, 2, 2, 0, 0, 0, 0];
const FIRST_HEAD: [u8; HEAD] = [9, 24, 2, 6];
const SECOND_HEAD: [u8; HEAD] = [1, 15, 1, 0];

/// What encoder and decoder remember; both start from zeros.
#[derive(Debug, Clone, Copy)]
pub(super) struct SampleDelta {
    last: Sample,
    t_step: u64,
    head: [Rice; HEAD],
    motors: [MotorHistory; JOINTS],
    samples: u8,
}

#[derive(Debug, Clone, Copy)]
struct MotorHistory {
    /// Last two differences of the position.
    position_steps: [i32; 2],
    /// Last two differences of the set-point that were not zero.
    setpoint_steps: [i32; 2],
    rice: [Rice; FIELDS],
}

/// Where bits go to or come from; the same walk over a sample serves both.
trait Bits {
    /// Writes `code`, or reads one and returns it.
    fn bits(&mut self, code: u32, width: u32) -> Option<u32>;
}

/// Adaptive Golomb-Rice parameter: four times the mean of the last codes.
#[derive(Debug, Clone, Copy)]
struct Rice(u32);

impl Rice {
    const fn sized(log2: u8) -> Self {
        Self(4 << log2)
    }

    /// Codes one number both ways.
    fn code<B: Bits>(&mut self, bits: &mut B, value: i32) -> Option<i32> {
        let k = (u32::BITS - (self.0 >> 2).leading_zeros())
            .saturating_sub(1)
            .min(30);
        let code = zigzag(value);
        let quotient = code >> k;
        let mut ones = 0;
        // At most ESCAPE passes.
        while ones < ESCAPE && bits.bits(u32::from(ones < quotient), 1)? == 1 {
            ones += 1;
        }
        let code = if ones == ESCAPE {
            bits.bits(code, PLAIN_BITS)?
        } else {
            let low = bits.bits(code & ((1 << k) - 1), k)?;
            ones << k | low
        };
        self.0 = self.0.saturating_sub(self.0 >> 2).saturating_add(code);
        Some(unzigzag(code))
    }
}

impl SampleDelta {
    /// Nothing seen.
    pub(super) const fn new() -> Self {
        let nothing = MotorHistory {
            position_steps: [0; 2],
            setpoint_steps: [0; 2],
            rice: [Rice(0); FIELDS],
        };
        Self {
            last: Sample::ZERO,
            t_step: 0,
            head: [Rice(0); HEAD],
            motors: [nothing; JOINTS],
            samples: 0,
        }
    }

    /// Writes the code of `sample`; returns its length.
    pub(super) fn encode(&mut self, sample: &Sample, out: &mut [u8; MAX_SAMPLE]) -> usize {
        let mut writer = Writer { out, len: 0 };
        let _ = self.walk(&mut writer, sample);
        writer.len.div_ceil(8)
    }

    /// Reads one sample; `None` when the bytes end early or a number is impossible.
    pub(super) fn decode<'a>(&mut self, bytes: &'a [u8]) -> Option<(Sample, &'a [u8])> {
        let mut reader = Reader { bytes, at: 0 };
        let sample = self.walk(&mut reader, &Sample::ZERO)?;
        let used = reader.at.div_ceil(8);
        // The rest of the last byte is zero, so that one sample has one code.
        while reader.at < used.saturating_mul(8) {
            if reader.bits(0, 1)? != 0 {
                return None;
            }
        }
        Some((sample, bytes.get(used..)?))
    }

    /// One sample through `bits`; `sample` counts only when writing.
    fn walk<B: Bits>(&mut self, bits: &mut B, sample: &Sample) -> Option<Sample> {
        self.set_sizes();
        let last = self.last;
        let [cycle, time, flags, mask] = &mut self.head;
        let cycle = last
            .cycle
            .wrapping_add(cycle.code(bits, sample.cycle.wrapping_sub(last.cycle) as i32)? as u32);
        // Times move on evenly; 32 bits of the difference are enough but for the first sample and jumps.
        let t_predicted = last.t_us.wrapping_add(self.t_step);
        let t_residual = sample.t_us.wrapping_sub(t_predicted);
        let low = time.code(bits, t_residual as u32 as i32)?;
        let near = t_residual as u32 as i32 as i64 as u64 == t_residual;
        let extended = i64::from(low) as u64;
        let t_residual = if bits.bits(u32::from(!near), 1)? == 1 {
            u64::from(bits.bits((t_residual >> 32) as u32, 32)?) << 32 | u64::from(low as u32)
        } else {
            extended
        };
        let t_us = t_predicted.wrapping_add(t_residual);
        let flags = last.flags ^ byte(flags.code(bits, i32::from(sample.flags ^ last.flags))?)?;
        let valid_mask = last.valid_mask
            ^ byte(mask.code(bits, i32::from(sample.valid_mask ^ last.valid_mask))?)?;
        let mut out = Sample {
            cycle,
            t_us,
            flags,
            valid_mask,
            motors: last.motors,
        };
        let before = self.motors.iter_mut().zip(&last.motors);
        for ((to, from), (history, last_motor)) in
            out.motors.iter_mut().zip(&sample.motors).zip(before)
        {
            let t_passed = t_us.wrapping_sub(last.t_us);
            *to = history.walk(bits, last_motor, from, t_passed)?;
            // The first sample is no step from zero.
            if self.samples > 0 {
                history.follow(last_motor, to);
            }
        }
        if self.samples > 0 {
            self.t_step = t_us.wrapping_sub(last.t_us);
        }
        self.last = out;
        self.samples = self.samples.saturating_add(1);
        Some(out)
    }

    /// The first two samples of a block begin with typical sizes.
    fn set_sizes(&mut self) {
        let (motor, head) = match self.samples {
            0 => (FIRST, FIRST_HEAD),
            1 => (SECOND, SECOND_HEAD),
            _ => return,
        };
        for (rice, size) in self.head.iter_mut().zip(head) {
            *rice = Rice::sized(size);
        }
        for history in &mut self.motors {
            for (rice, size) in history.rice.iter_mut().zip(motor) {
                *rice = Rice::sized(size);
            }
        }
    }
}

impl MotorHistory {
    fn walk<B: Bits>(
        &mut self,
        bits: &mut B,
        last: &MotorSample,
        now: &MotorSample,
        t_passed_us: u64,
    ) -> Option<MotorSample> {
        let mut residuals = self.residuals(last, now, t_passed_us);
        for (residual, rice) in residuals.iter_mut().zip(&mut self.rice) {
            *residual = rice.code(bits, *residual)?;
        }
        self.restore(last, &residuals, t_passed_us)
    }

    fn residuals(&self, last: &MotorSample, now: &MotorSample, t_passed_us: u64) -> [i32; FIELDS] {
        let (was, is) = (&last.feedback, &now.feedback);
        let setpoint = if now.setpoint_urad == last.setpoint_urad {
            0
        } else {
            changed_setpoint(
                now.setpoint_urad.wrapping_sub(last.setpoint_urad),
                extrapolate(self.setpoint_steps),
            )
        };
        let tick = predicted_tick(last, now.dt_us, t_passed_us);
        [
            is.position_urad
                .wrapping_sub(was.position_urad)
                .wrapping_sub(extrapolate(self.position_steps)),
            i32::from(is.velocity.wrapping_sub(was.velocity)),
            i32::from(is.current_ma.wrapping_sub(was.current_ma)),
            i32::from(is.duty.wrapping_sub(was.duty)),
            setpoint,
            now.dt_us.wrapping_sub(last.dt_us) as i32,
            i32::from(is.voltage_5mv.wrapping_sub(was.voltage_5mv) as i16),
            i32::from(is.tick_4us.wrapping_sub(tick) as i16),
            is.applied_urad
                .wrapping_sub(now.setpoint_urad)
                .wrapping_sub(was.applied_urad.wrapping_sub(last.setpoint_urad)),
            i32::from(is.temperature_c.wrapping_sub(was.temperature_c)),
            i32::from(is.status ^ was.status),
            i32::from(is.boots ^ was.boots),
        ]
    }

    fn restore(
        &self,
        last: &MotorSample,
        residuals: &[i32; FIELDS],
        t_passed_us: u64,
    ) -> Option<MotorSample> {
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
                .wrapping_add(setpoint_step(setpoint, extrapolate(self.setpoint_steps)))
        };
        let dt_us = last.dt_us.wrapping_add(dt as u32);
        Some(MotorSample {
            dt_us,
            setpoint_urad,
            feedback: PackedFeedback {
                tick_4us: predicted_tick(last, dt_us, t_passed_us)
                    .wrapping_add(short(tick)? as u16),
                applied_urad: setpoint_urad
                    .wrapping_add(was.applied_urad.wrapping_sub(last.setpoint_urad))
                    .wrapping_add(applied),
                position_urad: was
                    .position_urad
                    .wrapping_add(extrapolate(self.position_steps))
                    .wrapping_add(position),
                velocity: was.velocity.wrapping_add(short(velocity)?),
                current_ma: was.current_ma.wrapping_add(short(current)?),
                duty: was.duty.wrapping_add(short(duty)?),
                voltage_5mv: was.voltage_5mv.wrapping_add(short(voltage)? as u16),
                temperature_c: was.temperature_c.wrapping_add(short(temperature)?),
                status: was.status ^ byte(status)?,
                boots: was.boots ^ byte(boots)?,
            },
        })
    }

    fn follow(&mut self, last: &MotorSample, now: &MotorSample) {
        let position = now
            .feedback
            .position_urad
            .wrapping_sub(last.feedback.position_urad);
        self.position_steps = shift(self.position_steps, position);
        let setpoint = now.setpoint_urad.wrapping_sub(last.setpoint_urad);
        if setpoint != 0 {
            self.setpoint_steps = shift(self.setpoint_steps, setpoint);
        }
    }
}

/// Takes a new step in; the first one stands for the one before it as well.
fn shift([last, before]: [i32; 2], step: i32) -> [i32; 2] {
    if last == 0 && before == 0 {
        [step, step]
    } else {
        [step, last]
    }
}

/// The next step when steps change evenly.
fn extrapolate([last, before]: [i32; 2]) -> i32 {
    last.wrapping_add(last.wrapping_sub(before))
}

/// The driver's tick when its clock runs as ours.
fn predicted_tick(last: &MotorSample, dt_us: u32, t_passed_us: u64) -> u16 {
    let passed_us = t_passed_us
        .wrapping_add(u64::from(dt_us))
        .wrapping_sub(u64::from(last.dt_us));
    last.feedback.tick_4us.wrapping_add((passed_us >> 2) as u16)
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

fn short(value: i32) -> Option<i16> {
    i16::try_from(value).ok()
}

fn byte(value: i32) -> Option<u8> {
    u8::try_from(value).ok()
}

struct Writer<'a> {
    out: &'a mut [u8; MAX_SAMPLE],
    /// Bits.
    len: usize,
}

impl Bits for Writer<'_> {
    fn bits(&mut self, code: u32, width: u32) -> Option<u32> {
        for bit in 0..width {
            // MAX_SAMPLE is the sum of all maxima, so there is always a place.
            let place = self.out.get_mut(self.len >> 3)?;
            let mask = 1 << (self.len & 7);
            if code >> bit & 1 == 1 {
                *place |= mask;
            }
            self.len = self.len.saturating_add(1);
        }
        Some(code)
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    /// Bits.
    at: usize,
}

impl Bits for Reader<'_> {
    fn bits(&mut self, _code: u32, width: u32) -> Option<u32> {
        let mut code = 0;
        for bit in 0..width {
            let byte = self.bytes.get(self.at >> 3)?;
            code |= u32::from(byte >> (self.at & 7) & 1) << bit;
            self.at = self.at.saturating_add(1);
        }
        Some(code)
    }
}

fn zigzag(value: i32) -> u32 {
    ((value << 1) ^ (value >> 31)) as u32
}

fn unzigzag(code: u32) -> i32 {
    (code >> 1) as i32 ^ -((code & 1) as i32)
}
