//! When set-points were sent that a log shows: a row shows what was sent since the row before it.

/// Times that the bracket of a period shrinks to two thirds: to the last bits of an f64.
const STEPS: usize = 120;

/// Set-points that a column of a log shows: when each was sent, s from the first row, and its value.
pub(super) fn sent(rows_s: &[f64], column: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let (mut sent_s, mut before_s, mut values) = (Vec::new(), Vec::new(), Vec::new());
    let (mut last_s, mut held) = (f64::NAN, f64::NAN);
    for (t, value) in rows_s.iter().zip(column).filter(|row| row.1.is_finite()) {
        let at_s = t - rows_s[0];
        if *value != held {
            held = *value;
            sent_s.push(at_s);
            before_s.push(last_s);
            values.push(held);
        }
        last_s = at_s;
    }
    // When the first was sent is not known.
    if let ([_, shown_s @ ..], [_, before_s @ ..]) = (&mut sent_s[..], &before_s[..])
        && let Some(regular_s) = regular(shown_s, before_s)
    {
        shown_s.copy_from_slice(&regular_s);
    }
    (sent_s, values)
}

/// The latest instants of a sender with a period of its own that a log agrees with; `None` where it agrees with none, and
/// where most set-points are shown once: such a log has rows of the instants themselves.
///
/// `shown_s` are the instants of the rows that first show a new set-point, `before_s` those of the last rows that show the
/// one before. A set-point sent at 20 Hz and logged at 50 Hz shows in every second and every third row by turns, and is
/// 5 ms later in the log than on the wire by mean. A period of whole rows gives the rows themselves.
fn regular(shown_s: &[f64], before_s: &[f64]) -> Option<Vec<f64>> {
    let row_s = shown_s.iter().zip(before_s).map(|(t, b)| t - b);
    let row_s = row_s.fold(0.0, f64::max);
    let gaps = || shown_s.windows(2).map(|w| w[1] - w[0]);
    let least_s = gaps().fold(f64::INFINITY, f64::min);
    // A period between `n` and `n + 1` rows shows as either.
    let near: Vec<f64> = gaps().filter(|g| *g < least_s + 1.5 * row_s).collect();
    let held = before_s.iter().skip(1).zip(shown_s);
    let held = held.filter(|(before, shown)| before > shown).count();
    if near.is_empty() || least_s <= 0.0 || 2 * held < shown_s.len() {
        return None;
    }
    let mean_s = near.iter().sum::<f64>() / near.len() as f64;
    let mut ticks = vec![0.0];
    ticks.extend(gaps().scan(0.0, |at, gap| {
        *at += (gap / mean_s).round();
        Some(*at)
    }));
    let last = ticks.last().copied().unwrap_or(1.0).max(1.0);
    let ends = |period_s: f64| {
        let each = shown_s.iter().zip(&ticks).map(|(t, k)| t - k * period_s);
        each.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| {
            [low.min(x), high.max(x)]
        })
    };
    let width_s = |period_s: f64| {
        let [low, high] = ends(period_s);
        high - low
    };
    // The width of the strip that holds all rows is convex in the period. A mean gap is off by rows at its ends only.
    let [mut low_s, mut high_s] = [-2.0, 2.0].map(|rows| mean_s + rows * row_s / last);
    for _ in 0..STEPS {
        let third = (high_s - low_s) / 3.0;
        if width_s(low_s + third) <= width_s(high_s - third) {
            high_s -= third;
        } else {
            low_s += third;
        }
    }
    let period_s = 0.5 * (low_s + high_s);
    let [first_s, _] = ends(period_s);
    let out: Vec<f64> = ticks.iter().map(|k| first_s + k * period_s).collect();
    // Rounding must not put an instant before the row that does not show it yet.
    let slack_s = 1e-6 * row_s;
    let since = out.iter().zip(before_s).all(|(t, b)| *t > b - slack_s);
    since.then_some(out)
}

#[cfg(test)]
mod tests {
    use super::regular;

    /// Rows every `row_s` that first show what is sent every `period_s` from `phase_s` on, but for every `skip`-th.
    fn logged(row_s: f64, period_s: f64, phase_s: f64, skip: usize) -> [Vec<f64>; 3] {
        let sent: Vec<f64> = (1..160)
            .filter(|k| k % skip != 0)
            .map(|k| phase_s + period_s * f64::from(k as u32))
            .collect();
        let row = |t: &f64| (t / row_s - 1e-9).ceil();
        let shown = sent.iter().map(|t| row_s * row(t)).collect();
        let before = sent.iter().map(|t| row_s * (row(t) - 1.0)).collect();
        [sent, shown, before]
    }

    fn farthest(a: &[f64], b: &[f64]) -> f64 {
        a.iter()
            .zip(b)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max)
    }

    #[test]
    fn what_was_sent_at_20_hz_is_found_in_a_log_of_50_hz() {
        for skip in [1000, 7] {
            let [sent, shown, before] = logged(0.02, 0.05, 0.0, skip);
            assert!(farthest(&sent, &shown) > 0.009);
            let found = regular(&shown, &before).expect("a period");
            assert!(farthest(&sent, &found) < 1e-9, "{skip}");
        }
    }

    #[test]
    fn whole_rows_stay_and_another_period_is_found_to_a_tenth_of_a_row() {
        let [sent, shown, before] = logged(0.01, 0.05, 0.0, 1000);
        assert!(farthest(&sent, &regular(&shown, &before).expect("a period")) < 1e-12);
        let [sent, shown, before] = logged(0.01, 0.033, 0.004, 1000);
        assert!(farthest(&sent, &regular(&shown, &before).expect("a period")) < 0.001);
    }

    #[test]
    fn instants_without_a_period_are_left_alone() {
        let [_, mut shown, mut before] = logged(0.02, 0.05, 0.0, 1000);
        shown[40] += 0.04;
        before[40] += 0.04;
        assert_eq!(regular(&shown, &before), None);
        assert_eq!(regular(&[1.0], &[0.98]), None);
        let events = [0.0, 0.05, 0.11, 0.15, 0.2, 0.26, 0.3];
        assert_eq!(regular(&events[1..], &events), None);
    }
}
