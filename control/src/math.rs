//! f32 mathematics of the 20 Hz path: the same bits on every host, no `f64`, no table, no panic.
//!
//! `libm::sinf` reduces and evaluates in f64, which a Cortex-M4F computes in software (2000 instructions a call, 40 000 for an
//! unwrapped phase). These functions take about 30.

/// The f32 nearest to π; it lies 8.7e-8 above π.
pub const PI: f32 = core::f32::consts::PI;
/// The f32 nearest to 2π.
pub const TAU: f32 = core::f32::consts::TAU;

/// Largest error of [`sin`] and [`cos`] against the exact value for |x| <= [`REDUCTION_LIMIT_RAD`] (tested on a dense sweep).
pub const SIN_MAX_ERROR: f32 = 1.2e-7;
/// Largest |x| for which [`sin`], [`cos`] and [`wrap_pi`] reduce with the full error bound. Beyond it one f32 step exceeds 5e-4 rad,
/// the results stay in range and deterministic, but their error grows in proportion to |x|.
pub const REDUCTION_LIMIT_RAD: f32 = 8192.0;

// pi/2 in three parts (Cody and Waite; the split of Cephes' sinf.c times two). The first two have so few bits that a
// multiple up to 2^13 of either is exact in f32.
const HALF_PI_A: f32 = 1.570_312_5;
const HALF_PI_B: f32 = 4.837_513e-4;
const HALF_PI_C: f32 = 7.549_79e-8;
const INV_HALF_PI: f32 = core::f32::consts::FRAC_2_PI;

/// Reduces x to r in about [-π/4, π/4] and the quadrant, so that x = r + quadrant π/2 (modulo 2π).
fn reduce(x: f32) -> (f32, i32) {
    let x = if x.abs() <= REDUCTION_LIMIT_RAD {
        x
    } else {
        libm::fmodf(x, TAU)
    };
    let scaled = x * INV_HALF_PI;
    // `as` saturates and takes NaN to 0; |scaled| < 5300 here, so it is an exact truncation. Half away from zero keeps sin odd.
    let quadrant = (if scaled < 0.0 {
        scaled - 0.5
    } else {
        scaled + 0.5
    }) as i32;
    let k = quadrant as f32;
    (
        ((x - k * HALF_PI_A) - k * HALF_PI_B) - k * HALF_PI_C,
        quadrant,
    )
}

// Minimax polynomials on [-pi/4, pi/4] of Cephes (Moshier, sinf.c), error below 1 unit in the last place.
fn sin_poly(r: f32) -> f32 {
    let z = r * r;
    ((-1.951_529_6e-4 * z + 8.332_161e-3) * z - 1.666_665_5e-1) * z * r + r
}

fn cos_poly(r: f32) -> f32 {
    let z = r * r;
    ((2.443_315_7e-5 * z - 1.388_731_6e-3) * z + 4.166_664_6e-2) * z * z - 0.5 * z + 1.0
}

/// Sine and cosine of x in radians. Error at most [`SIN_MAX_ERROR`] up to [`REDUCTION_LIMIT_RAD`]; NaN for NaN and infinities.
#[must_use]
pub fn sin_cos(x: f32) -> (f32, f32) {
    let (r, quadrant) = reduce(x);
    let (s, c) = (sin_poly(r), cos_poly(r));
    match quadrant & 3 {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

/// Sine of x in radians; odd to the bit (but for the sign of zero). See [`sin_cos`] for the error.
#[must_use]
pub fn sin(x: f32) -> f32 {
    let (r, quadrant) = reduce(x);
    match quadrant & 3 {
        0 => sin_poly(r),
        1 => cos_poly(r),
        2 => -sin_poly(r),
        _ => -cos_poly(r),
    }
}

/// Cosine of x in radians; even to the bit. See [`sin_cos`] for the error.
#[must_use]
pub fn cos(x: f32) -> f32 {
    sin_cos(x).1
}

/// The angle equal to x modulo 2π in [-π, π), with π meaning [`PI`].
///
/// A value already inside is returned unchanged. NaN and infinities give NaN: a lost phase must fail the finite check behind
/// it, not look like zero.
#[must_use]
pub fn wrap_pi(x: f32) -> f32 {
    if (-PI..PI).contains(&x) {
        return x;
    }
    let x = if x.abs() <= REDUCTION_LIMIT_RAD {
        x
    } else {
        libm::fmodf(x, TAU)
    };
    let turns = x / TAU;
    let k = 4.0
        * ((if turns < 0.0 {
            turns - 0.5
        } else {
            turns + 0.5
        }) as i32) as f32;
    let r = ((x - k * HALF_PI_A) - k * HALF_PI_B) - k * HALF_PI_C;
    if r < -PI {
        (r + TAU).min(BELOW_PI)
    } else if r >= PI {
        (r - TAU).max(-PI)
    } else {
        r
    }
}

/// Largest f32 below [`PI`].
const BELOW_PI: f32 = 3.141_592_5;

/// Square root, correctly rounded; NaN below zero.
#[must_use]
pub fn sqrt(x: f32) -> f32 {
    libm::sqrtf(x)
}

/// 1 / sqrt(x) to 2 units in the last place for positive normal x, without division or the soft-float `libm` root; for x = 0 a large
/// finite number, so that `x * inverse_sqrt(x)` is the root there too.
pub(crate) fn inverse_sqrt(x: f32) -> f32 {
    // First guess within 3.5 % by halving the exponent (Lomont 2003), then three Newton steps: 1.8e-3, 4.7e-6, below rounding.
    let half = 0.5 * x;
    let mut y = f32::from_bits(0x5f37_5a86_u32.wrapping_sub(x.to_bits() >> 1));
    for _ in 0..3 {
        y *= 1.5 - half * y * y;
    }
    y
}

#[cfg(test)]
mod tests {
    use super::inverse_sqrt;

    #[test]
    fn inverse_root_is_exact_to_two_units() {
        for bits in (0x0080_0000u32..0x7f00_0000).step_by(4093) {
            let x = f32::from_bits(bits);
            let want = 1.0 / libm::sqrt(f64::from(x));
            let error = (f64::from(inverse_sqrt(x)) - want).abs() / want;
            assert!(error < 2.4e-7, "{x}: {error}");
        }
        assert_eq!(0.0 * inverse_sqrt(0.0), 0.0);
    }
}
