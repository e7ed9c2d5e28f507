//! The joint tier: each joint cut out by measured signals and fitted alone.

use files::model::{Key, Model};

use super::conventions::Conventions;
use super::data::{Data, JOINTS, Run, Track};
use super::search::{Answer, Candidate, Coordinate, Evaluate, Limits, Search};
use super::servo::{self, J, JointRun, Nominal, Trace};
use crate::math;
use crate::vocabulary::Effect;

/// Joints between cubes; the others sit inside one.
const INTER: [usize; 2] = [1, 4];
/// Speed lost per torque that a real drive may have without being called an effect, rad/s per N m (1 sigma): Table II's servo
/// has none; a drive with a speed loop of about 50 Hz on the reflected rotor loses 0.03.
const DROOP: f64 = 0.05;
/// Set-point timing that recordings leave open, s (1 sigma).
const TIMING_S: f64 = 0.002;
/// Error that two honest simulators of one servo may have, as a share of the angle's spread.
const MODEL_ERROR: f64 = 0.003;
/// Least tolerance of an angle, rad: the resolution of small encoders.
const LEAST_RAD: f64 = 3.0e-4;
/// Error of replayed loads as a share of their spread: contacts share a load in more than one way.
const LOAD_ERROR: f64 = 0.1;
/// Most seconds of recordings that one joint is fitted on.
const FIT_S: f64 = 540.0;

/// One joint's runs and tolerances.
pub(super) struct Tier {
    pub(super) joint: usize,
    pub(super) nominal: Nominal,
    pub(super) runs: Vec<JointRun>,
    /// Group of each run: gaits that are fitted, by number.
    group: Vec<usize>,
    groups: usize,
    /// One over the tolerance of angle, torque, twist; 0 = not compared.
    weight: [f64; 3],
    /// Tolerance of the angle, rad.
    pub(super) tolerance_rad: f64,
    /// Repeats' spread of the angle, rad; NaN without repeats.
    pub(super) repeat_rad: f64,
    /// Torque is compared.
    pub(super) torque: bool,
    /// Torque comes from a current.
    pub(super) ampere: bool,
    /// The set-points are those that the driver applied.
    pub(super) applied: bool,
}

/// Rated figures of the two motors (paper, Table I): no-load speed at 12 V gives torque per current at the output.
pub(super) fn nm_per_a(k: usize) -> f64 {
    if INTER.contains(&k) {
        12.0 / 2.032
    } else {
        12.0 / 2.786
    }
}

pub(super) fn nominal(model: &Model, k: usize) -> Nominal {
    let [speed, torque, gain] = if INTER.contains(&k) {
        [Key::InterSpeed, Key::InterTorque, Key::InterGain]
    } else {
        [Key::IntraSpeed, Key::IntraTorque, Key::IntraGain]
    }
    .map(|key| model.value(key));
    Nominal {
        gain_per_s: gain,
        max_speed_rad_s: speed,
        max_torque_nm: torque,
        no_load_rad_s: f64::INFINITY,
        nm_per_a: nm_per_a(k),
    }
}

fn scaled(track: &Track, factor: f64) -> Track {
    Track {
        t_s: track.t_s.clone(),
        v: track.v.iter().map(|x| x * factor).collect(),
    }
}

/// Prepares one run of joint `k`.
pub(super) fn prepare(
    run: &Run,
    k: usize,
    conventions: &Conventions,
    nominal: &Nominal,
    load: &[f64],
) -> Option<JointRun> {
    let tracks = &run.joints[k];
    let sent = run.joints[conventions.order[k]].command.as_ref();
    // Applied set-points are known to a row only; they are taken where sent ones get lost or come unevenly.
    let applied = tracks.applied.as_ref();
    let command = if conventions.uneven[k] {
        applied.or(sent)?
    } else {
        sent.or(applied)?
    };
    let current = tracks.current.as_ref().map(|c| scaled(c, nominal.nm_per_a));
    let effort = tracks.effort.as_ref().or(current.as_ref());
    let position = tracks.position.as_ref()?;
    Some(JointRun::new(
        command,
        position,
        tracks.link.as_ref(),
        effort,
        load.to_vec(),
    ))
}

/// RMS difference of repeated runs over root two, rad; NaN without repeats.
fn repeat_spread(data: &Data, k: usize) -> f64 {
    let mut all = Vec::new();
    for (i, a) in data.runs.iter().enumerate() {
        let twin = data.runs[..i].iter().find(|b| b.repeat == a.repeat);
        let (Some(b), Some(x)) = (twin, a.joints[k].position.as_ref()) else {
            continue;
        };
        if let Some(y) = b.joints[k].position.as_ref() {
            let d: Vec<f64> = x.t_s.iter().zip(&x.v).map(|(t, v)| v - y.at(*t)).collect();
            all.push(math::rms(&d) / 2.0_f64.sqrt());
        }
    }
    if all.is_empty() {
        f64::NAN
    } else {
        math::median(&all)
    }
}

/// Fast noise from second differences.
fn noise(track: &Track) -> f64 {
    let d: Vec<f64> = track
        .v
        .windows(3)
        .map(|w| (w[0] - 2.0 * w[1] + w[2]).abs())
        .collect();
    math::median(&d) / (0.6745 * 6.0_f64.sqrt())
}

fn spread(v: &[f64]) -> f64 {
    let m = math::mean(v);
    math::rms(&v.iter().map(|x| x - m).collect::<Vec<_>>())
}

/// Runs that joint `k` is fitted on, the group of each, and the number of groups.
fn chosen(
    data: &Data,
    k: usize,
    fit: &[usize],
    conventions: &Conventions,
    nominal: &Nominal,
    loads: &[[Vec<f64>; JOINTS]],
) -> (Vec<JointRun>, Vec<usize>, usize) {
    let total: f64 = fit.iter().map(|r| data.runs[*r].length_s).sum();
    let thin = (total / FIT_S).ceil().max(1.0) as usize;
    let mut seen = vec![0usize; data.gaits.len()];
    let (mut runs, mut group) = (Vec::new(), Vec::new());
    let mut names: Vec<usize> = Vec::new();
    for r in fit {
        let run = &data.runs[*r];
        let first = seen[run.gait] == 0;
        seen[run.gait] += 1;
        // Every gait keeps its first run; of the repeats every `thin`-th.
        if !first && !seen[run.gait].is_multiple_of(thin + 1) {
            continue;
        }
        if let Some(j) = prepare(run, k, conventions, nominal, &loads[*r][k]) {
            let known = names.iter().position(|n| *n == run.gait);
            group.push(known.unwrap_or(names.len()));
            if known.is_none() {
                names.push(run.gait);
            }
            runs.push(j);
        }
    }
    (runs, group, names.len())
}

impl Tier {
    /// Joint `k` on the runs `fit`; `None` when nothing can be compared.
    pub(super) fn new(
        data: &Data,
        model: &Model,
        k: usize,
        fit: &[usize],
        conventions: &Conventions,
        loads: &[[Vec<f64>; JOINTS]],
    ) -> Option<Self> {
        let nominal = Nominal {
            no_load_rad_s: conventions.no_load_rad_s[k],
            ..nominal(model, k)
        };
        let (runs, group, groups) = chosen(data, k, fit, conventions, &nominal, loads);
        if runs.is_empty() {
            return None;
        }
        let position: Vec<f64> = runs
            .iter()
            .flat_map(|r| servo::values(&r.position))
            .collect();
        let fast: Vec<f64> = data
            .runs
            .iter()
            .filter_map(|r| r.joints[k].position.as_ref())
            .map(noise)
            .collect();
        let repeat_rad = repeat_spread(data, k);
        let floor = if repeat_rad.is_finite() {
            repeat_rad
        } else {
            0.0
        };
        let tolerance_rad = floor
            .max(math::median(&fast))
            .hypot(MODEL_ERROR * spread(&position))
            .max(LEAST_RAD);
        let torque: Vec<f64> = runs.iter().flat_map(|r| servo::values(&r.effort)).collect();
        let twist: Vec<f64> = runs.iter().flat_map(|r| servo::values(&r.twist)).collect();
        let weight = [
            1.0 / tolerance_rad,
            if torque.is_empty() {
                0.0
            } else {
                1.0 / (LOAD_ERROR * spread(&torque)).max(0.01)
            },
            if twist.is_empty() {
                0.0
            } else {
                1.0 / (2.0_f64.sqrt() * tolerance_rad)
            },
        ];
        Some(Self {
            joint: k,
            nominal,
            groups,
            group,
            runs,
            weight,
            tolerance_rad,
            repeat_rad,
            torque: !torque.is_empty(),
            ampere: !data.has(k, |j| j.effort.is_some()),
            applied: conventions.uneven[k] || !data.has(k, |j| j.command.is_some()),
        })
    }

    /// Tolerance of torques from what the calibrated nominal model leaves: replayed loads are as good as they are.
    fn weigh_torque(&mut self, theta: &[f64]) {
        let mut left = Vec::new();
        let mut trace = Trace::default();
        for run in &self.runs {
            servo::simulate(run, &self.nominal, theta, &mut trace);
            left.extend(servo::errors(&trace.effort, &run.effort).map(f64::abs));
        }
        if !left.is_empty() {
            // Four fifths of normal errors lie within 1.282 standard deviations.
            self.weight[1] = self.weight[1].min(1.282 / math::quantile(&left, 0.8).max(1e-3));
        }
    }

    /// Measured torque less the friction found, over the replayed load: ratio of their sizes; `None` without torque. Both hold errors of one
    /// size, so that neither regression is right and their ratio is (on null robots 0.95 to 1.05).
    pub(super) fn load_ratio(&self, theta: &[f64]) -> Option<f64> {
        let (mut yy, mut xx) = (0.0, 0.0);
        let mut trace = Trace::default();
        for run in &self.runs {
            servo::simulate(run, &self.nominal, theta, &mut trace);
            for (measured, simulated, load) in run.loads(&trace) {
                let friction = simulated - theta[J::Load as usize] * load;
                let y = measured * theta[J::PerAmpere as usize] - friction;
                yy += y * y;
                xx += load * load;
            }
        }
        (xx > 0.0).then(|| (yy / xx).sqrt())
    }

    /// Tolerance of torques, N m.
    pub(super) fn torque_tolerance_nm(&self) -> f64 {
        if self.weight[1] > 0.0 {
            1.0 / self.weight[1]
        } else {
            0.0
        }
    }
}

impl Evaluate for Tier {
    fn residuals(&self, theta: &[f64]) -> Vec<Vec<f64>> {
        let mut out = vec![Vec::new(); self.groups];
        let mut trace = Trace::default();
        let per_ampere = theta[J::PerAmpere as usize];
        for (run, g) in self.runs.iter().zip(&self.group) {
            servo::simulate(run, &self.nominal, theta, &mut trace);
            let group = &mut out[*g];
            group.extend(servo::errors(&trace.position, &run.position).map(|e| e * self.weight[0]));
            if self.weight[1] > 0.0 {
                let w = self.weight[1];
                let errors =
                    servo::errors(&trace.effort, &run.effort).zip(servo::values(&run.effort));
                // In units of the measured current times the nominal torque per ampere.
                group.extend(errors.map(|(e, m)| w * ((e + m) / per_ampere - m)));
            }
            if self.weight[2] > 0.0 {
                group.extend(servo::errors(&trace.twist, &run.twist).map(|e| e * self.weight[2]));
            }
        }
        out
    }
}

fn coordinate(neutral: f64, sigma: f64, step: f64, range: [f64; 2]) -> Coordinate {
    Coordinate {
        neutral,
        sigma,
        step,
        range,
    }
}

/// The coordinates of joint `k` with the tolerances of `model` as priors.
pub(super) fn coordinates(model: &Model, k: usize, applied: bool, ampere: bool) -> Vec<Coordinate> {
    let keys = if INTER.contains(&k) {
        [
            Key::InterGain,
            Key::InterSpeed,
            Key::InterTorque,
            Key::InterDamping,
        ]
    } else {
        [
            Key::IntraGain,
            Key::IntraSpeed,
            Key::IntraTorque,
            Key::IntraDamping,
        ]
    };
    let relative = |key: Key| {
        let p = model.parameter(key);
        (p.tolerance / p.value.max(1e-9)).clamp(1e-3, 1.0)
    };
    let damping = model.parameter(keys[3]);
    let timing = if applied { 3.0 * TIMING_S } else { TIMING_S };
    let mut out = vec![coordinate(0.0, 0.0, 0.01, [0.0, 100.0]); J::COUNT];
    let mut set = |j: J, c: Coordinate| out[j as usize] = c;
    let ratio = [0.02, 50.0];
    set(J::Gain, coordinate(1.0, relative(keys[0]), 0.02, ratio));
    set(J::MaxSpeed, coordinate(1.0, relative(keys[1]), 0.02, ratio));
    set(
        J::MaxTorque,
        coordinate(1.0, relative(keys[2]), 0.02, ratio),
    );
    set(
        J::Viscous,
        coordinate(
            damping.value,
            damping.tolerance.max(1e-3),
            0.02,
            [0.0, 50.0],
        ),
    );
    set(J::Droop, coordinate(0.0, DROOP, 0.004, [0.0, 2.0]));
    set(J::Delay, coordinate(0.0, timing, 0.002, [-0.05, 3.0]));
    set(J::Skew, coordinate(1.0, 0.0, 2e-4, [0.5, 2.0]));
    set(J::Scale, coordinate(1.0, 0.0, 0.005, [-200.0, 200.0]));
    set(J::Offset, coordinate(0.0, 0.0, 0.002, [-7.0, 7.0]));
    set(J::Quantum, coordinate(0.0, 0.0, 0.001, [0.0, 1.0]));
    set(J::DeadHard, coordinate(0.0, 0.0, 0.002, [0.0, 1.0]));
    set(J::DeadSoft, coordinate(0.0, 0.0, 0.001, [0.0, 1.0]));
    set(J::Slew, coordinate(0.0, 0.0, 0.02, [0.0, 100.0]));
    set(J::FeedbackDelay, coordinate(0.0, 0.0, 0.003, [0.0, 0.5]));
    set(J::Lag, coordinate(0.0, 0.0, 0.003, [0.0, 5.0]));
    set(J::Coulomb, coordinate(0.0, 0.0, 0.03, [0.0, 20.0]));
    set(J::Static, coordinate(0.0, 0.0, 0.03, [0.0, 20.0]));
    set(J::StribeckSpeed, coordinate(0.05, 0.0, 0.005, [0.002, 5.0]));
    set(J::LoadShare, coordinate(0.0, 0.0, 0.02, [0.0, 0.95]));
    set(J::Asymmetry, coordinate(0.0, 0.0, 0.03, [-20.0, 20.0]));
    set(
        J::AsymmetryViscous,
        coordinate(0.0, 0.0, 0.03, [-20.0, 20.0]),
    );
    set(J::Quadratic, coordinate(0.0, 0.0, 0.02, [0.0, 20.0]));
    set(J::RippleSin, coordinate(0.0, 0.0, 0.02, [-20.0, 20.0]));
    set(J::RippleCos, coordinate(0.0, 0.0, 0.02, [-20.0, 20.0]));
    set(J::RipplePeriods, coordinate(1.0, 0.0, 0.02, [0.2, 500.0]));
    // Several contacts share a load in more than one way, so a replayed load is a guess of its share.
    set(J::Load, coordinate(1.0, 0.3, 0.03, [-5.0, 20.0]));
    set(J::Play, coordinate(0.0, 0.0, 0.001, [0.0, 1.0]));
    set(J::Flex, coordinate(0.0, 0.0, 0.001, [0.0, 10.0]));
    // Motor constants of one type vary by some per cent; see `direct` for larger differences.
    set(
        J::PerAmpere,
        coordinate(1.0, if ampere { 0.03 } else { 0.0 }, 0.02, ratio),
    );
    out
}

fn grid(from: f64, ratio: f64, count: u32) -> Vec<f64> {
    (0..count)
        .map(|i| from * libm::pow(ratio, f64::from(i)))
        .collect()
}

fn one(effect: Effect, joint: usize, j: J, starts: &[f64]) -> Candidate {
    many(
        effect,
        joint,
        &[j],
        &starts.iter().map(|s| vec![*s]).collect::<Vec<_>>(),
    )
}

fn many(effect: Effect, joint: usize, free: &[J], starts: &[Vec<f64>]) -> Candidate {
    Candidate {
        effect,
        joint: Some(joint),
        free: free.iter().map(|j| *j as usize).collect(),
        starts: starts.to_vec(),
    }
}

/// Everything that may be added to joint `tier.joint`.
pub(super) fn candidates(tier: &Tier, conventions: &Conventions) -> Vec<Candidate> {
    let k = tier.joint;
    let n = tier.nominal;
    let slope = conventions.slope[k].unwrap_or(1.0);
    let offset = conventions.offset_rad[k];
    let speed = math::median(
        &tier
            .runs
            .iter()
            .map(JointRun::busy_rad_s)
            .collect::<Vec<_>>(),
    );
    let fraction = (speed / n.max_speed_rad_s).clamp(0.05, 1.0);
    let mut out = vec![
        one(Effect::JointScale, k, J::Scale, &[slope, 0.95, 1.05]),
        one(Effect::JointOffset, k, J::Offset, &[offset, 0.02, -0.02]),
        one(Effect::LoopGain, k, J::Gain, &[0.4, 0.7, 1.4, 2.5]),
        one(Effect::Deadband, k, J::DeadHard, &[0.01, 0.03, 0.08]),
        one(Effect::Deadband, k, J::DeadSoft, &[0.005, 0.02, 0.06]),
        one(
            Effect::VelocityLimit,
            k,
            J::MaxSpeed,
            &[0.9 * fraction, 0.7 * fraction, 0.4 * fraction, 1.5],
        ),
        one(
            Effect::VelocityLimit,
            k,
            J::Slew,
            &[0.9 * speed, 0.6 * speed, 0.3 * speed],
        ),
        one(
            Effect::FeedbackDelay,
            k,
            J::FeedbackDelay,
            &[0.02, 0.05, 0.1],
        ),
        one(Effect::MotorLag, k, J::Lag, &[0.02, 0.05, 0.15]),
        one(Effect::TorqueLimit, k, J::MaxTorque, &grid(0.06, 1.12, 24)),
        one(Effect::CurrentLimit, k, J::MaxTorque, &grid(0.06, 1.12, 24)),
        one(Effect::CoulombFriction, k, J::Coulomb, &[0.1, 0.4, 1.0]),
        one(Effect::ViscousFriction, k, J::Viscous, &[0.2, 0.6, 1.5]),
        one(Effect::LoadDependentFriction, k, J::LoadShare, &[0.1, 0.3]),
        one(Effect::QuadraticFriction, k, J::Quadratic, &[0.2, 1.0]),
        many(
            Effect::StribeckFriction,
            k,
            &[J::Static, J::StribeckSpeed],
            &[vec![0.3, 0.05], vec![0.3, 0.2], vec![0.8, 0.05]],
        ),
        many(
            Effect::AsymmetricFriction,
            k,
            &[J::Asymmetry, J::AsymmetryViscous, J::Coulomb],
            &[vec![0.3, 0.0, 0.15], vec![-0.3, 0.0, 0.15]],
        ),
    ];
    let mut ripple = Vec::new();
    for periods in [
        1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 24.0,
    ] {
        ripple.push(vec![0.15, 0.0, periods]);
        ripple.push(vec![0.0, 0.15, periods]);
    }
    let free = [J::RippleSin, J::RippleCos, J::RipplePeriods];
    out.push(many(Effect::TorqueRipple, k, &free, &ripple));
    if !tier.applied {
        out.push(one(Effect::Latency, k, J::Delay, &[0.01, 0.03, 0.08, 0.2]));
        out.push(one(
            Effect::ClockSkew,
            k,
            J::Skew,
            &[0.999, 1.001, 0.99, 1.01],
        ));
        // Steps of other sizes fall out of time after a few; 4 % apart one start is always near enough.
        out.push(one(
            Effect::Quantisation,
            k,
            J::Quantum,
            &grid(0.004, 1.04, 96),
        ));
    }
    if tier.weight[2] > 0.0 {
        out.push(one(Effect::Backlash, k, J::Play, &[0.005, 0.02]));
        out.push(one(Effect::Compliance, k, J::Flex, &[0.002, 0.01, 0.04]));
    }
    out
}

/// What was found about one joint.
pub(super) struct Found {
    pub(super) tier: Tier,
    pub(super) answer: Answer,
}

/// Thresholds of a joint: calibrated on null robots, see docs/diagnosis.md.
fn limits(tier: &Tier) -> Limits {
    let seconds: f64 = tier
        .runs
        .iter()
        .map(|r| r.steps() as f64 * servo::STEP_S)
        .sum();
    Limits {
        share: 0.12,
        least: 0.1,
        relative: 0.1,
        of_first: 0.01,
        floor: 1.0,
        // Errors of a servo are alike for about half a second.
        independent: (2.0 * seconds).clamp(10.0, 1000.0),
        most: 4,
        beyond: 3.0,
        refined: 6,
        iterations: 4,
    }
}

/// Diagnoses one joint.
pub(super) fn diagnose(
    mut tier: Tier,
    model: &Model,
    conventions: &Conventions,
    withhold: &[Effect],
) -> Found {
    let coordinates = coordinates(model, tier.joint, tier.applied, tier.torque && tier.ampere);
    let per_ampere = conventions.per_ampere[tier.joint];
    let mut candidates = candidates(&tier, conventions);
    candidates.retain(|c| !withhold.contains(&c.effect));
    let limits = limits(&tier);
    let mut nominal: Vec<f64> = coordinates.iter().map(|c| c.neutral).collect();
    let mut coordinates = coordinates;
    nominal[J::PerAmpere as usize] = per_ampere;
    coordinates[J::PerAmpere as usize].neutral = per_ampere;
    if conventions.slope[tier.joint].is_some_and(|s| s < 0.0) {
        nominal[J::Scale as usize] = -1.0;
        coordinates[J::Scale as usize].neutral = -1.0;
    }
    let base = {
        let search = Search {
            model: &tier,
            coordinates: &coordinates,
            candidates: &candidates,
            limits,
        };
        search.fit(&nominal, &[], 4)
    };
    tier.weigh_torque(&base.theta);
    let search = Search {
        model: &tier,
        coordinates: &coordinates,
        candidates: &candidates,
        limits,
    };
    let base = search.fit(&base.theta, &[], 3);
    let answer = search.answer(base, nominal);
    Found { answer, tier }
}
