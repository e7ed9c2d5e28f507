//! The body tier: pose of the base in short windows, joints led along the measured angles.

mod contacts;
mod target;

use std::sync::Arc;

use files::model::Model;
use physics::{Outcome, Params, Robot, Trial};

use super::body_library::coordinates;
use super::data::{Data, JOINTS};
use super::fit::Evaluate;
use super::windows::{self, LinkMap, PERIOD_S, Window};
use super::{inertial, turn};
use crate::math;
use target::{Target, floor, numbers, sample_index, simulated, spread_by};

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
    /// The same where the friction across the direction is the lower one.
    AnisotropyLessCos,
    /// Sine part.
    AnisotropyLessSin,
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
    /// Mass added to body 0, kg; those of bodies 1 to 6 follow.
    Heavy,
}

/// Half-spheres of each body, from the free end of module A.
const HALVES: [&[usize]; 7] = [&[0], &[1], &[2], &[3, 4], &[5], &[6], &[7]];

pub(super) const BODY: usize = 25;
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
/// Error of a compared pose beyond that of its start and of the time step: m, share of the way, rad. With the inertial sensor: residues
/// of the pose and of contacts; emulated robots without a cause leave a cost of 1.4 to 2 with these. Without: two honest engines
/// (2 mm after 1 s at the median; `docs/validation/README.md` has the table of engines).
const FLOOR: [f64; 3] = [0.6e-3, 0.01, 2.5e-3];
const FLOOR_BLIND: [f64; 3] = [1.0e-3, 0.03, 6.0e-3];
/// Grounds on which windows are measured, 1 / stiffness of a contact point, m/N: hard, then from firm foam to soft.
pub(super) const SOFTER: [f64; 4] = [0.0, 3e-4, 1e-3, 3e-3];
/// Windows whose end moves by more than this under a disturbed start are left out, m: they are about to tip.
const CHAOTIC_M: f64 = 0.02;

/// Covariance of the numbers of a window without the floor, and the way to each instant, m.
type Spread = (Vec<f64>, [f64; SAMPLES]);

/// Numbers compared in a window.
pub(super) const NUMBERS: usize = 6 * SAMPLES;
/// Directions in which the start of a window may be wrong: pose and twist.
const STARTS: usize = 12;

/// Windows and what was measured in them.
#[derive(Clone)]
pub(super) struct Tier {
    base: Params,
    pub(super) model: Model,
    pub(super) windows: Vec<Window>,
    /// All windows with their groups, those that tip too.
    all: (Vec<Window>, Vec<usize>),
    targets: Vec<[Target; SAMPLES]>,
    /// Covariance of the numbers of each window without the floor, and the way to each instant, m.
    spreads: Vec<Spread>,
    /// Lower factor of the covariance with the floor, row by row.
    factors: Vec<Vec<f64>>,
    /// Floor of the tolerances: m, share of the way, rad.
    floor: [f64; 3],
    /// Windows start from the inertial sensor.
    sensed: bool,
    pub(super) group: Vec<usize>,
    pub(super) groups: usize,
    pub(super) maps: [LinkMap; JOINTS],
    pub(super) order: [usize; JOINTS],
    pub(super) link_measured: bool,
    /// Roll and pitch of the ground as the inertial sensor shows them.
    pub(super) slope: Option<[f64; 2]>,
    /// Windows left out because they tip.
    pub(super) chaotic: usize,
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
        let windows: Vec<Window> = all.into_iter().step_by(thin).collect();
        if windows.is_empty() {
            return None;
        }
        let mut names: Vec<usize> = windows.iter().map(|w| w.gait).collect();
        names.sort_unstable();
        names.dedup();
        let group: Vec<usize> = windows
            .iter()
            .filter_map(|w| names.iter().position(|n| *n == w.gait))
            .collect();
        let mut out = Self {
            base: Params::clone(params),
            model: model.clone(),
            targets: Vec::new(),
            spreads: Vec::new(),
            factors: Vec::new(),
            floor: FLOOR,
            sensed: false,
            groups: names.len(),
            all: (windows.clone(), group.clone()),
            group,
            windows,
            maps: [LinkMap::default(); JOINTS],
            order: std::array::from_fn(|k| k),
            link_measured: (0..JOINTS).all(|k| data.has(k, |j| j.link.is_some())),
            slope: inertial::slope(data),
            chaotic: 0,
        };
        let mut theta: Vec<f64> = coordinates(model).iter().map(|c| c.neutral).collect();
        if let Some([roll, pitch]) = out.slope {
            (theta[B::Roll as usize], theta[B::Pitch as usize]) = (roll, pitch);
        }
        out.sensed = out.inertial(data);
        out.floor = out.own_floor();
        out.settle(data, theta);
        (!out.windows.is_empty()).then_some(out)
    }

    /// Measures how windows depend on their start, on a ground soft enough that most of them can be told: on soft ground the feet
    /// stand in it, from where a hard one throws the robot.
    pub(super) fn settle(&mut self, data: &Data, mut theta: Vec<f64>) {
        for give in SOFTER {
            theta[B::GroundGive as usize] = give;
            self.measure(data, &theta);
            if 2 * self.windows.len() >= self.all.0.len() {
                return;
            }
        }
    }

    /// Whether any window starts from the inertial sensor.
    fn inertial(&self, data: &Data) -> bool {
        let of = |w: &Window| data.runs[w.run].base.as_ref()?.reckoned.as_ref();
        self.windows.iter().any(|w| of(w).is_some())
    }

    /// Takes measured poses and finds out how each window depends on its start and on the time step. A body on which every window tips is
    /// not measured: what was known before stays.
    pub(super) fn measure(&mut self, data: &Data, theta: &[f64]) {
        let all = self.all.clone();
        let before = std::mem::replace(&mut self.windows, all.0);
        let plain = windows::options(false);
        let nominal = windows::run(&self.trials(theta), &plain);
        let fine = physics::Options {
            time_step_s: 0.5 * plain.time_step_s,
            ..plain
        };
        let mut others = vec![windows::run(&self.trials(theta), &fine)];
        for d in 0..STARTS {
            let mut trials = self.trials(theta);
            for (t, w) in trials.iter_mut().zip(&self.windows) {
                let base = data.runs[w.run].base.as_ref();
                windows::disturb(t, d, 1.0, base.is_some_and(|b| b.reckoned.is_some()));
            }
            others.push(windows::run(&trials, &plain));
        }
        let mut kept = (Vec::new(), Vec::new(), Vec::new());
        for w in 0..self.windows.len() {
            let of: Vec<&Outcome> = others.iter().map(|o| &o[w]).collect();
            if let Some((targets, spread)) = self.target(data, w, &nominal[w], &of) {
                kept.0.push(w);
                kept.1.push(targets);
                kept.2.push(spread);
            }
        }
        if kept.0.is_empty() && !self.targets.is_empty() {
            self.windows = before;
            return;
        }
        self.chaotic = self.windows.len() - kept.0.len();
        self.windows = kept.0.iter().map(|w| self.windows[*w].clone()).collect();
        self.group = kept.0.iter().map(|w| all.1[*w]).collect();
        (self.targets, self.spreads) = (kept.1, kept.2);
        self.weigh();
    }

    /// Tolerances and factors with the floor as it is.
    fn weigh(&mut self) {
        self.weigh_with(&[]);
    }

    /// The same where windows may end off by each of the `columns` of their own too.
    fn weigh_with(&mut self, columns: &[Vec<Vec<f64>>]) {
        self.factors.clear();
        let windows = self.targets.iter_mut().zip(&self.spreads);
        for (w, (targets, (spread, ways))) in windows.enumerate() {
            let mut covariance = spread.clone();
            for c in columns {
                spread_by(&mut covariance, &c[w]);
            }
            for (i, (target, way)) in targets.iter_mut().zip(ways).enumerate() {
                for (k, t) in target.tolerance.iter_mut().enumerate() {
                    let own = &mut covariance[(6 * i + k) * (NUMBERS + 1)];
                    *own += floor(&self.floor, k, *way).powi(2);
                    *t = own.sqrt();
                }
            }
            self.factors
                .push(super::least::factor(&covariance, NUMBERS));
        }
    }

    /// What a window is compared with, its covariance without the floor, and the ways; `None` where it tips.
    fn target(
        &self,
        data: &Data,
        w: usize,
        nominal: &Outcome,
        others: &[&Outcome],
    ) -> Option<([Target; SAMPLES], Spread)> {
        let window = &self.windows[w];
        let base = data.runs[window.run].base.as_ref()?;
        let start = windows::base_state(base, window.from_s)?.0;
        let columns: Vec<Vec<f64>> = others
            .iter()
            .map(|o| numbers(nominal, o))
            .collect::<Option<_>>()?;
        let mut covariance = vec![0.0; NUMBERS * NUMBERS];
        for c in &columns {
            spread_by(&mut covariance, c);
        }
        for (i, own) in covariance.iter_mut().step_by(NUMBERS + 1).enumerate() {
            *own += base.filmed.map_or(0.0, |error| error[i % 6].powi(2));
        }
        let mut ways = [0.0; SAMPLES];
        let mut targets = Vec::with_capacity(SAMPLES);
        for (i, slot) in ways.iter_mut().enumerate() {
            let at = window.from_s + sample_index(i) as f64 * PERIOD_S;
            let measured = windows::base_state(base, at)?.0;
            let way = (0..3)
                .map(|k| f64::from(measured.position_m[k] - start.position_m[k]).powi(2))
                .sum::<f64>()
                .sqrt();
            *slot = way;
            let tolerance = std::array::from_fn(|k| {
                let own = covariance[(6 * i + k) * (NUMBERS + 1)];
                libm::hypot(own.sqrt(), floor(&self.floor, k, way))
            });
            if tolerance[..3]
                .iter()
                .map(|x: &f64| x * x)
                .sum::<f64>()
                .sqrt()
                > CHAOTIC_M
            {
                return None;
            }
            targets.push(Target {
                pose: (
                    measured.position_m.map(f64::from),
                    measured.quaternion.map(f64::from),
                ),
                tolerance,
            });
        }
        Some((targets.try_into().ok()?, (covariance, ways)))
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

    /// The tier with signs that were found.
    pub(super) fn mapped(mut self, data: &Data, maps: [LinkMap; JOINTS], theta: Vec<f64>) -> Self {
        self.maps = maps;
        self.settle(data, theta);
        self
    }

    /// Takes order and signs found elsewhere.
    pub(super) fn adopt(&mut self, other: &Self) {
        self.maps = other.maps;
        self.order = other.order;
        self.floor = other.floor;
        self.weigh();
    }

    /// Whether all joints read in the order and the sense that they should.
    pub(super) fn as_told(&self) -> bool {
        let right = std::array::from_fn(|k| k);
        self.order == right && self.maps == [LinkMap::default(); JOINTS]
    }

    /// Number of windows compared.
    pub(super) fn len(&self) -> usize {
        self.windows.len()
    }

    pub(super) fn params(&self, theta: &[f64]) -> Params {
        let get = |b: B| theta[b as usize];
        let mut p = self.base.clone();
        if let Some(model) = self.connected(theta)
            && let Ok(robot) = Robot::meta_module(&model)
            && let Ok(with) = Params::new(&model, Arc::new(robot))
        {
            p = with;
        }
        p.friction *= get(B::Friction);
        p.bounce = get(B::Bounce);
        p.erp = get(B::Erp);
        let last = (p.half_masses_kg.len() - 1) as f64;
        for (i, m) in p.half_masses_kg.iter_mut().enumerate() {
            *m *= 1.0 + get(B::Gradient) * (2.0 * i as f64 / last - 1.0);
        }
        for (b, halves) in HALVES.iter().enumerate() {
            let added = theta[B::Heavy as usize + b] / halves.len() as f64;
            for h in halves.iter().filter(|_| added != 0.0) {
                p.half_masses_kg[*h] = (p.half_masses_kg[*h] + added).max(1e-3);
            }
        }
        if let Some((ratio, direction_rad)) = anisotropy(theta) {
            (p.anisotropy_ratio, p.anisotropy_direction_rad) = (ratio, direction_rad);
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
        for (k, j) in p.joints[..JOINTS].iter_mut().enumerate() {
            let [play, flex] = [PLAY, FLEX].map(|what| theta[of_joint(k, what)]);
            j.backlash_rad = play.max(0.0);
            if flex > 0.0 {
                j.stiffness_nm_rad = 1.0 / flex;
            }
        }
        p.com_offset_m = [get(B::ComX), get(B::ComY), get(B::ComZ)];
        p
    }

    /// How readings hang on links.
    pub(super) fn links(&self, theta: &[f64]) -> [LinkMap; JOINTS] {
        std::array::from_fn(|k| LinkMap {
            offset_rad: self.maps[k].offset_rad + theta[of_joint(k, OFFSET)],
            ratio: self.maps[k].ratio * theta[of_joint(k, RATIO)],
        })
    }

    fn trials(&self, theta: &[f64]) -> Vec<Trial> {
        self.trials_of(theta, 1)
    }

    /// Every `thin`-th window.
    fn trials_of(&self, theta: &[f64], thin: usize) -> Vec<Trial> {
        let params = Arc::new(self.params(theta));
        let maps = self.links(theta);
        windows::trials(
            self.windows.iter().step_by(thin),
            &params,
            &maps,
            &self.order,
        )
    }

    /// Errors of window `w` in units of their tolerances.
    fn errors_of(&self, w: usize, o: &Outcome) -> [f64; NUMBERS] {
        let mut errors = self.whitened_of(w, o);
        temper(&mut errors);
        errors
    }

    /// The same where outliers count as they are.
    fn whitened_of(&self, w: usize, o: &Outcome) -> [f64; NUMBERS] {
        let mut errors = Vec::with_capacity(NUMBERS);
        for (i, t) in self.targets[w].iter().enumerate() {
            if let Some((p, q)) = simulated(o, i).filter(|_| o.not_finite.is_none()) {
                errors.extend((0..3).map(|k| p[k] - t.pose.0[k]));
                errors.extend(turn::between(t.pose.1, q));
            }
        }
        // A simulation that broke down is as wrong as can be.
        let Ok(mut errors) = <[f64; NUMBERS]>::try_from(errors) else {
            return [10.0; NUMBERS];
        };
        super::least::whiten(&self.factors[w], &mut errors);
        errors
    }

    /// Errors of every window in units of their tolerances.
    pub(super) fn whitened(&self, theta: &[f64]) -> Vec<[f64; NUMBERS]> {
        let outcomes = windows::run(&self.trials(theta), &windows::options(false));
        let all = outcomes.iter().enumerate();
        all.map(|(w, o)| self.whitened_of(w, o)).collect()
    }

    /// Errors of every window, started from elsewhere within the errors of a start; of side 1 from the other side of the
    /// measured start than of side 0.
    pub(in crate::whole) fn started_elsewhere(
        &self,
        theta: &[f64],
        side: usize,
    ) -> Vec<[f64; NUMBERS]> {
        let mut trials = self.trials(theta);
        for (w, trial) in trials.iter_mut().enumerate() {
            let mut rng = math::Rng::new(w as u64);
            for d in 0..STARTS {
                let up = (rng.normal() > 0.0) == (side == 0);
                windows::disturb(trial, d, if up { 1.0 } else { -1.0 }, self.sensed);
            }
        }
        let outcomes = windows::run(&trials, &windows::options(false));
        let all = outcomes.iter().enumerate();
        all.map(|(w, o)| self.whitened_of(w, o)).collect()
    }

    /// Errors of every `thin`-th window by group.
    fn residuals_of(&self, theta: &[f64], thin: usize) -> Vec<Vec<f64>> {
        let outcomes = windows::run(&self.trials_of(theta, thin), &windows::options(false));
        let mut out = vec![Vec::new(); self.groups];
        for (w, o) in (0..self.len()).step_by(thin).zip(&outcomes) {
            out[self.group[w]].extend(self.errors_of(w, o));
        }
        out
    }

    /// Cost of every `thin`-th window.
    pub(super) fn thinned(&self, theta: &[f64], thin: usize) -> f64 {
        super::least::cost(&self.residuals_of(theta, thin))
    }

    /// The gait whose windows leave most, and their cost.
    pub(super) fn worst(&self, theta: &[f64]) -> Option<(usize, f64)> {
        let costs = super::least::group_costs(&self.residuals(theta));
        let (group, cost) = (0..).zip(costs).max_by(|a, b| a.1.total_cmp(&b.1))?;
        let at = self.group.iter().position(|g| *g == group)?;
        Some((self.windows[at].gait, cost))
    }

    /// Error of position and heading at the end of every window, m and rad; `None` for one that could not be played.
    pub(super) fn ends(&self, theta: &[f64]) -> Vec<Option<[f64; 2]>> {
        let outcomes = windows::run(&self.trials(theta), &windows::options(false));
        let one = |(o, t): (&Outcome, &[Target; SAMPLES])| {
            let (p, q) = simulated(o, SAMPLES - 1)?;
            let last = &t[SAMPLES - 1];
            let off = (0..3).map(|k| (p[k] - last.pose.0[k]).powi(2));
            Some([off.sum::<f64>().sqrt(), turn::between(last.pose.1, q)[2]])
        };
        outcomes.iter().zip(&self.targets).map(one).collect()
    }
}

/// Ratio and direction of an anisotropic friction; `None` where it is the same all around.
pub(super) fn anisotropy(theta: &[f64]) -> Option<(f64, f64)> {
    let polar = |c: B, s: B, sign: f64| {
        let (c, s) = (theta[c as usize], theta[s as usize]);
        let strength = libm::hypot(c, s);
        (strength > 0.0).then(|| (libm::exp(sign * strength), 0.5 * libm::atan2(s, c)))
    };
    polar(B::AnisotropyCos, B::AnisotropySin, 1.0)
        .or_else(|| polar(B::AnisotropyLessCos, B::AnisotropyLessSin, -1.0))
}

/// Gravity in the frame of a ground turned by `roll` about x, then by `pitch` about y.
fn tilted(roll_rad: f64, pitch_rad: f64) -> [f64; 3] {
    let (sr, cr) = libm::sincos(roll_rad);
    let (sp, cp) = libm::sincos(pitch_rad);
    let g = physics::GRAVITY_M_S2;
    [g * sp, -g * cp * sr, -g * cp * cr]
}

/// Mean square of a window's errors above which it counts by its logarithm alone: a body that rests on an edge falls to either side.
const TEMPERED: f64 = 4.0;

pub(super) fn temper(errors: &mut [f64]) {
    let mean = errors.iter().map(|x| x * x).sum::<f64>() / errors.len() as f64;
    if mean > TEMPERED {
        let scale = (TEMPERED * (1.0 + libm::log(mean / TEMPERED)) / mean).sqrt();
        errors.iter_mut().for_each(|x| *x *= scale);
    }
}

impl Evaluate for Tier {
    fn residuals(&self, theta: &[f64]) -> Vec<Vec<f64>> {
        self.residuals_of(theta, 1)
    }
}
