//! The encoder given the set-points: the angle less that of the nominal servo, which is stable and forgets its
//! start in 0.3 s.
//!
//! What is measured of the joint stands on one side only. With the measured angle in the loop its noise would be a
//! regressor, and a late encoder would explain the noise (seen: 100 times the evidence of any planted cause).

mod lost;
mod played;
mod servo;
mod shapes;

use crate::evidence::block::{Column, Raw, Segment, Site};
use crate::vocabulary::{Effect, Stage};

use super::super::data::Track;
use super::super::nominal::Nominal;
use lost::Lost;
pub(in crate::whole) use played::{Played, errors_rad};
use servo::Grid;
pub(in crate::whole) use servo::Law;
use shapes::{Change, Shape, shape};

/// What two simulators of one servo differ by from one angle to the next: rad, and share of the angle's spread. The
/// old servo of the diagnosis and the emulated driver of `hil-sim`, both at their own steps, differ by 0.2 mrad on
/// 0.8 rad.
const LEAST_RAD: f64 = 1.0e-4;
const SHARE: f64 = 5.0e-4;

/// Steps of coarse set-points that are played, rad: 4 % apart, because steps of another size fall out of time after
/// a few.
const COARSEST_RAD: f64 = 0.25;
const FINEST_RAD: f64 = 0.004;
const APART: f64 = 1.04;
/// Steps that are kept of them.
const KEPT: usize = 3;

/// What one run of a joint holds.
pub(in crate::whole) struct Input<'a> {
    /// Set-points in force.
    pub(in crate::whole) command: Track,
    /// Encoder.
    pub(in crate::whole) position: &'a Track,
    /// Torque that the joint bears, N m, on a grid of `load_step_s`; empty where it is not known.
    pub(in crate::whole) load_nm: &'a [f64],
    /// Step of that grid, s.
    pub(in crate::whole) load_step_s: f64,
    /// Torque from which the motor is at its limit, N m, and the measured torque.
    pub(in crate::whole) limit: Option<(f64, &'a Track)>,
}

/// What is known of a joint's servo and its set-points.
pub(in crate::whole) struct Known {
    pub(in crate::whole) nominal: Nominal,
    /// Between which delays set-points come in force, s; `None` where nothing tells.
    pub(in crate::whole) late_s: Option<[f64; 2]>,
    /// The set-points are those that the driver applied.
    pub(in crate::whole) applied: bool,
    /// Tolerance of the largest speed, as a share of it.
    pub(in crate::whole) speed_tolerance: f64,
    /// The echo tells clock and rounding.
    pub(in crate::whole) echoed: bool,
    /// Time between rows, s.
    pub(in crate::whole) row_s: f64,
}

fn less(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// Spread of the angle, rad.
fn spread_rad(grids: &[Grid]) -> f64 {
    let mut all = Vec::new();
    for g in grids {
        let mean = crate::math::mean(&g.q);
        all.extend(g.q.iter().map(|q| q - mean));
    }
    crate::math::rms(&all)
}

/// Coarse set-points: the steps that explain most of the errors, by themselves.
fn steps_rad(grids: &[Grid], base: Law) -> Vec<f64> {
    let steps: Vec<f64> = std::iter::successors(Some(FINEST_RAD), |s| Some(s * APART))
        .take_while(|s| *s < COARSEST_RAD)
        .collect();
    let laws: Vec<Law> = std::iter::once(base)
        .chain(steps.iter().map(|step| Law {
            step: *step,
            ..base
        }))
        .collect();
    let mut sums = vec![[0.0, 1e-12]; steps.len()];
    for g in grids {
        let all = g.all_compared(&laws);
        let left = less(&g.angles(), &all[0]);
        for ([xy, xx], moved) in sums.iter_mut().zip(&all[1..]) {
            for (x, left) in less(moved, &all[0]).iter().zip(&left) {
                *xy += x * left;
                *xx += x * x;
            }
        }
    }
    let score = |[xy, xx]: &[f64; 2]| if *xy > 0.0 { xy * xy / xx } else { 0.0 };
    let mut scored: Vec<(f64, f64)> = sums.iter().map(score).zip(steps).collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored.iter().take(KEPT).map(|s| s.1).collect()
}

/// Set-points at the instants of the control tick, where rows show each of them late by a part of a row.
pub(in crate::whole) fn regular(track: Track) -> Track {
    let tick_s = 1.0 / physics::CONTROL_RATE_HZ;
    let row_s = track.period_s();
    let mut events: Vec<(f64, f64)> = Vec::new();
    for (t, v) in track.t_s.iter().zip(&track.v) {
        if events.last().is_none_or(|l| l.1 != *v) {
            events.push((*t, *v));
        }
    }
    let phases: Vec<f64> = events.iter().skip(1).map(|e| e.0 / tick_s).collect();
    let Some(first) = phases.first().copied() else {
        return track;
    };
    // Distance of each event to the ticks through the first one; the earliest is the least late.
    let off: Vec<f64> = phases
        .iter()
        .map(|p| (p - first) - (p - first).round())
        .collect();
    let [low, high] = [
        crate::math::quantile(&off, 0.0),
        crate::math::quantile(&off, 1.0),
    ];
    if (high - low) * tick_s > 1.05 * row_s || row_s >= tick_s {
        return track;
    }
    let phase = first + low;
    let mut out = Track::default();
    for (t, v) in events {
        let tick = ((t / tick_s - phase) + 1e-6).floor();
        out.t_s.push(((tick + phase) * tick_s).max(0.0));
        out.v.push(v);
    }
    out
}

/// What may be different about the servo of these runs.
fn shapes(known: &Known, grids: &[Grid]) -> Vec<Shape> {
    let mut all = shapes::shapes(known);
    if !known.echoed && !known.applied {
        let steps = steps_rad(grids, Law::nominal(&known.nominal));
        for (i, step) in steps.into_iter().enumerate() {
            let column = Column {
                prior: [1.0, 0.05],
                ..Column::played(Effect::Quantisation, "step_rad", 0.0, step, i)
            };
            all.push(shape(column, Change::Step(step), 1.0));
        }
    }
    all
}

/// Laws to play, that with all coefficients of `start` first, and for each shape the two between which its slope is
/// taken with the coefficient between them.
fn slopes(
    all: &[Shape],
    start: &[(usize, f64)],
    there: Law,
) -> (Vec<Law>, Vec<(usize, usize, f64)>) {
    let mut laws = vec![there];
    let mut place = |law: Law| match laws.iter().position(|l| *l == law) {
        Some(at) => at,
        None => {
            laws.push(law);
            laws.len() - 1
        }
    };
    let slope = |(c, s): (usize, &Shape)| {
        // What is in the law already is taken away, so that the errors with and without it are as they are
        // played; another shape of its effect stands in its place.
        let within = start.iter().find(|x| x.0 == c && x.1.abs() > 1e-9);
        let step = within.map_or(s.step, |x| -x.1);
        let alike = |x: &&(usize, f64)| {
            all[x.0].column.slack == 0.0 && all[x.0].column.meaning == s.column.meaning
        };
        let rivals = start.iter().filter(|x| within.is_none() && alike(x));
        let from = rivals.fold(there, |law, (c, by)| all[*c].change.on(law, -by));
        (place(from), place(s.change.on(from, step)), step)
    };
    let slopes = all.iter().enumerate().map(slope).collect();
    (laws, slopes)
}

/// The block of joint `joint` around the coefficients `start`; `None` without a run that is long enough.
pub(in crate::whole) fn raw(
    joint: usize,
    inputs: &[Input<'_>],
    known: &Known,
    start: &[(usize, f64)],
) -> Option<Raw> {
    let grids: Vec<Grid> = inputs.iter().filter_map(Grid::new).collect();
    let base = Law::nominal(&known.nominal);
    let all = shapes(known, &grids);
    let heard = known.echoed || known.applied;
    // Lost set-points are found again beside the rest: their column stands behind all others.
    let there_already: Vec<(usize, f64)> =
        start.iter().copied().filter(|s| s.0 < all.len()).collect();
    let start = there_already.as_slice();
    let there = start
        .iter()
        .fold(base, |law, (c, by)| all[*c].change.on(law, *by));
    let (laws, slopes) = slopes(&all, start, there);
    let mut segments = Vec::new();
    let lost: Vec<Lost> = grids.iter().map(|g| g.lost(&there)).collect();
    let loses = lost::share(&lost).filter(|_| !heard);
    for (grid, lost) in grids.iter().zip(&lost) {
        let played = grid.all_compared(&laws);
        let plain = &played[0];
        let column = |(from, to, step): &(usize, usize, f64)| -> Vec<f64> {
            let change = less(&played[*to], &played[*from]);
            change.iter().map(|x| x / step).collect()
        };
        let mut x: Vec<Vec<f64>> = slopes.iter().map(column).collect();
        if loses.is_some() {
            let came = grid.compared(&grid.answer(&there, &lost.command));
            x.push(less(&came, plain));
        }
        let mut y = less(&grid.angles(), plain);
        for (c, by) in start {
            y.iter_mut().zip(&x[*c]).for_each(|(y, x)| *y += by * x);
        }
        segments.push(Segment {
            y,
            weight: grid.weights(),
            x,
        });
    }
    let spread = spread_rad(&grids);
    let mut columns: Vec<Column> = all.into_iter().map(|a| a.column).collect();
    if let Some((share, ways)) = loses {
        columns.push(Column {
            prior: [1.0, 0.1],
            cost: ways,
            ..Column::played(Effect::PacketLoss, "probability", 0.0, share, 0)
        });
    }
    (!segments.is_empty()).then_some(Raw {
        site: Site {
            stage: Stage::Driver,
            joint: Some(joint),
            blind: false,
            coarse: false,
        },
        columns,
        segments,
        floor: LEAST_RAD + SHARE * spread,
        noisy: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::block::White;
    use crate::evidence::cause::causes;
    use crate::evidence::search::Problem;
    use crate::math::Rng;

    /// Gain of the loop, 1/s, time between rows, s, and noise of the encoder, rad.
    const GAIN: f64 = 10.0;
    const ROW_S: f64 = 0.01;
    const NOISE_RAD: f64 = 3e-4;
    const TICK_S: f64 = 0.05;

    fn known() -> Known {
        Known {
            nominal: Nominal {
                gain_per_s: GAIN,
                gain_tolerance: 0.05,
                max_speed_rad_s: 2.5,
                max_torque_nm: 4.8,
                torque_tolerance_nm: 0.3,
                damping_nm_s_rad: 0.0,
                damping_tolerance_nm_s_rad: 0.0,
                winding_ohm: 0.0,
                nm_per_a: 4.3,
            },
            late_s: None,
            applied: false,
            speed_tolerance: 0.1,
            echoed: false,
            row_s: ROW_S,
        }
    }

    /// Twelve seconds of set-points.
    fn sent(set: impl Fn(usize) -> f64) -> Track {
        let ticks = 0..240;
        Track {
            t_s: ticks.clone().map(|i| i as f64 * TICK_S).collect(),
            v: ticks.map(set).collect(),
        }
    }

    /// Set-points of a slow swing, and the closed form of a loop that follows them `late_s` late with gain `GAIN *
    /// ratio`.
    fn run([late_s, ratio, offset]: [f64; 3], row_s: f64, rng: &mut Rng) -> (Track, Track) {
        let set = |i: usize| {
            0.6 * crate::math::sin(0.063 * i as f64) + 0.2 * crate::math::sin(0.17 * i as f64)
        };
        let command = sent(set);
        let mut position = Track::default();
        let mut q = set(0);
        for row in 0..(11.9 / row_s) as usize {
            let t = row as f64 * row_s;
            position.t_s.push(t);
            position.v.push(q + NOISE_RAD * rng.normal());
            // Between two instants the set-point is held but for one change: exact exponentials on both sides of it.
            let (mut from, end) = (t, t + row_s);
            while from < end - 1e-12 {
                let tick = ((from - late_s) / TICK_S + 1e-9).floor();
                let next = ((tick + 1.0) * TICK_S + late_s).min(end);
                let c = set(tick.max(0.0) as usize) + offset;
                q = c + (q - c) * libm::exp(-GAIN * ratio * (next - from));
                from = next;
            }
        }
        (command, position)
    }

    fn named(late_s: f64, ratio: f64, offset: f64) -> Named {
        let mut rng = Rng::new(7);
        let runs: Vec<(Track, Track)> = (0..3)
            .map(|_| run([late_s, ratio, offset], ROW_S, &mut rng))
            .collect();
        let inputs: Vec<Input<'_>> = runs
            .iter()
            .map(|(command, position)| Input {
                command: command.clone(),
                position,
                load_nm: &[],
                load_step_s: 0.02,
                limit: None,
            })
            .collect();
        named_in(&inputs)
    }

    /// As the search of causes does: around nothing, then around what was found.
    fn named_in(inputs: &[Input<'_>]) -> Named {
        let first = searched(inputs, &[]);
        searched(inputs, &first.1).0
    }

    /// Effects and sizes, and coefficients, around the coefficients `start`.
    fn searched(inputs: &[Input<'_>], start: &[(usize, f64)]) -> (Named, Vec<(usize, f64)>) {
        let white = White::new(raw(0, inputs, &known(), start).expect("long enough"), 6);
        let by = white.tempering(0.12, 0.0);
        let slack: Vec<f64> = white.columns.iter().map(|c| c.slack).collect();
        let blocks = [white.without_nuisances(&slack, by)];
        let all = causes(&blocks, &[], &[]);
        let problem = Problem {
            blocks: &blocks,
            causes: &all,
            always: &[],
        };
        let found = problem.search(&vec![6.0; all.len()], 3);
        let posterior = problem.posterior(&found.best.members);
        let members = found.best.members.iter().zip(&posterior.first);
        let named = members
            .map(|(m, first)| {
                let number = &all[*m].numbers[0];
                let sd = number.of_latents[0].1;
                let coefficient = number.mean + sd * posterior.mean[*first];
                (all[*m].effect, number.neutral + number.scale * coefficient)
            })
            .collect();
        let coefficients = problem.coefficients(&found.best.members);
        (
            named,
            coefficients.into_iter().map(|c| (c.1, c.2)).collect(),
        )
    }

    type Named = Vec<(Option<Effect>, f64)>;

    #[test]
    fn closed_forms_of_the_loop_are_named_with_their_size() {
        let cases = [
            ("nothing", 0.0, 1.0, 0.0, None),
            ("late", 0.06, 1.0, 0.0, Some((Effect::Latency, 0.06, 0.01))),
            ("weak", 0.0, 0.6, 0.0, Some((Effect::LoopGain, 0.6, 0.06))),
            (
                "off",
                0.0,
                1.0,
                0.05,
                Some((Effect::JointOffset, 0.05, 0.005)),
            ),
        ];
        for (what, late_s, ratio, offset, expected) in cases {
            let found = named(late_s, ratio, offset);
            match expected {
                None => assert!(found.is_empty(), "{what}: {found:?}"),
                Some((effect, value, within)) => {
                    assert_eq!(found.len(), 1, "{what}: {found:?}");
                    assert_eq!(found[0].0, Some(effect), "{what}: {found:?}");
                    assert!((found[0].1 - value).abs() < within, "{what}: {found:?}");
                }
            }
        }
    }

    #[test]
    fn corners_between_two_rows_leave_the_noise_alone() {
        // Set-points that come half a row late: between rows the angle is no straight line.
        const SLOW_ROW_S: f64 = 0.025;
        const LATE_S: f64 = 3.5 * SLOW_ROW_S;
        let (command, position) = run([LATE_S, 1.0, 0.0], SLOW_ROW_S, &mut Rng::new(5));
        let input = Input {
            command,
            position: &position,
            load_nm: &[],
            load_step_s: 0.02,
            limit: None,
        };
        let known = Known {
            late_s: Some([LATE_S - 0.01, LATE_S + 0.01]),
            echoed: true,
            row_s: SLOW_ROW_S,
            ..known()
        };
        let is_late =
            |s: &Shape| matches!(s.change, Change::Delay(size) if size > 0.05 && size < 1.0);
        let late = shapes(&known, &[])
            .iter()
            .position(is_late)
            .expect("a delay");
        let raw = raw(0, &[input], &known, &[(late, 1.0)]).expect("long enough");
        let s = &raw.segments[0];
        let left = less(&s.y, &s.x[late]);
        let counted: Vec<f64> = left.iter().zip(&s.weight).map(|(e, w)| e * w).collect();
        let rms = crate::math::rms(&counted);
        // Set-points begin with a step of the grid: up to 1 ms off, 0.3 mrad here. Straight lines between rows leave 0.7 mrad.
        assert!(rms < 1.7 * NOISE_RAD, "{rms}");
    }

    #[test]
    fn set_points_that_never_came_are_counted() {
        let mut rng = Rng::new(9);
        let (sent, _) = run([0.0, 1.0, 0.0], ROW_S, &mut rng);
        for share in [0.0, 0.03, 0.2, 0.35] {
            // What came, followed by the closed form of the loop.
            let came: Vec<bool> = sent.t_s.iter().map(|_| rng.uniform() >= share).collect();
            let mut position = Track::default();
            let (mut q, mut held) = (sent.v[0], sent.v[0]);
            for row in 0..1190 {
                let tick = row / 5;
                if row % 5 == 0 && came[tick] {
                    held = sent.v[tick];
                }
                position.t_s.push(row as f64 * ROW_S);
                position.v.push(q + NOISE_RAD * rng.normal());
                q = held + (q - held) * libm::exp(-GAIN * ROW_S);
            }
            let input = Input {
                command: sent.clone(),
                position: &position,
                load_nm: &[],
                load_step_s: 0.02,
                limit: None,
            };
            let found = named_in(&[input]);
            let lost = found.iter().find(|f| f.0 == Some(Effect::PacketLoss));
            let size = lost.map_or(0.0, |l| l.1);
            let missed = came.iter().filter(|c| !**c).count() as f64 / came.len() as f64;
            assert!(
                (size - missed).abs() < 0.3 * missed + 1e-9,
                "{missed}: {found:?}"
            );
            assert!(found.len() <= 1, "{found:?}");
        }
    }

    /// A swing whose speed is limited, in fine steps.
    fn limited(most_rad_s: f64) -> (Track, Track) {
        let mut rng = Rng::new(3);
        let set = |i: usize| {
            1.1 * crate::math::sin(0.063 * i as f64) + 0.35 * crate::math::sin(0.17 * i as f64)
        };
        let command = sent(set);
        let mut position = Track::default();
        let (mut q, fine_s) = (set(0), 1e-4);
        for step in 0..(11.9 / fine_s) as usize {
            if step % 100 == 0 {
                position.t_s.push(step as f64 * fine_s);
                position.v.push(q + NOISE_RAD * rng.normal());
            }
            q += fine_s * (GAIN * (set(step / 500) - q)).clamp(-most_rad_s, most_rad_s);
        }
        (command, position)
    }

    fn input((command, position): &(Track, Track)) -> Input<'_> {
        Input {
            command: command.clone(),
            position,
            load_nm: &[],
            load_step_s: 0.02,
            limit: None,
        }
    }

    #[test]
    fn a_servo_that_is_slower_than_stated_within_its_tolerance_has_no_limit() {
        use crate::evidence::settle::settled;
        // Two and a half tolerances slow; the swing asks for more than that.
        let run = limited(2.5 * (1.0 - 2.5 * 0.1));
        let inputs = [input(&run)];
        let nominal = White::new(raw(0, &inputs, &known(), &[]).expect("long enough"), 6);
        let start = settled(&nominal);
        assert!(!start.is_empty());
        let limited = |start: &[(usize, f64)]| {
            let (named, _) = searched(&inputs, start);
            named.iter().any(|n| n.0 == Some(Effect::VelocityLimit))
        };
        assert!(limited(&[]), "around what is stated it looks like a limit");
        assert_eq!(searched(&inputs, &start).0, [], "around {start:?}");
    }

    #[test]
    fn a_cause_far_from_what_is_stated_is_fitted_where_it_is() {
        // Between the limits that are played, and down to a twelfth of the stated one.
        for most_rad_s in [0.97, 0.41, 0.2] {
            let run = limited(most_rad_s);
            let inputs = [input(&run)];
            let (named, start) = searched(&inputs, &[]);
            assert!(
                named.iter().any(|n| n.0 == Some(Effect::VelocityLimit)),
                "{most_rad_s}: {named:?}"
            );
            let played = Played::new(&inputs, &known());
            let law = played.law(played.fitted(&start));
            let found = law.most * law.share;
            assert!(
                (found / most_rad_s - 1.0).abs() < 0.01,
                "{most_rad_s}: {found}"
            );
            // The noise of the start stays where the speed is limited.
            let left = errors_rad(&inputs, &law)[0].expect("long enough");
            assert!(left < 4.0 * NOISE_RAD, "{most_rad_s}: {left}");
        }
    }
}
