//! Collision pre-check: certified clearance of a pose and of a whole move.
//!
//! Only cubes C1 (bodies 0, 1) and C4 (bodies 5, 6) can meet: neighbours touch by construction and the others stay 1.1547 edges apart.
//! The shape is the real one ([`crate::geometry`]), the bound is a separating plane (module `distance`), and a
//! move is the straight line in joint space that the motors follow from one set-point to the next.
//!
//! Along a move the plane found at the middle of an interval is kept and its gap bounded over the interval: the centres move with
//! known velocity and bounded acceleration, the flats turn by a bounded angle. Where the bound does not reach the margin the
//! interval is halved, up to a fixed number of poses; what is then not certified counts as blocked. So a verdict `Clear` is a proof, and the work is
//! bounded.

use crate::CYCLE_S;
use crate::distance::{separation, unit};
use crate::geometry::{ActiveFlat, Arms, EndCubes, FlatShape, support_bound_m};
use crate::linalg::Vec3;
use crate::robot::{JOINTS, RobotModel};

/// Subtracted from every certified clearance, m: f32 rounding of positions up to 0.4 m through a dozen operations stays below 1e-6 m.
pub const ROUNDING_M: f32 = 2e-6;
/// Clearance that every commanded move keeps, m: room for backlash and servo lag of a degree at 0.16 m from an axis.
pub const MARGIN_M: f32 = 3e-3;
/// Poses examined at most per move. One settles 95 near moves of 100; what three cannot certify lies within 4 mm of the margin.
pub const MAX_POSES_PER_MOVE: u8 = 3;
/// Poses examined at most when a move leaves a pose without margin: there the margin asked for is the clearance itself.
pub const MAX_POSES_PER_ESCAPE: u8 = 5;

/// Two bodies that could meet: one of 0, 1 and one of 5, 6.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Pair {
    /// Body 0 or 1.
    pub first: u8,
    /// Body 5 or 6.
    pub last: u8,
}

/// Certified clearance of one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Clearance {
    /// Lower bound of the distance, m. Not positive: an overlap cannot be excluded.
    pub clearance_m: f32,
    /// The bodies that are closest.
    pub pair: Pair,
}

/// What the pre-check says of a move.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Verdict {
    /// Every pose of the move keeps at least this distance, m (a lower bound; far poses are not refined).
    Clear {
        /// Lower bound of the distance over the move, m.
        clearance_m: f32,
    },
    /// The margin could not be certified.
    Blocked(Blocked),
}

/// A move that must not be made.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Blocked {
    /// The bodies that come too close.
    pub pair: Pair,
    /// Certified clearance of the part of the move that lacks the margin, m; not positive when an overlap cannot be excluded.
    pub clearance_m: f32,
    /// When, s from now; the move itself takes one cycle.
    pub at_s: f32,
}

/// Certified clearance of a pose (angles in rad, multi-turn allowed). A pose that is not finite has none.
#[must_use]
pub fn clearance(model: &RobotModel, q_rad: &[f32; JOINTS]) -> Clearance {
    clearance_within(model, &FlatShape::of(model), q_rad, 0.0, f32::INFINITY)
}

/// As [`clearance`], but not refined further once the distance is known to be below `give_up_m` or certified to be at least `enough_m`.
fn clearance_within(
    model: &RobotModel,
    shape: &FlatShape,
    q_rad: &[f32; JOINTS],
    give_up_m: f32,
    enough_m: f32,
) -> Clearance {
    let [_, _, q2, q3, _, _] = *q_rad;
    let arms = Arms::at(model, q2, q3);
    let cubes = arms.end_cubes(q_rad);
    let found = separation(shape, &cubes, give_up_m, enough_m);
    let clearance_m = found.lower_m - ROUNDING_M;
    let finite = q_rad.iter().all(|q| q.is_finite());
    Clearance {
        clearance_m: if finite && !clearance_m.is_nan() {
            clearance_m
        } else {
            f32::NEG_INFINITY
        },
        pair: pair_along(&cubes, found.direction),
    }
}

fn pair_along(cubes: &EndCubes, direction: Vec3) -> Pair {
    Pair {
        first: if cubes.first.proximal_side(direction) {
            0
        } else {
            1
        },
        last: if cubes.last.proximal_side(-direction) {
            5
        } else {
            6
        },
    }
}

/// Whether the straight move from one pose to another keeps `margin_m` all along.
///
/// Poses that are not finite are blocked.
#[must_use]
pub fn swept(
    model: &RobotModel,
    from_rad: &[f32; JOINTS],
    to_rad: &[f32; JOINTS],
    margin_m: f32,
) -> Verdict {
    let shape = FlatShape::of(model);
    Sweep::new(model, &shape, from_rad, to_rad, margin_m).run(MAX_POSES_PER_MOVE)
}

/// A move may start this much nearer than its own first pose when it leaves a pose without margin, m.
const ESCAPE_SLACK_M: f32 = 2e-4;

/// Margins of a move, m.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Margins {
    /// Kept by every move.
    pub keep_m: f32,
    /// A robot found closer than `keep_m` but not closer than this may move away: towards a pose that is no nearer.
    pub escape_m: f32,
}

/// [`swept`], but a robot that already stands too close may move apart again.
#[inline(never)] // instruction counts of the image begin at this symbol
#[must_use]
pub fn check_move(
    model: &RobotModel,
    from_rad: &[f32; JOINTS],
    to_rad: &[f32; JOINTS],
    margins: Margins,
) -> Verdict {
    let shape = FlatShape::of(model);
    let sweep = |margin_m| Sweep::new(model, &shape, from_rad, to_rad, margin_m);
    let verdict = sweep(margins.keep_m).run(MAX_POSES_PER_MOVE);
    let Verdict::Blocked(_) = verdict else {
        return verdict;
    };
    // Which side of a bound a clearance lies on is settled before its value. Beyond the bound by this much rounding cannot bring it back.
    let beyond_m = 2.0 * ROUNDING_M;
    let (enough_m, give_up_m) = (margins.keep_m + beyond_m, margins.escape_m - beyond_m);
    let from_m = clearance_within(model, &shape, from_rad, give_up_m, enough_m).clearance_m;
    if !(from_m < margins.keep_m && from_m >= margins.escape_m) {
        return verdict;
    }
    let (give_up_m, enough_m) = (from_m - beyond_m, from_m + beyond_m);
    if clearance_within(model, &shape, to_rad, give_up_m, enough_m).clearance_m < from_m {
        return verdict;
    }
    let margin_m = (from_m - ESCAPE_SLACK_M).max(margins.escape_m);
    sweep(margin_m).run(MAX_POSES_PER_ESCAPE)
}

/// A part of a move still to be certified: centre and half width as fractions of the move.
#[derive(Clone, Copy)]
struct Interval {
    centre: f32,
    half: f32,
}

/// What one interval turned out to be.
enum Part {
    /// Certified with this clearance, m.
    Clear(f32),
    /// Not certified; whether halving can help, and the evidence.
    Open { certain: bool, blocked: Blocked },
}

struct Sweep<'a> {
    model: &'a RobotModel,
    shape: &'a FlatShape,
    from: [f32; JOINTS],
    delta: [f32; JOINTS],
    margin_m: f32,
}

impl<'a> Sweep<'a> {
    fn new(
        model: &'a RobotModel,
        shape: &'a FlatShape,
        from: &[f32; JOINTS],
        to: &[f32; JOINTS],
        margin_m: f32,
    ) -> Self {
        let mut delta = *to;
        for (d, f) in delta.iter_mut().zip(from) {
            *d -= f;
        }
        Sweep {
            model,
            shape,
            from: *from,
            delta,
            margin_m,
        }
    }

    /// Depth-first over the halves of the move, earliest part first.
    fn run(&self, most_poses: u8) -> Verdict {
        let mut open: heapless::Vec<Interval, { MAX_POSES_PER_ESCAPE as usize + 1 }> =
            heapless::Vec::new();
        let _ = open.push(Interval {
            centre: 0.5,
            half: 0.5,
        });
        let mut least_m = f32::INFINITY;
        let mut poses = 0u8;
        while let Some(part) = open.pop() {
            poses += 1;
            match self.examine(part) {
                Part::Clear(clearance_m) => least_m = least_m.min(clearance_m),
                Part::Open { certain, blocked } => {
                    // Both halves still have to fit into the budget.
                    if certain || usize::from(poses) + open.len() + 2 > usize::from(most_poses) {
                        return Verdict::Blocked(blocked);
                    }
                    let half = 0.5 * part.half;
                    let _ = open.push(Interval {
                        centre: part.centre + half,
                        half,
                    });
                    let _ = open.push(Interval {
                        centre: part.centre - half,
                        half,
                    });
                }
            }
        }
        Verdict::Clear {
            clearance_m: least_m,
        }
    }

    fn pose(&self, at: f32) -> [f32; JOINTS] {
        let mut q = self.from;
        for (q, d) in q.iter_mut().zip(&self.delta) {
            *q += d * at;
        }
        q
    }

    fn examine(&self, part: Interval) -> Part {
        let q = self.pose(part.centre);
        let [_, _, q2, q3, _, _] = q;
        let d = self.delta;
        let [_, _, d2, d3, _, _] = d;
        let arms = Arms::at(self.model, q2, q3);
        let rate = arms.span_rate(self.model, d2, d3);
        // |second derivative| of the span: each centre circles its axis at sqrt(2/3) of an edge (0.8166 > 0.81650).
        let bend = 0.5 * 0.8166 * self.model.cube_m() * (d2 * d2 + d3 * d3) * part.half * part.half;
        let span = arms.span_m();
        let lost = |v: Vec3| v.dot(rate).abs() * part.half + bend;

        let (length, towards) = unit(span);
        let balls_m = length - lost(towards) - 2.0 * self.shape.ball_m - ROUNDING_M;
        if balls_m >= self.margin_m {
            return Part::Clear(balls_m);
        }
        let cubes = arms.end_cubes(&q);
        // With this much to spare in the middle the whole part is certain, whatever the direction.
        let turns = d.iter().fold(0.0f32, |sum, d| sum + d.abs()) * part.half;
        let enough_m =
            self.margin_m + ROUNDING_M + rate.norm() * part.half + bend + self.shape.rim_m * turns;
        let found = separation(self.shape, &cubes, self.margin_m, enough_m);
        let v = found.direction;
        let certified_m = v.dot(span)
            - lost(v)
            - self.first_support_m(&cubes, v, part.half)
            - self.last_support_m(&cubes, -v, part.half)
            - ROUNDING_M;
        if certified_m >= self.margin_m {
            return Part::Clear(certified_m);
        }
        let kept = found.lower_m - ROUNDING_M >= self.margin_m;
        let blocked = Blocked {
            pair: pair_along(&cubes, v),
            clearance_m: if kept {
                certified_m
            } else {
                found.lower_m - ROUNDING_M
            },
            at_s: part.centre * CYCLE_S,
        };
        // The middle pose itself lacks the margin, or something is not a number: halving cannot help.
        Part::Open {
            certain: !kept,
            blocked,
        }
    }

    fn first_support_m(&self, cubes: &EndCubes, v: Vec3, half: f32) -> f32 {
        let flat = cubes.first.active_flat(self.shape, v);
        let [d0, d1, d2, _, _, _] = self.delta;
        let own = if flat.as_ref().is_some_and(|f| f.proximal) {
            d0
        } else {
            0.0
        };
        let turn = (d2.abs() + d1.abs() + own.abs()) * half;
        support_bound_m(self.shape, flat.as_ref(), turn)
    }

    fn last_support_m(&self, cubes: &EndCubes, v: Vec3, half: f32) -> f32 {
        let flat: Option<ActiveFlat> = cubes.last.active_flat(self.shape, v);
        let [_, _, _, d3, d4, d5] = self.delta;
        let own = if flat.as_ref().is_some_and(|f| !f.proximal) {
            d5
        } else {
            0.0
        };
        let turn = (d3.abs() + d4.abs() + own.abs()) * half;
        support_bound_m(self.shape, flat.as_ref(), turn)
    }
}
