//! When set-points arrived at the driver, read from its echo of the applied set-point.

use super::data::{RunData, Sample};

/// A set-point that arrived: when, and which of the run's set-points it was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// Instant, s from the first row: halfway between the row that still shows the old one and the row that shows it.
    pub t_s: f64,
    /// Index into [`RunData::command`].
    pub index: usize,
    /// Half the time between those rows.
    pub doubt_s: f64,
}

/// Longest delay that is looked for.
const LONGEST_S: f64 = 0.6;

/// Changes of the echoed set-point: instant, doubt and value.
fn changes(samples: &[Sample], dt_s: f64) -> Vec<(f64, f64, f64)> {
    let mut out: Vec<(f64, f64, f64)> = Vec::new();
    let mut last: Option<(f64, f64)> = None;
    for s in samples {
        let (t, v) = ((s.step as f64 + s.part) * dt_s, s.measured[6]);
        if v.is_nan() {
            continue;
        }
        match last {
            None => out.push((t, 0.0, v)),
            Some((before, value)) if value != v => {
                out.push((0.5 * (before + t), 0.5 * (t - before), v));
            }
            Some(_) => {}
        }
        last = Some((t, v));
    }
    out
}

/// Instants of the first rows that show each of `count` set-points, if there are as many changes.
pub(super) fn shown(samples: &[Sample], count: usize, dt_s: f64) -> Vec<f64> {
    let changes = changes(samples, dt_s);
    if changes.len() == count {
        changes.iter().map(|c| c.0 + c.1).collect()
    } else {
        Vec::new()
    }
}

/// Straight line from set-points to echoes, over the rows of a run: offsets, scales and signs are no matter of time.
fn line(samples: &[Sample], command_t_s: &[f64], command: &[f64], dt_s: f64) -> (f64, f64) {
    let (mut n, mut x, mut y, mut xx, mut xy, mut k) = (0.0, 0.0, 0.0, 0.0, 0.0, 0);
    for s in samples.iter().filter(|s| s.measured[6].is_finite()) {
        let t = (s.step as f64 + s.part) * dt_s;
        while command_t_s.get(k + 1).is_some_and(|c| *c <= t) {
            k += 1;
        }
        let (a, b) = (command.get(k).copied().unwrap_or(0.0), s.measured[6]);
        (n, x, y, xx, xy) = (n + 1.0, x + a, y + b, xx + a * a, xy + a * b);
    }
    let spread = n * xx - x * x;
    if spread <= 1e-12 {
        return (1.0, 0.0);
    }
    let slope = (n * xy - x * y) / spread;
    (slope, (y - slope * x) / n)
}

/// Which set-points arrived when, and how well their values agree (median). Empty where the echo was not measured.
pub(super) fn arrivals(
    samples: &[Sample],
    command_t_s: &[f64],
    command: &[f64],
    dt_s: f64,
) -> (Vec<Arrival>, f64) {
    let changes = changes(samples, dt_s);
    if changes.len() < 4 || command.len() < 4 {
        return (Vec::new(), f64::INFINITY);
    }
    // The same numbers, the other direction, or a line blurred by delays that matched pairs sharpen.
    let start = line(samples, command_t_s, command, dt_s);
    let mut best = (Vec::new(), f64::INFINITY);
    for (mut map, rounds) in [((1.0, 0.0), 1), ((-1.0, 0.0), 1), (start, 4)] {
        for _ in 0..rounds {
            let pairs = matched(&changes, command_t_s, command, map);
            let errors: Vec<f64> = pairs.iter().map(|p| p.1).collect();
            let error = crate::math::median(&errors);
            if error < best.1 {
                best = (pairs.iter().map(|p| p.0).collect(), error);
            }
            let values: Vec<(f64, f64)> = pairs.iter().map(|p| (command[p.0.index], p.2)).collect();
            map = middle_line(&values, map);
        }
    }
    best
}

/// Least-squares line through the half of the pairs that lies nearest to `map`.
fn middle_line(pairs: &[(f64, f64)], map: (f64, f64)) -> (f64, f64) {
    let error = |p: &(f64, f64)| (map.0 * p.0 + map.1 - p.1).abs();
    let limit = crate::math::median(&pairs.iter().map(error).collect::<Vec<_>>());
    let near: Vec<&(f64, f64)> = pairs.iter().filter(|p| error(p) <= limit).collect();
    let n = near.len().max(1) as f64;
    let (mx, my) = (
        near.iter().map(|p| p.0).sum::<f64>() / n,
        near.iter().map(|p| p.1).sum::<f64>() / n,
    );
    let xx: f64 = near.iter().map(|p| (p.0 - mx) * (p.0 - mx)).sum();
    let xy: f64 = near.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum();
    if xx <= 1e-12 {
        return map;
    }
    (xy / xx, my - xy / xx * mx)
}

/// Set-points by the echoes they made under the line `map`: arrival, error of the value, echoed value.
fn matched(
    changes: &[(f64, f64, f64)],
    command_t_s: &[f64],
    command: &[f64],
    (slope, offset): (f64, f64),
) -> Vec<(Arrival, f64, f64)> {
    let mut out: Vec<(Arrival, f64, f64)> = Vec::new();
    for &(t_s, doubt_s, value) in changes {
        let from = out.last().map_or(0, |a| a.0.index);
        // Of the set-points sent since the last one that arrived, the one of nearest value; the latest of equals.
        let fits = (from..command.len())
            .take_while(|k| command_t_s[*k] <= t_s + doubt_s + 1e-6)
            .filter(|k| t_s - command_t_s[*k] < LONGEST_S || *k == from)
            .map(|k| (k, (slope * command[k] + offset - value).abs()));
        let best = fits.fold(None, |b: Option<(usize, f64)>, (k, e)| match b {
            Some((_, least)) if e > least + 1e-5 => b,
            _ => Some((k, e)),
        });
        if let Some((index, error)) = best {
            let arrival = Arrival {
                t_s,
                index,
                doubt_s,
            };
            out.push((arrival, error, value));
        }
    }
    out
}

/// The step of which all echoed set-points are multiples (beside an offset), where it is coarser than the recording.
#[must_use]
pub fn lattice(runs: &[RunData]) -> Option<f64> {
    let mut values: Vec<f64> = Vec::new();
    for run in runs {
        values.extend(
            run.samples
                .iter()
                .map(|s| s.measured[6])
                .filter(|v| v.is_finite()),
        );
    }
    values.sort_by(f64::total_cmp);
    values.dedup_by(|a, b| (*a - *b).abs() < 2e-6);
    if values.len() < 4 {
        return None;
    }
    let span = values.last()? - values.first()?;
    let gaps: Vec<f64> = values.windows(2).map(|w| w[1] - w[0]).collect();
    // Of a lattice most neighbours are one step apart.
    let coarse = crate::math::quantile(&gaps, 0.3);
    let whole = gaps.iter().map(|g| (g / coarse).round()).sum::<f64>();
    let step = span / whole.max(1.0);
    let fits = gaps
        .iter()
        .filter(|g| (*g / step - (*g / step).round()).abs() < 0.05)
        .count();
    (step > 1e-4 && fits * 10 > gaps.len() * 9).then_some(step)
}

/// How regularly set-points arrive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Regularity {
    /// Changed set-points behind these figures.
    pub sent: f64,
    /// Share of changed set-points that never arrived.
    pub lost: f64,
    /// Shortest delay, s.
    pub least_s: f64,
    /// Range of the delays but for the outer two percent, s.
    pub range_s: f64,
    /// Root mean square of the delay beyond the shortest, s.
    pub spread_s: f64,
    /// Time between the rows that show a set-point arrive, s.
    pub doubt_s: f64,
}

/// Largest disagreement of echoed and sent values, as a share of the set-points' range, at which they count as the same.
const SAME_VALUE: f64 = 5e-4;

/// Measures it over runs; `None` without echoes, or where the echoes are not the set-points that were sent.
#[must_use]
pub fn regularity(runs: &[RunData]) -> Option<Regularity> {
    let range = |r: &RunData| {
        let of = |f: fn(f64, f64) -> f64, x: f64| r.command.iter().copied().fold(x, f);
        of(f64::max, f64::MIN) - of(f64::min, f64::MAX)
    };
    if lattice(runs).is_some() || runs.iter().any(|r| r.arrival_error > SAME_VALUE * range(r)) {
        return None;
    }
    let (mut delays, mut sent, mut lost, mut doubt) = (Vec::new(), 0.0, 0.0, 0.0_f64);
    for run in runs.iter().filter(|r| r.arrivals.len() > 3) {
        let end = run.arrivals.last().map_or(0, |a| a.index);
        sent += end as f64;
        lost += (end + 1 - run.arrivals.len().min(end + 1)) as f64;
        for a in run.arrivals.iter().skip(1) {
            delays.push(a.t_s - run.command_t_s[a.index]);
            doubt = doubt.max(2.0 * a.doubt_s);
        }
    }
    if delays.len() < 10 || sent <= 0.0 {
        return None;
    }
    // The shortest of many would be one odd row; the twentieth part is not.
    let least = crate::math::quantile(&delays, 0.05) - 0.5 * doubt;
    let square = |d: &f64| (d - least).max(0.0) * (d - least).max(0.0);
    Some(Regularity {
        sent,
        lost: lost / sent,
        least_s: least.max(0.0),
        range_s: crate::math::quantile(&delays, 0.98) - crate::math::quantile(&delays, 0.02),
        spread_s: (delays.iter().map(square).sum::<f64>() / delays.len() as f64).sqrt(),
        doubt_s: doubt,
    })
}
