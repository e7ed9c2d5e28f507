//! Is there a law in what is left that the library does not hold?
//!
//! The torque that the best model leaves is regressed on general features of the motion. They are torque and friction that depend on the
//! place, hysteresis (stop operators of several widths, from which any rate-independent hysteresis is a sum), load by direction, and
//! friction by speed and by load. What predicts the remainder of gaits that it was not fitted on is a law.

use super::joints::Tier;
use super::least::solve;
use super::servo::{self, Left, Trace};

/// Share of the remainder of unseen gaits that a feature must predict to be a law.
///
/// Emulated robots: at most 0.09 on nulls, 0.2 where another joint's effect spoils the replayed loads, 0.24 and more where a spring yields
/// or friction depends on the place.
pub(super) const LAW: f64 = 0.2;
/// Size below which a law under replayed loads is their error, N m: 0.04 and 0.09 where a spring of the connector or a soft ground spoils them, 0.17
/// and more where a joint's own law does (emulated robots).
pub(super) const LEAST_NM: f64 = 0.12;
/// How many times as much as a law effects may leave.
pub(super) const RIVAL: f64 = 1.3;
/// Periods per turn that are tried, and widths of stop operators, rad.
const PERIODS: u32 = 24;
/// Periods of a ripple that may be named: one or two in a turn, weights and gains by direction are as well (0.05 of robots without a cause; an asymmetric gain was one).
const FEWEST: u32 = 3;
const WIDTHS_RAD: [f64; 4] = [0.08, 0.16, 0.32, 0.64];
/// Speeds between which a friction is free, rad/s: it may fall, rise or stay. At most 0.09 of what joints of emulated robots without a cause leave follows one,
/// 0.4 where a stribeck_friction of 1.1 N m must not be named.
const SPEEDS_RAD_S: [f64; 5] = [0.03, 0.1, 0.25, 0.6, 1.2];

/// One set of features by sample.
type Features = dyn Fn(&Left) -> Vec<f64>;

/// Share of the squares of `value` in gaits left out that the features predict.
fn predicted(
    samples: &[(usize, Left)],
    groups: usize,
    value: &dyn Fn(&Left) -> f64,
    features: &Features,
) -> f64 {
    let Some(n) = samples.first().map(|s| features(&s.1).len()) else {
        return 0.0;
    };
    let mut sums = vec![(vec![0.0; n * n], vec![0.0; n]); groups];
    for (g, s) in samples {
        let (x, y) = (features(s), value(s));
        let (a, b) = &mut sums[*g];
        for i in 0..n {
            b[i] += x[i] * y;
            for j in 0..n {
                a[i * n + j] += x[i] * x[j];
            }
        }
    }
    let weights: Vec<Vec<f64>> = (0..groups)
        .map(|left_out| {
            let (mut a, mut b) = (vec![0.0; n * n], vec![0.0; n]);
            for (_, s) in sums.iter().enumerate().filter(|s| s.0 != left_out) {
                a.iter_mut().zip(&s.0).for_each(|(x, y)| *x += y);
                b.iter_mut().zip(&s.1).for_each(|(x, y)| *x += y);
            }
            for i in 0..n {
                a[i * n + i] = 1.02 * a[i * n + i] + 1e-9;
            }
            solve(&a, &b)
        })
        .collect();
    let (mut before, mut after) = (0.0, 0.0);
    for (g, s) in samples {
        let y = value(s);
        let guess: f64 = features(s)
            .iter()
            .zip(&weights[*g])
            .map(|(x, w)| x * w)
            .sum();
        before += y * y;
        after += (y - guess).powi(2);
    }
    if before > 0.0 {
        1.0 - after / before
    } else {
        0.0
    }
}

/// What a model leaves of a joint's torque, with the gait of every sample.
fn left(tier: &Tier, theta: &[f64]) -> Vec<(usize, Left)> {
    let mut trace = Trace::default();
    let mut samples: Vec<(usize, Left)> = Vec::new();
    for (run, group) in tier.grouped() {
        servo::simulate(run, &tier.nominal, theta, &mut trace);
        let own = run.left(&trace, theta, &WIDTHS_RAD).into_iter();
        samples.extend(own.map(|l| (group, l)));
    }
    samples
}

/// Torque that goes with the place, so many periods in a turn.
fn of_place(periods: u32, s: &Left) -> [f64; 2] {
    let (sin, cos) = libm::sincos(f64::from(periods) * s.angle_rad);
    [sin, cos]
}

/// Friction at each of the speeds.
fn of_speed(s: &Left) -> Vec<f64> {
    let speed = s.speed_rad_s;
    let at = SPEEDS_RAD_S.iter().filter(|e| speed.abs() >= **e).count();
    let mut out = vec![0.0; SPEEDS_RAD_S.len() + 1];
    out[at] = speed.signum();
    out
}

/// Friction that grows with the load.
fn of_load(s: &Left) -> Vec<f64> {
    vec![s.direction() * s.load_nm.abs()]
}

/// The share of a remainder that a free friction predicts.
fn rubbed(samples: &[(usize, Left)]) -> f64 {
    let groups = samples.iter().map(|s| s.0 + 1).max().unwrap_or(0);
    if groups < 3 {
        return 0.0;
    }
    let torque = |s: &Left| s.torque_nm;
    let share = |f: &Features| predicted(samples, groups, &torque, f);
    share(&of_speed).max(share(&of_load))
}

/// The largest share of a remainder that a law of place, hysteresis or gain predicts.
fn largest(samples: &[(usize, Left)]) -> f64 {
    let groups = samples.iter().map(|s| s.0 + 1).max().unwrap_or(0);
    if groups < 3 {
        return 0.0;
    }
    let torque = |s: &Left| s.torque_nm;
    let share = |f: &Features| predicted(samples, groups, &torque, f);
    let mut best = share(&|s| s.stops_rad.clone()).max(share(&|s| vec![s.load_nm.abs()]));
    for k in 1..=PERIODS {
        let torque = move |s: &Left| of_place(k, s).to_vec();
        let friction = move |s: &Left| of_place(k, s).map(|x| s.direction() * x).to_vec();
        best = best.max(share(&torque)).max(share(&friction));
    }
    best
}

/// A law in what a model leaves of a joint's torque.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Law {
    /// Share of the squares of gaits left out that it predicts.
    pub(super) share: f64,
    /// Its size, root mean square, N m.
    pub(super) size_nm: f64,
}

/// The law that predicts the largest share of a joint's remainder.
pub(super) fn law(tier: &Tier, theta: &[f64]) -> Law {
    let samples = left(tier, theta);
    let share = largest(&samples).max(rubbed(&samples));
    let mean = squares(&samples) / samples.len().max(1) as f64;
    Law {
        share,
        size_nm: (mean * share.max(0.0)).sqrt(),
    }
}

/// The periods per turn of a ripple that predicts enough of what a model leaves to be a law.
pub(super) fn periods(tier: &Tier, theta: &[f64]) -> Option<u32> {
    ripple(&left(tier, theta))
}

/// The same of a remainder.
fn ripple(samples: &[(usize, Left)]) -> Option<u32> {
    let groups = samples.iter().map(|s| s.0 + 1).max().unwrap_or(0);
    if groups < 3 {
        return None;
    }
    let torque = |s: &Left| s.torque_nm;
    let share = |k| predicted(samples, groups, &torque, &move |s| of_place(k, s).to_vec());
    let shares = (FEWEST..=PERIODS).map(|k| (share(k), k));
    let (share, k) = shares.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let size_nm = (squares(samples) / samples.len() as f64 * share.max(0.0)).sqrt();
    (share > LAW && size_nm > LEAST_NM).then_some(k)
}

/// Sum of the squares of the torques, (N m)2.
fn squares(samples: &[(usize, Left)]) -> f64 {
    samples.iter().map(|s| s.1.torque_nm.powi(2)).sum()
}

/// How many times as much as the best law the effects in `theta` leave of the torque that the calibrated nominal model `base` leaves. Above
/// one a law that the library does not hold explains more than all of them together.
pub(super) fn rival(tier: &Tier, base: &[f64], theta: &[f64]) -> f64 {
    let before = left(tier, base);
    let effects = squares(&left(tier, theta)) / squares(&before).max(1e-12);
    effects / (1.0 - largest(&before)).max(1e-3)
}

#[cfg(test)]
mod tests {
    use super::{Left, WIDTHS_RAD, largest, ripple};

    /// What a model leaves of a joint on so many gaits of twelve seconds: a law of place, direction and gait, beside noise of 0.05 N m.
    fn remainder(gaits: usize, law: impl Fn(f64, f64, usize) -> f64) -> Vec<(usize, Left)> {
        let mut bits = 1_u32;
        let mut noise = || {
            bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            0.1 * (f64::from(bits >> 8) / f64::from(1_u32 << 24) - 0.5)
        };
        let mut all = Vec::new();
        for gait in 0..gaits {
            // Gaits turn about other places at other rates, as searched ones do.
            let (centre, rate) = (0.7 * gait as f64 - 1.5, 0.9 + 0.13 * gait as f64);
            for i in 0..240 {
                let (sin, cos) = libm::sincos(rate * 0.05 * f64::from(i));
                let angle_rad = centre + 0.9 * sin;
                let direction = cos.signum();
                let left = Left {
                    torque_nm: law(angle_rad, direction, gait) + noise(),
                    angle_rad,
                    speed_rad_s: 0.9 * rate * cos,
                    load_nm: 0.0,
                    stops_rad: vec![0.0; WIDTHS_RAD.len()],
                };
                all.push((gait, left));
            }
        }
        all
    }

    #[test]
    fn a_ripple_is_named_by_what_other_gaits_foretell_of_it() {
        // [what is left, a law, the ripple that may be named]
        type Case = (&'static str, fn(f64, f64, usize) -> f64, bool, Option<u32>);
        const CASES: [Case; 6] = [
            ("noise", |_, _, _| 0.0, false, None),
            (
                "five periods",
                |a, _, _| 0.4 * libm::sin(5.0 * a + 0.8),
                true,
                Some(5),
            ),
            (
                "twenty-four",
                |a, _, _| 0.4 * libm::cos(24.0 * a),
                true,
                Some(24),
            ),
            ("too small", |a, _, _| 0.1 * libm::sin(5.0 * a), true, None),
            (
                "friction by place",
                |a, d, _| 0.4 * d * libm::sin(5.0 * a),
                true,
                None,
            ),
            // Each gait's own phase: nothing that another gait foretells.
            (
                "no law",
                |a, _, g| 0.4 * libm::sin(5.0 * a + 2.1 * g as f64),
                false,
                None,
            ),
        ];
        for (name, law, lawful, periods) in CASES {
            let samples = remainder(6, law);
            assert_eq!(largest(&samples) > super::LAW, lawful, "{name}");
            assert_eq!(ripple(&samples), periods, "{name}");
        }
        let two = remainder(2, |a, _, _| 0.4 * libm::sin(5.0 * a));
        assert_eq!((largest(&two), ripple(&two)), (0.0, None), "two gaits");
        // A weight's own law, which the tolerances of masses hold.
        let weight = remainder(6, |a, _, _| 0.4 * libm::sin(a));
        assert_eq!(ripple(&weight), None, "one period");
    }
}
