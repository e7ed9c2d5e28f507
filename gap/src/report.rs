//! The verdict as Markdown and as one HTML file without network.

mod svg;

use std::fmt::Write as _;

use crate::diagnose::Diagnosis;
use crate::joint::{Trace, simulate};
use crate::verdict::Verdict;

fn value(x: f64) -> String {
    if x == 0.0 || (1e-3..1e5).contains(&x.abs()) {
        format!("{x:.4}")
    } else {
        format!("{x:.3e}")
    }
}

/// Markdown: the same numbers as the JSON.
#[must_use]
pub fn markdown(v: &Verdict) -> String {
    let g = &v.gap;
    let mut s = format!(
        "# Diagnosis\n\n**{}**\n\nVerdict: `{}`\n\n",
        v.sentence,
        word(v)
    );
    let _ = write!(
        s,
        "| {} [{}] | value |\n|---|---|\n| before | {} |\n| after calibration | {} |\n| after | {} (95 %: {} to {}) |\n| floor ({}) | {} |\n\n",
        g.metric,
        g.unit,
        value(g.before),
        value(g.after_calibration),
        value(g.after),
        value(g.ci95_after[0]),
        value(g.ci95_after[1]),
        g.floor_source,
        value(g.floor)
    );
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
    s.push_str("\n## Which effect\n\n| effect | parameters | confidence | alone | without it | kind |\n|---|---|---|---|---|---|\n");
    for e in &v.effects {
        let p: Vec<String> = e
            .parameters
            .iter()
            .map(|(k, p)| format!("{k} = {}", value(p.value)))
            .collect();
        let (alone, without) = (value(e.gap_added_alone), value(e.gap_removed_from_full));
        let _ = writeln!(
            s,
            "| {} | {} | {:.2} | {alone} | {without} | {} |",
            e.effect.name(),
            p.join(", "),
            e.confidence,
            e.kind
        );
    }
    s.push_str("\n## How far\n\n");
    for stair in &v.staircase {
        let _ = writeln!(s, "- {}: {}", stair.step, value(stair.gap));
    }
    if !v.ambiguous.is_empty() {
        s.push_str("\n## Cannot be told apart with this data\n\n");
        for a in &v.ambiguous {
            let names: Vec<&str> = a.effects.iter().map(|e| e.name()).collect();
            let _ = writeln!(s, "- {}: {}", names.join(", "), a.separate_by);
        }
    }
    if let Some(n) = &v.next_experiment {
        let _ = write!(s, "\n## Next\n\n{}\n", n.text);
    }
    s.push_str("\n## Could not be seen\n\n");
    for u in &v.unseen {
        let _ = writeln!(s, "- {}: {}", u.effect.name(), u.why);
    }
    s
}

fn word(v: &Verdict) -> String {
    serde_json::to_value(v.verdict)
        .ok()
        .and_then(|w| w.as_str().map(str::to_string))
        .unwrap_or_default()
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// Measured, before and after of one scored run, thinned to what a screen shows.
struct Traces {
    name: String,
    t_s: Vec<f64>,
    measured: Vec<f64>,
    before: Vec<f64>,
    after: Vec<f64>,
}

fn traces(d: &Diagnosis, run: usize) -> Traces {
    const POINTS: usize = 600;
    let data = &d.problem.runs[run];
    let (mut a, mut b) = (Trace::new(), Trace::new());
    simulate(data, &d.nominal, d.problem.dt_s, &mut a);
    simulate(data, &d.selection.model.params, d.problem.dt_s, &mut b);
    let column = if d.ideal { 6 } else { 0 };
    let step = data.samples.len().div_ceil(POINTS).max(1);
    let mut out = Traces {
        name: data.name.clone(),
        t_s: vec![],
        measured: vec![],
        before: vec![],
        after: vec![],
    };
    for (i, s) in data.samples.iter().enumerate().step_by(step) {
        if s.measured[0].is_finite() {
            out.t_s.push((s.step as f64 + s.part) * d.problem.dt_s);
            out.measured.push(s.measured[0]);
            out.before.push(a[i][column]);
            out.after.push(b[i][0]);
        }
    }
    out
}

/// One self-contained page: verdict, map of where, causes with evidence, staircase, next experiment, replay.
#[must_use]
pub fn html(d: &Diagnosis) -> String {
    // Enough runs to show evidence, few enough for a phone.
    const SHOWN: usize = 4;
    let v = &d.verdict;
    let all: Vec<Traces> = d
        .score_runs
        .iter()
        .take(SHOWN)
        .map(|r| traces(d, *r))
        .collect();
    let mut s = String::from(HEAD);
    let _ = write!(
        s,
        "<h1>Diagnosis</h1><p class=\"lead\">{}</p><p>Verdict: <b>{}</b></p>",
        escape(&v.sentence),
        word(v)
    );
    s.push_str("<h2>Where</h2>");
    let rows: Vec<(String, f64)> = v
        .place
        .iter()
        .map(|w| (format!("{} ({})", w.stage, w.regime), w.share))
        .collect();
    s.push_str(&svg::bars("Share of the gap by stage", &rows, |x| {
        format!("{:.0} %", 100.0 * x)
    }));
    s.push_str("<h2>Which effect</h2>");
    effects(&mut s, v);
    s.push_str("<h2>How far</h2>");
    let stairs: Vec<(String, f64)> = v
        .staircase
        .iter()
        .map(|x| (x.step.clone(), x.gap))
        .collect();
    s.push_str(&svg::bars("Held-out error after each step", &stairs, |x| {
        format!("{} {}", value(x), v.gap.unit)
    }));
    let _ = write!(
        s,
        "<p>Floor: {} {} (from {}).</p>",
        value(v.gap.floor),
        v.gap.unit,
        v.gap.floor_source
    );
    s.push_str("<h2>Evidence</h2>");
    for t in &all {
        let title = format!("{}: measured, before, after", t.name);
        let curves = [
            ("measured", &t.measured),
            ("before", &t.before),
            ("after", &t.after),
        ];
        s.push_str(&svg::curves(&title, &t.t_s, &curves));
    }
    words(&mut s, v);
    if let Some(t) = all.first() {
        replay(&mut s, t, d.problem.linear);
    }
    let _ = writeln!(
        s,
        "<footer><p>{} · seed {} · {} · data {}</p></footer></main></body></html>",
        escape(&v.provenance.tool),
        v.provenance.seed,
        escape(&v.provenance.split),
        escape(&v.provenance.data_sha256)
    );
    s
}

fn effects(s: &mut String, v: &Verdict) {
    if v.effects.is_empty() {
        s.push_str("<p>None.</p>");
        return;
    }
    s.push_str("<div class=\"wide\"><table><thead><tr><th>effect</th><th>in plain words</th><th>parameters</th><th>confidence</th><th>error alone</th><th>error without</th></tr></thead><tbody>");
    for e in &v.effects {
        let p: Vec<String> = e
            .parameters
            .iter()
            .map(|(k, p)| {
                format!(
                    "{k} = {} ({} to {})",
                    value(p.value),
                    value(p.ci95[0]),
                    value(p.ci95[1])
                )
            })
            .collect();
        let doubt = if e.plausible {
            ""
        } else {
            " <b>(physically implausible)</b>"
        };
        let _ = write!(
            s,
            "<tr><td>{}</td><td>{}{doubt}</td><td>{}</td><td>{:.2}</td><td>{}</td><td>{}</td></tr>",
            e.effect.name(),
            e.effect.plain(),
            p.join("<br>"),
            e.confidence,
            value(e.gap_added_alone),
            value(e.gap_removed_from_full)
        );
    }
    s.push_str("</tbody></table></div>");
}

fn words(s: &mut String, v: &Verdict) {
    s.push_str("<h2>What next</h2>");
    for a in &v.ambiguous {
        let names: Vec<&str> = a.effects.iter().map(|e| e.name()).collect();
        let _ = write!(
            s,
            "<p>Cannot be told apart with this data: <b>{}</b>. To tell: {}.</p>",
            names.join(", "),
            escape(&a.separate_by)
        );
    }
    if let Some(n) = &v.next_experiment {
        let _ = write!(s, "<p>{}</p>", escape(&n.text));
    }
    s.push_str("<details><summary>What these recordings could not show</summary><ul>");
    for u in &v.unseen {
        let _ = write!(s, "<li>{}: {}</li>", u.effect.name(), escape(&u.why));
    }
    s.push_str("</ul></details>");
}

/// Robot and both simulations drawn over each other, under a time slider.
fn replay(s: &mut String, t: &Traces, linear: bool) {
    let list = |v: &[f64]| {
        v.iter()
            .map(|x| format!("{x:.4}"))
            .collect::<Vec<_>>()
            .join(",")
    };
    let _ = write!(
        s,
        "<h2>Replay</h2><p><label for=\"time\">Time in {}</label> <output id=\"now\">0.00 s</output></p>\
         <input id=\"time\" type=\"range\" min=\"0\" max=\"{}\" value=\"0\" step=\"1\">\
         <svg viewBox=\"-120 -120 240 240\" class=\"replay\" role=\"img\" aria-label=\"measured, before and after at the chosen time\">\
         <line id=\"r1\" class=\"c1\" x1=\"0\" y1=\"0\" x2=\"0\" y2=\"80\"/><line id=\"r2\" class=\"c2\" x1=\"0\" y1=\"0\" x2=\"0\" y2=\"90\"/>\
         <line id=\"r0\" class=\"c0\" x1=\"0\" y1=\"0\" x2=\"0\" y2=\"100\"/></svg>\
         <script>\nconst T=[{}],Y=[[{}],[{}],[{}]],LINEAR={linear};\n{SCRIPT}</script>",
        escape(&t.name),
        t.t_s.len().saturating_sub(1),
        list(&t.t_s),
        list(&t.measured),
        list(&t.before),
        list(&t.after),
    );
}

const SCRIPT: &str = r"const s=document.getElementById('time'),o=document.getElementById('now');
const span=Math.max(1e-9,...Y[0].map(Math.abs));
function show(){const k=+s.value;o.textContent=T[k].toFixed(2)+' s';
for(let i=0;i<3;i++){const q=Y[i][k],l=document.getElementById('r'+i);
if(LINEAR){const x=100*q/span;l.setAttribute('x1',x);l.setAttribute('x2',x);}
else{const r=100-10*i;l.setAttribute('x2',r*Math.sin(q));l.setAttribute('y2',r*Math.cos(q));}}}
s.addEventListener('input',show);show();
";

const HEAD: &str = r#"<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1"><title>Diagnosis</title><link rel="icon" href="data:,"><style>
body{font:16px/1.5 system-ui,sans-serif;margin:0;color:#1b1b1b;background:#fff}main{max-width:60rem;margin:auto;padding:1rem}
p,li{overflow-wrap:anywhere}.lead{font-size:1.3rem;font-weight:600}.wide{overflow-x:auto}table{border-collapse:collapse;width:100%}th,td{text-align:left;padding:.3rem .6rem;border-bottom:1px solid #ccc;vertical-align:top}
svg{width:100%;height:auto}svg text{font:12px system-ui,sans-serif;fill:#1b1b1b}.bar{fill:#2c6fbb}.axis{stroke:#888;fill:none}
.c0{stroke:#1b1b1b}.c1{stroke:#c2410c}.c2{stroke:#1d70b8}.curve{fill:none;stroke-width:1.5}.replay{max-width:22rem;display:block}.replay line{stroke-width:4}
input[type=range]{width:100%}:focus-visible{outline:3px solid #1d70b8}
@media(prefers-color-scheme:dark){body{background:#151515;color:#eee}svg text{fill:#eee}.c0{stroke:#eee}.c1{stroke:#fb923c}.c2{stroke:#60a5fa}}
@media print{input,details{display:none}body{background:#fff;color:#000}}
</style></head><body><main>"#;
