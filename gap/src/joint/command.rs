//! The set-point's way to the controller: it hangs on no state of the joint, so it is worked out a block of steps ahead.

use wide::f64x8 as F;

use super::data::RunData;
use super::param::{P, Params};

/// Walks held set-points; gives their mean over a step, so that a delay shorter than a step still counts.
#[derive(Clone)]
struct Held<'a> {
    run: &'a RunData,
    echo: bool,
    index: usize,
    last_s: f64,
}

impl<'a> Held<'a> {
    fn new(run: &'a RunData, echo: bool, start_s: f64) -> Self {
        let mut out = Self {
            run,
            echo,
            index: 0,
            last_s: start_s,
        };
        while out.time(out.index + 1).is_some_and(|t| t <= start_s) {
            out.index += 1;
        }
        out
    }

    fn time(&self, i: usize) -> Option<f64> {
        if self.echo {
            self.run.arrivals.get(i).map(|a| a.t_s)
        } else {
            self.run.command_t_s.get(i).copied()
        }
    }

    fn value(&self, i: usize) -> f64 {
        let i = if self.echo {
            self.run.arrivals.get(i).map_or(0, |a| a.index)
        } else {
            i
        };
        self.run.command.get(i).copied().unwrap_or(0.0)
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

/// Parameters of one lane's command path.
#[derive(Clone, Copy, PartialEq)]
struct Path {
    echo: bool,
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

/// The command paths of eight lanes.
pub(super) struct Commands<'a> {
    lanes: Vec<Lane<'a>>,
    dt_s: f64,
}

impl<'a> Commands<'a> {
    /// Ready to walk `run` from its start; `start` is the position the followed set-point starts from without a command.
    pub(super) fn new(run: &'a RunData, params: &[Params], dt_s: f64, start: f64) -> Self {
        let first = run.command.first().copied().unwrap_or(start);
        let lane = |p: &Params| {
            let echo = p.get(P::Echo) > 0.5 && !run.arrivals.is_empty();
            let path = Path {
                echo,
                clock: if echo { 1.0 } else { 1.0 + p.get(P::Skew) },
                delay: if echo { 0.0 } else { p.get(P::Delay) },
                scale: p.get(P::Scale),
                offset: p.get(P::Offset),
                quantum: p.get(P::Quantum),
                slew: p.get(P::SlewLimit) * dt_s,
            };
            let held = Held::new(run, echo, -path.delay);
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
    pub(super) fn fill(&mut self, from: usize, applied: &mut [F], followed: &mut [F]) {
        for i in 0..self.lanes.len() {
            if i > 0 && self.lanes[i].path == self.lanes[0].path {
                for (a, f) in applied.iter_mut().zip(followed.iter_mut()) {
                    let (a, f) = (a.as_mut_array(), f.as_mut_array());
                    (a[i], f[i]) = (a[0], f[0]);
                }
                continue;
            }
            let lane = &mut self.lanes[i];
            let path = lane.path;
            for (k, (a, f)) in applied.iter_mut().zip(followed.iter_mut()).enumerate() {
                let end_s = ((from + k) as f64 * self.dt_s + self.dt_s) * path.clock - path.delay;
                let mut sp = lane.held.mean_to(end_s);
                sp = sp * path.scale + path.offset;
                if path.quantum > 0.0 {
                    sp = (sp / path.quantum).round() * path.quantum;
                }
                a.as_mut_array()[i] = sp;
                if path.slew.is_finite() {
                    lane.slewed += (sp - lane.slewed).max(-path.slew).min(path.slew);
                    sp = lane.slewed;
                }
                f.as_mut_array()[i] = sp;
            }
        }
    }
}
