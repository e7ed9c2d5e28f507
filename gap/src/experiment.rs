//! What to record next: the bench motion that best tells apart what the data at hand could not.
//!
//! Every motion of a menu is played in simulation by the model that was found; each rival is then fitted to that play
//! with all that it may move. What it cannot imitate is what the experiment would show.

use files::dataset::{self, Command, Signal};

use crate::candidates::measured;
use crate::joint::data::{CHANNELS, Edge, RunData, Sample};
use crate::joint::{Channel, Params, Problem, Trace, simulate};
use crate::math;
use crate::vocabulary::Effect;

fn header(signal: Signal, linear: bool) -> &'static str {
    let motion = if linear {
        dataset::Motion::Linear
    } else {
        dataset::Motion::Rotary
    };
    dataset::header_name(signal, motion)
}

/// A motion for a joint on a bench.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Short name.
    pub name: &'static str,
    /// Set-points: time [s], angle [rad] (or [m]); each holds until the next.
    pub setpoints: Vec<(f64, f64)>,
}

impl Motion {
    /// Length, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.setpoints.last().map_or(0.0, |s| s.0)
    }

    /// The motion as a file of the data set's own columns, so that a rig that can replay a run can play it.
    #[must_use]
    pub fn to_csv(&self, linear: bool) -> String {
        let mut out = format!("t_s,{}\n", header(Signal::Setpoint, linear));
        for (t, q) in &self.setpoints {
            out.push_str(&format!("{t:.4},{q:.6}\n"));
        }
        out
    }
}

/// What to record next.
#[derive(Debug, Clone, PartialEq)]
pub struct Experiment {
    /// The motion.
    pub motion: Motion,
    /// Signals to record beside those of this data set.
    pub signals: Vec<Signal>,
    /// Standard deviations between the two explanations that are hardest to tell apart, expected from one recording;
    /// `None` where nothing is to be told apart.
    pub separation: Option<f64>,
}

/// What the joint has been asked for already: the next motion stays inside.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Limits {
    low: f64,
    high: f64,
    /// Largest change from one set-point to the next.
    jump: f64,
    /// Between set-points, s.
    period_s: f64,
}

/// Set-points come this fast at least and at most, s: the gait rate of the robot, and a fast servo loop.
const PERIOD_S: (f64, f64) = (0.005, 0.05);

fn limits(problem: &Problem) -> Option<Limits> {
    let (mut low, mut high, mut jump) = (f64::INFINITY, f64::NEG_INFINITY, 0.0f64);
    let mut periods = Vec::new();
    for run in &problem.runs {
        for c in &run.command {
            low = low.min(*c);
            high = high.max(*c);
        }
        jump = (run.command.windows(2).map(|w| (w[1] - w[0]).abs())).fold(jump, f64::max);
        periods.extend(run.command_t_s.windows(2).map(|w| w[1] - w[0]));
    }
    let period_s = math::median(&periods).clamp(PERIOD_S.0, PERIOD_S.1);
    (high > low && jump > 0.0).then_some(Limits {
        low,
        high,
        jump,
        period_s,
    })
}

/// A wave: phase-less time [s] to a height, -1..1.
type Wave = fn(f64) -> f64;

fn triangle(t: f64, period_s: f64) -> f64 {
    let x = t / period_s - (t / period_s).floor();
    match x {
        _ if x < 0.25 => 4.0 * x,
        _ if x < 0.75 => 2.0 - 4.0 * x,
        _ => 4.0 * x - 4.0,
    }
}

/// The menu: name, length [s], wave. After design of experiments for servos: slow reversals show dead zones and dry
/// friction, steps show limits and delays, a chirp shows lags and inertia, reversals away from the middle show what hangs
/// on load.
const MENU: [(&str, f64, Wave); 6] = [
    ("slow triangle", 24.0, |t| 0.9 * triangle(t, 12.0)),
    ("small reversals", 20.0, |t| 0.12 * triangle(t, 2.5)),
    ("reversals under load", 24.0, |t| {
        let side = if t < 12.0 { 0.7 } else { -0.7 };
        side + 0.2 * triangle(t, 4.0)
    }),
    ("steps", 20.0, |t| {
        const HEIGHTS: [f64; 10] = [0.2, -0.2, 0.5, -0.5, 0.9, -0.9, 0.9, 0.0, 0.1, 0.0];
        HEIGHTS[((t / 2.0) as usize).min(HEIGHTS.len() - 1)]
    }),
    // 0.1 to 2.5 Hz.
    ("chirp", 20.0, |t| {
        0.35 * math::sin(std::f64::consts::TAU * (0.1 * t + 0.06 * t * t))
    }),
    ("fast swings", 16.0, |t| {
        0.9 * math::sin(std::f64::consts::TAU * 0.5 * t)
    }),
];

/// A bit of everything, for a gap that nothing explains.
const SURVEY: (&str, f64, Wave) = ("survey", 40.0, |t| match t {
    _ if t < 12.0 => 0.9 * triangle(t, 12.0),
    _ if t < 24.0 => [0.3, -0.3, 0.8, -0.8, 0.1, 0.0][((t - 12.0) / 2.0) as usize % 6],
    _ => {
        let t = t - 24.0;
        0.35 * math::sin(std::f64::consts::TAU * (0.1 * t + 0.06 * t * t))
    }
});

/// The wave as set-points inside what the joint has been asked for already.
fn motion(item: &(&'static str, f64, Wave), l: &Limits) -> Motion {
    let (name, duration_s, wave) = *item;
    let (middle, half) = (0.5 * (l.low + l.high), 0.5 * (l.high - l.low));
    let mut now = middle;
    let count = (duration_s / l.period_s) as usize;
    let setpoints = (0..=count)
        .map(|i| {
            let t = i as f64 * l.period_s;
            let wanted = if i == count {
                now
            } else {
                middle + half * wave(t)
            };
            now += (wanted - now).clamp(-l.jump, l.jump);
            (t, now)
        })
        .collect();
    Motion { name, setpoints }
}

/// A recording of `motion` with nothing measured yet, on the rig of `problem`.
fn shell(problem: &Problem, motion: &Motion) -> Option<RunData> {
    // 100 Hz shows what the effects of a servo do; slower rigs still show most of it.
    const ROW_S: f64 = 0.01;
    let nominal = problem.runs.first()?.nominal.clone();
    let count = (motion.duration_s() / ROW_S) as usize;
    let samples: Vec<Sample> = (0..count)
        .map(|i| {
            let at = i as f64 * ROW_S / problem.dt_s;
            Sample {
                step: (at + 1e-6) as usize,
                part: (at - (at + 1e-6).floor()).max(0.0),
                enabled: true,
                measured: [f64::NAN; CHANNELS],
            }
        })
        .collect();
    Some(RunData {
        name: motion.name.into(),
        gait: 0,
        repeat: 0,
        role: None,
        nominal,
        command_t_s: motion.setpoints.iter().map(|s| s.0).collect(),
        command: motion.setpoints.iter().map(|s| s.1).collect(),
        curved: false,
        tick_s: f64::INFINITY,
        arrivals: Vec::new(),
        shown_s: Vec::new(),
        arrival_error: 0.0,
        steps: samples.last()?.step + 1,
        samples,
        edges: vec![Edge {
            step: 0,
            enabled: true,
            position: motion.setpoints.first()?.1,
            velocity: 0.0,
        }],
        t0_s: 0.0,
        count: 1.0,
        horizon_s: f64::INFINITY,
    })
}

/// The play of `motion` by `truth`, as data.
fn play(problem: &Problem, motion: &Motion, truth: &Params) -> Option<Problem> {
    let mut run = shell(problem, motion)?;
    let mut trace = Trace::new();
    simulate(&run, truth, problem.dt_s, &mut trace);
    for (s, y) in run.samples.iter_mut().zip(&trace) {
        s.measured = *y;
    }
    Some(Problem {
        runs: vec![run],
        ..problem.clone()
    })
}

/// Signals worth adding, in the order of their price to a lab.
const SIGNALS: [(&[Signal], &[Channel]); 4] = [
    (&[], &[]),
    (&[Signal::Current], &[Channel::Current]),
    (
        &[Signal::Current, Signal::Duty],
        &[Channel::Current, Channel::Duty],
    ),
    (
        &[Signal::Current, Signal::Duty, Signal::LinkPosition],
        &[Channel::Current, Channel::Duty, Channel::Link],
    ),
];

/// A separation that leaves no doubt, in standard deviations: twice the margin below which two effects form a class.
const CLEAR: f64 = 6.0;

/// How far a play of a motion stays away from what else may have caused the gap, in standard deviations; it is given the
/// play, and the channels that would be recorded beside those of the data set.
pub type Judge<'a> = &'a dyn Fn(Problem, &[Channel]) -> f64;

/// The experiment that separates `truth` from its rivals best, with the fewest signals that make it clear.
#[must_use]
pub fn separating(problem: &Problem, truth: &Params, judge: Judge<'_>) -> Option<Experiment> {
    let l = limits(problem).filter(|_| position_command(problem))?;
    let mut best: Option<Experiment> = None;
    for (signals, channels) in SIGNALS {
        let absent = |c: &Channel| !measured(problem, *c);
        if !signals.is_empty() && !channels.iter().any(absent) {
            continue;
        }
        let added: Vec<Channel> = channels.iter().copied().filter(absent).collect();
        for item in &MENU {
            let motion = motion(item, &l);
            let found = judge(play(problem, &motion, truth)?, &added);
            // More signals must earn their price.
            let beaten = |b: &Experiment| {
                let more = signals.len() > b.signals.len();
                found > b.separation.unwrap_or(0.0) * if more { 1.3 } else { 1.0 }
            };
            if best.as_ref().is_none_or(beaten) {
                let own = signals.iter().zip(channels);
                best = Some(Experiment {
                    motion,
                    signals: own.filter(|s| absent(s.1)).map(|s| *s.0).collect(),
                    separation: Some(found),
                });
            }
        }
        if best.as_ref().is_some_and(|b| b.separation > Some(CLEAR)) {
            break;
        }
    }
    best
}

/// The experiment for a gap that nothing explains.
#[must_use]
pub fn survey(problem: &Problem) -> Option<Experiment> {
    let l = limits(problem).filter(|_| position_command(problem))?;
    let wanted = [
        (Signal::Current, Channel::Current),
        (Signal::Duty, Channel::Duty),
    ];
    let absent = wanted.iter().filter(|w| !measured(problem, w.1));
    Some(Experiment {
        motion: motion(&SURVEY, &l),
        signals: absent.map(|w| w.0).collect(),
        separation: None,
    })
}

/// A motion of efforts or voltages would let the joint run away: none is proposed.
fn position_command(problem: &Problem) -> bool {
    let position = |r: &RunData| r.nominal.command == Command::Position;
    problem.runs.iter().all(position)
}

/// One sentence on what to do.
#[must_use]
pub fn words(e: &Experiment, effects: &[Effect], linear: bool) -> String {
    let m = &e.motion;
    let start = m.setpoints.first().map_or(0.0, |s| s.1);
    let start = format!("{:.0} {}", 1e3 * start, if linear { "mm" } else { "mrad" });
    let mut out = format!(
        "Bring the joint to {start} and play the {} of the motion file three times ({:.0} s, within the angles and speeds of the recordings)",
        m.name,
        m.duration_s()
    );
    if !e.signals.is_empty() {
        let names: Vec<&str> = e.signals.iter().map(|s| header(*s, linear)).collect();
        out.push_str(&format!("; record {} too", names.join(" and ")));
    }
    if let Some(s) = e.separation {
        let names: Vec<&str> = effects.iter().map(|e| e.plain()).collect();
        let names = crate::report::words::listed(&names, names.len(), "and");
        out.push_str(&format!(
            ". This distinguishes {names} by about {s:.0} standard deviations"
        ));
    }
    out.push('.');
    out
}
