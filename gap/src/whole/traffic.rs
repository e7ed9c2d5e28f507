//! Set-points on their way, played with known delays and jitter: in which row each is seen, and which no row sees.

use crate::math;

/// Log-likelihood that jitter must gain over a constant delay.
pub(super) const CLEAR: f64 = 12.0;
/// Share of set-points that vanish or stray now and then on any way.
const STRAY: f64 = 1e-3;
/// Rows that a delay may span.
pub(super) const BINS: usize = 24;

/// Traffic played with known jitter: share of the arrivals by row, and share that no row sees.
#[derive(Debug, Clone, Copy)]
pub(super) struct Played {
    rows: [f64; BINS],
    pub(super) unseen: f64,
}

/// What is played.
#[derive(Debug, Clone, Copy)]
struct Traffic {
    sigma_s: f64,
    delay_s: f64,
    spacing_s: f64,
    row_s: f64,
    /// Whether a late set-point holds up those behind it, or is thrown away when one overtakes it.
    queue: bool,
}

pub(super) fn bin(delay_s: f64, row_s: f64) -> usize {
    ((delay_s / row_s - 0.05).ceil().max(0.0) as usize).min(BINS - 1)
}

fn play(t: &Traffic, normals: &[f64]) -> Played {
    let mut arrival: Vec<f64> = normals
        .iter()
        .enumerate()
        .map(|(i, n)| i as f64 * t.spacing_s + t.delay_s + t.sigma_s * n.abs())
        .collect();
    if t.queue {
        for i in 1..arrival.len() {
            arrival[i] = arrival[i].max(arrival[i - 1]);
        }
    }
    let mut out = Played {
        rows: [0.0; BINS],
        unseen: 0.0,
    };
    let mut next = f64::INFINITY;
    let mut seen = 0.0;
    for (i, a) in arrival.iter().enumerate().rev() {
        let row = (a / t.row_s - 1e-6).ceil() * t.row_s;
        if row < next {
            out.rows[bin(row - i as f64 * t.spacing_s, t.row_s)] += 1.0;
            seen += 1.0;
        }
        next = next.min(*a);
    }
    out.rows.iter_mut().for_each(|r| *r /= f64::max(seen, 1.0));
    out.unseen = 1.0 - seen / arrival.len().max(1) as f64;
    out
}

/// Log-likelihood of the delays that `rows` counts and of `lost` set-points that no row saw. Those that the traffic does not hide were lost on
/// the way, which is one cause more.
fn likelihood(rows: &[f64; BINS], lost: f64, p: &Played) -> f64 {
    // A stray arrival must not decide: some may be anywhere.
    let delays: f64 = rows
        .iter()
        .zip(&p.rows)
        .map(|(n, p)| n * libm::log(p + STRAY / BINS as f64))
        .sum();
    let arrived: f64 = rows.iter().sum();
    let hidden = |share: f64| {
        let share = share.clamp(STRAY, 1.0 - STRAY);
        lost * libm::log(share) + arrived * libm::log(1.0 - share)
    };
    let own = (lost / (lost + arrived).max(1.0)).max(p.unseen);
    delays + hidden(p.unseen).max(hidden(own) - CLEAR)
}

/// Jitter, delay and unseen share that make the delays most likely; log-likelihood gained over a delay alone.
pub(super) fn jitter(
    rows: &[f64; BINS],
    lost: f64,
    spacing_s: f64,
    row_s: f64,
) -> (f64, f64, Played, f64) {
    // Played traffic must be smoother than the counted one: with 2000 packets the size came out 8 % off.
    const PACKETS: usize = 8000;
    let mut rng = math::Rng::new(1);
    let normals: Vec<f64> = (0..PACKETS).map(|_| rng.normal()).collect();
    let of = |sigma_s: f64, delay_s: f64, queue: bool| {
        let p = play(
            &Traffic {
                sigma_s,
                delay_s,
                spacing_s,
                row_s,
                queue,
            },
            &normals,
        );
        (sigma_s, delay_s, p, likelihood(rows, lost, &p))
    };
    let better = |a: (f64, f64, Played, f64), b: (f64, f64, Played, f64), by: f64| {
        if b.3 > a.3 + by { b } else { a }
    };
    let mut best = of(0.0, 0.0, true);
    let none = (0..80)
        .map(|i| of(0.0, 0.1 * row_s * f64::from(i), true).3)
        .fold(best.3, f64::max);
    for queue in [true, false] {
        for i in 0..80 {
            best = better(
                best,
                of(0.003 * libm::pow(1.06, f64::from(i)), 0.0, queue),
                0.0,
            );
        }
    }
    let plain = best;
    for queue in [true, false] {
        for i in 0..27 {
            for d in 1..32 {
                let sigma_s = 0.003 * libm::pow(1.19, f64::from(i));
                best = better(
                    best,
                    of(sigma_s, 0.25 * row_s * f64::from(d), queue),
                    if best.1 == 0.0 { CLEAR } else { 0.0 },
                );
            }
        }
    }
    let best = if best.3 > plain.3 + CLEAR {
        best
    } else {
        plain
    };
    (best.0, best.1, best.2, best.3 - none)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jitter_and_what_it_hides_are_told_from_a_delay() {
        let mut rng = math::Rng::new(7);
        let normals: Vec<f64> = (0..4000).map(|_| rng.normal()).collect();
        let traffic = Traffic {
            sigma_s: 0.04,
            delay_s: 0.0,
            spacing_s: 0.05,
            row_s: 0.025,
            queue: true,
        };
        let truth = play(&traffic, &normals);
        let seen = 4000.0 * (1.0 - truth.unseen);
        let rows = truth.rows.map(|r| seen * r);
        let (sigma, delay, played, gain) = jitter(&rows, 4000.0 - seen, 0.05, 0.025);
        assert!(
            (sigma / 0.04 - 1.0).abs() < 0.08 && delay == 0.0,
            "{sigma} {delay}"
        );
        assert!((played.unseen - truth.unseen).abs() < 0.02 && gain > 100.0);
    }
}
