//! Eight lanes in two AVX or one AVX-512 register.
//!
//! Safety of the whole module: the values are created only inside the functions of [`super::super::dispatch`] that are compiled for
//! these instruction sets, which run after the processor was asked for them.
#![allow(unsafe_code)]

use core::arch::x86_64::*;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

use super::{Eight, Lane};

macro_rules! operators {
    ($t:ident, |$a:ident, $b:ident| $add:expr, $sub:expr, $mul:expr, $div:expr) => {
        operators!(one $t, Add, add, |$a, $b| $add);
        operators!(one $t, Sub, sub, |$a, $b| $sub);
        operators!(one $t, Mul, mul, |$a, $b| $mul);
        operators!(one $t, Div, div, |$a, $b| $div);
        impl AddAssign for $t {
            #[inline(always)]
            fn add_assign(&mut self, other: Self) {
                *self = *self + other;
            }
        }
        impl SubAssign for $t {
            #[inline(always)]
            fn sub_assign(&mut self, other: Self) {
                *self = *self - other;
            }
        }
        impl MulAssign for $t {
            #[inline(always)]
            fn mul_assign(&mut self, other: Self) {
                *self = *self * other;
            }
        }
    };
    (one $t:ident, $trait:ident, $name:ident, |$a:ident, $b:ident| $op:expr) => {
        impl $trait for $t {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                let ($a, $b) = (self.0, other.0);
                // SAFETY: see the module.
                Self(unsafe { $op })
            }
        }
    };
}

/// Two registers of four lanes.
#[derive(Clone, Copy)]
pub(in crate::joint) struct Avx2([__m256d; 2]);

operators!(
    Avx2,
    |a, b| [_mm256_add_pd(a[0], b[0]), _mm256_add_pd(a[1], b[1])],
    [_mm256_sub_pd(a[0], b[0]), _mm256_sub_pd(a[1], b[1])],
    [_mm256_mul_pd(a[0], b[0]), _mm256_mul_pd(a[1], b[1])],
    [_mm256_div_pd(a[0], b[0]), _mm256_div_pd(a[1], b[1])]
);

impl Neg for Avx2 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // SAFETY: see the module.
        let flip = |x| unsafe { _mm256_xor_pd(x, _mm256_set1_pd(-0.0)) };
        Self([flip(self.0[0]), flip(self.0[1])])
    }
}

macro_rules! both {
    (|$a:ident, $b:ident| $op:expr) => {
        |x: [__m256d; 2], y: [__m256d; 2]| {
            let one = |$a: __m256d, $b: __m256d| {
                // SAFETY: see the module.
                unsafe { $op }
            };
            [one(x[0], y[0]), one(x[1], y[1])]
        }
    };
}

impl Lane for Avx2 {
    type Mask = [__m256d; 2];
    #[inline(always)]
    fn splat(x: f64) -> Self {
        // SAFETY: see the module.
        Self([unsafe { _mm256_set1_pd(x) }; 2])
    }
    #[inline(always)]
    fn of(x: Eight) -> Self {
        // SAFETY: see the module; eight numbers fill two registers.
        Self(unsafe {
            [
                _mm256_loadu_pd(x.0.as_ptr()),
                _mm256_loadu_pd(x.0[4..].as_ptr()),
            ]
        })
    }
    #[inline(always)]
    fn put(self) -> Eight {
        // SAFETY: two registers hold eight numbers without padding.
        Eight(unsafe { core::mem::transmute::<[__m256d; 2], [f64; 8]>(self.0) })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(both!(|a, b| _mm256_andnot_pd(b, a))(
            self.0,
            Self::splat(-0.0).0,
        ))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: see the module.
        Self(unsafe { [_mm256_sqrt_pd(self.0[0]), _mm256_sqrt_pd(self.0[1])] })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // `vminpd` returns its second operand unless the first is smaller.
        Self(both!(|a, b| _mm256_min_pd(a, b))(self.0, other.0))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // `vmaxpd` returns its second operand unless the first is larger.
        Self(both!(|a, b| _mm256_max_pd(a, b))(self.0, other.0))
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Self::Mask {
        both!(|a, b| _mm256_cmp_pd::<_CMP_LT_OQ>(a, b))(self.0, other.0)
    }
    #[inline(always)]
    fn le(self, other: Self) -> Self::Mask {
        both!(|a, b| _mm256_cmp_pd::<_CMP_LE_OQ>(a, b))(self.0, other.0)
    }
    #[inline(always)]
    fn ne(self, other: Self) -> Self::Mask {
        both!(|a, b| _mm256_cmp_pd::<_CMP_NEQ_UQ>(a, b))(self.0, other.0)
    }
    #[inline(always)]
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self {
        // SAFETY: see the module.
        let one = |k: usize| unsafe { _mm256_blendv_pd(no.0[k], yes.0[k], mask[k]) };
        Self([one(0), one(1)])
    }
    #[inline(always)]
    fn any(mask: Self::Mask) -> bool {
        // SAFETY: see the module.
        unsafe { _mm256_movemask_pd(_mm256_or_pd(mask[0], mask[1])) != 0 }
    }
}

/// One register of eight lanes.
#[derive(Clone, Copy)]
pub(in crate::joint) struct Avx512(__m512d);

operators!(
    Avx512,
    |a, b| _mm512_add_pd(a, b),
    _mm512_sub_pd(a, b),
    _mm512_mul_pd(a, b),
    _mm512_div_pd(a, b)
);

impl Neg for Avx512 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // SAFETY: see the module.
        Self(unsafe {
            _mm512_castsi512_pd(_mm512_xor_si512(
                _mm512_castpd_si512(self.0),
                _mm512_set1_epi64(i64::MIN),
            ))
        })
    }
}

impl Lane for Avx512 {
    type Mask = __mmask8;
    #[inline(always)]
    fn splat(x: f64) -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm512_set1_pd(x) })
    }
    #[inline(always)]
    fn of(x: Eight) -> Self {
        // SAFETY: see the module; eight numbers fill the register.
        Self(unsafe { _mm512_loadu_pd(x.0.as_ptr()) })
    }
    #[inline(always)]
    fn put(self) -> Eight {
        // SAFETY: the register holds eight numbers without padding.
        Eight(unsafe { core::mem::transmute::<__m512d, [f64; 8]>(self.0) })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm512_abs_pd(self.0) })
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm512_sqrt_pd(self.0) })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: see the module. `vminpd` returns its second operand unless the first is smaller.
        Self(unsafe { _mm512_min_pd(self.0, other.0) })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: see the module. `vmaxpd` returns its second operand unless the first is larger.
        Self(unsafe { _mm512_max_pd(self.0, other.0) })
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Self::Mask {
        // SAFETY: see the module.
        unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn le(self, other: Self) -> Self::Mask {
        // SAFETY: see the module.
        unsafe { _mm512_cmp_pd_mask::<_CMP_LE_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn ne(self, other: Self) -> Self::Mask {
        // SAFETY: see the module.
        unsafe { _mm512_cmp_pd_mask::<_CMP_NEQ_UQ>(self.0, other.0) }
    }
    #[inline(always)]
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm512_mask_blend_pd(mask, no.0, yes.0) })
    }
    #[inline(always)]
    fn any(mask: Self::Mask) -> bool {
        mask != 0
    }
}
