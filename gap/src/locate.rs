//! Where: shares by stage and the regime in which the gap sits.

use crate::joint::data::CHANNELS;
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
        Delay | Skew | Played | Quantum => Stage::Transport,
        LoopGain | Damping | SpeedDelay | Windup | Tightness | Grip | Droop | Deadband
        | SlewLimit | FeedbackDelay | Lag => Stage::Driver,
        Motor | Ampere | Strength | ReadAfter | Resistance | CurrentLimit | TorqueLimit
        | DerateTime | DerateShare => Stage::Electrical,
        Supply | Sag | Regeneration => Stage::Supply,
        Play | OutputPlay | Flexibility => Stage::Transmission,
        _ => Stage::Drivetrain,
    }
}

/// A state of the joint's model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// Parameters.
    pub params: Params,
    /// Recorded over true, by channel.
    pub columns: [f64; CHANNELS],
    /// No servo is known: the position is the set-point.
    pub ideal: bool,
    /// Set-points come as the driver's echo shows, not as they were sent.
    pub arrived: bool,
}

impl State {
    /// The joint with `params`, set-points as they were sent.
    #[must_use]
    pub fn new(params: Params) -> Self {
        Self {
            params,
            columns: [1.0; CHANNELS],
            ideal: false,
            arrived: false,
        }
    }
}

/// Runs that figures are taken on.
#[derive(Debug, Clone, Copy)]
pub struct Scored<'a> {
    /// The joint with set-points as they were sent.
    pub sent: &'a Problem,
    /// The same as they arrived; `sent` where no echo shows it.
    pub arrived: &'a Problem,
    /// Numbers of the runs.
    pub runs: &'a [usize],
}

impl<'a> Scored<'a> {
    fn problem(&self, state: &State) -> &'a Problem {
        if state.arrived {
            self.arrived
        } else {
            self.sent
        }
    }

    /// A run and its rows as a state of the model has them, as they would be recorded.
    #[must_use]
    pub fn played(&self, state: &State, run: usize) -> (&'a RunData, Trace) {
        let problem = self.problem(state);
        let data = &problem.runs[run];
        let mut trace = Trace::new();
        simulate(data, &state.params, problem.dt_s, &mut trace);
        for row in &mut trace {
            if state.ideal {
                row[Channel::Position as usize] = row[Channel::Applied as usize];
            }
            row.iter_mut()
                .zip(&state.columns)
                .for_each(|(y, c)| *y *= c);
        }
        (data, trace)
    }

    /// Errors in `channel` at the enabled rows of each run.
    #[must_use]
    pub fn errors(&self, state: &State, channel: Channel) -> Vec<Vec<f64>> {
        let c = channel as usize;
        let one = |r: &usize| {
            let (run, trace) = self.played(state, *r);
            let rows = run.samples.iter().zip(&trace);
            rows.filter(|(s, _)| s.enabled && s.measured[c].is_finite())
                .map(|(s, y)| y[c] - s.measured[c])
                .collect()
        };
        self.runs.iter().map(one).collect()
    }

    /// Root mean square of `channel` by run.
    #[must_use]
    pub fn rmse(&self, state: &State, channel: Channel) -> Vec<f64> {
        let all = self.errors(state, channel);
        all.iter().map(|e| math::rms(e)).collect()
    }
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

/// States from `start` to `end`: the stages of the one replace those of the other in the order of the chain.
fn ladder(start: &State, end: &State) -> Vec<State> {
    let mut now = *start;
    let mut out = vec![now];
    for stage in Stage::JOINT {
        for p in P::ALL.iter().filter(|p| stage_of(**p) == stage) {
            now.params.set(*p, end.params.get(*p));
        }
        match stage {
            Stage::Conventions => now.columns = end.columns,
            Stage::Transport => now.arrived = end.arrived,
            // An ideal servo has no stages before its driver: what the servo model gains over it is the driver's.
            Stage::Driver => now.ideal = false,
            _ => {}
        }
        out.push(now);
    }
    out
}

/// Shares of the gap in `channel` by stage: the stages of the final state replace those of the first one in the order of the
/// chain, and each is given what the error falls by. What is left above the floor is `None`.
#[must_use]
pub fn shares(
    scored: &Scored<'_>,
    [start, end]: [&State; 2],
    channel: Channel,
    floor: f64,
    seed: u64,
) -> Vec<Share> {
    let states = ladder(start, end);
    let ladder: Vec<Vec<f64>> = states.iter().map(|s| scored.rmse(s, channel)).collect();
    let count = scored.runs.len();
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
    let value = of(&(0..count).collect::<Vec<_>>());
    let mut rng = math::Rng::new(seed);
    let draws: Vec<Vec<f64>> = (0..200)
        .map(|_| of(&(0..count).map(|_| rng.index(count)).collect::<Vec<_>>()))
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

/// Errors of a joint by regime of its motion, in the states before and after.
#[must_use]
pub fn regimes(scored: &Scored<'_>, [before, after]: [&State; 2]) -> Vec<RegimeRow> {
    let mut sums = Sums::default();
    for r in scored.runs {
        let (_, first) = scored.played(before, *r);
        let (run, last) = scored.played(after, *r);
        let volts = |s: &Sample| s.measured[Channel::BusVoltage as usize];
        let bus_v: Vec<f64> = run.samples.iter().map(volts).collect();
        let known = bus_v.iter().any(|v| v.is_finite());
        let marks = course(scored.sent, run, &last, |c| {
            c.marks(known.then_some(&bus_v[..]), None)
        });
        for (i, (s, marks)) in run.samples.iter().zip(marks).enumerate() {
            for (of, channel) in [
                (Compared::Position, Channel::Position),
                (Compared::Effort, Channel::Effort),
            ] {
                let measured = s.measured[channel as usize];
                if s.enabled && measured.is_finite() {
                    sums.add(of, false, marks, first[i][channel as usize] - measured);
                    sums.add(of, true, marks, last[i][channel as usize] - measured);
                }
            }
        }
    }
    sums.rows(Some(scored.sent.joint))
}

/// The regime in which the squared error in `channel` of the state before exceeds that of the one after most per sample.
#[must_use]
pub fn regime(scored: &Scored<'_>, [before, after]: [&State; 2], channel: Channel) -> &'static str {
    let mut sum = [0.0; MOTION.len()];
    let mut count = [0.0; MOTION.len()];
    let c = channel as usize;
    for r in scored.runs {
        let (_, a) = scored.played(before, *r);
        let (run, b) = scored.played(after, *r);
        let motion = course(scored.sent, run, &b, |c| c.motion());
        for (i, k) in motion.into_iter().enumerate() {
            let m = run.samples[i].measured[c];
            if m.is_finite() && run.samples[i].enabled {
                sum[k] += (a[i][c] - m).powi(2) - (b[i][c] - m).powi(2);
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
