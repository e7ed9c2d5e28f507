//! The link given the encoder: what lies between them, where a sensor of the link recorded it.

use crate::evidence::block::{Column, Raw, Segment, Site};
use crate::vocabulary::{Effect, Stage};

use super::super::data::Track;
use super::on;

/// Time between angles that are compared, s.
const STEP_S: f64 = 0.04;
/// What two sensors of one angle differ by from one instant to the next, rad: 1/16384 of a turn.
const LEAST_RAD: f64 = 4.0e-4;
/// Torque at which play has changed its side, N m: that of a half-sphere's weight on a lever of 2 cm.
const TURN_NM: f64 = 0.05;
/// Number of the shape of offset and ratio: those of the link's sensor, not of the set-points.
const LINK: usize = 101;
/// Periods of an eccentric gear per turn.
const PERIODS: usize = 8;

/// What one run of a joint holds.
pub(in crate::whole) struct Input<'a> {
    /// Encoder.
    pub(in crate::whole) position: &'a Track,
    /// Sensor of the link.
    pub(in crate::whole) link: &'a Track,
    /// Torque that the joint bears, N m, on a grid of `load_step_s`.
    pub(in crate::whole) load_nm: &'a [f64],
    /// Step of that grid, s.
    pub(in crate::whole) load_step_s: f64,
}

struct Row {
    t_s: f64,
    q: f64,
    load: f64,
}

fn columns() -> Vec<Column> {
    let mut out = vec![
        Column::linear(Effect::JointOffset, "offset_rad", 0.0, 0.1).shaped(LINK, &[]),
        Column::linear(Effect::JointScale, "ratio", 1.0, 0.1).shaped(LINK, &[]),
        Column::linear(Effect::Backlash, "half_width_rad", 0.0, 0.03)
            .shaped(LINK, &[])
            .at_least_neutral(),
        Column::linear(Effect::Compliance, "give_rad_nm", 0.0, 0.02)
            .shaped(LINK, &[])
            .at_least_neutral(),
        Column::open(LINK, 0.01),
    ];
    for n in 1..=PERIODS {
        for _ in 0..2 {
            out.push(Column::open(LINK + n, 0.02));
        }
    }
    for (i, c) in out.iter_mut().enumerate().skip(4) {
        c.parameter.key =
            ["drift_rad_s", "sine_rad", "cosine_rad"][if i == 4 { 0 } else { 1 + (i + 1) % 2 }];
    }
    out
}

fn entries(r: &Row) -> Vec<f64> {
    let mut out = vec![
        1.0,
        r.q,
        -r.load / libm::hypot(r.load, TURN_NM),
        -r.load,
        r.t_s,
    ];
    for n in 1..=PERIODS {
        let of = n as f64 * r.q;
        out.extend([libm::sin(of), libm::cos(of)]);
    }
    out
}

/// Instants of the rows of a run with this motion, s.
pub(in crate::whole) fn instants(position: &Track) -> Vec<f64> {
    let (from, end) = (position.t_s[0], position.t_s[position.t_s.len() - 1]);
    let n = ((end - from) / STEP_S).max(0.0) as usize;
    (0..n).map(|i| from + i as f64 * STEP_S).collect()
}

/// The block of joint `joint`; `None` without a run.
pub(in crate::whole) fn raw(joint: usize, inputs: &[Input<'_>]) -> Option<Raw> {
    let columns = columns();
    let mut segments = Vec::new();
    for input in inputs {
        let (q, all) = (input.position, instants(input.position));
        if all.is_empty() {
            continue;
        }
        let mut segment = Segment {
            x: vec![Vec::with_capacity(all.len()); columns.len()],
            weight: vec![1.0; all.len()],
            ..Segment::default()
        };
        for t_s in all {
            let row = Row {
                t_s,
                q: q.at(t_s),
                load: on(input.load_nm, input.load_step_s, t_s),
            };
            segment.y.push(input.link.at(t_s) - row.q);
            for (x, value) in segment.x.iter_mut().zip(entries(&row)) {
                x.push(value);
            }
        }
        segments.push(segment);
    }
    (!segments.is_empty()).then_some(Raw {
        site: Site {
            stage: Stage::Transmission,
            joint: Some(joint),
            blind: false,
            coarse: false,
        },
        columns,
        segments,
        floor: LEAST_RAD,
        noisy: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::found::{Named, named};
    use super::*;
    use crate::evidence::block::White;
    use crate::math::Rng;

    fn track(of: impl Fn(f64) -> f64) -> Track {
        let t_s: Vec<f64> = (0..1200).map(|i| 0.01 * f64::from(i)).collect();
        let v = t_s.iter().map(|t| of(*t)).collect();
        Track { t_s, v }
    }

    /// Effects named where the link is `off(q, load, t)` beside the encoder.
    fn found(off: impl Fn(f64, f64, f64) -> f64) -> Named {
        let mut rng = Rng::new(4);
        let q = |t: f64| 0.7 * crate::math::sin(1.9 * t);
        let load = |t: f64| 0.8 * crate::math::sin(1.9 * t + 0.7) + 0.2;
        let grid: Vec<f64> = (0..600).map(|i| load(0.02 * f64::from(i))).collect();
        let position = track(q);
        let mut link = track(|t| q(t) + off(q(t), load(t), t));
        link.v.iter_mut().for_each(|v| *v += 1e-3 * rng.normal());
        let input = Input {
            position: &position,
            link: &link,
            load_nm: &grid,
            load_step_s: 0.02,
        };
        let blocks = [White::new(raw(0, &[input]).expect("a run"), 6).plain()];
        named(&blocks).0
    }

    #[test]
    fn what_lies_between_encoder_and_link_is_named_with_its_size() {
        type Off = fn(f64, f64, f64) -> f64;
        let cases: [(&str, Off, Option<Effect>, f64); 5] = [
            (
                "play",
                |_, load, _| -0.02 * load.signum(),
                Some(Effect::Backlash),
                0.02,
            ),
            (
                "give",
                |_, load, _| -0.015 * load,
                Some(Effect::Compliance),
                0.015,
            ),
            ("zero", |_, _, _| 0.03, Some(Effect::JointOffset), 0.03),
            ("scale", |q, _, _| 0.05 * q, Some(Effect::JointScale), 1.05),
            ("drift", |_, _, t| 0.004 * t, None, 0.004),
        ];
        assert!(found(|_, _, _| 0.0).is_empty());
        for (what, off, effect, size) in cases {
            let found = found(off);
            assert_eq!(found.len(), 1, "{what}: {found:?}");
            assert_eq!(found[0].0, effect, "{what}: {found:?}");
            assert!((found[0].1 - size).abs() < 0.1 * size, "{what}: {found:?}");
        }
    }
}
