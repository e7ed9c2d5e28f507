//! The camera tier: silhouettes against those of the measured pose.

use std::collections::BTreeMap;
use std::sync::Arc;

use camera::{Silhouette, Solid, View, similarity};
use control::kinematics;
use control::linalg::{Pose, Rot3, Vec3};
use control::robot::{RobotModel, RobotParams};
use files::dataset::Manifest;
use files::model::{Key, Model};
use rayon::prelude::*;

use super::data::{Data, JOINTS, Run};
use super::direct::{Reading, exact};
use super::fit::{Coordinate, Evaluate};
use super::windows;
use crate::math;
use crate::verdict::Estimate;
use crate::vocabulary::Effect;

/// Silhouettes of one run.
#[derive(Debug, Clone)]
pub struct Film {
    /// Index of the run in the manifest.
    pub run: usize,
    /// Time on the recording's clock as labelled, s, and the frame.
    pub frames: Vec<(f64, Silhouette)>,
}

/// Coordinates of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum C {
    /// m.
    Height,
    /// m.
    X,
    /// m.
    Y,
    /// rad.
    Yaw,
    /// What is labelled `t` was taken at `t + shift`, s.
    Shift,
}

/// Most frames that are rendered for a fit.
const FRAMES: usize = 120;
/// Tolerance of a centre or a size, px: the outline of a few hundred pixels, and a tracked pose.
const TOLERANCE_PX: f64 = 0.5;
/// Least share of missing frames that counts.
const LEAST_DROP: f64 = 0.02;

struct Frame {
    run: usize,
    t_s: f64,
    moments: [f64; 5],
    frame: Silhouette,
}

/// Frames, and the poses they are compared with.
pub(super) struct Tier {
    data: Arc<Data>,
    robot: RobotModel,
    solids: Vec<Solid>,
    frames: Vec<Frame>,
    groups: usize,
    group: Vec<usize>,
    size: (usize, usize),
    focal_px: f64,
    /// Missing frames over expected ones.
    pub(super) dropped: f64,
    expected: f64,
}

/// The camera as the data set states it.
pub(super) struct Seen {
    pub(super) view: View,
    pub(super) focal_px: f64,
    pub(super) height_m: f64,
    pub(super) yaw_rad: f64,
    /// What is labelled `t` was taken at `t + shift`, s.
    pub(super) shift_s: f64,
}

impl Seen {
    /// `None` where no camera can be like that.
    pub(super) fn new(manifest: &Manifest, model: &Model, frame: &Silhouette) -> Option<Self> {
        let stated: Vec<f64> = coordinates(manifest, model)
            .iter()
            .map(|c| c.neutral)
            .collect();
        let get = |c: C| stated[c as usize];
        let size = (frame.width(), frame.height());
        let focal_px = focal_px(manifest, size);
        let view = View::new(
            get(C::Height) as f32,
            (get(C::X) as f32, get(C::Y) as f32),
            get(C::Yaw) as f32,
            size,
            focal_px as f32,
        );
        Some(Self {
            view: view.ok()?,
            focal_px,
            height_m: get(C::Height),
            yaw_rad: get(C::Yaw),
            shift_s: get(C::Shift),
        })
    }

    /// Way on the ground, m, that moves what stands at `z_m` by `px`.
    pub(super) fn way_m(&self, px: [f64; 2], z_m: f64) -> [f64; 2] {
        let scale = (self.height_m - z_m) / self.focal_px;
        let (u, v) = (scale * px[0], -scale * px[1]);
        let (sin, cos) = libm::sincos(self.yaw_rad);
        [cos * u - sin * v, sin * u + cos * v]
    }
}

/// Focal length, px: as stated, or a Kinect's at 640 pixels, scaled to the frame.
fn focal_px(manifest: &Manifest, size: (usize, usize)) -> f64 {
    let stated = manifest.camera.as_ref();
    stated
        .and_then(|c| c.quantities.get("focal_px"))
        .map_or(580.0 * size.0 as f64 / 640.0, |q| q.value)
}

/// Poses of the seven bodies of a robot whose body 3 is at `base`; `None` where an angle was not measured.
pub(super) fn bodies(
    robot: &RobotModel,
    run: &Run,
    t_s: f64,
    base: &physics::Pose,
) -> Option<Vec<Pose>> {
    let mut q = [0.0f32; JOINTS];
    for (slot, j) in q.iter_mut().zip(&run.joints) {
        *slot = j.link.as_ref().or(j.position.as_ref())?.at(t_s) as f32;
    }
    Some(placed(robot, q, base))
}

/// Poses of the seven bodies at joint angles `q_rad` with body 3 at `base`.
pub(super) fn placed(robot: &RobotModel, q_rad: [f32; JOINTS], base: &physics::Pose) -> Vec<Pose> {
    let [x, y, z] = base.position_m;
    let pose = Pose {
        position_m: Vec3::new(x, y, z),
        rotation: Rot3::from_quaternion(base.quaternion),
    };
    kinematics::forward(robot, &q_rad)
        .rebased(3, &pose)
        .bodies()
        .to_vec()
}

/// Centre, size and the two deviators of the second moments, all in px; `None` for an empty frame.
pub(super) fn moments(frame: &Silhouette) -> Option<[f64; 5]> {
    let (mut n, mut sx, mut sy, mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (x, y) in frame.marked() {
        let (x, y) = (x as f64, y as f64);
        n += 1.0;
        sx += x;
        sy += y;
        sxx += x * x;
        sxy += x * y;
        syy += y * y;
    }
    if n < 20.0 {
        return None;
    }
    let (mx, my) = (sx / n, sy / n);
    let (xx, xy, yy) = (sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my);
    let size = (xx + yy).max(1e-9).sqrt();
    Some([mx, my, n.sqrt(), (xx - yy) / size, 2.0 * xy / size])
}

/// Whether the outline touches the border: then its centre is not the robot's.
pub(super) fn cut(frame: &Silhouette) -> bool {
    let (w, h) = (frame.width(), frame.height());
    (0..w).any(|x| frame.get(x, 0) || frame.get(x, h - 1))
        || (0..h).any(|y| frame.get(0, y) || frame.get(w - 1, y))
}

pub(super) fn robot(model: &Model) -> Option<RobotModel> {
    RobotModel::new(RobotParams {
        twist_rad: model.value(Key::Twist) as f32,
        cube_m: model.value(Key::Cube) as f32,
        ball_radius_m: model.value(Key::BallRadius) as f32,
        ..RobotParams::default()
    })
    .ok()
}

/// Time between two frames of which none is missing in between, s: of frames at `t_s`, more than a tenth follow the one before at once.
fn period_s(t_s: &[f64]) -> f64 {
    let steps: Vec<f64> = t_s.windows(2).map(|w| w[1] - w[0]).collect();
    let short = 1.5 * math::quantile(&steps, 0.1);
    let single: Vec<f64> = steps.into_iter().filter(|s| *s <= short).collect();
    math::median(&single).max(1e-3)
}

impl Tier {
    /// Frames of the runs `fit`; `None` without films or poses.
    pub(super) fn new(
        data: &Arc<Data>,
        manifest: &Manifest,
        model: &Model,
        films: &[Film],
        fit: &[usize],
    ) -> Option<Self> {
        let robot = robot(model)?;
        let solids = Solid::meta_module(&robot);
        let mut frames = Vec::new();
        let (mut seen, mut expected) = (0.0, 0.0);
        for film in films {
            let Some(r) = data.runs.iter().position(|r| r.index == film.run) else {
                continue;
            };
            let run = &data.runs[r];
            let t: Vec<f64> = film.frames.iter().map(|f| f.0).collect();
            if let (Some(first), Some(last)) = (t.first(), t.last()) {
                // First and last are there by choice.
                seen += t.len() as f64 - 2.0;
                expected += ((last - first) / period_s(&t)).round() - 1.0;
            }
            // A pose that was read off the film says nothing of the film.
            let tracked = run.base.as_ref().is_some_and(|b| b.filmed.is_none());
            let measured = tracked && run.joints.iter().all(|j| j.position.is_some());
            if !fit.contains(&r) || !measured {
                continue;
            }
            for (t_s, frame) in &film.frames {
                if let Some(moments) = moments(frame).filter(|_| !cut(frame)) {
                    frames.push(Frame {
                        run: r,
                        t_s: t_s - run.t0_s,
                        moments,
                        frame: frame.clone(),
                    });
                }
            }
        }
        let thin = frames.len().div_ceil(FRAMES).max(1);
        let frames: Vec<Frame> = frames.into_iter().step_by(thin).collect();
        let first = frames.first()?;
        let size = (first.frame.width(), first.frame.height());
        let focal_px = focal_px(manifest, size);
        let mut names: Vec<usize> = frames.iter().map(|f| data.runs[f.run].gait).collect();
        names.sort_unstable();
        names.dedup();
        let group = frames
            .iter()
            .filter_map(|f| names.iter().position(|n| *n == data.runs[f.run].gait))
            .collect();
        Some(Self {
            data: Arc::clone(data),
            robot,
            solids,
            groups: names.len(),
            group,
            size,
            focal_px,
            frames,
            dropped: 1.0 - seen.max(0.0) / f64::max(expected, 1.0),
            expected,
        })
    }

    fn bodies(&self, run: usize, t_s: f64) -> Option<Vec<Pose>> {
        let run = &self.data.runs[run];
        let (base, _) = windows::base_state(run.base.as_ref()?, t_s)?;
        bodies(&self.robot, run, t_s, &base)
    }

    fn render(&self, theta: &[f64], frame: &Frame) -> Option<Silhouette> {
        let get = |c: C| theta[c as usize];
        let view = View::new(
            get(C::Height) as f32,
            (get(C::X) as f32, get(C::Y) as f32),
            get(C::Yaw) as f32,
            self.size,
            self.focal_px as f32,
        )
        .ok()?;
        let bodies = self.bodies(frame.run, frame.t_s + get(C::Shift))?;
        Some(view.render(&self.solids, &bodies))
    }

    /// Mean overlap over union by group.
    pub(super) fn similarity(&self, theta: &[f64]) -> Vec<f64> {
        let all: Vec<Option<f64>> = self
            .frames
            .par_iter()
            .map(|f| {
                similarity::ratio(&f.frame, &self.render(theta, f)?)
                    .ok()
                    .flatten()
            })
            .collect();
        (0..self.groups)
            .map(|g| {
                let own: Vec<f64> = all
                    .iter()
                    .zip(&self.group)
                    .filter(|x| *x.1 == g)
                    .filter_map(|x| *x.0)
                    .collect();
                math::mean(&own)
            })
            .collect()
    }

    /// Share of missing frames with its deviation, where it counts.
    pub(super) fn drops(&self) -> Option<(f64, f64)> {
        let p = self.dropped;
        (p > LEAST_DROP).then(|| (p, (p * (1.0 - p) / self.expected.max(1.0)).sqrt()))
    }
}

impl Evaluate for Tier {
    fn residuals(&self, theta: &[f64]) -> Vec<Vec<f64>> {
        let all: Vec<[f64; 5]> = self
            .frames
            .par_iter()
            .map(|f| {
                let seen = self.render(theta, f).and_then(|s| moments(&s));
                seen.map_or([20.0; 5], |m| {
                    std::array::from_fn(|i| (m[i] - f.moments[i]) / TOLERANCE_PX)
                })
            })
            .collect();
        let mut out = vec![Vec::new(); self.groups];
        for (r, g) in all.iter().zip(&self.group) {
            out[*g].extend_from_slice(r);
        }
        out
    }
}

/// What is stated of the camera.
pub(super) fn coordinates(manifest: &Manifest, model: &Model) -> Vec<Coordinate> {
    let known = |key: &str, default: f64, tolerance: f64| {
        let q = manifest.camera.as_ref().and_then(|c| c.quantities.get(key));
        let value = q.map_or(default, |q| q.value);
        // Tolerances of the data set are relative; of a value of zero they say nothing.
        let sigma = q
            .and_then(|q| q.tolerance)
            .map_or(tolerance, |t| (t * value.abs()).max(0.1 * tolerance));
        (value, sigma)
    };
    let height = model.parameter(Key::CameraHeight);
    // Table II's shift is that of the paper's films; it means nothing for a data set that brings no model of its own.
    let own = model.parameter(Key::CameraTimeShift);
    let shift = if manifest.model.is_some() {
        (own.value, own.tolerance)
    } else {
        (0.0, 0.02)
    };
    let list = [
        (
            known("height_m", height.value, height.tolerance),
            0.02,
            [0.2, 50.0],
        ),
        // A plumb line finds the point below the camera to a few millimetres.
        (known("x_m", 0.0, 0.005), 0.01, [-50.0, 50.0]),
        (known("y_m", 0.0, 0.005), 0.01, [-50.0, 50.0]),
        (known("yaw_rad", 0.0, 0.005), 0.01, [-7.0, 7.0]),
        (
            known("clock_offset_s", shift.0, shift.1),
            0.05,
            [-60.0, 60.0],
        ),
    ];
    list.into_iter()
        .map(|((neutral, sigma), step, range)| Coordinate {
            neutral,
            sigma,
            step,
            range,
        })
        .collect()
}

/// Missing frames, where they count.
pub(super) fn dropped(tier: &Tier) -> Option<Reading> {
    let (value, error) = tier.drops()?;
    Some(Reading {
        effect: Effect::FrameDrop,
        joint: None,
        key: "probability",
        estimate: exact(value, 1.96 * error),
    })
}

/// Puts what was found about the camera into its coordinates.
pub(super) fn put(theta: &mut [f64], effect: Effect, values: &BTreeMap<String, Estimate>) {
    let of: &[(C, &str)] = match effect {
        Effect::CameraHeight => &[(C::Height, "height_m")],
        Effect::CameraOffset => &[(C::X, "x_m"), (C::Y, "y_m")],
        Effect::CameraYaw => &[(C::Yaw, "angle_rad")],
        Effect::CameraTimeShift => &[(C::Shift, "shift_s")],
        _ => &[],
    };
    for (c, key) in of {
        if let Some(found) = values.get(*key) {
            theta[*c as usize] = found.value;
        }
    }
}
