//! Set-points that never arrived, where the driver does not echo them: each lost one leaves the joint behind until the
//! next, at instants that differ from repeat to repeat.

use files::dataset::{Manifest, Recording, Signal};

use super::data::{Data, average, predicted};
use super::model::Point;
use super::rows::Read;
use crate::evidence::noise::Whitening;
use crate::joint::{Problem, RunData, Trace, simulate};
use crate::vocabulary::Effect;

/// Time in which the loss of a set-point shows, s: a few time constants of a loop of 15 rad/s.
const SHOWS_S: f64 = 0.3;
/// Logarithm of the likelihood ratio from which one set-point counts as lost: one of 400 by chance.
const LOST: f64 = 6.0;
/// Half of the squares by which a loss would show, from which a set-point is looked at.
const SEEN: f64 = 8.0;
/// Shares between which losses are losses.
const SHARES: std::ops::Range<f64> = 0.005..0.5;
/// Share of the losses of a run that its repeat may have too, beyond which they are no losses.
const AGAIN: f64 = 0.5;
/// Rounds of looking, each with what the others leave.
const ROUNDS: usize = 3;

/// What was found.
pub(super) struct Lost {
    pub(super) read: Read,
    /// Recordings with the set-points that arrived.
    pub(super) arrived: Vec<Recording>,
}

/// One set-point: where its loss shows, and how.
struct Shape {
    command: usize,
    from: usize,
    white: Vec<f64>,
    square: f64,
}

struct Run {
    repeat: usize,
    left: Vec<f64>,
    shapes: Vec<Shape>,
    lost: Vec<bool>,
}

fn played(run: &RunData, point: &Point, dt_s: f64, stride: usize) -> Vec<f64> {
    let mut trace = Trace::new();
    simulate(run, &point.params, dt_s, &mut trace);
    trace
        .chunks(stride)
        .map(|rows| average(rows.iter().map(|y| y[0])))
        .collect()
}

fn without(run: &RunData, missing: impl Fn(usize) -> bool) -> RunData {
    let mut out = run.clone();
    let kept: Vec<usize> = (0..run.command.len())
        .filter(|k| *k == 0 || !missing(*k))
        .collect();
    out.command = kept.iter().map(|k| run.command[*k]).collect();
    out.command_t_s = kept.iter().map(|k| run.command_t_s[*k]).collect();
    out
}

fn looked_at(run: &RunData, point: &Point, data: &Data, white: &Whitening, more: f64) -> Run {
    let dt_s = data.problem.dt_s;
    let base = played(run, point, dt_s, data.stride);
    let errors: Vec<f64> = run
        .samples
        .chunks(data.stride)
        .zip(&base)
        .map(|(rows, y)| average(rows.iter().filter(|s| s.enabled).map(|s| s.measured[0])) - y)
        .collect();
    let scaled = |v: &[f64]| -> Vec<f64> { white.apply(v).iter().map(|x| x / more).collect() };
    let bin_s = run.steps as f64 * dt_s / base.len().max(1) as f64;
    let every = (SHOWS_S / run.tick_s.min(SHOWS_S)).ceil().max(1.0) as usize;
    let window = (SHOWS_S / bin_s) as usize;
    let mut shapes = Vec::new();
    for phase in 0..every {
        let other = played(
            &without(run, |k| k % every == phase),
            point,
            dt_s,
            data.stride,
        );
        let change: Vec<f64> = other.iter().zip(&base).map(|(a, b)| a - b).collect();
        let change = scaled(&change);
        for k in (1..run.command.len()).filter(|k| k % every == phase) {
            let from = (run.command_t_s[k] / bin_s) as usize;
            let end = (from + window).min(change.len());
            if from >= end || from < white.order() {
                continue;
            }
            let own = change[from..end].to_vec();
            let square: f64 = own.iter().map(|x| x * x).sum();
            if 0.5 * square > SEEN {
                shapes.push(Shape {
                    command: k,
                    from,
                    white: own,
                    square,
                });
            }
        }
    }
    shapes.sort_by_key(|s| s.command);
    Run {
        repeat: run.repeat,
        left: scaled(&errors),
        lost: vec![false; shapes.len()],
        shapes,
    }
}

impl Run {
    /// Logarithm of the likelihood ratio of the loss of set-point `i`, the others as they are.
    fn score(&mut self, i: usize) -> f64 {
        let s = &self.shapes[i];
        let left = &self.left[s.from..s.from + s.white.len()];
        let along: f64 = left.iter().zip(&s.white).map(|(a, b)| a * b).sum();
        along
            + if self.lost[i] {
                0.5 * s.square
            } else {
                -0.5 * s.square
            }
    }

    fn set(&mut self, i: usize, lost: bool) {
        if self.lost[i] == lost {
            return;
        }
        self.lost[i] = lost;
        let s = &self.shapes[i];
        let sign = if lost { -1.0 } else { 1.0 };
        for (l, u) in self.left[s.from..].iter_mut().zip(&s.white) {
            *l += sign * u;
        }
    }

    fn look(&mut self) {
        for _ in 0..ROUNDS {
            for i in 0..self.shapes.len() {
                let lost = self.score(i) > LOST;
                self.set(i, lost);
            }
        }
    }

    fn commands(&self) -> Vec<usize> {
        let all = self.shapes.iter().zip(&self.lost);
        all.filter(|x| *x.1).map(|x| x.0.command).collect()
    }
}

/// Whether repeats lose the same set-points: then it is no loss.
fn the_same(runs: &[Run]) -> bool {
    let (mut both, mut all) = (0.0, 0.0);
    for (i, a) in runs.iter().enumerate() {
        for b in runs[..i].iter().filter(|b| b.repeat == a.repeat) {
            let [a, b] = [a.commands(), b.commands()];
            both += a.iter().filter(|k| b.contains(k)).count() as f64;
            all += a.len().min(b.len()) as f64;
        }
    }
    all > 0.0 && both > AGAIN * all
}

/// Looks for lost set-points around `point`; `counts` is how much a row counts.
pub(super) fn lost(
    manifest: &Manifest,
    recordings: &[Recording],
    data: &Data,
    point: &Point,
    (white, counts): (&Whitening, f64),
) -> Option<Lost> {
    let mut problem = Problem::new(manifest, recordings, 0)?;
    super::transport::regular(&mut problem);
    predicted(&mut problem);
    let many = data
        .problem
        .runs
        .iter()
        .map(|r| r.count)
        .fold(1.0, f64::max);
    let mut runs: Vec<Run> = problem
        .runs
        .iter()
        .map(|r| looked_at(r, point, data, white, many.sqrt()))
        .collect();
    runs.iter_mut().for_each(Run::look);
    let looked: f64 = runs.iter().map(|r| r.shapes.len() as f64).sum();
    let gone: f64 = runs.iter().map(|r| r.commands().len() as f64).sum();
    let share = gone / looked.max(1.0);
    if !SHARES.contains(&share) || the_same(&runs) {
        return None;
    }
    let mut evidence = gone * libm::log(share) + (looked - gone) * libm::log(1.0 - share);
    for run in &mut runs {
        for i in 0..run.shapes.len() {
            if run.lost[i] {
                evidence += run.score(i);
            }
        }
    }
    let off = (share * (1.0 - share) / looked).sqrt();
    let read = Read::new(
        Effect::PacketLoss,
        "probability",
        [share, off],
        counts * evidence,
    );
    let mut arrived = recordings.to_vec();
    for (r, run) in arrived.iter_mut().zip(&runs) {
        let commands = run.commands();
        if let Some(j) = r.joint_mut(0) {
            let column = j.get(Signal::Setpoint).map(|c| held(c, &commands));
            j.set(Signal::Setpoint, column);
        }
    }
    Some(Lost { read, arrived })
}

/// The set-points with those that were lost held at the one before.
fn held(column: &[f64], lost: &[usize]) -> Vec<f64> {
    let (mut sent, mut in_force, mut number) = (f64::NAN, f64::NAN, usize::MAX);
    column
        .iter()
        .map(|v| {
            if v.is_finite() && *v != sent {
                sent = *v;
                number = number.wrapping_add(1);
                if !lost.contains(&number) {
                    in_force = *v;
                }
            }
            if v.is_finite() { in_force } else { *v }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::held;

    #[test]
    fn a_lost_set_point_leaves_the_one_before_in_force() {
        let sent = [0.0, 0.0, 1.0, f64::NAN, 1.0, 2.0, 3.0, 3.0];
        let seen = held(&sent, &[1, 3]);
        let expected = [0.0, 0.0, 0.0, f64::NAN, 0.0, 2.0, 2.0, 2.0];
        for (a, b) in seen.iter().zip(expected) {
            assert!(*a == b || (a.is_nan() && b.is_nan()), "{seen:?}");
        }
    }
}
