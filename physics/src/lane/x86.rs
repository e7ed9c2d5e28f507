//! 4, 8 and 16 single-precision lanes on x86-64.
//!
//! Safety of the whole module: SSE2 is part of x86-64. The 8- and 16-lane types call AVX, AVX2 and AVX-512F instructions; their values
//! are created only inside the engine functions of `dispatch`, which run after the processor was asked for these features.
#![allow(unsafe_code)]

use super::{Lane, Mask, sin_cos_f32};
use core::arch::x86_64::*;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

macro_rules! operators {
    ($t:ident, $add:ident, $sub:ident, $mul:ident, $div:ident) => {
        impl Add for $t {
            type Output = Self;
            #[inline(always)]
            fn add(self, other: Self) -> Self {
                // SAFETY: see the module.
                $t(unsafe { $add(self.0, other.0) })
            }
        }
        impl Sub for $t {
            type Output = Self;
            #[inline(always)]
            fn sub(self, other: Self) -> Self {
                // SAFETY: see the module.
                $t(unsafe { $sub(self.0, other.0) })
            }
        }
        impl Mul for $t {
            type Output = Self;
            #[inline(always)]
            fn mul(self, other: Self) -> Self {
                // SAFETY: see the module.
                $t(unsafe { $mul(self.0, other.0) })
            }
        }
        impl Div for $t {
            type Output = Self;
            #[inline(always)]
            fn div(self, other: Self) -> Self {
                // SAFETY: see the module.
                $t(unsafe { $div(self.0, other.0) })
            }
        }
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
    };
}

macro_rules! lane_access {
    ($n:expr, $v:ty) => {
        const N: usize = $n;
        #[inline(always)]
        fn get(self, lane: usize) -> f64 {
            // SAFETY: a vector of $n f32 has the size and at least the alignment of an array of them.
            let array: [f32; $n] = unsafe { core::mem::transmute::<$v, [f32; $n]>(self.0) };
            f64::from(array[lane])
        }
        #[inline(always)]
        fn set(&mut self, lane: usize, value: f64) {
            // SAFETY: as above, both ways.
            let mut array: [f32; $n] = unsafe { core::mem::transmute::<$v, [f32; $n]>(self.0) };
            array[lane] = value as f32;
            // SAFETY: as above.
            self.0 = unsafe { core::mem::transmute::<[f32; $n], $v>(array) };
        }
        #[inline(always)]
        fn sin_cos(self) -> (Self, Self) {
            sin_cos_f32(self)
        }
    };
}

/// Four lanes, SSE2: the baseline of x86-64.
#[derive(Clone, Copy)]
pub(crate) struct F32x4(__m128);
#[derive(Clone, Copy)]
pub(crate) struct M4(__m128);
operators!(F32x4, _mm_add_ps, _mm_sub_ps, _mm_mul_ps, _mm_div_ps);

impl Neg for F32x4 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // SAFETY: see the module.
        F32x4(unsafe { _mm_xor_ps(self.0, _mm_set1_ps(-0.0)) })
    }
}

impl Mask for M4 {
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        // SAFETY: see the module.
        M4(unsafe { _mm_and_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        // SAFETY: see the module.
        M4(unsafe { _mm_or_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn not(self) -> Self {
        // SAFETY: see the module.
        M4(unsafe { _mm_xor_ps(self.0, _mm_castsi128_ps(_mm_set1_epi32(-1))) })
    }
    #[inline(always)]
    fn any(self) -> bool {
        // SAFETY: see the module.
        unsafe { _mm_movemask_ps(self.0) != 0 }
    }
}

impl Lane for F32x4 {
    type Mask = M4;
    lane_access!(4, __m128);
    #[inline(always)]
    fn splat(value: f64) -> Self {
        // SAFETY: see the module.
        F32x4(unsafe { _mm_set1_ps(value as f32) })
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: see the module.
        F32x4(unsafe { _mm_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        // SAFETY: see the module.
        F32x4(unsafe { _mm_andnot_ps(_mm_set1_ps(-0.0), self.0) })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: see the module. `minps` returns its second operand unless the first is smaller.
        F32x4(unsafe { _mm_min_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: see the module. `maxps` returns its second operand unless the first is larger.
        F32x4(unsafe { _mm_max_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn lt(self, other: Self) -> M4 {
        // SAFETY: see the module.
        M4(unsafe { _mm_cmplt_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn gt(self, other: Self) -> M4 {
        // SAFETY: see the module.
        M4(unsafe { _mm_cmpgt_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn or_else(self, mask: M4, other: Self) -> Self {
        // SAFETY: see the module.
        F32x4(unsafe { _mm_or_ps(_mm_and_ps(mask.0, self.0), _mm_andnot_ps(mask.0, other.0)) })
    }
}

/// Eight lanes, AVX2.
#[derive(Clone, Copy)]
pub(crate) struct F32x8(__m256);
#[derive(Clone, Copy)]
pub(crate) struct M8(__m256);
operators!(
    F32x8,
    _mm256_add_ps,
    _mm256_sub_ps,
    _mm256_mul_ps,
    _mm256_div_ps
);

impl Neg for F32x8 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // SAFETY: see the module.
        F32x8(unsafe { _mm256_xor_ps(self.0, _mm256_set1_ps(-0.0)) })
    }
}

impl Mask for M8 {
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        // SAFETY: see the module.
        M8(unsafe { _mm256_and_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        // SAFETY: see the module.
        M8(unsafe { _mm256_or_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn not(self) -> Self {
        // SAFETY: see the module.
        M8(unsafe { _mm256_xor_ps(self.0, _mm256_castsi256_ps(_mm256_set1_epi32(-1))) })
    }
    #[inline(always)]
    fn any(self) -> bool {
        // SAFETY: see the module.
        unsafe { _mm256_movemask_ps(self.0) != 0 }
    }
}

impl Lane for F32x8 {
    type Mask = M8;
    lane_access!(8, __m256);
    #[inline(always)]
    fn splat(value: f64) -> Self {
        // SAFETY: see the module.
        F32x8(unsafe { _mm256_set1_ps(value as f32) })
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: see the module.
        F32x8(unsafe { _mm256_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        // SAFETY: see the module.
        F32x8(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: see the module. `vminps` returns its second operand unless the first is smaller.
        F32x8(unsafe { _mm256_min_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: see the module. `vmaxps` returns its second operand unless the first is larger.
        F32x8(unsafe { _mm256_max_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn lt(self, other: Self) -> M8 {
        // SAFETY: see the module.
        M8(unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) })
    }
    #[inline(always)]
    fn gt(self, other: Self) -> M8 {
        // SAFETY: see the module.
        M8(unsafe { _mm256_cmp_ps::<_CMP_GT_OQ>(self.0, other.0) })
    }
    #[inline(always)]
    fn or_else(self, mask: M8, other: Self) -> Self {
        // SAFETY: see the module.
        F32x8(unsafe { _mm256_blendv_ps(other.0, self.0, mask.0) })
    }
}

/// Sixteen lanes, AVX-512F.
#[derive(Clone, Copy)]
pub(crate) struct F32x16(__m512);
#[derive(Clone, Copy)]
pub(crate) struct M16(__mmask16);
operators!(
    F32x16,
    _mm512_add_ps,
    _mm512_sub_ps,
    _mm512_mul_ps,
    _mm512_div_ps
);

impl Neg for F32x16 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // SAFETY: see the module.
        F32x16(unsafe {
            _mm512_castsi512_ps(_mm512_xor_si512(
                _mm512_castps_si512(self.0),
                _mm512_set1_epi32(i32::MIN),
            ))
        })
    }
}

impl Mask for M16 {
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        M16(self.0 & other.0)
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        M16(self.0 | other.0)
    }
    #[inline(always)]
    fn not(self) -> Self {
        M16(!self.0)
    }
    #[inline(always)]
    fn any(self) -> bool {
        self.0 != 0
    }
}

impl Lane for F32x16 {
    type Mask = M16;
    lane_access!(16, __m512);
    #[inline(always)]
    fn splat(value: f64) -> Self {
        // SAFETY: see the module.
        F32x16(unsafe { _mm512_set1_ps(value as f32) })
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: see the module.
        F32x16(unsafe { _mm512_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        // SAFETY: see the module.
        F32x16(unsafe { _mm512_abs_ps(self.0) })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: see the module. `vminps` returns its second operand unless the first is smaller.
        F32x16(unsafe { _mm512_min_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: see the module. `vmaxps` returns its second operand unless the first is larger.
        F32x16(unsafe { _mm512_max_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn lt(self, other: Self) -> M16 {
        // SAFETY: see the module.
        M16(unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) })
    }
    #[inline(always)]
    fn gt(self, other: Self) -> M16 {
        // SAFETY: see the module.
        M16(unsafe { _mm512_cmp_ps_mask::<_CMP_GT_OQ>(self.0, other.0) })
    }
    #[inline(always)]
    fn or_else(self, mask: M16, other: Self) -> Self {
        // SAFETY: see the module.
        F32x16(unsafe { _mm512_mask_blend_ps(mask.0, other.0, self.0) })
    }
}
