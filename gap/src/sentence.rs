//! Parts of the sentence that says a verdict to a tired person.

use crate::verdict::Gap;

/// Causes named before the rest is counted.
const NAMED: usize = 3;

/// `a`, `a and b`, `a, b and c`, `a, b, c and 2 more`.
pub(crate) fn listed<S: AsRef<str>>(names: &[S]) -> String {
    let named = names.iter().take(NAMED).map(|n| n.as_ref().to_owned());
    let mut shown: Vec<String> = named.collect();
    if names.len() > NAMED {
        shown.push(format!("{} more", names.len() - NAMED));
    }
    match shown.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, others)) => format!("{} and {last}", others.join(", ")),
        None => String::new(),
    }
}

/// How far the held-out error falls, and how much of that calibration does alone.
pub(crate) fn fall(gap: &Gap) -> String {
    let percent = |after: f64| (100.0 * (1.0 - after / gap.before.max(f64::MIN_POSITIVE))).round();
    let (all, calibrated) = (percent(gap.after), percent(gap.after_calibration));
    if all <= 0.0 {
        return "The held-out error does not fall by it".into();
    }
    let fall = format!("The held-out error falls by {all} %");
    // Half of it is no small part.
    if 2.0 * calibrated >= all {
        format!("{fall}, {calibrated} % by calibration of known values alone")
    } else {
        fall
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lists_are_counted() {
        let names = ["a", "b", "c", "d", "e"];
        let table = [
            (0, ""),
            (1, "a"),
            (2, "a and b"),
            (3, "a, b and c"),
            (5, "a, b, c and 2 more"),
        ];
        for (count, text) in table {
            assert_eq!(listed(&names[..count]), text);
        }
    }
}
