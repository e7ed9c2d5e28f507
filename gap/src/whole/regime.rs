//! In which regime of its motion a joint has its gap, and in which of its stages what is left arose.

use super::joints::Tier;
use super::servo::{self, J, JointRun, STEP_S, Sample, Trace};
use crate::locate::REGIMES;
use crate::math;
use crate::vocabulary::Stage;

/// Time after a reversal that belongs to it, s.
const REVERSAL_S: f64 = 0.15;
/// Steps to either side over which speeds are taken.
const HALF: usize = (0.05 / STEP_S) as usize;
/// Share of the gap by which a regime must exceed its share of time to be named.
const EXCESS: f64 = 0.1;
/// Share of the torque limit from which a motor counts as at its limit.
const FULL: f64 = 0.97;
/// Share of the squared angle errors that a straight line in the angle must explain to be one of the conventions.
const STRAIGHT: f64 = 0.7;

/// Regime of every step, as an index into [`REGIMES`].
fn regimes(run: &JointRun, trace: &Trace, limit_nm: f64) -> Vec<usize> {
    let path = run.path();
    let n = path.len();
    let speed: Vec<f64> = (0..n)
        .map(|i| {
            let (a, b) = (i.saturating_sub(HALF), (i + HALF).min(n - 1));
            (path[b] - path[a]) / ((b - a).max(1) as f64 * STEP_S)
        })
        .collect();
    let sizes: Vec<f64> = speed.iter().map(|v| v.abs()).collect();
    let efforts: Vec<f64> = trace.effort.iter().map(|x| x.abs()).collect();
    let slow = 0.05 * math::quantile(&sizes, 0.95);
    let high = math::quantile(&efforts, 0.9);
    let (mut sign, mut turned_s) = (0.0, f64::NEG_INFINITY);
    (0..n)
        .map(|i| {
            let t = i as f64 * STEP_S;
            if sizes[i] > slow && speed[i].signum() != sign {
                (sign, turned_s) = (speed[i].signum(), t);
            }
            match () {
                () if efforts[i] >= FULL * limit_nm => 0,
                () if t - turned_s < REVERSAL_S => 1,
                () if sizes[i] < slow => 2,
                () if efforts[i] >= high => 3,
                () if t > 60.0 && t > 0.5 * n as f64 * STEP_S => 4,
                () => 5,
            }
        })
        .collect()
}

/// The regime that holds most of what `after` gains over `before` above its share of time; where `after` gains nothing, of what it leaves.
pub(super) fn regime(tier: &Tier, before: &[f64], after: &[f64], gained: bool) -> &'static str {
    let limit_nm = tier.nominal.max_torque_nm * after[J::MaxTorque as usize];
    let (mut gap, mut time) = ([0.0; REGIMES.len()], [0.0; REGIMES.len()]);
    let (mut a, mut b) = (Trace::default(), Trace::default());
    for run in &tier.runs {
        servo::simulate(run, &tier.nominal, before, &mut a);
        servo::simulate(run, &tier.nominal, after, &mut b);
        let which = regimes(run, &b, limit_nm);
        let angles = |trace: &Trace| servo::errors(&trace.position, &run.position).collect();
        let torques = |trace: &Trace, p: &[f64]| run.effort_errors(trace, p).collect();
        let channels: [(Vec<f64>, Vec<f64>, &[Sample]); 2] = [
            (angles(&a), angles(&b), &run.position),
            (torques(&a, before), torques(&b, after), &run.effort),
        ];
        for (c, (x, y, samples)) in channels.into_iter().enumerate() {
            let weight = tier.weight(c).powi(2);
            for ((ex, ey), s) in x.iter().zip(&y).zip(samples) {
                let left = weight * ey * ey;
                gap[which[s.step()]] += if gained {
                    weight * ex * ex - left
                } else {
                    left
                };
            }
        }
        which.iter().for_each(|k| time[*k] += 1.0);
    }
    let (all, whole): (f64, f64) = (gap.iter().sum(), time.iter().sum());
    let excess = |k: usize| gap[k] / all.max(1e-12) - time[k] / whole.max(1.0);
    let best = (0..REGIMES.len()).max_by(|x, y| excess(*x).total_cmp(&excess(*y)));
    best.filter(|k| excess(*k) > EXCESS)
        .map_or("all", |k| REGIMES[k])
}

/// Stage in which what the model leaves arose: a link that does not follow its encoder is the transmission's, an angle off by a straight
/// line the conventions', any other angle the driver's, and a torque that the angle does not show the drivetrain's.
pub(super) fn rest(tier: &Tier, theta: &[f64]) -> Stage {
    let mut sums = [0.0; 3];
    let (mut n, mut x, mut e, mut xx, mut xe, mut ee) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    let mut trace = Trace::default();
    for run in &tier.runs {
        servo::simulate(run, &tier.nominal, theta, &mut trace);
        let angles = servo::errors(&trace.position, &run.position);
        for (error, angle) in angles.zip(servo::values(&run.position)) {
            sums[0] += error * error;
            n += 1.0;
            x += angle;
            e += error;
            xx += angle * angle;
            xe += angle * error;
            ee += error * error;
        }
        let torques = run.effort_errors(&trace, theta);
        sums[1] += torques.map(|r| r * r).sum::<f64>();
        let twists = servo::errors(&trace.twist, &run.twist);
        sums[2] += twists.map(|r| r * r).sum::<f64>();
    }
    let [angle, torque, twist] = [0, 1, 2].map(|c| sums[c] * tier.weight(c).powi(2));
    if twist > angle && twist > torque {
        return Stage::Transmission;
    }
    if torque > angle {
        return Stage::Drivetrain;
    }
    let (variance, cross) = (xx - x * x / n, xe - x * e / n);
    let straight = e * e / n + cross * cross / variance.max(1e-12);
    if straight > STRAIGHT * ee {
        Stage::Conventions
    } else {
        Stage::Driver
    }
}
