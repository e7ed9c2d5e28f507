//! The verdict as Markdown.

use std::fmt::Write as _;

use super::words::{contacts, floor, number, word};
use crate::verdict::Verdict;

/// Markdown: the same numbers as the JSON, to four digits.
#[must_use]
pub fn markdown(v: &Verdict) -> String {
    let mut s = format!(
        "# Diagnosis\n\n**{}**\n\nVerdict: `{}`{}\n\n",
        v.sentence,
        word(v),
        if v.partial {
            " (partial: the search was stopped early)"
        } else {
            ""
        }
    );
    gap(&mut s, v);
    places(&mut s, v);
    super::regimes::markdown(&mut s, v);
    if let Some(c) = &v.contacts {
        let _ = write!(s, "\n{}\n", contacts(c));
    }
    effects(&mut s, v);
    s.push_str("\n## How far\n\n");
    for stair in &v.staircase {
        let _ = writeln!(s, "- {}: {} {}", stair.step, number(stair.gap), v.gap.unit);
    }
    metrics(&mut s, v);
    if !v.ambiguous.is_empty() {
        s.push_str("\n## Cannot be told apart with this data\n\n");
        for a in &v.ambiguous {
            let names: Vec<&str> = a.effects.iter().map(|e| e.name()).collect();
            let _ = writeln!(s, "- {}: {}", names.join(", "), a.separate_by);
        }
    }
    if let Some(n) = &v.next_experiment {
        let _ = write!(s, "\n## Next\n\n{}\n", n.text);
        if let Some(file) = &n.gait {
            let _ = write!(s, "\nFile beside this report: `{file}`\n");
        }
    }
    s.push_str("\n## Could not be seen\n\n");
    for u in &v.unseen {
        let _ = writeln!(s, "- {}: {}", u.effect.name(), u.why);
    }
    let p = &v.provenance;
    if !p.warnings.is_empty() {
        s.push_str("\n## Warnings of the reader\n\n");
    }
    for warning in &p.warnings {
        let _ = writeln!(s, "- {warning}");
    }
    let _ = write!(
        s,
        "\n{}, seed {}, {}, data {}\n",
        p.tool, p.seed, p.split, p.data_sha256
    );
    s
}

fn gap(s: &mut String, v: &Verdict) {
    let g = &v.gap;
    let _ = write!(
        s,
        "| {} [{}], held-out runs | value |\n|---|---|\n| before | {} |\n| after calibration | {} |\n| after | {} (95 %: {} to {}) |\n| floor ({}) | {} |\n\n",
        g.metric,
        g.unit,
        number(g.before),
        number(g.after_calibration),
        number(g.after),
        number(g.ci95_after[0]),
        number(g.ci95_after[1]),
        floor(v),
        number(g.floor)
    );
}

fn places(s: &mut String, v: &Verdict) {
    s.push_str("## Where\n\n| stage | joint | regime | share |\n|---|---|---|---|\n");
    for w in &v.place {
        let joint = w.joint.map_or("all".into(), |j| j.to_string());
        let _ = writeln!(
            s,
            "| {} | {joint} | {} | {:.0} % |",
            w.stage,
            w.regime,
            100.0 * w.share
        );
    }
}

fn effects(s: &mut String, v: &Verdict) {
    let unit = &v.gap.unit;
    let _ = write!(
        s,
        "\n## Which effect\n\n| effect | joint | parameters (95 %) | share of the confidence | error with it alone [{unit}] | with all but it [{unit}] | kind |\n|---|---|---|---|---|---|---|\n"
    );
    for e in &v.effects {
        let p: Vec<String> = e
            .parameters
            .iter()
            .map(|(k, p)| {
                let [low, high] = p.ci95.map(number);
                format!("{k} = {} ({low} to {high})", number(p.value))
            })
            .collect();
        let (alone, without) = (number(e.gap_added_alone), number(e.gap_removed_from_full));
        let joint = e.joint.map_or("all".into(), |j| j.to_string());
        let _ = writeln!(
            s,
            "| {} | {joint} | {} | {:.2} | {alone} | {without} | {} |",
            e.effect.name(),
            p.join(", "),
            e.confidence,
            e.kind
        );
    }
    let p = &v.probabilities;
    // The sum of nothing is -0.
    let named = 0.0 + v.effects.iter().map(|e| e.confidence).sum::<f64>();
    let _ = write!(
        s,
        "\nProbability that what is named is the cause: {named:.2}, of no gap: {:.2}, of a cause outside the library: {:.2}.\n",
        p.none, p.unknown
    );
}

fn metrics(s: &mut String, v: &Verdict) {
    s.push_str("\n| metric | before | after calibration | after |\n|---|---|---|---|\n");
    for (name, m) in &v.metrics {
        let [before, calibrated, after] = m.map(number);
        let _ = writeln!(s, "| {name} | {before} | {calibrated} | {after} |");
    }
}
