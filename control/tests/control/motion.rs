//! The motion planner from the outside: what leaves for the motors, against the CPG alone and the oracle.

use crate::common::{clash, crawl, gait};
use crate::oracle;
use control::cpg;
use control::gait::Gait;
use control::machine::{Angles, Machine};
use control::motion::{
    BeginError, CycleOutput, MAX_LOOKAHEAD, MotionParams, MotionSettings, Planner, SettingsError,
};
use control::precheck;
use control::robot::RobotModel;
use control::supervisor::Motion;

fn params(lookahead_cycles: u8) -> MotionParams {
    MotionParams::new(
        Machine::default(),
        MotionSettings {
            lookahead_cycles,
            ..MotionSettings::default()
        },
    )
    .expect("valid")
}

fn bits(angles_rad: &[f32]) -> Vec<u32> {
    angles_rad.iter().map(|angle| angle.to_bits()).collect()
}

/// Approaches from `pose` and returns every output up to the cycle in which the planner is in position.
fn approach(planner: &mut Planner, params: &MotionParams) -> Vec<CycleOutput> {
    let mut all = Vec::new();
    for _ in 0..2000 {
        let out = planner
            .cycle(params, Motion::Approach, None)
            .expect("set-points are sound");
        all.push(out);
        if out.in_position {
            return all;
        }
    }
    panic!("never in position: {:?}", all.last());
}

/// Every change of a set-point stays within the joint's speed, from `before` on.
fn assert_slow(before: impl Into<Angles>, outputs: &[CycleOutput]) {
    let mut last = before.into();
    for (cycle, out) in outputs.iter().enumerate() {
        for (k, joint) in RobotModel::default().joints().iter().enumerate() {
            let change = (out.set_point_rad[k] - last[k]).abs();
            assert!(
                change <= joint.no_load_speed_rad_s * 0.05 + 1e-5,
                "cycle {cycle} joint {k} changes by {change}"
            );
        }
        last = out.set_point_rad;
    }
}

fn run(planner: &mut Planner, params: &MotionParams, cycles: usize) -> Vec<CycleOutput> {
    (0..cycles)
        .map(|_| {
            planner
                .cycle(params, Motion::Run, None)
                .expect("set-points are sound")
        })
        .collect()
}

#[test]
fn a_free_gait_leaves_as_the_cpg_computes_it() {
    let p = params(20);
    for g in [
        crawl(),
        gait(
            "wave",
            [60.0, 50.0, 40.0, 30.0, 20.0, 10.0],
            [10.0, -20.0, 30.0, 0.0, 5.0, 90.0],
            [45.0; 5],
        ),
    ] {
        let mut planner = Planner::begin(&p, &g, &[0.0; 6].into()).expect("begins");
        approach(&mut planner, &p);
        let mut state = cpg::start(&g);
        for cycle in 0..600 {
            let out = planner.cycle(&p, Motion::Run, None).expect("sound");
            let alone = cpg::step(&g, &mut state, control::CYCLE_S)
                .joints()
                .expect("six");
            assert_eq!(bits(&out.set_point_rad), bits(&alone), "cycle {cycle}");
            assert_eq!(bits(&out.gait_rad), bits(&alone), "cycle {cycle}");
        }
        assert_eq!(planner.held_cycles(), 0);
    }
}

#[test]
fn the_approach_reaches_the_offsets_slowly_and_waits_there() {
    let p = params(20);
    let g = gait(
        "offsets",
        [20.0; 6],
        [90.0, -90.0, 45.0, 30.0, 170.0, -170.0],
        [0.0; 5],
    );
    let pose = [0.3, -6.5, 0.2, -0.1, 0.0, 7.0];
    let mut planner = Planner::begin(&p, &g, &pose.into()).expect("begins");
    let outputs = approach(&mut planner, &p);
    assert_slow(pose, &outputs);
    let x: Vec<f32> = g.oscillators().iter().map(|o| o.offset_rad).collect();
    assert_eq!(planner.applied_rad().as_slice(), x);
    for _ in 0..50 {
        let out = planner.cycle(&p, Motion::Approach, None).expect("sound");
        assert!(out.in_position);
        assert_eq!(out.set_point_rad.as_slice(), x);
    }
    let first = planner.cycle(&p, Motion::Run, None).expect("sound");
    assert_eq!(
        first.set_point_rad.as_slice(),
        x,
        "theta(0) = X because r(0) = 0"
    );
}

#[test]
fn a_clash_is_held_before_it_happens_and_left_again() {
    let oracle = oracle::Oracle::new(std::f64::consts::FRAC_PI_2);
    for lookahead in [1, 20, MAX_LOOKAHEAD as u8] {
        let p = params(lookahead);
        let g = clash();
        let mut planner = Planner::begin(&p, &g, &[0.0; 6].into()).expect("begins");
        let way = approach(&mut planner, &p);
        assert_slow([0.0; 6], &way);
        let start = *planner.applied_rad();
        let outputs = run(&mut planner, &p, 600);
        assert_slow(start, &outputs);
        let mut last = start;
        let mut unheld_would_collide = 0;
        for out in &outputs {
            for k in 0..=8 {
                let s = k as f32 / 8.0;
                let q: [f32; 6] =
                    std::array::from_fn(|i| last[i] + s * (out.set_point_rad[i] - last[i]));
                assert!(oracle.distance(&q).lower_m > 0.002, "{q:?}");
            }
            unheld_would_collide +=
                u32::from(oracle.distance(&out.gait_rad.meta_module()).lower_m <= 0.0);
            last = out.set_point_rad;
        }
        assert!(
            unheld_would_collide > 50,
            "the gait must be a real test: {unheld_would_collide}"
        );
        assert!(planner.holds() >= 5, "held {} times", planner.holds());
        let free = outputs.iter().filter(|o| !o.held).count();
        assert!(
            free > 100,
            "the robot must move between the holds: {free} free cycles with look-ahead {lookahead}"
        );
    }
}

#[test]
fn the_look_ahead_holds_a_second_early_and_says_who_meets_whom() {
    let g = clash();
    let first_block = |lookahead: u8| {
        let p = params(lookahead);
        let mut planner = Planner::begin(&p, &g, &[0.0; 6].into()).expect("begins");
        approach(&mut planner, &p);
        let outputs = run(&mut planner, &p, 200);
        let cycle = outputs.iter().position(|o| o.held).expect("is held");
        (cycle, outputs.into_iter().find_map(|o| o.blocked))
    };
    let (late, at_once) = first_block(1);
    let (early, ahead) = first_block(20);
    assert_eq!(late - early, 19);
    let (at_once, ahead) = (at_once.expect("reported"), ahead.expect("reported"));
    assert!((0.0..=0.05).contains(&at_once.at_s), "{at_once:?}");
    assert!((0.95..=1.0).contains(&ahead.at_s), "{ahead:?}");
    assert!(ahead.clearance_m < precheck::MARGIN_M);
    assert!(ahead.pair.first <= 1 && (5..=6).contains(&ahead.pair.last));
}

#[test]
fn a_measured_pose_that_would_be_driven_through_itself_holds() {
    let p = params(20);
    let g = crawl();
    let mut planner = Planner::begin(&p, &g, &[0.0; 6].into()).expect("begins");
    approach(&mut planner, &p);
    run(&mut planner, &p, 20);
    let before = *planner.applied_rad();
    // Folded by hand to where C1 and C4 overlap.
    let folded = [
        0.0,
        0.0,
        -145f32.to_radians(),
        -127f32.to_radians(),
        0.0,
        0.0,
    ];
    assert!(precheck::clearance(&RobotModel::default(), &folded).clearance_m < 0.0);
    let out = planner
        .cycle(&p, Motion::Run, Some(&folded.into()))
        .expect("sound");
    assert!(out.held);
    assert_eq!(out.set_point_rad, before);
    assert!(out.blocked.is_some());
    let out = planner
        .cycle(&p, Motion::Run, Some(&[f32::NAN; 6].into()))
        .expect("sound");
    assert!(out.held, "a pose that is no number is no proof");
    let later = run(&mut planner, &p, 200);
    assert!(!later.last().expect("some").held, "usable again");
    assert_slow(before, &later);
}

#[test]
fn a_changed_gait_takes_over_without_a_jump() {
    let p = params(20);
    let (a, b) = (crawl(), gait("other", [10.0; 6], [30.0; 6], [0.0; 5]));
    let mut planner = Planner::begin(&p, &a, &[0.0; 6].into()).expect("begins");
    approach(&mut planner, &p);
    let mut outputs = run(&mut planner, &p, 100);
    planner.retarget(&p, &b).expect("fits");
    assert!(planner.retarget(&p, &b).is_err(), "one change at a time");
    outputs.extend(run(&mut planner, &p, 500));
    let mut state = cpg::start(&a);
    for (cycle, out) in outputs.iter().enumerate() {
        let g: &Gait = if cycle < 119 { &a } else { &b };
        let alone = cpg::step(g, &mut state, control::CYCLE_S)
            .joints()
            .expect("six");
        assert_eq!(out.gait_rad, alone, "cycle {cycle}");
        assert_eq!(out.set_point_rad, alone, "cycle {cycle}");
    }
    // The filter: no step of the offset is larger than a dt times the change, plus the oscillation itself.
    for pair in outputs.windows(2) {
        for k in 0..6 {
            let change = (pair[1].set_point_rad[k] - pair[0].set_point_rad[k]).abs();
            assert!(
                change < 2.0 * 0.05 * 0.6 + 0.7 * std::f32::consts::TAU * 0.2 * 0.05,
                "{change}"
            );
        }
    }
    assert_eq!(planner.gait(), &b);
}

#[test]
fn a_stop_brings_the_amplitudes_to_zero_at_once_and_settles() {
    let p = params(20);
    let g = crawl();
    let mut planner = Planner::begin(&p, &g, &[0.0; 6].into()).expect("begins");
    approach(&mut planner, &p);
    run(&mut planner, &p, 157);
    let before = *planner.applied_rad();
    let mut outputs = Vec::new();
    while outputs.len() < 100 && !outputs.last().is_some_and(|o: &CycleOutput| o.settled) {
        outputs.push(planner.cycle(&p, Motion::Ramp, None).expect("sound"));
    }
    assert!(
        outputs.len() <= 80,
        "settles within the ramp time, took {} cycles",
        outputs.len()
    );
    assert_slow(before, &outputs);
    let end = outputs.last().expect("some").set_point_rad;
    for (q, o) in end.iter().zip(g.oscillators()) {
        assert!((q - o.offset_rad).abs() < 2e-3);
    }
    let hold = planner.cycle(&p, Motion::Hold, None).expect("sound");
    assert_eq!(hold.set_point_rad, end);
}

#[test]
fn a_stop_out_of_a_hold_stays_held() {
    let p = params(20);
    let mut planner = Planner::begin(&p, &clash(), &[0.0; 6].into()).expect("begins");
    approach(&mut planner, &p);
    let cycles = (0..600).find(|_| planner.cycle(&p, Motion::Run, None).expect("sound").held);
    assert!(cycles.is_some());
    let held = *planner.applied_rad();
    let out = planner.cycle(&p, Motion::Ramp, None).expect("sound");
    assert!(out.settled);
    assert_eq!(out.set_point_rad, held);
}

#[test]
fn an_approach_through_itself_is_refused_with_the_pair() {
    let p = params(20);
    // The straight way from the one side of the keep-out zone to the other leads through it.
    let g = gait(
        "behind",
        [0.0; 6],
        [0.0, 0.0, -90.0, -130.0, 0.0, 0.0],
        [0.0; 5],
    );
    let pose = [
        0.0,
        0.0,
        -210f32.to_radians(),
        -127f32.to_radians(),
        0.0,
        0.0,
    ];
    assert!(precheck::clearance(&RobotModel::default(), &pose).clearance_m > 0.003);
    let mut planner = Planner::begin(&p, &g, &pose.into()).expect("begins");
    let mut reason = None;
    let mut last = CycleOutputEnd::default();
    for _ in 0..400 {
        let out = planner.cycle(&p, Motion::Approach, None).expect("sound");
        reason = reason.or(out.blocked);
        last = CycleOutputEnd {
            blocked: out.approach_blocked,
            in_position: out.in_position,
        };
        assert!(
            precheck::clearance(&RobotModel::default(), &out.set_point_rad.meta_module())
                .clearance_m
                > 0.0
        );
    }
    assert!(last.blocked && !last.in_position);
    assert!(reason.is_some());
}

#[derive(Default)]
struct CycleOutputEnd {
    blocked: bool,
    in_position: bool,
}

#[test]
fn what_does_not_fit_is_refused() {
    let p = params(20);
    let fast = gait("fast", [93.0; 6], [0.0; 6], [0.0; 5]);
    assert!(matches!(
        Planner::begin(&p, &fast, &[0.0; 6].into()),
        Err(BeginError::Mismatch(_))
    ));
    for bad in [f32::NAN, f32::INFINITY, -26.0] {
        let pose = [0.0, 0.0, 0.0, bad, 0.0, 0.0];
        assert!(matches!(
            Planner::begin(&p, &crawl(), &pose.into()),
            Err(BeginError::Pose { joint: 3, .. })
        ));
    }
    let settings = MotionSettings {
        lookahead_cycles: 0,
        ..MotionSettings::default()
    };
    assert_eq!(
        MotionParams::new(Machine::default(), settings),
        Err(SettingsError::Lookahead)
    );
    let settings = MotionSettings {
        approach_ratio: f32::NAN,
        ..MotionSettings::default()
    };
    assert_eq!(
        MotionParams::new(Machine::default(), settings),
        Err(SettingsError::ApproachRatio)
    );
}

/// The last check before a set-point leaves does not rely on the checks at the begin: here the joints have become ten times as slow since.
#[test]
fn a_set_point_that_a_joint_cannot_reach_in_a_cycle_does_not_leave() {
    let p = params(20);
    let mut slow = *RobotModel::default().params();
    for joint in &mut slow.joints {
        joint.no_load_speed_rad_s *= 0.1;
    }
    let slow = RobotModel::new(slow).expect("slow joints are joints");
    let slow =
        MotionParams::new(Machine::meta_module(slow), MotionSettings::default()).expect("valid");
    let mut planner = Planner::begin(&p, &crawl(), &[0.0; 6].into()).expect("clear");
    approach(&mut planner, &p);
    let mut last = run(&mut planner, &p, 30).pop().expect("30 cycles");
    for _ in 0..100 {
        match planner.cycle(&slow, Motion::Run, None) {
            Ok(out) => {
                for (k, joint) in slow.machine().limits().iter().enumerate() {
                    let change = (out.set_point_rad[k] - last.set_point_rad[k]).abs();
                    assert!(change <= joint.no_load_speed_rad_s * 0.05 + 1e-5);
                }
                last = out;
            }
            Err(bad) => {
                let change = (bad.value_rad - bad.previous_rad).abs();
                let joint = slow.machine().limits()[usize::from(bad.joint)];
                assert!(change > joint.no_load_speed_rad_s * 0.05);
                return;
            }
        }
    }
    panic!("the gait is too fast for these joints, and nothing said so");
}

/// Random gaits from random poses, with a robot that lags and jitters: what leaves is always finite, slow and clear of itself.
#[test]
fn any_gait_is_driven_safely() {
    let oracle = oracle::Oracle::new(std::f64::consts::FRAC_PI_2);
    let p = params(20);
    let mut rng = oracle::Rng(77);
    let (mut held, mut refused) = (0, 0);
    for _ in 0..60 {
        let mut number = |low: f64, high: f64| rng.between(low, high) as f32;
        let amplitudes =
            std::array::from_fn(|k| number(0.0, if k % 3 == 1 { 92.0 } else { 120.0 }));
        let g = gait(
            "any",
            amplitudes,
            std::array::from_fn(|_| number(-180.0, 180.0)),
            std::array::from_fn(|_| number(-180.0, 180.0)),
        );
        let pose: [f32; 6] = std::array::from_fn(|_| number(-3.0, 3.0));
        if oracle.distance(&pose).lower_m < 0.005 {
            continue;
        }
        let mut planner = Planner::begin(&p, &g, &pose.into()).expect("begins");
        let (mut last, mut measured) = (Angles::from(pose), Angles::from(pose));
        let mut motion = Motion::Approach;
        for cycle in 0..700 {
            let out = planner
                .cycle(&p, motion, Some(&measured))
                .expect("set-points are sound");
            refused += u32::from(out.approach_blocked && cycle == 699);
            if out.in_position {
                motion = Motion::Run;
            }
            if cycle == 600 && motion == Motion::Run {
                motion = Motion::Ramp;
            }
            held += u32::from(out.held);
            assert_slow(last, &[out]);
            let middle: [f32; 6] = std::array::from_fn(|i| 0.5 * (last[i] + out.set_point_rad[i]));
            for q in [middle, out.set_point_rad.meta_module()] {
                assert!(
                    oracle.centre_distance_m(&q) > 2.0 * oracle::BALL_M + 0.01
                        || oracle.distance(&q).lower_m > 0.5e-3,
                    "{q:?}"
                );
            }
            last = out.set_point_rad;
            for (m, q) in measured.iter_mut().zip(last.iter()) {
                *m += 0.6 * (q - *m) + rng.between(-0.002, 0.002) as f32;
            }
        }
    }
    assert!(
        held > 200,
        "a real test holds: {held} cycles, {refused} approaches refused"
    );
}
