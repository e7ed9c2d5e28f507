//! Where, from measured signals alone: every stage of the servo is fed with what was measured at its input and judged by
//! what was measured at its output.
//!
//! The same is done with a play of the model, sampled at the same instants: what sampling and smoothing do to a residual
//! is alike in both and goes away in the difference. All residuals are in parts of the full duty, the unit in which the
//! stages of a position servo can be compared: what the loop must put out to make up for them.
//!
//! Where runs were repeated, only what the repeats have in common counts: noise and disturbances differ between them, so the
//! product of their residuals has no share of these. A loop that swings by itself swings in another phase every time; there
//! the whole residual counts.

use files::dataset::Output;

use crate::candidates::{effort_per_ampere, measured};
use crate::joint::data::RunData;
use crate::joint::merge::alike;
use crate::joint::swing::swings;
use crate::joint::{Channel, Params, Problem, Trace, simulate};
use crate::locate::Share;
use crate::math;
use crate::select::PULL;
use crate::vocabulary::Stage;

/// Rows over which the residuals of one run are averaged to each side: one set-point period of the robot in rows of 100 Hz.
const SMOOTH: usize = 2;

/// The same where repeats tell what is noise: less, for a loop that sees its encoder late rings at tens of hertz.
const SMOOTH_REPEATED: usize = 1;

/// Turns of the position that count as swings, in parts of the range of the motion: above the noise of an encoder, below the
/// swings of a loop that saturates.
const SWING: f64 = 0.005;

/// What a stage's law leaves, and the columns by which its constants may move within their tolerances.
struct Residual {
    stage: Stage,
    rest: Vec<f64>,
    columns: Vec<(Vec<f64>, f64)>,
}

/// Value, slope and curvature at every row, by differences of fourth order over five equally spaced rows: short, so that a swing
/// of ten rows keeps its size beside the signals that are not differentiated.
fn motion(y: &[f64], dt_s: f64) -> Vec<[f64; 3]> {
    let last = y.len().saturating_sub(1);
    let at = |i: usize, k: usize| y[(i + k).saturating_sub(2).min(last)];
    (0..y.len())
        .map(|i| {
            let [a, b, c, d, e] = std::array::from_fn(|k| at(i, k));
            [
                c,
                (a - 8.0 * b + 8.0 * d - e) / (12.0 * dt_s),
                (16.0 * (b + d) - (a + e) - 30.0 * c) / (12.0 * dt_s * dt_s),
            ]
        })
        .collect()
}

/// Mean over the finite neighbours.
fn smooth(y: &[f64], half: usize) -> Vec<f64> {
    (0..y.len())
        .map(|i| {
            let near = &y[i.saturating_sub(half)..(i + half + 1).min(y.len())];
            let finite = near.iter().filter(|v| v.is_finite());
            let (sum, n) = finite.fold((0.0, 0), |(s, n), v| (s + v, n + 1));
            if n > 0 { sum / f64::from(n) } else { f64::NAN }
        })
        .collect()
}

/// Channels of a run as columns, measured or simulated.
struct Signals([Vec<f64>; 7]);

impl Signals {
    fn of(&self, c: Channel) -> &[f64] {
        &self.0[c as usize]
    }

    /// Bus voltage over the nominal one; 1 where it was not sampled.
    fn bus(&self, supply_v: f64) -> Vec<f64> {
        let one = |v: &f64| if v.is_finite() { v / supply_v } else { 1.0 };
        self.of(Channel::BusVoltage).iter().map(one).collect()
    }

    fn measured(run: &RunData) -> Self {
        let column = |k: usize| run.samples.iter().map(|s| s.measured[k]).collect();
        Self(std::array::from_fn(column))
    }

    fn simulated(trace: &Trace) -> Self {
        Self(std::array::from_fn(|k| {
            trace.iter().map(|y| y[k]).collect()
        }))
    }
}

/// Set-points as sent at the rows of a run.
fn sent(run: &RunData, dt_s: f64) -> Vec<f64> {
    let mut k = 0;
    let at = |s: &crate::joint::Sample| (s.step as f64 + s.part) * dt_s;
    run.samples
        .iter()
        .map(|s| {
            while k + 1 < run.command_t_s.len() && run.command_t_s[k + 1] <= at(s) + 1e-6 {
                k += 1;
            }
            run.command.get(k).copied().unwrap_or(f64::NAN)
        })
        .collect()
}

fn zip(n: usize, f: impl Fn(usize) -> f64) -> Vec<f64> {
    (0..n).map(f).collect()
}

/// Driver, motor and drivetrain: laws between duty, current and motion.
fn laws(problem: &Problem, run: &RunData, s: &Signals, applied: &[f64]) -> [Residual; 3] {
    let n = &run.nominal;
    let rows = run.samples.len();
    let kt = effort_per_ampere(problem, &Params::default());
    let ohm = kt * n.supply_v / n.stall;
    let known = &problem.known;
    let q = s.of(Channel::Position);
    let motion = motion(q, (run.steps as f64 * problem.dt_s) / rows as f64);
    let (duty, current) = (s.of(Channel::Duty), s.of(Channel::Current));
    let bus = s.bus(n.supply_v);
    let error = |i: usize| n.kp * (applied[i] - q[i]);
    let damping = |i: usize| n.kd * motion[i][1];
    let law = |i: usize| (error(i) - damping(i)).clamp(-n.limit, n.limit);
    let late = |i: usize| n.kd * n.period_s * motion[i][2];
    let driven = |i: usize| duty[i] * bus[i];
    let back = |i: usize| kt * motion[i][1] / n.supply_v;
    let torque = |i: usize| current[i] * ohm / n.supply_v;
    let inertia = |i: usize| n.inertia * motion[i][2] / n.stall;
    let weight = |i: usize| n.gravity * math::sin(motion[i][0]) / n.stall;
    let column = |f: &dyn Fn(usize) -> f64, t: Option<f64>| (zip(rows, f), t.unwrap_or(0.05));
    // Gains are numbers in a register: 1 %. A sampled loop sees the speed a period late, give or take one.
    let exact = |t: Option<f64>| Some(t.unwrap_or(0.01).min(0.01));
    [
        Residual {
            stage: Stage::Driver,
            rest: zip(rows, |i| duty[i] - law(i)),
            columns: vec![
                column(&error, exact(known.kp)),
                column(&damping, exact(known.kd)),
                column(&late, Some(1.0)),
            ],
        },
        Residual {
            stage: Stage::Electrical,
            rest: zip(rows, |i| torque(i) - (driven(i) - back(i))),
            columns: vec![column(&driven, known.stall), column(&back, known.speed)],
        },
        Residual {
            stage: Stage::Drivetrain,
            rest: zip(rows, |i| torque(i) - inertia(i) - weight(i)),
            columns: vec![
                column(&torque, known.speed),
                column(&inertia, known.inertia),
                column(&weight, known.gravity),
            ],
        },
    ]
}

/// The stages' residuals on one set of signals.
fn residuals(problem: &Problem, run: &RunData, s: &Signals) -> Vec<Residual> {
    let n = &run.nominal;
    let rows = run.samples.len();
    let sent = sent(run, problem.dt_s);
    let echoed = measured(problem, Channel::Applied);
    let applied = if echoed {
        s.of(Channel::Applied)
    } else {
        &sent
    };
    let mut out: Vec<Residual> = laws(problem, run, s, applied).into();
    if measured(problem, Channel::BusVoltage) {
        let (duty, bus) = (s.of(Channel::Duty), s.bus(n.supply_v));
        out.push(Residual {
            stage: Stage::Supply,
            rest: zip(rows, |i| duty[i] * (bus[i] - 1.0)),
            columns: vec![(duty.to_vec(), problem.known.supply.unwrap_or(0.05))],
        });
    }
    if echoed {
        out.push(Residual {
            stage: Stage::Transport,
            rest: zip(rows, |i| n.kp * (applied[i] - sent[i])),
            columns: Vec::new(),
        });
    }
    if measured(problem, Channel::Link) {
        let (link, q) = (s.of(Channel::Link), s.of(Channel::Position));
        out.push(Residual {
            stage: Stage::Transmission,
            rest: zip(rows, |i| n.kp * (link[i] - q[i])),
            // A zero of two milliradians between two encoders is no finding.
            columns: vec![(vec![n.kp; rows], 0.002)],
        });
    }
    out
}

/// `y` once `columns` have taken what they may within their tolerances; not a number where one of them is none.
fn beyond(y: &[f64], columns: &[(Vec<f64>, f64)], independent: f64) -> Vec<f64> {
    let mut out = vec![f64::NAN; y.len()];
    let used: Vec<usize> = (0..y.len())
        .filter(|i| y[*i].is_finite() && columns.iter().all(|c| c.0[*i].is_finite()))
        .collect();
    if used.len() < 20 {
        return out;
    }
    let n = used.len() as f64;
    let mut rest: Vec<f64> = used.iter().map(|i| y[*i]).collect();
    let mut beta = vec![0.0; columns.len()];
    // Each column in turn, towards its optimum under its tolerance; a handful of rounds settles four columns.
    for _ in 0..30 {
        let size = rest.iter().map(|r| r * r).sum::<f64>() / n;
        for ((column, sigma), b) in columns.iter().zip(&mut beta) {
            let (mut xy, mut xx) = (0.0, 0.0);
            for (r, i) in rest.iter().zip(&used) {
                xy += r * column[*i];
                xx += column[*i] * column[*i];
            }
            let weight = independent / (n * size.max(1e-18));
            let prior = 1.0 / (sigma * sigma);
            let best = *b + (weight * xy - prior * *b) / (weight * xx + prior);
            let next = best.clamp(-PULL * sigma, PULL * sigma);
            for (r, i) in rest.iter_mut().zip(&used) {
                *r -= (next - *b) * column[*i];
            }
            *b = next;
        }
    }
    for (r, i) in rest.iter().zip(used) {
        out[i] = *r;
    }
    out
}

fn mean_square(y: &[f64]) -> f64 {
    let finite = y.iter().filter(|r| r.is_finite());
    let (sum, n) = finite.fold((0.0, 0.0), |(s, n), r| (s + r * r, n + 1.0));
    sum / f64::max(n, 1.0)
}

/// Mean square of one residual beyond its fast noise.
fn without_noise(y: &[f64]) -> f64 {
    let finite: Vec<f64> = y.iter().copied().filter(|r| r.is_finite()).collect();
    let second: Vec<f64> = finite
        .windows(3)
        .map(|w| (w[0] - 2.0 * w[1] + w[2]).powi(2))
        .collect();
    // Second differences of smoothed noise of variance v have the variance 2 v (window of five).
    (mean_square(&finite) - 0.5 * math::median(&second) / 0.455).max(0.0)
}

/// Mean product of the residuals of different repeats.
fn in_common(repeats: &[&[f64]]) -> f64 {
    let n = repeats.len() as f64;
    let rows = repeats.iter().map(|r| r.len()).min().unwrap_or(0);
    let product = |i: usize| {
        let (sum, squares) =
            (repeats.iter().map(|r| r[i])).fold((0.0, 0.0), |(s, q), r| (s + r, q + r * r));
        (sum * sum - squares) / (n * (n - 1.0))
    };
    let finite: Vec<f64> = (0..rows).map(product).filter(|p| p.is_finite()).collect();
    math::mean(&finite).max(0.0)
}

/// Splits what a residual holds into what a straight line of the set-point explains and the rest.
fn conventions(y: &[f64], sent: &[f64]) -> f64 {
    let used: Vec<usize> = (0..y.len())
        .filter(|i| y[*i].is_finite() && sent[*i].is_finite())
        .collect();
    let n = used.len().max(1) as f64;
    let mean = |v: &[f64]| used.iter().map(|i| v[*i]).sum::<f64>() / n;
    let (my, mx) = (mean(y), mean(sent));
    let (mut xy, mut xx, mut yy) = (0.0, 1e-12, 1e-18);
    for i in &used {
        xy += (sent[*i] - mx) * (y[*i] - my);
        xx += (sent[*i] - mx).powi(2);
        yy += y[*i] * y[*i];
    }
    ((n * my * my + xy * xy / xx) / yy).clamp(0.0, 1.0)
}

/// Rows at which a new set-point is in force. Duty is already the new one there, current and motion still the old ones.
fn edges(applied: &[f64]) -> Vec<bool> {
    let new = |i: usize| i > 0 && applied[i] != applied[i - 1];
    let out: Vec<bool> = (0..applied.len()).map(new).collect();
    // A set-point that is new in every other row is not held.
    if 2 * out.iter().filter(|e| **e).count() > out.len() {
        return vec![false; out.len()];
    }
    out
}

/// What `model` leaves of each stage's law in one run, row by row.
fn left(
    problem: &Problem,
    run: &RunData,
    model: &Params,
    independent: f64,
    half: usize,
) -> Vec<(Stage, Vec<f64>)> {
    let play = |p: &Params| {
        let mut trace = Trace::new();
        simulate(run, p, problem.dt_s, &mut trace);
        residuals(problem, run, &Signals::simulated(&trace))
    };
    let signals = Signals::measured(run);
    let (ours, stated) = (play(model), play(&Params::default()));
    let applied = if measured(problem, Channel::Applied) {
        signals.of(Channel::Applied).to_vec()
    } else {
        sent(run, problem.dt_s)
    };
    let edges = edges(&applied);
    let real = residuals(problem, run, &signals).into_iter();
    real.zip(ours.iter().zip(&stated))
        .map(|(m, (ours, stated))| {
            if m.stage == Stage::Transport {
                return (m.stage, smooth(&m.rest, half));
            }
            let mut rest = smooth(&zip(m.rest.len(), |i| m.rest[i] - ours.rest[i]), half);
            for (r, _) in rest.iter_mut().zip(&edges).filter(|(_, edge)| **edge) {
                *r = f64::NAN;
            }
            // What sampling does grows with the motion: as much of it again, give or take.
            let sampling = [(stated.rest.clone(), 1.0)];
            let columns: Vec<(Vec<f64>, f64)> = (m.columns.into_iter().chain(sampling))
                .map(|c| (smooth(&c.0, half), c.1))
                .collect();
            (m.stage, beyond(&rest, &columns, independent))
        })
        .collect()
}

/// What `model` leaves in `runs`, repeats of one stimulus or one run, by stage: mean squares in parts of the full duty.
fn energies(problem: &Problem, runs: &[usize], model: &Params, independent: f64) -> [f64; 7] {
    let repeated = runs.len() > 1;
    let half = if repeated { SMOOTH_REPEATED } else { SMOOTH };
    let one = |r: &usize| left(problem, &problem.runs[*r], model, independent, half);
    let all: Vec<Vec<(Stage, Vec<f64>)>> = runs.iter().map(one).collect();
    let swing = |r: &usize| swings(&problem.runs[*r], problem.dt_s, SWING * problem.range);
    let swinging = runs.iter().any(swing);
    let mut out = [0.0; 7];
    let place = |s: Stage| Stage::JOINT.iter().position(|x| *x == s).unwrap_or(0);
    for (k, (stage, first)) in all[0].iter().enumerate() {
        let rest: Vec<&[f64]> = all.iter().map(|a| a[k].1.as_slice()).collect();
        let found = match (swinging, repeated) {
            (true, _) => math::mean(&rest.iter().map(|r| mean_square(r)).collect::<Vec<_>>()),
            (false, true) => in_common(&rest),
            (false, false) => without_noise(first),
        };
        let straight = if *stage == Stage::Transport {
            conventions(first, &sent(&problem.runs[runs[0]], problem.dt_s))
        } else {
            0.0
        };
        out[place(*stage)] += found * (1.0 - straight);
        out[place(Stage::Conventions)] += found * straight;
    }
    out
}

/// `runs` with repeats of one stimulus together.
fn repeats(problem: &Problem, runs: &[usize]) -> Vec<Vec<usize>> {
    let mut out: Vec<Vec<usize>> = Vec::new();
    for r in runs {
        let same = |g: &&mut Vec<usize>| alike(&problem.runs[g[0]], &problem.runs[*r]);
        match out.iter_mut().find(same) {
            Some(group) => group.push(*r),
            None => out.push(vec![*r]),
        }
    }
    out
}

/// Whether the stages of this joint can be judged: duty and current measured, a servo on a duty with known constants.
fn can_tell(problem: &Problem, runs: &[usize]) -> bool {
    let servo = |r: &usize| {
        let n = &problem.runs[*r].nominal;
        n.output == Output::Duty && n.ki == 0.0 && n.no_load_speed.is_finite()
    };
    let k = &problem.known;
    let constants = [k.kp, k.stall, k.inertia, k.gravity]
        .iter()
        .all(Option::is_some);
    let signals = [Channel::Duty, Channel::Current]
        .iter()
        .all(|c| measured(problem, *c));
    constants && signals && runs.iter().all(servo)
}

/// Shares of what `model` leaves in `runs`, by the stage whose own law is broken in the measured signals, largest first,
/// with intervals over runs; they sum to 1. `None` where the signals cannot tell.
#[must_use]
pub fn shares(
    problem: &Problem,
    runs: &[usize],
    model: &Params,
    independent: f64,
    seed: u64,
) -> Option<Vec<Share>> {
    if !can_tell(problem, runs) || runs.is_empty() {
        return None;
    }
    let each = independent / runs.len() as f64;
    let groups = repeats(problem, runs);
    // A group counts as often as it was recorded.
    let one = |g: &Vec<usize>| energies(problem, g, model, each).map(|e| e * g.len() as f64);
    let all: Vec<[f64; 7]> = groups.iter().map(one).collect();
    let of = |pick: &[usize], k: usize| {
        let sum = |k: usize| pick.iter().map(|i| all[*i][k]).sum::<f64>();
        let total: f64 = (0..7).map(sum).sum();
        sum(k) / total.max(1e-300)
    };
    let every: Vec<usize> = (0..groups.len()).collect();
    if (0..7).all(|k| of(&every, k) == 0.0) {
        return None;
    }
    let mut rng = math::Rng::new(seed);
    let draws: Vec<Vec<usize>> = (0..200)
        .map(|_| every.iter().map(|_| rng.index(groups.len())).collect())
        .collect();
    let row = |k: usize| {
        let column: Vec<f64> = draws.iter().map(|d| of(d, k)).collect();
        Share {
            stage: Some(Stage::JOINT[k]),
            share: of(&every, k),
            ci95: [
                math::quantile(&column, 0.025),
                math::quantile(&column, 0.975),
            ],
        }
    };
    let mut out: Vec<Share> = (0..7).map(row).filter(|s| s.share > 0.0).collect();
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    Some(out)
}
