//! Eight double-precision numbers side by side, on whatever registers the processor has.
//!
//! One rounding rule holds for every implementation: each `+ - * /` and square root is one IEEE operation, rounded to nearest; none
//! is fused, reordered or approximated. So a lane gives the same bits on SSE2, AVX2 and AVX-512.
//!
//! Every method is `#[inline(always)]`: the values must vanish into a function compiled for their instruction set.

#[cfg(target_arch = "x86_64")]
pub(super) mod x86;

use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

use physics::laws::Arithmetic;
use wide::f64x8;

/// Parameter sets simulated at once.
pub(in crate::joint) const LANES: usize = 8;

/// Eight numbers in memory.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(in crate::joint) struct Eight(pub(in crate::joint) [f64; LANES]);

impl Eight {
    /// The same number in every lane.
    #[inline(always)]
    pub(in crate::joint) const fn splat(x: f64) -> Self {
        Self([x; LANES])
    }
}

/// Numbers in registers.
pub(in crate::joint) trait Lane:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
{
    /// A truth value per lane.
    type Mask: Copy;

    fn splat(x: f64) -> Self;
    fn of(x: Eight) -> Self;
    fn put(self) -> Eight;
    fn abs(self) -> Self;
    fn sqrt(self) -> Self;
    /// `if self < other { self } else { other }`.
    fn min(self, other: Self) -> Self;
    /// `if self > other { self } else { other }`.
    fn max(self, other: Self) -> Self;
    fn lt(self, other: Self) -> Self::Mask;
    fn le(self, other: Self) -> Self::Mask;
    fn ne(self, other: Self) -> Self::Mask;
    /// `if mask { yes } else { no }`.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// Whether any lane is true.
    fn any(mask: Self::Mask) -> bool;

    #[inline(always)]
    fn zero() -> Self {
        Self::splat(0.0)
    }
    #[inline(always)]
    fn one() -> Self {
        Self::splat(1.0)
    }
    #[inline(always)]
    fn gt(self, other: Self) -> Self::Mask {
        other.lt(self)
    }
    /// Between `low` and `high`; `low <= high`.
    #[inline(always)]
    fn clamp(self, low: Self, high: Self) -> Self {
        self.max(low).min(high)
    }
    /// -1 below zero, else 1.
    #[inline(always)]
    fn sign(self) -> Self {
        Self::select(self.lt(Self::zero()), -Self::one(), Self::one())
    }
}

/// Lanes as the numbers of a shared law.
pub(super) struct Lanes<F>(std::marker::PhantomData<F>);

impl<F: Lane> Arithmetic for Lanes<F> {
    type Number = F;
    #[inline(always)]
    fn number(value: f64) -> F {
        F::splat(value)
    }
    #[inline(always)]
    fn least(a: F, b: F) -> F {
        a.min(b)
    }
    #[inline(always)]
    fn most(a: F, b: F) -> F {
        a.max(b)
    }
}

/// What every processor has: registers as the compiler's baseline allows.
impl Lane for f64x8 {
    type Mask = Self;
    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self::splat(x)
    }
    #[inline(always)]
    fn of(x: Eight) -> Self {
        Self::from(x.0)
    }
    #[inline(always)]
    fn put(self) -> Eight {
        Eight(self.to_array())
    }
    #[inline(always)]
    fn abs(self) -> Self {
        self.abs()
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.simd_lt(other).select(self, other)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.simd_gt(other).select(self, other)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Self {
        self.simd_lt(other)
    }
    #[inline(always)]
    fn le(self, other: Self) -> Self {
        self.simd_le(other)
    }
    #[inline(always)]
    fn ne(self, other: Self) -> Self {
        self.simd_ne(other)
    }
    #[inline(always)]
    fn select(mask: Self, yes: Self, no: Self) -> Self {
        mask.select(yes, no)
    }
    #[inline(always)]
    fn any(mask: Self) -> bool {
        mask.any()
    }
}
