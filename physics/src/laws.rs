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
    fn far_out_nothing_is_left() {
        for ratio in [7.0, 1e3, 1e30] {
            let left = stribeck::<Scalar>(1.0, ratio);
            assert!((0.0..1e-15).contains(&left), "{left}");
        }
        assert_eq!(stribeck::<Scalar>(0.3, 0.0), 0.3);
    }
}
