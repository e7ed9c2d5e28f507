//! Transport read off the set-points sent and applied: clock, rounding, loss, jitter, and the rows between which a delay lies.
//!
//! Every sent value is followed to the row in which it is applied. A drift of the delays that all joints share is the clock, and values
//! on one grid are rounded. Delays that differ by more than neighbouring rows are jitter. Its size and the losses that it hides (a
//! value that is replaced before a row sees it) come from playing the same traffic with known sizes.

use super::clock::clock;
use super::conventions::Conventions;
use super::data::{Data, JOINTS, Run, Track};
use super::direct::{Reading, exact};
use super::traffic::{BINS, CLEAR, bin, jitter};
use crate::math;
use crate::vocabulary::Effect;

/// What is known of the way of one address's set-points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Echo {
    /// Set-points get lost, come unevenly or are changed in a way nobody knows: what was applied is taken.
    pub(super) uneven: bool,
    /// Robot clock over the recording's.
    pub(super) skew: f64,
    /// Step that set-points are rounded to, rad; 0 = none.
    pub(super) step_rad: f64,
    /// Between which delays all set-points come, s; `None` where not measured or uneven.
    pub(super) late_s: Option<[f64; 2]>,
    /// Something happens on the way that no effect of the library explains.
    pub(super) odd: bool,
}

impl Echo {
    /// Nothing is known to happen.
    pub(super) const NEUTRAL: Self = Self {
        uneven: false,
        skew: 1.0,
        step_rad: 0.0,
        late_s: None,
        odd: false,
    };

    /// Set-points as they act: those sent, on the robot's clock and rounded, or those applied.
    pub(super) fn command(&self, sent: Option<&Track>, applied: Option<&Track>) -> Option<Track> {
        if self.uneven
            && let Some(a) = applied
        {
            // A row shows what came at some time since the row before.
            let half = 0.5 * a.period_s();
            let mut out = a.clone();
            out.t_s.iter_mut().for_each(|t| *t = (*t - half).max(0.0));
            return Some(out);
        }
        let mut out = sent.or(applied)?.clone();
        out.t_s.iter_mut().for_each(|t| *t /= self.skew);
        if let (Some(a), Some(last)) = (applied, out.t_s.last().copied()) {
            // A robot whose clock is fast ends with set-points that were sent after the recording; its echo has them.
            let half = 0.5 * a.period_s();
            for (t, v) in a.t_s.iter().zip(&a.v).filter(|(t, _)| **t > last + half) {
                out.t_s.push(t - half);
                out.v.push(*v);
            }
        }
        if self.step_rad > 0.0
            && let Some(a) = applied
        {
            let anchor = a.v[0];
            out.v
                .iter_mut()
                .for_each(|v| *v = rounded(*v, anchor, self.step_rad));
        }
        Some(out)
    }
}

/// Values are printed to 10 urad.
const EXACT_RAD: f64 = 2e-5;
/// Longer than any delay that a gait survives, s.
const LONGEST_S: f64 = 0.4;
/// Least share of lost set-points that counts: one in a hundred is a damaged frame now and then.
const LEAST_LOSS: f64 = 0.015;
/// Least step that counts as rounding, rad: twice the resolution of a 12-bit encoder.
const LEAST_STEP_RAD: f64 = 3e-3;
/// Least set-points followed.
const LEAST_SENT: f64 = 50.0;
/// Neighbouring values that must differ for a value to be followed.
const NEIGHBOURS: usize = 8;
/// Share of set-points that come in another row than a constant delay says, up to which delays count as one.
pub(super) const STRAY: f64 = 0.004;
/// Least set-points in another row than a constant delay says that may be the tail of a jitter.
const TAIL: f64 = 4.0;
/// Delays that are told apart within a row.
const GRAINS: f64 = 20.0;
/// Resolution of printed times, s.
pub(super) const TICK_S: f64 = 6e-4;

fn rounded(v: f64, anchor: f64, step: f64) -> f64 {
    anchor + ((v - anchor) / step).round() * step
}

/// Times and values at which a held signal changes.
fn changes(track: &Track, least: f64) -> Vec<(f64, f64)> {
    let mut out: Vec<(f64, f64)> = Vec::new();
    for (t, v) in track.t_s.iter().zip(&track.v) {
        if out.last().is_none_or(|l| (l.1 - v).abs() > least) {
            out.push((*t, *v));
        }
    }
    out
}

/// Distinct values of a held signal, sorted.
fn levels(track: &Track) -> Vec<f64> {
    let mut levels = track.v.clone();
    levels.sort_by(f64::total_cmp);
    levels.dedup_by(|a, b| (*a - *b).abs() < 2.0 * EXACT_RAD);
    levels
}

/// The step of the grid that all applied values lie on and most of those sent do not; 0 without one, `None` where nothing moved.
fn grid(sent: &Track, applied: &Track) -> Option<f64> {
    let (given, seen) = (levels(sent), levels(applied));
    if given.len() < 8 || seen.len() < 2 {
        return None;
    }
    let gaps = seen.windows(2).map(|w| w[1] - w[0]);
    let mut step = gaps.fold(f64::INFINITY, f64::min);
    if step < LEAST_STEP_RAD {
        return Some(0.0);
    }
    let mut index = 0.0;
    for w in seen.windows(2) {
        let count = ((w[1] - w[0]) / step).round();
        index += count;
        let place = w[1] - seen[0];
        if (place - index * step).abs() > EXACT_RAD * (2.0 + count) {
            return Some(0.0);
        }
        step = place / index;
    }
    let off = |v: &&f64| (rounded(**v, seen[0], step) - **v).abs() > 3.0 * EXACT_RAD;
    Some(if 2 * given.iter().filter(off).count() > given.len() {
        step
    } else {
        0.0
    })
}

/// One set-point that was followed: sent at, and how much later it was seen; `None` = never.
type Followed = (f64, Option<f64>);

/// Follows every sent value that no neighbour shares.
fn follow(sent: &Track, applied: &Track, step: f64) -> Vec<Followed> {
    let arrived = changes(applied, 0.0);
    let mut all = changes(sent, 0.0);
    if step > 0.0 {
        all.iter_mut()
            .for_each(|s| s.1 = rounded(s.1, applied.v[0], step));
        all.dedup_by(|b, a| (a.1 - b.1).abs() < EXACT_RAD);
    }
    let end = applied.t_s[applied.t_s.len() - 1] - LONGEST_S;
    let mut out = Vec::new();
    let (mut from, mut expected) = (0, 0.0);
    for (i, (t, v)) in all.iter().enumerate() {
        let near = &all[i.saturating_sub(NEIGHBOURS)..(i + NEIGHBOURS + 1).min(all.len())];
        let same = near
            .iter()
            .filter(|n| (n.1 - v).abs() <= 5.0 * EXACT_RAD)
            .count();
        // The first value was in force before the recording began.
        if i == 0 || same > 1 || t + expected > end {
            continue;
        }
        let window = |a: &&(f64, f64)| (a.0 - t - expected).abs() <= LONGEST_S;
        let hit = arrived[from..]
            .iter()
            .position(|a| window(&a) && (a.1 - v).abs() <= 2.0 * EXACT_RAD);
        let delay = hit.map(|h| {
            from += h;
            arrived[from].0 - t
        });
        if let Some(d) = delay {
            expected += 0.3 * (d - expected);
        }
        out.push((*t, delay));
    }
    out
}

/// Slope of delay over time, and its error; `None` with too few.
fn drift(followed: &[Followed]) -> Option<f64> {
    let hits: Vec<(f64, f64)> = followed.iter().filter_map(|f| Some((f.0, f.1?))).collect();
    let n = hits.len() as f64;
    if n < 20.0 {
        return None;
    }
    let (mt, md) = (
        hits.iter().map(|h| h.0).sum::<f64>() / n,
        hits.iter().map(|h| h.1).sum::<f64>() / n,
    );
    let (mut xx, mut xy) = (0.0, 0.0);
    for (t, d) in &hits {
        xx += (t - mt) * (t - mt);
        xy += (t - mt) * (d - md);
    }
    (xx > 1.0).then(|| xy / xx)
}

/// Sent and applied set-points of one address in one run; the echo stands in column `echo_at`.
fn pair(run: &Run, address: usize, echo_at: usize) -> Option<(&Track, &Track)> {
    let sent = run.joints[address].command.as_ref()?;
    Some((sent, run.joints[echo_at].applied.as_ref()?))
}

fn reading(
    effect: Effect,
    joint: Option<usize>,
    key: &'static str,
    value: f64,
    half: f64,
) -> Reading {
    Reading {
        effect,
        joint,
        key,
        estimate: exact(value, half),
    }
}

/// Set-points that do not all take the same time.
struct Spread {
    /// Share that no row can have seen.
    unseen: f64,
    /// No jitter that is known looks like it.
    odd: bool,
}

/// The best of constant delays.
struct Constant {
    /// Arrivals that it does not explain.
    stray: f64,
    /// Between which values it lies, s.
    late_s: [f64; 2],
}

/// What one address showed.
pub(super) struct Address {
    step_rad: f64,
    pub(super) row_s: f64,
    spacing_s: f64,
    /// Length of the longest run, s.
    pub(super) length_s: f64,
    runs: Vec<Vec<Followed>>,
}

impl Address {
    fn new(data: &Data, address: usize, echo_at: usize) -> Option<Self> {
        let runs = data.runs.iter();
        let pairs: Vec<(&Track, &Track)> = runs.filter_map(|r| pair(r, address, echo_at)).collect();
        let first = pairs.first()?;
        let known: Vec<f64> = pairs.iter().filter_map(|p| grid(p.0, p.1)).collect();
        let steps: Vec<f64> = known.iter().copied().filter(|s| *s > 0.0).collect();
        let step_rad = if 2 * steps.len() > known.len() {
            math::median(&steps)
        } else {
            0.0
        };
        // Where a joint hardly moves, neighbouring set-points are printed alike: the run with most of them shows their rate.
        let spacing = |p: &(&Track, &Track)| {
            let all = changes(p.0, 0.0);
            let gaps: Vec<f64> = all.windows(2).map(|w| w[1].0 - w[0].0).collect();
            (gaps.len() >= 10).then(|| math::median(&gaps))
        };
        let row_s = first.1.period_s();
        let spacing_s = pairs
            .iter()
            .filter_map(spacing)
            .fold(f64::INFINITY, f64::min);
        Some(Self {
            step_rad,
            row_s,
            spacing_s: if spacing_s.is_finite() {
                spacing_s.max(row_s)
            } else {
                row_s
            },
            length_s: data.runs.iter().map(|r| r.length_s).fold(0.0, f64::max),
            runs: pairs.iter().map(|p| follow(p.0, p.1, step_rad)).collect(),
        })
    }

    pub(super) fn drift(&self) -> Option<(f64, f64)> {
        let slopes: Vec<f64> = self.runs.iter().filter_map(|r| drift(r)).collect();
        let middle = math::median(&slopes);
        let spread = math::rms(&slopes.iter().map(|s| s - middle).collect::<Vec<_>>());
        (!slopes.is_empty()).then(|| (middle, spread / (slopes.len() as f64).sqrt()))
    }

    pub(super) fn sent(&self) -> f64 {
        self.runs.iter().map(|r| r.len() as f64).sum()
    }

    /// Arrivals by rows of delay on the robot's clock, and the number never seen.
    fn rows(&self, slope: f64) -> ([f64; BINS], f64) {
        let (mut rows, mut lost) = ([0.0; BINS], 0.0);
        for (t, delay) in self.runs.iter().flatten() {
            match delay {
                Some(d) => rows[bin(d - slope * t, self.row_s)] += 1.0,
                None => lost += 1.0,
            }
        }
        (rows, lost)
    }

    /// Arrivals seen in another row than `delay` on a clock that drifts by `slope` says.
    pub(super) fn stray(&self, slope: f64, delay: f64) -> f64 {
        let row = |t: f64| ((t * (1.0 + slope) + delay - TICK_S) / self.row_s).ceil() * self.row_s;
        let off = |f: &&Followed| {
            f.1.is_some_and(|d| (row(f.0) - f.0 - d).abs() > 0.5 * self.row_s)
        };
        self.runs.iter().flatten().filter(off).count() as f64
    }

    /// The delays at which, were all the same, fewest arrivals would be seen in another row than they were.
    fn constant(&self, slope: f64) -> Constant {
        let fine = self.row_s / GRAINS;
        let all: Vec<f64> = (0..(LONGEST_S / fine) as usize)
            .map(|i| self.stray(slope, i as f64 * fine))
            .collect();
        let least = all.iter().copied().fold(f64::INFINITY, f64::min);
        let near = |s: &&f64| **s <= least + STRAY * self.sent();
        let low = all.iter().position(|s| near(&s)).unwrap_or(0) as f64;
        let high = all.iter().rposition(|s| near(&s)).unwrap_or(0) as f64;
        // No delay at all is the one that no row adds to.
        let late_s = if high == 0.0 {
            [-self.row_s, 0.0]
        } else {
            [(low - 1.0) * fine, (high + 1.0) * fine]
        };
        Constant {
            stray: least,
            late_s,
        }
    }

    /// The step that set-points of `joint` are rounded to, where they are.
    fn rounding(&self, joint: usize, out: &mut Vec<Reading>) {
        if self.step_rad > 0.0 {
            out.push(reading(
                Effect::Quantisation,
                Some(joint),
                "step_rad",
                self.step_rad,
                EXACT_RAD,
            ));
        }
    }

    /// Jitter of `joint` and the delay beside it, where arrivals by rows, and the number `lost`, are not those of a constant delay.
    fn spread(
        &self,
        joint: usize,
        slope: f64,
        constant: &Constant,
        (rows, lost): (&[f64; BINS], f64),
        out: &mut Vec<Reading>,
    ) -> Option<Spread> {
        let arrived: f64 = rows.iter().sum();
        // Where the clock drifts, rows are met at every phase, and 1.5 to 2 % of them at the very edge.
        let few = if slope == 0.0 { STRAY } else { 10.0 * STRAY };
        let wide = constant.stray > (few * arrived).max(8.0);
        // A few late ones are the tail of a jitter that mostly hides within a row.
        let tail = slope == 0.0 && constant.stray >= TAIL && constant.late_s[1] > 0.0;
        if !wide && !tail {
            return None;
        }
        let (sigma, delay, played, gain) = jitter(rows, lost, self.spacing_s, self.row_s);
        let clear = sigma > 0.0 && gain > CLEAR;
        if !wide && !clear {
            return None;
        }
        if clear {
            let half = 1.96 * sigma / (2.0 * arrived).sqrt() + 0.03 * sigma;
            let (effect, key) = (Effect::Jitter, "sigma_s");
            out.push(reading(effect, Some(joint), key, sigma, half));
        }
        if delay > 0.0 {
            let error = 0.3 * self.row_s;
            out.push(reading(
                Effect::Latency,
                Some(joint),
                "delay_s",
                delay,
                error,
            ));
        }
        Some(Spread {
            unseen: played.unseen,
            odd: !clear,
        })
    }

    /// Loss and jitter of `joint`, and what the joint needs to know.
    fn judge(&self, joint: usize, slope: f64, out: &mut Vec<Reading>) -> Echo {
        let (rows, lost) = self.rows(slope);
        let arrived: f64 = rows.iter().sum();
        let mut echo = Echo {
            skew: 1.0 / (1.0 + slope),
            step_rad: self.step_rad,
            ..Echo::NEUTRAL
        };
        self.rounding(joint, out);
        if self.sent() < LEAST_SENT {
            return echo;
        }
        // Values that mostly never appear have been changed on the way.
        if arrived < 0.3 * self.sent() {
            return Echo {
                uneven: true,
                odd: true,
                ..Echo::NEUTRAL
            };
        }
        let constant = self.constant(slope);
        let spread = self.spread(joint, slope, &constant, (&rows, lost), out);
        let unseen = spread.as_ref().map_or(0.0, |s| s.unseen);
        if let Some(s) = &spread {
            echo.odd = s.odd;
        }
        let loss = 1.0 - arrived / self.sent() / (1.0 - unseen);
        let error = (loss.abs().max(0.01) / self.sent()).sqrt() + 0.2 * unseen;
        if loss > LEAST_LOSS + 3.0 * error {
            out.push(reading(
                Effect::PacketLoss,
                Some(joint),
                "probability",
                loss,
                1.96 * error,
            ));
        }
        echo.uneven = spread.is_some() || lost > LEAST_LOSS * self.sent();
        if !echo.uneven {
            echo.late_s = Some(constant.late_s);
        }
        echo
    }
}

/// Reads the transport of every joint off its echo, and tells `conventions` what the joints need to know.
pub(super) fn read(data: &Data, conventions: &mut Conventions, out: &mut Vec<Reading>) {
    let addresses: Vec<Option<Address>> = (0..JOINTS)
        .map(|a| Address::new(data, a, conventions.echo_at[a]))
        .collect();
    let mut slope = 0.0;
    if let Some((s, error)) = clock(&addresses) {
        slope = s;
        out.push(reading(
            Effect::ClockSkew,
            None,
            "ratio",
            1.0 / (1.0 + s),
            1.96 * error,
        ));
    }
    let mut all = [Echo::NEUTRAL; JOINTS];
    for (address, echo) in all.iter_mut().enumerate() {
        let joint = conventions
            .order
            .iter()
            .position(|o| *o == address)
            .unwrap_or(address);
        if let Some(a) = &addresses[address] {
            *echo = a.judge(joint, slope, out);
        }
    }
    conventions.echo = std::array::from_fn(|k| all[conventions.order[k]]);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Set-points every 50 ms, seen in rows of 25 ms after delays that `delay_s` gives.
    fn address(delay_s: &mut dyn FnMut() -> f64) -> Address {
        let row_s = 0.025;
        let one = |i: u32| {
            let sent = 0.05 * f64::from(i);
            let seen = ((sent + delay_s()) / row_s - 1e-6).ceil() * row_s;
            (sent, Some(seen - sent))
        };
        Address {
            step_rad: 0.0,
            row_s,
            spacing_s: 0.05,
            length_s: 200.0,
            runs: vec![(0..4000).map(one).collect()],
        }
    }

    #[test]
    fn a_jitter_that_mostly_hides_within_a_row_shows_by_its_tail() {
        let mut rng = math::Rng::new(5);
        let mut out = Vec::new();
        let jitters = address(&mut || 0.009 * rng.normal().abs());
        let echo = jitters.judge(2, 0.0, &mut out);
        let said = out.iter().map(|r| (r.effect, r.joint)).collect::<Vec<_>>();
        assert_eq!(said, [(Effect::Jitter, Some(2))]);
        let sigma_s = out[0].estimate.value;
        assert!((sigma_s / 0.009 - 1.0).abs() < 0.1, "{sigma_s}");
        assert!(echo.uneven && !echo.odd);
        for delay_s in [0.0, 0.006, 0.0249, 0.031] {
            out.clear();
            let echo = address(&mut || delay_s).judge(2, 0.0, &mut out);
            assert!(out.is_empty() && !echo.uneven, "{delay_s} {out:?}");
        }
    }

    /// Six runs of 12 s on a clock whose delays grow by `slope`, with a delay of its own for every set-point; drivers look once a millisecond.
    fn slipping(slope: f64, delay_s: &mut dyn FnMut() -> f64) -> Address {
        let row_s = 0.025;
        let mut one = |i: u32| {
            let sent = 0.05 * f64::from(i);
            let arrived = (1e3 * (sent * (1.0 + slope) + delay_s()) - 1e-6).ceil() / 1e3;
            let seen = (arrived / row_s - 1e-6).ceil() * row_s;
            (sent, Some(seen - sent))
        };
        Address {
            step_rad: 0.0,
            row_s,
            spacing_s: 0.05,
            length_s: 12.0,
            runs: (0..6).map(|_| (0..239).map(&mut one).collect()).collect(),
        }
    }

    #[test]
    fn a_clock_that_slips_by_a_row_or_two_is_told_from_jitter() {
        let mut rng = math::Rng::new(8);
        let six = |slope: f64, jitters: usize, rng: &mut math::Rng| -> Vec<Option<Address>> {
            let one = |k: usize| {
                let mut late = || 0.02 * rng.normal().abs();
                let mut none = || 0.0;
                let delay_s: &mut dyn FnMut() -> f64 =
                    if k < jitters { &mut late } else { &mut none };
                Some(slipping(slope, delay_s))
            };
            (0..JOINTS).map(one).collect()
        };
        for (slope, jitters) in [(0.00225, 0), (0.0042, 2), (-0.0042, 0)] {
            let found = clock(&six(slope, jitters, &mut rng));
            let near = found.is_some_and(|(s, _)| (s - slope).abs() < 1.5e-4);
            assert!(near, "{slope} {jitters} {found:?}");
        }
        for jitters in [0, 2, 4] {
            let found = clock(&six(0.0, jitters, &mut rng));
            assert!(found.is_none(), "{jitters} {found:?}");
        }
    }

    #[test]
    fn a_grid_is_found_with_its_step_and_nothing_else_is_one() {
        let track = |f: &dyn Fn(f64) -> f64| Track {
            t_s: (0..400).map(|i| 0.025 * f64::from(i)).collect(),
            v: (0..400).map(|i| f(0.025 * f64::from(i))).collect(),
        };
        let smooth = |t: f64| (1e5 * 0.7 * math::sin(1.3 * t)).round() / 1e5;
        let coarse = |t: f64| (1e5 * (rounded(smooth(t), 0.0, 0.02) - 0.0013)).round() / 1e5;
        let step = grid(&track(&smooth), &track(&coarse));
        assert!(step.is_some_and(|s| (s - 0.02).abs() < 1e-5), "{step:?}");
        assert_eq!(grid(&track(&smooth), &track(&smooth)), Some(0.0));
        assert_eq!(grid(&track(&coarse), &track(&coarse)), Some(0.0));
    }
}
