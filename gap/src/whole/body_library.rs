//! Coordinates of the body tier.

use files::model::{Key, Model};

use super::body::{B, BODY, FLEX, OFFSET, PLAY, RATIO, of_joint};
use super::data::JOINTS;
use super::fit::Coordinate;

/// Shift of a body's centre of mass within the tolerances of `model`, m: its two half-spheres lie half an edge away from the middle.
fn shift_m(model: &Model) -> f64 {
    let mass = model.parameter(Key::Mass1);
    0.5 * model.value(Key::Cube) * mass.tolerance / mass.value / 2.0_f64.sqrt()
}

/// The coordinates of the body with the tolerances of `model` as priors.
pub(super) fn coordinates(model: &Model) -> Vec<Coordinate> {
    let tolerance = |k: Key| model.parameter(k).tolerance;
    let c = |neutral: f64, sigma: f64, step: f64, range: [f64; 2]| Coordinate {
        neutral,
        sigma,
        step,
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
    set(B::Torsion, c(0.0, 0.0, 0.003, [0.0, 1.0]));
    set(B::Roll, c(0.0, 0.0, 0.01, [-1.0, 1.0]));
    set(B::Pitch, c(0.0, 0.0, 0.01, [-1.0, 1.0]));
    set(B::GroundGive, c(0.0, 0.0, 3e-5, [0.0, 0.1]));
    set(B::GroundDamping, c(50.0, 0.0, 20.0, [1.0, 1e5]));
    let shift = shift_m(model);
    for b in [B::ComX, B::ComY, B::ComZ] {
        set(b, c(0.0, shift, 0.005, [-0.3, 0.3]));
    }
    set(B::ConnectorGive, c(0.0, 0.0, 0.005, [0.0, 1.0]));
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
