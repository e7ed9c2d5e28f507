//! The inertial sensor beside the tracked pose: where the base is and how it moves between and at tracked samples, and where down is.
//!
//! A walking robot shakes: its angular velocity changes by tenths of rad/s between two tracked poses. The rate gyro and the
//! accelerometer hold that; the tracked pose holds what they lose over seconds. Both dead reckonings are laid onto the tracked
//! samples around an instant by straight lines. How many samples that takes is what predicts left-out samples best; where no
//! choice beats a parabola through the tracked samples alone, the sensor is not used.

use files::dataset::Recording;

use super::data::{BaseTrack, Data, Run};
use super::least;
use super::turn;
use crate::math;

/// Rows of an inertial sensor, body axes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Inertial {
    /// Times from the start of the run, s.
    pub t_s: Vec<f64>,
    /// Angular velocity, rad/s.
    pub gyro_rad_s: Vec<[f64; 3]>,
    /// Specific force, mean since the row before, m/s2.
    pub accel_m_s2: Vec<[f64; 3]>,
}

/// Times the median deviation of the specific force's size from which a row is a blow (four standard deviations of noise), and the least of it, m/s2.
const BLOW: f64 = 6.0;
const BLOW_M_S2: f64 = 2.0;

impl Inertial {
    /// Instants at which the specific force is far from its usual size.
    #[must_use]
    pub fn blows_s(&self) -> Vec<f64> {
        let size = |a: &[f64; 3]| libm::sqrt(a.iter().map(|x| x * x).sum());
        let sizes: Vec<f64> = self.accel_m_s2.iter().map(size).collect();
        let usual = crate::math::median(&sizes);
        let off: Vec<f64> = sizes.iter().map(|x| (x - usual).abs()).collect();
        let least = (BLOW * crate::math::median(&off)).max(BLOW_M_S2);
        let rows = self.t_s.iter().zip(off).filter(|(_, off)| *off > least);
        rows.map(|(t, _)| *t).collect()
    }

    /// The sensor's rows; `None` without all six columns.
    #[must_use]
    pub fn new(r: &Recording) -> Option<Self> {
        let b = r.body();
        let columns: Vec<&[f64]> = b
            .gyro_rad_s
            .iter()
            .chain(&b.accel_m_s2)
            .map(|c| c.as_deref())
            .collect::<Option<_>>()?;
        let mut out = Self::default();
        for (i, t) in r.t_s().iter().enumerate() {
            if columns.iter().all(|c| c[i].is_finite()) {
                out.t_s.push(t - r.t_s()[0]);
                out.gyro_rad_s.push(std::array::from_fn(|k| columns[k][i]));
                out.accel_m_s2
                    .push(std::array::from_fn(|k| columns[3 + k][i]));
            }
        }
        (out.t_s.len() >= 20).then_some(out)
    }
}

/// Error of the slope that the sensor shows, rad: a calibrated accelerometer's bias of 15 mm/s2, and emulated robots (up to 1.8 mrad).
pub(super) const SLOPE_RAD: f64 = 2.0e-3;

/// Roll and pitch of the ground in the tracker's frame, as mean over gaits; `None` without the sensor or in a single run.
pub(super) fn slope(data: &Data) -> Option<[f64; 2]> {
    let shown = |r: &Run| Some((r.gait, r.base.as_ref()?.reckoned.as_ref()?.gravity));
    let all: Vec<(usize, [f64; 3])> = data.runs.iter().filter_map(shown).collect();
    if all.len() < 2 {
        return None;
    }
    let mean: [f64; 3] =
        std::array::from_fn(|k| math::mean(&all.iter().map(|x| x.1[k]).collect::<Vec<_>>()));
    let size = mean.iter().map(|x| x * x).sum::<f64>().sqrt();
    // Runs that disagree show a sensor that is loose or a tracker that is not on its clock.
    let spread = |k: usize| {
        let own: Vec<f64> = all.iter().map(|x| (x.1[k] - mean[k]).abs()).collect();
        math::median(&own) / size / (own.len() as f64).sqrt()
    };
    if spread(0).max(spread(1)) > SLOPE_RAD || (size / physics::GRAVITY_M_S2 - 1.0).abs() > 0.05 {
        return None;
    }
    // Gravity in the frame of a ground turned by roll about x, then by pitch about y.
    Some([
        libm::atan2(-mean[1], -mean[2]),
        libm::asin((mean[0] / size).clamp(-1.0, 1.0)),
    ])
}

/// Half widths that are tried for the straight lines, s.
const HALVES_S: [f64; 5] = [0.12, 0.2, 0.3, 0.45, 0.7];
/// Longest gap between rows that is bridged, s.
const GAP_S: f64 = 0.1;

/// Motion by dead reckoning, and how to lay it onto the tracked pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Reckoned {
    t_s: Vec<f64>,
    gyro: Vec<[f64; 3]>,
    attitude: Vec<[f64; 4]>,
    velocity: Vec<[f64; 3]>,
    position: Vec<[f64; 3]>,
    /// Half width for attitude and position, s; 0 = the sensor is no help.
    half_s: [f64; 2],
    /// Mean of gravity over the run in the tracker's frame, m/s2.
    gravity: [f64; 3],
}

/// Attitude, angular velocity, position and velocity in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Body to world.
    pub attitude: [f64; 4],
    /// World axes, rad/s.
    pub angular_rad_s: [f64; 3],
    /// m.
    pub position_m: [f64; 3],
    /// m/s.
    pub velocity_m_s: [f64; 3],
}

impl Reckoned {
    /// Dead reckoning of a run; `None` where the sensor pauses or predicts tracked samples worse than they do each other.
    #[must_use]
    pub fn new(sensor: &Inertial, base: &BaseTrack) -> Option<Self> {
        let dt = sensor.t_s.windows(2).map(|w| w[1] - w[0]);
        if dt.fold(0.0, f64::max) > GAP_S {
            return None;
        }
        let n = sensor.t_s.len();
        let mut out = Self {
            t_s: sensor.t_s.clone(),
            gyro: sensor.gyro_rad_s.clone(),
            attitude: Vec::with_capacity(n),
            velocity: vec![[0.0; 3]; n],
            position: vec![[0.0; 3]; n],
            half_s: [0.0; 2],
            gravity: [0.0; 3],
        };
        let mut q = [1.0, 0.0, 0.0, 0.0];
        for i in 0..n {
            if i > 0 {
                let (a, b) = (sensor.gyro_rad_s[i - 1], sensor.gyro_rad_s[i]);
                let dt = sensor.t_s[i] - sensor.t_s[i - 1];
                let step = std::array::from_fn(|k| 0.5 * (a[k] + b[k]) * dt);
                q = turn::times(q, turn::exp(step));
            }
            out.attitude.push(q);
        }
        out.half_s[0] = out.best(base, 0)?;
        out.fall(sensor, base)?;
        out.half_s[1] = out.best(base, 1).unwrap_or(0.0);
        Some(out)
    }

    /// Integrates the specific force, turned by the attitude as tracked, and takes out its mean.
    fn fall(&mut self, sensor: &Inertial, base: &BaseTrack) -> Option<()> {
        let n = self.t_s.len();
        let mut force = vec![[0.0; 3]; n];
        for (i, slot) in force.iter_mut().enumerate().skip(1) {
            let middle = 0.5 * (self.t_s[i - 1] + self.t_s[i]);
            *slot = turn::apply(self.attitude(base, middle)?, sensor.accel_m_s2[i]);
        }
        // Mean force over the run = change of speed over time, less gravity.
        let (from, to) = (
            base.t_s.get(3)?,
            base.t_s.get(base.t_s.len().checked_sub(4)?)?,
        );
        let mut sum = [0.0; 3];
        let mut time = 0.0;
        for (i, f) in force.iter().enumerate().skip(1) {
            let dt = self.t_s[i].min(*to) - self.t_s[i - 1].max(*from);
            if dt > 0.0 {
                time += dt;
                sum.iter_mut().zip(f).for_each(|(s, f)| *s += f * dt);
            }
        }
        if time < 1.0 {
            return None;
        }
        for (k, sum) in sum.iter().enumerate() {
            let speed = |t: f64| base.position_m[k].curve(t, HALF_S).map(|x| x.1);
            self.gravity[k] = (speed(*to)? - speed(*from)? - sum) / time;
        }
        for (i, f) in force.iter().enumerate().skip(1) {
            let dt = self.t_s[i] - self.t_s[i - 1];
            for (k, f) in f.iter().enumerate() {
                let v = self.velocity[i - 1][k];
                let next = v + (f + self.gravity[k]) * dt;
                self.velocity[i][k] = next;
                self.position[i][k] = self.position[i - 1][k] + 0.5 * (v + next) * dt;
            }
        }
        Some(())
    }

    /// The half width that predicts left-out samples of attitude (0) or position (1) best.
    fn best(&mut self, base: &BaseTrack, what: usize) -> Option<f64> {
        let error = |of: &dyn Fn(usize) -> Option<f64>| {
            let all: Vec<f64> = (4..base.t_s.len().saturating_sub(4))
                .filter_map(of)
                .collect();
            (!all.is_empty()).then(|| math::mean(&all))
        };
        let plain = error(&|i| tracked_error(base, what, i))?;
        let mut best = None;
        let mut least = plain;
        for half in HALVES_S {
            let of = |i: usize| self.left_out(base, what, half, i);
            if let Some(e) = error(&of).filter(|e| *e < least) {
                (best, least) = (Some(half), e);
            }
        }
        best
    }

    /// Squared error of sample `i` predicted from those around it.
    fn left_out(&self, base: &BaseTrack, what: usize, half_s: f64, i: usize) -> Option<f64> {
        let t = base.t_s[i];
        let line = if what == 0 {
            self.turns(base, t, half_s, Some(i))
        } else {
            self.ways(base, t, half_s, Some(i))
        }?;
        let own = if what == 0 {
            let (reference, _) = self.reference(base, t)?;
            turn::between(reference, self.drift(base, i)?)
        } else {
            self.offset(base, i)?
        };
        Some((0..3).map(|k| (own[k] - line[k].0).powi(2)).sum())
    }

    /// Row before `t_s` and the share of the way to the next.
    fn row(&self, t_s: f64) -> (usize, f64) {
        let last = self.t_s.len() - 2;
        let i = self
            .t_s
            .partition_point(|t| *t <= t_s)
            .saturating_sub(1)
            .min(last);
        let share = (t_s - self.t_s[i]) / (self.t_s[i + 1] - self.t_s[i]);
        (i, share.clamp(0.0, 1.0))
    }

    fn rate(&self, t_s: f64) -> [f64; 3] {
        let (i, s) = self.row(t_s);
        std::array::from_fn(|k| self.gyro[i][k] + s * (self.gyro[i + 1][k] - self.gyro[i][k]))
    }

    fn turned(&self, t_s: f64) -> [f64; 4] {
        let (i, s) = self.row(t_s);
        let d = turn::body_between(self.attitude[i], self.attitude[i + 1]);
        turn::times(self.attitude[i], turn::exp(d.map(|x| x * s)))
    }

    fn moved(&self, t_s: f64) -> ([f64; 3], [f64; 3]) {
        let (i, s) = self.row(t_s);
        let dt = (self.t_s[i + 1] - self.t_s[i]) * s;
        let v: [f64; 3] = std::array::from_fn(|k| {
            self.velocity[i][k] + s * (self.velocity[i + 1][k] - self.velocity[i][k])
        });
        let p =
            std::array::from_fn(|k| self.position[i][k] + 0.5 * (self.velocity[i][k] + v[k]) * dt);
        (p, v)
    }

    /// Tracked attitude over reckoned one at sample `i`.
    fn drift(&self, base: &BaseTrack, i: usize) -> Option<[f64; 4]> {
        let q = [0, 1, 2, 3].map(|k: usize| base.quaternion[k].v[i]);
        let t = *base.t_s.get(i)?;
        Some(turn::times(q, turn::conjugate(self.turned(t))))
    }

    fn offset(&self, base: &BaseTrack, i: usize) -> Option<[f64; 3]> {
        let (p, _) = self.moved(*base.t_s.get(i)?);
        Some([0, 1, 2].map(|k: usize| base.position_m[k].v[i] - p[k]))
    }

    /// Drift at the sample nearest to `t_s`, and its index.
    fn reference(&self, base: &BaseTrack, t_s: f64) -> Option<([f64; 4], usize)> {
        let at = base
            .t_s
            .partition_point(|t| *t < t_s)
            .min(base.t_s.len() - 1);
        Some((self.drift(base, at)?, at))
    }

    fn turns(
        &self,
        base: &BaseTrack,
        t_s: f64,
        half_s: f64,
        without: Option<usize>,
    ) -> Option<[(f64, f64); 3]> {
        let (reference, _) = self.reference(base, t_s)?;
        line(base, t_s, half_s, without, &|i| {
            Some(turn::between(reference, self.drift(base, i)?))
        })
    }

    fn ways(
        &self,
        base: &BaseTrack,
        t_s: f64,
        half_s: f64,
        without: Option<usize>,
    ) -> Option<[(f64, f64); 3]> {
        line(base, t_s, half_s, without, &|i| self.offset(base, i))
    }

    fn attitude(&self, base: &BaseTrack, t_s: f64) -> Option<[f64; 4]> {
        let (reference, _) = self.reference(base, t_s)?;
        let d = self.turns(base, t_s, self.half_s[0], None)?.map(|x| x.0);
        Some(turn::times(
            turn::times(turn::exp(d), reference),
            self.turned(t_s),
        ))
    }

    /// Where the base is and how it moves.
    #[must_use]
    pub fn at(&self, base: &BaseTrack, t_s: f64) -> Option<Motion> {
        let attitude = self.attitude(base, t_s)?;
        let (position_m, velocity_m_s) = if self.half_s[1] > 0.0 {
            let (p, v) = self.moved(t_s);
            let line = self.ways(base, t_s, self.half_s[1], None)?;
            (
                std::array::from_fn(|k| p[k] + line[k].0),
                std::array::from_fn(|k| v[k] + line[k].1),
            )
        } else {
            let mut both = [(0.0, 0.0); 3];
            for (slot, track) in both.iter_mut().zip(&base.position_m) {
                *slot = track.curve(t_s, HALF_S)?;
            }
            (both.map(|x| x.0), both.map(|x| x.1))
        };
        Some(Motion {
            attitude,
            angular_rad_s: turn::apply(attitude, self.rate(t_s)),
            position_m,
            velocity_m_s,
        })
    }
}

/// Half width of the parabola that the sensor has to beat, s.
const HALF_S: f64 = 0.17;

/// Squared error of a tracked sample against the parabola through those around it.
fn tracked_error(base: &BaseTrack, what: usize, i: usize) -> Option<f64> {
    let t = base.t_s[i];
    let tracks = if what == 0 {
        &base.quaternion[..]
    } else {
        &base.position_m[..]
    };
    // Half the angle's error stands in a quaternion.
    let scale = if what == 0 { 4.0 } else { 1.0 };
    let mut sum = 0.0;
    for track in tracks {
        let mut a = [0.0; 9];
        let mut b = [0.0; 3];
        for j in i.saturating_sub(8)..(i + 9).min(track.t_s.len()) {
            let d = (track.t_s[j] - t) / HALF_S;
            if j == i || d.abs() > 1.0 {
                continue;
            }
            let row = [1.0, d, d * d];
            for r in 0..3 {
                b[r] += row[r] * track.v[j];
                for c in 0..3 {
                    a[3 * r + c] += row[r] * row[c];
                }
            }
        }
        sum += scale * (least::solve(&a, &b)[0] - track.v[i]).powi(2);
    }
    Some(sum)
}

/// Value and slope at `t_s` of straight lines through what `of` gives for the tracked samples within `half_s`.
fn line(
    base: &BaseTrack,
    t_s: f64,
    half_s: f64,
    without: Option<usize>,
    of: &dyn Fn(usize) -> Option<[f64; 3]>,
) -> Option<[(f64, f64); 3]> {
    let from = base.t_s.partition_point(|t| *t < t_s - half_s);
    let to = base.t_s.partition_point(|t| *t <= t_s + half_s);
    let (mut n, mut st, mut stt) = (0.0, 0.0, 0.0);
    let (mut sv, mut stv) = ([0.0; 3], [0.0; 3]);
    for i in (from..to).filter(|i| Some(*i) != without) {
        let (d, v) = (base.t_s[i] - t_s, of(i)?);
        n += 1.0;
        st += d;
        stt += d * d;
        for k in 0..3 {
            sv[k] += v[k];
            stv[k] += d * v[k];
        }
    }
    let det = n * stt - st * st;
    if n < 3.0 || det <= 1e-12 {
        return None;
    }
    Some([0, 1, 2].map(|k: usize| {
        (
            (sv[k] * stt - st * stv[k]) / det,
            (n * stv[k] - st * sv[k]) / det,
        )
    }))
}
