//! The joint tier: each joint cut out by measured signals and fitted alone.

use files::model::Model;
use rayon::prelude::*;

use super::answer::REMAINDER;
use super::conventions::Conventions;
use super::data::{Data, JOINTS, Run, Track};
use super::joint_library::{TIMING_S, candidates, coordinates};
use super::last_word::{doubted, limited, rippled, unhurried, weakened, weightless};
use super::loads::{JOINTLY, Moments};
use super::nominal::{Nominal, nominal};
use super::open::Law;
use super::search::{Answer, Candidate, Coordinate, Evaluate, Fit, Given, Limits, Search};
use super::servo::{self, J, JointRun, Load, Trace};
use super::{open, regime};
use crate::math;
use crate::vocabulary::{Effect, Stage};

/// The same where an echo shows set-points in force at once: a tick of the driver.
const ECHO_S: f64 = 0.0007;
/// Largest error that two honest simulators of one servo may have, as a share of the angle's spread; see [`calibrate`].
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
    /// Largest tolerance of the torque, N m.
    most_nm: f64,
    /// Tolerance of the angle, rad.
    pub(super) tolerance_rad: f64,
    /// The part of it that no model has a share in, and the spread of the angle, rad.
    noise_rad: f64,
    spread_rad: f64,
    /// Repeats' spread of the angle, rad; NaN without repeats.
    pub(super) repeat_rad: f64,
    /// Torque is compared.
    pub(super) torque: bool,
    /// Torque comes from a current.
    pub(super) ampere: bool,
    /// The set-points are those that the driver applied.
    pub(super) applied: bool,
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
    load: &Load,
) -> Option<JointRun> {
    let tracks = &run.joints[k];
    let sent = run.joints[conventions.order[k]].command.as_ref();
    let applied = run.joints[conventions.echo_at[conventions.order[k]]]
        .applied
        .as_ref();
    let command = conventions.echo[k].command(sent, applied)?;
    let current = tracks.current.as_ref().map(|c| scaled(c, nominal.nm_per_a));
    let effort = tracks.effort.as_ref().or(current.as_ref());
    let position = tracks.position.as_ref()?;
    let out = JointRun::new(
        &command,
        position,
        tracks.link.as_ref(),
        effort,
        load.clone(),
    );
    let ampere = tracks.effort.is_none();
    Some(out.supplied(run.bus_v.as_ref()).by_current(ampere))
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

/// Error of the angle from set-points that are known to a row only, rad: uniform over the row, at a typical speed, and
/// smoothed over two set-points by the servo.
fn timing_rad(runs: &[JointRun], data: &Data, k: usize, conventions: &Conventions) -> f64 {
    let address = conventions.echo_at[conventions.order[k]];
    let rows = data
        .runs
        .iter()
        .filter_map(|r| r.joints[address].applied.as_ref());
    let Some(row_s) = rows
        .map(Track::period_s)
        .next()
        .filter(|_| conventions.echo[k].uneven)
    else {
        return 0.0;
    };
    let speeds: Vec<f64> = runs.iter().map(JointRun::busy_rad_s).collect();
    row_s / 12.0_f64.sqrt() * 0.5 * math::median(&speeds)
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
    loads: &[[Load; JOINTS]],
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
            let j = j.below(nominal.at_limit_nm());
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
        loads: &[[Load; JOINTS]],
    ) -> Option<Self> {
        let nominal = Nominal {
            winding_ohm: conventions.winding_ohm[k],
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
        // Second differences of few samples hold the motion too; repeats hold the noise alone.
        let floor = if repeat_rad.is_finite() {
            repeat_rad
        } else {
            math::median(&fast)
        };
        let noise_rad = libm::hypot(floor, timing_rad(&runs, data, k, conventions));
        let spread_rad = spread(&position);
        let tolerance_rad = libm::hypot(noise_rad, MODEL_ERROR * spread_rad).max(LEAST_RAD);
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
            most_nm: f64::INFINITY,
            tolerance_rad,
            noise_rad,
            spread_rad,
            repeat_rad,
            torque: !torque.is_empty(),
            ampere: !data.has(k, |j| j.effort.is_some()),
            applied: conventions.echo[k].uneven || !data.has(k, |j| j.command.is_some()),
        })
    }

    /// Standard deviations of what `theta` leaves of angle and torque, rad and N m, by the fifth of the samples that it leaves most of; no torque
    /// where none was measured.
    fn left(&self, theta: &[f64]) -> (f64, Option<f64>) {
        let (mut angles, mut torques) = (Vec::new(), Vec::new());
        let mut trace = Trace::default();
        for run in &self.runs {
            servo::simulate(run, &self.nominal, theta, &mut trace);
            angles.extend(servo::errors(&trace.position, &run.position).map(f64::abs));
            torques.extend(run.effort_errors(&trace, theta).map(f64::abs));
        }
        // Four fifths of normal errors lie within 1.282 standard deviations.
        let deviation = |v: &[f64]| math::quantile(v, 0.8) / 1.282;
        let torque = (!torques.is_empty()).then(|| deviation(&torques));
        (deviation(&angles), torque)
    }

    /// Tolerance of torques from what the calibrated nominal model leaves: replayed loads are as good as they are.
    fn weigh_torque(&mut self, theta: &[f64]) {
        if let (_, Some(nm)) = self.left(theta) {
            self.weight[1] = self.weight[1].min(1.0 / nm.clamp(1e-3, self.most_nm.max(1e-3)));
        }
    }

    /// Sums over the torque samples, of measured torques less the friction in `theta` and of replayed loads; `None` without torque. `bare`
    /// leaves out what follows speed and direction of motion, as a friction that is not found yet does.
    pub(super) fn moments(&self, theta: &[f64], bare: bool) -> Option<Moments> {
        let mut gram = [[0.0; 4]; 4];
        let mut trace = Trace::default();
        let mut count = 0;
        for run in &self.runs {
            servo::simulate(run, &self.nominal, theta, &mut trace);
            let loads = run.loads(&trace, theta).zip(run.left(&trace, theta, &[]));
            for ((measured, simulated, load), left) in loads {
                let friction = simulated - theta[J::Load as usize] * load;
                let torque = measured - friction;
                let row = [torque, load, left.speed_rad_s, left.direction()];
                for (sums, x) in gram.iter_mut().zip(row) {
                    sums.iter_mut().zip(row).for_each(|(s, y)| *s += x * y);
                }
                count += 1;
            }
        }
        (count > 0).then(|| Moments::new(&gram, bare))
    }

    /// Runs with the gait of each by number.
    pub(super) fn grouped(&self) -> impl Iterator<Item = (&JointRun, usize)> {
        self.runs.iter().zip(self.group.iter().copied())
    }

    /// Whether the link was measured.
    pub(super) fn has_link(&self) -> bool {
        self.weight[2] > 0.0
    }

    /// One over the tolerance of angle, torque or twist; 0 = not compared.
    pub(super) fn weight(&self, channel: usize) -> f64 {
        self.weight[channel]
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
        for (run, g) in self.runs.iter().zip(&self.group) {
            servo::simulate(run, &self.nominal, theta, &mut trace);
            let group = &mut out[*g];
            group.extend(servo::errors(&trace.position, &run.position).map(|e| e * self.weight[0]));
            if self.weight[1] > 0.0 {
                let errors = run.effort_errors(&trace, theta);
                group.extend(errors.map(|e| e * self.weight[1]));
            }
            if self.weight[2] > 0.0 {
                group.extend(servo::errors(&trace.twist, &run.twist).map(|e| e * self.weight[2]));
            }
        }
        out
    }
}

/// What was found about one joint.
pub(super) struct Found {
    pub(super) tier: Tier,
    pub(super) answer: Answer,
    /// What general features of the motion predict of what is left.
    pub(super) law: Law,
    /// How many times as much as those features the effects found leave; 0 without effects.
    pub(super) rival: f64,
    /// What is left follows a law that the library does not hold.
    pub(super) odd: bool,
    /// Stage in which what is left arose.
    pub(super) rest: Stage,
    /// Stage in which what the calibrated nominal model leaves arose.
    pub(super) gap: Stage,
    /// Set-points come late, and no effect may say so.
    pub(super) late: bool,
    /// The effects found bend to a law that they are not.
    pub(super) astray: bool,
    /// The scored runs have refuted an effect that took most of a plain gap away: it bent to a law that it is not.
    pub(super) refuted: bool,
    /// Regime that holds most of the gap.
    pub(super) regime: &'static str,
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
        of_first: 0.02,
        floor: 1.0,
        // Errors of a servo are alike for about half a second.
        independent: (2.0 * seconds).clamp(10.0, 1000.0),
        most: 4,
        beyond: 3.0,
        refined: 8,
        iterations: 8,
        remainder: REMAINDER,
        rough: false,
    }
}

/// Sets the tolerances from what the calibrated nominal model leaves: the share of a joint's motion, and the torque, that it leaves in most
/// joints is the error of the model; an effect sits in few.
pub(super) fn calibrate(tiers: &mut [Tier], model: &Model, conventions: &Conventions) {
    // Of six joints the third best: three may have an effect.
    const MOST: f64 = 0.4;
    // The error of one joint beside another's.
    const ROOM: f64 = 1.5;
    // Torques of six joints without a cause: 0.06 N m at the ends, 0.17 N m where the robot hinges (emulated robots); the fourth best is 0.09 N m.
    const MOST_NM: f64 = 0.6;
    const ROOM_NM: f64 = 2.5;
    let left = |tier: &Tier| {
        let (coordinates, nominal) = start(tier, model, conventions);
        let search = Search {
            model: tier,
            coordinates: &coordinates,
            candidates: &[],
            limits: limits(tier),
        };
        let base = search.fit(&nominal, &[], 4);
        let (angle_rad, torque_nm) = tier.left(&base.theta);
        (angle_rad / tier.spread_rad.max(1e-3), torque_nm)
    };
    let all: Vec<(f64, Option<f64>)> = tiers.par_iter().map(left).collect();
    let shares: Vec<f64> = all.iter().map(|l| l.0).collect();
    let torques: Vec<f64> = all.iter().filter_map(|l| l.1).collect();
    let share = ROOM * math::quantile(&shares, MOST);
    for tier in tiers {
        tier.tolerance_rad =
            libm::hypot(tier.noise_rad, share.min(MODEL_ERROR) * tier.spread_rad).max(LEAST_RAD);
        tier.weight[0] = 1.0 / tier.tolerance_rad;
        if tier.weight[2] > 0.0 {
            tier.weight[2] = 1.0 / (2.0_f64.sqrt() * tier.tolerance_rad);
        }
        if torques.len() >= JOINTLY {
            tier.most_nm = ROOM_NM * math::quantile(&torques, MOST_NM);
        }
    }
}

/// Least share of its strongest torques at which a motor may be limited: a torque constant may be off by 0.65 to 1.65 before it is read off.
const SHOWN: f64 = 0.6;

/// Coordinates of a joint and where they start.
fn start(tier: &Tier, model: &Model, conventions: &Conventions) -> (Vec<Coordinate>, Vec<f64>) {
    let mut coordinates = coordinates(model, tier.joint, tier.applied, tier.torque && tier.ampere);
    let per_ampere = conventions.per_ampere[tier.joint];
    coordinates[J::PerAmpere as usize].neutral = per_ampere;
    if conventions.echo[tier.joint]
        .late_s
        .is_some_and(|l| l[1] <= 0.0)
    {
        coordinates[J::Delay as usize].sigma = ECHO_S;
    }
    if let Some(nm) = JointRun::plateaus_nm(&tier.runs)[0].filter(|_| tier.torque) {
        // No limit lies below what the motor was seen to give.
        coordinates[J::MaxTorque as usize].range[0] = SHOWN * nm / tier.nominal.max_torque_nm;
    }
    if conventions.slope[tier.joint].is_some_and(|s| s < 0.0) {
        coordinates[J::Scale as usize].neutral = -1.0;
    }
    let nominal = coordinates.iter().map(|c| c.neutral).collect();
    (coordinates, nominal)
}

/// Moments of a nominal joint, bare of any friction.
pub(super) fn moments(tier: &Tier, model: &Model, conventions: &Conventions) -> Option<Moments> {
    let (_, nominal) = start(tier, model, conventions);
    tier.moments(&nominal, true)
}

/// What is known of the robot that a joint belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Around {
    /// Joints stood in another order.
    pub(super) mixed: bool,
    /// Links or their connector play or twist.
    pub(super) loose: bool,
}

/// Diagnoses one joint.
pub(super) fn diagnose(
    mut tier: Tier,
    model: &Model,
    conventions: &Conventions,
    withhold: &[Effect],
    around: Around,
) -> Found {
    let (coordinates, nominal) = start(&tier, model, conventions);
    let mut candidates = candidates(&tier, conventions);
    candidates.retain(|c| !withhold.contains(&c.effect));
    let limits = limits(&tier);
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
    let sure = late(&search, &base, conventions.echo[tier.joint].late_s);
    let given = Given::from(sure);
    let shown = given.shown();
    let mut answer = search.answer_with(base.clone(), nominal.clone(), given);
    answer = rippled(&search, &answer, &nominal, &shown).unwrap_or(answer);
    let derates = tier.torque && !withhold.contains(&Effect::ThermalDerating);
    if answer.last().members.is_empty() && derates {
        answer = weakened(&search, base, nominal).unwrap_or(answer);
    }
    while let Some((at, without)) = doubted(&answer, &coordinates, around.mixed)
        .or_else(|| unhurried(&answer))
        .or_else(|| weightless(&answer, around.loose))
    {
        answer.drop_member(at, without);
    }
    let mut found = Found {
        late: nameless_delay(&answer, conventions.echo[tier.joint].late_s),
        answer: limited(answer, &tier),
        tier,
        law: Law::default(),
        rival: 0.0,
        odd: false,
        rest: Stage::Driver,
        gap: Stage::Driver,
        astray: false,
        refuted: false,
        regime: "all",
    };
    found.look();
    found
}

impl Found {
    /// Looks at what the effects found leave.
    pub(super) fn look(&mut self) {
        let (tier, answer) = (&self.tier, &self.answer);
        let (base, last) = (&answer.steps[0].theta, &answer.last().theta);
        let named = !answer.last().members.is_empty();
        self.law = open::law(tier, last);
        self.rival = if named {
            open::rival(tier, base, last)
        } else {
            0.0
        };
        self.rest = regime::rest(tier, last);
        self.gap = regime::rest(tier, base);
        self.regime = regime::regime(tier, &answer.nominal, last, named);
        (self.odd, self.astray) = (false, false);
    }
}

/// The latency that the echo shows to a row, and the angle to a millisecond, with a delayed feedback beside it where the angle asks for one; `None` without
/// one.
fn late(search: &Search<'_, Tier>, base: &Fit, late_s: Option<[f64; 2]>) -> Option<Fit> {
    // A clock that is slightly off delays too, on average; a short delay lies within the tolerance of set-points, where a clock fits as well.
    const PLAINLY: f64 = 0.8;
    let [low, high] = late_s.filter(|l| l[1] > 0.0)?;
    let find = |effect| search.candidates.iter().position(|c| c.effect == effect);
    let c = find(Effect::Latency)?;
    let mut theta = base.theta.clone();
    theta[J::Delay as usize] = 0.5 * (low + high);
    let fit = search.fit(&theta, &[c], 6);
    let alone = |c: usize, theta: &[f64]| search.fit(theta, &[c], 6).cost;
    let clock = find(Effect::ClockSkew).map_or(f64::INFINITY, |c| alone(c, &base.theta));
    if clock >= PLAINLY * fit.cost && agreed([low, high], &fit) {
        return Some(fit);
    }
    let feedback = find(Effect::FeedbackDelay)?;
    theta[J::FeedbackDelay as usize] = 0.5 * (low + high);
    let both = search.fit(&theta, &[c, feedback], 8);
    theta.clone_from(&base.theta);
    theta[J::FeedbackDelay as usize] = both.theta[J::FeedbackDelay as usize];
    let without = search.fit(&theta, &[feedback], 6);
    // The echo has shown that there is a delay: the angle need only not speak against it.
    let needed = both.cost < PLAINLY * fit.cost.min(clock) && both.cost <= without.cost;
    (needed && agreed([low, high], &both)).then_some(both)
}

/// Whether the angle shows a delay between those that the echo shows: an echo that is itself a row old shows one that the angle does not.
fn agreed([low, high]: [f64; 2], fit: &Fit) -> bool {
    let delay = fit.theta[J::Delay as usize];
    let margin = 2.0 * TIMING_S;
    delay > 1.5 * TIMING_S && (low - margin..high + margin).contains(&delay)
}

/// Whether echo and angle show a delay where a latency may not be named.
fn nameless_delay(answer: &Answer, late_s: Option<[f64; 2]>) -> bool {
    let named = |c: &Candidate| c.effect == Effect::Latency;
    let shown = late_s.filter(|l| l[1] > 0.0);
    shown.is_some_and(|late_s| agreed(late_s, answer.last()))
        && !answer.candidates.iter().any(named)
}
