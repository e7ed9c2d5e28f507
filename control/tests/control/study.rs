//! Compares pre-check and oracle on random poses and moves.

use crate::oracle::{BALL_M, Bounds, Oracle, PARRY_ERROR_M, Rng};
use control::precheck::{self, Verdict};
use control::robot::{RobotModel, RobotParams};
use std::fmt;

/// Margin the pre-check is asked for, m.
pub(crate) const MARGIN_M: f32 = precheck::MARGIN_M;
/// Gap of the two balls beyond which the oracle does not build polyhedra, m.
const FAR_M: f64 = 0.040;

#[derive(Clone, Copy, Debug)]
pub(crate) enum Where {
    Everywhere,
    /// Balls closer than 40 mm.
    Near,
}

pub(crate) struct Study {
    pub(crate) oracle: Oracle,
    model: RobotModel,
    seed: u64,
}

#[derive(Default, Debug)]
pub(crate) struct PoseTable {
    pub(crate) label: &'static str,
    pub(crate) poses: u64,
    pub(crate) near: u64,
    pub(crate) colliding: u64,
    pub(crate) missed: u64,
    pub(crate) optimistic: u64,
    pub(crate) gap_sum_mm: f64,
    pub(crate) gap_max_mm: f64,
    pub(crate) gaps: u64,
    pub(crate) pair_agrees: u64,
}

#[derive(Default, Debug)]
pub(crate) struct MoveTable {
    pub(crate) moves: u64,
    pub(crate) colliding: u64,
    pub(crate) missed: u64,
    pub(crate) optimistic: u64,
    pub(crate) in_band: u64,
    pub(crate) blocked_in_band: u64,
    pub(crate) worst_blocked_mm: f64,
    pub(crate) clear: u64,
    pub(crate) blocked: u64,
}

impl MoveTable {
    pub(crate) fn blocked_share(&self) -> f64 {
        self.blocked_in_band as f64 / self.in_band.max(1) as f64
    }
}

impl fmt::Display for PoseTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "  poses {:>9} ({:<10}) | near {:>7} | may collide {:>6} | missed {} | optimistic {} | bound short of the oracle: mean {:.3} mm, max {:.3} mm | same pair {:.1} %",
            self.poses,
            self.label,
            self.near,
            self.colliding,
            self.missed,
            self.optimistic,
            self.gap_sum_mm / self.gaps.max(1) as f64,
            self.gap_max_mm,
            100.0 * self.pair_agrees as f64 / self.gaps.max(1) as f64
        )
    }
}

impl fmt::Display for MoveTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "  moves {:>9} | may collide {:>6} | missed {} | optimistic {} | clear {} blocked {} | clearance 5 to 30 mm: {} moves, {} blocked = {:.2} %, largest blocked clearance {:.2} mm",
            self.moves,
            self.colliding,
            self.missed,
            self.optimistic,
            self.clear,
            self.blocked,
            self.in_band,
            self.blocked_in_band,
            100.0 * self.blocked_share(),
            self.worst_blocked_mm
        )
    }
}

impl Study {
    pub(crate) fn new(twist: f64, seed: u64) -> Self {
        let model = RobotModel::new(RobotParams {
            twist_rad: twist as f32,
            ..RobotParams::default()
        })
        .expect("valid");
        Study {
            oracle: Oracle::new(f64::from(twist as f32)),
            model,
            seed,
        }
    }

    fn bounds(&self, q: &[f32; 6]) -> Option<Bounds> {
        (self.oracle.centre_distance_m(q) - 2.0 * BALL_M < FAR_M).then(|| self.oracle.distance(q))
    }

    fn pick(&self, rng: &mut Rng, place: Where) -> [f32; 6] {
        loop {
            let q = rng.pose();
            match place {
                Where::Everywhere => return q,
                Where::Near if self.oracle.centre_distance_m(&q) - 2.0 * BALL_M < FAR_M => {
                    return q;
                }
                Where::Near => {}
            }
        }
    }

    pub(crate) fn poses(&self, count: u64, place: Where) -> PoseTable {
        let label = match place {
            Where::Everywhere => "everywhere",
            Where::Near => "near",
        };
        let mut t = PoseTable {
            label,
            poses: count,
            ..PoseTable::default()
        };
        let mut rng = Rng(self.seed);
        for _ in 0..count {
            let q = self.pick(&mut rng, place);
            let ours = precheck::clearance(&self.model, &q);
            let Some(truth) = self.bounds(&q) else {
                continue;
            };
            t.near += 1;
            let certified_m = f64::from(ours.clearance_m);
            if truth.lower_m <= 0.0 {
                t.colliding += 1;
                t.missed += u64::from(certified_m >= f64::from(MARGIN_M));
            } else {
                let gap_mm = (truth.upper_m - certified_m) * 1e3;
                t.gaps += 1;
                t.gap_sum_mm += gap_mm;
                t.gap_max_mm = t.gap_max_mm.max(gap_mm);
                t.pair_agrees += u64::from(
                    truth.pair == (usize::from(ours.pair.first), usize::from(ours.pair.last)),
                );
            }
            t.optimistic += u64::from(certified_m > truth.upper_m + PARRY_ERROR_M);
        }
        t
    }

    /// A move of one cycle: a near pose and a change of every joint within its speed limit.
    pub(crate) fn random_move(&self, rng: &mut Rng) -> ([f32; 6], [f32; 6]) {
        let from = self.pick(rng, Where::Near);
        let mut to = from;
        for (q, joint) in to.iter_mut().zip(self.model.joints()) {
            let most = f64::from(joint.no_load_speed_rad_s * control::CYCLE_S);
            *q += rng.between(-most, most) as f32;
        }
        (from, to)
    }

    pub(crate) fn moves(&self, count: u64) -> MoveTable {
        const STEPS: i32 = 24;
        let mut t = MoveTable {
            moves: count,
            ..MoveTable::default()
        };
        let mut rng = Rng(self.seed ^ 0x5eed);
        for _ in 0..count {
            let (from, to) = self.random_move(&mut rng);
            let verdict = precheck::swept(&self.model, &from, &to, MARGIN_M);
            let (mut upper_m, mut lower_m) = (f64::INFINITY, f64::INFINITY);
            for k in 0..=STEPS {
                let s = k as f32 / STEPS as f32;
                let q: [f32; 6] = std::array::from_fn(|i| from[i] + s * (to[i] - from[i]));
                if let Some(b) = self.bounds(&q) {
                    upper_m = upper_m.min(b.upper_m);
                    lower_m = lower_m.min(b.lower_m);
                }
            }
            let collides = lower_m <= 0.0;
            let in_band = (0.005..=0.030).contains(&upper_m);
            t.colliding += u64::from(collides);
            t.in_band += u64::from(in_band);
            match verdict {
                Verdict::Clear { clearance_m } => {
                    t.clear += 1;
                    t.missed += u64::from(collides);
                    t.optimistic += u64::from(f64::from(clearance_m) > upper_m + PARRY_ERROR_M);
                }
                Verdict::Blocked(_) => {
                    t.blocked += 1;
                    t.blocked_in_band += u64::from(in_band);
                    t.worst_blocked_mm = t.worst_blocked_mm.max(upper_m * 1e3);
                }
            }
        }
        t
    }
}
