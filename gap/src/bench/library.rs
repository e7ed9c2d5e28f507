//! What may be wrong with a joint: causes as parameters with priors and places to start from.

use files::dataset::{Command, Output};

use super::data::{Data, row_s};
use super::model::{Axis, Coordinate, Point};
use crate::candidates::{self, Candidate};
use crate::candidates::{Free, Map};
use crate::evidence::block::{Column, Meaning, Parameter, Site};
use crate::joint::{Channel, P};
use crate::vocabulary::{Compound, Effect, Stage};

/// A cause as people name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// One effect of the vocabulary.
    One(Effect),
    /// Several of them.
    Many(Compound),
    /// A column that is off by a factor.
    ColumnScale(Channel),
}

impl Kind {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::One(e) => e.name(),
            Self::Many(c) => c.name(),
            Self::ColumnScale(_) => "column_scale",
        }
    }

    pub(super) fn stage(self) -> Stage {
        match self {
            Self::One(e) => e.stage(),
            Self::Many(c) => c.effects()[0].stage(),
            Self::ColumnScale(_) => Stage::Conventions,
        }
    }

    /// Whether the nominal model holds all of its numbers.
    pub(super) fn parametric(self) -> bool {
        match self {
            Self::One(e) => e.is_base(),
            Self::Many(c) => c.effects().iter().all(|e| e.is_base()),
            Self::ColumnScale(_) => false,
        }
    }

    /// The cause as a noun.
    pub(super) fn plain(self) -> String {
        match self {
            Self::One(e) => e.plain().to_owned(),
            Self::Many(c) => c.plain().to_owned(),
            Self::ColumnScale(c) => format!("a scale of column {}", column(c)),
        }
    }

    /// The robot has it once, not the joint.
    pub(super) fn of_robot(self) -> bool {
        match self {
            Self::One(e) => !e.info().per_joint(),
            Self::Many(c) => !c.effects().iter().all(|e| e.info().per_joint()),
            Self::ColumnScale(_) => false,
        }
    }
}

pub(super) fn column(c: Channel) -> &'static str {
    match c {
        Channel::Position => "position",
        Channel::Current => "current",
        Channel::Duty => "duty",
        Channel::BusVoltage => "bus_v",
        Channel::Link => "link_position",
        Channel::Effort => "effort",
        Channel::Applied => "applied_setpoint",
    }
}

/// One way in which a cause may act.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Hypothesis {
    pub(super) kind: Kind,
    /// What the vocabulary's parameters are read with.
    pub(super) candidate: Option<Candidate>,
    /// Parameters that it sets and no fit moves.
    pub(super) fixed: Vec<(Axis, f64)>,
    /// Parameters that it moves.
    pub(super) coordinates: Vec<Coordinate>,
    /// Values to start from.
    pub(super) starts: Vec<Vec<f64>>,
    /// The joint without it.
    base: Point,
}

impl Hypothesis {
    /// `point` with the values of a start.
    pub(super) fn on(&self, point: &Point, values: &[f64]) -> Point {
        let mut out = *point;
        self.fixed.iter().for_each(|(a, v)| out.set(*a, *v));
        for (c, v) in self.coordinates.iter().zip(values) {
            out.set(c.axis, *v);
        }
        out
    }

    /// Values at which it has no effect, or as little as its bounds allow.
    pub(super) fn neutral(&self) -> Vec<f64> {
        let all = self.coordinates.iter().zip(&self.starts[0]);
        all.map(|(c, start)| {
            let value = self.base.get(c.axis);
            if value.is_finite() { value } else { *start }
        })
        .collect()
    }

    /// How far a start is from no effect, in standard deviations of its prior; 1 for a size that has no neutral value.
    fn size(&self, start: &[f64]) -> f64 {
        let each = self.coordinates.iter().zip(start).map(|(c, v)| {
            let off = (c.variable(*v) - c.variable(self.base.get(c.axis))) / c.sd;
            if off.is_finite() { off * off } else { 0.0 }
        });
        let size = each.sum::<f64>().sqrt();
        if size > 0.0 { size } else { 1.0 }
    }

    /// The hypothesis as a column of errors that a start changes, one unit being one standard deviation of its prior,
    /// and the share of the start that one unit is.
    pub(super) fn column(&self, start: &[f64]) -> (Column, f64) {
        let variant = self.candidate.as_ref().map_or("", |c| c.variant);
        let (meaning, key) = match self.kind {
            Kind::One(e) => (Meaning::Effect(e), variant),
            Kind::Many(Compound::Payload) => (Meaning::Effect(Effect::GravityLoad), "payload"),
            Kind::Many(Compound::WeakBattery) => {
                (Meaning::Effect(Effect::SupplySag), "weak_battery")
            }
            Kind::ColumnScale(c) => (Meaning::Open, column(c)),
        };
        let own = Column {
            meaning,
            prior: [0.0, 1.0],
            slack: 0.0,
            parameter: Parameter {
                key,
                neutral: 0.0,
                scale: 1.0,
            },
            ..Column::nuisance(1.0)
        };
        (own, 1.0 / self.size(start))
    }

    pub(super) fn axes(&self) -> impl Iterator<Item = Axis> {
        let moved = self.coordinates.iter().map(|c| c.axis);
        moved.chain(self.fixed.iter().map(|f| f.0))
    }
}

/// Standard deviation of the logarithm of a ratio that is off: as in the registry.
const RATIO: f64 = 0.4;
/// Of a period, a speed, a time constant that shapes an effect.
const SHAPE: f64 = 0.5;

/// The prior of parameter `k` of a candidate: as wide as its starts.
fn prior(c: &Candidate, k: usize, free: &Free, start: &[f64], base: &Point) -> (f64, f64) {
    let neutral = free.to_x(base.params.get(free.p));
    if let Some(t) = free.tolerance {
        return (neutral, t);
    }
    match free.map {
        Map::Log if matches!(free.p, P::RipplePeriods | P::StribeckSpeed | P::DerateTime) => {
            (free.to_x(start[k]), SHAPE)
        }
        Map::Log => (neutral, RATIO),
        Map::Linear { .. } => {
            let all: Vec<f64> = c.starts.iter().map(|s| free.to_x(s[k])).collect();
            let neutral = if neutral.is_finite() { neutral } else { 0.0 };
            let off: Vec<f64> = all.iter().map(|x| x - neutral).collect();
            (neutral, crate::math::rms(&off).max(1e-3))
        }
    }
}

/// Limits are neutral at infinity: their prior is a share of what is there.
fn limit(p: P) -> bool {
    matches!(p, P::SlewLimit | P::TorqueLimit | P::CurrentLimit)
}

fn of_candidate(c: &Candidate, start: &[f64], base: &Point) -> Hypothesis {
    let mut fixed = Vec::new();
    let mut coordinates = Vec::new();
    let mut moved = Vec::new();
    for (k, free) in c.free.iter().enumerate() {
        if free.fixed() {
            fixed.push((Axis::Joint(free.p), free.low));
            continue;
        }
        let (mean, sd) = if limit(free.p) {
            (free.to_x(start[k]), 0.5 * free.to_x(start[k]))
        } else {
            prior(c, k, free, start, base)
        };
        coordinates.push(Coordinate::of_effect(free, mean, sd));
        moved.push(k);
    }
    Hypothesis {
        kind: Kind::One(c.effect),
        candidate: Some(c.clone()),
        fixed,
        coordinates,
        starts: vec![moved.iter().map(|k| start[*k]).collect()],
        base: *base,
    }
}

/// What set-points show before they reach the driver; the transport block weighs it where the driver echoes them.
const ON_THE_WAY: [Effect; 3] = [Effect::Latency, Effect::Quantisation, Effect::ClockSkew];

/// Every hypothesis that the data could show. `cut` says that set-points are those that the driver applied.
pub(super) fn library(
    data: &Data<'_>,
    point: &Point,
    withhold: &[Effect],
    cut: bool,
) -> Vec<Hypothesis> {
    let problem = &data.problem;
    let scales = candidates::scales(problem, &point.params);
    let mut out = Vec::new();
    for c in candidates::library(problem, &scales) {
        if cut && ON_THE_WAY.contains(&c.effect) {
            continue;
        }
        // Limits, periods and speeds have a prior around each start; else one hypothesis has all its starts.
        let shaped = |f: &Free| {
            limit(f.p) || matches!(f.p, P::RipplePeriods | P::StribeckSpeed | P::DerateTime)
        };
        if c.free.iter().any(shaped) {
            out.extend(c.starts.iter().map(|s| of_candidate(&c, s, point)));
        } else if let Some(first) = c.starts.first() {
            let mut h = of_candidate(&c, first, point);
            let moving: Vec<usize> = (0..c.free.len()).filter(|k| !c.free[*k].fixed()).collect();
            let one = |s: &Vec<f64>| moving.iter().map(|k| s[*k]).collect();
            h.starts = c.starts.iter().map(one).collect();
            out.push(h);
        }
    }
    compounds(data, point, &mut out);
    // What is not stated cannot differ from what is.
    let unstated: Vec<P> = candidates::nominal(problem)
        .iter()
        .filter(|f| f.tolerance.is_none())
        .map(|f| f.p)
        .collect();
    let stated = |a: Axis| !matches!(a, Axis::Joint(p) if unstated.contains(&p));
    out.retain(|h| h.axes().any(stated));
    let known = |e: Effect| !withhold.contains(&e);
    out.retain(|h| match h.kind {
        Kind::One(e) => known(e),
        Kind::Many(Compound::Payload) => known(Effect::GravityLoad) && known(Effect::Inertia),
        Kind::Many(Compound::WeakBattery) => {
            known(Effect::SupplyVoltage) && known(Effect::SupplySag)
        }
        Kind::ColumnScale(_) => true,
    });
    out
}

fn compounds(data: &Data<'_>, base: &Point, out: &mut Vec<Hypothesis>) {
    let Some(n) = data.problem.runs.first().map(|r| r.nominal.clone()) else {
        return;
    };
    let k = data.problem.known;
    if n.gravity != 0.0 && k.inertia.is_some() && n.output != Output::Velocity {
        let plus = |p, sd| Coordinate::linear(Axis::Joint(p), 0.3, [0.05, 50.0], 1.0, sd);
        out.push(Hypothesis {
            kind: Kind::Many(Compound::Payload),
            candidate: None,
            fixed: Vec::new(),
            coordinates: vec![plus(P::Gravity, 0.7), plus(P::Inertia, 0.7)],
            starts: [0.6, 1.25, 1.6, 2.2, 5.0, 15.0]
                .map(|r| vec![r, 1.0 + 0.8 * (r - 1.0)])
                .to_vec(),
            base: *base,
        });
    }
    if n.output == Output::Duty && k.supply.is_some() {
        let ohm = n.supply_v * n.effort_per_a / n.stall.max(1e-9);
        let volts = Coordinate::ratio(Axis::Joint(P::Supply), 0.2);
        let sag = Coordinate::linear(
            Axis::Joint(P::Sag),
            0.1 * ohm,
            [0.0, 10.0 * ohm],
            0.0,
            0.3 * ohm,
        );
        out.push(Hypothesis {
            kind: Kind::Many(Compound::WeakBattery),
            candidate: None,
            fixed: Vec::new(),
            coordinates: vec![volts, sag],
            starts: vec![vec![0.9, 0.1 * ohm], vec![0.8, 0.3 * ohm]],
            base: *base,
        });
    }
    for channel in [Channel::Current, Channel::Effort] {
        if data.channels.contains(&(channel as usize)) && n.command == Command::Position {
            let axis = Axis::Column(channel as usize);
            out.push(Hypothesis {
                kind: Kind::ColumnScale(channel),
                candidate: None,
                fixed: Vec::new(),
                coordinates: vec![Coordinate::ratio(axis, RATIO)],
                starts: vec![vec![0.7], vec![1.4]],
                base: *base,
            });
        }
    }
}

/// A joint on a bench as one block of errors.
pub(super) const SITE: Site = Site {
    stage: Stage::Drivetrain,
    joint: None,
    blind: false,
    coarse: false,
};

/// What two simulators of one servo differ by in scale and place, as a share of the motion; one standard deviation.
const SAME_SCALE: f64 = 1e-3;
const SAME_PLACE: f64 = 3e-4;
/// Instants within a row at which a set-point may have come in force, as a share of the row; one standard deviation.
const WITHIN_ROW: f64 = 0.1;

/// The same within a controller's period: one over the root of twelve.
const WITHIN_PERIOD: f64 = 0.29;

/// What is stated, within its tolerances, and what joints and recordings are built like, which no data set states.
pub(super) fn nuisances(data: &Data<'_>, base: &Point, cut: bool) -> Vec<Coordinate> {
    let problem = &data.problem;
    let mut out: Vec<Coordinate> = candidates::nominal(problem)
        .iter()
        .map(|f| Coordinate::nominal(f, base))
        .collect();
    let position = problem
        .runs
        .iter()
        .any(|r| r.nominal.command == Command::Position);
    if position {
        let within = |p, scale: f64, middle: f64, sd: f64| {
            Coordinate::linear(Axis::Joint(p), scale, [-1e3, 1e3], middle, sd).around(base)
        };
        out.push(within(P::Scale, 0.1, 1.0, SAME_SCALE));
        out.push(within(P::Offset, 0.1, 0.0, SAME_PLACE * problem.range));
        let row = row_s(problem);
        // An echo is seen at the row after it; a controller looks at its set-points once a period.
        let share = if cut { 0.5 } else { WITHIN_ROW };
        let period = problem.runs.first().map_or(0.0, |r| r.nominal.period_s);
        let sd = libm::hypot(share * row, WITHIN_PERIOD * period.max(problem.dt_s));
        let axis = Axis::Joint(P::Delay);
        out.push(Coordinate::linear(axis, 0.01, [-1.0, 1.0], 0.0, sd).around(base));
    }
    out
}
