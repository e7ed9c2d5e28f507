//! The torque given the motion: what the motor gave less what the body needed along the measured motion.

use crate::evidence::block::{Column, Meaning, Noisy, Raw, Segment, Site};
use crate::vocabulary::{Effect, Stage};

use super::super::data::Track;
use super::on;

/// Time between torques that are compared, s.
pub(super) const STEP_S: f64 = 0.04;
/// Half width of the lines that give torque and speed, s: a set-point's period is averaged.
pub(super) const HALF_S: f64 = 0.05;
/// What a torque may be off by from one instant to the next, N m: the resolution of a current of 5 mA.
pub(super) const LEAST_NM: f64 = 0.02;
/// Speed at which dry friction has turned over, rad/s: slower is what an encoder of 1 mrad shows over 0.1 s.
const TURN_RAD_S: f64 = 0.02;
const SLOW_RAD_S: f64 = 0.1;
/// The same of friction that turns over more slowly. The second was added by hand, after robots of MuJoCo and ODE that had
/// been looked at (seed 20261128) turned over there: their dry friction had Stribeck friction beside it.
const SLOWER_RAD_S: [f64; 2] = [SLOW_RAD_S, 0.05];
/// Speeds of the Stribeck curve that are played, rad/s.
const STRIBECK_RAD_S: [f64; 4] = [0.03, 0.06, 0.12, 0.25];
/// Number of the shape of a friction that has one direction alone.
const ONE_SIDED: usize = 1;
/// Periods of a ripple per turn.
const PERIODS: usize = 24;
/// Inertia that a ratio of 1 stands for, kg m2: half of the robot about a joint.
pub(in crate::whole) const INERTIA_KG_M2: f64 = 0.02;

/// What one run of a joint holds.
pub(in crate::whole) struct Input<'a> {
    /// Encoder.
    pub(in crate::whole) position: &'a Track,
    /// Torque of the motor, N m.
    pub(in crate::whole) effort: Track,
    /// Torque that the body needs, N m, on a grid of `load_step_s`.
    pub(in crate::whole) load_nm: &'a [f64],
    /// The same of other windows: a column that shared the errors' noise would explain it.
    pub(in crate::whole) apart_nm: &'a [f64],
    /// Change of the load per coefficient, N m: mean of two plays and half of what they differ by.
    pub(in crate::whole) plays_nm: Vec<[&'a [f64]; 2]>,
    /// Step of these grids, s.
    pub(in crate::whole) load_step_s: f64,
    /// What may be wrong about the torque, each with its change of `motor less load` at an instant.
    pub(in crate::whole) electrical: Vec<Along<'a>>,
}

/// A column and its change of the errors per coefficient, at an instant and under the load there.
pub(in crate::whole) type Along<'a> = (Column, Box<dyn Fn(f64, f64) -> f64 + 'a>);

/// What is known of a joint.
pub(in crate::whole) struct Known {
    /// Damping of the nominal joint, N m s/rad.
    pub(in crate::whole) damping_nm_s: f64,
    /// Its tolerance, N m s/rad.
    pub(in crate::whole) tolerance_nm_s: f64,
    /// No pose of the base was recorded.
    pub(in crate::whole) blind: bool,
    /// Duties alone tell the torque.
    pub(in crate::whole) coarse: bool,
    /// Sense of the motion that friction of one direction has; `None` = the one that shows.
    pub(in crate::whole) sense: Option<f64>,
    /// What is behind [`Input::plays_nm`], and the coefficient that the loads are already played with.
    pub(in crate::whole) plays: Vec<(Column, f64)>,
}

/// Instants around the middle of a row, s: a motor that turns round within a row has each friction for a part of it.
const WITHIN_S: [f64; 5] = [
    -0.8 * HALF_S,
    -0.4 * HALF_S,
    0.0,
    0.4 * HALF_S,
    0.8 * HALF_S,
];

/// An instant of a motion.
#[derive(Clone, Copy)]
struct Row {
    t_s: f64,
    q: f64,
    v: f64,
    a: f64,
    side: f64,
    /// Load that the errors are taken against, and that of other windows, N m.
    load: f64,
    apart: f64,
}

/// What the effort of a row is the mean over.
type Span = [Row; WITHIN_S.len()];

/// The middle of a row.
fn middle(span: &Span) -> &Row {
    &span[WITHIN_S.len() / 2]
}

/// The motion at an instant, without its load.
fn instant(q: &Track, t_s: f64) -> Option<Row> {
    let (here, v) = q.curve(t_s, 1.2 * HALF_S)?;
    let (_, before) = q.curve(t_s - HALF_S, HALF_S)?;
    let (_, after) = q.curve(t_s + HALF_S, HALF_S)?;
    Some(Row {
        t_s,
        q: here,
        v,
        a: (after - before) / (2.0 * HALF_S),
        side: v / libm::hypot(v, TURN_RAD_S),
        load: 0.0,
        apart: 0.0,
    })
}

/// Rows of a motion without their load.
fn moving(q: &Track) -> impl Iterator<Item = Span> + '_ {
    let end = q.t_s[q.t_s.len() - 1];
    let n = ((end - q.t_s[0] - 0.4) / STEP_S).max(0.0) as usize;
    (0..n).filter_map(|i| {
        let t_s = q.t_s[0] + 0.2 + i as f64 * STEP_S;
        let within = WITHIN_S.map(|off| instant(q, t_s + off));
        let whole: Option<Vec<Row>> = within.into_iter().collect();
        whole?.try_into().ok()
    })
}

fn rows(input: &Input<'_>) -> Vec<Span> {
    // Loads are means over as long as the effort.
    let loaded = |span: Span| {
        let t_s = middle(&span).t_s;
        let load = on(input.load_nm, input.load_step_s, t_s);
        let apart = on(input.apart_nm, input.load_step_s, t_s);
        span.map(|r| Row { load, apart, ..r })
    };
    moving(input.position).map(loaded).collect()
}

/// Instants of the rows of a run with this motion, s.
pub(in crate::whole) fn instants(position: &Track) -> Vec<f64> {
    moving(position).map(|s| middle(&s).t_s).collect()
}

/// A column and what each row gives it.
type Term = (Column, Box<dyn Fn(&Row) -> f64>);

fn term(column: Column, of: impl Fn(&Row) -> f64 + 'static) -> Term {
    (column, Box::new(of))
}

/// Friction in the gear.
fn friction([damping_nm_s, tolerance_nm_s]: [f64; 2], sense: f64) -> Vec<Term> {
    let mut out = vec![
        term(
            Column::linear(Effect::CoulombFriction, "torque_nm", 0.0, 0.5).at_least_neutral(),
            |r| r.side,
        ),
        term(
            Column::linear(Effect::ViscousFriction, "nm_s_rad", 0.0, 0.5)
                .with_slack(tolerance_nm_s)
                .at_least_neutral(),
            |r| r.v,
        ),
        term(
            Column::linear(Effect::QuadraticFriction, "nm_s2_rad2", 0.0, 0.5).at_least_neutral(),
            |r| r.v * r.v.abs(),
        ),
        term(
            Column::linear(Effect::LoadDependentFriction, "fraction", 0.0, 0.3).at_least_neutral(),
            |r| r.apart.abs() * r.side,
        ),
        term(
            Column::linear(Effect::LoadDependentFriction, "fraction", 0.0, 0.3)
                .shaped(1, &[])
                .at_least_neutral(),
            |r| r.apart.abs() * r.v / libm::hypot(r.v, SLOW_RAD_S),
        ),
        term(
            Column::linear(Effect::AsymmetricFriction, "difference_nm", 0.0, 0.4),
            |r| 0.5 * r.side * r.side,
        ),
        term(
            Column::linear(Effect::AsymmetricFriction, "difference_nm_s_rad", 0.0, 0.4),
            |r| 0.5 * r.v.abs(),
        ),
    ];
    // Dry friction turned over more slowly, as bristles and encoders of low resolution have it.
    for (shape, turn) in SLOWER_RAD_S.into_iter().enumerate() {
        out.push(term(
            Column::linear(Effect::CoulombFriction, "torque_nm", 0.0, 0.5)
                .shaped(1 + shape, &[])
                .at_least_neutral(),
            move |r| r.v / libm::hypot(r.v, turn),
        ));
    }
    // A friction of one direction alone, the one that shows: it cannot push where the other has none.
    let one = |key| {
        let mut column = Column::linear(Effect::AsymmetricFriction, key, 0.0, 0.4);
        column.parameter.scale = sense;
        column.shaped(ONE_SIDED, &[]).at_least_neutral()
    };
    out.push(term(one("difference_nm"), move |r| {
        0.5 * sense * (sense * r.side).max(0.0)
    }));
    out.push(term(one("difference_nm_s_rad"), move |r| {
        0.5 * sense * (sense * r.v).max(0.0)
    }));
    if damping_nm_s > 0.0 {
        let mut column = Column::linear(Effect::DampingGain, "ratio", 1.0, 0.5).at_least_neutral();
        column.parameter.scale = 1.0 / damping_nm_s;
        out.push(term(column, |r| r.v));
    }
    for (shape, vs) in STRIBECK_RAD_S.into_iter().enumerate() {
        out.push(term(
            Column::linear(Effect::StribeckFriction, "static_nm", 0.0, 0.4)
                .shaped(shape, &[("velocity_rad_s", vs)])
                .at_least_neutral(),
            move |r| r.side * libm::exp(-(r.v / vs).powi(2)),
        ));
    }
    out
}

/// What repeats with the turn.
fn ripple() -> Vec<Term> {
    (1..=PERIODS)
        .flat_map(|n| {
            let of = n as f64;
            let fixed = [("periods", of)];
            let column =
                |key| Column::linear(Effect::TorqueRipple, key, 0.0, 0.2).shaped(n, &fixed);
            // The ripple helps the motor: what it gives the motor need not.
            [
                term(column("sine_nm"), move |r: &Row| -libm::sin(of * r.q)),
                term(column("cosine_nm"), move |r: &Row| -libm::cos(of * r.q)),
            ]
        })
        .collect()
}

/// Shapes that no effect has: friction by place, friction and torque by time, a spring to the housing.
fn open(length_s: f64, middle_rad: f64) -> Vec<Term> {
    let mut out = vec![
        term(Column::open(0, 0.3), move |r| {
            r.side * (r.t_s / length_s - 0.5)
        }),
        term(Column::open(1, 0.3), move |r| r.t_s / length_s - 0.5),
        term(Column::open(2, 0.5), move |r| r.q - middle_rad),
    ];
    for n in 1..=12_usize {
        let of = n as f64;
        out.push(term(Column::open(2 + n, 0.2), move |r| {
            r.side * libm::sin(of * r.q)
        }));
        out.push(term(Column::open(2 + n, 0.2), move |r| {
            r.side * libm::cos(of * r.q)
        }));
    }
    for (i, c) in out.iter_mut().enumerate().skip(3) {
        c.0.parameter.key = if i % 2 == 1 { "sine_nm" } else { "cosine_nm" };
    }
    out
}

/// Sense of the motion in which the motor gives more than the load, over what it gives in the other.
fn sense(inputs: &[Input<'_>], damping_nm_s: f64) -> f64 {
    let mut sums = [(0.0, 1e-9); 2];
    for input in inputs {
        for span in rows(input) {
            let r = middle(&span);
            let effort = input.effort.line(r.t_s, HALF_S).map_or(f64::NAN, |l| l.0);
            let left = effort - r.load - damping_nm_s * r.v;
            if left.is_finite() && r.v.abs() > SLOW_RAD_S {
                let s = &mut sums[usize::from(r.v < 0.0)];
                s.0 += left * r.v.signum();
                s.1 += 1.0;
            }
        }
    }
    if sums[0].0 / sums[0].1 >= sums[1].0 / sums[1].1 {
        1.0
    } else {
        -1.0
    }
}

/// Sense of the motion that friction of one direction has in these `columns`.
pub(in crate::whole) fn sense_in(columns: &[Column]) -> Option<f64> {
    let one_sided = |c: &&Column| {
        c.meaning == Meaning::Effect(Effect::AsymmetricFriction) && c.shape == ONE_SIDED
    };
    columns.iter().find(one_sided).map(|c| c.parameter.scale)
}

/// Torque less load and nominal damping, N m; no number where no torque was measured.
fn errors(rows: &[Span], input: &Input<'_>, damping_nm_s: f64) -> Vec<f64> {
    let one = |span: &Span| {
        let r = middle(span);
        let effort = input.effort.line(r.t_s, HALF_S).map_or(f64::NAN, |l| l.0);
        effort - r.load - damping_nm_s * r.v
    };
    rows.iter().map(one).collect()
}

/// Columns of one run but for those of plays, and what they give at its rows.
fn own(
    input: &Input<'_>,
    rows: &[Span],
    known: &Known,
    [sense, middle_rad]: [f64; 2],
) -> (Vec<Column>, Vec<Vec<f64>>) {
    let length_s = rows.last().map_or(0.0, |s| middle(s).t_s).max(1.0);
    let mut terms = friction([known.damping_nm_s, known.tolerance_nm_s], sense);
    terms.extend(ripple());
    terms.extend(open(length_s, middle_rad));
    terms.push(term(
        Column::linear(Effect::Inertia, "ratio", 1.0, 5.0).at_least_neutral(),
        |r| INERTIA_KG_M2 * r.a,
    ));
    let mut x: Vec<Vec<f64>> = terms
        .iter()
        .map(|(_, of)| rows.iter().map(|s| mean(s, of)).collect())
        .collect();
    let mut columns: Vec<Column> = terms.into_iter().map(|t| t.0).collect();
    for (column, of) in &input.electrical {
        columns.push(column.clone());
        let at = |s: &Span| of(middle(s).t_s, middle(s).apart);
        x.push(rows.iter().map(at).collect());
    }
    (columns, x)
}

/// What a term gives a row.
fn mean(span: &Span, of: &dyn Fn(&Row) -> f64) -> f64 {
    span.iter().map(of).sum::<f64>() / span.len() as f64
}

/// A grid of a run at its rows.
fn along(grid: &[f64], input: &Input<'_>, rows: &[Span]) -> Vec<f64> {
    let at = |s: &Span| on(grid, input.load_step_s, middle(s).t_s);
    rows.iter().map(at).collect()
}

/// The block of joint `joint`; `None` without a run that is long enough.
pub(in crate::whole) fn raw(joint: usize, inputs: &[Input<'_>], known: &Known) -> Option<Raw> {
    let mut columns = Vec::new();
    let mut segments = Vec::new();
    let mut noisy = Vec::new();
    let middles: Vec<f64> = inputs
        .iter()
        .map(|i| crate::math::mean(&i.position.v))
        .collect();
    let of_joint = [
        known
            .sense
            .unwrap_or_else(|| sense(inputs, known.damping_nm_s)),
        crate::math::mean(&middles),
    ];
    for input in inputs {
        let rows = rows(input);
        if rows.is_empty() {
            continue;
        }
        let mut y = errors(&rows, input, known.damping_nm_s);
        let mut x;
        (columns, x) = own(input, &rows, known, of_joint);
        noisy.resize_with(known.plays.len(), Vec::new);
        for (i, [mean, half]) in input.plays_nm.iter().enumerate() {
            let (column, at) = &known.plays[i];
            columns.push(column.clone());
            noisy[i].push(along(half, input, &rows));
            let mean = along(mean, input, &rows);
            // Coefficients count from the neutral values.
            y.iter_mut().zip(&mean).for_each(|(y, x)| *y += at * x);
            x.push(mean);
        }
        let weight = y.iter().map(|y| f64::from(u8::from(y.is_finite())));
        let weight = weight.collect();
        y.iter_mut()
            .filter(|y| !y.is_finite())
            .for_each(|y| *y = 0.0);
        segments.push(Segment { y, x, weight });
    }
    let first = columns.len() - noisy.len();
    let plays = noisy.into_iter().zip(&known.plays).enumerate();
    (!segments.is_empty()).then_some(Raw {
        site: Site {
            stage: Stage::Drivetrain,
            joint: Some(joint),
            blind: known.blind,
            coarse: known.coarse,
        },
        columns,
        segments,
        floor: LEAST_NM,
        noisy: plays
            .map(|(i, (half, (_, at)))| Noisy {
                column: first + i,
                half,
                at: *at,
            })
            .collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::block::White;
    use crate::evidence::cause::causes;
    use crate::evidence::search::Problem;
    use crate::math::{Rng, sin};

    const STEP: f64 = 0.02;
    const LENGTH_S: f64 = 60.0;

    /// A grid of loads that each play has otherwise by some tenths of a newton metre.
    fn played(rng: &mut Rng) -> Vec<f64> {
        let mut apart = 0.0;
        let one = |i: usize| {
            apart = 0.8 * apart + 0.12 * rng.normal();
            load_nm(i as f64 * STEP) + apart
        };
        (0..(LENGTH_S / STEP) as usize + 2).map(one).collect()
    }

    fn load_nm(t_s: f64) -> f64 {
        0.6 * sin(1.9 * t_s + 0.7) + 0.3 * sin(3.8 * t_s)
    }

    fn track(step_s: f64, of: impl FnMut(f64) -> f64) -> Track {
        let t_s: Vec<f64> = (0..(LENGTH_S / step_s) as usize)
            .map(|i| step_s * i as f64)
            .collect();
        Track {
            v: t_s.iter().copied().map(of).collect(),
            t_s,
        }
    }

    /// The loads of a play are wrong by when feet land. A robot as heavy as stated has the mass stated all the same.
    #[test]
    fn what_plays_differ_by_is_no_mass() {
        let mut rng = Rng::new(3);
        let [errors, first, second] = [0; 3].map(|_| played(&mut rng));
        let both = |of: fn(f64, f64) -> f64| -> Vec<f64> {
            first.iter().zip(&second).map(|(a, b)| of(*a, *b)).collect()
        };
        let (mean, half) = (both(|a, b| 0.5 * (a + b)), both(|a, b| 0.5 * (a - b)));
        let position = track(0.01, |t| 0.7 * sin(1.9 * t));
        let effort = track(0.01, |t| load_nm(t) + 0.02 * rng.normal());
        let input = Input {
            position: &position,
            effort,
            load_nm: &errors,
            apart_nm: &mean,
            plays_nm: vec![[&mean, &half]],
            load_step_s: STEP,
            electrical: Vec::new(),
        };
        let known = Known {
            damping_nm_s: 0.0,
            tolerance_nm_s: 0.0,
            blind: false,
            coarse: false,
            sense: Some(1.0),
            plays: vec![(
                Column::linear(Effect::Mass, "ratio", 1.0, 0.4).of_robot(),
                0.0,
            )],
        };
        let raw = raw(0, &[input], &known).expect("long enough");
        let blocks = [White::new(raw, 6).plain()];
        let all = causes(&blocks, &[], &[]);
        let problem = Problem {
            blocks: &blocks,
            causes: &all,
            always: &[],
        };
        let mass = all.iter().position(|c| c.effect == Some(Effect::Mass));
        let (_, _, by) = problem.coefficients(&[mass.expect("a cause")])[0];
        assert!(by.abs() < 0.05, "{by}");
    }
}
