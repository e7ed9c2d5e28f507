//! The winding: duty, speed and supply give the current, the current gives the torque.
//!
//! `duty V = R i + k w` at means over two set-points' periods, and `torque = k i`. Whatever of current and torque was not
//! recorded the other one stands for.

use crate::evidence::block::{Column, Raw, Segment, Site};
use crate::vocabulary::{Effect, Stage};

use super::super::data::Track;
use super::torque::{Along, HALF_S, LEAST_NM, STEP_S};

/// What a mean duty may be off by: 1/2000; and a mean voltage, V: that of 12 V.
const LEAST_DUTY: f64 = 5e-4;
const LEAST_V: f64 = 0.006;
/// Size of a change of a motor's constants where there is one, as a share: another winding of one series.
const RATIO: f64 = 0.3;
/// Size of a change of the supply, as a share of it: one cell of six.
const SUPPLY: f64 = 0.15;
/// Resistance of a weak battery, ohm.
const SAG_OHM: f64 = 0.3;
/// Time between rows beyond which a duty is not resolved between two set-points, s: a quarter of their period.
const COARSE_S: f64 = 0.0125;
/// Number of the shape of a torque that differs between the directions.
const UNEVEN: usize = 320;
/// Time constants of a winding that warms, s.
const WARM_S: [f64; 5] = [1.0, 3.0, 6.0, 12.0, 25.0];
/// Share of its torque that a warm motor has lost.
const LOST: f64 = 0.3;

/// What is known of a motor and its supply, each with its relative tolerance (1 sigma).
#[derive(Debug, Clone, Copy)]
pub(in crate::whole) struct Motor {
    /// Torque per current at the output, N m/A.
    pub(in crate::whole) nm_per_a: [f64; 2],
    /// Resistance of the winding, ohm.
    pub(in crate::whole) winding_ohm: [f64; 2],
    /// Supply without load, V, and its tolerance, V.
    pub(in crate::whole) supply_v: [f64; 2],
}

/// What the drivers recorded of one joint in one run.
#[derive(Clone, Copy)]
pub(in crate::whole) struct Signals<'a> {
    pub(in crate::whole) position: &'a Track,
    pub(in crate::whole) velocity: Option<&'a Track>,
    pub(in crate::whole) duty: Option<&'a Track>,
    pub(in crate::whole) current: Option<&'a Track>,
    pub(in crate::whole) effort: Option<&'a Track>,
    pub(in crate::whole) bus_v: Option<&'a Track>,
}

/// Whether a duty shows what it does between two set-points; else its means are of whatever instants the rows hit.
fn resolved(duty: &Track) -> bool {
    duty.period_s() <= COARSE_S
}

fn mean(track: &Track, t_s: f64) -> Option<f64> {
    track.line(t_s, HALF_S).map(|l| l.0)
}

impl Signals<'_> {
    /// Mean speed around `t_s`, rad/s. Without a speed it is the way over the time, the same mean as that of the duty.
    fn speed(&self, t_s: f64) -> Option<f64> {
        if let Some(v) = self.velocity {
            return mean(v, t_s);
        }
        let [before, after] = [t_s - HALF_S, t_s + HALF_S].map(|t| self.position.at(t));
        Some((after - before) / (2.0 * HALF_S))
    }

    /// Supply at `t_s`, V; the stated one where it was not recorded.
    fn volt(&self, motor: &Motor, t_s: f64) -> Option<f64> {
        self.bus_v.map_or(Some(motor.supply_v[0]), |b| mean(b, t_s))
    }

    /// Current by what was recorded, A.
    fn ampere(&self, motor: &Motor, t_s: f64) -> Option<f64> {
        if let Some(i) = self.current {
            return mean(i, t_s);
        }
        if let Some(nm) = self.effort {
            return mean(nm, t_s).map(|nm| nm / motor.nm_per_a[0]);
        }
        let volt = mean(self.duty?, t_s)? * self.volt(motor, t_s)?;
        Some((volt - motor.nm_per_a[0] * self.speed(t_s)?) / motor.winding_ohm[0])
    }

    /// Whether something tells the current.
    pub(in crate::whole) fn tell(&self) -> bool {
        self.current.is_some() || self.effort.is_some() || self.duty.is_some()
    }

    /// Current that the joint draws from the supply at `t_s`, A: its power over the voltage.
    pub(in crate::whole) fn drawn_a(&self, motor: &Motor, t_s: f64) -> Option<f64> {
        let i = self.ampere(motor, t_s)?;
        let taken = match self.duty {
            Some(d) => mean(d, t_s)?,
            None => {
                let volt = motor.winding_ohm[0] * i + motor.nm_per_a[0] * self.speed(t_s)?;
                volt / self.volt(motor, t_s)?
            }
        };
        Some(taken * i)
    }

    /// Torque of the motor where only its duty tells it, on the instants of the duty, N m.
    pub(in crate::whole) fn torque_of_duty(&self, motor: &Motor) -> Option<Track> {
        let duty = self.duty.filter(|d| resolved(d))?;
        let mut out = Track::default();
        for t in &duty.t_s {
            if let Some(i) = self.ampere(motor, *t) {
                out.t_s.push(*t);
                out.v.push(motor.nm_per_a[0] * i);
            }
        }
        (out.v.len() >= 2).then_some(out)
    }
}

/// Mean square of what voltages of a motor are off in some runs, V^2, and their length, s; `None` where not all was recorded.
pub(in crate::whole) fn misfit(runs: &[Signals<'_>], motor: &Motor) -> Option<[f64; 2]> {
    let (mut sum, mut count) = (0.0, 0.0);
    for s in runs {
        let (Some(duty), Some(current)) = (s.duty.filter(|d| resolved(d)), s.current) else {
            continue;
        };
        let off = |t_s: f64| {
            let volt = mean(duty, t_s)? * s.volt(motor, t_s)?;
            let taken = motor.winding_ohm[0] * mean(current, t_s)?;
            Some(volt - taken - motor.nm_per_a[0] * s.speed(t_s)?)
        };
        for e in instants(s.position).filter_map(off) {
            sum += e * e;
            count += 1.0;
        }
    }
    (count > 0.0 && sum > 0.0).then(|| [sum / count, count * STEP_S])
}

/// Instants of a run at which means are compared, s.
fn instants(position: &Track) -> impl Iterator<Item = f64> {
    let (from, end) = (position.t_s[0], position.t_s[position.t_s.len() - 1]);
    let n = ((end - from - 0.4) / STEP_S).max(0.0) as usize;
    (0..n).map(move |i| from + 0.2 + i as f64 * STEP_S)
}

/// Share of its torque that a motor of `LOST` has lost after `t_s`.
fn warmth(t_s: f64, time_s: f64) -> f64 {
    1.0 - libm::exp(-t_s / time_s)
}

fn warm(shape: usize) -> Column {
    let fixed = [("time_constant_s", WARM_S[shape])];
    Column::linear(Effect::ThermalDerating, "fraction", 0.0, LOST)
        .shaped(shape, &fixed)
        .at_least_neutral()
}

/// Torque constant, winding: columns that every block of a winding has.
fn constants(motor: &Motor) -> [Column; 2] {
    let of = |effect, own: [f64; 2]| Column::linear(effect, "ratio", 1.0, RATIO).with_slack(own[1]);
    [
        of(Effect::MotorConstant, motor.nm_per_a),
        of(Effect::WindingResistance, motor.winding_ohm),
    ]
}

/// What a supply that nobody recorded may be: voltage and resistance.
fn battery(motor: &Motor) -> [Column; 2] {
    let [volt, tolerance] = motor.supply_v;
    [
        Column::linear(Effect::SupplyVoltage, "value_v", volt, SUPPLY * volt)
            .of_robot()
            .with_shared_slack("supply", tolerance),
        Column::linear(Effect::SupplySag, "resistance_ohm", 0.0, SAG_OHM)
            .of_robot()
            .at_least_neutral(),
    ]
}

/// Columns of a torque that was computed from current or duty, each with the change of `motor less load` per coefficient
/// at an instant under the load there. The load stands for the torque, because a noisy torque would explain its own noise.
pub(in crate::whole) fn of_torque<'a>(
    motor: &'a Motor,
    signals: &'a Signals<'a>,
    drawn: &'a Track,
) -> Vec<Along<'a>> {
    let [k, ohm] = [motor.nm_per_a[0], motor.winding_ohm[0]];
    let [constant, winding] = constants(motor);
    let warming = WARM_S.into_iter().enumerate();
    if signals.current.is_some() {
        let mut out: Vec<Along<'a>> = vec![(constant, Box::new(|_, load| -load))];
        out.extend(warming.map(|(shape, time_s)| -> Along<'a> {
            let lost = move |t: f64, load: f64| load * warmth(t, time_s);
            (warm(shape), Box::new(lost))
        }));
        return out;
    }
    // Torque that the duty must make up for what the motion induces.
    let induced = move |t| k * k / ohm * signals.speed(t).unwrap_or(0.0);
    let [voltage, sag] = battery(motor);
    let volt = motor.supply_v[0];
    let guessed = f64::from(u8::from(signals.bus_v.is_none())) / volt;
    vec![
        (constant, Box::new(move |t, load| induced(t) - load)),
        (winding, Box::new(|_, load| load)),
        (
            voltage,
            Box::new(move |t, load| -guessed * (load + induced(t))),
        ),
        (
            sag,
            Box::new(move |t, load| guessed * (load + induced(t)) * drawn.at(t)),
        ),
    ]
}

/// The block of joint `joint` in shares of the supply: the duty less that of current and speed; `None` where duty, or what tells the current, was not recorded.
pub(in crate::whole) fn duties(
    joint: usize,
    runs: &[(Signals<'_>, &Track)],
    motor: &Motor,
) -> Option<Raw> {
    let mut columns: Vec<Column> = constants(motor).to_vec();
    columns.extend((0..WARM_S.len()).map(warm));
    columns.extend(battery(motor));
    let [k, ohm] = [motor.nm_per_a[0], motor.winding_ohm[0]];
    let mut segments = Vec::new();
    for (s, drawn) in runs {
        let heard = s.current.is_some() || s.effort.is_some();
        let Some(duty) = s.duty.filter(|d| heard && resolved(d)) else {
            continue;
        };
        let mut segment = Segment {
            x: vec![Vec::new(); columns.len()],
            ..Segment::default()
        };
        for t in instants(s.position) {
            let row = || {
                Some([
                    mean(duty, t)?,
                    s.volt(motor, t)?,
                    s.ampere(motor, t)?,
                    s.speed(t)?,
                ])
            };
            let (d, v, i, w) = match row() {
                Some([d, v, i, w]) => (d, v, i, w),
                None => (0.0, 0.0, 0.0, 0.0),
            };
            segment.weight.push(f64::from(u8::from(row().is_some())));
            let v = v.max(LEAST_V);
            segment.y.push(d - (ohm * i + k * w) / v);
            // A current that a torque stands for is smaller the larger the constant is.
            let stood_for = if s.current.is_none() { ohm * i } else { 0.0 };
            let mut x = vec![(k * w - stood_for) / v, ohm * i / v];
            x.extend(WARM_S.map(|time_s| stood_for / v * warmth(t, time_s)));
            let guessed = if s.bus_v.is_none() {
                (ohm * i + k * w) / (v * v)
            } else {
                0.0
            };
            x.extend([-guessed, guessed * drawn.at(t)]);
            segment.x.iter_mut().zip(x).for_each(|(to, x)| to.push(x));
        }
        segments.push(segment);
    }
    block(joint, columns, segments, LEAST_DUTY)
}

/// The block of joint `joint` in newton metres; `None` where current or torque was not recorded.
pub(in crate::whole) fn torques(
    joint: usize,
    runs: &[(Signals<'_>, &Track)],
    motor: &Motor,
) -> Option<Raw> {
    let [constant, _] = constants(motor);
    let mut columns = vec![constant];
    columns.extend((0..WARM_S.len()).map(warm));
    let mut uneven = Column::open(UNEVEN, RATIO);
    uneven.parameter.key = "fraction";
    columns.push(uneven);
    let k = motor.nm_per_a[0];
    let mut segments = Vec::new();
    for (s, _) in runs {
        let (Some(current), Some(effort)) = (s.current, s.effort) else {
            continue;
        };
        let mut segment = Segment {
            x: vec![Vec::new(); columns.len()],
            ..Segment::default()
        };
        for t in instants(s.position) {
            let row = mean(current, t).zip(mean(effort, t));
            let (i, nm) = row.unwrap_or((0.0, 0.0));
            segment.weight.push(f64::from(u8::from(row.is_some())));
            segment.y.push(nm - k * i);
            let mut x = vec![k * i];
            x.extend(WARM_S.map(|time_s| -k * i * warmth(t, time_s)));
            x.push(k * i.abs());
            segment.x.iter_mut().zip(x).for_each(|(to, x)| to.push(x));
        }
        segments.push(segment);
    }
    block(joint, columns, segments, LEAST_NM)
}

fn block(joint: usize, columns: Vec<Column>, segments: Vec<Segment>, floor: f64) -> Option<Raw> {
    (!segments.is_empty()).then_some(Raw {
        site: Site {
            stage: Stage::Electrical,
            joint: Some(joint),
            blind: false,
            coarse: false,
        },
        columns,
        segments,
        floor,
        noisy: Vec::new(),
    })
}

/// The block of the supply; `None` where its voltage was not recorded. `runs` are voltage and current drawn by all joints.
pub(in crate::whole) fn supply(runs: &[(&Track, &Track)], supply_v: [f64; 2]) -> Option<Raw> {
    let [volt, tolerance] = supply_v;
    let columns = vec![
        Column::linear(Effect::SupplyVoltage, "value_v", volt, SUPPLY * volt).with_slack(tolerance),
        Column::linear(Effect::SupplySag, "resistance_ohm", 0.0, SAG_OHM).at_least_neutral(),
    ];
    let mut segments = Vec::new();
    for (bus, drawn) in runs {
        let mut segment = Segment {
            x: vec![Vec::new(); columns.len()],
            ..Segment::default()
        };
        for t in &drawn.t_s {
            let v = mean(bus, *t);
            segment.weight.push(f64::from(u8::from(v.is_some())));
            segment.y.push(v.unwrap_or(volt) - volt);
            segment.x[0].push(1.0);
            segment.x[1].push(-drawn.at(*t));
        }
        segments.push(segment);
    }
    (!segments.is_empty()).then_some(Raw {
        site: Site {
            stage: Stage::Supply,
            joint: None,
            blind: false,
            coarse: false,
        },
        columns,
        segments,
        floor: LEAST_V,
        noisy: Vec::new(),
    })
}

/// Current that all joints of a run draw from the supply, A; `None` where one of them does not tell it.
pub(in crate::whole) fn drawn(joints: &[(Signals<'_>, Motor)]) -> Option<Track> {
    if joints.iter().any(|(s, _)| !s.tell()) {
        return None;
    }
    let mut out = Track::default();
    for t in instants(joints.first()?.0.position) {
        let each: Option<Vec<f64>> = joints.iter().map(|(s, m)| s.drawn_a(m, t)).collect();
        if let Some(each) = each {
            out.t_s.push(t);
            out.v.push(each.iter().sum());
        }
    }
    (out.v.len() >= 2).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::super::found::{Named, named};
    use super::*;
    use crate::evidence::block::White;
    use crate::math::Rng;

    const MOTOR: Motor = Motor {
        nm_per_a: [4.3, 0.03],
        winding_ohm: [1.9, 0.04],
        supply_v: [12.0, 0.15],
    };
    const ROW_S: f64 = 0.01;

    /// A motor and its battery as they are.
    #[derive(Clone, Copy)]
    struct Truth {
        nm_per_a: f64,
        winding_ohm: f64,
        volt: f64,
        sag_ohm: f64,
        lost: [f64; 2],
        uneven: f64,
    }

    const HEALTHY: Truth = Truth {
        nm_per_a: 4.3,
        winding_ohm: 1.9,
        volt: 12.0,
        sag_ohm: 0.0,
        lost: [0.0, 1.0],
        uneven: 0.0,
    };

    struct Recorded {
        position: Track,
        duty: Track,
        current: Track,
        effort: Track,
        bus_v: Track,
    }

    /// The closed forms of winding and battery along a swing.
    fn recorded(truth: Truth) -> Recorded {
        let mut rng = Rng::new(8);
        let new = Track::default;
        let mut out = Recorded {
            position: new(),
            duty: new(),
            current: new(),
            effort: new(),
            bus_v: new(),
        };
        for n in 0..1200 {
            let t = f64::from(n) * ROW_S;
            let w = 0.9 * crate::math::sin(1.4 * t) + 0.4 * crate::math::sin(3.1 * t);
            let q = -0.9 / 1.4 * libm::cos(1.4 * t) - 0.4 / 3.1 * libm::cos(3.1 * t);
            let waves = [(0.3, 2.2), (0.15, 5.3)];
            let wave = |(size, speed)| size * crate::math::sin(speed * t + 0.5);
            let i = 0.1 + waves.map(wave).iter().sum::<f64>();
            let needed = truth.winding_ohm * i + truth.nm_per_a * w;
            // V = V0 - R d i with d = needed / V.
            let power = needed * i;
            let volt =
                0.5 * (truth.volt + (truth.volt * truth.volt - 4.0 * truth.sag_ohm * power).sqrt());
            let [lost, time_s] = truth.lost;
            let torque = truth.nm_per_a
                * i
                * (1.0 - lost * warmth(t, time_s))
                * (1.0 + truth.uneven * i.signum());
            let mut push = |track: &mut Track, v: f64, noise: f64| {
                track.t_s.push(t);
                track.v.push(v + noise * rng.normal());
            };
            push(&mut out.position, q, 3e-4);
            push(&mut out.duty, needed / volt, 2e-3);
            push(&mut out.current, i, 5e-3);
            push(&mut out.effort, torque, 0.03);
            push(&mut out.bus_v, volt, 0.02);
        }
        out
    }

    /// Effects named with their first value; `heard` are current, effort and bus.
    fn found(truth: Truth, heard: [bool; 3]) -> Named {
        let r = recorded(truth);
        let signals = Signals {
            position: &r.position,
            velocity: None,
            duty: Some(&r.duty),
            current: Some(&r.current).filter(|_| heard[0]),
            effort: Some(&r.effort).filter(|_| heard[1]),
            bus_v: Some(&r.bus_v).filter(|_| heard[2]),
        };
        let drawn = drawn(&[(signals, MOTOR)]).expect("a current");
        let runs = [(signals, &drawn)];
        let bus: Vec<(&Track, &Track)> = signals.bus_v.map(|b| (b, &drawn)).into_iter().collect();
        let raw = [
            duties(0, &runs, &MOTOR),
            torques(0, &runs, &MOTOR),
            supply(&bus, MOTOR.supply_v),
        ];
        let plain = |raw: Raw| White::new(raw, 6).plain();
        let blocks: Vec<_> = raw.into_iter().flatten().map(plain).collect();
        named(&blocks).0
    }

    #[test]
    fn what_the_winding_and_the_battery_have_is_named_with_its_size() {
        let of = |change: fn(&mut Truth)| {
            let mut truth = HEALTHY;
            change(&mut truth);
            truth
        };
        const ALL: [bool; 3] = [true, true, true];
        let cases = [
            ("nothing", HEALTHY, ALL, None),
            (
                "another winding",
                of(|t| t.winding_ohm = 2.8),
                [true, false, true],
                Some((Some(Effect::WindingResistance), 2.8 / 1.9)),
            ),
            (
                "weak magnets",
                of(|t| t.nm_per_a = 3.4),
                ALL,
                Some((Some(Effect::MotorConstant), 3.4 / 4.3)),
            ),
            (
                "a battery that sags",
                of(|t| t.sag_ohm = 0.4),
                ALL,
                Some((Some(Effect::SupplySag), 0.4)),
            ),
            (
                "a low battery, its voltage recorded",
                of(|t| t.volt = 10.0),
                ALL,
                Some((Some(Effect::SupplyVoltage), 10.0)),
            ),
            (
                "a low battery, its voltage not recorded",
                of(|t| t.volt = 10.0),
                [true, true, false],
                Some((Some(Effect::SupplyVoltage), 10.0)),
            ),
            (
                "a motor that warms",
                of(|t| t.lost = [0.3, 6.0]),
                ALL,
                Some((Some(Effect::ThermalDerating), 0.3)),
            ),
            (
                "torque by direction",
                of(|t| t.uneven = 0.2),
                ALL,
                Some((None, 0.2)),
            ),
        ];
        for (what, truth, heard, expected) in cases {
            let found = found(truth, heard);
            match expected {
                None => assert!(found.is_empty(), "{what}: {found:?}"),
                Some((effect, value)) => {
                    assert_eq!(found.len(), 1, "{what}: {found:?}");
                    assert_eq!(found[0].0, effect, "{what}: {found:?}");
                    let off = (found[0].1 / value - 1.0).abs();
                    assert!(off < 0.1, "{what}: {found:?}");
                }
            }
        }
    }
}
