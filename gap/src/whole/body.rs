//! The body tier: pose of the base in short windows, joints led along the measured angles.

use std::sync::Arc;

use files::model::{Effect as ModelEffect, Model};
use physics::{Outcome, Params, Robot, Trial};

use super::body_library::{candidates, coordinates};
use super::data::{Data, JOINTS};
use super::search::{Answer, Evaluate, Limits, Search};
use super::windows::{self, LinkMap, PERIOD_S, Window};
use crate::math;
use crate::vocabulary::Effect;

/// Coordinates of the body; those of the joints follow, four per joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum B {
    /// Ratio to the nominal friction.
    Friction,
    /// Restitution.
    Bounce,
    /// ERP of the contacts.
    Erp,
    /// Masses of the free end of module B over those of module A, as a linear gradient.
    Gradient,
    /// Logarithm of the anisotropy, cosine part of twice the direction.
    AnisotropyCos,
    /// Sine part.
    AnisotropySin,
    /// Torsional friction, m.
    Torsion,
    /// Roll of the ground, rad.
    Roll,
    /// Pitch of the ground, rad.
    Pitch,
    /// 1 / stiffness of a contact point, m/N.
    GroundGive,
    /// Damping of a contact point, N s/m.
    GroundDamping,
    /// Shift of the centre of mass of body 3, m.
    ComX,
    /// The same along y.
    ComY,
    /// The same along z.
    ComZ,
    /// 1 / stiffness of the connector, rad/(N m).
    ConnectorGive,
    /// Half play of the connector, rad.
    ConnectorPlay,
}

pub(super) const BODY: usize = 16;
/// Coordinates of joint `k`: offset, ratio, play, flex.
pub(super) fn of_joint(k: usize, what: usize) -> usize {
    BODY + 4 * k + what
}
pub(super) const OFFSET: usize = 0;
pub(super) const RATIO: usize = 1;
pub(super) const PLAY: usize = 2;
pub(super) const FLEX: usize = 3;

/// Length of a window, s: long enough for a slip to show, short enough that no tipping is amplified.
pub(super) const WINDOW_S: f64 = 1.0;
/// Samples compared in a window.
const SAMPLES: usize = 4;
/// Most seconds of windows that are fitted.
const FIT_S: f64 = 150.0;
/// Error of the base position that two honest engines make in a window, m and share of the way: measured between time steps of
/// 1 and 4 ms (docs/physics.md: 2 mm after 1 s at the median).
const MODEL_M: f64 = 1.0e-3;
const MODEL_SHARE: f64 = 0.03;
/// The same for the attitude, rad.
const MODEL_RAD: f64 = 6.0e-3;
/// Windows whose end moves by more than this under a disturbed start are left out, m: they are about to tip.
const CHAOTIC_M: f64 = 0.02;

/// Measured pose change and tolerance at one instant of a window: position then rotation vector.
#[derive(Debug, Clone, Copy)]
struct Target {
    pose: ([f64; 3], [f64; 4]),
    tolerance: [f64; 6],
}

/// Windows and what was measured in them.
pub(super) struct Tier {
    base: Params,
    model: Model,
    windows: Vec<Window>,
    targets: Vec<[Target; SAMPLES]>,
    group: Vec<usize>,
    groups: usize,
    pub(super) maps: [LinkMap; JOINTS],
    pub(super) order: [usize; JOINTS],
    link_measured: bool,
    /// Windows left out because they tip.
    pub(super) chaotic: usize,
}

fn conjugate_times(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    // b a*: from a to b in world axes.
    let [aw, ax, ay, az] = [a[0], -a[1], -a[2], -a[3]];
    let [bw, bx, by, bz] = b;
    [
        bw * aw - bx * ax - by * ay - bz * az,
        bw * ax + bx * aw + by * az - bz * ay,
        bw * ay - bx * az + by * aw + bz * ax,
        bw * az + bx * ay - by * ax + bz * aw,
    ]
}

/// Rotation vector from attitude `a` to `b`, small angles.
fn rotation(a: [f64; 4], b: [f64; 4]) -> [f64; 3] {
    let q = conjugate_times(a, b);
    let s = if q[0] < 0.0 { -2.0 } else { 2.0 };
    [s * q[1], s * q[2], s * q[3]]
}

fn sample_index(i: usize) -> usize {
    ((i + 1) as f64 * WINDOW_S / SAMPLES as f64 / PERIOD_S).round() as usize
}

fn simulated(o: &Outcome, i: usize) -> Option<([f64; 3], [f64; 4])> {
    let p = o.poses.get(sample_index(i)).or(o.poses.last())?;
    Some((p.position_m.map(f64::from), p.quaternion.map(f64::from)))
}

impl Tier {
    /// Windows of the runs `fit`; `None` without base poses or with a joint that was not measured.
    pub(super) fn new(
        data: &Data,
        model: &Model,
        params: &Arc<Params>,
        fit: &[usize],
    ) -> Option<Self> {
        let mut all = windows::cut(data, WINDOW_S, WINDOW_S);
        all.retain(|w| data.runs[w.run].base.is_some() && fit.contains(&w.run));
        let thin = (all.len() as f64 * WINDOW_S / FIT_S).ceil().max(1.0) as usize;
        let mut windows: Vec<Window> = all.into_iter().step_by(thin).collect();
        if windows.is_empty() {
            return None;
        }
        windows::replay(data, &mut windows, params, PERIOD_S);
        let mut names: Vec<usize> = windows.iter().map(|w| w.gait).collect();
        names.sort_unstable();
        names.dedup();
        let group = windows
            .iter()
            .filter_map(|w| names.iter().position(|n| *n == w.gait))
            .collect();
        let mut out = Self {
            base: Params::clone(params),
            model: model.clone(),
            targets: Vec::new(),
            groups: names.len(),
            group,
            windows,
            maps: [LinkMap::default(); JOINTS],
            order: std::array::from_fn(|k| k),
            link_measured: (0..JOINTS).all(|k| data.has(k, |j| j.link.is_some())),
            chaotic: 0,
        };
        out.measure(data);
        Some(out)
    }

    /// Takes measured poses and finds out how sharply each window depends on its start.
    fn measure(&mut self, data: &Data) {
        let coordinates = coordinates(&self.model);
        let theta: Vec<f64> = coordinates.iter().map(|c| c.neutral).collect();
        let nominal = windows::run(&self.trials(&theta), &windows::options(false));
        let disturbed: Vec<Vec<Outcome>> = (0..3)
            .map(|d| {
                let mut trials = self.trials(&theta);
                for t in &mut trials {
                    disturb(t, d);
                }
                windows::run(&trials, &windows::options(false))
            })
            .collect();
        let mut keep = Vec::new();
        let mut targets = Vec::new();
        for (w, window) in self.windows.iter().enumerate() {
            let of = |d: usize| &disturbed[d][w];
            let target = |i: usize| -> Option<Target> {
                let (p, q) = simulated(&nominal[w], i)?;
                let base = data.runs[window.run].base.as_ref()?;
                let at = window.from_s + sample_index(i) as f64 * PERIOD_S;
                let measured = windows::base_state(base, at)?.0;
                let start = windows::base_state(base, window.from_s)?.0;
                let mp = measured.position_m.map(f64::from);
                let way = (0..3)
                    .map(|k| (mp[k] - f64::from(start.position_m[k])).powi(2))
                    .sum::<f64>()
                    .sqrt();
                let mut tolerance = [0.0; 6];
                for d in 0..3 {
                    let (pd, qd) = simulated(of(d), i)?;
                    let r = rotation(q, qd);
                    for k in 0..3 {
                        tolerance[k] += (pd[k] - p[k]).powi(2) / 3.0;
                        tolerance[3 + k] += r[k] * r[k] / 3.0;
                    }
                }
                if tolerance[..3].iter().sum::<f64>().sqrt() > CHAOTIC_M {
                    return None;
                }
                for (k, t) in tolerance.iter_mut().enumerate() {
                    let model = if k < 3 {
                        MODEL_M + MODEL_SHARE * way
                    } else {
                        MODEL_RAD
                    };
                    *t = (*t + model * model).sqrt();
                }
                Some(Target {
                    pose: (mp, measured.quaternion.map(f64::from)),
                    tolerance,
                })
            };
            let all: Option<Vec<Target>> = (0..SAMPLES).map(target).collect();
            match all.and_then(|v| <[Target; SAMPLES]>::try_from(v).ok()) {
                Some(t) => {
                    targets.push(t);
                    keep.push(w);
                }
                None => self.chaotic += 1,
            }
        }
        self.windows = keep.iter().map(|w| self.windows[*w].clone()).collect();
        self.group = keep.iter().map(|w| self.group[*w]).collect();
        self.targets = targets;
    }

    /// Tolerance of the position at the end of a window, m: a disturbed start and another engine.
    pub(super) fn tolerance_m(&self) -> f64 {
        let one = |t: &[Target; SAMPLES]| {
            t[SAMPLES - 1].tolerance[..3]
                .iter()
                .map(|x| x * x)
                .sum::<f64>()
        };
        let all: Vec<f64> = self.targets.iter().map(one).collect();
        math::mean(&all).sqrt()
    }

    /// Takes order and signs found elsewhere.
    pub(super) fn adopt(&mut self, other: &Self) {
        self.maps = other.maps;
        self.order = other.order;
    }

    /// Number of windows compared.
    pub(super) fn len(&self) -> usize {
        self.windows.len()
    }

    pub(super) fn params(&self, theta: &[f64]) -> Params {
        let get = |b: B| theta[b as usize];
        let (give, play) = (get(B::ConnectorGive), get(B::ConnectorPlay));
        let mut p = self.base.clone();
        if give > 0.0 || play > 0.0 {
            let mut model = self.model.clone();
            let set = if give > 0.0 {
                model.set_effect(ModelEffect::ConnectorCompliance, None, &[1.0 / give])
            } else {
                model.set_effect(ModelEffect::ConnectorPlay, None, &[play])
            };
            if let (Ok(()), Ok(robot)) = (set, Robot::meta_module(&model))
                && let Ok(with) = Params::new(&model, Arc::new(robot))
            {
                p = with;
            }
        }
        p.friction *= get(B::Friction);
        p.bounce = get(B::Bounce);
        p.erp = get(B::Erp);
        let last = (p.half_masses_kg.len() - 1) as f64;
        for (i, m) in p.half_masses_kg.iter_mut().enumerate() {
            *m *= 1.0 + get(B::Gradient) * (2.0 * i as f64 / last - 1.0);
        }
        let (c, s) = (get(B::AnisotropyCos), get(B::AnisotropySin));
        let strength = c.hypot(s);
        if strength > 0.0 {
            p.anisotropy_ratio = libm::exp(strength);
            p.anisotropy_direction_rad = 0.5 * libm::atan2(s, c);
        }
        p.torsional_m = get(B::Torsion);
        let tilt = tilted(get(B::Roll), get(B::Pitch));
        if get(B::Roll) != 0.0 || get(B::Pitch) != 0.0 {
            p.gravity_m_s2 = tilt;
        }
        if get(B::GroundGive) > 0.0 {
            p.ground_stiffness_n_m = 1.0 / get(B::GroundGive);
            p.ground_damping_n_s_m = get(B::GroundDamping);
        }
        p.com_offset_m = [get(B::ComX), get(B::ComY), get(B::ComZ)];
        p
    }

    fn trials(&self, theta: &[f64]) -> Vec<Trial> {
        let params = Arc::new(self.params(theta));
        let maps: [LinkMap; JOINTS] = std::array::from_fn(|k| LinkMap {
            offset_rad: self.maps[k].offset_rad + theta[of_joint(k, OFFSET)],
            ratio: self.maps[k].ratio * theta[of_joint(k, RATIO)],
            play_rad: theta[of_joint(k, PLAY)],
            flex: theta[of_joint(k, FLEX)],
        });
        self.windows
            .iter()
            .map(|w| w.trial(&params, &maps, &self.order))
            .collect()
    }

    /// Position and heading error at the end of every window, by group: RMS, m and rad.
    pub(super) fn errors(&self, theta: &[f64]) -> Vec<[f64; 2]> {
        let outcomes = windows::run(&self.trials(theta), &windows::options(false));
        let mut sums = vec![[0.0f64; 3]; self.groups];
        for ((o, t), g) in outcomes.iter().zip(&self.targets).zip(&self.group) {
            let last = &t[SAMPLES - 1];
            if let Some((p, q)) = simulated(o, SAMPLES - 1) {
                let r = rotation(last.pose.1, q);
                let d: f64 = (0..3).map(|k| (p[k] - last.pose.0[k]).powi(2)).sum();
                sums[*g][0] += d;
                sums[*g][1] += r[2] * r[2];
                sums[*g][2] += 1.0;
            }
        }
        sums.iter()
            .filter(|s| s[2] > 0.0)
            .map(|s| [(s[0] / s[2]).sqrt(), (s[1] / s[2]).sqrt()])
            .collect()
    }
}

/// Gravity in the frame of a ground turned by `roll` about x, then by `pitch` about y.
fn tilted(roll_rad: f64, pitch_rad: f64) -> [f64; 3] {
    let (sr, cr) = libm::sincos(roll_rad);
    let (sp, cp) = libm::sincos(pitch_rad);
    let g = physics::GRAVITY_M_S2;
    [g * sp, -g * cp * sr, -g * cp * cr]
}

/// Start states as wrong as a tracker's: 0.5 mm, 4 mrad, 10 mm/s.
fn disturb(trial: &mut Trial, which: usize) {
    if let physics::Start::State { base, twist, .. } = &mut trial.start {
        let sign = [1.0f32, -1.0, 1.0][which];
        base.position_m[2] += 5e-4 * sign;
        base.quaternion[1 + which % 2] += 2e-3 * sign;
        twist.linear_m_s[which % 3] += 0.01 * sign;
    }
}

impl Evaluate for Tier {
    fn residuals(&self, theta: &[f64]) -> Vec<Vec<f64>> {
        let outcomes = windows::run(&self.trials(theta), &windows::options(false));
        let mut out = vec![Vec::new(); self.groups];
        for ((o, targets), g) in outcomes.iter().zip(&self.targets).zip(&self.group) {
            for (i, t) in targets.iter().enumerate() {
                let Some((p, q)) = simulated(o, i).filter(|_| o.not_finite.is_none()) else {
                    // A simulation that broke down is as wrong as can be.
                    out[*g].extend([10.0; 6]);
                    continue;
                };
                let r = rotation(t.pose.1, q);
                let off = [0, 1, 2].map(|k: usize| p[k] - t.pose.0[k]);
                let errors = off.iter().chain(&r).zip(&t.tolerance);
                out[*g].extend(errors.map(|(e, tolerance)| e / tolerance));
            }
        }
        out
    }
}

/// What was found about the body.
pub(super) struct Found {
    pub(super) tier: Tier,
    pub(super) answer: Answer,
}

impl Found {
    /// Joints whose readings were found to be off by the body.
    pub(super) fn readings(&self) -> Vec<usize> {
        let a = &self.answer;
        let off = |c: &&usize| {
            matches!(
                a.candidates[**c].effect,
                Effect::JointOffset | Effect::JointScale
            )
        };
        a.last()
            .members
            .iter()
            .filter(off)
            .filter_map(|c| a.candidates[*c].joint)
            .collect()
    }
}

/// Order and signs that only the body shows: recorded and commanded in one convention, turned in another.
fn conventions(tier: &mut Tier, theta: &[f64]) {
    let cost = |tier: &Tier| super::least::cost(&tier.residuals(theta));
    let mut now = cost(tier);
    // Below this the windows fit; no order of joints is wrong.
    const WRONG: f64 = 4.0;
    const BETTER: f64 = 0.6;
    for _ in 0..JOINTS {
        if now < WRONG {
            return;
        }
        let (maps, order) = (tier.maps, tier.order);
        let mut best = (now, maps, order);
        for a in 0..JOINTS {
            tier.maps = maps;
            tier.maps[a].ratio = -maps[a].ratio;
            let c = cost(tier);
            if c < best.0 {
                best = (c, tier.maps, order);
            }
            tier.maps = maps;
            for b in a + 1..JOINTS {
                tier.order = order;
                tier.order.swap(a, b);
                let c = cost(tier);
                if c < best.0 {
                    best = (c, maps, tier.order);
                }
            }
            tier.order = order;
        }
        if best.0 > BETTER * now {
            return;
        }
        (now, tier.maps, tier.order) = best;
    }
}

/// Diagnoses the body.
pub(super) fn diagnose(mut tier: Tier, withhold: &[Effect]) -> Found {
    let coordinates = coordinates(&tier.model);
    let mut candidates = candidates(tier.link_measured);
    candidates.retain(|c| !withhold.contains(&c.effect));
    let nominal: Vec<f64> = coordinates.iter().map(|c| c.neutral).collect();
    conventions(&mut tier, &nominal);
    let limits = Limits {
        share: 0.12,
        least: 0.1,
        relative: 0.18,
        of_first: 0.03,
        floor: 1.0,
        // A window is one independent trial of the body.
        independent: (tier.len() as f64).clamp(10.0, 1000.0),
        most: 4,
        beyond: 3.0,
        refined: 4,
        iterations: 3,
    };
    let search = Search {
        model: &tier,
        coordinates: &coordinates,
        candidates: &candidates,
        limits,
    };
    let base = search.fit(&nominal, &[], 3);
    let answer = search.answer(base, nominal);
    Found { answer, tier }
}
