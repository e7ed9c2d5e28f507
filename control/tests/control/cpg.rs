//! The oscillators against closed forms, and their bits.

use crate::common::{clash, crawl, gait, raw};
use control::CYCLE_S;
use control::cpg;
use control::gait::Gait;
use control::math::wrap_pi;

#[test]
fn amplitude_and_offset_follow_the_closed_form_of_the_filter() {
    let g = gait("g", [57.0; 6], [0.0; 6], [0.0; 5]);
    let moved = gait("g", [57.0; 6], [60.0; 6], [0.0; 5]);
    let mut state = cpg::start(&g);
    let r = f64::from(g.oscillators()[0].amplitude_rad);
    let x = f64::from(moved.oscillators()[0].offset_rad);
    cpg::retarget(&moved, &state).expect("same size");
    for n in 0..200 {
        let o = state.oscillators()[3];
        let rest = (1.0 - 2.0 * 0.05f64).powi(n);
        assert!(
            (f64::from(o.amplitude_rad) - r * (1.0 - rest)).abs() < 2e-6,
            "tick {n}"
        );
        assert!(
            (f64::from(o.offset_rad) - x * (1.0 - rest)).abs() < 2e-6,
            "tick {n}"
        );
        // Against the differential equation itself: Euler at 50 ms is within 4 % of R.
        let exact = r * (1.0 - (-2.0 * 0.05 * f64::from(n)).exp());
        assert!((f64::from(o.amplitude_rad) - exact).abs() < 0.04 * r);
        cpg::step(&moved, &mut state, CYCLE_S);
    }
}

#[test]
fn the_output_belongs_to_the_state_before_the_step() {
    let mut r = raw(
        "g",
        [30.0; 6],
        [10.0, 20.0, 30.0, 40.0, 50.0, 60.0],
        [0.0; 5],
    );
    r.oscillators
        .iter_mut()
        .for_each(|o| o.initial_phase_rad = 1.0);
    let g = Gait::try_from(r).expect("valid");
    let mut state = cpg::start(&g);
    let first = cpg::step(&g, &mut state, CYCLE_S);
    for (q, o) in first.as_slice().iter().zip(g.oscillators()) {
        assert_eq!(*q, o.offset_rad);
    }
    let o = state.oscillators()[0];
    let step = 0.05 * 2.0 * 30f32.to_radians();
    assert!((o.amplitude_rad - step).abs() < 1e-7);
    assert!((o.phase_rad - (1.0 + 0.05 * std::f32::consts::TAU * 0.2)).abs() < 1e-6);
}

#[test]
fn a_locked_network_turns_at_its_frequency() {
    let g = crawl();
    let mut state = cpg::start(&g);
    let mut turned = [0.0f64; 6];
    for _ in 0..6000 {
        let before: Vec<f32> = state.oscillators().iter().map(|o| o.phase_rad).collect();
        cpg::step(&g, &mut state, CYCLE_S);
        for ((t, o), b) in turned.iter_mut().zip(state.oscillators()).zip(before) {
            *t += f64::from(wrap_pi(o.phase_rad - b));
        }
    }
    for t in turned {
        let hz = t / std::f64::consts::TAU / 300.0;
        assert!((hz - 0.2).abs() < 1e-5, "{hz} Hz");
    }
}

#[test]
fn phases_lock_with_the_time_constant_of_the_chain() {
    // Slowest mode of a chain of six: rate w R (2 - 2 cos(pi/6)) = 0.134/s at R = 1 rad, 7.5 s.
    let mut r = raw(
        "lock",
        [57.295_78; 6],
        [0.0; 6],
        [20.0, -40.0, 60.0, 10.0, 0.0],
    );
    let locked: Vec<f32> = r.oscillators.iter().map(|o| o.initial_phase_rad).collect();
    let mode: Vec<f32> = (0..6)
        .map(|k| (std::f32::consts::PI * (k as f32 + 0.5) / 6.0).cos())
        .collect();
    for ((o, l), m) in r.oscillators.iter_mut().zip(&locked).zip(&mode) {
        o.initial_phase_rad = wrap_pi(l + 0.05 * m);
    }
    let g = Gait::try_from(r).expect("valid");
    let mut state = cpg::start(&g);
    let spread = |state: &cpg::CpgState| {
        let p = state.oscillators();
        wrap_pi((p[0].phase_rad - p[5].phase_rad) - (locked[0] - locked[5]))
    };
    let mut at = Vec::new();
    for n in 0..=500 {
        if n % 100 == 0 {
            at.push(spread(&state));
        }
        cpg::step(&g, &mut state, CYCLE_S);
    }
    // From 10 s to 25 s, the amplitudes are settled.
    let rate = f64::from(at[2] / at[5]).ln() / 15.0;
    let want = 0.5 * (2.0 - 2.0 * (std::f64::consts::PI / 6.0).cos());
    assert!(
        (rate / want - 1.0).abs() < 0.02,
        "time constant {} s, want {} s",
        1.0 / rate,
        1.0 / want
    );
}

#[test]
fn any_network_size_runs() {
    for count in [1usize, 2, 12] {
        let mut r = raw("n", [30.0; 6], [0.0; 6], [0.0; 5]);
        let one = r.oscillators[0];
        r.oscillators = (0..count).map(|_| one).collect();
        r.links = control::gait::chain(0.5, &vec![0.7; count - 1]);
        r.lock_phases();
        let g = Gait::try_from(r).expect("valid");
        let mut state = cpg::start(&g);
        for _ in 0..200 {
            assert_eq!(cpg::step(&g, &mut state, CYCLE_S).as_slice().len(), count);
        }
        let lag =
            wrap_pi(state.oscillators()[count - 1].phase_rad - state.oscillators()[0].phase_rad);
        assert!((lag - wrap_pi(0.7 * (count - 1) as f32)).abs() < 1e-4);
    }
    let (six, mut one) = (crawl(), raw("one", [1.0; 6], [0.0; 6], [0.0; 5]));
    one.oscillators.truncate(1);
    one.links.clear();
    let one = Gait::try_from(one).expect("valid");
    assert!(cpg::retarget(&one, &cpg::start(&six)).is_err());
}

/// FNV-1a over the bits of 600 set-points of six joints.
fn hash(g: &Gait) -> u64 {
    let mut state = cpg::start(g);
    let mut h = 0xcbf2_9ce4_8422_2325u64;
    for _ in 0..600 {
        for q in cpg::step(g, &mut state, CYCLE_S).as_slice() {
            for byte in q.to_bits().to_le_bytes() {
                h = (h ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
            }
        }
    }
    h
}

/// Bits of the set-points of five gaits over 30 s. They must be the same on every host, in every build profile and on the MCU: a difference means
/// a contracted multiply-add, another sine or another order of operations.
#[test]
fn golden_bits() {
    let mut unlocked = raw(
        "unlocked",
        [57.0; 6],
        [5.0; 6],
        [30.0, 60.0, 90.0, 120.0, 150.0],
    );
    for (o, phase) in unlocked
        .oscillators
        .iter_mut()
        .zip([0.1, -2.0, 3.0, 1.0, -1.0, 0.5])
    {
        o.initial_phase_rad = phase;
    }
    let gaits = [
        (crawl(), GOLDEN[0]),
        (clash(), GOLDEN[1]),
        (
            gait(
                "wave",
                [60.0, 50.0, 40.0, 30.0, 20.0, 10.0],
                [10.0, -20.0, 30.0, 0.0, 5.0, 90.0],
                [45.0; 5],
            ),
            GOLDEN[2],
        ),
        (Gait::try_from(unlocked).expect("valid"), GOLDEN[3]),
        (
            gait(
                "pose",
                [0.0; 6],
                [120.0, 0.0, -120.0, 0.0, 90.0, 0.0],
                [0.0; 5],
            ),
            GOLDEN[4],
        ),
    ];
    let found: Vec<u64> = gaits.iter().map(|(g, _)| hash(g)).collect();
    let want: Vec<u64> = gaits.iter().map(|(_, h)| *h).collect();
    assert_eq!(found, want, "found {found:#018x?}");
}

const GOLDEN: [u64; 5] = [
    0x4481_be5e_1eda_3824,
    0x52a2_5abd_51c9_cdd1,
    0x1641_c333_8831_fdef,
    0x984e_cc7d_30c6_4222,
    0x1158_e147_d536_d9e5,
];
