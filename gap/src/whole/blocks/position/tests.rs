//! Closed forms and fine integrations of the loop.

use super::super::found::{Named, named};
use super::*;
use crate::evidence::block::{Meaning, White};
use crate::math::Rng;

/// Gain of the loop, 1/s, time between rows, s, and noise of the encoder, rad.
const GAIN: f64 = 10.0;
const ROW_S: f64 = 0.01;
const NOISE_RAD: f64 = 3e-4;
const TICK_S: f64 = 0.05;

fn known() -> Known {
    Known {
        nominal: Nominal {
            gain_per_s: GAIN,
            gain_tolerance: 0.05,
            max_speed_rad_s: 2.5,
            max_torque_nm: 4.8,
            torque_tolerance_nm: 0.3,
            damping_nm_s_rad: 0.0,
            damping_tolerance_nm_s_rad: 0.0,
            winding_ohm: 0.0,
            nm_per_a: 4.3,
        },
        late_s: None,
        applied: false,
        speed_tolerance: 0.1,
        echoed: false,
        clocked: false,
        row_s: ROW_S,
        loaded: true,
    }
}

/// Twelve seconds of set-points.
fn sent(set: impl Fn(usize) -> f64) -> Track {
    let ticks = 0..240;
    Track {
        t_s: ticks.clone().map(|i| i as f64 * TICK_S).collect(),
        v: ticks.map(set).collect(),
    }
}

/// Set-points of a slow swing, and the closed form of a loop that follows them `late_s` late with gain `GAIN *
/// ratio`.
fn run([late_s, ratio, offset]: [f64; 3], row_s: f64, rng: &mut Rng) -> (Track, Track) {
    let set = |i: usize| {
        0.6 * crate::math::sin(0.063 * i as f64) + 0.2 * crate::math::sin(0.17 * i as f64)
    };
    let command = sent(set);
    let mut position = Track::default();
    let mut q = set(0);
    for row in 0..(11.9 / row_s) as usize {
        let t = row as f64 * row_s;
        position.t_s.push(t);
        position.v.push(q + NOISE_RAD * rng.normal());
        // Between two instants the set-point is held but for one change: exact exponentials on both sides of it.
        let (mut from, end) = (t, t + row_s);
        while from < end - 1e-12 {
            let tick = ((from - late_s) / TICK_S + 1e-9).floor();
            let next = ((tick + 1.0) * TICK_S + late_s).min(end);
            let c = set(tick.max(0.0) as usize) + offset;
            q = c + (q - c) * libm::exp(-GAIN * ratio * (next - from));
            from = next;
        }
    }
    (command, position)
}

fn named_loop(late_s: f64, ratio: f64, offset: f64) -> Named {
    let mut rng = Rng::new(7);
    let runs: Vec<(Track, Track)> = (0..3)
        .map(|_| run([late_s, ratio, offset], ROW_S, &mut rng))
        .collect();
    let inputs: Vec<Input<'_>> = runs
        .iter()
        .map(|(command, position)| Input {
            command: command.clone(),
            position,
            load_nm: &[],
            load_step_s: 0.02,
            limit: None,
        })
        .collect();
    named_in(&inputs)
}

/// As the search of causes does: around nothing, then around what was found.
fn named_in(inputs: &[Input<'_>]) -> Named {
    let first = searched(inputs, &[]);
    searched(inputs, &first.1).0
}

/// Effects and sizes, and coefficients, around the coefficients `start`.
fn searched(inputs: &[Input<'_>], start: &[(usize, f64)]) -> (Named, Vec<(usize, f64)>) {
    let white = White::new(raw(0, inputs, &known(), start).expect("long enough"), 6);
    let by = white.tempering(0.12, 0.0);
    let slack: Vec<f64> = white.columns.iter().map(|c| c.slack).collect();
    let (named, coefficients) = named(&[white.without_nuisances(&slack, by)]);
    let own = coefficients.into_iter().map(|c| (c.1, c.2));
    (named, own.collect())
}

#[test]
fn closed_forms_of_the_loop_are_named_with_their_size() {
    let cases = [
        ("nothing", 0.0, 1.0, 0.0, None),
        ("late", 0.06, 1.0, 0.0, Some((Effect::Latency, 0.06, 0.01))),
        ("weak", 0.0, 0.6, 0.0, Some((Effect::LoopGain, 0.6, 0.06))),
        (
            "off",
            0.0,
            1.0,
            0.05,
            Some((Effect::JointOffset, 0.05, 0.005)),
        ),
    ];
    for (what, late_s, ratio, offset, expected) in cases {
        let found = named_loop(late_s, ratio, offset);
        match expected {
            None => assert!(found.is_empty(), "{what}: {found:?}"),
            Some((effect, value, within)) => {
                assert_eq!(found.len(), 1, "{what}: {found:?}");
                assert_eq!(found[0].0, Some(effect), "{what}: {found:?}");
                assert!((found[0].1 - value).abs() < within, "{what}: {found:?}");
            }
        }
    }
}

#[test]
fn corners_between_two_rows_leave_the_noise_alone() {
    // Set-points that come half a row late: between rows the angle is no straight line.
    const SLOW_ROW_S: f64 = 0.025;
    const LATE_S: f64 = 3.5 * SLOW_ROW_S;
    let (command, position) = run([LATE_S, 1.0, 0.0], SLOW_ROW_S, &mut Rng::new(5));
    let input = Input {
        command,
        position: &position,
        load_nm: &[],
        load_step_s: 0.02,
        limit: None,
    };
    let known = Known {
        late_s: Some([LATE_S - 0.01, LATE_S + 0.01]),
        echoed: true,
        row_s: SLOW_ROW_S,
        ..known()
    };
    let is_late = |s: &Shape| matches!(s.change, Change::Delay(size) if size > 0.05 && size < 1.0);
    let late = shapes(&known, &[])
        .iter()
        .position(is_late)
        .expect("a delay");
    let raw = raw(0, &[input], &known, &[(late, 1.0)]).expect("long enough");
    let s = &raw.segments[0];
    let left = less(&s.y, &s.x[late]);
    let counted: Vec<f64> = left.iter().zip(&s.weight).map(|(e, w)| e * w).collect();
    let rms = crate::math::rms(&counted);
    // Set-points begin with a step of the grid: up to 1 ms off, 0.3 mrad here. Straight lines between rows leave 0.7 mrad.
    assert!(rms < 1.7 * NOISE_RAD, "{rms}");
}

#[test]
fn set_points_that_never_came_are_counted() {
    let mut rng = Rng::new(9);
    let (sent, _) = run([0.0, 1.0, 0.0], ROW_S, &mut rng);
    for share in [0.0, 0.03, 0.2, 0.35] {
        // What came, followed by the closed form of the loop.
        let came: Vec<bool> = sent.t_s.iter().map(|_| rng.uniform() >= share).collect();
        let mut position = Track::default();
        let (mut q, mut held) = (sent.v[0], sent.v[0]);
        for row in 0..1190 {
            let tick = row / 5;
            if row % 5 == 0 && came[tick] {
                held = sent.v[tick];
            }
            position.t_s.push(row as f64 * ROW_S);
            position.v.push(q + NOISE_RAD * rng.normal());
            q = held + (q - held) * libm::exp(-GAIN * ROW_S);
        }
        let input = Input {
            command: sent.clone(),
            position: &position,
            load_nm: &[],
            load_step_s: 0.02,
            limit: None,
        };
        let found = named_in(&[input]);
        let lost = found.iter().find(|f| f.0 == Some(Effect::PacketLoss));
        let size = lost.map_or(0.0, |l| l.1);
        let missed = came.iter().filter(|c| !**c).count() as f64 / came.len() as f64;
        assert!(
            (size - missed).abs() < 0.3 * missed + 1e-9,
            "{missed}: {found:?}"
        );
        assert!(found.len() <= 1, "{found:?}");
    }
}

/// A swing whose speed is limited, in fine steps.
fn limited(most_rad_s: f64) -> (Track, Track) {
    let mut rng = Rng::new(3);
    let set = |i: usize| {
        1.1 * crate::math::sin(0.063 * i as f64) + 0.35 * crate::math::sin(0.17 * i as f64)
    };
    let command = sent(set);
    let mut position = Track::default();
    let (mut q, fine_s) = (set(0), 1e-4);
    for step in 0..(11.9 / fine_s) as usize {
        if step % 100 == 0 {
            position.t_s.push(step as f64 * fine_s);
            position.v.push(q + NOISE_RAD * rng.normal());
        }
        q += fine_s * (GAIN * (set(step / 500) - q)).clamp(-most_rad_s, most_rad_s);
    }
    (command, position)
}

fn input((command, position): &(Track, Track)) -> Input<'_> {
    Input {
        command: command.clone(),
        position,
        load_nm: &[],
        load_step_s: 0.02,
        limit: None,
    }
}

/// A swing against gravity with a motor of at most `most_nm`, in fine steps: set-points, angles, and the torque that the joint bears.
fn lifting(most_nm: f64) -> (Track, Track, Track) {
    const LIFTED_NM: f64 = 3.0;
    const STIFF_NM_S: f64 = 100.0;
    const TURNED_KG_M2: f64 = 0.02;
    let mut rng = Rng::new(5);
    let set = |i: usize| 0.8 * crate::math::sin(0.063 * i as f64) + 0.3;
    let command = sent(set);
    let (mut position, mut torque) = (Track::default(), Track::default());
    let (mut q, mut v, fine_s) = (set(0), 0.0, 1e-4);
    for step in 0..(11.9 / fine_s) as usize {
        let wanted = (GAIN * (set(step / 500) - q)).clamp(-2.5, 2.5);
        let gives = (STIFF_NM_S * (wanted - v)).clamp(-most_nm, most_nm);
        if step % 100 == 0 {
            position.t_s.push(step as f64 * fine_s);
            position.v.push(q + NOISE_RAD * rng.normal());
            torque.t_s.push(step as f64 * fine_s);
            torque.v.push(gives + 0.02 * rng.normal());
        }
        v += fine_s * (gives - LIFTED_NM * crate::math::sin(q)) / TURNED_KG_M2;
        q += fine_s * v;
    }
    (command, position, torque)
}

#[test]
fn a_motor_that_cannot_lift_its_load_has_a_limit_of_its_size() {
    for (most_nm, within) in [(1.2, 0.1), (2.0, 0.1), (4.0, 0.0)] {
        let (command, position, torque) = lifting(most_nm);
        // Measured, and as a replay of the body has it.
        for measured in [true, false] {
            let input = Input {
                command: command.clone(),
                position: &position,
                load_nm: &torque.v,
                load_step_s: ROW_S,
                limit: measured.then_some((4.56, &torque)),
            };
            let inputs = [input];
            let (named, start) = searched(&inputs, &[]);
            let limited = named.iter().any(|n| n.0 == Some(Effect::TorqueLimit));
            assert_eq!(limited, within > 0.0, "{most_nm} {measured}: {named:?}");
            if limited {
                let played = Played::new(&inputs, &known());
                let found = played.law(played.fitted(&start)).torque_nm;
                assert!(
                    (found / most_nm - 1.0).abs() < within,
                    "{most_nm} {measured}: {found}"
                );
            }
        }
    }
}

#[test]
fn a_servo_that_is_slower_than_stated_within_its_tolerance_has_no_limit() {
    use crate::decide::Calibration;
    use crate::evidence::settle::settled;
    // Two and a half tolerances slow; the swing asks for more than that.
    let run = limited(2.5 * (1.0 - 2.5 * 0.1));
    let inputs = [input(&run)];
    let nominal = White::new(raw(0, &inputs, &known(), &[]).expect("long enough"), 6);
    let start = settled(&nominal, &Calibration::shipped().spreads);
    assert!(!start.is_empty());
    let limited = |start: &[(usize, f64)]| {
        let (named, _) = searched(&inputs, start);
        named.iter().any(|n| n.0 == Some(Effect::VelocityLimit))
    };
    assert!(limited(&[]), "around what is stated it looks like a limit");
    assert_eq!(searched(&inputs, &start).0, [], "around {start:?}");
}

#[test]
fn a_cause_far_from_what_is_stated_is_fitted_where_it_is() {
    // Between the limits that are played, and down to a twelfth of the stated one.
    for most_rad_s in [0.97, 0.41, 0.2] {
        let run = limited(most_rad_s);
        let inputs = [input(&run)];
        let (named, start) = searched(&inputs, &[]);
        assert!(
            named.iter().any(|n| n.0 == Some(Effect::VelocityLimit)),
            "{most_rad_s}: {named:?}"
        );
        let played = Played::new(&inputs, &known());
        let law = played.law(played.fitted(&start));
        let found = law.most * law.share;
        assert!(
            (found / most_rad_s - 1.0).abs() < 0.01,
            "{most_rad_s}: {found}"
        );
        // The noise of the start stays where the speed is limited.
        let all = errors_rad(&inputs, &law);
        let errors: Vec<f64> = all[0].iter().map(|e| e[1]).collect();
        let left = crate::math::rms(&errors);
        assert!(left < 4.0 * NOISE_RAD, "{most_rad_s}: {left}");
    }
}

/// A driver whose clock is fast acts on set-points that were sent after the end of the recording.
#[test]
fn a_fast_clock_has_no_errors_where_its_set_points_are_not_recorded() {
    let run = limited(2.5);
    let inputs = [input(&run)];
    let played = Played::new(&inputs, &known());
    let clock = shapes(&known(), &[])
        .iter()
        .position(|s| matches!(s.change, Change::Clock))
        .expect("a clock");
    let end = |by: f64| {
        let errors = errors_rad(&inputs, &played.law([(clock, by)]));
        errors[0].last().map_or(0.0, |e| e[0])
    };
    let whole_s = end(0.0);
    assert_eq!(end(-0.02), whole_s);
    // Two in a hundred of twelve seconds.
    let lost_s = whole_s - end(0.02);
    assert!((0.1..0.3).contains(&lost_s), "{lost_s}");
}

/// At the ends of its range a shape's number is the law's, and beyond them the law stays: a fit ends at a limit above zero.
#[test]
fn a_fitted_limit_or_gain_is_above_zero() {
    let known = known();
    let there = Law::nominal(&known.nominal);
    let mut ends = 0;
    for shape in shapes::shapes(&known, 10.0) {
        let number = |law: &Law| match shape.column.meaning {
            Meaning::Effect(Effect::LoopGain) => law.ratio,
            Meaning::Effect(Effect::VelocityLimit) => law.most * law.share,
            Meaning::Effect(Effect::TorqueLimit) => law.torque_nm,
            _ => f64::NAN,
        };
        let of = shape.column.parameter;
        for end in shape.change.range().into_iter().filter(|e| e.is_finite()) {
            let law = shape.change.on(there, end);
            if number(&law).is_finite() {
                let value = of.neutral + of.scale * end;
                assert!(
                    value > 0.0 && (value - number(&law)).abs() < 1e-9,
                    "{value}"
                );
                let beyond = number(&shape.change.on(there, 1.5 * end));
                assert!((value - beyond).abs() < 1e-9, "{value} {beyond}");
                ends += 1;
            }
        }
    }
    assert!(ends > 20, "{ends}");
    let recorded = run([0.0, 1.0, 0.0], ROW_S, &mut Rng::new(5));
    let limits = |s: &Shape| s.column.meaning == Meaning::Effect(Effect::VelocityLimit);
    let all = shapes::shapes(&known, 0.0);
    let at = all.iter().position(limits).expect("a limit");
    let fitted = Played::new(&[input(&recorded)], &known).fitted(&[(at, 19.0)]);
    let of = all[at].column.parameter;
    for (_, by) in fitted.iter().filter(|f| f.0 == at) {
        assert!(of.neutral + of.scale * by > 0.0, "{by}");
    }
}
