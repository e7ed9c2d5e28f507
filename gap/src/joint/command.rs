//! The set-point's way to the controller: it hangs on no state of the joint, so it is worked out a block of steps ahead.

use super::data::RunData;
use super::lanes::Eight;
use super::param::{P, Params};

/// Walks held set-points; gives their mean over a step, so that a delay shorter than a step still counts.
#[derive(Clone)]
struct Held<'a> {
    run: &'a RunData,
    /// Instants and values of a gait that runs at another rate; empty where they are as recorded.
    played: (Vec<f64>, Vec<f64>),
    index: usize,
    last_s: f64,
}

impl<'a> Held<'a> {
    fn new(run: &'a RunData, played: (Vec<f64>, Vec<f64>), start_s: f64) -> Self {
        let mut out = Self {
            run,
            played,
            index: 0,
            last_s: start_s,
        };
        while out.time(out.index + 1).is_some_and(|t| t <= start_s) {
            out.index += 1;
        }
        out
    }

    fn time(&self, i: usize) -> Option<f64> {
        let times = if self.played.0.is_empty() {
            &self.run.command_t_s
        } else {
            &self.played.0
        };
        times.get(i).copied()
    }

    fn value(&self, i: usize) -> f64 {
        let values = if self.played.1.is_empty() {
            &self.run.command
        } else {
            &self.played.1
        };
        values.get(i).copied().unwrap_or(0.0)
    }

    /// When the set-point changes.
    fn next_s(&self) -> f64 {
        self.time(self.index + 1).unwrap_or(f64::INFINITY)
    }

    fn mean_to(&mut self, to_s: f64) -> f64 {
        let span = to_s - self.last_s;
        if span <= 0.0 {
            return self.value(self.index);
        }
        if self.time(self.index + 1).is_none_or(|t| t > to_s) {
            self.last_s = to_s;
            return self.value(self.index);
        }
        let (mut sum, mut from) = (0.0, self.last_s);
        while let Some(next) = self.time(self.index + 1).filter(|t| *t <= to_s) {
            sum += self.value(self.index) * (next.max(from) - from);
            from = next.max(from);
            self.index += 1;
        }
        sum += self.value(self.index) * (to_s - from);
        self.last_s = to_s;
        sum / span
    }
}

/// Set-points of `run` with its gait played at `clock` times the rate, still sent tick by tick: instants and values. On
/// a curve the instants stay and the values are a cubic's through the four neighbours; steps come at the tick after them.
fn played(run: &RunData, clock: f64) -> (Vec<f64>, Vec<f64>) {
    let (t, y) = (&run.command_t_s, &run.command);
    let n = t.len();
    if !run.curved || n < 4 {
        return ((0..n).map(|i| moved(run, i, clock)).collect(), y.clone());
    }
    let mut k = 0;
    let one = |at: &f64| {
        // Past the last set-point the curve is run on by no more than a tick.
        let at = (at * clock).min(t[n - 1] + run.tick_s);
        while k + 2 < n && t[k + 1] <= at {
            k += 1;
        }
        let from = k.saturating_sub(1).min(n - 4);
        let term = |i: usize| {
            let others = (from..from + 4).filter(|j| *j != i);
            others.fold(y[i], |w, j| w * (at - t[j]) / (t[i] - t[j]))
        };
        (from..from + 4).map(term).sum()
    };
    (t.clone(), t.iter().map(one).collect())
}

/// Instant at which step `i` of a gait comes that is played at `clock` times its rate.
fn moved(run: &RunData, i: usize, clock: f64) -> f64 {
    // The echo shows the tick, but for a delay on the way. Without one: where between two ticks the step was is not
    // known, so halfway.
    let tick = match run.shown_s.get(i) {
        Some(shown) => (shown / run.tick_s + 1e-6).floor(),
        None => ((run.command_t_s[i] / run.tick_s - 0.5).max(0.0) / clock - 1e-6).ceil(),
    };
    tick * run.tick_s
}

/// Parameters of one lane's command path.
#[derive(Clone, Copy, PartialEq)]
struct Path {
    /// Rate of the gait.
    rate: f64,
    clock: f64,
    delay: f64,
    scale: f64,
    offset: f64,
    quantum: f64,
    slew: f64,
}

/// One lane: parameters and where it stands.
#[derive(Clone)]
struct Lane<'a> {
    path: Path,
    held: Held<'a>,
    slewed: f64,
}

impl Lane<'_> {
    /// Hands `put` the set-points of the `count` steps from `from`, as applied and as followed, by their number.
    #[inline(always)]
    fn fill(&mut self, from: usize, count: usize, dt_s: f64, mut put: impl FnMut(usize, f64, f64)) {
        let path = self.path;
        let end_s = |k: usize| ((from + k) as f64 * dt_s + dt_s) * path.clock - path.delay;
        let mut k = 0;
        while k < count {
            let next_s = self.held.next_s();
            let mut sp = self.held.mean_to(end_s(k)) * path.scale + path.offset;
            if path.quantum > 0.0 {
                sp = (sp / path.quantum).round() * path.quantum;
            }
            // Between two set-points all steps are alike.
            let mut last_s;
            loop {
                last_s = end_s(k);
                if path.slew.is_finite() {
                    self.slewed += (sp - self.slewed).max(-path.slew).min(path.slew);
                    put(k, sp, self.slewed);
                } else {
                    put(k, sp, sp);
                }
                k += 1;
                if k >= count || last_s >= next_s || end_s(k) >= next_s {
                    break;
                }
            }
            self.held.last_s = last_s;
        }
    }
}

/// The command paths of all lanes.
pub(super) struct Commands<'a> {
    lanes: Vec<Lane<'a>>,
    dt_s: f64,
}

impl<'a> Commands<'a> {
    /// Ready to walk `run` from its start; `start` is the position the followed set-point starts from without a command.
    pub(super) fn new(run: &'a RunData, params: &[Params], dt_s: f64, start: f64) -> Self {
        let first = run.command.first().copied().unwrap_or(start);
        let lane = |p: &Params| {
            let clock = 1.0 + p.get(P::Skew);
            let gait = p.get(P::Played) > 0.5 && run.tick_s.is_finite() && clock != 1.0;
            let path = Path {
                rate: if gait { clock } else { 1.0 },
                clock: if gait { 1.0 } else { clock },
                delay: p.get(P::Delay),
                scale: p.get(P::Scale) * p.get(P::Sense),
                offset: p.get(P::Offset),
                quantum: p.get(P::Quantum),
                slew: p.get(P::SlewLimit) * dt_s,
            };
            let played = if gait {
                played(run, clock)
            } else {
                <_>::default()
            };
            let held = Held::new(run, played, -path.delay);
            Lane {
                slewed: first * path.scale + path.offset,
                path,
                held,
            }
        };
        Self {
            lanes: params.iter().map(lane).collect(),
            dt_s,
        }
    }

    /// Set-points of the steps from `from`: as applied, and as followed under a speed limit.
    #[inline(always)]
    pub(super) fn fill(&mut self, from: usize, applied: &mut [Eight], followed: &mut [Eight]) {
        let Some((first, others)) = self.lanes.split_first_mut() else {
            return;
        };
        let count = applied.len();
        let same = first.path;
        first.fill(from, count, self.dt_s, |k, sp, slewed| {
            applied[k] = Eight::splat(sp);
            followed[k] = Eight::splat(slewed);
        });
        for (i, lane) in others.iter_mut().enumerate().filter(|l| l.1.path != same) {
            lane.fill(from, count, self.dt_s, |k, sp, slewed| {
                applied[k].0[i + 1] = sp;
                followed[k].0[i + 1] = slewed;
            });
        }
    }
}
