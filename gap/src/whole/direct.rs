//! What the signals show without a simulation: set-points on their way ([`echo`]), the motor's voltage equation, the supply.

use super::conventions::Conventions;
use super::data::{Data, JOINTS, Track};
use super::echo;
use super::least::solve;
use super::nominal::{self, Motors};
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

impl Reading {
    /// How far it stands over the threshold of about three tolerances.
    pub(super) fn strength(&self) -> f64 {
        self.gain.sqrt() / BEYOND
    }
}

/// Least spread of motor constants and of windings (1 sigma, relative) where no speed was recorded and the slope of the angle stands for it: what the slope smooths away goes with the current. Of two robots that
/// MuJoCo played one winding each came out 1.23 and 1.25, and constants 0.86 to 0.90.
const MOTOR_SLOPED: [f64; 2] = [0.09, 0.12];
/// Spreads of its type (model) beyond which a motor has an effect.
const BEYOND: f64 = 3.0;
/// Factor on an error that a jackknife over some gaits gives: of six gaits it is known to a third.
const ERRORS: f64 = 1.5;
/// Least source resistance that counts, ohm: below it six motors at 0.5 A move the bus by less than 0.1 V.
const LEAST_OHM: f64 = 0.03;
/// Relative error of a source resistance: five came out 7 to 15 % high (emulated robots), perhaps because filtered readings of the current miss
/// its chatter, which the bus carries too.
const FILTERED: f64 = 0.08;
/// Speed and slope of the angle that differ by more than this are no steady motion, rad/s.
const STEADY_RAD_S: f64 = 0.08;

/// Duty above which a driver may be at its limit.
const FULL_DUTY: f64 = 0.95;

pub(super) fn exact(value: f64, half: f64) -> Estimate {
    Estimate {
        value,
        ci95: [value - half, value + half],
    }
}

/// Sums of the motor's voltage equation over one gait.
#[derive(Debug, Clone, Copy, Default)]
struct Volts {
    /// Instruments (rows) times current and speed.
    a: [f64; 4],
    /// Instruments times voltage.
    b: [f64; 2],
}

impl Volts {
    fn add(&mut self, other: &Self) {
        self.a.iter_mut().zip(&other.a).for_each(|(x, y)| *x += y);
        self.b.iter_mut().zip(&other.b).for_each(|(x, y)| *x += y);
    }

    /// Torque constant and resistance of joint `k` over nominal.
    fn ratios(&self, motors: &Motors, k: usize) -> Option<[f64; 2]> {
        let [a, b, c, d] = self.a;
        let det = a * d - b * c;
        let ohm = (d * self.b[0] - b * self.b[1]) / det;
        let volt_s = (a * self.b[1] - c * self.b[0]) / det;
        (ohm.is_finite() && volt_s.is_finite()).then(|| {
            [
                volt_s / motors.nm_per_a[k][0],
                ohm / motors.winding_ohm[k][0],
            ]
        })
    }
}

/// Sums of `duty V = R i + k n w` at steady speed, by gait.
///
/// Current and speed are noisy, which would pull a plain regression towards zero: the neighbouring samples of the current and the slope
/// of the angle, whose noise is their own, stand in for them (instrumental variables).
fn volts(data: &Data, k: usize) -> Vec<Volts> {
    let mut sums = vec![Volts::default(); data.gaits.len()];
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
        for (n, (t, amp)) in i.t_s.iter().zip(&i.v).enumerate() {
            let beside = (i.v.get(n.wrapping_sub(1)), i.v.get(n + 1));
            let (Some((_, slope)), (Some(before), Some(after))) = (q.line(*t, half_s), beside)
            else {
                continue;
            };
            let w = j.velocity.as_ref().map_or(slope, |v| v.at(*t));
            // Where the speed jumps, samples of one row do not belong to one instant; at full duty the voltage is what there is, not
            // what the motor takes.
            if (w - slope).abs() > STEADY_RAD_S || d.at(*t).abs() > FULL_DUTY {
                continue;
            }
            let volt = d.at(*t) * bus.at(*t);
            let near = 0.5 * (before + after);
            sums[run.gait].add(&Volts {
                a: [near * amp, near * w, slope * amp, slope * w],
                b: [near * volt, slope * volt],
            });
        }
    }
    sums.retain(|s| s.a[0] != 0.0 && s.a[3] > 0.0);
    sums
}

/// Torque constant and resistance over nominal with their errors (jackknife over gaits); `None` when not measured.
fn windings(data: &Data, k: usize) -> Option<[(f64, f64); 2]> {
    let sums = volts(data, k);
    let without = |left_out: Option<usize>| {
        let mut all = Volts::default();
        let kept = sums.iter().enumerate().filter(|s| Some(s.0) != left_out);
        kept.for_each(|s| all.add(s.1));
        all.ratios(&data.motors, k)
    };
    let whole = without(None)?;
    let n = sums.len() as f64;
    let each: Vec<[f64; 2]> = (0..sums.len()).filter_map(|g| without(Some(g))).collect();
    let one = |what: usize| {
        let square: f64 = each.iter().map(|e| (e[what] - whole[what]).powi(2)).sum();
        // One gait alone says nothing about its error.
        let error = if n < 2.0 {
            1.0
        } else {
            ((n - 1.0) / n * square).sqrt()
        };
        (whole[what], error)
    };
    Some([one(0), one(1)])
}

/// Squared tolerances, of torque constant and winding together, within which a motor is of a kind, and beyond which it is none of it.
const OF_A_KIND: [f64; 2] = [18.0, 60.0];

/// Whether the motor whose signals stand in each column is of the inter joints' kind, where it is clearly of one kind; `None` where no two motors of
/// different kinds stand in each other's place.
pub(super) fn displaced(data: &Data) -> Option<[Option<bool>; JOINTS]> {
    let kinds: [Option<bool>; JOINTS] = std::array::from_fn(|k| kind(data, k));
    let astray = |inter| {
        let here =
            |(k, kind): (usize, &Option<bool>)| *kind == Some(inter) && nominal::inter(k) != inter;
        kinds.iter().enumerate().any(here)
    };
    (astray(true) && astray(false)).then_some(kinds)
}

/// Whether the motor in column `k` is of the inter joints' kind.
fn kind(data: &Data, k: usize) -> Option<bool> {
    let measured = windings(data, k)?;
    let own = nominal::inter(k);
    let motors = &data.motors;
    let like = |inter: bool| {
        let there = (0..JOINTS).find(|j| nominal::inter(*j) == inter);
        let there = there.unwrap_or(k);
        let over = |of: &[[f64; 2]; JOINTS]| of[k][0] / of[there][0];
        let to = [over(&motors.nm_per_a), over(&motors.winding_ohm)];
        let spread = motors.spread(there);
        let off = |what: usize| {
            let (ratio, error) = measured[what];
            let tolerance = libm::hypot(spread[what], ERRORS * error * to[what]);
            ((ratio * to[what] - 1.0) / tolerance).powi(2)
        };
        off(0) + off(1)
    };
    let [within, beyond] = OF_A_KIND;
    [own, !own]
        .into_iter()
        .find(|inter| like(*inter) < within && like(!*inter) > beyond)
}

/// Spread of torque constant and winding of joint `k` as its signals show them, over those of its type, and the part of it that is the signals'.
fn motor(data: &Data, k: usize) -> [[f64; 2]; 2] {
    let own = data.motors.spread(k);
    if data.has(k, |j| j.velocity.is_some()) {
        return [own, [0.0; 2]];
    }
    let sloped = [0, 1].map(|what| MOTOR_SLOPED[what].max(own[what]));
    [sloped, MOTOR_SLOPED]
}

/// Motors against their type and against each other; the resistance of every winding, ohm.
fn motors(data: &Data, conventions: &mut Conventions, out: &mut Vec<Reading>) -> [f64; JOINTS] {
    let mut ohm = data.motors.winding_ohm.map(|w| w[0]);
    let all: Vec<Option<[(f64, f64); 2]>> = (0..JOINTS).map(|k| windings(data, k)).collect();
    for (what, effect) in [(0, Effect::MotorConstant), (1, Effect::WindingResistance)] {
        let known: Vec<f64> = all.iter().flatten().map(|v| v[what].0).collect();
        // Other motors than the catalogue's: then they are only compared with each other.
        let common = math::median(&known);
        let typical = if (0.9..1.1).contains(&common) {
            1.0
        } else {
            common
        };
        for (k, v) in all.iter().enumerate().filter_map(|(k, v)| Some((k, (*v)?))) {
            let (ratio, error) = (v[what].0 / typical, v[what].1 / typical);
            let [spread, signals] = motor(data, k).map(|m| m[what]);
            if what == 0 {
                // Weighed against the type: a joint that hardly turns says little of its motor.
                let [own, prior] = [error.max(1e-3), spread].map(|e| 1.0 / (e * e));
                let off = (ratio - 1.0).abs()
                    > BEYOND * libm::hypot(prior.recip().sqrt(), ERRORS * error);
                let weighed = (own * ratio + prior) / (own + prior);
                conventions.per_ampere[k] = typical * if off { ratio } else { weighed };
            } else {
                let [own, prior] = [error.max(1e-3), spread].map(|e| 1.0 / (e * e));
                ohm[k] *= typical * (own * ratio + prior) / (own + prior);
            }
            if (ratio - 1.0).abs() > BEYOND * libm::hypot(spread, ERRORS * error) {
                out.push(Reading {
                    effect,
                    joint: Some(k),
                    key: "ratio",
                    estimate: exact(ratio, 1.96 * libm::hypot(ERRORS * error, signals)),
                    gain: ((ratio - 1.0) / libm::hypot(spread, error))
                        .powi(2)
                        .min(1e3),
                });
            }
        }
    }
    ohm
}

/// Voltage and resistance of the supply from `V = V0 - R sum(duty i)`, by run; whether they were measured.
fn supply(data: &Data, out: &mut Vec<Reading>) -> bool {
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
        return false;
    }
    let column = |i: usize| fits.iter().map(|f| f[i]).collect::<Vec<_>>();
    let error = |v: &[f64], m: f64| {
        let free = (v.len() as f64 - 1.0).max(1.0);
        math::few(free) * math::rms(&v.iter().map(|x| x - m).collect::<Vec<_>>()) / free.sqrt()
    };
    let (volts, ohms) = (column(0), column(1));
    let (volt, ohm) = (math::mean(&volts), math::median(&ohms));
    if ohm > LEAST_OHM && ohm > 4.0 * error(&ohms, ohm) {
        out.push(Reading {
            effect: Effect::SupplySag,
            joint: None,
            key: "resistance_ohm",
            estimate: exact(ohm, 1.96 * libm::hypot(error(&ohms, ohm), FILTERED * ohm)),
            gain: (ohm / LEAST_OHM).powi(2).min(1e3),
        });
    }
    let [nominal_v, spread_v] = data.motors.supply_v;
    if (volt - nominal_v).abs() > 4.0 * spread_v {
        out.push(Reading {
            effect: Effect::SupplyVoltage,
            joint: None,
            key: "value_v",
            estimate: exact(volt, 1.96 * error(&volts, volt)),
            gain: ((volt - nominal_v) / spread_v).powi(2).min(1e3),
        });
    }
    true
}

/// Reads everything off, and tells `conventions` what the joints need to know.
pub(super) fn read(
    data: &Data,
    conventions: &mut Conventions,
    withhold: &[Effect],
) -> Vec<Reading> {
    let mut out = Vec::new();
    echo::read(data, conventions, withhold, &mut out);
    let ohm = motors(data, conventions, &mut out);
    if supply(data, &mut out) {
        conventions.winding_ohm = ohm;
    }
    out
}
