//! Integer units of both wires, and the conversions between them and SI.
//!
//! The packed feedback block on the bus and the telemetry on the host link use the same units, so firmware copies, never converts.

/// Radians per count of every angle: 1 micro-radian. Ours; 1534 times finer than the X-series count.
pub const RAD_PER_ANGLE_COUNT: f64 = 1.0e-6;
/// Radians per second per count of velocity: 0.5 mrad/s, so an `i16` spans +-16.4 rad/s, 5.9 times the faster motor's no-load speed (2.786 rad/s, paper Table I).
pub const RAD_S_PER_VELOCITY_COUNT: f64 = 5.0e-4;
/// Ampere per count of current: 1 mA.
pub const A_PER_CURRENT_COUNT: f64 = 1.0e-3;
/// Duty (-1..1 of bus voltage) per count.
pub const DUTY_PER_COUNT: f64 = 1.0 / 2000.0;
/// Volt per count of bus voltage: 5 mV.
pub const V_PER_VOLTAGE_COUNT: f64 = 5.0e-3;
/// Microseconds per count of a driver's tick. The 16-bit tick wraps every 262.144 ms.
pub const US_PER_TICK: u32 = 4;
/// Largest magnitude of an angle on the wire: 2^27 - 1 micro-radians, 21.3 turns. The packed block carries 28 bits.
pub const MAX_ANGLE_URAD: i32 = (1 << 27) - 1;

/// X-series: counts of position per turn (0.087891 deg each), Robotis e-manual XM430, register 132.
pub const X_COUNTS_PER_TURN: i32 = 4096;
/// X-series: radians per second per count of velocity (0.229 rpm), register 128.
pub const X_RAD_S_PER_VELOCITY_COUNT: f64 = 0.229 * 2.0 * core::f64::consts::PI / 60.0;
/// X-series: PWM counts at duty 1 (0.113 % each), register 124.
pub const X_PWM_FULL: i32 = 885;
/// X-series: milliampere per 100 counts of current (2.69 mA each), register 126.
pub const X_MA_PER_100_CURRENT_COUNTS: i32 = 269;

/// Micro-radians of one turn, rounded (2 pi 1e6 = 6283185.307).
const URAD_PER_TURN: i64 = 6_283_185;

/// Radians to wire counts, rounded half away from zero. `None` when not finite or beyond [`MAX_ANGLE_URAD`]: such a number must never reach a motor.
#[must_use]
pub fn urad_from_rad(angle_rad: f32) -> Option<i32> {
    let scaled = angle_rad * 1.0e6;
    let rounded = if scaled < 0.0 {
        scaled - 0.5
    } else {
        scaled + 0.5
    };
    // 134_217_727 rounds up to 2^27 as f32, hence the strict comparison. NaN fails it.
    if rounded.abs() < MAX_ANGLE_URAD as f32 {
        Some(rounded as i32)
    } else {
        None
    }
}

/// Wire counts to radians.
#[must_use]
pub fn rad_from_urad(angle_urad: i32) -> f32 {
    angle_urad as f32 * 1.0e-6
}

/// Wire counts to radians per second.
#[must_use]
pub fn rad_s_from_velocity(counts: i16) -> f32 {
    f32::from(counts) * 5.0e-4
}

/// Radians per second to wire counts, saturating; NaN gives 0.
#[must_use]
pub fn velocity_from_rad_s(velocity_rad_s: f32) -> i16 {
    round_i16(velocity_rad_s * 2000.0)
}

/// Wire counts to ampere.
#[must_use]
pub fn a_from_current(counts: i16) -> f32 {
    f32::from(counts) * 1.0e-3
}

/// Ampere to wire counts, saturating; NaN gives 0.
#[must_use]
pub fn current_from_a(current_a: f32) -> i16 {
    round_i16(current_a * 1000.0)
}

/// Wire counts to duty, -1..1.
#[must_use]
pub fn duty_from_counts(counts: i16) -> f32 {
    f32::from(counts) * (1.0 / 2000.0)
}

/// Duty, -1..1, to wire counts, saturating; NaN gives 0.
#[must_use]
pub fn counts_from_duty(duty: f32) -> i16 {
    round_i16(duty * 2000.0)
}

/// Wire counts to volt.
#[must_use]
pub fn v_from_voltage(counts: u16) -> f32 {
    f32::from(counts) * 5.0e-3
}

/// Volt to wire counts, saturating; NaN gives 0.
#[must_use]
pub fn voltage_from_v(voltage_v: f32) -> u16 {
    (voltage_v * 200.0 + 0.5) as u16
}

/// X-series position counts to micro-radians, saturating.
#[must_use]
pub fn urad_from_x_position(counts: i32) -> i32 {
    // 2 pi 1e6 / 4096 = 1533.9807878857; the fraction is kept to 2^-20.
    let urad = (i64::from(counts) * 1_608_495_439 + (1 << 19)) >> 20;
    saturate(urad)
}

/// Micro-radians to X-series position counts, rounded to the nearest.
#[must_use]
pub fn x_position_from_urad(angle_urad: i32) -> i32 {
    let scaled = i64::from(angle_urad) * i64::from(X_COUNTS_PER_TURN);
    // No tie: a turn has an odd number of micro-radians.
    saturate((scaled + URAD_PER_TURN / 2).div_euclid(URAD_PER_TURN))
}

fn round_i16(scaled: f32) -> i16 {
    let rounded = if scaled < 0.0 {
        scaled - 0.5
    } else {
        scaled + 0.5
    };
    rounded as i16
}

fn saturate(wide: i64) -> i32 {
    wide.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_that_no_motor_may_see_are_refused() {
        for bad in [
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            134.3,
            -134.3,
            f32::MAX,
        ] {
            assert_eq!(urad_from_rad(bad), None, "{bad}");
        }
        for (rad, urad) in [
            (0.0, 0),
            (-0.0, 0),
            (1.0, 1_000_000),
            (-2.5, -2_500_000),
            (5.0e-7, 1),
            (134.0, 134_000_000),
        ] {
            assert_eq!(urad_from_rad(rad), Some(urad), "{rad}");
        }
    }

    #[test]
    fn x_series_counts_agree_with_one_turn() {
        assert_eq!(urad_from_x_position(4096), 6_283_185);
        assert_eq!(urad_from_x_position(-4096), -6_283_185);
        assert_eq!(x_position_from_urad(6_283_185), 4096);
        assert_eq!(x_position_from_urad(-6_283_185), -4096);
        for counts in (-80_000..80_000).step_by(37) {
            assert_eq!(x_position_from_urad(urad_from_x_position(counts)), counts);
        }
    }

    #[test]
    fn counts_come_back_and_agree_with_the_documented_steps() {
        for counts in i16::MIN..=i16::MAX {
            assert_eq!(velocity_from_rad_s(rad_s_from_velocity(counts)), counts);
            assert_eq!(current_from_a(a_from_current(counts)), counts);
            assert_eq!(counts_from_duty(duty_from_counts(counts)), counts);
            let voltage = counts as u16;
            assert_eq!(voltage_from_v(v_from_voltage(voltage)), voltage);
            let angle_urad = i32::from(counts) * 4000;
            assert!((urad_from_rad(rad_from_urad(angle_urad)).unwrap() - angle_urad).abs() <= 8);
            for (ours, step) in [
                (rad_s_from_velocity(counts), RAD_S_PER_VELOCITY_COUNT),
                (a_from_current(counts), A_PER_CURRENT_COUNT),
                (duty_from_counts(counts), DUTY_PER_COUNT),
            ] {
                assert!((f64::from(ours) - f64::from(counts) * step).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn small_quantities_saturate_and_round() {
        assert_eq!(velocity_from_rad_s(2.786), 5572);
        assert_eq!(velocity_from_rad_s(-99.0), i16::MIN);
        assert_eq!(velocity_from_rad_s(f32::NAN), 0);
        assert_eq!(current_from_a(-0.0125), -13);
        assert_eq!(counts_from_duty(-1.0), -2000);
        assert_eq!(voltage_from_v(7.4), 1480);
        assert_eq!(voltage_from_v(-1.0), 0);
    }
}
