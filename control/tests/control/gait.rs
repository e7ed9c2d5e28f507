//! What becomes a gait and what does not.

use crate::common::{crawl, raw};
use control::cpg;
use control::gait::{
    self, AMPLITUDE_RAD, Gait, GaitError, GaitField, Link, MAX_OSCILLATORS, Oscillator,
    RATE_A_PER_S, RawGait, RobotMismatch,
};
use control::robot::RobotModel;
use proptest::prelude::*;

fn good() -> RawGait {
    raw(
        "good",
        [40.0; 6],
        [0.0; 6],
        [90.0, -90.0, 180.0, 90.0, -90.0],
    )
}

/// One number of a gait: its name, its index, and how to set it.
type Knob = (GaitField, u8, fn(&mut RawGait, f32));

const KNOBS: [Knob; 8] = [
    (GaitField::Frequency, 0, |g, v| g.frequency_hz = v),
    (GaitField::RateA, 0, |g, v| g.rate_a_per_s = v),
    (GaitField::Duration, 0, |g, v| g.duration_s = v),
    (GaitField::Amplitude, 2, |g, v| {
        g.oscillators[2].amplitude_rad = v
    }),
    (GaitField::Offset, 5, |g, v| g.oscillators[5].offset_rad = v),
    (GaitField::InitialPhase, 0, |g, v| {
        g.oscillators[0].initial_phase_rad = v
    }),
    (GaitField::Weight, 4, |g, v| g.links[4].weight = v),
    (GaitField::PhaseLag, 1, |g, v| g.links[1].phase_lag_rad = v),
];

#[test]
fn every_number_is_checked_and_named() {
    for (field, index, set) in KNOBS {
        for value in [
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            1e30,
            -1e30,
            f32::MAX,
        ] {
            let mut g = good();
            set(&mut g, value);
            match Gait::try_from(g) {
                Err(GaitError::OutOfRange {
                    field: f,
                    index: i,
                    value: v,
                    min,
                    max,
                }) => {
                    assert_eq!((f, i, v.to_bits()), (field, index, value.to_bits()));
                    assert!(min < max);
                }
                other => panic!("{field:?} = {value} gave {other:?}"),
            }
        }
    }
}

#[test]
fn the_ends_of_a_range_are_inside() {
    for (value, ok) in [
        (0.0, true),
        (AMPLITUDE_RAD.max, true),
        (AMPLITUDE_RAD.max * 1.000_001, false),
        (-1e-9, false),
    ] {
        let mut g = good();
        g.oscillators[0].amplitude_rad = value;
        assert_eq!(Gait::try_from(g).is_ok(), ok, "{value}");
    }
    let mut g = good();
    g.rate_a_per_s = RATE_A_PER_S.min;
    assert!(Gait::try_from(g).is_ok());
}

#[test]
fn wrong_links_are_named() {
    let link = |from, to| Link {
        from,
        to,
        weight: 0.5,
        phase_lag_rad: 0.0,
    };
    let with = |links: &[Link]| {
        let mut g = good();
        g.links = links.iter().copied().collect();
        Gait::try_from(g)
    };
    assert_eq!(
        with(&[link(0, 1), link(3, 3)]),
        Err(GaitError::SelfLink { link: 1 })
    );
    assert_eq!(
        with(&[link(0, 6)]),
        Err(GaitError::LinkOutOfRange {
            link: 0,
            oscillator: 6,
            count: 6
        })
    );
    assert_eq!(
        with(&[link(255, 0)]),
        Err(GaitError::LinkOutOfRange {
            link: 0,
            oscillator: 255,
            count: 6
        })
    );
    assert_eq!(
        with(&[link(0, 1), link(1, 2), link(1, 0)]),
        Err(GaitError::DuplicateLink {
            link: 2,
            earlier: 0
        })
    );
    assert!(with(&[]).is_ok(), "uncoupled is a gait");
}

#[test]
fn names_are_plain_text() {
    for (name, ok) in [
        ("crawl", true),
        ("Überschlag 2", true),
        ("", false),
        ("a\x1b[31m", false),
        ("a\nb", false),
    ] {
        let mut g = good();
        g.name = name.try_into().expect("short");
        assert_eq!(Gait::try_from(g).is_ok(), ok, "{name:?}");
    }
    assert_eq!(
        Gait::try_from(RawGait {
            oscillators: heapless::Vec::new(),
            links: heapless::Vec::new(),
            ..good()
        }),
        Err(GaitError::NoOscillators)
    );
}

#[test]
fn equal_behaviour_has_one_form() {
    let mut turned = good();
    turned.oscillators[1].initial_phase_rad -= std::f32::consts::TAU;
    turned.oscillators[3].offset_rad = -0.0;
    turned.links.reverse();
    let last = turned.links.last_mut().expect("some");
    (last.from, last.to, last.phase_lag_rad) = (last.to, last.from, -last.phase_lag_rad);
    let (a, b) = (
        Gait::try_from(good()).expect("valid"),
        Gait::try_from(turned).expect("valid"),
    );
    assert_eq!(a.links(), b.links());
    assert_eq!(
        a.oscillators()[3].offset_rad.to_bits(),
        b.oscillators()[3].offset_rad.to_bits()
    );
    // No number of a gait keeps the sign of a zero: a file's digest is of the bits.
    let mut negative = good();
    negative.links.iter_mut().for_each(|link| {
        (link.weight, link.phase_lag_rad) = (-0.0, -0.0);
    });
    let o = &mut negative.oscillators[3];
    (o.amplitude_rad, o.offset_rad, o.initial_phase_rad) = (-0.0, -0.0, -0.0);
    let zeros = Gait::try_from(negative).expect("valid");
    let o = &zeros.oscillators()[3];
    let of_links = zeros.links().iter();
    let numbers = of_links.flat_map(|link| [link.weight, link.phase_lag_rad]);
    let all = numbers.chain([o.amplitude_rad, o.offset_rad, o.initial_phase_rad]);
    assert!(all.into_iter().all(|x| x.to_bits() == 0));
    let again = Gait::try_from(b.raw()).expect("canonical form is valid");
    assert_eq!(again, b, "canonical form is a fixed point");
}

#[test]
fn the_locked_start_is_a_fixed_point_of_the_coupling() {
    // A star, a chain against the direction of its links, and a part of its own.
    let mut g = good();
    let link = |from, to, lag: f32| Link {
        from,
        to,
        weight: 0.5,
        phase_lag_rad: lag,
    };
    g.links = [
        link(2, 0, 0.3),
        link(2, 1, -1.0),
        link(3, 2, 2.5),
        link(5, 4, -2.0),
    ]
    .into_iter()
    .collect();
    g.lock_phases();
    let gait = Gait::try_from(g).expect("valid");
    let mut state = cpg::start(&gait);
    let before: Vec<f32> = state.oscillators().iter().map(|o| o.phase_rad).collect();
    for _ in 0..400 {
        cpg::step(&gait, &mut state, control::CYCLE_S);
    }
    let turned = control::math::wrap_pi(state.oscillators()[0].phase_rad - before[0]);
    for (o, b) in state.oscillators().iter().zip(before) {
        assert!((control::math::wrap_pi(o.phase_rad - b) - turned).abs() < 1e-4);
    }
}

#[test]
fn the_speed_check_names_joint_and_both_speeds() {
    let model = RobotModel::default();
    assert_eq!(crawl().check_speed(model.joints()), Ok(()));
    // At 0.2 Hz the no-load speed is met at 127 deg (intra) and 92.6 deg (inter).
    for (joint, just, too_much) in [
        (0usize, 126.9, 127.2),
        (1, 92.5, 92.8),
        (4, 92.5, 92.8),
        (5, 126.9, 127.2),
    ] {
        for (amplitude, ok) in [(just, true), (too_much, false)] {
            let mut amplitudes = [10.0; 6];
            amplitudes[joint] = amplitude;
            let g = Gait::try_from(raw("g", amplitudes, [0.0; 6], [0.0; 5])).expect("valid");
            match g.check_speed(model.joints()) {
                Ok(()) => assert!(ok, "joint {joint} at {amplitude} deg"),
                Err(RobotMismatch::TooFast {
                    joint: k,
                    needed_rad_s,
                    limit_rad_s,
                }) => {
                    assert!(!ok && usize::from(k) == joint && needed_rad_s > limit_rad_s);
                }
                Err(other) => panic!("{other:?}"),
            }
        }
    }
    let mut five = good();
    five.oscillators.truncate(5);
    five.links.clear();
    let five = Gait::try_from(five).expect("a network of any size is a gait");
    assert_eq!(
        five.check_speed(model.joints()),
        Err(RobotMismatch::JointCount {
            oscillators: 5,
            joints: 6
        })
    );
}

fn any_number() -> impl Strategy<Value = f32> {
    prop_oneof![4 => -8.0f32..8.0, 1 => any::<u32>().prop_map(f32::from_bits)]
}

fn any_raw() -> impl Strategy<Value = RawGait> {
    let oscillator = (any_number(), any_number(), any_number()).prop_map(
        |(amplitude_rad, offset_rad, initial_phase_rad)| Oscillator {
            amplitude_rad: amplitude_rad.abs() * 0.4,
            offset_rad: offset_rad * 0.4,
            initial_phase_rad,
        },
    );
    let link = (0u8..13, 0u8..13, any_number(), any_number()).prop_map(
        |(from, to, weight, phase_lag_rad)| Link {
            from,
            to,
            weight: weight.abs() * 0.4,
            phase_lag_rad,
        },
    );
    let oscillators = prop::collection::vec(oscillator, 0..=MAX_OSCILLATORS);
    let links = prop::collection::vec(link, 0..6);
    (any_number(), any_number(), any_number(), oscillators, links).prop_map(
        |(f, a, d, oscillators, links)| RawGait {
            name: "any".try_into().expect("short"),
            frequency_hz: f.abs() * 0.25,
            rate_a_per_s: a.abs(),
            duration_s: d.abs(),
            oscillators: oscillators.into_iter().collect(),
            links: links.into_iter().collect(),
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    /// Whatever is accepted gives finite set-points inside amplitude and offset for as long as it runs.
    #[test]
    fn accepted_means_finite_and_bounded(raw in any_raw()) {
        let Ok(gait) = Gait::try_from(raw) else { return Ok(()) };
        prop_assert_eq!(&Gait::try_from(gait.raw()).expect("canonical"), &gait);
        let mut state = cpg::start(&gait);
        for _ in 0..200 {
            let out = cpg::step(&gait, &mut state, control::CYCLE_S);
            for (q, o) in out.as_slice().iter().zip(gait.oscillators()) {
                prop_assert!((q - o.offset_rad).abs() <= o.amplitude_rad + 1e-5, "{} of {:?}", q, o);
            }
        }
    }

    #[test]
    fn locking_phases_never_leaves_a_valid_gait_invalid(raw in any_raw()) {
        let mut locked = raw.clone();
        locked.lock_phases();
        if Gait::try_from(raw).is_ok() {
            prop_assert!(Gait::try_from(locked).is_ok());
        }
    }
}

#[test]
fn a_chain_couples_neighbours() {
    let links = gait::chain(0.5, &[0.1, 0.2]);
    assert_eq!(
        links
            .iter()
            .map(|l| (l.from, l.to, l.phase_lag_rad))
            .collect::<Vec<_>>(),
        [(0, 1, 0.1), (1, 2, 0.2)]
    );
}
