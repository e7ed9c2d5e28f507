//! Coordinates and candidates of the body tier.

use files::model::{Key, Model};

use super::body::{B, BODY, FLEX, OFFSET, PLAY, RATIO, of_joint};
use super::data::JOINTS;
use super::search::{Candidate, Coordinate};
use crate::vocabulary::Effect;

/// Shift of a body's centre of mass within the tolerances of `model`, m: its two half-spheres lie half an edge away from the middle.
fn shift_m(model: &Model) -> f64 {
    let mass = model.parameter(Key::Mass1);
    0.5 * model.value(Key::Cube) * mass.tolerance / mass.value / 2.0_f64.sqrt()
}

/// Shift of body 3 that moves the robot's centre of mass as all half-spheres together do within the tolerances of `model`, m along each
/// axis. There are eight, 1.12 edges from the middle, as root mean square of the stretched chain. Body 3 is a quarter of the robot.
pub(super) fn apart_m(model: &Model) -> f64 {
    let mass = model.parameter(Key::Mass1);
    let all = mass.tolerance / mass.value / 8.0_f64.sqrt();
    4.0 * all * 1.12 * model.value(Key::Cube) / 3.0_f64.sqrt()
}

/// Share of a step that counts as an effect of the body, whose cost is rough and whose steps are wide. Small effects of robots are four
/// tenths of them at least, a spring that two windows asked for was less than a tenth.
const WIDE: f64 = 0.2;
/// The same of a torsional friction: windows beside another ground or another order of joints ask for one of 1.8 to 3 mm (three emulated robots without one).
const TORSION_M: f64 = 0.003;
/// The same of a connector's twist, rad/(N m): windows of seventeen gaits ask for one of 460 to 540 N m/rad (three emulated robots without one); the
/// stiffest that was planted has 100 N m/rad.
const TWIST_RAD_NM: f64 = 0.004;

/// The coordinates of the body with the tolerances of `model` as priors.
pub(super) fn coordinates(model: &Model) -> Vec<Coordinate> {
    let tolerance = |k: Key| model.parameter(k).tolerance;
    let c = |neutral: f64, sigma: f64, step: f64, range: [f64; 2]| Coordinate {
        neutral,
        sigma,
        step,
        least: WIDE * step,
        range,
    };
    let mu = model.value(Key::Friction);
    let mut out = vec![c(0.0, 0.0, 0.01, [0.0, 1.0]); BODY + 4 * JOINTS];
    let mut set = |b: B, x: Coordinate| out[b as usize] = x;
    set(
        B::Friction,
        c(
            1.0,
            tolerance(Key::Friction) / mu.max(1e-6),
            0.1,
            [0.01, 10.0],
        ),
    );
    set(
        B::Bounce,
        c(
            model.value(Key::Bounce),
            tolerance(Key::Bounce),
            0.1,
            [0.0, 1.0],
        ),
    );
    set(
        B::Erp,
        c(
            model.value(Key::Erp),
            tolerance(Key::Erp),
            0.05,
            [0.01, 1.0],
        ),
    );
    let mass = model.parameter(Key::Mass1);
    set(
        B::Gradient,
        c(0.0, 0.7 * mass.tolerance / mass.value, 0.05, [-0.9, 0.9]),
    );
    set(B::AnisotropyCos, c(0.0, 0.0, 0.1, [-4.0, 4.0]));
    set(B::AnisotropySin, c(0.0, 0.0, 0.1, [-4.0, 4.0]));
    set(B::AnisotropyLessCos, c(0.0, 0.0, 0.1, [-4.0, 4.0]));
    set(B::AnisotropyLessSin, c(0.0, 0.0, 0.1, [-4.0, 4.0]));
    let torsion = c(0.0, 0.0, 0.003, [0.0, 1.0]);
    set(
        B::Torsion,
        Coordinate {
            least: TORSION_M,
            ..torsion
        },
    );
    set(B::Roll, c(0.0, 0.0, 0.01, [-1.0, 1.0]));
    set(B::Pitch, c(0.0, 0.0, 0.01, [-1.0, 1.0]));
    set(B::GroundGive, c(0.0, 0.0, 3e-5, [0.0, 0.1]));
    set(B::GroundDamping, c(50.0, 0.0, 20.0, [1.0, 1e5]));
    let shift = shift_m(model);
    for b in [B::ComX, B::ComY, B::ComZ] {
        set(b, c(0.0, shift, 0.005, [-0.3, 0.3]));
    }
    let twist = c(0.0, 0.0, 0.005, [0.0, 1.0]);
    set(
        B::ConnectorGive,
        Coordinate {
            least: TWIST_RAD_NM,
            ..twist
        },
    );
    set(B::ConnectorPlay, c(0.0, 0.0, 0.005, [0.0, 0.5]));
    for body in 0..7 {
        out[B::Heavy as usize + body] = c(0.0, 0.0, 0.05, [-0.3, 20.0]);
    }
    for k in 0..JOINTS {
        out[of_joint(k, OFFSET)] = c(0.0, 0.0, 0.01, [-7.0, 7.0]);
        out[of_joint(k, RATIO)] = c(1.0, 0.0, 0.02, [-100.0, 100.0]);
        out[of_joint(k, PLAY)] = c(0.0, 0.0, 0.01, [0.0, 1.0]);
        out[of_joint(k, FLEX)] = c(0.0, 0.0, 0.01, [0.0, 10.0]);
    }
    out
}

fn candidate(effect: Effect, joint: Option<usize>, free: &[usize], starts: &[&[f64]]) -> Candidate {
    Candidate {
        effect,
        joint,
        free: free.to_vec(),
        starts: starts.iter().map(|s| s.to_vec()).collect(),
    }
}

/// Logarithms of an anisotropy, cosine and sine part: eight directions.
const AROUND: [&[f64]; 8] = [
    &[0.5, 0.0],
    &[0.35, 0.35],
    &[0.0, 0.5],
    &[-0.35, 0.35],
    &[-0.5, 0.0],
    &[-0.35, -0.35],
    &[0.0, -0.5],
    &[0.35, -0.35],
];

/// Everything that may be added to the body.
pub(super) fn candidates(link_measured: bool) -> Vec<Candidate> {
    let b = |b: B| b as usize;
    let give = [b(B::GroundGive), b(B::GroundDamping)];
    let turn = [b(B::AnisotropyCos), b(B::AnisotropySin)];
    let less = [b(B::AnisotropyLessCos), b(B::AnisotropyLessSin)];
    let com = [b(B::ComX), b(B::ComY), b(B::ComZ)];
    let mut out = vec![
        candidate(
            Effect::GroundFriction,
            None,
            &[b(B::Friction)],
            &[&[0.3], &[0.6], &[0.8], &[1.3], &[1.8]],
        ),
        candidate(
            Effect::Restitution,
            None,
            &[b(B::Bounce)],
            &[&[0.05], &[0.9]],
        ),
        candidate(Effect::FrictionAnisotropy, None, &turn, &AROUND),
        candidate(Effect::FrictionAnisotropy, None, &less, &AROUND),
        candidate(
            Effect::TorsionalFriction,
            None,
            &[b(B::Torsion)],
            &[&[0.005], &[0.02]],
        ),
        candidate(
            Effect::GroundSlope,
            None,
            &[b(B::Roll), b(B::Pitch)],
            &[
                &[0.01, 0.01],
                &[-0.05, 0.05],
                &[0.08, 0.0],
                &[-0.08, 0.0],
                &[0.0, 0.08],
                &[0.0, -0.08],
            ],
        ),
        candidate(
            Effect::GroundCompliance,
            None,
            &give,
            &[&[1e-4, 50.0], &[5e-4, 50.0], &[2e-3, 30.0]],
        ),
        candidate(
            Effect::ComOffset,
            None,
            &com,
            &[
                &[0.01, 0.0, 0.0],
                &[-0.01, 0.0, 0.0],
                &[0.0, 0.01, 0.0],
                &[0.0, -0.01, 0.0],
                &[0.0, 0.0, 0.01],
                &[0.0, 0.0, -0.01],
                &[0.04, 0.0, 0.0],
                &[-0.04, 0.0, 0.0],
                &[0.0, 0.04, 0.0],
                &[0.0, -0.04, 0.0],
                &[0.0, 0.0, 0.04],
                &[0.0, 0.0, -0.04],
            ],
        ),
        candidate(
            Effect::ConnectorCompliance,
            None,
            &[b(B::ConnectorGive)],
            &[&[0.01], &[0.05], &[0.15]],
        ),
        candidate(
            Effect::ConnectorPlay,
            None,
            &[b(B::ConnectorPlay)],
            &[&[0.01], &[0.04], &[0.12]],
        ),
    ];
    joints(link_measured, &mut out);
    out
}

/// Starts of large offsets and scales: they show as windows that do not fit at all.
pub(super) fn widen(candidates: &mut [Candidate]) {
    for c in candidates {
        let far: &[f64] = match c.effect {
            Effect::JointOffset => &[0.15, -0.15, 0.4, -0.4],
            Effect::JointScale => &[0.8, 1.25],
            _ => &[],
        };
        c.starts.extend(far.iter().map(|x| vec![*x]));
    }
}

/// Conventions and transmissions that only the body shows.
fn joints(link_measured: bool, out: &mut Vec<Candidate>) {
    for k in 0..JOINTS {
        let j = |what: usize| [of_joint(k, what)];
        out.push(candidate(
            Effect::JointOffset,
            Some(k),
            &j(OFFSET),
            &[&[0.04], &[-0.04]],
        ));
        out.push(candidate(
            Effect::JointScale,
            Some(k),
            &j(RATIO),
            &[&[0.93], &[1.07]],
        ));
        if !link_measured {
            out.push(candidate(
                Effect::Backlash,
                Some(k),
                &j(PLAY),
                &[&[0.02], &[0.06]],
            ));
            out.push(candidate(
                Effect::Compliance,
                Some(k),
                &j(FLEX),
                &[&[0.02], &[0.1]],
            ));
        }
    }
}
