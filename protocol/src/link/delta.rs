//! The code of one sample against the ones before it. Exact: every difference wraps, whatever the numbers are.
//!
//! Each number is predicted; the difference is coded as zigzag, then Golomb-Rice with a parameter that follows the last differences of that number
//! (Rice 1979; adaptation as in lossless audio codecs). A number that does not change costs one bit, a noisy one about log2 of its noise plus two. Whether a set-point changed is a bit of its own.
//!
//! Predictors: position moves as last time, or as the measured velocities say plus what it moved more than that last time, whichever was
//! nearer of late. Set-points, which are smooth, follow the polynomial through their last four values, the tick the module's clock. The
//! applied set-point keeps its distance to the set-point; everything else stays. In the first sample of a block each motor is coded against the one before it, its position against its set-point.

mod bits;

use super::telemetry::{MotorSample, Sample};
use super::{JOINTS, MAX_JOINTS};
use crate::bus::PackedFeedback;
use bits::{Bits, ESCAPE, PLAIN_BITS, Reader, Writer};

/// Numbers of a motor, in the order of `MotorHistory::residuals`.
const FIELDS: usize = 12;
/// Numbers of a sample besides the motors: cycle, time, flags, mask.
const HEAD: usize = 4;

/// Largest code of one sample in bytes.
pub(super) const MAX_SAMPLE: usize =
    ((HEAD + FIELDS * JOINTS) * (ESCAPE + PLAIN_BITS) as usize + TIME_HIGH_BITS + JOINTS)
        .div_ceil(8);
/// Upper half of a time that does not follow the last one.
const TIME_HIGH_BITS: usize = 32;

/// Bits of each number written plainly, in the orders of `SampleDelta::head` and `MotorHistory::residuals`.
const PLAIN_HEAD: [u32; HEAD] = [32, 32, 9, 17];
const PLAIN_MOTOR: [u32; FIELDS] = [32, 16, 16, 16, 32, 32, 16, 16, 32, 16, 9, 9];
const _: () = assert!(plain_bits(MAX_JOINTS) <= MAX_SAMPLE * 8);

/// Most bits of a sample of so many motors in [`Form::Plain`].
const fn plain_bits(motors: usize) -> usize {
    // The bit of the form, the one of the time's upper half, that half; one more for each motor's set-point.
    1 + 1 + TIME_HIGH_BITS + sum(&PLAIN_HEAD) + motors * (1 + sum(&PLAIN_MOTOR))
}

const fn sum(widths: &[u32]) -> usize {
    match widths {
        [] => 0,
        [first, rest @ ..] => *first as usize + sum(rest),
    }
}

/// How the numbers of a sample are written. Samples of six motors are always adaptive; others begin with a bit that says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    /// Golomb-Rice codes.
    Adaptive,
    /// Every number in as many bits as it can need: what is left where the codes of more than six motors would not fit a block.
    Plain,
}

/// Marks a size that is followed instead of set.
const KEEP: u8 = u8::MAX;
/// Typical sizes (log2 of the code) in the first samples of a block, in the order of `MotorHistory::residuals`: position, velocity, current, duty, set-point,
/// dt, voltage, tick, applied, temperature, status, boots. Tuned on emulated motors that follow a 0.2 Hz gait.
const MOTOR_SIZES: [[u8; FIELDS]; 3] = [
    [14, 9, 6, 7, 18, 3, 2, 14, 0, 1, 1, 0],
    [11, 6, 5, 5, KEEP, 2, 1, 1, 0, 0, 0, 0],
    [
        8, KEEP, KEEP, KEEP, KEEP, KEEP, KEEP, KEEP, KEEP, KEEP, KEEP, KEEP,
    ],
];
/// The same for the first changes of a set-point, while its polynomial grows.
const STEP_SIZES: [u8; 4] = [13, 10, 7, 4];
/// Place of the set-point in these orders.
const SETPOINT: usize = 4;
/// The same for cycle, time, flags, mask.
const HEAD_SIZES: [[u8; HEAD]; 3] = [[9, 24, 2, 6], [1, 15, 1, 0], [KEEP, 0, KEEP, KEEP]];

/// What encoder and decoder remember; both start from zeros.
#[derive(Debug, Clone)]
pub(super) struct SampleDelta {
    last: Sample,
    t_step: u64,
    head: [Rice; HEAD],
    motors: [MotorHistory; MAX_JOINTS],
    samples: u8,
}

#[derive(Debug, Clone, Copy)]
struct MotorHistory {
    motion: Motion,
    /// Last differences of the set-point that were not zero, newest first.
    setpoint_steps: [i32; 3],
    /// How many of them there are.
    known_steps: u8,
    rice: [Rice; FIELDS],
}

/// Adaptive Golomb-Rice parameter: four times the mean of the last codes.
#[derive(Debug, Clone, Copy)]
struct Rice(u32);

impl Rice {
    const fn sized(log2: u8) -> Self {
        Self(4 << log2)
    }

    /// Codes one number both ways; `plain`: in how many bits.
    fn code<B: Bits>(&mut self, bits: &mut B, value: i32, plain: Option<u32>) -> Option<i32> {
        let code = match plain {
            Some(width) => bits.bits(zigzag(value), width)?,
            None => self.adaptive(bits, zigzag(value))?,
        };
        self.0 = self.0.saturating_sub(self.0 >> 2).saturating_add(code);
        Some(unzigzag(code))
    }

    fn adaptive<B: Bits>(&self, bits: &mut B, code: u32) -> Option<u32> {
        let k = (u32::BITS - (self.0 >> 2).leading_zeros())
            .saturating_sub(1)
            .min(30);
        bits.rice(code, k)
    }
}

impl SampleDelta {
    /// Nothing seen, of no robot.
    pub(super) const BLANK: Self = {
        let nothing = MotorHistory {
            motion: Motion {
                step: 0,
                excess: 0,
                straight_error: 0,
                measured_error: 0,
                known: false,
                begun: false,
            },
            setpoint_steps: [0; 3],
            known_steps: 0,
            rice: [Rice(0); FIELDS],
        };
        Self {
            last: Sample::ZERO,
            t_step: 0,
            head: [Rice(0); HEAD],
            motors: [nothing; MAX_JOINTS],
            samples: 0,
        }
    };

    /// Nothing seen, of a robot with this many motors.
    pub(super) fn new(motors: u8) -> Self {
        Self {
            last: Sample::of(motors),
            ..Self::BLANK
        }
    }

    /// Whether each sample says in which form it is.
    pub(super) fn says_form(&self) -> bool {
        self.last.motors.len() != JOINTS
    }

    /// Writes the code of `sample` over zeros; returns its length. `None` when it does not fit: never in [`Form::Plain`], never of six
    /// motors.
    pub(super) fn encode(
        &mut self,
        sample: &Sample,
        out: &mut [u8; MAX_SAMPLE],
        form: Form,
    ) -> Option<usize> {
        let mut writer = Writer::new(out);
        self.walk(&mut writer, sample, form)?;
        writer.finish()
    }

    /// Reads one sample; `None` when the bytes end early or a number is impossible.
    pub(super) fn decode<'a>(&mut self, bytes: &'a [u8]) -> Option<(Sample, &'a [u8])> {
        let mut reader = Reader { bytes, at: 0 };
        let nothing = Sample::of(self.last.motors.len() as u8);
        self.walk(&mut reader, &nothing, Form::Adaptive)?;
        let used = reader.at.div_ceil(8);
        // The rest of the last byte is zero, so that one sample has one code.
        while reader.at < used.saturating_mul(8) {
            if reader.bits(0, 1)? != 0 {
                return None;
            }
        }
        Some((self.last.clone(), bytes.get(used..)?))
    }

    /// One sample through `bits`; `sample` counts only when writing. It is the last one then. After `None` nothing here means anything.
    fn walk<B: Bits>(&mut self, bits: &mut B, sample: &Sample, form: Form) -> Option<()> {
        self.set_sizes();
        let plain = self.says_form() && bits.bits(u32::from(form == Form::Plain), 1)? == 1;
        let t_us = self.walk_head(bits, sample, plain)?;
        let t_passed_us = t_us.wrapping_sub(self.last.t_us);
        let mut neighbour = MotorSample::ZERO;
        let motors = self.motors.iter_mut().zip(&mut self.last.motors);
        for ((history, last), from) in motors.zip(&sample.motors) {
            *last = if self.samples == 0 {
                history.walk_first(bits, &neighbour, from, plain)?
            } else {
                history.walk(bits, last, from, t_passed_us, plain)?
            };
            neighbour = *last;
        }
        if self.samples > 0 {
            self.t_step = t_passed_us;
        }
        self.last.t_us = t_us;
        self.samples = self.samples.saturating_add(1);
        Some(())
    }

    /// What a sample holds besides its motors; returns its time, which is not yet the last one.
    fn walk_head<B: Bits>(&mut self, bits: &mut B, sample: &Sample, plain: bool) -> Option<u64> {
        let width = |index: usize| PLAIN_HEAD.get(index).copied().filter(|_| plain);
        let last = &mut self.last;
        let [cycle, time, flags, mask] = &mut self.head;
        let step = sample.cycle.wrapping_sub(last.cycle) as i32;
        last.cycle = last
            .cycle
            .wrapping_add(cycle.code(bits, step, width(0))? as u32);
        // Times move on evenly; 32 bits of the difference are enough but for the first sample and jumps.
        let t_predicted = last.t_us.wrapping_add(self.t_step);
        let t_residual = sample.t_us.wrapping_sub(t_predicted);
        let low = time.code(bits, t_residual as u32 as i32, width(1))?;
        let near = t_residual as u32 as i32 as i64 as u64 == t_residual;
        let extended = i64::from(low) as u64;
        let t_residual = if bits.bits(u32::from(!near), 1)? == 1 {
            u64::from(bits.bits((t_residual >> 32) as u32, 32)?) << 32 | u64::from(low as u32)
        } else {
            extended
        };
        let changed = i32::from(sample.flags ^ last.flags);
        last.flags ^= byte(flags.code(bits, changed, width(2))?)?;
        let changed = i32::from(sample.valid_mask ^ last.valid_mask);
        last.valid_mask ^= u16::try_from(mask.code(bits, changed, width(3))?).ok()?;
        Some(t_predicted.wrapping_add(t_residual))
    }

    /// The first samples of a block begin with typical sizes.
    fn set_sizes(&mut self) {
        if let Some(sizes) = HEAD_SIZES.get(usize::from(self.samples)) {
            set_sizes(&mut self.head, sizes);
        }
        if let Some(sizes) = MOTOR_SIZES.get(usize::from(self.samples)) {
            for history in &mut self.motors {
                set_sizes(&mut history.rice, sizes);
            }
        }
    }
}

fn set_sizes(rice: &mut [Rice], sizes: &[u8]) {
    for (rice, size) in rice.iter_mut().zip(sizes) {
        if *size != KEEP {
            *rice = Rice::sized(*size);
        }
    }
}

impl MotorHistory {
    /// The first sample of a block: like a step from the motor before, without history, in no time.
    fn walk_first<B: Bits>(
        &mut self,
        bits: &mut B,
        neighbour: &MotorSample,
        now: &MotorSample,
        plain: bool,
    ) -> Option<MotorSample> {
        // Angles, speeds and currents of neighbours have nothing in common; what is left does.
        let last = MotorSample {
            dt_us: neighbour.dt_us,
            feedback: PackedFeedback {
                applied_urad: neighbour
                    .feedback
                    .applied_urad
                    .wrapping_sub(neighbour.setpoint_urad),
                tick_4us: neighbour.feedback.tick_4us,
                voltage_5mv: neighbour.feedback.voltage_5mv,
                temperature_c: neighbour.feedback.temperature_c,
                status: neighbour.feedback.status,
                boots: neighbour.feedback.boots,
                ..PackedFeedback::ZERO
            },
            ..MotorSample::ZERO
        };
        // The position is coded against the set-point: as if its excess were there already.
        let lag = |sample: &MotorSample| MotorSample {
            feedback: PackedFeedback {
                position_urad: sample
                    .feedback
                    .position_urad
                    .wrapping_sub(sample.setpoint_urad),
                ..sample.feedback
            },
            ..*sample
        };
        let mut now = self.code(bits, &last, &lag(now), 0, plain)?;
        now.feedback.position_urad = now.feedback.position_urad.wrapping_add(now.setpoint_urad);
        self.motion.begun = true;
        Some(now)
    }

    fn walk<B: Bits>(
        &mut self,
        bits: &mut B,
        last: &MotorSample,
        now: &MotorSample,
        t_passed_us: u64,
        plain: bool,
    ) -> Option<MotorSample> {
        let now = self.code(bits, last, now, t_passed_us, plain)?;
        self.follow(last, &now, t_passed_us);
        Some(now)
    }

    fn code<B: Bits>(
        &mut self,
        bits: &mut B,
        last: &MotorSample,
        now: &MotorSample,
        t_passed_us: u64,
        plain: bool,
    ) -> Option<MotorSample> {
        let changed = bits.bits(u32::from(now.setpoint_urad != last.setpoint_urad), 1)? == 1;
        let mut residuals = self.residuals(last, now, t_passed_us);
        let sizes = STEP_SIZES.get(usize::from(self.known_steps));
        if let (true, Some(size), Some(rice)) =
            (self.motion.begun, sizes, self.rice.get_mut(SETPOINT))
        {
            *rice = Rice::sized(*size);
        }
        let numbers = residuals.iter_mut().zip(&mut self.rice).zip(PLAIN_MOTOR);
        for (index, ((residual, rice), width)) in numbers.enumerate() {
            if index != SETPOINT || changed {
                *residual = rice.code(bits, *residual, plain.then_some(width))?;
            }
        }
        self.restore(last, &residuals, changed, t_passed_us)
    }

    fn residuals(&self, last: &MotorSample, now: &MotorSample, t_passed_us: u64) -> [i32; FIELDS] {
        let (was, is) = (&last.feedback, &now.feedback);
        let moved = moved_urad(was.velocity, is.velocity, t_passed_us);
        let tick = predicted_tick(last, now.dt_us, t_passed_us);
        [
            is.position_urad
                .wrapping_sub(was.position_urad)
                .wrapping_sub(self.motion.expected(moved)),
            i32::from(is.velocity.wrapping_sub(was.velocity)),
            i32::from(is.current_ma.wrapping_sub(was.current_ma)),
            i32::from(is.duty.wrapping_sub(was.duty)),
            now.setpoint_urad
                .wrapping_sub(last.setpoint_urad)
                .wrapping_sub(self.expected_step(moved)),
            now.dt_us.wrapping_sub(last.dt_us) as i32,
            i32::from(is.voltage_5mv.wrapping_sub(was.voltage_5mv) as i16),
            i32::from(is.tick_4us.wrapping_sub(tick) as i16),
            is.applied_urad
                .wrapping_sub(now.setpoint_urad)
                .wrapping_sub(was.applied_urad.wrapping_sub(last.setpoint_urad)),
            i32::from(is.temperature_c.wrapping_sub(was.temperature_c)),
            // The bits that change most (moving) come lowest.
            i32::from((is.status ^ was.status).rotate_left(2)),
            i32::from(is.boots ^ was.boots),
        ]
    }

    fn restore(
        &self,
        last: &MotorSample,
        residuals: &[i32; FIELDS],
        changed: bool,
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
        let velocity = was.velocity.wrapping_add(short(velocity)?);
        let moved = moved_urad(was.velocity, velocity, t_passed_us);
        let step = if changed {
            setpoint.wrapping_add(self.expected_step(moved))
        } else {
            0
        };
        let setpoint_urad = last.setpoint_urad.wrapping_add(step);
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
                    .wrapping_add(self.motion.expected(moved))
                    .wrapping_add(position),
                velocity,
                current_ma: was.current_ma.wrapping_add(short(current)?),
                duty: was.duty.wrapping_add(short(duty)?),
                voltage_5mv: was.voltage_5mv.wrapping_add(short(voltage)? as u16),
                temperature_c: was.temperature_c.wrapping_add(short(temperature)?),
                status: was.status ^ byte(status)?.rotate_right(2),
                boots: was.boots ^ byte(boots)?,
            },
        })
    }

    fn follow(&mut self, last: &MotorSample, now: &MotorSample, t_passed_us: u64) {
        let (was, is) = (&last.feedback, &now.feedback);
        let step = is.position_urad.wrapping_sub(was.position_urad);
        self.motion
            .follow(step, moved_urad(was.velocity, is.velocity, t_passed_us));
        let step = now.setpoint_urad.wrapping_sub(last.setpoint_urad);
        if step != 0 {
            let [newest, second, _] = self.setpoint_steps;
            self.setpoint_steps = [step, newest, second];
            self.known_steps = self.known_steps.saturating_add(1);
        }
    }

    /// The step of a set-point that changes: the polynomial through the last ones; before there are any, what the motor moved.
    fn expected_step(&self, moved: i32) -> i32 {
        let [newest, second, third] = self.setpoint_steps;
        match self.known_steps {
            0 => moved,
            1 => newest,
            2 => newest.wrapping_add(newest.wrapping_sub(second)),
            _ => newest
                .wrapping_sub(second)
                .wrapping_mul(3)
                .wrapping_add(third),
        }
    }
}

/// Two predictors of a position's step, and how well they did of late.
#[derive(Debug, Clone, Copy)]
struct Motion {
    /// Last step.
    step: i32,
    /// What it was more than the velocities said.
    excess: i32,
    /// Four times the mean error of "as last time".
    straight_error: u32,
    /// Four times the mean error of "as the velocities say, plus the excess".
    measured_error: u32,
    /// Whether there was a step.
    known: bool,
    /// Whether there was a sample.
    begun: bool,
}

impl Motion {
    fn expected(&self, moved: i32) -> i32 {
        if self.straight_error < self.measured_error {
            self.step
        } else {
            moved.wrapping_add(self.excess)
        }
    }

    fn follow(&mut self, step: i32, moved: i32) {
        let excess = step.wrapping_sub(moved);
        if self.known {
            let mean =
                |old: u32, error: i32| (old - (old >> 2)).saturating_add(error.unsigned_abs());
            self.straight_error = mean(self.straight_error, step.wrapping_sub(self.step));
            self.measured_error = mean(self.measured_error, excess.wrapping_sub(self.excess));
        }
        (self.step, self.excess, self.known) = (step, excess, true);
    }
}

/// What a motor moves in a time at the mean of two velocities: 0.5 mrad/s times us is 1/2000 urad. Wraps for times that are none.
fn moved_urad(before: i16, after: i16, t_passed_us: u64) -> i32 {
    let twice = i64::from(before).wrapping_add(i64::from(after));
    let moved = twice.wrapping_mul(t_passed_us as i64);
    // Of one cycle it fits 32 bits, which a Cortex-M4 divides in hardware.
    i32::try_from(moved).map_or_else(|_| moved_far_urad(moved), |moved| moved / 4000)
}

/// Apart, or the compiler divides 64 bits, in software, every time.
#[cold]
#[inline(never)]
fn moved_far_urad(moved: i64) -> i32 {
    (moved / 4000) as i32
}

/// The driver's tick when its clock runs as ours.
fn predicted_tick(last: &MotorSample, dt_us: u32, t_passed_us: u64) -> u16 {
    let passed_us = t_passed_us
        .wrapping_add(u64::from(dt_us))
        .wrapping_sub(u64::from(last.dt_us));
    last.feedback.tick_4us.wrapping_add((passed_us >> 2) as u16)
}

fn short(value: i32) -> Option<i16> {
    i16::try_from(value).ok()
}

fn byte(value: i32) -> Option<u8> {
    u8::try_from(value).ok()
}

fn zigzag(value: i32) -> u32 {
    ((value << 1) ^ (value >> 31)) as u32
}

fn unzigzag(code: u32) -> i32 {
    (code >> 1) as i32 ^ -((code & 1) as i32)
}
