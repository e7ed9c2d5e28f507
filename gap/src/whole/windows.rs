//! Short windows restarted from the measured state, joints led along the measured angles: body and ground alone are on trial.

use std::sync::Arc;

use physics::{Drive, JointParams, Level, Options, Outcome, Params, Pose, Start, Trial, Twist};
use rayon::prelude::*;

use super::data::{BaseTrack, Data, JOINTS, Run};
use super::inertial::Motion;
use super::turn;

/// Time between samples of the led angles, s.
pub(super) const PERIOD_S: f64 = 0.02;
/// Rate of recorded poses and torques, Hz: one per sample of the angles.
const RATE_HZ: f64 = 1.0 / PERIOD_S;

/// What comes before a window bends springs and takes up play: so many pieces of so many seconds each, at the beginning
/// of which the base is put where it was measured. Of ten choices compared by the cost at the true size on two development
/// robots (emulator, seed 7, 16 and 30): the longer, the better, and 0.7 s is what plays take time for.
const PIECES: usize = 12;
const PIECE_S: f64 = 3.0 * PERIOD_S;

/// How link angles follow from the recorded ones, per joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LinkMap {
    /// Recorded less true angle, rad.
    pub(super) offset_rad: f64,
    /// Recorded over true angle.
    pub(super) ratio: f64,
}

impl Default for LinkMap {
    fn default() -> Self {
        Self {
            offset_rad: 0.0,
            ratio: 1.0,
        }
    }
}

/// A window.
#[derive(Debug, Clone)]
pub(super) struct Window {
    pub(super) run: usize,
    pub(super) gait: usize,
    /// Start in the run's time, s.
    pub(super) from_s: f64,
    start: Option<(Pose, Twist)>,
    /// What the robot did before, in pieces: it bends what hangs at the start.
    before: Vec<Window>,
    /// `angles[sample * 6 + joint]`.
    angles: Vec<f64>,
    duration_s: f64,
}

/// Measured state of the base at `t_s`: with the inertial sensor where it helps, else parabolas through the samples around.
pub(super) fn base_state(base: &BaseTrack, t_s: f64) -> Option<(Pose, Twist)> {
    let m = match &base.reckoned {
        Some(r) => r.at(base, t_s)?,
        None => tracked(base, t_s)?,
    };
    let pose = Pose {
        position_m: m.position_m.map(|x| x as f32),
        quaternion: m.attitude.map(|x| x as f32),
    };
    let twist = Twist {
        linear_m_s: m.velocity_m_s.map(|x| x as f32),
        angular_rad_s: m.angular_rad_s.map(|x| x as f32),
    };
    Some((pose, twist))
}

fn tracked(base: &BaseTrack, t_s: f64) -> Option<Motion> {
    // Seven samples, so that noise does not become speed; at least 60 ms.
    let half_s = (3.2 * base.position_m[0].period_s()).clamp(0.06, 0.2);
    let mut p = [(0.0, 0.0); 3];
    for (slot, track) in p.iter_mut().zip(&base.position_m) {
        *slot = track.curve(t_s, half_s)?;
    }
    let mut q = [(0.0, 0.0); 4];
    for (slot, track) in q.iter_mut().zip(&base.quaternion) {
        *slot = track.curve(t_s, half_s)?;
    }
    let norm = q.iter().map(|x| x.0 * x.0).sum::<f64>().sqrt().max(1e-9);
    let attitude = q.map(|c| c.0 / norm);
    // omega = 2 dq q*, world axes.
    let [_, x, y, z] = turn::times(q.map(|c| 2.0 * c.1 / norm), turn::conjugate(attitude));
    Some(Motion {
        attitude,
        angular_rad_s: [x, y, z],
        position_m: p.map(|c| c.0),
        velocity_m_s: p.map(|c| c.1),
    })
}

/// Joint angles of a run from `from_s` on, the link side where measured; `None` where a joint was not measured.
pub(super) fn angles(run: &Run, from_s: f64, samples: usize) -> Option<Vec<f64>> {
    let mut out = vec![0.0; samples * JOINTS];
    for (k, j) in run.joints.iter().enumerate() {
        let track = j.link.as_ref().or(j.position.as_ref())?;
        let step = (run.length_s / track.t_s.len() as f64).max(0.005);
        for i in 0..samples {
            let t = from_s + i as f64 * PERIOD_S;
            let line = track.line(t, (2.1 * step).min(0.05));
            out[i * JOINTS + k] = line.map_or_else(|| track.at(t), |l| l.0);
        }
    }
    Some(out)
}

/// One window of a run; `None` where a joint or the base was not measured.
fn one(run: usize, of: &Run, from_s: f64, duration_s: f64) -> Option<Window> {
    let samples = (duration_s / PERIOD_S).round() as usize + 1;
    let start = of.base.as_ref().and_then(|b| base_state(b, from_s));
    let angles = angles(of, from_s, samples)?;
    (start.is_some() || of.base.is_none()).then(|| Window {
        run,
        gait: of.gait,
        from_s,
        start,
        before: Vec::new(),
        angles,
        duration_s,
    })
}

/// Windows of `duration_s` every `every_s` over all runs that allow it. Without a base pose one window spans each run, from home.
pub(super) fn cut(data: &Data, duration_s: f64, every_s: f64) -> Vec<Window> {
    cut_from(data, duration_s, every_s, 0.0)
}

/// The same, the first windows being `offset_s` late; a run without a pose of the base is one window.
pub(super) fn cut_from(data: &Data, duration_s: f64, every_s: f64, offset_s: f64) -> Vec<Window> {
    let mut out = Vec::new();
    for (r, run) in data.runs.iter().enumerate() {
        let (duration_s, first_s, end) = match &run.base {
            Some(b) => (
                duration_s,
                b.t_s[0].max(0.0) + 0.05,
                b.t_s[b.t_s.len() - 1].min(run.length_s),
            ),
            None => (run.length_s, 0.0, run.length_s),
        };
        let mut from_s = first_s + if run.base.is_some() { offset_s } else { 0.0 };
        while from_s + duration_s <= end + 1e-9 {
            if let Some(mut window) = one(r, run, from_s, duration_s) {
                if run.base.is_some() {
                    let piece = |i: usize| {
                        let earlier_s = from_s - (PIECES - i) as f64 * PIECE_S;
                        one(r, run, earlier_s.max(first_s), PIECE_S)
                    };
                    window.before = (0..PIECES).filter_map(piece).collect();
                }
                out.push(window);
            }
            from_s += every_s.min(duration_s);
        }
    }
    out
}

impl Window {
    /// Link angles after the maps.
    fn mapped(&self, maps: &[LinkMap; JOINTS], order: &[usize; JOINTS]) -> Vec<f32> {
        let one = |(i, _): (usize, &f64)| {
            let from = i - i % JOINTS + order[i % JOINTS];
            let m = &maps[i % JOINTS];
            ((self.angles[from] - m.offset_rad) / m.ratio) as f32
        };
        self.angles.iter().enumerate().map(one).collect()
    }

    /// The window as a trial.
    pub(super) fn trial(
        &self,
        params: &Arc<Params>,
        maps: &[LinkMap; JOINTS],
        order: &[usize; JOINTS],
    ) -> Trial {
        let values = self.mapped(maps, order);
        let start = match self.start {
            None => Start::Home,
            Some((base, twist)) => Start::State {
                base,
                twist,
                angles_rad: values[..JOINTS].to_vec(),
                speeds_rad_s: (0..JOINTS)
                    .map(|k| (values[JOINTS + k] - values[k]) / PERIOD_S as f32)
                    .collect(),
            },
        };
        Trial {
            params: Arc::clone(params),
            start,
            drive: if params.joints[..JOINTS].iter().any(JointParams::hangs) {
                Drive::EncoderAngles {
                    period_s: PERIOD_S,
                    values_rad: Arc::from(values),
                }
            } else {
                Drive::LinkAngles {
                    period_s: PERIOD_S,
                    values_rad: Arc::from(values),
                }
            },
            duration_s: self.duration_s,
        }
    }
}

/// The windows as trials. What gives or has play starts where the motion before has brought it to: a spring that starts
/// straight would let the robot sink at once.
pub(super) fn trials<'a>(
    windows: impl Iterator<Item = &'a Window> + Clone,
    params: &Arc<Params>,
    maps: &[LinkMap; JOINTS],
    order: &[usize; JOINTS],
) -> Vec<Trial> {
    let all = windows.clone().map(|w| w.trial(params, maps, order));
    let mut out: Vec<Trial> = all.collect();
    if !params.joints.iter().any(JointParams::hangs) {
        return out;
    }
    let mut bent: Vec<Option<Bent>> = out.iter().map(|_| None).collect();
    for piece in 0..PIECES {
        let (at, mut before): (Vec<usize>, Vec<Trial>) = windows
            .clone()
            .enumerate()
            .filter_map(|(i, w)| Some((i, w.before.get(piece)?.trial(params, maps, order))))
            .unzip();
        for (i, trial) in at.iter().zip(&mut before) {
            bend(trial, bent[*i].as_ref());
        }
        let ends = run(&before, &options(false));
        for ((i, trial), end) in at.into_iter().zip(&before).zip(&ends) {
            bent[i] = Bent::at_the_end(trial, end);
        }
    }
    for (trial, bent) in out.iter_mut().zip(&bent) {
        bend(trial, bent.as_ref());
    }
    out
}

/// What hangs, by joint, connectors last: how far it stands off the angle that leads it, rad, and its speed, rad/s.
/// Nothing for a joint that is rigid.
struct Bent(Vec<Option<[f32; 2]>>);

impl Bent {
    /// At the end of a trial; `None` where that broke down.
    fn at_the_end(trial: &Trial, end: &Outcome) -> Option<Self> {
        let led: &[f32] = match &trial.drive {
            Drive::EncoderAngles { values_rad, .. } => &values_rad[values_rad.len() - JOINTS..],
            _ => &[],
        };
        let one = |(k, (angle, speed)): (usize, (&f32, &f32))| {
            let led = led.get(k).copied().unwrap_or(0.0);
            let hangs = trial.params.joints[k].hangs();
            hangs.then_some([angle - led, *speed])
        };
        let joints = end.end_angles_rad.iter().zip(&end.end_speeds_rad_s);
        let all = Self(joints.enumerate().map(one).collect());
        end.not_finite.is_none().then_some(all)
    }
}

/// Bends what hangs at the start of a trial.
fn bend(trial: &mut Trial, bent: Option<&Bent>) {
    let (
        Some(Bent(all)),
        Start::State {
            angles_rad,
            speeds_rad_s,
            ..
        },
    ) = (bent, &mut trial.start)
    else {
        return;
    };
    angles_rad.resize(all.len(), 0.0);
    speeds_rad_s.resize(all.len(), 0.0);
    for (k, bent) in all.iter().enumerate() {
        if let Some([off, speed]) = bent {
            angles_rad[k] += off;
            speeds_rad_s[k] = *speed;
        }
    }
}

/// Errors of a start, `by` standard deviations. With the inertial sensor: residues of its lines through the tracked samples; angular
/// velocity as noisy as the gyro of a phone. Without: a robot that shakes turns otherwise than a parabola through 0.3 s.
pub(super) fn disturb(trial: &mut Trial, which: usize, by: f32, inertial: bool) {
    let (m, rad) = (
        4e-4 * by,
        f64::from(by) * if inertial { 2e-3 } else { 4e-3 },
    );
    let (m_s, rad_s) = if inertial { (6e-3, 0.02) } else { (1e-2, 0.1) };
    let (m_s, rad_s) = (m_s * by, rad_s * by);
    if let Start::State { base, twist, .. } = &mut trial.start {
        let k = which % 3;
        match which / 3 {
            0 => base.position_m[k] += m,
            1 => {
                let mut step = [0.0; 3];
                step[k] = rad;
                let q = base.quaternion.map(f64::from);
                base.quaternion = turn::times(turn::exp(step), q).map(|x| x as f32);
            }
            2 => twist.linear_m_s[k] += m_s,
            _ => twist.angular_rad_s[k] += rad_s,
        }
    }
}

/// Numerical settings of the windows.
pub(super) fn options(motors: bool) -> Options {
    Options {
        sample_rate_hz: RATE_HZ,
        record_motors: motors,
        ..Options::default()
    }
}

/// Runs trials on all threads.
pub(super) fn run(trials: &[Trial], options: &Options) -> Vec<Outcome> {
    let lanes = Level::detect().lanes();
    let parts: Vec<Vec<Outcome>> = trials
        .par_chunks(lanes)
        .map(|part| physics::run(part, options).unwrap_or_default())
        .collect();
    parts.into_iter().flatten().collect()
}

/// Torque that the body needs on each joint along the measured motion, `[run][joint]` on a grid of `step_s`, smoothed.
pub(super) fn replay(
    data: &Data,
    windows: &[Window],
    params: &Arc<Params>,
    maps: &[LinkMap; JOINTS],
    step_s: f64,
) -> Vec<[Vec<f64>; JOINTS]> {
    let order = std::array::from_fn(|k| k);
    let trials = trials(windows.iter(), params, maps, &order);
    let outcomes = run(&trials, &options(true));
    let mut sums: Vec<[Vec<(f64, f64)>; JOINTS]> = data
        .runs
        .iter()
        .map(|r| std::array::from_fn(|_| vec![(0.0, 0.0); (r.length_s / PERIOD_S) as usize + 2]))
        .collect();
    for (w, o) in windows.iter().zip(&outcomes) {
        let n = o.torques_nm.len() / JOINTS;
        // The first samples hold the blow of a state that fits the ground only to within the tracker's noise.
        let skip = if w.start.is_some() { 4 } else { 0 };
        for (k, sums) in sums[w.run].iter_mut().enumerate() {
            // Readings of a joint with another sign show its torque with another sign too.
            let sign = maps[k].ratio.signum();
            let torque: Vec<f64> = (0..n)
                .map(|i| sign * f64::from(o.torques_nm[i * JOINTS + k]))
                .collect();
            let smooth = smoothed(&torque, skip);
            for (i, t) in smooth.iter().enumerate() {
                let at = ((w.from_s / PERIOD_S).round() as usize) + i;
                if i >= skip
                    && t.is_finite()
                    && let Some(s) = sums.get_mut(at)
                {
                    s.0 += t;
                    s.1 += 1.0;
                }
            }
        }
    }
    let spread = |series: &Vec<(f64, f64)>, length_s: f64| {
        let filled = fill(series);
        let steps = (length_s / step_s) as usize + 3;
        (0..steps)
            .map(|i| {
                let place = i as f64 * step_s / PERIOD_S;
                let a = (place as usize).min(filled.len() - 1);
                let b = (a + 1).min(filled.len() - 1);
                filled[a] + (filled[b] - filled[a]) * (place - a as f64).min(1.0)
            })
            .collect::<Vec<f64>>()
    };
    data.runs
        .iter()
        .zip(&sums)
        .map(|(r, s)| std::array::from_fn(|k| spread(&s[k], r.length_s)))
        .collect()
}

/// Moving average over five samples (100 ms), from `skip` on.
fn smoothed(v: &[f64], skip: usize) -> Vec<f64> {
    (0..v.len())
        .map(|i| {
            let from = i.max(skip).saturating_sub(2).max(skip.min(v.len() - 1));
            let to = (i.max(skip) + 3).min(v.len()).max(from + 1);
            v[from..to].iter().sum::<f64>() / (to - from) as f64
        })
        .collect()
}

/// Means of a series of sums and counts; gaps take the last value before them.
fn fill(series: &[(f64, f64)]) -> Vec<f64> {
    let first = series.iter().find(|s| s.1 > 0.0).map_or(0.0, |s| s.0 / s.1);
    let mut last = first;
    series
        .iter()
        .map(|s| {
            if s.1 > 0.0 {
                last = s.0 / s.1;
            }
            last
        })
        .collect()
}
