//! What may be wrong with a joint: its coordinates with their tolerances, and the effects with the values they start from.

use files::model::{Key, MOTORS, Model};

use super::conventions::Conventions;
use super::echo::Echo;
use super::joints::Tier;
use super::search::{Candidate, Coordinate};
use super::servo::{J, JointRun};
use crate::math;
use crate::vocabulary::Effect;

/// Speed lost per torque that a real drive may have without being called an effect, rad/s per N m (1 sigma). Table II's servo
/// has none; a drive with a speed loop of about 50 Hz on the reflected rotor loses 0.03.
const DROOP: f64 = 0.05;
/// Set-point timing that recordings leave open, s (1 sigma).
pub(super) const TIMING_S: f64 = 0.002;
/// Most periods per turn of a torque ripple that are tried: the slots of a motor act at the gear's ratio times as many, too fast for rows of
/// a recording.
const PERIODS: u32 = 24;

fn coordinate(neutral: f64, sigma: f64, step: f64, range: [f64; 2]) -> Coordinate {
    Coordinate {
        neutral,
        sigma,
        step,
        least: step,
        range,
    }
}

/// The coordinates of joint `k` with the tolerances of `model` as priors.
pub(super) fn coordinates(model: &Model, k: usize, applied: bool, ampere: bool) -> Vec<Coordinate> {
    let keys = MOTORS[k];
    let keys = [keys.gain, keys.speed, keys.torque, keys.damping];
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
    // An encoder whose zero runs away makes the loop lag by that rate over its gain: 40 mrad/s look like 5 mrad.
    set(J::Offset, coordinate(0.0, 0.0, 0.005, [-7.0, 7.0]));
    set(J::Quantum, coordinate(0.0, 0.0, 0.001, [0.0, 1.0]));
    set(J::DeadHard, coordinate(0.0, 0.0, 0.002, [0.0, 1.0]));
    set(J::DeadSoft, coordinate(0.0, 0.0, 0.001, [0.0, 1.0]));
    set(J::Slew, coordinate(0.0, 0.0, 0.02, [0.0, 100.0]));
    set(J::FeedbackDelay, coordinate(0.0, 0.0, 0.003, [0.0, 0.5]));
    set(J::Lag, coordinate(0.0, 0.0, 0.003, [0.0, 5.0]));
    set(J::Coulomb, coordinate(0.0, 0.0, 0.03, [0.0, 20.0]));
    set(J::Static, coordinate(0.0, 0.0, 0.03, [0.0, 20.0]));
    // A friction that falls above a third of what a gait of 50 degrees at 0.2 Hz reaches is Coulomb's there.
    set(
        J::StribeckSpeed,
        coordinate(0.05, 0.0, 0.005, [0.002, 0.35]),
    );
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
    set(J::Gravity, coordinate(0.0, 0.0, 0.05, [-3.0, 5.0]));
    set(J::Play, coordinate(0.0, 0.0, 0.001, [0.0, 1.0]));
    set(J::Flex, coordinate(0.0, 0.0, 0.001, [0.0, 10.0]));
    // Motor constants of one type vary by some per cent; see `direct` for larger differences.
    set(
        J::PerAmpere,
        coordinate(1.0, if ampere { 0.03 } else { 0.0 }, 0.02, ratio),
    );
    set(J::DerateShare, coordinate(0.0, 0.0, 0.02, [0.0, 0.95]));
    // What is warm before a run has begun is another torque constant, and so is what warms up sooner than a step of a gait takes.
    set(J::DerateSince, coordinate(0.0, 0.0, 0.3, [0.0, 3.0]));
    set(J::DerateTime, coordinate(5.0, 0.0, 0.5, [1.5, 100.0]));
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
    let slope = conventions.slope[k].unwrap_or(1.0);
    let offset = conventions.offset_rad[k];
    let typical = |of: fn(&JointRun) -> f64| {
        let all: Vec<f64> = tier.runs.iter().map(of).collect();
        math::median(&all)
    };
    let [speed, moved] = [JointRun::busy_rad_s, JointRun::moved_rad_s].map(typical);
    // A joint that lags behind is ever further off: no slope leads to its limit.
    let mut speeds = grid(0.04, 1.06, 56);
    speeds.push(1.5);
    // Up to the 4.8 N m of the stronger joints (Table II): few gaits ask a joint for half of that, and what one asks for no slope tells.
    let torques = grid(0.06, 1.12, 39);
    let mut out = vec![
        one(Effect::JointScale, k, J::Scale, &[slope, 0.95, 1.05]),
        one(Effect::JointOffset, k, J::Offset, &[offset, 0.02, -0.02]),
        one(Effect::LoopGain, k, J::Gain, &[0.4, 0.7, 1.4, 2.5]),
        one(
            Effect::Deadband,
            k,
            J::DeadHard,
            &[0.003, 0.006, 0.01, 0.03, 0.08],
        ),
        one(Effect::Deadband, k, J::DeadSoft, &[0.005, 0.02, 0.06]),
        one(Effect::VelocityLimit, k, J::MaxSpeed, &speeds),
        one(
            Effect::VelocityLimit,
            k,
            J::Slew,
            &[0.9 * speed, 0.6 * speed, 0.3 * speed, moved],
        ),
        one(
            Effect::FeedbackDelay,
            k,
            J::FeedbackDelay,
            &[0.01, 0.02, 0.05, 0.1],
        ),
        one(Effect::MotorLag, k, J::Lag, &[0.006, 0.02, 0.05, 0.15]),
        one(Effect::TorqueLimit, k, J::MaxTorque, &torques),
        one(Effect::CurrentLimit, k, J::MaxTorque, &torques),
        one(Effect::CoulombFriction, k, J::Coulomb, &[0.1, 0.4, 1.0]),
        one(Effect::ViscousFriction, k, J::Viscous, &[0.2, 0.6, 1.5]),
        // The servo's own damping is a torque per speed too; a robot at work does not tell the two apart.
        one(Effect::DampingGain, k, J::Viscous, &[0.2, 0.6, 1.5]),
        one(Effect::GravityLoad, k, J::Gravity, &[-0.5, 0.5]),
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
            &[J::Asymmetry, J::AsymmetryViscous],
            &[vec![0.3, 0.0], vec![-0.3, 0.0]],
        ),
    ];
    let mut ripple = Vec::new();
    for periods in (1..=PERIODS).map(f64::from) {
        ripple.push(vec![0.15, 0.0, periods]);
        ripple.push(vec![0.0, 0.15, periods]);
    }
    let free = [J::RippleSin, J::RippleCos, J::RipplePeriods];
    out.push(many(Effect::TorqueRipple, k, &free, &ripple));
    out.extend(transport(tier, &conventions.echo[k]));
    if tier.has_link() {
        out.push(one(Effect::Backlash, k, J::Play, &[0.005, 0.02]));
        out.push(one(Effect::Compliance, k, J::Flex, &[0.002, 0.01, 0.04]));
    }
    out
}

/// What is tried on joint `k` where nothing else is believed: with a time constant of its own it bends to much that is none.
pub(super) fn last_resort(k: usize) -> Candidate {
    many(
        Effect::ThermalDerating,
        k,
        &[J::DerateShare, J::DerateTime, J::DerateSince],
        &[
            vec![0.15, 4.0, 1.0],
            vec![0.4, 4.0, 1.0],
            vec![0.4, 15.0, 1.0],
        ],
    )
}

/// What may happen to set-points on their way, as far as their echo leaves it open.
fn transport(tier: &Tier, echo: &Echo) -> Vec<Candidate> {
    let k = tier.joint;
    let mut out = Vec::new();
    if tier.applied {
        return out;
    }
    match echo.late_s {
        None => out.push(one(Effect::Latency, k, J::Delay, &[0.01, 0.03, 0.08, 0.2])),
        Some([low, high]) if high > 0.0 => {
            out.push(one(Effect::Latency, k, J::Delay, &[0.5 * (low + high)]));
        }
        Some(_) => {}
    }
    if echo.skew == 1.0 {
        let starts = [0.999, 1.001, 0.99, 1.01];
        out.push(one(Effect::ClockSkew, k, J::Skew, &starts));
    }
    if echo.late_s.is_none() && echo.step_rad == 0.0 {
        // Steps of other sizes fall out of time after a few; 4 % apart one start is always near enough.
        let steps = grid(0.004, 1.04, 96);
        out.push(one(Effect::Quantisation, k, J::Quantum, &steps));
    }
    out
}
