//! Which parameters the fit may move: the nominal ones within their tolerances, and one candidate per effect.

mod free;
mod nominal;

use files::dataset::{Command, Output};

use crate::joint::{Channel, P, Params, Problem, Trace, simulate};
use crate::math;
use crate::vocabulary::Effect;

pub use free::{Free, Map};
pub use nominal::{base_effect, nominal, pull};

/// An effect as the fit tries it.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Which effect.
    pub effect: Effect,
    /// Which of several places it can act in; empty where there is only one.
    pub variant: &'static str,
    /// Parameters it adds or sets free.
    pub free: Vec<Free>,
    /// Starting points, each a list of values for `free`.
    pub starts: Vec<Vec<f64>>,
}

impl Candidate {
    /// Parameters that a fit moves.
    #[must_use]
    pub fn moving(&self) -> usize {
        self.free.iter().filter(|f| !f.fixed()).count()
    }
}

/// Typical sizes in a data set; starting grids are multiples of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scales {
    /// Range of the measured position (5 % to 95 %).
    pub range: f64,
    /// Root mean square of position minus set-point.
    pub error: f64,
    /// 95 % quantile of speed.
    pub speed: f64,
    /// Motor effort, 95 % quantile in the nominal simulation.
    pub effort: f64,
    /// Motor current, 95 % quantile in the nominal simulation.
    pub current: f64,
    /// Longest run, s.
    pub duration_s: f64,
}

/// Measures the typical sizes.
#[must_use]
pub fn scales(problem: &Problem, params: &Params) -> Scales {
    let mut all = [Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new()];
    let mut duration_s: f64 = 0.0;
    for run in &problem.runs {
        let mut trace = Trace::new();
        simulate(run, params, problem.dt_s, &mut trace);
        let mut last: Option<(f64, f64)> = None;
        duration_s = duration_s.max(run.steps as f64 * problem.dt_s);
        for (s, y) in run.samples.iter().zip(&trace).filter(|(s, _)| s.enabled) {
            let q = s.measured[0];
            if q.is_nan() {
                continue;
            }
            let t = (s.step as f64 + s.part) * problem.dt_s;
            all[0].push(q);
            if let Some((t0, q0)) = last.filter(|l| t - l.0 > 0.03) {
                all[2].push(((q - q0) / (t - t0)).abs());
                last = Some((t, q));
            }
            last = last.or(Some((t, q)));
            all[1].push(q - y[Channel::Applied as usize]);
            all[3].push(y[Channel::Effort as usize].abs());
            all[4].push(y[Channel::Current as usize].abs());
        }
    }
    let floor = |x: f64, low: f64| if x > low { x } else { low };
    Scales {
        range: floor(
            math::quantile(&all[0], 0.95) - math::quantile(&all[0], 0.05),
            1e-4,
        ),
        error: floor(math::rms(&all[1]), 1e-5),
        speed: floor(math::quantile(&all[2], 0.95), 1e-3),
        effort: floor(math::quantile(&all[3], 0.95), 1e-9),
        current: floor(math::quantile(&all[4], 0.95), 1e-9),
        duration_s,
    }
}

fn log(p: P, tolerance: Option<f64>) -> Free {
    // Three decades around the reference for what is unknown; more would be another machine.
    Free {
        p,
        map: Map::Log,
        low: 1e-3,
        high: 1e3,
        tolerance,
    }
}

fn linear(p: P, scale: f64, low: f64, high: f64) -> Free {
    Free {
        p,
        map: Map::Linear { scale },
        low,
        high,
        tolerance: None,
    }
}

/// Effort per ampere at `params`.
#[must_use]
pub fn effort_per_ampere(problem: &Problem, params: &Params) -> f64 {
    let nominal = problem.runs.first();
    let nominal = nominal.map_or(1.0, |r| r.nominal.effort_per_a);
    (nominal * params.get(P::Motor) * params.get(P::Ampere)).max(1e-12)
}

/// Whether any run measured this channel.
#[must_use]
pub fn measured(problem: &Problem, channel: Channel) -> bool {
    problem.runs.iter().any(|r| {
        r.samples
            .iter()
            .any(|s| s.measured[channel as usize].is_finite())
    })
}

struct List(Vec<Candidate>);

impl List {
    fn add(
        &mut self,
        effect: Effect,
        variant: &'static str,
        free: Vec<Free>,
        starts: Vec<Vec<f64>>,
    ) {
        self.0.push(Candidate {
            effect,
            variant,
            free,
            starts,
        });
    }

    /// A candidate with one parameter and a list of starts.
    fn one(
        &mut self,
        effect: Effect,
        variant: &'static str,
        free: Free,
        starts: &[f64],
        unit: f64,
    ) {
        self.add(
            effect,
            variant,
            vec![free],
            starts.iter().map(|s| vec![s * unit]).collect(),
        );
    }
}

/// Every effect of the stages conventions .. transmission that this data could show.
#[must_use]
pub fn library(problem: &Problem, s: &Scales) -> Vec<Candidate> {
    let mut list = List(Vec::new());
    let Some(n) = problem.runs.first().map(|r| r.nominal.clone()) else {
        return Vec::new();
    };
    if n.command == Command::Position {
        conventions(&mut list, problem, s);
        controller(&mut list, s, &n);
    }
    transport(&mut list, problem, s);
    electrical(&mut list, problem, s, &n);
    if n.output != Output::Velocity || n.effort_limit.is_finite() {
        friction(&mut list, s);
        mechanics(&mut list, problem, s, &n);
    }
    transmission(&mut list, problem, s, &n);
    list.0
}

fn conventions(list: &mut List, problem: &Problem, s: &Scales) {
    let ratios = [0.5, 0.95, 1.05, 2.0, 57.29578, 0.0174533];
    let scale = |p| linear(p, 0.1, 1e-3, 100.0);
    list.one(Effect::JointScale, "command", scale(P::Scale), &ratios, 1.0);
    list.one(
        Effect::JointSign,
        "",
        linear(P::Sense, 1.0, -1.0, -1.0),
        &[-1.0],
        1.0,
    );
    let both = [-0.3, -0.03, 0.03, 0.3];
    list.one(
        Effect::JointOffset,
        "command",
        linear(P::Offset, 0.1 * s.range, -10.0, 10.0),
        &both,
        s.range,
    );
    let gravity = problem.runs.iter().any(|r| r.nominal.gravity != 0.0);
    if gravity || measured(problem, Channel::Link) {
        list.one(
            Effect::JointOffset,
            "zero",
            linear(P::MechOffset, 0.1, -4.0, 4.0),
            &[-0.3, -0.03, 0.03, 0.3],
            1.0,
        );
    }
}

fn transport(list: &mut List, problem: &Problem, s: &Scales) {
    let delays = [0.003, 0.008, 0.02, 0.045, 0.1, 0.2];
    list.one(
        Effect::Latency,
        "",
        linear(P::Delay, 0.01, 0.0, 1.0),
        &delays,
        1.0,
    );
    // The whole clock is off, or only the one that plays the gait.
    for (variant, played) in [("clock", 0.0), ("gait", 1.0)] {
        let skew = linear(P::Skew, 1e-3, -0.2, 0.2);
        let free = vec![skew, linear(P::Played, 1.0, played, played)];
        let starts = [
            -0.03, -0.01, -0.003, -1e-3, -3e-4, 3e-4, 1e-3, 0.003, 0.01, 0.03,
        ];
        let starts = starts.map(|x| vec![x, played]).to_vec();
        list.add(Effect::ClockSkew, variant, free, starts);
    }
    let echoed = crate::joint::arrival::lattice(&problem.runs);
    // Rounding is no smooth function of its step: a fine grid where the echo does not show the step itself.
    let steps: Vec<f64> = match echoed {
        Some(step) => vec![step / s.range],
        None => (0..120)
            .map(|k| 0.005 * libm::exp(0.035 * f64::from(k)))
            .collect(),
    };
    // An echoed step is exact: a fit that moves it only trips over its own rounding.
    let within = echoed.map_or((0.0, s.range), |x| (x * (1.0 - 1e-4), x * (1.0 + 1e-4)));
    list.one(
        Effect::Quantisation,
        "",
        linear(P::Quantum, 0.01 * s.range, within.0, within.1),
        &steps,
        s.range,
    );
}

fn controller(list: &mut List, s: &Scales, n: &crate::joint::Nominal) {
    list.one(
        Effect::LoopGain,
        "",
        log(P::LoopGain, None),
        &[0.8, 1.25],
        1.0,
    );
    if n.kd > 0.0 {
        list.one(
            Effect::DampingGain,
            "",
            log(P::Damping, None),
            &[0.7, 1.4],
            1.0,
        );
    }
    let widths = [0.1, 0.25, 0.5, 1.0, 2.0];
    list.one(
        Effect::Deadband,
        "",
        linear(P::Deadband, 0.2 * s.error, 0.0, s.range),
        &widths,
        s.error,
    );
    let limits = [0.35, 0.55, 0.75, 0.95, 1.2];
    list.one(
        Effect::VelocityLimit,
        "",
        linear(P::SlewLimit, 0.2 * s.speed, 1e-4, 1e4),
        &limits,
        s.speed,
    );
    // Close together: where the loop begins to swing by itself its phase hangs on every millisecond.
    let delays = [
        0.001, 0.002, 0.004, 0.006, 0.008, 0.010, 0.012, 0.0145, 0.0175, 0.021, 0.027, 0.04,
    ];
    list.one(
        Effect::FeedbackDelay,
        "",
        linear(P::FeedbackDelay, 0.005, 0.0, 0.3),
        &delays,
        1.0,
    );
    list.one(
        Effect::MotorLag,
        "",
        linear(P::Lag, 0.01, 0.0, 2.0),
        &[0.003, 0.01, 0.03, 0.1],
        1.0,
    );
}

fn electrical(list: &mut List, problem: &Problem, s: &Scales, n: &crate::joint::Nominal) {
    // Close together: the valley of a hard limit is narrow.
    let shares = [
        0.1, 0.125, 0.155, 0.19, 0.24, 0.3, 0.37, 0.46, 0.58, 0.72, 0.9, 1.1,
    ];
    if matches!(n.output, Output::Duty | Output::Voltage) {
        if problem.known.speed.is_some() && n.no_load_speed.is_finite() {
            list.one(
                Effect::MotorConstant,
                "",
                log(P::Motor, None),
                &[0.8, 1.25],
                1.0,
            );
        }
        if problem.known.stall.is_some() {
            list.one(
                Effect::WindingResistance,
                "",
                log(P::Resistance, None),
                &[0.8, 1.25],
                1.0,
            );
        }
        list.one(
            Effect::CurrentLimit,
            "",
            linear(P::CurrentLimit, 0.2 * s.current, 1e-6, 1e6),
            &shares,
            s.current,
        );
        if problem.known.supply.is_some() {
            list.one(
                Effect::SupplyVoltage,
                "",
                log(P::Supply, None),
                &[0.85, 1.18],
                1.0,
            );
        }
        let ohm = n.supply_v / s.current;
        if n.output == Output::Duty || problem.known.supply.is_some() {
            // A source that is no battery takes nothing back from a braking motor.
            let back = Free {
                tolerance: Some(0.5),
                ..linear(P::Regeneration, 1.0, 0.0, 1.0)
            };
            let starts = [0.03, 0.1, 0.3, 0.8].map(|x| vec![x * ohm, 1.0]).to_vec();
            let free = vec![linear(P::Sag, 0.1 * ohm, 0.0, 10.0 * ohm), back];
            list.add(Effect::SupplySag, "", free, starts);
        }
    }
    let free = linear(P::TorqueLimit, 0.2 * s.effort, 1e-9, 1e9);
    list.one(Effect::TorqueLimit, "", free, &shares, s.effort);
    let free = vec![
        Free {
            p: P::DerateTime,
            map: Map::Log,
            low: 1.0,
            high: 1e4,
            tolerance: None,
        },
        linear(P::DerateShare, 0.1, 0.0, 0.95),
    ];
    let starts = [0.1, 1.0]
        .iter()
        .flat_map(|t| [0.1, 0.4].map(|f| vec![t * s.duration_s, f]))
        .collect();
    list.add(Effect::ThermalDerating, "", free, starts);
}

fn friction(list: &mut List, s: &Scales) {
    let t = s.effort;
    let positive = |p, scale: f64| linear(p, 0.1 * scale, 0.0, 1e3 * scale);
    let sizes = [0.01, 0.04, 0.12, 0.35, 0.9];
    list.one(
        Effect::CoulombFriction,
        "",
        positive(P::Coulomb, t),
        &sizes,
        t,
    );
    list.one(
        Effect::ViscousFriction,
        "",
        positive(P::Viscous, t / s.speed),
        &sizes,
        t / s.speed,
    );
    let speed = Free {
        p: P::StribeckSpeed,
        map: Map::Log,
        low: 1e-3 * s.speed,
        // Beyond the speeds of the motion the law is one with dry friction.
        high: 0.7 * s.speed,
        tolerance: None,
    };
    let starts = [0.05, 0.2, 0.7]
        .iter()
        .flat_map(|f| [0.02, 0.1, 0.4].map(|v| vec![f * t, v * s.speed]))
        .collect();
    list.add(
        Effect::StribeckFriction,
        "",
        vec![positive(P::Static, t), speed],
        starts,
    );
    // Nor is it whether the motor's effort or the load presses the teeth.
    let of = Free {
        tolerance: Some(1.0),
        ..linear(P::LoadOf, 1.0, 0.0, 1.0)
    };
    let sizes = [0.02, 0.08, 0.25, 0.6];
    let starts = sizes
        .iter()
        .flat_map(|x| [0.0, 1.0].map(|w| vec![*x, 0.5, w]));
    let starts = starts.collect();
    let free = vec![linear(P::LoadShare, 0.1, 0.0, 2.0), behind(), of];
    list.add(Effect::LoadDependentFriction, "", free, starts);
    let both = |p, scale: f64| linear(p, 0.1 * scale, -1e3 * scale, 1e3 * scale);
    let free = vec![
        both(P::Asymmetry, t),
        both(P::AsymmetryViscous, t / s.speed),
    ];
    let starts = [-0.3, -0.05, 0.05, 0.3].map(|f| vec![f * t, 0.0]).to_vec();
    list.add(Effect::AsymmetricFriction, "", free, starts);
    let unit = t / (s.speed * s.speed);
    list.one(
        Effect::QuadraticFriction,
        "",
        positive(P::Quadratic, unit),
        &[0.05, 0.3, 1.0],
        unit,
    );
}

fn mechanics(list: &mut List, problem: &Problem, s: &Scales, n: &crate::joint::Nominal) {
    if problem.known.inertia.is_some() {
        list.one(Effect::Inertia, "", log(P::Inertia, None), &[0.7, 1.4], 1.0);
    }
    if n.gravity != 0.0 {
        list.one(
            Effect::GravityLoad,
            "",
            log(P::Gravity, None),
            &[0.7, 1.4],
            1.0,
        );
    } else {
        let free = linear(P::Weight, 0.1 * s.effort, -1e3 * s.effort, 1e3 * s.effort);
        list.one(Effect::GravityLoad, "", free, &[-0.2, 0.2], s.effort);
    }
    let both = |p| linear(p, 0.1 * s.effort, -1e3 * s.effort, 1e3 * s.effort);
    let per_turn = if problem.linear {
        std::f64::consts::TAU / s.range
    } else {
        1.0
    };
    // Magnets, teeth and wobbling shafts: whole numbers of periods per turn.
    let least = std::f64::consts::TAU;
    let mut starts = Vec::new();
    for periods in [
        1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 24.0,
    ] {
        // A ripple is only told from a bent load curve if the motion passes more than a period.
        if periods * per_turn * s.range > least {
            starts.extend(
                [(0.15, 0.0), (-0.15, 0.0), (0.0, 0.15), (0.0, -0.15)]
                    .map(|(a, b)| vec![periods * per_turn, a * s.effort, b * s.effort]),
            );
        }
    }
    let free = Free {
        p: P::RipplePeriods,
        map: Map::Log,
        low: least / s.range,
        high: 60.0 * per_turn,
        tolerance: None,
    };
    if starts.is_empty() {
        return;
    }
    list.add(
        Effect::TorqueRipple,
        "",
        vec![free, both(P::RippleSin), both(P::RippleCos)],
        starts,
    );
}

fn transmission(list: &mut List, problem: &Problem, s: &Scales, n: &crate::joint::Nominal) {
    let link = measured(problem, Channel::Link);
    let effort = if link && n.gravity != 0.0 {
        n.gravity.abs()
    } else {
        s.effort
    };
    // Impacts and swings are no straight line in a size: neighbours stand a factor of 1.7 apart.
    let of_gear = |free: Free, unit: f64| {
        let sizes = [0.002, 0.0034, 0.0058, 0.0098, 0.0167, 0.0284, 0.0482, 0.082];
        let starts = sizes.map(|x| [0.2, 0.5].map(|behind| vec![x * unit, behind]));
        (vec![free, behind()], starts.concat())
    };
    let play = linear(P::Play, 0.01, 0.0, 1.0);
    let (free, starts) = of_gear(play, 1.0);
    list.add(Effect::Backlash, "link", free, starts);
    let give = linear(P::Flexibility, 0.01 / effort, 0.0, 1.0 / effort);
    let (free, starts) = of_gear(give, 1.0 / effort);
    list.add(Effect::Compliance, "", free, starts);
    if !link {
        let widths = [0.1, 0.25, 0.5, 1.0, 2.0];
        list.one(
            Effect::Backlash,
            "output",
            linear(P::OutputPlay, 0.2 * s.error, 0.0, s.range),
            &widths,
            s.error,
        );
    }
}

/// How much of the inertia sits behind the gear is stated nowhere: about half, give or take.
fn behind() -> Free {
    Free {
        tolerance: Some(0.3),
        ..linear(P::Behind, 1.0, 0.0, 1.0)
    }
}
