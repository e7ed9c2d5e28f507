//! The forward model of one joint. Semi-implicit Euler; friction as a clipped stop-effort, so it holds without chatter.

use files::dataset::{Command, Output};

use super::data::{CHANNELS, RunData};
use super::param::{P, Params};
use crate::math;

/// A simulated signal that may have been measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Channel {
    /// Encoder angle.
    Position,
    /// Motor current.
    Current,
    /// Controller output as a share of the supply.
    Duty,
    /// Bus voltage.
    BusVoltage,
    /// Link angle.
    Link,
    /// Motor effort.
    Effort,
    /// Set-point as applied.
    Applied,
}

impl Channel {
    /// All channels, in the order of [`super::Sample::measured`].
    pub const ALL: [Self; CHANNELS] = [
        Self::Position,
        Self::Current,
        Self::Duty,
        Self::BusVoltage,
        Self::Link,
        Self::Effort,
        Self::Applied,
    ];
}

/// Simulated channels at the rows of a run.
pub type Trace = Vec<[f64; CHANNELS]>;

/// Walks the held set-points; gives their mean over a window, so that a delay shorter than a step still counts.
struct Commands<'a> {
    t: &'a [f64],
    v: &'a [f64],
    index: usize,
    last_s: f64,
}

impl<'a> Commands<'a> {
    fn new(run: &'a RunData, start_s: f64) -> Self {
        let mut c = Self {
            t: &run.command_t_s,
            v: &run.command,
            index: 0,
            last_s: f64::MIN,
        };
        c.last_s = start_s;
        while c.t.get(c.index + 1).is_some_and(|t| *t <= start_s) {
            c.index += 1;
        }
        c
    }

    fn mean_to(&mut self, to_s: f64) -> f64 {
        let held = |i: usize| self.v.get(i).copied().unwrap_or(0.0);
        let span = to_s - self.last_s;
        if span <= 0.0 {
            return held(self.index);
        }
        let (mut sum, mut from) = (0.0, self.last_s);
        while let Some(next) = self.t.get(self.index + 1).copied().filter(|t| *t <= to_s) {
            sum += held(self.index) * (next.max(from) - from);
            from = next.max(from);
            self.index += 1;
        }
        sum += held(self.index) * (to_s - from);
        self.last_s = to_s;
        sum / span
    }
}

/// Parameters of a run, resolved to absolute values once.
struct Model {
    dt: f64,
    inertia: f64,
    gravity: f64,
    /// Effort per volt.
    gv: f64,
    /// Effort per speed lost to the back-EMF.
    ge: f64,
    /// Effort per ampere.
    kt: f64,
    supply: f64,
    kp: f64,
    ki: f64,
    kd: f64,
    lag: f64,
    limit: f64,
    effort_limit: f64,
    speed_limit: f64,
    delay_steps: f64,
}

fn resolve(run: &RunData, p: &Params, dt: f64) -> Model {
    let n = &run.nominal;
    let (m, r) = (p.get(P::Motor), p.get(P::Resistance).max(1e-6));
    let volts = n.supply_v.max(1e-9);
    let kt_nominal = if n.no_load_speed.is_finite() {
        volts / n.no_load_speed
    } else {
        n.stall / volts
    };
    let lag = p.get(P::Lag).max(0.0);
    let kt = kt_nominal * m;
    Model {
        dt,
        inertia: (n.inertia * p.get(P::Inertia)).max(1e-12),
        gravity: n.gravity * p.get(P::Gravity) + p.get(P::Weight),
        gv: n.stall / volts * m / r,
        ge: n.stall / n.no_load_speed * m * m / r,
        kt,
        supply: n.supply_v * p.get(P::Supply),
        kp: n.kp * p.get(P::LoopGain),
        ki: n.ki,
        kd: n.kd * p.get(P::Damping),
        lag: if lag > 0.0 { dt / (lag + dt) } else { 1.0 },
        limit: n.limit,
        effort_limit: n
            .effort_limit
            .min(p.get(P::TorqueLimit))
            .min(p.get(P::CurrentLimit) * kt),
        speed_limit: n.speed_limit,
        delay_steps: (p.get(P::FeedbackDelay) / dt).max(0.0),
    }
}

/// What the loop carries from step to step.
struct State {
    q: f64,
    dq: f64,
    integral: f64,
    actuator: f64,
    slewed: f64,
    output: f64,
    link: f64,
    drive: Drive,
    effort: f64,
    history: Vec<(f64, f64)>,
    at: usize,
}

/// Electrical quantities of a step.
#[derive(Clone, Copy, Default)]
struct Drive {
    duty: f64,
    bus: f64,
    command: f64,
}

impl State {
    fn new(run: &RunData, m: &Model) -> Self {
        let e = run.edges.first().copied();
        let (q, dq) = e.map_or((0.0, 0.0), |e| (e.position, e.velocity));
        let first = run.command.first().copied().unwrap_or(q);
        let depth = m.delay_steps.ceil() as usize + 2;
        Self {
            q,
            dq,
            integral: 0.0,
            actuator: 0.0,
            slewed: first,
            output: q,
            link: q,
            drive: Drive {
                duty: 0.0,
                bus: m.supply,
                command: first,
            },
            effort: 0.0,
            history: vec![(q, dq); depth],
            at: 0,
        }
    }

    /// Encoder as the controller sees it.
    fn feedback(&mut self, m: &Model) -> (f64, f64) {
        let q = self.q;
        if m.delay_steps <= 0.0 {
            return (q, self.dq);
        }
        let n = self.history.len();
        self.history[self.at] = (q, self.dq);
        let whole = m.delay_steps.floor() as usize;
        let part = m.delay_steps - whole as f64;
        let a = self.history[(self.at + n - whole) % n];
        let b = self.history[(self.at + n - whole - 1) % n];
        self.at = (self.at + 1) % n;
        (a.0 + part * (b.0 - a.0), a.1 + part * (b.1 - a.1))
    }
}

fn play(out: f64, input: f64, half: f64) -> f64 {
    out.clamp(input - half, input + half)
}

/// Set-point after conventions and transport.
fn command(p: &Params, m: &Model, s: &mut State, mean: f64) -> f64 {
    let mut sp = mean * p.get(P::Scale) + p.get(P::Offset);
    let quantum = p.get(P::Quantum);
    if quantum > 0.0 {
        sp = (sp / quantum).round() * quantum;
    }
    let applied = sp;
    let slew = p.get(P::SlewLimit) * m.dt;
    s.slewed = if slew.is_finite() {
        s.slewed + (sp - s.slewed).clamp(-slew, slew)
    } else {
        sp
    };
    s.drive.command = applied;
    s.slewed
}

/// The joint's controller: set-point and encoder to controller output.
fn control(p: &Params, m: &Model, s: &mut State, sp: f64, kind: Command) -> f64 {
    if kind != Command::Position {
        return sp.clamp(-m.limit, m.limit);
    }
    let (q, dq) = s.feedback(m);
    let mut e = sp - q;
    let band = p.get(P::Deadband);
    if band > 0.0 {
        e -= e.clamp(-band, band);
    }
    if m.ki != 0.0 {
        let bound = m.limit / m.ki;
        s.integral = (s.integral + e * m.dt).clamp(-bound, bound);
    }
    (m.kp * e + m.ki * s.integral - m.kd * dq).clamp(-m.limit, m.limit)
}

/// Motor effort at the present speed, and its slope against speed.
fn drive(p: &Params, m: &Model, s: &mut State, u: f64, output: Output, t: f64) -> (f64, f64) {
    s.actuator += m.lag * (u - s.actuator);
    let u = s.actuator;
    let (mut effort, mut slope) = match output {
        Output::Duty | Output::Voltage => {
            let volts_per_u = if output == Output::Duty {
                None
            } else {
                Some(u)
            };
            let duty = volts_per_u.map_or(u, |v| v / m.supply);
            let sag = p.get(P::Sag);
            let bus = if sag > 0.0 {
                // Bus current is duty times motor current; solved for the voltage of this very step.
                let k = sag * duty / m.kt;
                ((m.supply + k * m.ge * s.dq) / (1.0 + k * m.gv * duty)).clamp(0.0, 2.0 * m.supply)
            } else {
                m.supply
            };
            s.drive.duty = duty;
            s.drive.bus = bus;
            (m.gv * duty * bus, m.ge)
        }
        Output::Effort => (u * m.gv, 0.0),
        Output::Velocity => {
            let v = u.clamp(-m.speed_limit, m.speed_limit);
            // A stiff velocity servo: reaches its speed within a step unless the effort limit stops it.
            let stiff = m.inertia / m.dt;
            (stiff * v, stiff)
        }
    };
    let share = p.get(P::DerateShare);
    if share > 0.0 {
        let tau = p.get(P::DerateTime).max(1e-3);
        let warm = 1.0 - share * t / (t + tau);
        effort *= warm;
        slope *= warm;
    }
    let now = effort - slope * s.dq;
    if now.abs() > m.effort_limit {
        return (now.clamp(-m.effort_limit, m.effort_limit), 0.0);
    }
    (effort, slope)
}

/// One step of the mechanics, given motor effort `a - b dq`.
fn mechanics(p: &Params, m: &Model, s: &mut State, a: f64, b: f64) {
    let angle = s.q + p.get(P::MechOffset);
    let mut load = 0.0;
    if m.gravity != 0.0 {
        load -= m.gravity * math::sin(angle);
    }
    let (rs, rc) = (p.get(P::RippleSin), p.get(P::RippleCos));
    if rs != 0.0 || rc != 0.0 {
        let x = p.get(P::RipplePeriods) * s.q;
        load += rs * math::sin(x) + rc * math::sin(x + std::f64::consts::FRAC_PI_2);
    }
    let speed = s.dq;
    let sign = if speed == 0.0 {
        (a + load).signum()
    } else {
        speed.signum()
    };
    let viscous =
        p.get(P::Viscous) + sign * p.get(P::AsymmetryViscous) + p.get(P::Quadratic) * speed.abs();
    let k = m.dt / m.inertia;
    let damping = 1.0 + k * (b + viscous);
    let free = (speed + k * (a + load)) / damping;
    let mut dry = p.get(P::Coulomb) + sign * p.get(P::Asymmetry);
    let fs = p.get(P::Static);
    if fs != 0.0 {
        let x = free / p.get(P::StribeckSpeed);
        dry += fs / (1.0 + x * x);
    }
    let share = p.get(P::LoadShare);
    let motor = a - b * speed;
    if share != 0.0 {
        // Half the difference of the two efforts that press on the gear: what it transmits (after Rhoban BAM).
        dry += share * 0.5 * (motor - load).abs();
    }
    let stop = k * dry.max(0.0) / damping;
    s.dq = if free.abs() <= stop {
        0.0
    } else {
        free - stop * free.signum()
    };
    s.q += m.dt * s.dq;
    s.effort = a - b * s.dq;
}

/// Angle behind play and twist, quasi-static.
fn transmission(p: &Params, m: &Model, s: &mut State) {
    let gravity = if m.gravity == 0.0 {
        0.0
    } else {
        m.gravity * math::sin(s.link)
    };
    let twist = p.get(P::Flexibility) * gravity;
    let half = p.get(P::Play);
    let target = s.q - twist;
    s.link = if half <= 0.0 {
        target
    } else if gravity.abs() > 1e-9 {
        // The load presses the link to one flank; it crosses when the load turns.
        let flank = target - half * (gravity / (0.05 * m.gravity.abs())).clamp(-1.0, 1.0);
        play(s.link, flank, 0.2 * half)
    } else {
        play(s.link, target, half)
    };
    let half = p.get(P::OutputPlay);
    s.output = if half > 0.0 {
        play(s.output, s.q, half)
    } else {
        s.q
    };
}

fn outputs(p: &Params, m: &Model, s: &State) -> [f64; CHANNELS] {
    let q = s.output * p.get(P::RecordScale);
    [
        q,
        s.effort / m.kt,
        s.drive.duty,
        s.drive.bus,
        s.link + p.get(P::MechOffset),
        s.effort,
        s.drive.command,
    ]
}

fn blend(a: &[f64; CHANNELS], b: &[f64; CHANNELS], part: f64) -> [f64; CHANNELS] {
    let mut out = *b;
    // Angles run on between steps; electrical signals are held.
    for k in [Channel::Position as usize, Channel::Link as usize] {
        out[k] = a[k] + part * (b[k] - a[k]);
    }
    out
}

/// Simulates a run with step `dt_s`; one entry per row. A run that blows up gives large finite values.
pub fn simulate(run: &RunData, p: &Params, dt_s: f64, trace: &mut Trace) {
    trace.clear();
    let m = resolve(run, p, dt_s);
    let mut s = State::new(run, &m);
    let clock = 1.0 + p.get(P::Skew);
    let delay = p.get(P::Delay);
    let mut commands = Commands::new(run, -delay);
    let (mut row, mut edge) = (0, 0);
    let mut enabled = true;
    let mut before = outputs(p, &m, &s);
    for step in 0..run.steps {
        while let Some(e) = run.edges.get(edge).filter(|e| e.step <= step) {
            (s.q, s.dq, enabled) = (e.position, e.velocity, e.enabled);
            (s.output, s.link, s.integral) = (s.q, s.q, 0.0);
            if step > 0 {
                s.actuator = 0.0;
            }
            before = outputs(p, &m, &s);
            edge += 1;
        }
        let t = step as f64 * dt_s;
        let mean = commands.mean_to((t + dt_s) * clock - delay);
        let sp = command(p, &m, &mut s, mean);
        let (a, b) = if enabled {
            let u = control(p, &m, &mut s, sp, run.nominal.command);
            drive(p, &m, &mut s, u, run.nominal.output, t)
        } else {
            (s.drive.duty, s.actuator) = (0.0, 0.0);
            (0.0, 0.0)
        };
        mechanics(p, &m, &mut s, a, b);
        transmission(p, &m, &mut s);
        if s.q.is_nan() || s.q.abs() > 1e6 {
            (s.q, s.dq) = (1e6, 0.0);
        }
        let after = outputs(p, &m, &s);
        while let Some(x) = run.samples.get(row).filter(|x| x.step == step) {
            trace.push(blend(&before, &after, x.part));
            row += 1;
        }
        before = after;
    }
    while trace.len() < run.samples.len() {
        trace.push(before);
    }
}
