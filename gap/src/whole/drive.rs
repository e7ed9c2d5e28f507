//! One step of a joint's motor against friction and load.

use super::servo::{J, STEP_S};
use physics::laws::{Scalar, stribeck};

/// Inertia that regularises the torque limit, kg m2: that of one half-sphere about its cube's centre is 6.6e-4, of half the
/// robot about a joint 0.02; the replayed load already holds the true one.
pub(super) const INERTIA_KG_M2: f64 = 0.01;
/// Change of load per angle off the measured path once the motor is at its limit, N m/rad. Gravity alone gives 2 (half the
/// robot on a lever of 0.15 m); a replayed load is wrong by some tenths of a newton metre, and a motor at its limit would
/// run away on them.
const SURROUNDINGS_NM_RAD: f64 = 30.0;

/// Share of its torque per current that a motor still has at `t_s` of a run.
pub(super) fn warm(p: &[f64], t_s: f64) -> f64 {
    let lost = p[J::DerateShare as usize];
    if lost == 0.0 {
        return 1.0;
    }
    let on_s = t_s + p[J::DerateSince as usize];
    let cold = libm::exp(-on_s / p[J::DerateTime as usize].max(1e-3));
    1.0 - lost * (1.0 - cold)
}

/// Friction other than viscous at speed `v`, N m, for forward (+1) or backward motion.
pub(super) struct Friction {
    base: f64,
    half_asymmetry: f64,
    damping: f64,
    half_asymmetry_damping: f64,
}

impl Friction {
    pub(super) fn at(p: &[f64], v: f64, load: f64) -> Self {
        let stick = match p[J::Static as usize] {
            0.0 => 0.0,
            stick => stribeck::<Scalar>(stick, v / p[J::StribeckSpeed as usize].max(1e-4)),
        };
        Self {
            base: p[J::Coulomb as usize] + stick + p[J::LoadShare as usize] * load.abs(),
            half_asymmetry: 0.5 * p[J::Asymmetry as usize],
            damping: p[J::Viscous as usize] + p[J::Quadratic as usize] * v.abs(),
            half_asymmetry_damping: 0.5 * p[J::AsymmetryViscous as usize],
        }
    }

    fn dry(&self, sign: f64) -> f64 {
        (self.base + sign * self.half_asymmetry).max(0.0)
    }

    fn wet(&self, sign: f64) -> f64 {
        self.damping + sign * self.half_asymmetry_damping
    }

    /// Speed from `m v + wet v + dry sign(v) = push`, 0 while the push is below the dry friction; and the friction then.
    fn solve(&self, m: f64, push: f64) -> (f64, f64) {
        let sign = if push >= 0.0 { 1.0 } else { -1.0 };
        let rest = push.abs() - self.dry(sign);
        if rest <= 0.0 {
            return (0.0, push);
        }
        let v = sign * rest / (m + self.wet(sign)).max(1e-9);
        (v, sign * self.dry(sign) + self.wet(sign) * v)
    }
}

/// What bounds a motor.
pub(super) struct Limits {
    /// Speed lost per torque, rad/s per N m.
    pub(super) droop: f64,
    /// Largest torque, N m.
    pub(super) torque_nm: f64,
    /// Speed at which the supply gives no torque, rad/s; infinite where not measured.
    pub(super) free_rad_s: f64,
    /// Speed lost per torque once the supply gives no more, rad/s per N m.
    pub(super) brake: f64,
}

/// One step of the motor against friction and load: new speed, and torque less what accelerates the regularising inertia.
pub(super) fn drive(
    v: f64,
    wanted: f64,
    load: f64,
    off: f64,
    l: &Limits,
    f: &Friction,
) -> (f64, f64) {
    let m = INERTIA_KG_M2 / STEP_S;
    let stiff = 1.0 / l.droop;
    let (mut v1, mut friction) = f.solve(m + stiff, m * v + stiff * wanted - load);
    let mut torque = stiff * (wanted - v1);
    // The full supply: speed falls along the motor's own line, driving and driven.
    let full = l.free_rad_s * wanted.signum();
    if full.is_finite() && wanted.abs() > full.abs() - l.brake * torque * wanted.signum() {
        let line = 1.0 / l.brake.max(l.droop);
        (v1, friction) = f.solve(m + line, m * v + line * full - load);
        torque = line * (full - v1);
    }
    if torque.abs() <= l.torque_nm {
        return (v1, friction + load);
    }
    let limit = l.torque_nm * torque.signum();
    let k = SURROUNDINGS_NM_RAD;
    let (v1, _) = f.solve(m + k * STEP_S, m * v + limit - load - k * off);
    (v1, limit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sticking_friction_falls_as_a_bell() {
        let mut p = vec![0.0; J::COUNT];
        (p[J::Coulomb as usize], p[J::Static as usize]) = (0.2, 0.5);
        p[J::StribeckSpeed as usize] = 0.1;
        for v in [-0.3, -0.1, 0.0, 0.05, 0.1, 0.25, 3.0] {
            let exact = 0.2 + 0.5 * libm::exp(-(v / 0.1) * (v / 0.1));
            let dry = Friction::at(&p, v, 0.0).dry(1.0);
            assert!((dry - exact).abs() < 1e-6, "{v}: {dry} {exact}");
        }
    }

    #[test]
    fn a_motor_weakens_from_when_it_was_switched_on() {
        let mut p = vec![0.0; J::COUNT];
        p[J::DerateTime as usize] = 4.0;
        assert_eq!(warm(&p, 100.0), 1.0, "nothing to lose");
        p[J::DerateShare as usize] = 0.5;
        assert_eq!(warm(&p, 0.0), 1.0, "cold");
        p[J::DerateSince as usize] = 4.0;
        // Half of it times what one time constant, then many, leave.
        let after_one = 0.5 + 0.5 / std::f64::consts::E;
        assert!((warm(&p, 0.0) - after_one).abs() < 1e-12);
        assert!((warm(&p, 1e3) - 0.5).abs() < 1e-12);
    }
}
