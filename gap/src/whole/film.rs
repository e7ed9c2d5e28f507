//! The base pose from the film, where no tracker recorded one.
//!
//! Between two frames the nominal simulator carries the robot on along the measured angles; at every frame its place and heading are
//! corrected until centre and axes of the outline are those of the film. How the robot lies at first is tried out, and again where it
//! tipped otherwise than simulated: the ways whose outlines fit best are followed side by side until one fits well. Between such
//! moments tilt and height stay the simulator's.

use std::sync::Arc;

use camera::{Silhouette, Solid, similarity};
use control::robot::RobotModel;
use files::dataset::Manifest;
use files::model::Model;
use physics::{Drive, Outcome, Params, Pose, Start, Trial, Twist};
use rayon::prelude::*;

use super::camera::{self as tier, Film, Seen};
use super::data::{BaseTrack, Data, JOINTS, Run};
use super::windows::{self, PERIOD_S};
use super::{predict, turn};
use crate::math;

/// Least time between two frames that are used, s: a slow walker moves by a pixel in it.
const APART_S: f64 = 0.15;
/// Ways followed side by side at most, and the frames over which they are judged.
const TRIED: usize = 4;
const JUDGED: usize = 6;
/// Overlap over union of a pose that is right: outlines of right poses overlap by 0.97 at 9 mm a pixel (emulated robots).
const GOOD: f64 = 0.93;
/// Ways of lying: turns about x (quarter turns) and about y, rad, from where the home pose leads.
const QUARTER: f64 = std::f64::consts::FRAC_PI_2;
const LIES: [[f64; 2]; 6] = [
    [0.0, 0.0],
    [QUARTER, 0.0],
    [2.0 * QUARTER, 0.0],
    [3.0 * QUARTER, 0.0],
    [0.0, QUARTER],
    [0.0, -QUARTER],
];
/// Ways in which a robot may have tipped since the last frame: horizontal turns, rad, in eight directions.
const TIPS_RAD: [f64; 3] = [0.4, 0.8, 1.4];
/// Time for a robot that was put down to come to rest, and for one that tips, s.
const REST_S: f64 = 1.0;
const TIP_S: f64 = 0.3;
/// What a start from home is given in overlap over union: a recording begins there unless it shows otherwise.
const HOME: f64 = 0.02;
/// Overlap over union below which the outline is not the robot as it was followed, and how many frames in a row end the track.
const LOST: f64 = 0.6;
const LOST_FRAMES: usize = 3;
/// Least mean overlap over union of a track that is used.
const LEAST: f64 = 0.75;
/// Error of a centre or an axis of an outline, px: a few hundred pixels of outline, each off by half a pixel at most.
const OUTLINE_PX: f64 = 0.15;
/// Heading by which the simulator may be off after a frame, rad.
const HEADING_RAD: f64 = 0.05;
/// Heading of a robot that was put down: any.
const ANY_RAD: f64 = 10.0;
/// Turns and shifts at a frame, one after the other: a turn moves the centre of the outline too (chosen).
const ROUNDS: usize = 2;
/// Error of the tilt, which the simulator alone tells, rad, and of the height, m.
const TILT_RAD: f64 = 0.03;
const HEIGHT_M: f64 = 4e-3;
/// Least error of a heading, rad.
const AXES_RAD: f64 = 8e-3;

/// What outlines are made with.
struct Stage {
    robot: RobotModel,
    solids: Vec<Solid>,
    seen: Seen,
    params: Arc<Params>,
}

/// One frame.
struct Shot<'a> {
    /// When it was taken, in the run's time, s.
    t_s: f64,
    frame: &'a Silhouette,
    moments: [f64; 5],
}

/// One way through a run.
#[derive(Clone)]
struct Way {
    pose: Pose,
    twist: Twist,
    /// Overlap over union at the frames so far.
    overlaps: Vec<f64>,
    /// Time, s, and pose.
    poses: Vec<(f64, Pose)>,
    /// Whether it begins as the home pose lies.
    home: bool,
}

impl Way {
    fn new(pose: Pose, home: bool) -> Self {
        Self {
            pose,
            twist: Twist::default(),
            overlaps: Vec::new(),
            poses: Vec::new(),
            home,
        }
    }

    /// Overlap over union lately.
    fn merit(&self) -> f64 {
        let last = &self.overlaps[self.overlaps.len().saturating_sub(JUDGED)..];
        let home = self.home && last.len() == self.overlaps.len();
        math::mean(last) + if home { HOME } else { 0.0 }
    }

    fn lost(&self) -> bool {
        let last = self.overlaps.iter().rev().take(LOST_FRAMES);
        self.overlaps.len() >= LOST_FRAMES && last.into_iter().all(|o| *o < LOST)
    }

    /// Takes the corrected pose of a frame at `to_s`; what was simulated since the last one is bent onto it.
    fn bend(&mut self, from_s: f64, to_s: f64, between: &[Pose], pose: Pose, heading_rad: f64) {
        let end = between.last().copied().unwrap_or(self.pose);
        let n = between.len().max(2) - 1;
        for (i, p) in between.iter().enumerate().take(n) {
            let part = i as f64 / n as f64;
            let mut bent = turned(*p, part * heading_rad);
            for k in 0..3 {
                let step = pose.position_m[k] - end.position_m[k];
                bent.position_m[k] += part as f32 * step;
            }
            self.poses.push((from_s + part * (to_s - from_s), bent));
        }
        let turn = turn::exp([0.0, 0.0, heading_rad]);
        let of = |v: [f32; 3]| turn::apply(turn, v.map(f64::from)).map(|x| x as f32);
        if let [.., a, b] = between {
            let step = |k: usize| f64::from(b.position_m[k] - a.position_m[k]) / PERIOD_S;
            let spin = turn::between(a.quaternion.map(f64::from), b.quaternion.map(f64::from));
            self.twist = Twist {
                linear_m_s: of(std::array::from_fn(|k| step(k) as f32)),
                angular_rad_s: of(spin.map(|x| (x / PERIOD_S) as f32)),
            };
        }
        self.pose = pose;
    }

    fn track(mut self, last_s: f64, error: [f64; 6]) -> BaseTrack {
        self.poses.push((last_s, self.pose));
        let mut out = BaseTrack {
            filmed: Some(error),
            ..BaseTrack::default()
        };
        for (t, p) in &self.poses {
            out.push(*t, p.position_m.map(f64::from), p.quaternion.map(f64::from));
        }
        out
    }
}

/// `pose` turned about the vertical through its own place.
fn turned(pose: Pose, heading_rad: f64) -> Pose {
    let turn = turn::exp([0.0, 0.0, heading_rad]);
    Pose {
        quaternion: turn::times(turn, pose.quaternion.map(f64::from)).map(|x| x as f32),
        ..pose
    }
}

/// Fills in the base pose of runs that have a film and all six angles, but no tracker.
pub(super) fn track(
    data: &mut Data,
    films: &[Film],
    manifest: &Manifest,
    model: &Model,
    params: &Arc<Params>,
) {
    let wanted: Vec<(usize, &Film)> = films
        .iter()
        .filter_map(|f| Some((data.runs.iter().position(|r| r.index == f.run)?, f)))
        .filter(|(r, _)| data.runs[*r].base.is_none())
        .collect();
    let found: Vec<(usize, Option<BaseTrack>)> = wanted
        .into_par_iter()
        .map(|(r, film)| {
            let track = Stage::new(film, manifest, model, params)
                .and_then(|stage| stage.track(&data.runs[r], film));
            (r, track)
        })
        .collect();
    for (r, track) in found {
        data.runs[r].base = track;
    }
}

impl Stage {
    fn new(film: &Film, manifest: &Manifest, model: &Model, params: &Arc<Params>) -> Option<Self> {
        let robot = tier::robot(model)?;
        Some(Self {
            solids: Solid::meta_module(&robot),
            robot,
            seen: Seen::new(manifest, model, &film.frames.first()?.1)?,
            params: Arc::clone(params),
        })
    }

    fn track(&self, run: &Run, film: &Film) -> Option<BaseTrack> {
        let shots = self.shots(run, film);
        let first = shots.first()?;
        let mut ways = self.lies(run, first)?;
        for pair in shots.windows(2) {
            self.carry(run, &mut ways, pair[0].t_s, &pair[1])?;
            self.tip(run, &mut ways, &pair[1])?;
            ways.sort_by(|a, b| b.merit().total_cmp(&a.merit()));
            let sure = ways
                .first()
                .is_some_and(|w| w.overlaps.len() >= JUDGED && w.merit() > GOOD);
            ways.truncate(if sure { 1 } else { TRIED });
            if ways.iter().all(Way::lost) {
                return None;
            }
        }
        let last_s = shots.last()?.t_s;
        let way = ways.into_iter().next()?;
        let px_m = self.seen.height_m / self.seen.focal_px;
        let place_m = OUTLINE_PX * px_m;
        let error = [place_m, place_m, HEIGHT_M, TILT_RAD, TILT_RAD, AXES_RAD];
        (math::mean(&way.overlaps) > LEAST).then(|| way.track(last_s, error))
    }

    /// Frames that show the whole robot, far enough apart.
    fn shots<'a>(&self, run: &Run, film: &'a Film) -> Vec<Shot<'a>> {
        let mut out: Vec<Shot<'_>> = Vec::new();
        for (t, frame) in &film.frames {
            let t_s = t - run.t0_s + self.seen.shift_s;
            let late = out.last().is_none_or(|l| t_s - l.t_s >= APART_S);
            if late
                && (0.0..=run.length_s).contains(&t_s)
                && let Some(moments) = tier::moments(frame).filter(|_| !tier::cut(frame))
            {
                out.push(Shot {
                    t_s,
                    frame,
                    moments,
                });
            }
        }
        out
    }

    fn render(&self, run: &Run, t_s: f64, pose: &Pose) -> Option<Silhouette> {
        let bodies = tier::bodies(&self.robot, run, t_s, pose)?;
        Some(self.seen.view.render(&self.solids, &bodies))
    }

    /// Turns and shifts `pose` until the outline lies on that of the shot, the heading by no more than its error over `trust_rad`
    /// suggests: pose, turn, rad, and overlap over union.
    fn correct(
        &self,
        run: &Run,
        shot: &Shot<'_>,
        mut pose: Pose,
        trust_rad: f64,
    ) -> Option<(Pose, f64, f64)> {
        let axis = |m: &[f64; 5]| 0.5 * libm::atan2(m[4], m[3]);
        let long_px = libm::hypot(shot.moments[3], shot.moments[4]).max(1e-3);
        let error_rad = (0.5 * OUTLINE_PX / long_px).max(AXES_RAD);
        let gain = trust_rad * trust_rad / (trust_rad * trust_rad + error_rad * error_rad);
        let mut heading_rad = 0.0;
        for _ in 0..ROUNDS {
            let m = tier::moments(&self.render(run, shot.t_s, &pose)?)?;
            let mut off = axis(&m) - axis(&shot.moments);
            off -= std::f64::consts::PI * (off / std::f64::consts::PI).round();
            pose = turned(pose, gain * off);
            heading_rad += gain * off;
            let m = tier::moments(&self.render(run, shot.t_s, &pose)?)?;
            let [x, y] = self.seen.way_m(
                [shot.moments[0] - m[0], shot.moments[1] - m[1]],
                f64::from(pose.position_m[2]),
            );
            pose.position_m[0] += x as f32;
            pose.position_m[1] += y as f32;
        }
        let outline = self.render(run, shot.t_s, &pose)?;
        let overlap = similarity::ratio(shot.frame, &outline).ok().flatten()?;
        Some((pose, heading_rad, overlap))
    }

    /// Overlap over union of a frame with a simulated run.
    fn overlap(&self, shot: &Shot<'_>, o: &Outcome) -> Option<f64> {
        let i = (shot.t_s * predict::RATE_HZ).round() as usize;
        let (pose, angles) = (
            o.poses.get(i)?,
            o.angles_rad.get(i * JOINTS..(i + 1) * JOINTS)?,
        );
        let bodies = tier::placed(&self.robot, angles.try_into().ok()?, pose);
        let outline = self.seen.view.render(&self.solids, &bodies);
        similarity::ratio(shot.frame, &outline).ok().flatten()
    }

    /// Ways of lying, rested and turned as the first frame shows it; the best of them.
    fn lies(&self, run: &Run, first: &Shot<'_>) -> Option<Vec<Way>> {
        let angles = windows::angles(run, first.t_s, 1)?;
        let still = held(&angles, REST_S);
        let home = self.play(vec![(Start::Home, still.clone())])?;
        let pose = home.first()?.first().copied()?;
        let laid = LIES.iter().map(|[x, y]| {
            let turn = turn::times(turn::exp([*x, 0.0, 0.0]), turn::exp([0.0, *y, 0.0]));
            let pose = self.laid(run, first.t_s, pose, turn)?;
            Some((rest(pose, &angles), still.clone()))
        });
        let rested = self.play(laid.collect::<Option<Vec<_>>>()?)?;
        let mut ways: Vec<Way> = Vec::new();
        for (i, poses) in rested.iter().enumerate() {
            for heading in [0.0, std::f64::consts::PI] {
                let pose = turned(*poses.last()?, heading);
                if let Some((pose, _, overlap)) = self.correct(run, first, pose, ANY_RAD) {
                    let mut way = Way::new(pose, i == 0);
                    way.overlaps.push(overlap);
                    ways.push(way);
                }
            }
        }
        ways.sort_by(|a, b| b.merit().total_cmp(&a.merit()));
        ways.truncate(TRIED);
        (!ways.is_empty()).then_some(ways)
    }

    /// Simulates starts along led angles: poses every [`PERIOD_S`].
    fn play(&self, starts: Vec<(Start, Vec<f64>)>) -> Option<Vec<Vec<Pose>>> {
        let trials: Vec<Trial> = starts
            .into_iter()
            .map(|(start, values)| Trial {
                params: Arc::clone(&self.params),
                start,
                duration_s: (values.len() / JOINTS - 1) as f64 * PERIOD_S,
                drive: Drive::LinkAngles {
                    period_s: PERIOD_S,
                    values_rad: values.iter().map(|v| *v as f32).collect(),
                },
            })
            .collect();
        let outcomes = physics::run(&trials, &windows::options(false)).ok()?;
        let whole = |o: Outcome| o.not_finite.is_none().then_some(o.poses);
        outcomes.into_iter().map(whole).collect()
    }

    /// Carries every way on to the next frame.
    fn carry(&self, run: &Run, ways: &mut Vec<Way>, from_s: f64, to: &Shot<'_>) -> Option<()> {
        let n = (((to.t_s - from_s) / PERIOD_S).round() as usize).max(1);
        let values = windows::angles(run, from_s, n + 2)?;
        let starts = ways.iter().map(|w| {
            let speed = |k: usize| ((values[JOINTS + k] - values[k]) / PERIOD_S) as f32;
            let start = Start::State {
                base: w.pose,
                twist: w.twist,
                angles_rad: values[..JOINTS].iter().map(|x| *x as f32).collect(),
                speeds_rad_s: (0..JOINTS).map(speed).collect(),
            };
            (start, values[..(n + 1) * JOINTS].to_vec())
        });
        let played = self.play(starts.collect())?;
        let mut next = Vec::with_capacity(ways.len());
        for (mut w, between) in std::mem::take(ways).into_iter().zip(&played) {
            let end = *between.last()?;
            if let Some((pose, heading_rad, overlap)) = self.correct(run, to, end, HEADING_RAD) {
                w.bend(from_s, to.t_s, between, pose, heading_rad);
                w.overlaps.push(overlap);
                next.push(w);
            }
        }
        *ways = next;
        (!ways.is_empty()).then_some(())
    }

    /// Where even the best way does not fit a frame: ways in which the robot may have tipped.
    fn tip(&self, run: &Run, ways: &mut Vec<Way>, shot: &Shot<'_>) -> Option<()> {
        let now = |w: &Way| w.overlaps.last().copied().unwrap_or(0.0);
        let best = ways
            .iter()
            .max_by(|a, b| now(a).total_cmp(&now(b)))?
            .clone();
        if now(&best) > GOOD {
            return Some(());
        }
        let angles = windows::angles(run, shot.t_s, 1)?;
        let still = held(&angles, TIP_S);
        let mut starts = Vec::new();
        for size in TIPS_RAD {
            for eighth in 0..8 {
                let (sin, cos) = libm::sincos(0.5 * QUARTER * f64::from(eighth));
                let pose = self.laid(
                    run,
                    shot.t_s,
                    best.pose,
                    turn::exp([size * cos, size * sin, 0.0]),
                )?;
                starts.push((rest(pose, &angles), still.clone()));
            }
        }
        for poses in self.play(starts)? {
            let Some((pose, _, overlap)) = self.correct(run, shot, *poses.last()?, ANY_RAD) else {
                continue;
            };
            if overlap > now(&best) + HOME {
                let mut way = Way {
                    pose,
                    twist: Twist::default(),
                    ..best.clone()
                };
                way.overlaps.pop();
                way.overlaps.push(overlap);
                ways.push(way);
            }
        }
        Some(())
    }

    /// `pose` turned by `turn`, its lowest cube just above the ground.
    fn laid(&self, run: &Run, t_s: f64, pose: Pose, turn: [f64; 4]) -> Option<Pose> {
        let mut pose = Pose {
            quaternion: turn::times(turn, pose.quaternion.map(f64::from)).map(|x| x as f32),
            ..pose
        };
        let bodies = tier::bodies(&self.robot, run, t_s, &pose)?;
        let height = bodies.iter().map(|b| b.position_m.z);
        pose.position_m[2] +=
            1.1 * self.robot.ball_radius_m() - height.fold(f32::INFINITY, f32::min);
        Some(pose)
    }
}

/// Angles held for a while, one sample every [`PERIOD_S`].
fn held(angles: &[f64], duration_s: f64) -> Vec<f64> {
    let samples = (duration_s / PERIOD_S) as usize + 1;
    angles.repeat(samples)
}

/// At rest with the joints held.
fn rest(base: Pose, angles: &[f64]) -> Start {
    Start::State {
        base,
        twist: Twist::default(),
        angles_rad: angles.iter().map(|x| *x as f32).collect(),
        speeds_rad_s: vec![0.0; JOINTS],
    }
}

/// The paper's similarity R of whole runs that start as the film shows and follow the set-points: mean overlap over union of filmed
/// and simulated outlines (paper, section VII); `None` where no run's pose came from its film.
pub(super) fn similarity(
    data: &Data,
    films: &[Film],
    manifest: &Manifest,
    model: &Model,
    runs: &[usize],
    params: &Arc<Params>,
) -> Option<f64> {
    let filmed = |r: &&usize| {
        let base = data.runs[**r].base.as_ref();
        base.is_some_and(|b| b.filmed.is_some())
    };
    let runs: Vec<usize> = runs.iter().filter(filmed).copied().collect();
    let outcomes = predict::rollouts(data, &runs, params);
    let one = |(r, o): (&usize, &Option<Outcome>)| {
        let (run, o) = (&data.runs[*r], o.as_ref()?);
        let film = films.iter().find(|f| f.run == run.index)?;
        let stage = Stage::new(film, manifest, model, params)?;
        let overlaps: Vec<f64> = stage
            .shots(run, film)
            .iter()
            .filter_map(|shot| stage.overlap(shot, o))
            .collect();
        (!overlaps.is_empty()).then(|| math::mean(&overlaps))
    };
    let all: Vec<f64> = runs.iter().zip(&outcomes).filter_map(one).collect();
    (!all.is_empty()).then(|| math::mean(&all))
}
