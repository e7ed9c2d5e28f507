//! A joint's recording, resampled onto the simulation's own steps once, before any fit.

use files::dataset::{Command, Manifest, Output, Recording, Role, Signal};

use super::nominal::{Known, Nominal, known, nominal, run_nominal};
use crate::math;

/// Number of simulated output channels.
pub const CHANNELS: usize = 7;

/// One row of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Simulation step that this row follows.
    pub step: usize,
    /// Part of a step after it, 0..1.
    pub part: f64,
    /// Whether the command is in force.
    pub enabled: bool,
    /// Measured value per [`crate::joint::Channel`], NaN where none.
    pub measured: [f64; CHANNELS],
}

/// A piece of a run without a command, or the start of one with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// Step at which it happens.
    pub step: usize,
    /// Command in force from here on.
    pub enabled: bool,
    /// Measured position to restart from.
    pub position: f64,
    /// Measured speed to restart from.
    pub velocity: f64,
}

/// One run of one joint.
#[derive(Debug, Clone, PartialEq)]
pub struct RunData {
    /// File name.
    pub name: String,
    /// Group of runs with the same gait.
    pub gait: usize,
    /// Group of runs that repeat each other.
    pub repeat: usize,
    /// Use.
    pub role: Option<Role>,
    /// Nominal values.
    pub nominal: Nominal,
    /// Times of set-point changes, s from the first row.
    pub command_t_s: Vec<f64>,
    /// Set-points at those times.
    pub command: Vec<f64>,
    /// The set-points follow a curve, tick by tick; not steps now and then.
    pub curved: bool,
    /// Interval at which set-points are sent, s; infinite where no run shows it.
    pub tick_s: f64,
    /// Set-points that arrived, by the driver's echo; empty where it was not measured.
    pub arrivals: Vec<super::arrival::Arrival>,
    /// Instants of the first rows that echo each set-point; empty unless every one of them is echoed once.
    pub shown_s: Vec<f64>,
    /// Disagreement between echoed and sent set-points, beside one straight line.
    pub arrival_error: f64,
    /// Rows.
    pub samples: Vec<Sample>,
    /// Enable edges, the first at step 0.
    pub edges: Vec<Edge>,
    /// Steps to simulate.
    pub steps: usize,
    /// Time of row 0 on the device clock, s.
    pub t0_s: f64,
    /// Recordings that were averaged into this one.
    pub count: f64,
    /// Horizon over which positions are predicted from those before, s; infinite: played from the set-points alone.
    pub horizon_s: f64,
}

/// Everything the fit needs to know of one joint.
#[derive(Debug, Clone)]
pub struct Problem {
    /// Joint index.
    pub joint: usize,
    /// Step, s.
    pub dt_s: f64,
    /// What is known.
    pub known: Known,
    /// Runs in file order.
    pub runs: Vec<RunData>,
    /// Names of gaits by group.
    pub gaits: Vec<String>,
    /// Rotary or linear, for units in text.
    pub linear: bool,
    /// Resolution of the position column.
    pub position_quantum: f64,
    /// Range of the measured positions (5 % to 95 %).
    pub range: f64,
    /// Distance of set-point and position, 95 % quantile.
    pub distance: f64,
}

/// Largest and smallest step: coarse enough to be fast, fine enough for joints up to about 100 rad/s of bandwidth.
const DT_RANGE_S: (f64, f64) = (0.0005, 0.002);

/// A step short against the joint's fastest loop.
fn stable_step_s(n: &Nominal) -> f64 {
    // Part of the loop's time constant that one explicit step may take.
    const PART: f64 = 0.4;
    let per_output = match n.output {
        Output::Duty => n.stall,
        Output::Voltage => n.stall / n.supply_v,
        _ => 1.0,
    };
    let damping = (n.kd * per_output + n.stall / n.no_load_speed) / n.inertia;
    let stiffness = (n.kp * per_output / n.inertia).sqrt();
    PART / damping.max(stiffness).max(1e-3)
}

/// Median time between positions. Rows of other signals may lie as close together as they like.
fn row_step_s(recordings: &[Recording], joint: usize) -> f64 {
    // Positions closer than this are one instant written twice.
    const SAME_S: f64 = 1e-4;
    let step = |r: &Recording| {
        let position = r.joint(joint).and_then(|j| j.get(Signal::Position))?;
        let rows = r.t_s().iter().zip(position).filter(|(_, p)| p.is_finite());
        let times: Vec<f64> = rows.map(|(t, _)| *t).collect();
        let steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
        let apart: Vec<f64> = steps.into_iter().filter(|d| *d > SAME_S).collect();
        (!apart.is_empty()).then(|| math::median(&apart))
    };
    let steps: Vec<f64> = recordings.iter().filter_map(step).collect();
    if steps.is_empty() {
        return DT_RANGE_S.1;
    }
    math::median(&steps)
}

impl Problem {
    /// Takes joint `joint` out of a data set. `None` if that joint has no position column at all.
    #[must_use]
    pub fn new(manifest: &Manifest, recordings: &[Recording], joint: usize) -> Option<Self> {
        let repeats = files::dataset::repeat_groups(manifest, recordings);
        let step_s = row_step_s(recordings, joint);
        let mut gaits: Vec<String> = Vec::new();
        let mut runs = Vec::new();
        let mut quantum = 0.0;
        let first = manifest.runs.first()?;
        let reference = nominal(&first.bench);
        let period_s = first
            .bench
            .controller
            .period_s
            .map_or(f64::INFINITY, |p| p.value);
        let dt_s = (step_s / 5.0)
            .min(if period_s.is_finite() {
                // A sampled loop is what it is at its own period; the plant between is exact enough.
                period_s
            } else {
                stable_step_s(&reference)
            })
            .clamp(DT_RANGE_S.0, DT_RANGE_S.1);
        // A whole number of steps per row: rows and set-points of one cyclic loop then fall onto steps.
        let dt_s = step_s / (step_s / dt_s - 1e-6).ceil().max(1.0);
        for ((run, rec), repeat) in manifest.runs.iter().zip(recordings).zip(&repeats) {
            let gait = gaits
                .iter()
                .position(|g| *g == run.gait)
                .unwrap_or_else(|| {
                    gaits.push(run.gait.clone());
                    gaits.len() - 1
                });
            let mut data = run_data(rec, joint, dt_s, run_nominal(&run.bench, &reference));
            (data.name, data.gait, data.repeat, data.role) =
                (run.file.clone(), gait, *repeat, run.role);
            if let Some(q) = rec
                .joint(joint)
                .and_then(|j| j.get(Signal::Position))
                .map(files::dataset::quantum)
            {
                quantum = if quantum > 0.0 {
                    f64::min(quantum, q)
                } else {
                    q
                };
            }
            runs.push(data);
        }
        curved(&mut runs);
        if first.bench.command == Command::Position {
            let travel = super::stop::travel(&runs, dt_s);
            runs.iter_mut().for_each(|r| r.nominal.travel = travel);
        }
        let any = runs
            .iter()
            .any(|r: &RunData| r.samples.iter().any(|s| s.measured[0].is_finite()));
        let mut known = known(&first.bench);
        let effort = |r: &RunData| r.samples.iter().any(|s| s.measured[5].is_finite());
        known.effort_unit |= runs.iter().any(effort);
        let (range, distance) = sizes(&runs, dt_s);
        any.then(|| Self {
            range,
            distance,
            joint,
            dt_s,
            known,
            runs,
            gaits,
            linear: manifest.bench.motion == files::dataset::Motion::Linear,
            position_quantum: quantum,
        })
    }
}

/// Range of the positions, and their distance from the set-points in force.
fn sizes(runs: &[RunData], dt_s: f64) -> (f64, f64) {
    let (mut positions, mut distances) = (Vec::new(), Vec::new());
    for run in runs {
        let mut k = 0;
        for s in &run.samples {
            let t = (s.step as f64 + s.part) * dt_s;
            while run.command_t_s.get(k + 1).is_some_and(|c| *c <= t) {
                k += 1;
            }
            let q = s.measured[0];
            if s.enabled && q.is_finite() {
                positions.push(q);
                distances.extend(run.command.get(k).map(|c| (c - q).abs()));
            }
        }
    }
    let quantile = |v: &[f64], q: f64| {
        if v.is_empty() {
            0.0
        } else {
            math::quantile(v, q)
        }
    };
    let range = quantile(&positions, 0.95) - quantile(&positions, 0.05);
    (range.max(1e-6), quantile(&distances, 0.95).max(1e-6))
}

/// Marks the runs whose set-points change at (nearly) every tick of the one who sends them.
fn curved(runs: &mut [RunData]) {
    let interval = |r: &RunData| {
        let gaps: Vec<f64> = r.command_t_s.windows(2).map(|w| w[1] - w[0]).collect();
        if gaps.len() < 4 {
            f64::INFINITY
        } else {
            math::median(&gaps)
        }
    };
    let tick = runs.iter().map(interval).fold(f64::INFINITY, f64::min);
    for r in runs {
        let own = interval(r);
        r.curved = own.is_finite() && own <= 1.5 * tick;
        r.tick_s = tick;
    }
}

fn run_data(rec: &Recording, joint: usize, dt_s: f64, nominal: Nominal) -> RunData {
    let empty = files::dataset::JointColumns::default();
    let j = rec.joint(joint).unwrap_or(&empty);
    let t = rec.t_s();
    let t0_s = t[0];
    let column = |s| j.get(s);
    let at = |c: Option<&[f64]>, i: usize| c.map_or(f64::NAN, |c| c[i]);
    let command = column(Signal::Setpoint)
        .or(column(Signal::AppliedSetpoint))
        .unwrap_or_default();
    let position = column(Signal::Position);
    // Where the controller asks for an effort or a speed, the voltage that gives it is no part of the model.
    let volts = matches!(nominal.output, Output::Duty | Output::Voltage);
    let channels = [
        position,
        column(Signal::Current),
        column(Signal::Duty).filter(|_| volts),
        rec.body().bus_v.as_deref().filter(|_| volts),
        column(Signal::LinkPosition),
        column(Signal::Effort),
        column(Signal::AppliedSetpoint).filter(|_| column(Signal::Setpoint).is_some()),
    ];
    let mut enabled = true;
    let mut samples = Vec::with_capacity(t.len());
    let mut edges: Vec<Edge> = Vec::new();
    for i in 0..t.len() {
        let at_s = t[i] - t0_s;
        let e = at(column(Signal::Enable), i);
        enabled = if e.is_nan() { enabled } else { e > 0.5 };
        // The small part keeps a row that falls onto a step in that step.
        let step = (at_s / dt_s + 1e-6) as usize;
        if edges.last().is_none_or(|l| l.enabled != enabled) {
            let near = state_near(t, position, column(Signal::Velocity), i);
            // A run without its response stands where the first set-point says.
            let asked = |c: &f64| (*c, 0.0);
            let first = command.iter().skip(i).find(|c| c.is_finite());
            let first = first.filter(|_| nominal.command == Command::Position);
            let (p, v) = near.or(first.map(asked)).unwrap_or_default();
            edges.push(Edge {
                step,
                enabled,
                position: p,
                velocity: v,
            });
        }
        let measured = channels.map(|c| at(c, i));
        samples.push(Sample {
            step,
            part: (at_s / dt_s - step as f64).max(0.0),
            enabled,
            measured,
        });
    }
    let (command_t_s, commands) = super::instants::sent(t, command);
    let steps = samples.last().map_or(0, |s| s.step + 1);
    let (arrivals, arrival_error) =
        super::arrival::arrivals(&samples, &command_t_s, &commands, dt_s);
    let shown_s = super::arrival::shown(&samples, commands.len(), dt_s);
    mask_edges(&mut samples, &command_t_s, dt_s);
    RunData {
        name: String::new(),
        gait: 0,
        repeat: 0,
        role: None,
        nominal,
        command_t_s,
        command: commands,
        curved: false,
        tick_s: f64::INFINITY,
        arrivals,
        arrival_error,
        shown_s,
        samples,
        edges,
        steps,
        t0_s,
        count: 1.0,
        horizon_s: f64::INFINITY,
    }
}

/// Drops electrical samples that fall onto a set-point edge: whether they were taken before or after it is not known.
/// Not where (nearly) every row has an edge; nothing would be left.
fn mask_edges(samples: &mut [Sample], edges_s: &[f64], dt_s: f64) {
    let mut k = 0;
    let mut at_edge = |s: &Sample| {
        let t = (s.step as f64 + s.part) * dt_s;
        while k + 1 < edges_s.len() && edges_s[k + 1] < t - 1.5 * dt_s {
            k += 1;
        }
        let near = |e: Option<&f64>| e.is_some_and(|e| (e - t).abs() <= 1.5 * dt_s);
        near(edges_s.get(k)) || near(edges_s.get(k + 1))
    };
    let masked: Vec<bool> = samples.iter().map(&mut at_edge).collect();
    if masked.iter().filter(|m| **m).count() * 3 > 2 * samples.len() {
        return;
    }
    for (s, _) in samples.iter_mut().zip(masked).filter(|(_, m)| *m) {
        for c in [1, 2, 3, 5, 6] {
            s.measured[c] = f64::NAN;
        }
    }
}

/// Position and speed at row `i`: the next sample at or after it, speed measured or from a short difference; `None` if there is none.
fn state_near(
    t: &[f64],
    position: Option<&[f64]>,
    velocity: Option<&[f64]>,
    i: usize,
) -> Option<(f64, f64)> {
    let next = |c: &[f64], from: usize| (from..c.len()).find(|k| c[*k].is_finite());
    let p = position?;
    let a = next(p, i)?;
    let v = match velocity.and_then(|v| next(v, i).map(|k| v[k])) {
        Some(v) => v,
        None => next(p, a + 1)
            .filter(|b| t[*b] > t[a])
            .map_or(0.0, |b| (p[b] - p[a]) / (t[b] - t[a])),
    };
    // A run starts at rest unless the first samples say otherwise beyond a doubt.
    Some((p[a], if i == 0 && v.abs() < 0.05 { 0.0 } else { v }))
}
