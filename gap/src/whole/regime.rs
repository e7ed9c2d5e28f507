//! In which regime of its motion a joint has its gap, and in which of its stages what is left arose.

use super::joints::Tier;
use super::servo::{self, J, JointRun, STEP_S, Sample, Trace};
use crate::regimes::{Course, MOTION};
use crate::vocabulary::Stage;

/// Share of the gap by which a regime must exceed its share of time to be named.
const EXCESS: f64 = 0.1;
/// Share of the torque limit from which a motor counts as at its limit.
const FULL: f64 = 0.97;
/// Share of the squared angle errors that a straight line in the angle must explain to be one of the conventions.
const STRAIGHT: f64 = 0.7;

/// Regimes of every step as `of` takes them from the course of a run, whose torque is limited to `limit_nm`.
pub(super) fn course<T>(
    run: &JointRun,
    trace: &Trace,
    limit_nm: f64,
    of: impl FnOnce(&Course<'_>) -> T,
) -> T {
    let t_s: Vec<f64> = (0..run.path().len()).map(|i| i as f64 * STEP_S).collect();
    of(&Course {
        t_s: &t_s,
        angle_rad: run.path(),
        effort_nm: &trace.effort,
        full: &|i| trace.effort[i].abs() >= FULL * limit_nm,
    })
}

/// The regime that holds most of what `after` gains over `before` above its share of time; where `after` gains nothing, of what it leaves.
pub(super) fn regime(tier: &Tier, before: &[f64], after: &[f64], gained: bool) -> &'static str {
    let limit_nm = tier.nominal.max_torque_nm * after[J::MaxTorque as usize];
    let (mut gap, mut time) = ([0.0; MOTION.len()], [0.0; MOTION.len()]);
    let (mut a, mut b) = (Trace::default(), Trace::default());
    for run in &tier.runs {
        servo::simulate(run, &tier.nominal, before, &mut a);
        servo::simulate(run, &tier.nominal, after, &mut b);
        let which = course(run, &b, limit_nm, |c| c.motion());
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
    let best = (0..MOTION.len()).max_by(|x, y| excess(*x).total_cmp(&excess(*y)));
    best.filter(|k| excess(*k) > EXCESS)
        .map_or("all", |k| MOTION[k])
}

/// Stage in which what the model leaves arose. A link that does not follow its encoder is the transmission's, an angle off by a straight
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
