//! Own f32 functions against libm's f64.

use control::math::{PI, REDUCTION_LIMIT_RAD, SIN_MAX_ERROR, cos, sin, sin_cos, sqrt, wrap_pi};

fn errors(x: f32) -> f64 {
    let x64 = f64::from(x);
    let s = (f64::from(sin(x)) - libm::sin(x64)).abs();
    let c = (f64::from(cos(x)) - libm::cos(x64)).abs();
    s.max(c)
}

#[test]
fn sine_and_cosine_stay_within_the_documented_error() {
    let mut worst = (0.0, 0.0);
    let mut take = |x: f32| {
        let e = errors(x);
        if e > worst.0 {
            worst = (e, x);
        }
    };
    // Every 97th f32 up to the limit, both signs: 1.6 million points from 1e-3 on, finer near zero.
    let (first, last) = (1e-3f32.to_bits(), REDUCTION_LIMIT_RAD.to_bits());
    for bits in (first..=last).step_by(97) {
        take(f32::from_bits(bits));
    }
    // The range of a wrapped phase difference, densely.
    for k in -1_000_000..=1_000_000 {
        take(k as f32 * 1e-5);
    }
    assert!(
        worst.0 <= f64::from(SIN_MAX_ERROR),
        "error {} at {}",
        worst.0,
        worst.1
    );
    assert!(
        worst.0 > 0.4 * f64::from(SIN_MAX_ERROR),
        "the documented bound is loose: {}",
        worst.0
    );
}

#[test]
fn symmetry_holds_to_the_bit() {
    for k in 1..100_000 {
        let x = k as f32 * 0.0173;
        assert_eq!(sin(-x).to_bits(), (-sin(x)).to_bits());
        assert_eq!(cos(-x).to_bits(), cos(x).to_bits());
        assert_eq!((sin(x), cos(x)), sin_cos(x));
    }
}

#[test]
fn large_and_strange_inputs_stay_in_range() {
    for x in [
        1e5,
        -1e7,
        3e20,
        f32::MAX,
        f32::MIN,
        f32::MIN_POSITIVE,
        1e-45,
        -0.0,
    ] {
        assert!(sin(x).abs() <= 1.0 && cos(x).abs() <= 1.0, "{x}");
        assert!((-PI..PI).contains(&wrap_pi(x)), "{x}");
    }
    for x in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert!(sin(x).is_nan() && cos(x).is_nan() && wrap_pi(x).is_nan());
    }
}

#[test]
fn every_float_wraps_into_the_half_open_interval() {
    for bits in (0..=u32::MAX).step_by(1021) {
        let x = f32::from_bits(bits);
        let w = wrap_pi(x);
        assert!(w.is_nan() != x.is_finite(), "{x} -> {w}");
        assert!(w.is_nan() || (-PI..PI).contains(&w), "{x} -> {w}");
        if (-PI..PI).contains(&x) {
            assert_eq!(w.to_bits(), x.to_bits());
        }
    }
    for k in -1000..=1000i32 {
        for around in [-1e-3f32, 0.0, 1e-3] {
            let x = (f64::from(k) * std::f64::consts::PI) as f32 + around;
            let turns = f64::from(x) - f64::from(wrap_pi(x));
            let whole = (turns / std::f64::consts::TAU).round() * std::f64::consts::TAU;
            assert!((turns - whole).abs() < 1e-6, "{x}");
        }
    }
    assert_eq!(
        wrap_pi(PI),
        -3.141_592_5,
        "the f32 PI lies above π, so PI - 2π lies above -PI"
    );
    assert_eq!(wrap_pi(-PI), -PI);
}

#[test]
fn the_root_is_correctly_rounded() {
    for bits in (0..0x7f80_0000u32).step_by(4099) {
        let x = f32::from_bits(bits);
        assert_eq!(sqrt(x), x.sqrt());
    }
    assert!(sqrt(-1.0).is_nan());
}
