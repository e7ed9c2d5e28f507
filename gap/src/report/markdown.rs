//! The verdict as Markdown that fits a terminal of 100 columns.

use std::fmt::Write as _;

use super::page::otherwise;
use super::stairs::{before, steps};
use super::subject::Subject;
use super::words::{capital, floor_explained, listed, metric, metric_row, number};
use super::{place, regimes};
use crate::sentence::{Cause, causes};
use crate::verdict::Verdict;

/// Columns of the text.
const WIDTH: usize = 96;

/// Adds `text` with line breaks between words; lines but the first are indented by `by`.
pub(super) fn wrap(s: &mut String, text: &str, by: usize) {
    let mut used = 0;
    for word in text.split_whitespace() {
        let length = word.chars().count();
        if used > 0 && used + 1 + length > WIDTH - by {
            let _ = write!(s, "\n{:by$}", "");
            used = 0;
        } else if used > 0 {
            s.push(' ');
            used += 1;
        }
        s.push_str(word);
        used += length;
    }
    s.push('\n');
}

fn paragraph(s: &mut String, text: &str) {
    s.push('\n');
    wrap(s, text, 0);
}

fn item(s: &mut String, mark: &str, text: &str) {
    s.push_str(mark);
    wrap(s, text, mark.len());
}

/// A table with columns as wide as their widest cell; what is too wide ends in dots.
pub(super) fn table(s: &mut String, rows: &[Vec<String>]) {
    const MOST: usize = 50;
    let columns = rows.first().map_or(0, Vec::len);
    let cut = |cell: &String| match cell.chars().count() {
        n if n > MOST => cell.chars().take(MOST - 1).collect::<String>() + "…",
        _ => cell.clone(),
    };
    let rows: Vec<Vec<String>> = rows.iter().map(|r| r.iter().map(cut).collect()).collect();
    let width = |k: usize| rows.iter().map(|r| r[k].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    s.push('\n');
    for (i, row) in rows.iter().enumerate() {
        for (cell, w) in row.iter().zip(&widths) {
            let _ = write!(s, "| {cell:w$} ");
        }
        s.push_str("|\n");
        if i == 0 {
            for w in &widths {
                let _ = write!(s, "|{}", "-".repeat(w + 2));
            }
            s.push_str("|\n");
        }
    }
}

/// Markdown: the parts of the page in its order, without pictures.
#[must_use]
pub fn markdown(v: &Verdict, subject: &Subject) -> String {
    let mut s = format!("# Sim-to-real gap: {}\n", subject.name);
    paragraph(&mut s, &format!("{}.", capital(&subject.line())));
    paragraph(&mut s, &format!("**{}**", subject.lead(v)));
    if v.partial {
        paragraph(&mut s, "Partial: the search was stopped before its end.");
    }
    s.push_str("\n## Where\n");
    paragraph(&mut s, &format!("{}.", capital(&place::answer(v, subject))));
    table(&mut s, &place::rows(v, subject));
    which(&mut s, v, subject);
    s.push_str("\n## How far\n");
    let (unit, all) = steps(v);
    let mut rows = vec![vec!["model".to_owned(), format!("error [{unit}]")]];
    rows.extend(all.iter().map(|x| vec![x.name.clone(), number(x.error)]));
    table(&mut s, &rows);
    let figure = capital(metric(&v.gap.metric));
    let text = format!(
        "{figure}, held-out runs. {} The last line is the {}.",
        before(subject),
        floor_explained(v)
    );
    paragraph(&mut s, &text);
    s.push_str("\n## What next\n\n");
    for text in subject.next(v) {
        item(&mut s, "- ", &text);
    }
    if let Some(file) = v.next_experiment.as_ref().and_then(|n| n.gait.as_ref()) {
        item(
            &mut s,
            "- ",
            &format!("The motion to play lies beside this report: `{file}`"),
        );
    }
    details(&mut s, v);
    s
}

fn card(s: &mut String, c: &Cause<'_>, v: &Verdict, subject: &Subject) {
    item(s, "- ", &format!("**{}**", capital(&subject.headline(c))));
    if let Some(text) = subject.filled(c) {
        item(s, "  ", &text);
    }
    if !c.members.is_empty() {
        let names: Vec<&str> = c.members.iter().map(|e| e.plain()).collect();
        item(
            s,
            "  ",
            &format!("It could as well be {}.", listed(&names, 9, "or")),
        );
    }
    if let Some(text) = subject.sure_of(v, c) {
        item(s, "  ", &text);
    }
}

fn which(s: &mut String, v: &Verdict, subject: &Subject) {
    s.push_str("\n## Which cause\n\n");
    let all = causes(v);
    if all.is_empty() {
        s.push_str("None.\n");
    }
    for c in &all {
        card(s, c, v, subject);
    }
    if let Some(text) = otherwise(v, subject) {
        paragraph(s, &text);
    }
}

fn details(s: &mut String, v: &Verdict) {
    s.push_str("\n## Details\n");
    let head = [
        "metric, held-out runs",
        "before",
        "calibrated",
        "with the causes",
    ];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    for (key, m) in &v.metrics {
        let (name, values) = metric_row(key, *m);
        rows.push(std::iter::once(name).chain(values).collect());
    }
    table(s, &rows);
    regimes::markdown(s, v);
    if !v.unseen.is_empty() {
        s.push_str("\nThese recordings could not show:\n\n");
    }
    for u in &v.unseen {
        item(
            s,
            "- ",
            &format!("{}: {}.", u.effect.plain(), u.why.trim_end_matches('.')),
        );
    }
    let p = &v.provenance;
    if !p.warnings.is_empty() {
        s.push_str("\nWarnings of the reader:\n\n");
    }
    for warning in &p.warnings {
        item(s, "- ", warning);
    }
    paragraph(
        s,
        &format!(
            "{}, seed {}, {}, data {}",
            p.tool, p.seed, p.split, p.data_sha256
        ),
    );
}
