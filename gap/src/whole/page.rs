//! The report as one page without network.

use std::fmt::Write as _;

use super::replay::Replay;
use super::score::JointRow;
use crate::verdict::Verdict;

const HEAD: &str = r#"<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1"><title>Diagnosis of a robot</title><link rel="icon" href="data:,"><style>
body{font:16px/1.5 system-ui,sans-serif;margin:0;color:#1b1b1b;background:#fff}main{max-width:60rem;margin:auto;padding:1rem}
p,li{overflow-wrap:anywhere}.lead{font-size:1.3rem;font-weight:600}.wide{overflow-x:auto}table{border-collapse:collapse;width:100%}th,td{text-align:left;padding:.3rem .6rem;border-bottom:1px solid #ccc;vertical-align:top}
svg{width:100%;height:auto;border:1px solid #ccc}circle{fill-opacity:.15}polyline{fill:none;stroke-width:3}polyline[id^=s]{stroke-width:1;stroke-opacity:.4}
.k0{stroke:#1b1b1b;fill:#1b1b1b;color:#1b1b1b}.k1{stroke:#c2410c;fill:#c2410c;color:#c2410c}.k2{stroke:#1d70b8;fill:#1d70b8;color:#1d70b8}
input[type=range]{width:100%}button{font:inherit}:focus-visible{outline:3px solid #1d70b8}
.bar{height:.9rem;background:#2c6fbb;min-width:1px}.bar.rest{background:#999}
@media(prefers-color-scheme:dark){body{background:#151515;color:#eee}.k0{stroke:#eee;fill:#eee;color:#eee}.k1{stroke:#fb923c;fill:#fb923c;color:#fb923c}.k2{stroke:#60a5fa;fill:#60a5fa;color:#60a5fa}}@media print{input,button{display:none}body{background:#fff;color:#000}}
</style></head><body><main>"#;

pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

fn number(x: f64) -> String {
    if x == 0.0 || (1e-3..1e5).contains(&x.abs()) {
        format!("{x:.4}")
    } else {
        format!("{x:.2e}")
    }
}

fn joint(k: Option<usize>) -> String {
    k.map_or_else(|| "robot".into(), |k| format!("joint {k}"))
}

fn table(s: &mut String, title: &str, head: &[&str], rows: &[Vec<String>]) {
    let _ = write!(s, "<h2>{title}</h2><div class=\"wide\"><table><thead><tr>");
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

fn places(s: &mut String, v: &Verdict) {
    let places: Vec<Vec<String>> = v
        .place
        .iter()
        .map(|w| {
            let rest = if w.stage == "unexplained" {
                " rest"
            } else {
                ""
            };
            let bar = format!(
                "<div class=\"bar{rest}\" style=\"width:{:.1}%\"></div>",
                100.0 * w.share
            );
            vec![
                escape(&w.stage),
                joint(w.joint),
                format!("{:.0} %", 100.0 * w.share),
                bar,
            ]
        })
        .collect();
    table(s, "Where", &["stage", "of", "share", ""], &places);
}

fn effects(s: &mut String, v: &Verdict) {
    let effects: Vec<Vec<String>> = v
        .effects
        .iter()
        .map(|e| {
            let p: Vec<String> = e
                .parameters
                .iter()
                .map(|(k, p)| {
                    format!(
                        "{k} = {} ({} to {})",
                        number(p.value),
                        number(p.ci95[0]),
                        number(p.ci95[1])
                    )
                })
                .collect();
            vec![
                format!("{}<br>{}", e.effect.name(), e.effect.plain()),
                joint(e.joint),
                p.join("<br>"),
                format!("{:.2}", e.confidence),
                number(e.gap_added_alone),
                number(e.gap_removed_from_full),
                e.kind.clone(),
            ]
        })
        .collect();
    table(
        s,
        "Which effect",
        &[
            "effect",
            "of",
            "parameters (95 %)",
            "confidence",
            "alone",
            "all but this",
            "kind",
        ],
        &effects,
    );
}

fn figures(s: &mut String, v: &Verdict, joints: &[JointRow]) {
    let rows: Vec<Vec<String>> = joints
        .iter()
        .map(|r| {
            let pair = |x: Option<[f64; 2]>| {
                x.map_or_else(
                    || "not measured".into(),
                    |x| format!("{} to {}", number(x[0]), number(x[1])),
                )
            };
            vec![r.joint.to_string(), pair(r.angle_rad), pair(r.torque_nm)]
        })
        .collect();
    table(
        s,
        "Joint by joint, before to after",
        &["joint", "angle error [rad]", "torque error [N m]"],
        &rows,
    );
    let metrics: Vec<Vec<String>> = v
        .metrics
        .iter()
        .map(|(k, m)| vec![escape(k), number(m[0]), number(m[1]), number(m[2])])
        .collect();
    table(
        s,
        "All metrics, held-out runs",
        &["metric", "before", "after calibration", "after"],
        &metrics,
    );
}

/// The page.
pub(super) fn html(v: &Verdict, joints: &[JointRow], replay: Option<&Replay>) -> String {
    let g = &v.gap;
    let mut s = String::from(HEAD);
    let _ = write!(
        s,
        "<h1>Diagnosis of a robot</h1><p class=\"lead\">{}</p>",
        escape(&v.sentence)
    );
    let stairs: Vec<Vec<String>> = v
        .staircase
        .iter()
        .map(|x| vec![escape(&x.step), number(x.gap)])
        .collect();
    table(
        &mut s,
        "How far it shrinks",
        &["step", &format!("{} [{}]", g.metric, g.unit)],
        &stairs,
    );
    let _ = write!(
        s,
        "<p>Floor ({}): {}. Held out: {}.</p>",
        g.floor_source,
        number(g.floor),
        escape(&v.provenance.split)
    );
    places(&mut s, v);
    effects(&mut s, v);
    figures(&mut s, v, joints);
    if let Some(replay) = replay {
        replay.html(&mut s);
    }
    rest(&mut s, v);
    s.push_str("</main></body></html>\n");
    s
}

fn rest(s: &mut String, v: &Verdict) {
    if !v.ambiguous.is_empty() {
        s.push_str("<h2>Cannot be told apart with this data</h2><ul>");
        for a in &v.ambiguous {
            let names: Vec<&str> = a.effects.iter().map(|e| e.name()).collect();
            let _ = write!(
                s,
                "<li>{}: {}</li>",
                names.join(", "),
                escape(&a.separate_by)
            );
        }
        s.push_str("</ul>");
    }
    if let Some(n) = &v.next_experiment {
        let _ = write!(s, "<h2>Next</h2><p>{}</p>", escape(&n.text));
    }
    s.push_str("<h2>Could not be seen</h2><ul>");
    for u in &v.unseen {
        let _ = write!(s, "<li>{}: {}</li>", u.effect.name(), escape(&u.why));
    }
    let p = &v.provenance;
    let _ = write!(
        s,
        "</ul><p>{} on data {}, seed {}, {:.1} s.</p>",
        escape(&p.tool),
        &p.data_sha256,
        p.seed,
        p.wall_time_s
    );
}
