//! The base given the joints: poses of short windows, restarted from the measured state and led along the measured
//! angles.

use std::collections::BTreeMap;

use super::FREEDOM;
use crate::evidence::block::{Column, Meaning, Segment, Site, White};
use crate::vocabulary::{Effect, Stage};
use files::model::{Key, Model};
use rayon::prelude::*;

use super::super::body::{B, FLEX, NUMBERS, OFFSET, PLAY, RATIO, Tier, of_joint};
use super::super::body_library::coordinates;
use super::super::data::JOINTS;
use super::super::windows::Window;

/// Plays of each change, and the shares of its step that they take: the whole one and half of it show a bend. Of six
/// choices compared on development robots (emulator, seed 7; MuJoCo, seed 1) by how well true changes and errors
/// correlate; no calibration says so.
pub(in crate::whole) const PLAYS: usize = 2;
const SHARES: [f64; PLAYS] = [1.0, 0.5];

/// A column of the body: what is moved, from where the coefficient counts.
#[derive(Debug, Clone)]
pub(in crate::whole) struct Move {
    pub(in crate::whole) column: Column,
    /// Coordinates and their change per coefficient.
    pub(in crate::whole) along: Vec<(usize, f64)>,
    /// Coefficient over which the slope is taken.
    pub(in crate::whole) step: f64,
    /// Shares of it over which slopes are taken.
    pub(in crate::whole) shares: [f64; PLAYS],
    /// It moves the loads of the joints too.
    pub(in crate::whole) loads: bool,
}

impl Move {
    /// The same where the joints' loads follow.
    fn loading(self) -> Self {
        Self {
            loads: true,
            ..self
        }
    }

    /// The step to play where `at` of it is there already: back to where nothing is, if that is far enough.
    pub(in crate::whole) fn step_from(&self, at: f64) -> f64 {
        if at.abs() > 0.5 * self.step.abs() {
            -at
        } else {
            self.step
        }
    }

    /// The same the other way.
    fn downwards(self) -> Self {
        Self {
            step: -self.step,
            ..self
        }
    }

    /// The coefficient that comes nearest to a step from `nominal` to `theta`.
    pub(in crate::whole) fn coefficient(&self, theta: &[f64], nominal: &[f64]) -> f64 {
        let (mut xy, mut xx) = (0.0, 0.0);
        for (at, along) in &self.along {
            xy += along * (theta[*at] - nominal[*at]);
            xx += along * along;
        }
        xy / xx
    }

    /// Coordinates after a coefficient of `step`.
    pub(in crate::whole) fn from(&self, theta: &[f64], step: f64) -> Vec<f64> {
        let mut out = theta.to_vec();
        for (at, by) in &self.along {
            out[*at] += by * step;
        }
        out
    }
}

/// A slope over the size that an effect has where it is there. Two plays of one window differ by when a foot lands,
/// whatever the step is: over a small one nothing else would show.
fn slope(column: Column, at: usize) -> Move {
    Move {
        step: column.prior[1],
        column,
        along: vec![(at, 1.0)],
        shares: SHARES,
        loads: false,
    }
}

/// The same of a map from links to readings: effects say what a link does to a number on the wire, the other way round.
fn reading(column: Column, at: usize) -> Move {
    let slope = slope(column, at);
    Move {
        along: vec![(at, -1.0)],
        ..slope.downwards()
    }
}

fn whole(column: Column, along: Vec<(usize, f64)>) -> Move {
    Move {
        column,
        along,
        step: 1.0,
        shares: [1.0; PLAYS],
        loads: false,
    }
}

/// Everything that the body may have, with what its model leaves open as slack.
pub(in crate::whole) fn moves(model: &Model, link_measured: bool) -> Vec<Move> {
    let start = coordinates(model);
    let sigma = |b: B| start[b as usize].sigma;
    let b = |b: B| b as usize;
    let mu = model.value(Key::Friction);
    let mut out = Vec::new();
    // Loads and base have the same friction of the ground, within its tolerance too. Masses and their centre act on loads by
    // what the whole robot weighs: there each block keeps what the model leaves open.
    let mut friction = Column::linear(Effect::GroundFriction, "coefficient", mu, 0.4)
        .with_shared_slack("", sigma(B::Friction));
    friction.parameter.scale = mu;
    // Downwards: a ground that holds well holds no better with more friction.
    out.push(slope(friction, b(B::Friction)).downwards().loading());
    let bounce = model.value(Key::Bounce);
    out.push(slope(
        Column::linear(Effect::Restitution, "coefficient", bounce, 0.3)
            .with_slack(sigma(B::Bounce)),
        b(B::Bounce),
    ));
    out.push(slope(Column::nuisance(sigma(B::Erp).max(0.05)), b(B::Erp)));
    out.push(slope(
        Column::nuisance(sigma(B::Gradient).max(0.01)),
        b(B::Gradient),
    ));
    for (shape, [cos, sin]) in [
        [B::AnisotropyCos, B::AnisotropySin],
        [B::AnisotropyLessCos, B::AnisotropyLessSin],
    ]
    .into_iter()
    .enumerate()
    {
        for (key, at) in [("log_cosine", cos), ("log_sine", sin)] {
            let column = Column::linear(Effect::FrictionAnisotropy, key, 0.0, 0.7);
            let column = column.shaped(shape, &[("less", shape as f64)]);
            out.push(slope(column, b(at)).loading());
        }
    }
    for (shape, m) in [0.004, 0.01, 0.03].into_iter().enumerate() {
        let column = Column::played(Effect::TorsionalFriction, "coefficient_m", 0.0, m, shape);
        out.push(whole(column, vec![(b(B::Torsion), m)]).loading());
    }
    for (key, at) in [("roll_rad", B::Roll), ("pitch_rad", B::Pitch)] {
        // Three degrees.
        let column = Column::linear(Effect::GroundSlope, key, 0.0, 0.05);
        out.push(slope(column, b(at)).loading());
    }
    for (shape, (give, damping)) in [(1e-4, 50.0), (5e-4, 50.0), (2e-3, 30.0)]
        .into_iter()
        .enumerate()
    {
        let fixed = [("damping_n_s_m", damping)];
        out.push(whole(
            Column::played(Effect::GroundCompliance, "give_m_n", 0.0, give, shape)
                .shaped(shape, &fixed),
            vec![
                (b(B::GroundGive), give),
                (b(B::GroundDamping), damping - 50.0),
            ],
        ));
    }
    for (key, at) in [("x_m", B::ComX), ("y_m", B::ComY), ("z_m", B::ComZ)] {
        let column = Column::linear(Effect::ComOffset, key, 0.0, 0.02).with_slack(sigma(at));
        out.push(slope(column, b(at)).loading());
    }
    let half = model.parameter(Key::Mass1);
    for body in 0..7 {
        let column = Column::linear(Effect::Mass, "added_kg", 0.0, 0.3)
            .with_slack(half.tolerance)
            .shaped(10 + body, &[("body", body as f64)]);
        out.push(slope(column, b(B::Heavy) + body).loading());
    }
    connector(&mut out);
    joints(&mut out, link_measured);
    out
}

fn connector(out: &mut Vec<Move>) {
    for (shape, give) in [0.004, 0.012, 0.04, 0.12].into_iter().enumerate() {
        out.push(whole(
            Column::played(Effect::ConnectorCompliance, "give_rad_nm", 0.0, give, shape),
            vec![(B::ConnectorGive as usize, give)],
        ));
    }
    for (shape, play) in [0.01, 0.03, 0.09].into_iter().enumerate() {
        out.push(whole(
            Column::played(Effect::ConnectorPlay, "half_width_rad", 0.0, play, shape),
            vec![(B::ConnectorPlay as usize, play)],
        ));
    }
}

/// Conventions and transmissions that only the body shows.
fn joints(out: &mut Vec<Move>, link_measured: bool) {
    for k in 0..JOINTS {
        let offset = Column::linear(Effect::JointOffset, "offset_rad", 0.0, 0.1).shaped(100, &[]);
        out.push(reading(offset.of_joint(k), of_joint(k, OFFSET)));
        let ratio = Column::linear(Effect::JointScale, "ratio", 1.0, 0.1).shaped(100, &[]);
        out.push(reading(ratio.of_joint(k), of_joint(k, RATIO)));
        if link_measured {
            continue;
        }
        for (shape, play) in [0.006, 0.015, 0.035, 0.08].into_iter().enumerate() {
            let column = Column::played(Effect::Backlash, "half_width_rad", 0.0, play, shape);
            out.push(whole(column.of_joint(k), vec![(of_joint(k, PLAY), play)]));
        }
        for (shape, flex) in [0.01, 0.04].into_iter().enumerate() {
            let column = Column::played(Effect::Compliance, "give_rad_nm", 0.0, flex, shape);
            out.push(whole(column.of_joint(k), vec![(of_joint(k, FLEX), flex)]));
        }
    }
}

/// Shapes that no effect has: what a move changes and another one late in a run than early, by the number of the move. Of
/// the ground's friction, and of the zero of each joint.
fn drifting(moves: &[Move]) -> Vec<(usize, Column)> {
    let of = |(m, own): (usize, &Move)| {
        let shape = match own.column.meaning {
            Meaning::Effect(Effect::GroundFriction) => 0,
            Meaning::Effect(Effect::JointOffset) => 1,
            _ => return None,
        };
        let mut column = Column::open(DRIFTING + shape, own.column.prior[1]);
        (column.owner, column.parameter.key) = (own.column.owner, "drift");
        Some((m, column))
    };
    moves.iter().enumerate().filter_map(of).collect()
}

/// Number of the first shape that drifts.
const DRIFTING: usize = 310;

/// How late in its run each window begins: from -1/2 to 1/2.
fn late(tier: &Tier) -> Vec<f64> {
    let mut last_s: BTreeMap<usize, f64> = BTreeMap::new();
    for w in &tier.windows {
        let last = last_s.entry(w.run).or_default();
        *last = last.max(w.from_s);
    }
    let one = |w: &Window| w.from_s / last_s[&w.run].max(f64::MIN_POSITIVE) - 0.5;
    tier.windows.iter().map(one).collect()
}

/// Coordinates at the coefficients `start` of the `moves`.
pub(in crate::whole) fn placed(
    moves: &[Move],
    neutral: &[f64],
    start: &[(usize, f64)],
) -> Vec<f64> {
    let mut out = neutral.to_vec();
    for (m, by) in start {
        for (at, along) in &moves[*m].along {
            out[*at] += along * by;
        }
    }
    out
}

/// Change of the errors per coefficient, by window: what two plays, each with its slope, have alike. The rest comes from
/// feet that land earlier or later and from bends; a window in which that is all counts for nothing (James and Stein
/// 1961).
fn change([first, second]: &[Vec<[f64; NUMBERS]>; PLAYS]) -> Vec<[f64; NUMBERS]> {
    let window = |(a, b): (&[f64; NUMBERS], &[f64; NUMBERS])| {
        let mean: [f64; NUMBERS] = std::array::from_fn(|i| 0.5 * (a[i] + b[i]));
        let square: f64 = mean.iter().map(|x| x * x).sum();
        let error: f64 = a.iter().zip(b).map(|(a, b)| 0.25 * (a - b).powi(2)).sum();
        let share = (1.0 - error / square.max(f64::MIN_POSITIVE)).max(0.0);
        mean.map(|x| share * x)
    };
    first.iter().zip(second).map(window).collect()
}

/// The block of the base around `theta`, where the moves have the coefficients `start`; these count from the neutral
/// values.
pub(in crate::whole) fn block(
    tier: &Tier,
    moves: &[Move],
    theta: &[f64],
    start: &[(usize, f64)],
) -> White {
    let here = tier.whitened(theta);
    let roots: Vec<f64> = here
        .iter()
        .map(|e| {
            let square: f64 = e.iter().map(|x| x * x).sum();
            ((FREEDOM + NUMBERS as f64) / (FREEDOM + square))
                .min(1.0)
                .sqrt()
        })
        .collect();
    let flat = |windows: &[[f64; NUMBERS]]| -> Vec<f64> {
        windows
            .iter()
            .zip(&roots)
            .flat_map(|(e, root)| e.iter().map(move |x| root * x))
            .collect()
    };
    let y0 = flat(&here);
    let beside: [Vec<[f64; NUMBERS]>; PLAYS] =
        std::array::from_fn(|side| tier.started_elsewhere(theta, side));
    let x: Vec<Vec<f64>> = moves
        .par_iter()
        .enumerate()
        .map(|(i, m)| {
            // What is there already is taken away, so that the errors with and without it are as they are played.
            let within = start.iter().find(|x| x.0 == i);
            let step = m.step_from(within.map_or(0.0, |x| x.1));
            let slopes = |side: usize| {
                let by = step * m.shares[side];
                let there = tier.started_elsewhere(&m.from(theta, by), side);
                let slope = |(a, b): (&[f64; NUMBERS], &[f64; NUMBERS])| {
                    std::array::from_fn(|i| (b[i] - a[i]) / by)
                };
                beside[side].iter().zip(&there).map(slope).collect()
            };
            flat(&change(&std::array::from_fn(slopes)))
        })
        .collect();
    let drifting = drifting(moves);
    let late = late(tier);
    let along = |(m, _): &(usize, Column)| -> Vec<f64> {
        let rows = x[*m].chunks(NUMBERS).zip(&late);
        rows.flat_map(|(x, late)| x.iter().map(move |x| late * x))
            .collect()
    };
    let drifts: Vec<Vec<f64>> = drifting.iter().map(along).collect();
    // Residuals are simulated less measured.
    let mut y: Vec<f64> = y0.iter().map(|r| -r).collect();
    for (m, by) in start {
        y.iter_mut().zip(&x[*m]).for_each(|(y, x)| *y += by * x);
    }
    let rows = y.len();
    let before = (y0.iter().map(|r| r * r).sum::<f64>() / rows.max(1) as f64).sqrt();
    let segment = Segment {
        weight: vec![1.0; rows],
        y,
        x: x.into_iter().chain(drifts).collect(),
    };
    let site = Site {
        stage: Stage::Body,
        joint: None,
        blind: false,
        coarse: false,
    };
    let own = moves.iter().map(|m| m.column.clone());
    let columns = own.chain(drifting.into_iter().map(|d| d.1)).collect();
    White::whitened(site, columns, &[segment], [1.0, before])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `set-point = ratio * command + offset`, of what is read back as of what is sent.
    #[test]
    fn a_scale_and_a_zero_move_the_link_as_their_effects_say() {
        let model = Model::hand_tuned();
        let neutral: Vec<f64> = coordinates(&model).iter().map(|c| c.neutral).collect();
        for (effect, by, at_reading, expected) in [
            (Effect::JointScale, 0.05, 0.8, 0.8 * 1.05),
            (Effect::JointOffset, 0.03, 0.8, 0.8 + 0.03),
        ] {
            let moves = moves(&model, true);
            let of = |m: &&Move| m.column.meaning == Meaning::Effect(effect);
            let first = moves.iter().find(of).expect("one for each joint");
            let theta = first.from(&neutral, by);
            let link = (at_reading - theta[of_joint(0, OFFSET)]) / theta[of_joint(0, RATIO)];
            assert!((link - expected).abs() < 0.003, "{effect:?}: {link}");
        }
    }

    #[test]
    fn a_window_counts_by_what_two_plays_have_alike() {
        let flat = |v: f64| [v; NUMBERS];
        let mut one_sided = flat(0.0);
        one_sided[3] = 8.0;
        let first = vec![flat(2.0), one_sided, flat(2.0)];
        let second = vec![flat(2.0), flat(0.0), flat(1.0)];
        let both = change(&[first, second]);
        assert_eq!(both[0], flat(2.0), "alike");
        assert_eq!(both[1], flat(0.0), "a fall in one of them");
        // Mean 1.5 with an error of 0.5: eight ninths.
        assert!(both[2].iter().all(|x| (x - 1.5 * 8.0 / 9.0).abs() < 1e-12));
    }
}
