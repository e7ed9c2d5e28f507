//! Joint order and signs: which set-point each joint follows, and in which direction.

use super::data::{Data, JOINTS, Track};
use super::echo::Echo;

/// Time from a set-point to the angle it causes that is typical of the nominal servo (1 / P), s.
const LAG_S: f64 = 0.1;
/// Instants compared, s.
const EVERY_S: f64 = 0.1;
/// Unexplained share of a joint's motion above which its own set-point is not believed, and the share of it that a better
/// assignment may leave.
const DOUBT: f64 = 0.3;
const BETTER: f64 = 0.33;
/// Slope of angle over set-point below which a joint turns the other way. Chosen by hand, between 1 and -1; no calibration says so.
const TURNED: f64 = -0.3;

/// What the conventions are.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Conventions {
    /// Joint `k` follows the set-point column `order[k]`.
    pub(super) order: [usize; JOINTS],
    /// Column in which the echo of the set-points of column `i` stands: with the set-points, or with the joint that follows them.
    pub(super) echo_at: [usize; JOINTS],
    /// -1 for a joint that turns the other way than its set-points, else 1.
    pub(super) sign: [f64; JOINTS],
    /// The way of each joint's set-points.
    pub(super) echo: [Echo; JOINTS],
}

impl Conventions {
    /// The same where every joint follows its own set-points as they were sent.
    pub(super) fn as_sent(&self) -> Self {
        Self {
            order: std::array::from_fn(|k| k),
            echo_at: std::array::from_fn(|k| k),
            sign: [1.0; JOINTS],
            echo: [Echo::NEUTRAL; JOINTS],
        }
    }
}

/// Sums of a straight-line fit.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    xx: f64,
    xy: f64,
    yy: f64,
    x: f64,
    y: f64,
    n: f64,
}

impl Sums {
    fn add(&mut self, xs: &[f64], ys: &[f64]) {
        let n = xs.len() as f64;
        let (mx, my) = (xs.iter().sum::<f64>() / n, ys.iter().sum::<f64>() / n);
        for (x, y) in xs.iter().zip(ys) {
            self.xx += (x - mx) * (x - mx);
            self.xy += (x - mx) * (y - my);
            self.yy += (y - my) * (y - my);
        }
        self.x += xs.iter().sum::<f64>();
        self.y += ys.iter().sum::<f64>();
        self.n += n;
    }

    /// Share of the motion that a line leaves.
    fn left(&self) -> f64 {
        if self.xx <= 1e-6 || self.yy <= 1e-6 {
            return 1.0;
        }
        1.0 - self.xy * self.xy / (self.xx * self.yy)
    }
}

fn column(track: Option<&Track>, at_s: &[f64], lag_s: f64, hold: bool) -> Option<Vec<f64>> {
    let track = track?;
    let one = |t: &f64| {
        if hold {
            track.held(t - lag_s)
        } else {
            track.at(*t)
        }
    };
    Some(at_s.iter().map(one).collect())
}

/// Share of the echoes in the columns `at` that the set-points sent leave, summed over those columns.
fn echo_left(data: &Data, at: &[usize; JOINTS]) -> f64 {
    let mut sums = [Sums::default(); JOINTS];
    for run in &data.runs {
        let n = (run.length_s / EVERY_S) as usize;
        let times: Vec<f64> = (0..n).map(|i| i as f64 * EVERY_S).collect();
        for (i, sum) in sums.iter_mut().enumerate().filter(|_| n > 1) {
            let sent = column(run.joints[i].command.as_ref(), &times, 0.0, true);
            let echo = column(run.joints[at[i]].applied.as_ref(), &times, 0.0, true);
            if let (Some(sent), Some(echo)) = (sent, echo) {
                sum.add(&sent, &echo);
            }
        }
    }
    let known = sums.iter().filter(|s| s.n > 0.0);
    known.map(Sums::left).sum()
}

/// Columns of the echoes when joint `k` follows the set-points of column `order[k]`: drivers echo what they were told, so a recorder
/// that sorts by joint puts the echo beside the joint, one that sorts by address beside the set-point.
fn echo_columns(data: &Data, order: &[usize; JOINTS]) -> [usize; JOINTS] {
    let identity: [usize; JOINTS] = std::array::from_fn(|k| k);
    let mut beside_joint = identity;
    for (k, address) in order.iter().enumerate() {
        beside_joint[*address] = k;
    }
    if *order != identity && echo_left(data, &beside_joint) < echo_left(data, &identity) {
        beside_joint
    } else {
        identity
    }
}

fn sums(data: &Data) -> [[Sums; JOINTS]; JOINTS] {
    let mut out = [[Sums::default(); JOINTS]; JOINTS];
    for run in &data.runs {
        let n = ((run.length_s - LAG_S) / EVERY_S).max(0.0) as usize;
        let at: Vec<f64> = (0..n).map(|i| LAG_S + i as f64 * EVERY_S).collect();
        if at.len() < 10 {
            continue;
        }
        let sp: Vec<Option<Vec<f64>>> = run
            .joints
            .iter()
            .map(|j| column(j.command.as_ref(), &at, LAG_S, true))
            .collect();
        for (j, tracks) in run.joints.iter().enumerate() {
            let Some(y) = column(tracks.position.as_ref(), &at, 0.0, false) else {
                continue;
            };
            for (i, x) in sp.iter().enumerate() {
                if let Some(x) = x {
                    out[i][j].add(x, &y);
                }
            }
        }
    }
    out
}

/// Every permutation of six in lexicographic order.
pub(super) fn permutations() -> Vec<[usize; JOINTS]> {
    fn extend(head: &mut Vec<usize>, out: &mut Vec<[usize; JOINTS]>) {
        if let Ok(p) = <[usize; JOINTS]>::try_from(head.as_slice()) {
            out.push(p);
            return;
        }
        for k in 0..JOINTS {
            if !head.contains(&k) {
                head.push(k);
                extend(head, out);
                head.pop();
            }
        }
    }
    let mut out = Vec::new();
    extend(&mut Vec::new(), &mut out);
    out
}

/// Number of a permutation, for the effect `joint_order`: in lexicographic order, of the joints that set-points reach, the inverse
/// of the columns `order` that joints follow.
pub(super) fn permutation(order: &[usize; JOINTS]) -> f64 {
    let mut reached = [0; JOINTS];
    for (joint, column) in order.iter().enumerate() {
        reached[*column] = joint;
    }
    permutations()
        .iter()
        .position(|p| *p == reached)
        .unwrap_or(0) as f64
}

/// Finds order and signs.
pub(super) fn find(data: &Data) -> Conventions {
    let s = sums(data);
    let identity: [usize; JOINTS] = std::array::from_fn(|k| k);
    let left = |order: &[usize; JOINTS]| -> f64 {
        (0..JOINTS)
            .filter(|j| s[*j][*j].n > 0.0)
            .map(|j| s[order[j]][j].left())
            .sum()
    };
    let doubtful = (0..JOINTS).any(|j| s[j][j].yy > 1e-3 * s[j][j].n && s[j][j].left() > DOUBT);
    let mut order = identity;
    if doubtful {
        let all = permutations();
        let best = all.iter().min_by(|a, b| left(a).total_cmp(&left(b)));
        if let Some(best) = best.filter(|b| left(b) < BETTER * left(&identity)) {
            order = *best;
        }
    }
    let mut out = Conventions {
        order,
        echo_at: echo_columns(data, &order),
        sign: [1.0; JOINTS],
        echo: [Echo::NEUTRAL; JOINTS],
    };
    for j in 0..JOINTS {
        let m = &s[order[j]][j];
        // A joint that moves less than 0.05 rad RMS says nothing about signs.
        let moves = m.n > 0.0 && m.xx > 0.0025 * m.n && m.left() < 0.5;
        if moves && m.xy < TURNED * m.xx {
            out.sign[j] = -1.0;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn permutations_are_counted_in_lexicographic_order() {
        assert_eq!(permutation(&[0, 1, 2, 3, 4, 5]), 0.0);
        assert_eq!(permutation(&[0, 1, 2, 3, 5, 4]), 1.0);
        assert_eq!(permutation(&[5, 4, 3, 2, 1, 0]), 719.0);
        assert_eq!(permutations().len(), 720);
    }
}
