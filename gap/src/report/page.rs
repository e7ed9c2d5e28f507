//! The page that every report shares: what a tired person needs first, details folded below.

use std::fmt::Write as _;

use super::place;
use super::regimes;
use super::stairs::{Step, before, steps};
use super::style::HEAD;
use super::subject::Subject;
use super::words::{
    capital, escape, floor, listed, metric, metric_row, number, parameter, quantity, regime, size,
};
use crate::sentence::{Cause, causes, percent, sure};
use crate::verdict::{Verdict, Where, Word};
use crate::vocabulary::Effect;

/// What only the kind of the data set can draw.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Evidence {
    /// Plots and tables, HTML.
    pub plots: String,
    /// Robot and simulator under a time slider, HTML; empty without one.
    pub replay: String,
}

/// A table under a heading; cells are HTML.
pub(crate) fn table(s: &mut String, head: &[&str], rows: &[Vec<String>]) {
    s.push_str("<div class=\"wide\"><table><thead><tr>");
    for h in head {
        let _ = write!(s, "<th scope=\"col\">{h}</th>");
    }
    s.push_str("</tr></thead><tbody>");
    for row in rows {
        s.push_str("<tr>");
        for cell in row {
            let _ = write!(s, "<td>{cell}</td>");
        }
        s.push_str("</tr>");
    }
    s.push_str("</tbody></table></div>");
}

/// One self-contained page.
#[must_use]
pub fn html(v: &Verdict, subject: &Subject, evidence: &Evidence) -> String {
    let name = escape(&subject.name);
    let mut s = format!("{HEAD}<title>Sim-to-real gap: {name}</title></head><body><main>");
    let whole = subject.lead(v);
    // The first sentence stands out.
    let (lead, doubts) = match whole.find(". ") {
        Some(end) => (&whole[..=end], &whole[end + 2..]),
        None => (whole.as_str(), ""),
    };
    let _ = write!(
        s,
        "<header><h1>Sim-to-real gap: {name}</h1><p class=\"about\">{}</p><p class=\"lead\">{}</p>",
        escape(&capital(&subject.line())),
        escape(lead)
    );
    if !doubts.is_empty() {
        let _ = write!(s, "<p class=\"doubt\">{}</p>", escape(doubts));
    }
    if v.partial {
        s.push_str("<p class=\"warning\">Partial: the search was stopped before its end.</p>");
    }
    s.push_str("</header><div class=\"first\"><section id=\"where\"><h2>Where</h2>");
    place::picture(&mut s, v, subject);
    s.push_str("</section>");
    contents(&mut s, v, subject, !evidence.replay.is_empty());
    s.push_str("</div><section id=\"which\"><h2>Which cause</h2>");
    cards(&mut s, v, subject);
    s.push_str("</section><section id=\"far\"><h2>How far</h2>");
    stairs(&mut s, v, subject);
    s.push_str("</section><section id=\"next\"><h2>What next</h2>");
    next(&mut s, v, subject);
    s.push_str("</section>");
    if !evidence.replay.is_empty() {
        let _ = write!(
            s,
            "<section id=\"replay\"><h2>Replay</h2>{}</section>",
            evidence.replay
        );
    }
    s.push_str("<section id=\"details\"><h2>Details</h2>");
    details(&mut s, v, subject, evidence);
    s.push_str("</section></main></body></html>\n");
    s
}

/// Text with what stands between backticks as code.
fn coded(text: &str) -> String {
    let text = escape(text);
    let parts = text.split('`').enumerate();
    let one = |(k, part): (usize, &str)| match k % 2 {
        1 => format!("<code>{part}</code>"),
        _ => part.into(),
    };
    parts.map(one).collect()
}

/// The part of `text` up to its first clause.
fn short(text: &str) -> &str {
    let end = [". ", "; ", ": "].iter().filter_map(|e| text.find(e)).min();
    let end = end.filter(|k| *k > 24).unwrap_or(text.len());
    text[..end].trim_end_matches('.')
}

/// The contents list, which answers each question in a few words.
fn contents(s: &mut String, v: &Verdict, subject: &Subject, replay: bool) {
    let which = match subject.which(v) {
        _ if v.verdict == Word::Unknown => "no effect of the library".into(),
        names if names.is_empty() && v.verdict == Word::None => "none".into(),
        names if names.is_empty() => "calibration of stated and default values".into(),
        names => listed(&names, 3, "and"),
    };
    let next = subject.next(v);
    let first = next
        .first()
        .map_or("", |n| match n.strip_prefix("State this first: ") {
            Some(_) => n.split(", under").next().unwrap_or(n),
            None => short(n),
        });
    s.push_str("<nav aria-label=\"Contents\"><h2>In short</h2><ul>");
    for (id, question, answer) in [
        ("where", "Where", place::answer(v, subject)),
        ("which", "Which", which),
        ("far", "How far", subject.distance(v)),
        ("next", "What next", first.to_owned()),
    ] {
        let answer = coded(&answer);
        let _ = write!(
            s,
            "<li><a href=\"#{id}\">{question}</a> <span>{answer}</span></li>"
        );
    }
    if replay {
        s.push_str("<li><a href=\"#replay\">Replay</a> <span>a held-out run</span></li>");
    }
    s.push_str("<li><a href=\"#details\">Details</a> <span>curves, shares, metrics, limits</span></li></ul></nav>");
}

/// One line of a card.
fn line(s: &mut String, name: &str, value: &str) {
    if !value.is_empty() {
        let _ = write!(s, "<dt>{name}</dt><dd>{value}</dd>");
    }
}

fn nouns(effects: &[Effect]) -> Vec<&'static str> {
    effects.iter().map(|e| e.plain()).collect()
}

/// Sizes with their intervals, a line for every joint and parameter.
fn sizes(s: &mut String, c: &Cause<'_>, subject: &Subject) {
    for row in &c.rows {
        for (key, p) in &row.parameters {
            let (name, _) = parameter(key);
            let joint = row.joint.filter(|_| c.rows.len() > 1);
            let at = joint.map_or(String::new(), |k| format!(", joint {k}"));
            let value = size(key, [p.value; 2], subject.linear);
            let range = size(key, p.ci95, subject.linear);
            let name = if name == "ratio" {
                "share of nominal".into()
            } else {
                name
            };
            line(
                s,
                &capital(&(name + &at)),
                &format!("<b>{value}</b> (95 %: {range})"),
            );
        }
    }
}

fn card(s: &mut String, c: &Cause<'_>, v: &Verdict, subject: &Subject) {
    let _ = write!(
        s,
        "<section class=\"card\"><h3>{}</h3><p>{}</p>",
        escape(&capital(&subject.headline(c))),
        escape(&subject.filled(c).unwrap_or_default())
    );
    let or = listed(&nouns(&c.members), 9, "or");
    if !c.members.is_empty() {
        let _ = write!(
            s,
            "<p><b>It could as well be</b> {or}. These recordings cannot distinguish them.</p>"
        );
    }
    if let Some(text) = subject.sure_of(v, c) {
        let _ = write!(s, "<p>{}</p>", escape(&text));
    }
    s.push_str("<details><summary>Sizes, intervals, rivals</summary><dl>");
    sizes(s, c, subject);
    let [out, open] = c.rivals();
    line(s, "Ruled out", &listed(&nouns(&out), 9, "and"));
    line(s, "Not ruled out", &listed(&nouns(&open), 9, "and"));
    for row in &c.rows {
        let at = row.joint.filter(|_| c.rows.len() > 1);
        let at = at.map_or(String::new(), |k| format!(", joint {k}"));
        let error = |x: f64| quantity(x, &v.gap.unit);
        line(
            s,
            &format!("Error with it alone{at}"),
            &error(row.gap_added_alone),
        );
        line(
            s,
            &format!("Error without it{at}"),
            &error(row.gap_removed_from_full),
        );
    }
    let kind = match c.effect().is_base() {
        true => "another value of a parameter that the model has",
        false => "an effect that the nominal model lacks",
    };
    line(s, "Kind", kind);
    s.push_str("</dl></details></section>");
}

/// What else it may be, with its probability; no probability is given where too little is stated.
pub(super) fn otherwise(v: &Verdict, subject: &Subject) -> Option<String> {
    if subject.tentative && v.verdict != Word::None {
        return None;
    }
    // Below this a doubt is no news.
    const LEAST: f64 = 0.02;
    let p = v.probabilities;
    let both = [
        ("a cause outside the library", p.unknown, Word::Unknown),
        ("no gap at all", p.none, Word::None),
    ];
    let some = both.iter().filter(|x| x.1 >= LEAST && x.2 != v.verdict);
    let words: Vec<String> = some
        .map(|x| format!("{} ({})", x.0, percent(x.1)))
        .collect();
    (!words.is_empty()).then(|| format!("Otherwise: {}.", listed(&words, 2, "or")))
}

fn cards(s: &mut String, v: &Verdict, subject: &Subject) {
    let all = causes(v);
    match (v.verdict, all.as_slice()) {
        (Word::Unknown, []) => s.push_str("<p>No effect of the library explains the gap.</p>"),
        (Word::Unknown, _) => {
            let sure = match subject.tentative {
                true => String::new(),
                false => format!(" ({} sure)", sure(v)),
            };
            let text = format!(
                "No effect of the library explains the gap{sure}. These take a part of the error, perhaps only by imitation:"
            );
            let _ = write!(s, "<p>{}</p>", escape(&text));
        }
        (Word::None, []) => s.push_str("<p>None.</p>"),
        (_, []) => s.push_str("<p>None beyond calibration.</p>"),
        _ => {}
    }
    for c in &all {
        card(s, c, v, subject);
    }
    if let Some(text) = otherwise(v, subject) {
        let _ = write!(s, "<p>{text}</p>");
    }
}

fn stairs(s: &mut String, v: &Verdict, subject: &Subject) {
    let (unit, all) = steps(v);
    let top = all.iter().map(|x| x.error).fold(0.0, f64::max);
    for Step { name, error, rest } in &all {
        let width = 100.0 * (error / top.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        let class = if *rest { "bar rest" } else { "bar" };
        let _ = write!(
            s,
            "<div class=\"stair\"><span>{}</span><b>{} {unit}</b><div class=\"{class}\" style=\"width:{width:.1}%\"></div></div>",
            escape(&capital(name)),
            number(*error)
        );
    }
    let [low, high] = super::words::range(v.gap.ci95_after, &v.gap.unit);
    let _ = write!(
        s,
        "<p>{}: mean of the {} held-out {}. {} The last error has a 95 % interval of {low} to {high}. Floor: {}.</p>",
        capital(metric(&v.gap.metric)),
        v.gap.held_out_runs.len(),
        if v.gap.held_out_runs.len() == 1 {
            "run"
        } else {
            "runs"
        },
        escape(&before(subject)),
        floor(v)
    );
    if let Some((name, [_, calibrated, after])) = shows_in(v) {
        let (name, [_, calibrated, after]) = metric_row(name, [0.0, calibrated, after]);
        let _ = write!(
            s,
            "<p>The causes show most in another figure, {name}: {calibrated} once calibrated, {after} with them.</p>",
        );
    }
}

/// The metric that the effects make fall most, where the primary one hardly falls by them.
fn shows_in(v: &Verdict) -> Option<(&str, [f64; 3])> {
    // Falls of less than this are no story.
    const LEAST: f64 = 0.05;
    if v.effects.is_empty() || v.gap.shrink_after_calibration >= LEAST {
        return None;
    }
    let fall = |m: &[f64; 3]| 1.0 - m[2] / m[1].max(f64::MIN_POSITIVE);
    // A similarity is better when it grows.
    let errors = v.metrics.iter().filter(|(k, _)| *k != "similarity_r");
    let (name, most) = errors.max_by(|a, b| fall(a.1).total_cmp(&fall(b.1)))?;
    (fall(most) >= LEAST).then_some((name, *most))
}

fn next(s: &mut String, v: &Verdict, subject: &Subject) {
    s.push_str("<ol>");
    for text in subject.next(v) {
        let _ = write!(s, "<li>{}</li>", coded(&text));
    }
    s.push_str("</ol>");
    if let Some(file) = v.next_experiment.as_ref().and_then(|n| n.gait.as_ref()) {
        let file = escape(file);
        let _ = write!(
            s,
            "<p>The motion to play lies beside this report: <code>{file}</code></p>"
        );
    }
}

/// A part that is folded until asked for.
fn folded(s: &mut String, title: &str, inside: &str) {
    if !inside.is_empty() {
        let _ = write!(s, "<details><summary>{title}</summary>{inside}</details>");
    }
}

fn details(s: &mut String, v: &Verdict, subject: &Subject, evidence: &Evidence) {
    for warning in &v.provenance.warnings {
        let _ = write!(s, "<p class=\"warning\">{}</p>", escape(warning));
    }
    folded(s, "Curves of held-out runs", &evidence.plots);
    folded(
        s,
        "All shares of the gap, with intervals",
        &shares(v, subject),
    );
    let mut map = String::new();
    regimes::html(&mut map, v);
    folded(s, "Errors by regime of the motion", &map);
    folded(s, "All metrics", &metrics(v));
    folded(s, "What these recordings could not show", &unseen(v));
    let p = &v.provenance;
    let commit = p.commit.as_deref().unwrap_or("commit not known");
    let _ = write!(
        s,
        "<footer><p>{} ({}), seed {}, {:.1} s. Split: {}. Held out: {}. SHA-256 of the data: {}.</p></footer>",
        escape(&p.tool),
        escape(commit),
        p.seed,
        p.wall_time_s,
        escape(&p.split),
        escape(&v.gap.held_out_runs.join(", ")),
        escape(&p.data_sha256)
    );
}

fn shares(v: &Verdict, subject: &Subject) -> String {
    let row = |w: &Where| {
        let [low, high] = w.ci95.map(|x| 100.0 * x);
        let stage = crate::sentence::stage(&w.stage);
        let name = match stage {
            None => "what stays".into(),
            stage => {
                let joint: Vec<usize> = w.joint.into_iter().collect();
                crate::sentence::place(stage, &joint, subject.robot)
            }
        };
        let share = format!("{:.0} % ({low:.0} to {high:.0})", 100.0 * w.share);
        vec![capital(&name), share, regime(w).into()]
    };
    let rows: Vec<Vec<String>> = v.place.iter().map(row).collect();
    let mut s = String::new();
    table(&mut s, &["place", "share of the gap (95 %)", "when"], &rows);
    s
}

fn metrics(v: &Verdict) -> String {
    let row = |(key, m): (&String, &[f64; 3])| {
        let (name, values) = metric_row(key, *m);
        let mut row = vec![name];
        row.extend(values);
        row
    };
    let rows: Vec<Vec<String>> = v.metrics.iter().map(row).collect();
    let mut s = String::new();
    table(
        &mut s,
        &[
            "metric, held-out runs",
            "before",
            "calibrated",
            "with the causes",
        ],
        &rows,
    );
    s
}

fn unseen(v: &Verdict) -> String {
    let item = |u: &crate::verdict::Unseen| {
        let name = capital(u.effect.plain());
        format!(
            "<li>{}: {}.</li>",
            escape(&name),
            escape(u.why.trim_end_matches('.'))
        )
    };
    let all: String = v.unseen.iter().map(item).collect();
    if all.is_empty() {
        all
    } else {
        format!("<ul>{all}</ul>")
    }
}
