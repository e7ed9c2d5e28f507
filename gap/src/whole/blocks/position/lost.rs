//! Set-points that never came, found one by one: the servo holds the one before.

use super::servo::{Grid, Law, Loops, STEP_S};
use crate::whole::data::Track;

/// Shares of lost set-points between which a loss is tried: one in a hundred is a damaged frame now and then.
const LEAST_LOST: f64 = 0.005;
const MOST_LOST: f64 = 0.5;
/// Logarithm of the likelihood ratio from which a set-point counts as lost: that of a loss of one in ten beforehand.
const LOST: f64 = 2.2;
/// What two simulators of one servo differ by over the time between two set-points, rad.
const LEAST_RAD: f64 = 1.0e-4;

/// Times that losses are weighed again, by the noise that the last ones leave.
const PASSES: usize = 2;

/// What was lost of the set-points of a run.
pub(super) struct Lost {
    /// The set-points that came.
    pub(super) command: Track,
    missed: f64,
    sent: f64,
}

/// Share of all set-points that were lost, and in how many ways that many may be: `None` where it is no loss.
pub(super) fn share(all: &[Lost]) -> Option<(f64, f64)> {
    let missed: f64 = all.iter().map(|l| l.missed).sum();
    let sent: f64 = all.iter().map(|l| l.sent).sum::<f64>().max(1.0);
    let p = missed / sent;
    // Logarithm of the number of ways, by the entropy.
    let ways = -sent * (p * libm::log(p.max(1e-9)) + (1.0 - p) * libm::log(1.0 - p));
    (LEAST_LOST..MOST_LOST).contains(&p).then_some((p, ways))
}

impl Grid {
    /// Standard deviation of what the errors change by in `span` steps after set-points `command`, by their median.
    fn noise(&self, law: &Law, command: &Track, span: usize) -> f64 {
        let plain = self.answer(law, command);
        let left: Vec<f64> = self.q.iter().zip(&plain).map(|(q, p)| q - p).collect();
        let mut jumps: Vec<f64> = left
            .windows(span + 1)
            .map(|w| (w[span] - w[0]).abs())
            .collect();
        jumps.sort_by(f64::total_cmp);
        // Median absolute deviation, as that of a normal distribution.
        jumps.get(jumps.len() / 2).map_or(0.0, |m| m / 0.6745) + LEAST_RAD
    }

    /// Step at which a set-point sent at `t_s` is in force.
    fn step_of(&self, law: &Law, t_s: f64) -> usize {
        let at = (t_s + law.delay_s) / law.clock - self.from_s;
        (at.max(0.0) / STEP_S).ceil() as usize
    }

    /// The set-points that came: each is weighed against the one before it, which the servo would have held.
    pub(super) fn lost(&self, law: &Law) -> Lost {
        let starts: Vec<usize> = self
            .command
            .t_s
            .iter()
            .map(|t| self.step_of(law, *t))
            .collect();
        let gaps: Vec<f64> = starts.windows(2).map(|w| (w[1] - w[0]) as f64).collect();
        let span = (crate::math::quantile(&gaps, 0.5) as usize).max(1);
        // Losses would be noise until they are known: what is nearer stands first, then what the noise allows.
        let mut out = self.weighed(law, &starts, LEAST_RAD);
        for _ in 0..PASSES {
            out = self.weighed(law, &starts, self.noise(law, &out.command, span));
        }
        out
    }

    /// The same where errors have the standard deviation `noise`.
    fn weighed(&self, law: &Law, starts: &[usize], noise: f64) -> Lost {
        let (times, values) = (&self.command.t_s, &self.command.v);
        let end = self.q.len();
        let mut out = Lost {
            command: Track::default(),
            missed: 0.0,
            sent: 0.0,
        };
        let (mut past, mut speed) = (vec![[self.q[0]]], [0.0]);
        let mut held = values[0];
        let law = &Loops::new([*law]);
        for (i, value) in values.iter().enumerate() {
            let until = starts.get(i + 1).copied().unwrap_or(end).min(end);
            // Two answers from here to the next set-point.
            let from = past.len();
            let mut play = |c: f64| {
                let mut speed = speed;
                while past.len() < until {
                    let next = self.next(law, c, &past, &mut speed);
                    past.push(next);
                }
                (past.split_off(from), speed)
            };
            let came = play(*value);
            let stayed = (held != *value && i > 0).then(|| play(held));
            let mut misses = false;
            if let Some(stayed) = &stayed
                && until > from
            {
                let level = self.q[from - 1] - past[from - 1][0];
                let square = |of: &dyn Fn(usize) -> f64| {
                    let sum: f64 = (from..until).map(|k| of(k) * of(k)).sum();
                    sum / (until - from) as f64 / (noise * noise)
                };
                let off = |own: &[[f64; 1]]| square(&|k| self.q[k] - own[k - from][0] - level);
                // Only a set-point that would have shown counts.
                if square(&|k| came.0[k - from][0] - stayed.0[k - from][0]) > 4.0 * LOST {
                    out.sent += 1.0;
                    misses = off(&came.0) - off(&stayed.0) > 2.0 * LOST;
                }
            }
            let tail;
            if misses && let Some(stayed) = stayed {
                out.missed += 1.0;
                (tail, speed) = stayed;
            } else {
                out.command.t_s.push(times[i]);
                out.command.v.push(*value);
                held = *value;
                (tail, speed) = came;
            }
            past.extend(tail);
        }
        out
    }
}
