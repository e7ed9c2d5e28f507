//! Text on its way to a terminal: what stands in files and answers of robots must not steer it.

use std::borrow::Cow;
use std::fmt::Write as _;

/// Longest line of a message in characters. A line of a file that is quoted in full can be far longer.
const LONGEST_LINE: usize = 700;
/// Characters kept at the begin of a longer line.
const KEPT_HEAD: usize = 450;
/// Characters kept at its end, where messages say what is allowed.
const KEPT_TAIL: usize = 200;

/// Characters that steer a terminal or change the order in which text is shown: C0 and C1 controls, DEL, bidirectional marks.
fn steers(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Text for people: lines and tabs stay, everything else that steers a terminal is written as `\u{1b}`.
#[must_use]
pub fn clean(text: &str) -> Cow<'_, str> {
    let bad = |c: char| steers(c) && c != '\n' && c != '\t';
    if !text.contains(bad) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if bad(c) {
            out.extend(c.escape_unicode());
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// One JSON document: what its writer leaves as it is and a terminal obeys is written as `\u009b`.
#[must_use]
pub fn clean_json(text: &str) -> Cow<'_, str> {
    if !text.contains(steers) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if steers(c) && c != '\n' {
            // All of them lie in the first plane. Outside of strings JSON holds none of them.
            let _ = write!(out, "\\u{:04x}", u32::from(c));
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// A message whose lines are cut in the middle where they quote very long values.
#[must_use]
pub fn cut(text: &str) -> Cow<'_, str> {
    if text.lines().all(|line| line.len() <= LONGEST_LINE) {
        return Cow::Borrowed(text);
    }
    let lines: Vec<Cow<'_, str>> = text.lines().map(cut_line).collect();
    Cow::Owned(lines.join("\n"))
}

fn cut_line(line: &str) -> Cow<'_, str> {
    let count = line.chars().count();
    if count <= LONGEST_LINE {
        return Cow::Borrowed(line);
    }
    let head: String = line.chars().take(KEPT_HEAD).collect();
    let tail: String = line.chars().skip(count - KEPT_TAIL).collect();
    let left_out = count - KEPT_HEAD - KEPT_TAIL;
    Cow::Owned(format!("{head} [{left_out} characters left out] {tail}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_steers_a_terminal_is_written_out() {
        for (given, expected) in [
            ("plain, äöü 漢\n\ttab", "plain, äöü 漢\n\ttab"),
            ("\u{1b}]0;title\u{7}", "\\u{1b}]0;title\\u{7}"),
            ("\u{9b}31m", "\\u{9b}31m"),
            ("a\rb\u{8}c\u{7f}", "a\\u{d}b\\u{8}c\\u{7f}"),
            ("\u{202e}txt.exe", "\\u{202e}txt.exe"),
        ] {
            assert_eq!(clean(given), expected);
        }
    }

    #[test]
    fn json_stays_the_same_document() {
        let value = serde_json::json!({ "a\u{9b}": "\u{1b}[2J\u{7f}\u{202e}\n", "b": "äß" });
        let text = serde_json::to_string_pretty(&value).unwrap();
        let safe = clean_json(&text);
        assert!(!safe.contains(|c| steers(c) && c != '\n'), "{safe}");
        let back: serde_json::Value = serde_json::from_str(&safe).unwrap();
        assert_eq!(back, value);
    }

    #[test]
    fn long_values_are_cut_in_the_middle() {
        let long = format!("f.toml:3: `{}` must lie in 0 .. 1", "x".repeat(20_000));
        let shown = cut(&long);
        assert!(shown.len() < 800 && shown.starts_with("f.toml:3: `xxx"));
        assert!(shown.contains("characters left out") && shown.ends_with("0 .. 1"));
        assert_eq!(cut("short\nlines"), "short\nlines");
    }
}
