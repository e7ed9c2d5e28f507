//! Telemetry: exact, bounded, and how much of it link and memory carry.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::*;
use control::gait::Gait;
use proptest::prelude::*;
use protocol::bus::PackedFeedback;
use protocol::link::telemetry::{BlockError, MAX_BLOCK_DATA, flags};
use protocol::link::*;
use protocol::units;

/// Byte of an 8N1 line at 115200 baud.
const LINK_BYTES_PER_S: f64 = 11_520.0;
/// What the module's memory budget gives: 72 blocks of 496 bytes are 34.9 KiB of the 96 KiB.
const BLOCKS: usize = 72;

fn any_feedback() -> impl Strategy<Value = PackedFeedback> {
    (
        any::<(u16, i32, i32, i16, i16)>(),
        any::<(i16, u16, i16, u8, u8)>(),
    )
        .prop_map(|(a, b)| PackedFeedback {
            tick_4us: a.0,
            applied_urad: a.1,
            position_urad: a.2,
            velocity: a.3,
            current_ma: a.4,
            duty: b.0,
            voltage_5mv: b.1,
            temperature_c: b.2,
            status: b.3,
            boots: b.4,
        })
}

fn any_sample(motors: usize) -> impl Strategy<Value = Sample> {
    let motor =
        (any::<(u32, i32)>(), any_feedback()).prop_map(|((dt_us, setpoint_urad), feedback)| {
            MotorSample {
                dt_us,
                setpoint_urad,
                feedback,
            }
        });
    (
        any::<(u32, u64, u8)>(),
        0..1_u16 << motors,
        proptest::collection::vec(motor, motors),
    )
        .prop_map(|((cycle, t_us, flags), valid_mask, motors)| Sample {
            cycle,
            t_us,
            flags,
            valid_mask,
            motors: heapless::Vec::from_slice(&motors).unwrap(),
        })
}

/// All samples of a log, drained block by block, each through a frame.
fn drained<const N: usize>(log: &mut SampleLog<N>) -> (Vec<(u32, Sample)>, usize) {
    let (mut samples, mut link_bytes, mut from) = (Vec::new(), 0, 0);
    loop {
        let block = log.drain(from, true);
        if block.count == 0 {
            return (samples, link_bytes);
        }
        let bytes = frame(&module_header(1), &FromModule::from(block));
        link_bytes += bytes.len();
        let mut decoder = Decoder::new();
        let message = bytes.iter().find_map(|byte| {
            decoder
                .push(*byte)
                .map(|frame| frame.decode::<FromModule>())
        });
        let Some(Ok(FromModule::SampleBlock(block) | FromModule::SampleBlockOf(block))) = message
        else {
            panic!("{message:?}")
        };
        samples.extend((block.first..).zip(block.samples().map(Result::unwrap)));
        from = block.end();
    }
}

fn nudge(motor: &mut MotorSample, field: u8, step: i32) {
    let feedback = &mut motor.feedback;
    match field {
        0 => motor.dt_us = motor.dt_us.wrapping_add_signed(step),
        1 => motor.setpoint_urad = motor.setpoint_urad.wrapping_add(step),
        2 => feedback.tick_4us = feedback.tick_4us.wrapping_add_signed(step as i16),
        3 => feedback.applied_urad = feedback.applied_urad.wrapping_add(step),
        4 => feedback.position_urad = feedback.position_urad.wrapping_add(step),
        5 => feedback.velocity = feedback.velocity.wrapping_add(step as i16),
        6 => feedback.current_ma = feedback.current_ma.wrapping_add(step as i16),
        7 => feedback.duty = feedback.duty.wrapping_add(step as i16),
        8 => feedback.voltage_5mv = feedback.voltage_5mv.wrapping_add_signed(step as i16),
        9 => feedback.temperature_c = feedback.temperature_c.wrapping_add(step as i16),
        10 => feedback.status = feedback.status.wrapping_add_signed(step as i8),
        _ => feedback.boots = feedback.boots.wrapping_add_signed(step as i8),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_samples_of_any_robot_come_back_exactly(
        samples in (1..=MAX_JOINTS).prop_flat_map(|motors| proptest::collection::vec(any_sample(motors), 1..20)),
    ) {
        let mut log = SampleLog::<40>::new();
        log.begin(3, samples[0].motors.len() as u8);
        for sample in &samples {
            log.push(sample);
        }
        log.flush();
        let (back, _) = drained(&mut log);
        let expected: Vec<_> = (0..).zip(samples).collect();
        prop_assert_eq!(back, expected);
        prop_assert_eq!(log.dropped(), 0);
    }

    /// Near the predictions, where codes are short, numbers stand still and the ends of their ranges are crossed.
    #[test]
    fn small_steps_come_back_exactly(
        start in any_sample(6),
        steps in proptest::collection::vec((0..6_usize, 0..12_u8, -3..=3_i32), 0..400),
    ) {
        let mut samples = vec![start.clone()];
        let mut now = start;
        for chunk in steps.chunks(7) {
            now.t_us = now.t_us.wrapping_add(50_000);
            now.cycle = now.cycle.wrapping_add(1);
            for (motor, field, step) in chunk {
                nudge(&mut now.motors[*motor], *field, *step);
            }
            samples.push(now.clone());
        }
        let mut log = SampleLog::<64>::new();
        log.begin(3, 6);
        for sample in &samples {
            log.push(sample);
        }
        log.flush();
        let (back, _) = drained(&mut log);
        let expected: Vec<_> = (0..).zip(samples).collect();
        prop_assert_eq!(back, expected);
    }

    #[test]
    fn any_bytes_are_no_danger(data in proptest::collection::vec(any::<u8>(), 0..MAX_BLOCK_DATA), count: u8) {
        let block = SampleBlock { count, data: heapless::Vec::from_slice(&data).unwrap(), ..SampleBlock::default() };
        prop_assert!(block.samples().count() <= usize::from(count) + 1);
    }
}

/// What a run looks like: the CPG's own set-points, a motor that follows with lag, all drivers measuring at one instant, encoder steps of 40 urad, noise on
/// every other channel.
fn run(rate_hz: u32, seconds: u32) -> Vec<Sample> {
    let gait = Gait::try_from(&gait()).unwrap();
    let mut state = control::cpg::start(&gait);
    let mut rng = Rng(0xABCD);
    let per_cycle = rate_hz / 20;
    let dt = 1.0 / f64::from(rate_hz);
    let (mut positions, mut velocities, mut setpoints) = ([0.0_f64; 6], [0.0_f64; 6], [0_i32; 6]);
    let mut samples = Vec::new();
    for n in 0..rate_hz * seconds {
        let t_us = 5_000_000 + u64::from(n) * u64::from(1_000_000 / rate_hz);
        let fresh = n % per_cycle == 0;
        if fresh {
            let out = control::cpg::step(&gait, &mut state, 0.05);
            for (setpoint, angle) in setpoints.iter_mut().zip(out.as_slice()) {
                *setpoint = units::urad_from_rad(*angle).unwrap();
            }
        }
        let mut noise = |size: i64| (rng.next() % (2 * size as u64 + 1)) as i64 - size;
        let dt_us = 200 + noise(3);
        let motors: [MotorSample; 6] = core::array::from_fn(|k| {
            let target = f64::from(setpoints[k]) * 1e-6;
            let before = velocities[k];
            let wanted = ((target - positions[k]) * 12.0).clamp(-2.7, 2.7);
            velocities[k] += (wanted - before) * (dt / 0.04).min(1.0);
            positions[k] += (before + velocities[k]) / 2.0 * dt;
            let velocity = velocities[k];
            MotorSample {
                dt_us: dt_us as u32,
                setpoint_urad: setpoints[k],
                feedback: PackedFeedback {
                    tick_4us: ((t_us as i64 + dt_us + 777 * k as i64) / 4) as u16,
                    applied_urad: setpoints[k],
                    position_urad: ((positions[k] * 1e6 / 40.0).round() * 40.0) as i32,
                    velocity: (velocity * 2000.0) as i16 + noise(4) as i16,
                    current_ma: (velocity * 100.0) as i16 + noise(12) as i16,
                    duty: (velocity * 600.0) as i16 + noise(6) as i16,
                    voltage_5mv: (1480 + noise(1)) as u16,
                    temperature_c: 30,
                    status: 3,
                    boots: 1,
                },
            }
        });
        let flags = if fresh {
            flags::TORQUE | flags::NEW_SETPOINT
        } else {
            flags::TORQUE
        };
        samples.push(Sample {
            cycle: n / per_cycle,
            t_us,
            flags,
            valid_mask: ALL_JOINTS,
            motors: heapless::Vec::from(motors),
        });
    }
    samples
}

#[test]
fn live_samples_at_20_hz_fit_the_link() {
    let bytes: usize = run(20, 30)
        .iter()
        .map(|sample| frame(&module_header(1), &FromModule::Sample(sample.clone())).len())
        .sum();
    let share = bytes as f64 / 30.0 / LINK_BYTES_PER_S;
    println!(
        "20 Hz live: {:.0} B a sample, {:.1} % of 115200 baud",
        bytes as f64 / 600.0,
        share * 100.0
    );
    assert!(share < 0.40);
}

#[test]
fn a_run_at_20_hz_fits_the_memory_without_any_link() {
    let mut log = SampleLog::<BLOCKS>::new();
    log.begin(1, 6);
    run(20, 30).iter().for_each(|sample| log.push(sample));
    log.flush();
    println!(
        "20 Hz for 30 s: {} blocks of {BLOCKS}, log is {} bytes",
        log.kept_blocks(),
        size_of_val(&log)
    );
    assert_eq!((log.run(), log.taken(), log.dropped()), (1, 600, 0));
    assert!(size_of_val(&log) <= 37 * 1024);
    let (back, bytes) = drained(&mut log);
    assert_eq!(back.len(), 600);
    println!(
        "drained after the run in {:.1} s",
        bytes as f64 / LINK_BYTES_PER_S
    );
}

/// What does not fit is dropped and counted; the beginning is whole.
#[test]
fn at_100_hz_without_any_link_the_beginning_is_kept() {
    let fast = run(100, 30);
    let mut log = SampleLog::<BLOCKS>::new();
    log.begin(2, 6);
    fast.iter().for_each(|sample| log.push(sample));
    log.flush();
    let kept = log.taken() - log.dropped();
    println!(
        "100 Hz without a link: {kept} of {} samples, {:.1} s",
        log.taken(),
        f64::from(kept) / 100.0
    );
    assert_eq!(log.taken(), 3000);
    assert!(kept >= 500);
    let (back, _) = drained(&mut log);
    assert_eq!(back.len() as u32, kept);
    assert!(
        back.iter()
            .enumerate()
            .all(|(n, (index, sample))| *index == n as u32 && *sample == fast[n])
    );
}

#[test]
fn at_100_hz_the_link_keeps_up_and_a_gap_of_5_s_loses_nothing() {
    let mut log = SampleLog::<BLOCKS>::new();
    log.begin(3, 6);
    let (mut credit, mut sent) = (0.0, 0);
    for (n, sample) in run(100, 30).iter().enumerate() {
        log.push(sample);
        let down = (1000..1500).contains(&n);
        credit = if down {
            0.0
        } else {
            f64::min(credit + LINK_BYTES_PER_S / 100.0, 600.0)
        };
        while credit >= MAX_FRAME as f64 {
            let Some(block) = log.next_unsent() else {
                break;
            };
            let len = frame(&module_header(1), &FromModule::SampleBlock(block.clone())).len();
            credit -= len as f64;
            sent += len;
        }
    }
    let share = sent as f64 / 30.0 / LINK_BYTES_PER_S;
    println!(
        "100 Hz streamed: {:.1} B a sample, {:.1} % of 115200 baud",
        sent as f64 / 3000.0,
        share * 100.0
    );
    assert_eq!(log.dropped(), 0);
    assert!(share < 0.85);
}

#[test]
fn the_log_keeps_what_was_not_sent_and_gives_again_what_was_lost() {
    let mut log = SampleLog::<2>::new();
    log.begin(5, 6);
    let put = |log: &mut SampleLog<2>, n: i32| {
        log.push(&sample(n));
        log.flush();
    };
    put(&mut log, 0);
    put(&mut log, 1);
    assert_eq!(log.next_unsent().unwrap().first, 0);
    put(&mut log, 2);
    assert_eq!(
        (log.dropped(), log.kept_blocks()),
        (0, 2),
        "the sent block made room"
    );
    put(&mut log, 3);
    put(&mut log, 4);
    assert_eq!(log.dropped(), 2, "none was sent: the newest are dropped");
    assert_eq!(log.next_unsent().unwrap().first, 1);
    put(&mut log, 5);

    // The host missed sample 1: too late; it gets what is kept, with the gap visible.
    let block = log.drain(1, true);
    assert_eq!((block.first, block.count, block.run), (2, 1, 5));
    assert_eq!(log.drain(1, true), block, "asking again gives the same");
    let block = log.drain(3, true);
    assert_eq!((block.first, block.count, block.dropped), (5, 1, 2));
    let end = log.drain(6, true);
    assert_eq!((end.first, end.count, end.dropped), (6, 0, 2));
    assert_eq!(log.taken(), 6);
}

#[test]
fn damaged_blocks_end_with_an_error() {
    let mut log = SampleLog::<2>::new();
    log.begin(1, 6);
    log.push(&sample(1));
    log.push(&sample(2));
    log.flush();
    let good = log.drain(0, true);
    assert_eq!(
        good.samples().collect::<Vec<_>>(),
        [Ok(sample(1)), Ok(sample(2))]
    );
    for cut in 0..good.data.len() {
        let mut damaged = good.clone();
        damaged.data.truncate(cut);
        assert_eq!(
            damaged.samples().last(),
            Some(Err(BlockError::Damaged)),
            "cut at {cut}"
        );
    }
    let mut longer = good.clone();
    longer.data.push(0).unwrap();
    assert_eq!(
        longer.samples().last(),
        Some(Err(BlockError::TrailingBytes))
    );
    let fewer = SampleBlock { count: 1, ..good };
    assert_eq!(fewer.samples().last(), Some(Err(BlockError::TrailingBytes)));
}
