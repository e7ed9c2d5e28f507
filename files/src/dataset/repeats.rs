//! Which runs repeat each other.

use super::manifest::{Manifest, Run};
use super::table::{Recording, Signal};

/// Smallest step between different values of a column: its resolution. 0 if the column never changes.
#[must_use]
pub fn quantum(column: &[f64]) -> f64 {
    // The same reading computed in two ways differs in its last digits: no step. A 20-bit encoder over a turn has 1e-6.
    const SAME: f64 = 1e-7;
    let mut v: Vec<f64> = column.iter().copied().filter(|x| x.is_finite()).collect();
    v.sort_by(f64::total_cmp);
    let range = v.last().zip(v.first()).map_or(0.0, |(b, a)| b - a);
    let least = 1e-9_f64.max(SAME * range);
    let mut steps: Vec<f64> = v
        .windows(2)
        .map(|p| p[1] - p[0])
        .filter(|d| *d > least)
        .collect();
    steps.sort_by(f64::total_cmp);
    // A low percentile instead of the minimum: rounding in the text makes a few steps too small.
    steps.get(steps.len() / 20).copied().unwrap_or(0.0)
}

/// Value of a held signal at `t_s`: that of the last sample at or before it.
fn hold(times: &[f64], column: &[f64], t_s: f64) -> f64 {
    let mut i = times.partition_point(|t| *t <= t_s);
    while i > 0 {
        i -= 1;
        if column[i].is_finite() {
            return column[i];
        }
    }
    f64::NAN
}

/// Command of joint `k`: as sent, else as applied.
fn command(r: &Recording, k: usize) -> Option<&[f64]> {
    let j = r.joint(k)?;
    j.get(Signal::Setpoint)
        .or_else(|| j.get(Signal::AppliedSetpoint))
}

fn setpoints_agree(a: &Recording, b: &Recording, joints: usize) -> bool {
    let length = |r: &Recording| r.t_s()[r.len() - 1] - r.t_s()[0];
    let (la, lb) = (length(a), length(b));
    if (la - lb).abs() > 0.05 * la.max(lb) {
        return false;
    }
    let known = |k: &usize| command(a, *k).is_some() || command(b, *k).is_some();
    let mut of = (0..joints).filter(known).peekable();
    of.peek().is_some() && of.all(|k| joint_agrees(a, b, k, la.min(lb)))
}

fn joint_agrees(a: &Recording, b: &Recording, k: usize, length_s: f64) -> bool {
    // Instants compared, and the share that must agree: a set-point sent one row later still repeats the run.
    const INSTANTS: usize = 400;
    const SHARE: f64 = 0.95;
    let (Some(sa), Some(sb)) = (command(a, k), command(b, k)) else {
        return false;
    };
    let (ta, tb) = (a.t_s(), b.t_s());
    let position = a.joint(k).and_then(|j| j.get(Signal::Position));
    let q = position.map_or(0.0, quantum).max(1e-6);
    let same = (0..INSTANTS).filter(|i| {
        let t = length_s * (*i as f64) / INSTANTS as f64;
        let d = hold(ta, sa, ta[0] + t) - hold(tb, sb, tb[0] + t);
        d.is_nan() || d.abs() <= q
    });
    same.count() as f64 >= SHARE * INSTANTS as f64
}

/// Group number of every run: runs with the same number repeat each other (same gait, same overrides, set-points that
/// agree within one quantum of the position).
#[must_use]
pub fn repeat_groups(manifest: &Manifest, recordings: &[Recording]) -> Vec<usize> {
    let runs: &[Run] = &manifest.runs;
    let mut groups: Vec<usize> = Vec::new();
    for i in 0..runs.len().min(recordings.len()) {
        let twin = (0..i).find(|j| {
            runs[*j].gait == runs[i].gait
                && runs[*j].bench == runs[i].bench
                && setpoints_agree(&recordings[*j], &recordings[i], manifest.joints())
        });
        let next = groups.iter().max().map_or(0, |g| g + 1);
        groups.push(twin.map_or(next, |j| groups[j]));
    }
    groups
}
