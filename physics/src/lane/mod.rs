//! The number type the engine is written over: one trial per lane.
//!
//! One rounding rule holds for every lane type of the same precision: each `+ - * /` and square root is one IEEE operation, rounded to
//! nearest; no operation is fused, reordered or approximated; `min`, `max` and `select` follow the exact rules below. So a trial gives
//! the same bits as scalar `f32`, in 4 SSE2, 8 AVX2 or 16 AVX-512 lanes, and whatever its neighbours do. Scalar `f64` runs the
//! same source as a reference.
//!
//! Every method is `#[inline(always)]`: the vector types must vanish into a function compiled for their instruction set.

mod scalar;
#[cfg(target_arch = "x86_64")]
mod x86;

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{F32x4, F32x8, F32x16};

use crate::laws::Arithmetic;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// A truth value per lane.
pub(crate) trait Mask: Copy {
    fn and(self, other: Self) -> Self;
    fn or(self, other: Self) -> Self;
    fn not(self) -> Self;
    /// Whether any lane is true.
    fn any(self) -> bool;
}

/// A number per lane.
pub(crate) trait Lane:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
{
    type Mask: Mask;
    /// Number of lanes.
    const N: usize;

    fn splat(value: f64) -> Self;
    fn get(self, lane: usize) -> f64;
    fn set(&mut self, lane: usize, value: f64);
    fn sqrt(self) -> Self;
    fn abs(self) -> Self;
    /// `if self < other { self } else { other }`.
    fn min(self, other: Self) -> Self;
    /// `if self > other { self } else { other }`.
    fn max(self, other: Self) -> Self;
    fn lt(self, other: Self) -> Self::Mask;
    fn gt(self, other: Self) -> Self::Mask;
    /// `if mask { self } else { other }`.
    fn or_else(self, mask: Self::Mask, other: Self) -> Self;
    /// Sine and cosine, absolute error below 1e-7 (f32, |x| < 1e3 rad) or full precision (f64).
    fn sin_cos(self) -> (Self, Self);

    #[inline(always)]
    fn zero() -> Self {
        Self::splat(0.0)
    }
    #[inline(always)]
    fn one() -> Self {
        Self::splat(1.0)
    }
    #[inline(always)]
    fn clamp(self, low: Self, high: Self) -> Self {
        self.max(low).min(high)
    }
    /// The value where the mask is true, zero elsewhere.
    #[inline(always)]
    fn only(self, mask: Self::Mask) -> Self {
        self.or_else(mask, Self::zero())
    }
    /// True in no lane.
    #[inline(always)]
    fn never() -> Self::Mask {
        Self::zero().lt(Self::zero())
    }
}

/// Lanes as the numbers of a shared law.
pub(crate) struct Lanes<L>(std::marker::PhantomData<L>);

impl<L: Lane> Arithmetic for Lanes<L> {
    type Number = L;
    #[inline(always)]
    fn number(value: f64) -> L {
        L::splat(value)
    }
    #[inline(always)]
    fn least(a: L, b: L) -> L {
        a.min(b)
    }
    #[inline(always)]
    fn most(a: L, b: L) -> L {
        a.max(b)
    }
}

/// Sine and cosine in single precision: reduction by multiples of π/2 in three parts (Cody and Waite, parts of Cephes `sinf.c`), then the
/// Cephes polynomials on ±π/4. `round` adds and subtracts 1.5 * 2^23, exact for |x| < 2^22.
#[inline(always)]
pub(crate) fn sin_cos_f32<L: Lane>(x: L) -> (L, L) {
    let magic = L::splat(12_582_912.0);
    let k = (x * L::splat(std::f64::consts::FRAC_2_PI) + magic) - magic;
    let r = ((x - k * L::splat(1.570_312_5)) - k * L::splat(4.837_512_969_970_703e-4))
        - k * L::splat(7.549_789_948_768_648e-8);
    let z = r * r;
    let s = ((L::splat(-1.951_529_589_1e-4) * z + L::splat(8.332_160_873_6e-3)) * z
        + L::splat(-1.666_665_461_1e-1))
        * z
        * r
        + r;
    let c = ((L::splat(2.443_315_711_809_948e-5) * z + L::splat(-1.388_731_625_493_765e-3)) * z
        + L::splat(4.166_664_568_298_827e-2))
        * z
        * z
        - L::splat(0.5) * z
        + L::one();
    // Quadrant k mod 4, in 0..4: k - 4 floor(k / 4); floor by rounding (k / 4 - 3/8), exact because k / 4 is a multiple of 1/4.
    let q = k - L::splat(4.0) * ((k * L::splat(0.25) - L::splat(0.375) + magic) - magic);
    let half = L::splat(0.5);
    let odd = (q - L::one())
        .abs()
        .lt(half)
        .or((q - L::splat(3.0)).abs().lt(half));
    let sin_negative = q.gt(L::splat(1.5));
    let cos_negative = (q - L::splat(1.5)).abs().lt(L::one());
    let sin = c.or_else(odd, s);
    let cos = s.or_else(odd, c);
    (
        (-sin).or_else(sin_negative, sin),
        (-cos).or_else(cos_negative, cos),
    )
}

#[cfg(test)]
mod tests;
