//! A whole-robot data set as tracks: what was measured, of what, when.

use files::dataset::{Manifest, Recording, Role, Signal, repeat_groups};
use files::model::Model;

use super::inertial::{Inertial, Reckoned};
use super::nominal::Motors;

/// Joints of the meta-module.
pub const JOINTS: usize = files::model::MOTORS.len();

/// Samples of one signal in order of time; only finite ones.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Track {
    /// Times from the start of the run, s.
    pub t_s: Vec<f64>,
    /// Values.
    pub v: Vec<f64>,
}

impl Track {
    /// Finite samples of a column whose row satisfies `keep`; `None` when there are fewer than two.
    fn new(t_s: &[f64], column: Option<&[f64]>, keep: &dyn Fn(usize) -> bool) -> Option<Self> {
        let column = column?;
        let mut out = Self::default();
        for (i, (t, v)) in t_s.iter().zip(column).enumerate() {
            if v.is_finite() && keep(i) {
                out.t_s.push(t - t_s[0]);
                out.v.push(*v);
            }
        }
        (out.v.len() >= 2).then_some(out)
    }

    /// Index of the last sample at or before `t_s`.
    fn before(&self, t_s: f64) -> Option<usize> {
        self.t_s.partition_point(|t| *t <= t_s).checked_sub(1)
    }

    /// Value held at `t_s`; the first one before the first sample.
    #[must_use]
    pub fn held(&self, t_s: f64) -> f64 {
        let i = self.before(t_s).unwrap_or(0);
        self.v.get(i).copied().unwrap_or(0.0)
    }

    /// Linear interpolation, constant outside.
    #[must_use]
    pub fn at(&self, t_s: f64) -> f64 {
        let Some(i) = self.before(t_s) else {
            return self.v.first().copied().unwrap_or(0.0);
        };
        let (Some(t1), Some(v1)) = (self.t_s.get(i + 1), self.v.get(i + 1)) else {
            return self.v[i];
        };
        let share = (t_s - self.t_s[i]) / (t1 - self.t_s[i]).max(1e-9);
        self.v[i] + (v1 - self.v[i]) * share
    }

    /// Value and slope of a straight line through the samples within `half_s` of `t_s`.
    #[must_use]
    pub fn line(&self, t_s: f64, half_s: f64) -> Option<(f64, f64)> {
        let from = self.t_s.partition_point(|t| *t < t_s - half_s);
        let to = self.t_s.partition_point(|t| *t <= t_s + half_s);
        if to < from + 2 {
            return None;
        }
        let n = (to - from) as f64;
        let (mut st, mut sv, mut stt, mut stv) = (0.0, 0.0, 0.0, 0.0);
        for (t, v) in self.t_s[from..to].iter().zip(&self.v[from..to]) {
            let d = t - t_s;
            st += d;
            sv += v;
            stt += d * d;
            stv += d * v;
        }
        let det = n * stt - st * st;
        if det <= 1e-12 {
            return None;
        }
        Some(((sv * stt - st * stv) / det, (n * stv - st * sv) / det))
    }

    /// Value and slope of a parabola through the samples within `half_s` of `t_s`; a line where there are too few.
    #[must_use]
    pub fn curve(&self, t_s: f64, half_s: f64) -> Option<(f64, f64)> {
        let from = self.t_s.partition_point(|t| *t < t_s - half_s);
        let to = self.t_s.partition_point(|t| *t <= t_s + half_s);
        if to < from + 4 {
            return self.line(t_s, half_s);
        }
        let mut a = [0.0; 9];
        let mut b = [0.0; 3];
        for (t, v) in self.t_s[from..to].iter().zip(&self.v[from..to]) {
            // In units of the half width, so that the sums are of one size.
            let d = (t - t_s) / half_s;
            let row = [1.0, d, d * d];
            for i in 0..3 {
                b[i] += row[i] * v;
                for j in 0..3 {
                    a[3 * i + j] += row[i] * row[j];
                }
            }
        }
        let x = super::least::solve(&a, &b);
        Some((x[0], x[1] / half_s))
    }

    /// Median time between samples, s.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        let d: Vec<f64> = self.t_s.windows(2).map(|w| w[1] - w[0]).collect();
        crate::math::median(&d)
    }

    /// Time from the first sample to the last, s.
    #[must_use]
    pub fn span_s(&self) -> f64 {
        let ends = self.t_s.first().zip(self.t_s.last());
        ends.map_or(0.0, |(from, to)| to - from)
    }
}

/// What one joint showed in one run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointTracks {
    /// Set-points as sent.
    pub command: Option<Track>,
    /// Set-points as applied.
    pub applied: Option<Track>,
    /// Motor-side angle.
    pub position: Option<Track>,
    /// Link-side angle.
    pub link: Option<Track>,
    /// Signed effort, N m.
    pub effort: Option<Track>,
    /// Signed current, A.
    pub current: Option<Track>,
    /// Speed as the driver reports it.
    pub velocity: Option<Track>,
    /// Duty.
    pub duty: Option<Track>,
}

/// Pose of body 3 over time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BaseTrack {
    /// The inertial sensor laid onto the pose, where there is one and it helps.
    pub reckoned: Option<Reckoned>,
    /// One standard deviation of place, m, and attitude about the world's axes, rad, where the pose was read off a film.
    pub filmed: Option<[f64; 6]>,
    /// Times, s.
    pub t_s: Vec<f64>,
    /// x, y, z.
    pub position_m: [Track; 3],
    /// w, x, y, z, without sign jumps.
    pub quaternion: [Track; 4],
}

/// One run.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// CSV file.
    pub name: String,
    /// Gait by number.
    pub gait: usize,
    /// Group of runs that repeat each other.
    pub repeat: usize,
    /// Use.
    pub role: Option<Role>,
    /// Joints.
    pub joints: [JointTracks; JOINTS],
    /// Base pose.
    pub base: Option<BaseTrack>,
    /// Bus voltage.
    pub bus_v: Option<Track>,
    /// Instants of blows on the inertial sensor, s; `None` without one.
    pub blows_s: Option<Vec<f64>>,
    /// Device time of the first row, s.
    pub t0_s: f64,
    /// Length, s.
    pub length_s: f64,
    /// Index in the manifest.
    pub index: usize,
}

/// All runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Data {
    /// Runs in file order.
    pub runs: Vec<Run>,
    /// Names of the gaits.
    pub gaits: Vec<String>,
    /// Nominal motors and supply.
    pub motors: Motors,
}

fn joint_tracks(r: &Recording, k: usize) -> JointTracks {
    let Some(columns) = r.joint(k) else {
        return JointTracks::default();
    };
    let mut on = Vec::with_capacity(r.len());
    let mut enabled = true;
    for i in 0..r.len() {
        if let Some(e) = columns.get(Signal::Enable).map(|e| e[i])
            && e.is_finite()
        {
            enabled = e > 0.5;
        }
        on.push(enabled);
    }
    let track = |s: Signal| Track::new(r.t_s(), columns.get(s), &|i| on[i]);
    JointTracks {
        command: track(Signal::Setpoint),
        applied: track(Signal::AppliedSetpoint),
        position: track(Signal::Position),
        link: track(Signal::LinkPosition),
        effort: track(Signal::Effort),
        current: track(Signal::Current),
        velocity: track(Signal::Velocity),
        duty: track(Signal::Duty),
    }
}

impl BaseTrack {
    /// Adds a sample; the quaternion's length and sign do not matter.
    pub fn push(&mut self, t_s: f64, position_m: [f64; 3], quaternion: [f64; 4]) {
        let last = |track: &Track| track.v.last().copied();
        let before: [Option<f64>; 4] = std::array::from_fn(|k| last(&self.quaternion[k]));
        let dot: f64 = before
            .iter()
            .zip(quaternion)
            .map(|(a, b)| a.unwrap_or(0.0) * b)
            .sum();
        let norm = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
        let scale = if dot < 0.0 { -1.0 } else { 1.0 } / norm.max(1e-9);
        self.t_s.push(t_s);
        for (track, x) in self.position_m.iter_mut().zip(position_m) {
            track.t_s.push(t_s);
            track.v.push(x);
        }
        for (track, x) in self.quaternion.iter_mut().zip(quaternion) {
            track.t_s.push(t_s);
            track.v.push(scale * x);
        }
    }
}

fn base(r: &Recording) -> Option<BaseTrack> {
    let b = r.body();
    let columns: Vec<&[f64]> = b
        .base_m
        .iter()
        .chain(&b.base_q)
        .map(|c| c.as_deref())
        .collect::<Option<_>>()?;
    let mut out = BaseTrack::default();
    for (i, t) in r.t_s().iter().enumerate() {
        if columns.iter().all(|c| c[i].is_finite()) {
            let at = |k: usize| columns[k][i];
            out.push(
                t - r.t_s()[0],
                std::array::from_fn(at),
                std::array::from_fn(|k| at(3 + k)),
            );
        }
    }
    if out.t_s.len() < 5 {
        return None;
    }
    out.reckoned = Inertial::new(r).and_then(|sensor| Reckoned::new(&sensor, &out));
    Some(out)
}

impl Data {
    /// The tracks of a data set on a robot with the motors of `model`.
    #[must_use]
    pub fn new(manifest: &Manifest, recordings: &[Recording], model: &Model) -> Self {
        let groups = repeat_groups(manifest, recordings);
        let mut gaits: Vec<String> = Vec::new();
        let mut runs = Vec::new();
        for (index, (run, r)) in manifest.runs.iter().zip(recordings).enumerate() {
            let gait = gaits
                .iter()
                .position(|g| *g == run.gait)
                .unwrap_or_else(|| {
                    gaits.push(run.gait.clone());
                    gaits.len() - 1
                });
            let t = r.t_s();
            runs.push(Run {
                name: run.file.clone(),
                gait,
                repeat: groups[index],
                role: run.role,
                joints: std::array::from_fn(|k| joint_tracks(r, k)),
                base: base(r),
                bus_v: Track::new(t, r.body().bus_v.as_deref(), &|_| true),
                blows_s: Inertial::new(r).map(|sensor| sensor.blows_s()),
                t0_s: t[0],
                length_s: t[t.len() - 1] - t[0],
                index,
            });
        }
        let motors = Motors::of(model);
        Self {
            runs,
            gaits,
            motors,
        }
    }

    /// The same with the tracks of joint `k` taken from column `order[k]`.
    #[must_use]
    pub fn reordered(&self, order: &[usize; JOINTS]) -> Self {
        let mut out = self.clone();
        for (to, from) in out.runs.iter_mut().zip(&self.runs) {
            to.joints = std::array::from_fn(|k| from.joints[order[k]].clone());
        }
        out
    }

    /// Whether the base was read off a film.
    pub fn filmed(&self) -> bool {
        let mut bases = self.runs.iter().filter_map(|r| r.base.as_ref());
        bases.any(|b| b.filmed.is_some())
    }

    /// Whether any run has the signal that `of` picks, for joint `k`.
    pub fn has(&self, k: usize, of: impl Fn(&JointTracks) -> bool) -> bool {
        self.runs.iter().any(|r| of(&r.joints[k]))
    }
}
