//! Whether what the model holds constant stays the same during a run.

use super::body::{B, NUMBERS, OFFSET, Tier, WINDOW_S, of_joint};
use super::data::JOINTS;
use super::search::Evaluate;

/// What is another one late in a run than early.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Change {
    /// Friction of the ground.
    Friction,
    /// Zero of a joint.
    Zero(usize),
}

/// Frictions that windows are simulated with, as ratios to the one found.
const FRICTIONS: [f64; 9] = [0.3, 0.42, 0.55, 0.7, 0.85, 1.0, 1.2, 1.5, 1.9];
/// Offsets of a joint that has one, likewise; and of one that has none, rad.
const OFFSETS: [f64; 9] = [-0.5, 0.0, 0.4, 0.7, 1.0, 1.3, 1.6, 2.0, 2.5];
const OFFSETS_RAD: [f64; 15] = [
    -0.3, -0.22, -0.16, -0.11, -0.07, -0.04, -0.02, 0.0, 0.02, 0.04, 0.07, 0.11, 0.16, 0.22, 0.3,
];
/// Offsets between the least and the largest of these that are fitted.
const FITTED: usize = 61;
/// A zero that drifts runs away steadily from where homing put it, which was up to so long before a run, s: the robot goes to its first set-points.
const HOMED_S: [f64; 4] = [0.0, 2.0, 4.0, 8.0];
/// Least gain of such a zero over one that stays, in costs of a window at the mean; of that without the gait that gains most; and the most
/// that a gait may lose. Of 125, emulated robots whose zero drifts by 5 to 25 mrad/s gain 9.3 to 81, 3.0 and more without their best gait,
/// and no gait loses. Others gain up to 3.6, one 7.1, of it 5.8 on one gait.
const AWAY: f64 = 5.0;
const ELSEWHERE: f64 = 2.5;
const LOSS: f64 = 1.0;
/// Share of that gain which the best offset that stays must have gained over none: the mean of a drift from zero holds three quarters of its squares, three
/// times what is left. A robot without one gained 5.3 where its best offset gained 0.2.
const MEAN: f64 = 0.5;
/// Largest fall that is tried, and its steps to either side of none.
const MOST: f64 = 2.4;
const FALLS: i32 = 16;
/// Values in mid run that are tried.
const LEVELS: usize = 25;
/// Least fall that counts, whichever gait is left out: a friction halved or doubled.
const FAR: f64 = core::f64::consts::LN_2;
/// Least gain on gaits left out, in costs of a window at the mean: of 125, emulated robots whose friction falls by 2.6 or more gain 8 and more,
/// others up to 2.4 with a fall that all gaits tell.
const GAIN: f64 = 4.0;

/// A value that changes steadily: in mid run, and what it loses over the length of the runs.
#[derive(Debug, Clone, Copy)]
struct Law {
    level: f64,
    fall: f64,
}

/// The laws tried, for values between `low` and `high`.
fn laws(low: f64, high: f64) -> impl Iterator<Item = Law> {
    let step = (high - low) / (LEVELS - 1) as f64;
    (-FALLS..=FALLS).flat_map(move |f| {
        (0..LEVELS).map(move |l| Law {
            level: low + step * l as f64,
            fall: MOST * f64::from(f) / f64::from(FALLS),
        })
    })
}

impl Tier {
    /// What changes along the runs of the body `theta`.
    pub(super) fn changes(&self, theta: &[f64]) -> Option<Change> {
        let drifts = (0..JOINTS).filter_map(|k| Some((k, self.drifts(theta, k)?)));
        if let Some((k, _)) = drifts.max_by(|a, b| a.1.total_cmp(&b.1)) {
            return Some(Change::Zero(k));
        }
        let at = |ratio: f64| {
            let mut t = theta.to_vec();
            t[B::Friction as usize] *= ratio;
            (libm::log(ratio), self.window_costs(&t))
        };
        self.unsteady(&FRICTIONS.map(at))
            .then_some(Change::Friction)
    }

    /// What a zero of joint `k` that runs away from where homing put it gains over the best offset that stays, in costs of a window at the mean;
    /// `None` where it stays.
    fn drifts(&self, theta: &[f64], k: usize) -> Option<f64> {
        let own = theta[of_joint(k, OFFSET)];
        let at = |x: f64| {
            let mut t = theta.to_vec();
            t[of_joint(k, OFFSET)] = x;
            (x, self.window_costs(&t))
        };
        let mut tried: Vec<(f64, Vec<f64>)> = if own == 0.0 {
            OFFSETS_RAD.iter().map(|x| at(*x)).collect()
        } else {
            OFFSETS.iter().map(|f| at(f * own)).collect()
        };
        tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        let by_gait = |offset: &dyn Fn(f64) -> f64| {
            let mut sums = vec![0.0; self.groups];
            for (w, window) in self.windows.iter().enumerate() {
                sums[self.group[w]] += between(&tried, w, offset(window.from_s + 0.5 * WINDOW_S));
            }
            sums
        };
        let (low, high) = (tried[0].0, tried[tried.len() - 1].0);
        let values = || (0..FITTED).map(|i| low + (high - low) * i as f64 / (FITTED - 1) as f64);
        let best = |all: &mut dyn Iterator<Item = Vec<f64>>| {
            all.min_by(|a, b| a.iter().sum::<f64>().total_cmp(&b.iter().sum()))
        };
        let stays = best(&mut values().map(|x| by_gait(&|_| x)))?;
        let length_s = self.windows.iter().map(|w| w.from_s).fold(0.0, f64::max) + WINDOW_S;
        let runs = best(&mut values().map(|x| {
            let since = |homed_s: &f64| by_gait(&|t_s| x * (t_s + homed_s) / length_s);
            let all: Vec<Vec<f64>> = HOMED_S.iter().map(since).collect();
            let least = |g: usize| all.iter().map(|a| a[g]).fold(f64::INFINITY, f64::min);
            (0..self.groups).map(least).collect()
        }))?;
        let none = by_gait(&|_| 0.0);
        let windows = self.windows.len() as f64;
        ran_away([&none, &stays, &runs], windows)
    }

    /// Whether a value changes along the runs, of which `tried` holds the windows' costs, by rising value: by how much the other gaits tell, on every gait.
    fn unsteady(&self, tried: &[(f64, Vec<f64>)]) -> bool {
        let (Some(low), Some(high)) = (tried.first(), tried.last()) else {
            return false;
        };
        // Windows take 1 s.
        let starts = self.windows.iter().map(|w| w.from_s);
        let length_s = 1.0 + starts.clone().fold(0.0, f64::max);
        let when: Vec<f64> = starts.map(|t| (t + 0.5) / length_s - 0.5).collect();
        // Costs of the gaits, by law.
        let laws: Vec<(Law, Vec<f64>)> = laws(low.0, high.0)
            .map(|law| {
                let mut sums = vec![0.0; self.groups];
                for (w, t) in when.iter().enumerate() {
                    sums[self.group[w]] += between(tried, w, law.level - law.fall * t);
                }
                (law, sums)
            })
            .collect();
        let best = |left_out: usize, steady: bool| -> &(Law, Vec<f64>) {
            let cost = |(_, sums): &(Law, Vec<f64>)| sums.iter().sum::<f64>() - sums[left_out];
            let tried = laws.iter().filter(|l| !steady || l.0.fall == 0.0);
            tried
                .min_by(|a, b| cost(a).total_cmp(&cost(b)))
                .unwrap_or(&laws[0])
        };
        let groups = 0..self.groups;
        let left_out = |steady| -> f64 { groups.clone().map(|g| best(g, steady).1[g]).sum() };
        let (stays, falls) = (left_out(true), left_out(false));
        let told = groups.clone().map(|g| best(g, false).0.fall);
        let least = told.clone().fold(f64::INFINITY, f64::min);
        let most = told.fold(f64::NEG_INFINITY, f64::max);
        (least > FAR || most < -FAR) && stays - falls > GAIN * stays / self.windows.len() as f64
    }

    /// Mean square of the errors of every window.
    fn window_costs(&self, theta: &[f64]) -> Vec<f64> {
        let mut out = Vec::with_capacity(self.windows.len());
        let all = self.residuals(theta);
        let mut next = vec![0; self.groups];
        for g in &self.group {
            let own = &all[*g][next[*g]..next[*g] + NUMBERS];
            next[*g] += NUMBERS;
            out.push(own.iter().map(|x| x * x).sum::<f64>() / NUMBERS as f64);
        }
        out
    }
}

/// What a zero that runs away gains over the best offset that stays, in costs of a window at the mean. It comes from the costs of the gaits
/// without an offset, with that one and with the drift, of `windows` windows in all; `None` where they do not bear a drift out.
fn ran_away([none, stays, runs]: [&[f64]; 3], windows: f64) -> Option<f64> {
    let sum = |costs: &[f64]| costs.iter().sum::<f64>();
    let unit = sum(stays) / windows;
    let gains = || stays.iter().zip(runs).map(|(a, b)| (a - b) / unit);
    let gain: f64 = gains().sum();
    let told =
        gain - gains().fold(0.0, f64::max) > ELSEWHERE && gains().fold(0.0, f64::min) > -LOSS;
    let averaged = sum(none) / unit - windows > MEAN * gain;
    (gain > AWAY && told && averaged).then_some(gain)
}

/// Cost of window `w` at the value `x`, between the two tried ones beside it.
fn between(tried: &[(f64, Vec<f64>)], w: usize, x: f64) -> f64 {
    let last = tried.len() - 1;
    let x = x.clamp(tried[0].0, tried[last].0);
    let i = (1..last).find(|i| x < tried[*i].0).unwrap_or(last);
    let (a, b) = (&tried[i - 1], &tried[i]);
    let f = (x - a.0) / (b.0 - a.0);
    a.1[w] * (1.0 - f) + b.1[w] * f
}

#[cfg(test)]
mod tests {
    use super::ran_away;

    #[test]
    fn a_drift_is_told_by_many_gaits_and_by_its_mean() {
        // Costs of four gaits of 25 windows each: without an offset, with the best that stays, with the drift.
        let stays = [25.0; 4];
        for (name, none, runs, gain) in [
            ("on every gait", [28.0; 4], [23.0; 4], Some(8.0)),
            ("too small", [28.0; 4], [24.0; 4], None),
            (
                "on one gait alone",
                [28.0; 4],
                [18.0, 25.0, 25.0, 25.0],
                None,
            ),
            (
                "one gait speaks against it",
                [28.0; 4],
                [18.0, 21.0, 21.0, 26.5],
                None,
            ),
            (
                "an offset that stays gains nothing",
                [25.1; 4],
                [23.0; 4],
                None,
            ),
        ] {
            let found = ran_away([&none, &stays, &runs], 100.0);
            assert_eq!(found.map(|g| (g * 1e6).round() / 1e6), gain, "{name}");
        }
    }
}
