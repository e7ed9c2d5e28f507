use super::*;

#[test]
fn sine_and_cosine_are_close_and_agree_in_all_widths() {
    let mut worst: f64 = 0.0;
    for k in -40_000..40_000 {
        let x = (f64::from(k) * 0.025_137) as f32;
        let (s, c) = x.sin_cos_lane();
        let (rs, rc) = libm::sincos(f64::from(x));
        worst = worst
            .max((f64::from(s) - rs).abs())
            .max((f64::from(c) - rc).abs());
    }
    assert!(worst < 1.5e-7, "{worst}");
}

trait SinCos {
    fn sin_cos_lane(self) -> (f32, f32);
}

impl SinCos for f32 {
    fn sin_cos_lane(self) -> (f32, f32) {
        sin_cos_f32(self)
    }
}
