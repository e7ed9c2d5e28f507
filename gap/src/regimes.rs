//! In which regime of the motion the gap sits: at the motor's limit, at a reversal, in one direction, in a quarter of the cycle, at a low voltage, at a blow.

use serde::Serialize;

use crate::math;

/// Regimes of motion, in order of precedence.
pub const MOTION: [&str; 6] = [
    "saturation",
    "reversal",
    "low_speed",
    "high_load",
    "warm_up",
    "other",
];

/// What regimes are told apart by: those of one aspect share the time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Aspect {
    /// What the motor does.
    Motion,
    /// Sense of the motion.
    Direction,
    /// Quarters of the joint's cycle, by the middle of its angles and the sense of its motion.
    Phase,
    /// Voltage of the bus.
    Supply,
    /// Blows of the ground on the inertial sensor.
    Contact,
}

const COUNT: usize = 16;

/// Every regime with its aspect; those of the motion first, in the order of [`MOTION`].
pub(crate) const REGIMES: [(Aspect, &str); COUNT] = [
    (Aspect::Motion, MOTION[0]),
    (Aspect::Motion, MOTION[1]),
    (Aspect::Motion, MOTION[2]),
    (Aspect::Motion, MOTION[3]),
    (Aspect::Motion, MOTION[4]),
    (Aspect::Motion, MOTION[5]),
    (Aspect::Direction, "forwards"),
    (Aspect::Direction, "backwards"),
    (Aspect::Phase, "low_rising"),
    (Aspect::Phase, "high_rising"),
    (Aspect::Phase, "high_falling"),
    (Aspect::Phase, "low_falling"),
    (Aspect::Supply, "low_voltage"),
    (Aspect::Supply, "usual_voltage"),
    (Aspect::Contact, "blow"),
    (Aspect::Contact, "quiet"),
];
const DIRECTION: usize = 6;
const PHASE: usize = 8;
const SUPPLY: usize = 12;
const CONTACT: usize = 14;

/// Time after a reversal that belongs to it, s.
const REVERSAL_S: f64 = 0.15;
/// Time to either side over which speeds are taken, s.
const HALF_S: f64 = 0.05;
/// Time from which a motor may be warm, s.
const WARM_S: f64 = 60.0;
/// Share of the median below which the voltage of the bus is low: a battery under six motors at 0.5 A falls by some per cent.
const LOW: f64 = 0.98;
/// Time around a blow that belongs to it, s.
const BLOW_S: f64 = 0.1;

/// Regimes that hold at an instant, one bit each.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Marks(u32);

impl Marks {
    fn mark(&mut self, regime: usize) {
        self.0 |= 1 << regime;
    }

    /// Whether a window has a blow.
    pub(crate) fn contact(blow: bool) -> Self {
        Self(1 << (CONTACT + usize::from(!blow)))
    }

    fn has(self, regime: usize) -> bool {
        self.0 & (1 << regime) != 0
    }
}

/// A joint's run, row by row.
pub(crate) struct Course<'a> {
    /// Times, s.
    pub(crate) t_s: &'a [f64],
    /// Measured angles, rad.
    pub(crate) angle_rad: &'a [f64],
    /// Simulated torques, N m.
    pub(crate) effort_nm: &'a [f64],
    /// Whether the motor is at its limit.
    pub(crate) full: &'a dyn Fn(usize) -> bool,
}

impl Course<'_> {
    fn speeds_rad_s(&self) -> Vec<f64> {
        let (t, q) = (self.t_s, self.angle_rad);
        let last = t.len().saturating_sub(1);
        let mean_s = (t[last] - t[0]) / t.len() as f64;
        let half = libm::ceil(HALF_S / mean_s.max(1e-6) - 1e-6) as usize;
        let speed = |i: usize| {
            let (a, b) = (i.saturating_sub(half), (i + half).min(last));
            if b > a {
                (q[b] - q[a]) / (t[b] - t[a]).max(1e-9)
            } else {
                0.0
            }
        };
        (0..t.len()).map(speed).collect()
    }

    /// Speed of every row, and that below which a joint stands.
    fn moving(&self) -> (Vec<f64>, f64) {
        let speed = self.speeds_rad_s();
        let sizes = speed.iter().map(|v| v.abs()).filter(|v| v.is_finite());
        let slow = 0.05 * math::quantile(&sizes.collect::<Vec<_>>(), 0.95);
        (speed, slow)
    }

    /// Regime of the motion of every row, as an index into [`MOTION`].
    pub(crate) fn motion(&self) -> Vec<usize> {
        let (speed, slow) = self.moving();
        let efforts: Vec<f64> = self.effort_nm.iter().map(|x| x.abs()).collect();
        let high = math::quantile(&efforts, 0.9);
        let end_s = self.t_s.last().copied().unwrap_or(0.0);
        let (mut sign, mut turned_s) = (0.0, f64::NEG_INFINITY);
        let one = |(i, (v, t)): (usize, (&f64, &f64))| {
            if v.abs() > slow && v.signum() != sign {
                (sign, turned_s) = (v.signum(), *t);
            }
            match () {
                () if (self.full)(i) => 0,
                () if t - turned_s < REVERSAL_S => 1,
                () if v.abs() < slow => 2,
                () if efforts[i] >= high => 3,
                () if *t > WARM_S && *t > 0.5 * end_s => 4,
                () => 5,
            }
        };
        speed.iter().zip(self.t_s).enumerate().map(one).collect()
    }

    /// All regimes of every row; `bus_v` at every row, and the instants of blows, where they were measured.
    pub(crate) fn marks(&self, bus_v: Option<&[f64]>, blows_s: Option<&[f64]>) -> Vec<Marks> {
        let (speed, slow) = self.moving();
        let middle = usual(self.angle_rad);
        let usual_v = bus_v.map(usual);
        let mut rises = None;
        let one = |(i, motion): (usize, usize)| {
            let mut out = Marks::default();
            out.mark(motion);
            if speed[i].abs() > slow {
                rises = Some(speed[i] > 0.0);
                out.mark(DIRECTION + usize::from(speed[i] < 0.0));
            }
            if let Some(rises) = rises {
                out.mark(PHASE + quarter(self.angle_rad[i] >= middle, rises));
            }
            if let (Some(v), Some(usual)) = (bus_v, usual_v)
                && v[i].is_finite()
            {
                out.mark(SUPPLY + usize::from(v[i] >= LOW * usual));
            }
            if let Some(blows) = blows_s {
                out.mark(CONTACT + usize::from(!struck(blows, self.t_s[i])));
            }
            out
        };
        self.motion().into_iter().enumerate().map(one).collect()
    }
}

/// Median of the values that were measured.
fn usual(values: &[f64]) -> f64 {
    let known: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    math::median(&known)
}

/// Quarter of a cycle.
const fn quarter(high: bool, rises: bool) -> usize {
    match (high, rises) {
        (false, true) => 0,
        (true, true) => 1,
        (true, false) => 2,
        (false, false) => 3,
    }
}

/// Whether one of `blows_s`, in order, is near `t_s`.
pub(crate) fn struck(blows_s: &[f64], t_s: f64) -> bool {
    let next = blows_s.partition_point(|b| *b < t_s - BLOW_S);
    blows_s.get(next).is_some_and(|b| *b <= t_s + BLOW_S)
}

/// Errors in one regime of the motion, held-out runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RegimeRow {
    /// Joint; null for the body.
    pub joint: Option<usize>,
    /// What the regime is one of.
    pub aspect: Aspect,
    /// Which.
    pub regime: &'static str,
    /// Its share of the time.
    pub time: f64,
    /// Root mean square error of the angle, rad, with the nominal model and with the effects found; null where not measured.
    pub position_rmse_rad: Option<[f64; 2]>,
    /// The same of the torque, N m.
    pub effort_rmse_nm: Option<[f64; 2]>,
    /// The same of the base's position after windows of 1 s, m.
    pub pose_rmse_m: Option<[f64; 2]>,
}

/// What is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Compared {
    Position,
    Effort,
    Pose,
}

/// Sums of squared errors by regime.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sums {
    /// Number of samples and sum of squares, by what is compared, before and after.
    cells: [[[[f64; 2]; 2]; COUNT]; 3],
}

impl Sums {
    /// Adds an error of the nominal model, or of the final one.
    pub(crate) fn add(&mut self, of: Compared, after: bool, marks: Marks, error: f64) {
        let cells = &mut self.cells[of as usize];
        for (_, cell) in cells.iter_mut().enumerate().filter(|c| marks.has(c.0)) {
            let sum = &mut cell[usize::from(after)];
            sum[0] += 1.0;
            sum[1] += error * error;
        }
    }

    /// The regimes that occurred.
    pub(crate) fn rows(&self, joint: Option<usize>) -> Vec<RegimeRow> {
        let count = |k: usize| self.cells.iter().map(|c| c[k][0][0]).fold(0.0, f64::max);
        let pair = |of: Compared, k: usize| {
            let [before, after] = self.cells[of as usize][k];
            let rms = |[n, squares]: [f64; 2]| (squares / n.max(1.0)).sqrt();
            (before[0] > 0.0 && after[0] > 0.0).then(|| [rms(before), rms(after)])
        };
        let row = |(k, (aspect, regime)): (usize, (Aspect, &'static str))| {
            let same = REGIMES.iter().enumerate().filter(|r| r.1.0 == aspect);
            let all: f64 = same.map(|r| count(r.0)).sum();
            (count(k) > 0.0).then(|| RegimeRow {
                joint,
                aspect,
                regime,
                time: count(k) / all,
                position_rmse_rad: pair(Compared::Position, k),
                effort_rmse_nm: pair(Compared::Effort, k),
                pose_rmse_m: pair(Compared::Pose, k),
            })
        };
        REGIMES.into_iter().enumerate().filter_map(row).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sine of one turn a second in rows of 10 ms, and its rows.
    fn sine() -> (Vec<f64>, Vec<f64>) {
        let t_s: Vec<f64> = (0..1000).map(|i| 0.01 * f64::from(i)).collect();
        let angle = |t: &f64| libm::sin(core::f64::consts::TAU * t);
        (t_s.clone(), t_s.iter().map(angle).collect())
    }

    /// Rows of errors that are 3 where `bad` and 1 elsewhere, before; none after.
    fn rows(
        bad: impl Fn(f64) -> bool,
        bus_v: Option<&[f64]>,
        blows_s: Option<&[f64]>,
    ) -> Vec<RegimeRow> {
        let (t_s, angle_rad) = sine();
        // The strongest tenth is that at the limit.
        let effort_nm = t_s.clone();
        let course = Course {
            t_s: &t_s,
            angle_rad: &angle_rad,
            effort_nm: &effort_nm,
            full: &|i| t_s[i] > 9.0,
        };
        let mut sums = Sums::default();
        for (t, marks) in t_s.iter().zip(course.marks(bus_v, blows_s)) {
            sums.add(
                Compared::Position,
                false,
                marks,
                if bad(*t) { 3.0 } else { 1.0 },
            );
            sums.add(Compared::Position, true, marks, 0.0);
        }
        sums.rows(Some(4))
    }

    fn before(rows: &[RegimeRow], regime: &str) -> f64 {
        let row = rows.iter().find(|r| r.regime == regime);
        row.map_or(f64::NAN, |r| r.position_rmse_rad.unwrap()[0])
    }

    #[test]
    fn errors_are_told_in_the_regime_where_they_are() {
        // Every fourth row without a voltage.
        let volts = |(i, t): (usize, &f64)| match (i % 4, *t < 3.0) {
            (0, _) => f64::NAN,
            (_, true) => 11.0,
            (_, false) => 12.0,
        };
        let low: Vec<f64> = sine().0.iter().enumerate().map(volts).collect();
        let blows = [2.0, 4.0, 6.0];
        type Bad = fn(f64) -> bool;
        let cases: [(&str, &str, Bad); 6] = [
            ("high_falling", "low_rising", |t| {
                (4.0 * t).rem_euclid(4.0) as usize == 1
            }),
            ("forwards", "backwards", |t| {
                [0, 3].contains(&((4.0 * t).rem_euclid(4.0) as usize))
            }),
            ("saturation", "other", |t| t > 9.0),
            ("low_voltage", "usual_voltage", |t| t < 3.0),
            ("blow", "quiet", |t| {
                [2.0, 4.0, 6.0].iter().any(|b| (t - b).abs() < 0.1)
            }),
            ("reversal", "other", |t| {
                (2.0 * t - 0.5).rem_euclid(1.0) < 0.3
            }),
        ];
        for (there, elsewhere, bad) in cases {
            let rows = rows(bad, Some(&low), Some(&blows));
            let [here, other] = [there, elsewhere].map(|r| before(&rows, r));
            assert!(
                here > 2.6 && other < 1.5,
                "{there}: {here}, {elsewhere}: {other}"
            );
            assert!(
                rows.iter()
                    .all(|r| r.joint == Some(4) && r.position_rmse_rad.unwrap()[1] == 0.0)
            );
        }
    }

    #[test]
    fn the_regimes_of_an_aspect_share_the_time() {
        let rows = rows(|_| false, None, None);
        let share = |aspect| -> f64 {
            let own = rows.iter().filter(|r| r.aspect == aspect);
            own.map(|r| r.time).sum()
        };
        for (aspect, whole) in [
            (Aspect::Motion, 1.0),
            (Aspect::Direction, 1.0),
            (Aspect::Phase, 1.0),
            (Aspect::Supply, 0.0),
            (Aspect::Contact, 0.0),
        ] {
            assert!((share(aspect) - whole).abs() < 1e-9, "{aspect:?}");
        }
        assert!((before(&rows, "other") - 1.0).abs() < 1e-12);
    }
}
