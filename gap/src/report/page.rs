//! The page that every report shares: verdict, causes, what next, where, how far; evidence and replay come from the caller.

use std::fmt::Write as _;

use super::words::{
    escape, floor, metric, number, parameter, place, quantity, regime, stage, word,
};
use crate::verdict::{EffectRow, Verdict};

/// What only the kind of the data set can draw.
pub(crate) struct Evidence {
    /// Title of the page.
    pub(crate) title: &'static str,
    /// Plots and tables, HTML.
    pub(crate) plots: String,
    /// Robot and simulator under a time slider, HTML; empty without one.
    pub(crate) replay: String,
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
pub(crate) fn html(v: &Verdict, evidence: &Evidence) -> String {
    let mut s = format!("{HEAD}<title>{}</title></head><body><main>", evidence.title);
    head(&mut s, v, evidence.title);
    s.push_str("<h2>Which effect</h2>");
    effects(&mut s, v);
    next(&mut s, v);
    s.push_str("<h2>Where</h2>");
    places(&mut s, v);
    s.push_str("<h2>How far it shrinks</h2>");
    stairs(&mut s, v);
    s.push_str("<h2>Evidence</h2>");
    s.push_str(&evidence.plots);
    s.push_str(&evidence.replay);
    s.push_str("<h2>All metrics, held-out runs</h2>");
    metrics(&mut s, v);
    unseen(&mut s, v);
    provenance(&mut s, v);
    s.push_str("</main></body></html>\n");
    s
}

fn head(s: &mut String, v: &Verdict, title: &str) {
    let g = &v.gap;
    let of = |x: f64| quantity(x, &g.unit);
    let _ = write!(
        s,
        "<h1>{title}</h1><p class=\"lead\">{}</p><p>Verdict: <b>{}</b>. Held-out error ({}): <b>{}</b> before, \
         <b>{}</b> after; no model gets below {}, {}.</p>",
        escape(&v.sentence),
        word(v),
        metric(&g.metric),
        of(g.before),
        of(g.after),
        of(g.floor),
        floor(v)
    );
    if v.partial {
        s.push_str("<p class=\"warning\">Partial: the search was stopped before its end.</p>");
    }
}

fn cause(e: &EffectRow) -> String {
    let joint = e.joint.map_or(String::new(), |k| format!(", joint {k}"));
    let doubt = if e.plausible {
        ""
    } else {
        "<br><b>no plausible size for such a part</b>"
    };
    format!(
        "<b>{}</b>{joint}<br>{}{doubt}",
        e.effect.name(),
        e.effect.plain()
    )
}

fn rivals(e: &EffectRow) -> String {
    let told: Vec<String> = e
        .alternatives
        .iter()
        .filter(|a| a.distinguishable)
        .map(|a| format!("{} (by {:.1} sigma)", a.effect.name(), a.margin))
        .collect();
    told.join("<br>")
}

fn effects(s: &mut String, v: &Verdict) {
    let p = &v.probabilities;
    if v.effects.is_empty() {
        s.push_str("<p>None.</p>");
    } else {
        let unit = &v.gap.unit;
        let size = |e: &EffectRow| {
            let one = |(key, p): (&String, &crate::verdict::Estimate)| {
                let (name, unit) = parameter(key);
                let [low, high] = p.ci95.map(number);
                format!("{name} {}<br>({low} to {high})", quantity(p.value, unit))
            };
            e.parameters
                .iter()
                .map(one)
                .collect::<Vec<_>>()
                .join("<br>")
        };
        let rows: Vec<Vec<String>> = v
            .effects
            .iter()
            .map(|e| {
                vec![
                    cause(e),
                    size(e),
                    format!("{:.0} %", 100.0 * e.confidence),
                    number(e.gap_added_alone),
                    number(e.gap_removed_from_full),
                    e.kind.clone(),
                    rivals(e),
                ]
            })
            .collect();
        let (alone, without) = (
            format!("error with it alone [{unit}]"),
            format!("error with all but it [{unit}]"),
        );
        let head = [
            "effect",
            "size (95 %)",
            "confidence",
            &alone,
            &without,
            "kind",
            "ruled out",
        ];
        table(s, &head, &rows);
    }
    let _ = write!(
        s,
        "<p>Probability that there is no gap: {:.0} %; that the cause is outside the library: {:.0} %.</p>",
        100.0 * p.none,
        100.0 * p.unknown
    );
}

fn next(s: &mut String, v: &Verdict) {
    if v.ambiguous.is_empty() && v.next_experiment.is_none() {
        return;
    }
    s.push_str("<h2>What next</h2>");
    for a in &v.ambiguous {
        let names: Vec<&str> = a.effects.iter().map(|e| e.name()).collect();
        let _ = write!(
            s,
            "<p>Cannot be told apart with this data: <b>{}</b>. To tell: {}.</p>",
            names.join(", "),
            escape(a.separate_by.trim_end_matches('.'))
        );
    }
    if let Some(n) = &v.next_experiment {
        let _ = write!(s, "<p>{}</p>", escape(&n.text));
        if let Some(file) = &n.gait {
            let file = escape(file);
            let _ = write!(s, "<p>File beside this report: <code>{file}</code></p>");
        }
    }
}

/// A bar as wide as `share` of its cell.
fn bar(share: f64, class: &str) -> String {
    let width = 100.0 * share.clamp(0.0, 1.0);
    format!("<div class=\"bar {class}\" style=\"width:{width:.1}%\"></div>")
}

fn places(s: &mut String, v: &Verdict) {
    let rows: Vec<Vec<String>> = v
        .place
        .iter()
        .map(|w| {
            let rest = w.stage == "unexplained";
            vec![
                format!(
                    "<b>{}</b><br>{}",
                    escape(&place(&w.stage, w.joint)),
                    stage(&w.stage)
                ),
                regime(w).into(),
                format!(
                    "{:.0} % ({:.0} to {:.0})",
                    100.0 * w.share,
                    100.0 * w.ci95[0],
                    100.0 * w.ci95[1]
                ),
                bar(w.share, if rest { "rest" } else { "" }),
            ]
        })
        .collect();
    let head = ["stage", "most of it", "share of the gap (95 %)", ""];
    table(s, &head, &rows);
}

fn stairs(s: &mut String, v: &Verdict) {
    let g = &v.gap;
    let top = v.staircase.iter().map(|x| x.gap).fold(g.floor, f64::max);
    let step = |name: &str, gap: f64, class: &str| {
        vec![
            escape(name),
            number(gap),
            bar(gap / top.max(f64::MIN_POSITIVE), class),
        ]
    };
    let mut rows: Vec<Vec<String>> = v
        .staircase
        .iter()
        .map(|x| step(&x.step, x.gap, ""))
        .collect();
    rows.push(step("floor", g.floor, "rest"));
    let error = format!("{} [{}]", metric(&g.metric), g.unit);
    table(s, &["model with", &error, ""], &rows);
    let percent = |x: f64| format!("{:.0} %", 100.0 * x);
    let _ = write!(
        s,
        "<p>It shrinks by {}, by {} after calibration",
        percent(g.shrink),
        percent(g.shrink_after_calibration)
    );
    if let Some(share) = g.shrink_of_achievable {
        let _ = write!(s, ", by {} of what the floor leaves", percent(share));
    }
    let [low, high] = g.ci95_after.map(number);
    let _ = write!(
        s,
        ". 95 % interval of the last error: {low} to {high}. Floor: {}.</p>",
        floor(v)
    );
}

fn metrics(s: &mut String, v: &Verdict) {
    let rows: Vec<Vec<String>> = v
        .metrics
        .iter()
        .map(|(k, m)| {
            let [before, calibrated, after] = m.map(number);
            let name = format!("<code>{}</code><br>{}", escape(k), metric(k));
            vec![name, before, calibrated, after]
        })
        .collect();
    table(
        s,
        &["metric", "before", "after calibration", "after"],
        &rows,
    );
}

fn unseen(s: &mut String, v: &Verdict) {
    s.push_str("<details><summary>What these recordings could not show</summary><ul>");
    for u in &v.unseen {
        let _ = write!(s, "<li>{}: {}</li>", u.effect.name(), escape(&u.why));
    }
    s.push_str("</ul></details>");
}

fn provenance(s: &mut String, v: &Verdict) {
    let p = &v.provenance;
    let commit = p.commit.as_deref().unwrap_or("commit not known");
    let _ = write!(
        s,
        "<footer><p>{} ({}), seed {}, {:.1} s. Split: {}. Held out: {}. Data: {}.</p></footer>",
        escape(&p.tool),
        escape(commit),
        p.seed,
        p.wall_time_s,
        escape(&p.split),
        escape(&v.gap.held_out_runs.join(", ")),
        escape(&p.data_sha256)
    );
}

const HEAD: &str = r#"<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1"><link rel="icon" href="data:,"><style>
:root{--ink:#1b1b1b;--paper:#fff;--before:#c2410c;--after:#1d70b8;--line:#ccc;--faint:#8884}
@media screen and (prefers-color-scheme:dark){:root{--ink:#eee;--paper:#151515;--before:#fb923c;--after:#60a5fa;--line:#555}}
body{font:16px/1.5 system-ui,sans-serif;margin:0;color:var(--ink);background:var(--paper)}main{max-width:60rem;margin:auto;padding:1rem}
p,li{overflow-wrap:anywhere}.lead{font-size:1.3rem;font-weight:600}.warning{border-left:.4rem solid var(--before);padding-left:.6rem}footer{font-size:.85rem;border-top:1px solid var(--line)}
.wide{overflow-x:auto}table{border-collapse:collapse;width:100%}th,td{text-align:left;padding:.3rem .6rem;border-bottom:1px solid var(--line);vertical-align:top}td:last-child{min-width:5rem}
.bar{height:.9rem;margin-top:.3rem;background:var(--after);min-width:1px;print-color-adjust:exact;-webkit-print-color-adjust:exact}.bar.rest{background:#999}
.k0{color:var(--ink)}.k1{color:var(--before)}.k2{color:var(--after)}
.plot{margin:1.2rem 0;display:grid;grid-template-columns:3.2rem 1fr;break-inside:avoid}.plot figcaption,.plot .legend{grid-column:1/3}.plot figcaption{font-weight:600}
.plot .ylabel{grid-column:1/3;font-size:.8rem}.plot .xlabel{grid-column:2;font-size:.8rem;text-align:right}.plot svg{width:100%;height:13rem;border:1px solid var(--line);box-sizing:border-box}.plot.map svg{height:auto;aspect-ratio:1}.plot.map{max-width:26rem}
.yticks,.xticks{position:relative;font-size:.8rem;line-height:1}.yticks span{position:absolute;right:.4rem;transform:translateY(-50%)}.xticks{grid-column:2;height:1.2rem;margin-top:.2rem}.xticks span{position:absolute;transform:translateX(-50%)}
.plot polyline{fill:none;stroke:currentColor;stroke-width:1.5;vector-effect:non-scaling-stroke}.plot polyline.k1{stroke-dasharray:6 3}.plot .grid{stroke:var(--faint);fill:none;vector-effect:non-scaling-stroke}
.legend span{margin-right:1rem;white-space:nowrap}.legend i{display:inline-block;width:1.4rem;border-top:3px solid currentColor;vertical-align:middle;margin-right:.3rem}.legend .k1 i{border-top-style:dashed}
.replay{width:100%;height:auto;border:1px solid var(--line);box-sizing:border-box;display:block}.replay.hand{max-width:22rem}.replay line{stroke:currentColor;stroke-width:4}.replay circle{fill:currentColor;fill-opacity:.15;stroke:currentColor}.replay polyline{fill:none;stroke:currentColor;stroke-width:3}.replay polyline[id^=s]{stroke-width:1;stroke-opacity:.4}
input[type=range]{width:100%;min-height:2rem}button{font:inherit;padding:.3rem 1rem}summary{padding:.5rem 0}:focus-visible{outline:3px solid var(--after)}
@media print{input,button,label{display:none}h2{break-after:avoid}tr{break-inside:avoid}main{max-width:none;padding:0}.wide{overflow:visible}body{font-size:11px}details::details-content{content-visibility:visible;display:block}}
</style>"#;
