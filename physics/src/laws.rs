//! Laws of a joint that the simulator and the diagnosis share, generic over the number type: one trial or many side by side.

use std::ops::{Add, Div, Mul, Sub};

/// What a law asks of its numbers beside `+ - * /`. Implemented by a marker, so that any crate can bring any number type.
pub trait Arithmetic {
    /// The number: a scalar or lanes.
    type Number: Copy
        + Add<Output = Self::Number>
        + Sub<Output = Self::Number>
        + Mul<Output = Self::Number>
        + Div<Output = Self::Number>;

    /// A constant in every lane.
    fn number(value: f64) -> Self::Number;
    /// `if a < b { a } else { b }` in every lane.
    fn least(a: Self::Number, b: Self::Number) -> Self::Number;
    /// `if a > b { a } else { b }` in every lane.
    fn most(a: Self::Number, b: Self::Number) -> Self::Number;
}

/// Double precision, one trial.
#[derive(Clone, Copy, Debug)]
pub struct Scalar;

impl Arithmetic for Scalar {
    type Number = f64;
    #[inline(always)]
    fn number(value: f64) -> f64 {
        value
    }
    #[inline(always)]
    fn least(a: f64, b: f64) -> f64 {
        if a < b { a } else { b }
    }
    #[inline(always)]
    fn most(a: f64, b: f64) -> f64 {
        if a > b { a } else { b }
    }
}

/// `exp(-x)` for `x >= 0`: the series of `exp(x / 16)`, turned over and squared four times. Absolute error below 1e-6, always
/// between 0 and 1; beyond x = 48 that of 48 (1e-21).
#[inline(always)]
pub fn decay<A: Arithmetic>(x: A::Number) -> A::Number {
    let z = A::least(x, A::number(48.0)) * A::number(1.0 / 16.0);
    let mut p = A::number(1.0 / 120.0);
    for c in [1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        p = A::number(c) + z * p;
    }
    let mut e = A::number(1.0) / p;
    for _ in 0..4 {
        e = e * e;
    }
    e
}

/// `stribeck_friction`: friction above Coulomb's, `static_nm exp(-(v / vs)^2)`, N m (Bo and Pavelescu, Wear 82, 1982, with the
/// exponent 2 of Armstrong-Helouvry, "Control of Machines with Friction", 1991). `ratio` is `v / vs`, the speed over `velocity_rad_s`, of either sign.
#[inline(always)]
pub fn stribeck<A: Arithmetic>(static_nm: A::Number, ratio: A::Number) -> A::Number {
    static_nm * decay::<A>(ratio * ratio)
}

/// `deadband`: the error that a controller acts on, `e` less what of it lies within `half_width` of zero. Continuous at the edge.
#[inline(always)]
pub fn dead_zone<A: Arithmetic>(error: A::Number, half_width: A::Number) -> A::Number {
    let low = A::number(0.0) - half_width;
    error - A::least(A::most(error, low), half_width)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lane::Lanes;

    #[test]
    fn the_bell_is_the_closed_form_in_either_precision() {
        for k in 0..200 {
            let ratio = -4.0 + 0.04 * f64::from(k);
            let exact = 0.7 * libm::exp(-ratio * ratio);
            let double = stribeck::<Scalar>(0.7, ratio);
            let single = stribeck::<Lanes<f32>>(0.7, ratio as f32);
            assert!((double - exact).abs() < 1e-6, "{ratio}: {double} {exact}");
            let single = f64::from(single);
            assert!((single - exact).abs() < 2e-6, "{ratio}: {single} {exact}");
        }
    }

    #[test]
    fn small_errors_count_as_none_and_large_ones_less() {
        for (error, left) in [
            (0.0, 0.0),
            (0.1, 0.0),
            (-0.25, 0.0),
            (0.75, 0.5),
            (-1.0, -0.75),
        ] {
            assert_eq!(dead_zone::<Scalar>(error, 0.25), left, "{error}");
            assert_eq!(dead_zone::<Lanes<f32>>(error as f32, 0.25), left as f32);
            assert_eq!(dead_zone::<Scalar>(error, 0.0), error, "off");
        }
    }

    #[test]
    fn far_out_nothing_is_left() {
        for ratio in [7.0, 1e3, 1e30] {
            let left = stribeck::<Scalar>(1.0, ratio);
            assert!((0.0..1e-15).contains(&left), "{left}");
        }
        assert_eq!(stribeck::<Scalar>(0.3, 0.0), 0.3);
    }
}
