//! What the signals show without a simulation: set-points on their way, the motor's voltage equation, the supply.

use super::conventions::Conventions;
use super::data::{Data, JOINTS, Track};
use super::joints::nm_per_a;
use super::least::solve;
use crate::math;
use crate::verdict::Estimate;
use crate::vocabulary::Effect;

/// An effect read off the signals.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Reading {
    pub(super) effect: Effect,
    pub(super) joint: Option<usize>,
    pub(super) key: &'static str,
    pub(super) estimate: Estimate,
    /// Squared tolerances by which it is off.
    pub(super) gain: f64,
}

/// Winding resistances of the two motors, ohm (catalogue of the 2342 012 CR and the 2232 012 SR).
fn winding_ohm(k: usize) -> f64 {
    if matches!(k, 1 | 4) { 4.09 } else { 1.9 }
}

/// Spread of motor constants and of windings of one type (1 sigma, relative); beyond three of them it is an effect. Windings also
/// warm up: 4 % per 10 K.
const MOTOR: [f64; 2] = [0.03, 0.05];
/// Voltage for which Table I states the motors, V, and the spread of a charged battery (1 sigma).
const SUPPLY_V: f64 = 12.0;
const SUPPLY_SPREAD_V: f64 = 0.15;
/// Least source resistance that counts, ohm: below it six motors at 0.5 A move the bus by less than 0.1 V.
const LEAST_OHM: f64 = 0.03;
/// Least share of lost set-points that counts: one in a hundred is a damaged frame now and then.
const LEAST_LOSS: f64 = 0.015;

/// Speed and slope of the angle that differ by more than this are no steady motion, rad/s.
const STEADY_RAD_S: f64 = 0.08;

/// Duty above which a driver may be at its limit.
const FULL_DUTY: f64 = 0.95;

/// What became of the set-points of a joint.
#[derive(Debug, Clone, Copy, Default)]
struct Way {
    sent: f64,
    lost: f64,
    delay: f64,
    delay2: f64,
    arrived: f64,
    /// Later than the first row that could show it.
    late: f64,
}

/// Times and values at which a held signal changes.
fn changes(track: &Track, least: f64) -> Vec<(f64, f64)> {
    let mut out: Vec<(f64, f64)> = Vec::new();
    for (t, v) in track.t_s.iter().zip(&track.v) {
        if out.last().is_none_or(|l| (l.1 - v).abs() > least) {
            out.push((*t, *v));
        }
    }
    out
}

/// Follows every sent value to the row in which it is applied; a value that a later one overtakes is lost.
fn follow(sent: &Track, applied: &Track, row_s: f64, out: &mut Way) {
    const EXACT_RAD: f64 = 2e-5;
    // Longer than any delay that a gait survives.
    const LONGEST_S: f64 = 0.4;
    let arrived = changes(applied, 0.0);
    let mut from = 0;
    for (t, v) in changes(sent, 10.0 * EXACT_RAD) {
        if t + LONGEST_S > applied.t_s[applied.t_s.len() - 1] {
            break;
        }
        while from < arrived.len() && arrived[from].0 < t {
            from += 1;
        }
        out.sent += 1.0;
        let hit = arrived[from..]
            .iter()
            .take_while(|a| a.0 <= t + LONGEST_S)
            .find(|a| (a.1 - v).abs() <= EXACT_RAD);
        match hit {
            Some(a) => {
                out.arrived += 1.0;
                out.delay += a.0 - t;
                out.delay2 += (a.0 - t).powi(2);
                out.late += f64::from(u8::from(a.0 - t > 1.6 * row_s));
            }
            None => out.lost += 1.0,
        }
    }
}

pub(super) fn exact(value: f64, half: f64) -> Estimate {
    Estimate {
        value,
        ci95: [value - half, value + half],
    }
}

/// Loss and jitter of joint `k`, from set-points sent and applied; whether either was found.
fn transport(data: &Data, k: usize, conventions: &Conventions, out: &mut Vec<Reading>) -> bool {
    let mut way = Way::default();
    let mut row_s = Vec::new();
    for run in &data.runs {
        let sent = run.joints[conventions.order[k]].command.as_ref();
        if let (Some(s), Some(a)) = (sent, run.joints[k].applied.as_ref()) {
            row_s.push(a.period_s());
            follow(s, a, a.period_s(), &mut way);
        }
    }
    // Values that mostly never appear have been changed on the way (rounded, scaled): nothing can be followed.
    if way.sent < 50.0 || way.arrived < 0.3 * way.sent {
        return false;
    }
    let row = math::median(&row_s);
    let loss = way.lost / way.sent;
    let mean = way.delay / way.arrived;
    let deviation = (way.delay2 / way.arrived - mean * mean).max(0.0).sqrt();
    let mut found = false;
    if loss > LEAST_LOSS {
        let half = 1.96 * (loss * (1.0 - loss) / way.sent).sqrt();
        out.push(Reading {
            effect: Effect::PacketLoss,
            joint: Some(k),
            key: "probability",
            estimate: exact(loss, half),
            gain: (loss / LEAST_LOSS).powi(2).min(1e3),
        });
        found = true;
    }
    // Some late and some not; a few that are late beside losses are values that came twice.
    let late = way.late / way.arrived;
    if deviation > 0.2 * row && (0.08..0.97).contains(&late) {
        // The extra delay is half a normal distribution: its deviation is 0.603 sigma; rows add a uniform error.
        let sigma = (deviation * deviation - row * row / 12.0)
            .max(0.04 * row * row)
            .sqrt()
            / 0.603;
        out.push(Reading {
            effect: Effect::Jitter,
            joint: Some(k),
            key: "sigma_s",
            estimate: exact(sigma, 1.96 * sigma / way.arrived.sqrt() + 0.1 * row),
            gain: (deviation / (0.2 * row)).powi(2).min(1e3),
        });
        found = true;
    }
    found
}

/// Torque constant and resistance over nominal from `duty V = R i + k n w`, by gait; empty when not measured.
fn windings(data: &Data, k: usize) -> Vec<[f64; 2]> {
    let mut sums = vec![([0.0; 4], [0.0; 2]); data.gaits.len()];
    for run in &data.runs {
        let j = &run.joints[k];
        let (Some(i), Some(d), Some(q), Some(bus)) = (
            j.current.as_ref(),
            j.duty.as_ref(),
            j.position.as_ref(),
            run.bus_v.as_ref(),
        ) else {
            continue;
        };
        let half_s = (1.6 * q.period_s()).max(0.02);
        for (t, amp) in i.t_s.iter().zip(&i.v) {
            let Some((_, slope)) = q.line(*t, half_s) else {
                continue;
            };
            let w = j.velocity.as_ref().map_or(slope, |v| v.at(*t));
            // Where the speed jumps, samples of one row do not belong to one instant.
            if (w - slope).abs() > STEADY_RAD_S {
                continue;
            }
            // At full duty the voltage is what there is, not what the motor takes.
            if d.at(*t).abs() > FULL_DUTY {
                continue;
            }
            let volt = d.at(*t) * bus.at(*t);
            let (a, b) = &mut sums[run.gait];
            let x = [*amp, w];
            for m in 0..2 {
                b[m] += x[m] * volt;
                for n in 0..2 {
                    a[2 * m + n] += x[m] * x[n];
                }
            }
        }
    }
    sums.iter()
        .filter(|s| s.0[0] > 0.0 && s.0[3] > 0.0)
        .map(|(a, b)| {
            let x = solve(a, b);
            [x[1] / nm_per_a(k), x[0] / winding_ohm(k)]
        })
        .collect()
}

/// Motors against their type and against each other.
fn motors(data: &Data, conventions: &mut Conventions, out: &mut Vec<Reading>) {
    let all: Vec<Vec<[f64; 2]>> = (0..JOINTS).map(|k| windings(data, k)).collect();
    for (what, effect) in [(0, Effect::MotorConstant), (1, Effect::WindingResistance)] {
        let one = |v: &Vec<[f64; 2]>| math::median(&v.iter().map(|x| x[what]).collect::<Vec<_>>());
        let known: Vec<f64> = all.iter().filter(|v| !v.is_empty()).map(one).collect();
        // Other motors than the catalogue's: then they are only compared with each other.
        let common = math::median(&known);
        let typical = if (0.9..1.1).contains(&common) {
            1.0
        } else {
            common
        };
        for (k, v) in all.iter().enumerate().filter(|x| !x.1.is_empty()) {
            let ratio = one(v) / typical;
            let spread = math::rms(
                &v.iter()
                    .map(|x| x[what] / typical - ratio)
                    .collect::<Vec<_>>(),
            );
            let error = spread / (v.len() as f64).sqrt();
            if what == 0 {
                conventions.per_ampere[k] = one(v);
            }
            if (ratio - 1.0).abs() > 3.0 * MOTOR[what].hypot(error) {
                out.push(Reading {
                    effect,
                    joint: Some(k),
                    key: "ratio",
                    estimate: exact(ratio, 1.96 * error),
                    gain: ((ratio - 1.0) / MOTOR[what]).powi(2).min(1e3),
                });
            }
        }
    }
}

/// Voltage and resistance of the supply from `V = V0 - R sum(duty i)`, by run.
fn supply(data: &Data, out: &mut Vec<Reading>) -> Option<f64> {
    let mut fits = Vec::new();
    for run in &data.runs {
        let Some(bus) = run.bus_v.as_ref() else {
            continue;
        };
        let pairs: Vec<(&Track, &Track)> = run
            .joints
            .iter()
            .filter_map(|j| Some((j.current.as_ref()?, j.duty.as_ref()?)))
            .collect();
        if pairs.len() < JOINTS {
            continue;
        }
        let (mut a, mut b) = ([0.0; 4], [0.0; 2]);
        for (t, v) in bus.t_s.iter().zip(&bus.v) {
            let sum: f64 = pairs.iter().map(|(i, d)| i.at(*t) * d.at(*t)).sum();
            let x = [1.0, -sum];
            for m in 0..2 {
                b[m] += x[m] * v;
                for n in 0..2 {
                    a[2 * m + n] += x[m] * x[n];
                }
            }
        }
        let x = solve(&a, &b);
        fits.push([x[0], x[1]]);
    }
    if fits.is_empty() {
        return None;
    }
    let column = |i: usize| fits.iter().map(|f| f[i]).collect::<Vec<_>>();
    let error = |v: &[f64], m: f64| {
        math::rms(&v.iter().map(|x| x - m).collect::<Vec<_>>()) / (v.len() as f64).sqrt()
    };
    let (volts, ohms) = (column(0), column(1));
    let (volt, ohm) = (math::mean(&volts), math::median(&ohms));
    if ohm > LEAST_OHM && ohm > 4.0 * error(&ohms, ohm) {
        out.push(Reading {
            effect: Effect::SupplySag,
            joint: None,
            key: "resistance_ohm",
            estimate: exact(ohm, 1.96 * error(&ohms, ohm)),
            gain: (ohm / LEAST_OHM).powi(2).min(1e3),
        });
    }
    if (volt - SUPPLY_V).abs() > 4.0 * SUPPLY_SPREAD_V {
        out.push(Reading {
            effect: Effect::SupplyVoltage,
            joint: None,
            key: "value_v",
            estimate: exact(volt, 1.96 * error(&volts, volt)),
            gain: ((volt - SUPPLY_V) / SUPPLY_SPREAD_V).powi(2).min(1e3),
        });
    }
    Some(volt)
}

/// The mass of the whole robot, from how much larger all joints' loads are than those of the nominal body.
pub(super) fn mass(ratios: &[f64], tolerance: f64) -> Option<Reading> {
    // Replayed loads of a null robot are right to 5 % per joint.
    const LOAD: f64 = 0.05;
    if ratios.len() < 4 {
        return None;
    }
    let ratio = math::median(ratios);
    let off = |r: &&f64| (**r - 1.0) * (ratio - 1.0).signum() > LOAD;
    let agree = ratios.iter().filter(off).count();
    let spread = math::rms(&ratios.iter().map(|r| r - ratio).collect::<Vec<_>>());
    let error = spread / (ratios.len() as f64).sqrt();
    let least = 3.0 * tolerance.hypot(0.5 * LOAD).hypot(error);
    ((ratio - 1.0).abs() > least && 3 * agree >= 2 * ratios.len()).then(|| Reading {
        effect: Effect::Mass,
        joint: None,
        key: "ratio",
        estimate: exact(ratio, 1.96 * error),
        gain: ((ratio - 1.0) / LOAD).powi(2),
    })
}

/// Reads everything off, and tells `conventions` what the joints need to know.
pub(super) fn read(
    data: &Data,
    conventions: &mut Conventions,
    withhold: &[Effect],
) -> Vec<Reading> {
    let mut out = Vec::new();
    for k in 0..JOINTS {
        conventions.uneven[k] = transport(data, k, conventions, &mut out);
    }
    motors(data, conventions, &mut out);
    if let Some(volt) = supply(data, &mut out) {
        for k in 0..JOINTS {
            // Beyond this speed no voltage is left for torque.
            conventions.no_load_rad_s[k] = volt / (nm_per_a(k) * conventions.per_ampere[k]);
        }
    }
    out.retain(|r| !withhold.contains(&r.effect));
    out
}
