//! Where: shares by stage and the regime in which the gap sits.

use crate::fit::Model;
use crate::joint::{Channel, P, Params, Problem, RunData, Sample, Trace, simulate};
use crate::math;
use crate::regimes::{Compared, Course, MOTION, RegimeRow, Sums};
use crate::vocabulary::Stage;

/// Share of the controller's limit from which its output is at it.
const FULL: f64 = 0.95;

/// Stage in which a parameter acts.
#[must_use]
pub fn stage_of(p: P) -> Stage {
    use P::*;
    match p {
        Scale | Sense | Offset | MechOffset | RecordScale => Stage::Conventions,
        Delay | Skew | Played | Quantum | Echo => Stage::Transport,
        LoopGain | Damping | SpeedDelay | Windup | Tightness | Grip | Droop | Deadband
        | SlewLimit | FeedbackDelay | Lag => Stage::Driver,
        Motor | Ampere | Strength | ReadAfter | Resistance | CurrentLimit | TorqueLimit
        | DerateTime | DerateShare => Stage::Electrical,
        Supply | Sag | Regeneration => Stage::Supply,
        Play | OutputPlay | Flexibility => Stage::Transmission,
        _ => Stage::Drivetrain,
    }
}

/// Position errors of one run at its enabled samples; `ideal` = set-point instead of a model.
#[must_use]
pub fn errors(
    problem: &Problem,
    run: &RunData,
    params: &Params,
    ideal: bool,
    channel: Channel,
) -> Vec<f64> {
    let mut trace = Trace::new();
    simulate(run, params, problem.dt_s, &mut trace);
    let column = if ideal { Channel::Applied } else { channel } as usize;
    let rows = run.samples.iter().zip(&trace);
    rows.filter(|(s, _)| s.enabled && s.measured[channel as usize].is_finite())
        .map(|(s, y)| y[column] - s.measured[channel as usize])
        .collect()
}

/// A share with its interval.
#[derive(Debug, Clone, PartialEq)]
pub struct Share {
    /// Stage; `None` for what is left.
    pub stage: Option<Stage>,
    /// Share.
    pub share: f64,
    /// 95 % interval over runs.
    pub ci95: [f64; 2],
}

/// Shares of the gap by stage: the stages of the final model replace those of the nominal one in the order of the chain,
/// and each is given what the error falls by. What is left above the floor is `None`.
#[must_use]
pub fn shares(
    problem: &Problem,
    runs: &[usize],
    start: &Params,
    ideal: bool,
    end: &Model,
    floor: f64,
    seed: u64,
) -> Vec<Share> {
    let mut ladder: Vec<Vec<f64>> = Vec::new();
    let mut params = *start;
    let score = |p: &Params, ideal: bool| -> Vec<f64> {
        runs.iter()
            .map(|r| {
                math::rms(&errors(
                    problem,
                    &problem.runs[*r],
                    p,
                    ideal,
                    Channel::Position,
                ))
            })
            .collect()
    };
    ladder.push(score(&params, ideal));
    for stage in Stage::JOINT {
        for p in P::ALL.iter().filter(|p| stage_of(**p) == stage) {
            params.set(*p, end.params.get(*p));
        }
        ladder.push(score(&params, false));
    }
    if ideal {
        // An ideal servo has no stages before its driver: what the servo model gains over it is the driver's.
        let driver = 1 + Stage::JOINT
            .iter()
            .position(|s| *s == Stage::Driver)
            .unwrap_or(0);
        let first = ladder[0].clone();
        for level in &mut ladder[1..driver] {
            level.clone_from(&first);
        }
    }
    let of = |pick: &[usize]| -> Vec<f64> {
        let level = |k: usize| math::mean(&pick.iter().map(|i| ladder[k][*i]).collect::<Vec<_>>());
        let drops: Vec<f64> = (1..ladder.len())
            .map(|k| (level(k - 1) - level(k)).max(0.0))
            .collect();
        let known: f64 = drops.iter().sum();
        let rest = (level(ladder.len() - 1) - floor).max(if known > 0.0 { 0.0 } else { 1e-12 });
        let sum: f64 = known + rest;
        drops
            .iter()
            .chain([&rest])
            .map(|d| if sum > 0.0 { d / sum } else { 0.0 })
            .collect()
    };
    let all: Vec<usize> = (0..runs.len()).collect();
    let value = of(&all);
    let mut rng = math::Rng::new(seed);
    let draws: Vec<Vec<f64>> = (0..200)
        .map(|_| {
            of(&(0..runs.len())
                .map(|_| rng.index(runs.len()))
                .collect::<Vec<_>>())
        })
        .collect();
    let stages = Stage::JOINT.iter().map(|s| Some(*s)).chain([None]);
    stages
        .enumerate()
        .map(|(k, stage)| {
            let column: Vec<f64> = draws.iter().map(|d| d[k]).collect();
            Share {
                stage,
                share: value[k],
                ci95: [
                    math::quantile(&column, 0.025),
                    math::quantile(&column, 0.975),
                ],
            }
        })
        .collect()
}

/// `of` a run's course under a simulation of it.
fn course<T>(
    problem: &Problem,
    run: &RunData,
    trace: &Trace,
    of: impl FnOnce(&Course<'_>) -> T,
) -> T {
    let limit = run.nominal.limit;
    let full = |i: usize| {
        let duty = run.samples[i].measured[Channel::Duty as usize];
        duty.is_finite() && limit.is_finite() && duty.abs() > FULL * limit
    };
    let at = |s: &Sample| (s.step as f64 + s.part) * problem.dt_s;
    let t_s: Vec<f64> = run.samples.iter().map(at).collect();
    let angle_rad: Vec<f64> = run.samples.iter().map(|s| s.measured[0]).collect();
    let effort_nm: Vec<f64> = trace.iter().map(|y| y[Channel::Effort as usize]).collect();
    of(&Course {
        t_s: &t_s,
        angle_rad: &angle_rad,
        effort_nm: &effort_nm,
        full: &full,
    })
}

/// Errors of a joint by regime of its motion, with the model `before` and with the one `after`; `ideal` = the set-point in the place of the first.
#[must_use]
pub fn regimes(
    problem: &Problem,
    runs: &[usize],
    (before, ideal): (&Params, bool),
    after: &Params,
) -> Vec<RegimeRow> {
    let mut sums = Sums::default();
    let (mut first, mut last) = (Trace::new(), Trace::new());
    for r in runs {
        let run = &problem.runs[*r];
        simulate(run, before, problem.dt_s, &mut first);
        simulate(run, after, problem.dt_s, &mut last);
        let volts = |s: &Sample| s.measured[Channel::BusVoltage as usize];
        let bus_v: Vec<f64> = run.samples.iter().map(volts).collect();
        let known = bus_v.iter().any(|v| v.is_finite());
        let marks = course(problem, run, &last, |c| {
            c.marks(known.then_some(&bus_v[..]), None)
        });
        for (i, (s, marks)) in run.samples.iter().zip(marks).enumerate() {
            for (of, channel) in [
                (Compared::Position, Channel::Position),
                (Compared::Effort, Channel::Effort),
            ] {
                let measured = s.measured[channel as usize];
                let set_point = ideal && of == Compared::Position;
                let column = if set_point { Channel::Applied } else { channel };
                if s.enabled && measured.is_finite() {
                    sums.add(of, false, marks, first[i][column as usize] - measured);
                    sums.add(of, true, marks, last[i][channel as usize] - measured);
                }
            }
        }
    }
    sums.rows(Some(problem.joint))
}

/// The regime in which the squared error of `before` exceeds that of `after` most per sample.
#[must_use]
pub fn regime(
    problem: &Problem,
    runs: &[usize],
    before: &Params,
    ideal: bool,
    after: &Params,
) -> &'static str {
    let mut sum = [0.0; MOTION.len()];
    let mut count = [0.0; MOTION.len()];
    for r in runs {
        let run = &problem.runs[*r];
        let (mut a, mut b) = (Trace::new(), Trace::new());
        simulate(run, before, problem.dt_s, &mut a);
        simulate(run, after, problem.dt_s, &mut b);
        let column = if ideal {
            Channel::Applied
        } else {
            Channel::Position
        } as usize;
        for (i, k) in course(problem, run, &b, |c| c.motion())
            .into_iter()
            .enumerate()
        {
            let m = run.samples[i].measured[0];
            if m.is_finite() && run.samples[i].enabled {
                sum[k] += (a[i][column] - m).powi(2) - (b[i][0] - m).powi(2);
                count[k] += 1.0;
            }
        }
    }
    let total: f64 = count.iter().sum();
    // A regime must hold at least 2 % of the samples to be named.
    let score = |k: usize| {
        if count[k] > 0.02 * total {
            sum[k] / count[k]
        } else {
            f64::MIN
        }
    };
    let best = (0..MOTION.len())
        .max_by(|a, b| score(*a).total_cmp(&score(*b)))
        .unwrap_or(MOTION.len() - 1);
    MOTION[best]
}
