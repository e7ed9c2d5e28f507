//! Set-points that never arrived, where the driver does not echo them: each lost one leaves the joint behind until the
//! next, at instants that differ from repeat to repeat.

use files::dataset::{Manifest, Recording, Signal};
use rayon::prelude::*;

use super::data::{Data, Errors, fast_noise, predicted};
use super::model::Point;
use super::noise::ORDER;
use super::rows::Read;
use crate::evidence::block::Segment;
use crate::evidence::linear::dot;
use crate::evidence::noise::Whitening;
use crate::joint::{Problem, RunData, Trace, simulate};
use crate::vocabulary::Effect;

/// Time in which the loss of a set-point shows, s: a few time constants of a loop of 15 rad/s.
const SHOWS_S: f64 = 0.3;
/// Shares between which losses are losses.
const SHARES: std::ops::Range<f64> = 0.005..0.5;
/// Share of losses that is expected before the first look: one of 400.
const FIRST: f64 = 0.0025;
/// Share of the losses of a run that its repeat may have too, beyond which they are no losses.
const AGAIN: f64 = 0.5;
/// Passes, each around the losses of the one before and under the noise that they leave.
const PASSES: usize = 12;
/// Most set-points of one value that are lost in a row.
const IN_A_ROW: usize = 3;

/// What was found.
pub(super) struct Lost {
    pub(super) read: Read,
    /// Recordings with the set-points that arrived.
    pub(super) arrived: Vec<Recording>,
}

/// Another number of lost sendings of a value: where that shows, and how, by channel.
struct Shape {
    command: usize,
    late: usize,
    from: usize,
    change: Errors,
}

/// One recording, and which sendings of it are lost.
struct Run<'a> {
    data: &'a RunData,
    weights: Errors,
    /// Sendings that are lost, by command.
    late: Vec<usize>,
}

fn played(run: &RunData, point: &Point, data: &Data<'_>) -> Errors {
    if data.stop.asked() {
        return data.nothing(run);
    }
    let mut trace = Trace::new();
    simulate(run, &point.params, data.problem.dt_s, &mut trace);
    data.of_run(run, &trace, point)
}

/// When a value arrives of which the first `late` sendings are lost; `None` if the next one arrives before.
fn arrival_s(run: &RunData, command: usize, late: usize) -> Option<f64> {
    if late == 0 {
        return Some(run.command_t_s[command]);
    }
    // What is sent once is lost until the next.
    let t_s = run.command_t_s[command] + late as f64 * run.tick_s;
    let next_s = run.command_t_s.get(command + 1);
    (t_s.is_finite() && next_s.is_none_or(|n| t_s < n - 0.5 * run.tick_s)).then_some(t_s)
}

/// The run with values late by some sendings.
fn with_losses(run: &RunData, late: impl Fn(usize) -> usize) -> RunData {
    let mut out = run.clone();
    let each = (0..run.command.len()).filter_map(|k| Some((arrival_s(run, k, late(k))?, k)));
    let kept: Vec<(f64, usize)> = each.collect();
    out.command = kept.iter().map(|k| run.command[k.1]).collect();
    out.command_t_s = kept.iter().map(|k| k.0).collect();
    out
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// Adds a change from a row on.
fn add(to: &mut Errors, from: usize, change: &Errors, sign: f64) {
    for (to, change) in to.iter_mut().zip(change) {
        let rows = to[from..].iter_mut().zip(change);
        rows.for_each(|(to, c)| *to += sign * c);
    }
}

fn white(errors: &Errors, noise: &[Whitening]) -> Errors {
    let all = errors.iter().zip(noise);
    all.map(|(e, n)| n.apply(e)).collect()
}

/// White errors of rows as far as they count.
fn white_counted(errors: &Errors, noise: &[Whitening], weights: &Errors) -> Errors {
    let mut out = white(errors, noise);
    for (out, weights) in out.iter_mut().zip(weights) {
        let rows = out.iter_mut().zip(weights);
        rows.for_each(|(out, weight)| *out *= weight.sqrt());
    }
    out
}

/// What a run is played with.
#[derive(Clone, Copy)]
struct Play<'a> {
    point: &'a Point,
    data: &'a Data<'a>,
}

impl<'a> Run<'a> {
    fn new(run: &'a RunData, data: &Data<'_>) -> Self {
        let channels = data.channels.iter();
        Self {
            data: run,
            weights: channels.map(|c| data.counts(run, *c)).collect(),
            late: vec![0; run.command.len()],
        }
    }

    /// Errors with the losses as they are.
    fn left(&self, play: Play<'_>) -> Errors {
        played(
            &with_losses(self.data, |k| self.late[k]),
            play.point,
            play.data,
        )
    }

    /// What each other number of losses of a value would change; values far apart are changed in one play.
    fn shapes(&self, left: &Errors, play: Play<'_>) -> Vec<Shape> {
        let run = self.data;
        let count = left.first().map_or(0, Vec::len);
        let bin_s = run.steps as f64 * play.data.problem.dt_s / count.max(1) as f64;
        let every = (SHOWS_S / run.tick_s.min(SHOWS_S)).ceil().max(1.0) as usize;
        let window = (SHOWS_S / bin_s) as usize;
        let mut out = Vec::new();
        for (late, phase) in (0..=IN_A_ROW).flat_map(|n| (0..every).map(move |p| (n, p))) {
            // A value that another has replaced is lost no longer.
            let there = |k: &usize| late < 2 || arrival_s(run, *k, late - 1).is_some();
            let other = |k: &usize| k % every == phase && self.late[*k] != late && there(k);
            let own: Vec<usize> = (1..run.command.len()).filter(other).collect();
            if own.is_empty() {
                continue;
            }
            let now = |k| {
                if own.binary_search(&k).is_ok() {
                    late
                } else {
                    self.late[k]
                }
            };
            let errors = played(&with_losses(run, now), play.point, play.data);
            for command in own {
                let from = (run.command_t_s[command] / bin_s) as usize;
                let end = (from + window).min(count);
                if from < end {
                    let both = errors.iter().zip(left);
                    let change = both.map(|(a, b)| difference(&a[from..end], &b[from..end]));
                    out.push(Shape {
                        command,
                        late,
                        from,
                        change: change.collect(),
                    });
                }
            }
        }
        out.sort_by_key(|s| (s.command, s.late));
        out
    }

    /// Takes for each value the likeliest number of losses, each of which costs `price`, the others as they are. Gives
    /// how many values could show a loss, and how many losses are expected of them.
    fn look(
        &mut self,
        left: &Errors,
        shapes: &[Shape],
        noise: &[Whitening],
        price: f64,
    ) -> [f64; 2] {
        let order = noise.iter().map(Whitening::order).max().unwrap_or(0);
        let mut left = white_counted(left, noise, &self.weights);
        let (mut looked, mut expected) = (0.0, 0.0);
        for own in shapes.chunk_by(|a, b| a.command == b.command) {
            let late = &mut self.late[own[0].command];
            let now = *late as f64;
            let (mut best, mut most) = (None, 0.0);
            let mut odds = Vec::new();
            for s in own.iter().filter(|s| s.from >= order) {
                let rows = s.from..s.from + s.change.first().map_or(0, Vec::len);
                let weights = self.weights.iter().map(|w| w[rows.clone()].to_vec());
                let change = white_counted(&s.change, noise, &weights.collect());
                let half = 0.5 * change.iter().map(|c| dot(c, c)).sum::<f64>();
                if half <= price {
                    continue;
                }
                let rows = left.iter().zip(&change);
                let along: f64 = rows
                    .map(|(left, c)| dot(&left[s.from..s.from + c.len()], c))
                    .sum();
                let gain = -along - half - (s.late as f64 - now) * price;
                odds.push((gain, s.late as f64));
                if gain > most {
                    (best, most) = (Some((s, change)), gain);
                }
            }
            if odds.is_empty() {
                *late = 0;
                continue;
            }
            looked += 1.0;
            odds.push((0.0, now));
            let weight = |o: &(f64, f64)| libm::exp(o.0 - most);
            let all: f64 = odds.iter().map(weight).sum();
            expected += odds.iter().map(|o| o.1 * weight(o)).sum::<f64>() / all;
            if let Some((s, change)) = best {
                add(&mut left, s.from, &change, 1.0);
                *late = s.late;
            }
        }
        [looked, expected]
    }

    fn commands(&self) -> Vec<usize> {
        (0..self.late.len()).filter(|k| self.late[*k] > 0).collect()
    }
}

/// The noise of channel number `k` from second differences, which losses are seldom part of.
fn fast(left: &[Errors], k: usize, floor: f64) -> Whitening {
    let noise = fast_noise(left.iter().map(|e| &e[k]));
    Whitening::plain(libm::hypot(noise, floor))
}

/// The noise of single recordings by channel, of what losses leave.
fn noise(runs: &[Run<'_>], left: &[Errors], data: &Data<'_>) -> Vec<Whitening> {
    let one = |k: usize| {
        let all = runs.iter().zip(left);
        let segments: Vec<Segment> = all
            .map(|(r, left)| Segment {
                y: left[k].clone(),
                x: Vec::new(),
                weight: r.weights[k].clone(),
            })
            .collect();
        Whitening::fit(&segments, &[], ORDER, data.floor(k))
    };
    (0..data.channels.len()).map(one).collect()
}

/// Whether repeats lose the same set-points: then it is no loss.
fn the_same(runs: &[Run<'_>]) -> bool {
    let (mut both, mut all) = (0.0, 0.0);
    for (i, a) in runs.iter().enumerate() {
        for b in runs[..i].iter().filter(|b| b.data.repeat == a.data.repeat) {
            let [a, b] = [a.commands(), b.commands()];
            both += a.iter().filter(|k| b.contains(k)).count() as f64;
            all += a.len().min(b.len()) as f64;
        }
    }
    all > 0.0 && both > AGAIN * all
}

/// Looks for lost set-points around `point`.
pub(super) fn lost(
    manifest: &Manifest,
    recordings: &[Recording],
    data: &Data<'_>,
    point: &Point,
) -> Option<Lost> {
    let mut problem = Problem::new(manifest, recordings, 0)?;
    predicted(&mut problem, data.horizon_s());
    let all = problem.runs.iter();
    let mut runs: Vec<Run<'_>> = all.map(|r| Run::new(r, data)).collect();
    let play = Play { point, data };
    let before: Vec<Errors> = runs.iter().map(|r| r.left(play)).collect();
    // As small as second differences at first: what losses explain is theirs, as for the noise of a search.
    let channels = 0..data.channels.len();
    let mut filters: Vec<Whitening> = channels.map(|k| fast(&before, k, data.floor(k))).collect();
    let mut left = before.clone();
    let (mut share, mut looked, mut gone) = (FIRST, 0.0, 0.0);
    for _ in 0..PASSES {
        let price = libm::log((1.0 - share) / share).max(1.0);
        let all = runs.par_iter_mut().zip(&left);
        let counted = all.map(|(run, left)| {
            let shapes = run.shapes(left, play);
            run.look(left, &shapes, &filters, price)
        });
        let counted: Vec<[f64; 2]> = counted.collect();
        looked = counted.iter().map(|c| c[0]).sum();
        let expected: f64 = counted.iter().map(|c| c[1]).sum();
        let before = gone;
        gone = runs.iter().flat_map(|r| &r.late).sum::<usize>() as f64;
        share = (expected / f64::max(looked, 1.0)).clamp(SHARES.start, SHARES.end);
        left = runs.par_iter().map(|r| r.left(play)).collect();
        filters = noise(&runs, &left, data);
        if (gone - before).abs() <= SHARES.start * looked {
            break;
        }
    }
    if gone < SHARES.start * looked || gone == 0.0 || the_same(&runs) {
        return None;
    }
    let squares = |all: &[Errors]| -> f64 {
        let all = all.iter().zip(&runs);
        let white = all.map(|(e, r)| white_counted(e, &filters, &r.weights));
        white.flatten().map(|w| dot(&w, &w)).sum()
    };
    let mut evidence = 0.5 * (squares(&before) - squares(&left));
    evidence += gone * libm::log(share) + (looked - gone) * libm::log(1.0 - share);
    let off = (share * (1.0 - share) / looked).sqrt();
    let read = Read::new(Effect::PacketLoss, "probability", [share, off], evidence);
    Some(Lost {
        read,
        arrived: arrived(recordings, &runs),
    })
}

/// Recordings with the set-points that arrived.
fn arrived(recordings: &[Recording], runs: &[Run<'_>]) -> Vec<Recording> {
    let mut out = recordings.to_vec();
    for (r, run) in out.iter_mut().zip(runs) {
        let late = run.late.iter();
        let late_s: Vec<f64> = late.map(|n| *n as f64 * run.data.tick_s).collect();
        let t_s = r.t_s().to_vec();
        if let Some(j) = r.joint_mut(0) {
            let column = j.get(Signal::Setpoint);
            let column = column.map(|c| held(&t_s, c, &late_s));
            j.set(Signal::Setpoint, column);
        }
    }
    out
}

/// The set-points, each held back for `late_s` after the row in which it was sent.
fn held(t_s: &[f64], column: &[f64], late_s: &[f64]) -> Vec<f64> {
    let (mut sent, mut in_force, mut number, mut from_s) = (f64::NAN, f64::NAN, 0, 0.0);
    let row = |(t, v): (&f64, &f64)| {
        if !v.is_finite() {
            return *v;
        }
        if *v != sent {
            if sent.is_finite() {
                number += 1;
            }
            sent = *v;
            // NaN, from no losses of what is sent once, is no wait.
            from_s = t + late_s.get(number).copied().unwrap_or(0.0).max(0.0);
        }
        if *t >= from_s - 1e-6 {
            in_force = *v;
        }
        in_force
    };
    t_s.iter().zip(column).map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::held;

    #[test]
    fn a_lost_set_point_leaves_the_one_before_in_force() {
        let sent = [0.0, 0.0, 1.0, f64::NAN, 1.0, 2.0, 3.0, 3.0];
        let t_s: Vec<f64> = (0..8).map(f64::from).collect();
        let seen = held(&t_s, &sent, &[0.0, 9.0, 0.0, 9.0]);
        let expected = [0.0, 0.0, 0.0, f64::NAN, 0.0, 2.0, 2.0, 2.0];
        for (a, b) in seen.iter().zip(expected) {
            assert!(*a == b || (a.is_nan() && b.is_nan()), "{seen:?}");
        }
    }
}
