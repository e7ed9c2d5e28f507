//! The page that every report shares: verdict, causes, what next, where, how far; evidence and replay come from the caller.

use std::fmt::Write as _;

use super::regimes;
use super::words::{
    contacts, escape, floor, metric, number, parameter, place, quantity, regime, stage, word,
};
use crate::verdict::{EffectRow, Verdict, Where};

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
    regimes::html(&mut s, v);
    if let Some(c) = &v.contacts {
        let _ = write!(s, "<p>{}</p>", escape(&contacts(c)));
    }
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
         <b>{}</b> once known values are calibrated, <b>{}</b> with the effects. Floor: {} ({}).</p>",
        escape(&v.sentence),
        word(v),
        metric(&g.metric),
        of(g.before),
        of(g.after_calibration),
        of(g.after),
        of(g.floor),
        floor(v)
    );
    if let Some((name, [_, calibrated, after])) = shows_in(v) {
        let _ = write!(
            s,
            "<p>The effects show most in another metric, {}: {} once calibrated, {} with them.</p>",
            metric(name),
            number(calibrated),
            number(after)
        );
    }
    if v.partial {
        s.push_str("<p class=\"warning\">Partial: the search was stopped before its end.</p>");
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

/// One line of a card.
fn line(s: &mut String, name: &str, value: &str) {
    if !value.is_empty() {
        let _ = write!(s, "<dt>{name}</dt><dd>{value}</dd>");
    }
}

/// The card of effect `e`, one of `count`: confidences are shares of one, so that of many effects each has a small one however sure all are.
fn card(s: &mut String, e: &EffectRow, unit: &str, count: usize) {
    let joint = e.joint.map_or(String::new(), |k| format!(", joint {k}"));
    let _ = write!(
        s,
        "<section class=\"card\"><h3>{}{joint}</h3><p>{}</p><dl>",
        e.effect.name(),
        e.effect.plain()
    );
    for (key, p) in &e.parameters {
        let (name, unit) = parameter(key);
        let [low, high] = p.ci95.map(number);
        let size = quantity(p.value, unit);
        line(s, &name, &format!("<b>{size}</b>, 95 %: {low} to {high}"));
    }
    if !e.plausible {
        line(s, "but", "<b>no plausible size for such a part</b>");
    }
    let percent = format!("{:.0} %", 100.0 * e.confidence);
    let name = if count > 1 {
        "share of the confidence"
    } else {
        "confidence"
    };
    line(s, name, &percent);
    line(s, "kind", &e.kind);
    let error = |x: f64| format!("{} {unit}", number(x));
    line(s, "error with it alone", &error(e.gap_added_alone));
    line(s, "error with all but it", &error(e.gap_removed_from_full));
    let rivals = |told: bool| {
        let some = e.alternatives.iter().filter(|a| a.distinguishable == told);
        let names = some.map(|a| format!("{} ({:.1} sigma)", a.effect.name(), a.margin));
        names.collect::<Vec<_>>().join(", ")
    };
    line(s, "ruled out", &rivals(true));
    line(s, "not ruled out", &rivals(false));
    s.push_str("</dl></section>");
}

fn effects(s: &mut String, v: &Verdict) {
    let p = &v.probabilities;
    if v.effects.is_empty() {
        s.push_str("<p>None.</p>");
    }
    for e in &v.effects {
        card(s, e, &v.gap.unit, v.effects.len());
    }
    let named: f64 = v.effects.iter().map(|e| e.confidence).sum();
    if !v.effects.is_empty() {
        let these = if v.effects.len() > 1 {
            "these are the causes"
        } else {
            "this is the cause"
        };
        let _ = write!(s, "<p>That {these}: <b>{:.0} %</b>.</p>", 100.0 * named);
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
    // What rounds to no percent at all is told in one line.
    const LEAST: f64 = 0.005;
    let (large, small): (Vec<&Where>, Vec<&Where>) = v.place.iter().partition(|w| w.share >= LEAST);
    let rows: Vec<Vec<String>> = large
        .iter()
        .map(|w| {
            let class = if w.stage == "unexplained" { "rest" } else { "" };
            let [low, high] = w.ci95.map(|x| 100.0 * x);
            vec![
                format!(
                    "<b>{}</b>{}<br>{}",
                    escape(&place(&w.stage, w.joint)),
                    regime(w),
                    stage(&w.stage)
                ),
                format!(
                    "{:.0} % ({low:.0} to {high:.0}){}",
                    100.0 * w.share,
                    bar(w.share, class)
                ),
            ]
        })
        .collect();
    table(s, &["stage", "share of the gap (95 %)"], &rows);
    if !small.is_empty() {
        let names: Vec<String> = small.iter().map(|w| place(&w.stage, w.joint)).collect();
        let _ = write!(
            s,
            "<p>Less than half a percent each: {}.</p>",
            escape(&names.join("; "))
        );
    }
}

fn stairs(s: &mut String, v: &Verdict) {
    let g = &v.gap;
    let top = v.staircase.iter().map(|x| x.gap).fold(g.floor, f64::max);
    let step = |name: &str, gap: f64, class: &str| {
        let width = bar(gap / top.max(f64::MIN_POSITIVE), class);
        vec![escape(name), format!("{}{width}", number(gap))]
    };
    let mut rows: Vec<Vec<String>> = v
        .staircase
        .iter()
        .map(|x| step(&x.step, x.gap, ""))
        .collect();
    rows.push(step("floor", g.floor, "rest"));
    let error = format!("{} [{}]", metric(&g.metric), g.unit);
    table(s, &["model", &error], &rows);
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
    for warning in &p.warnings {
        let _ = write!(s, "<p class=\"warning\">{}</p>", escape(warning));
    }
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
.wide{overflow-x:auto}table{border-collapse:collapse;width:100%}th,td{text-align:left;padding:.3rem .6rem;border-bottom:1px solid var(--line);vertical-align:top}td:last-child{min-width:8rem}.heat{display:block;margin:-.3rem -.6rem;padding:.3rem .6rem;background:color-mix(in srgb,var(--before) var(--heat),transparent);white-space:nowrap}.card{border-left:.4rem solid var(--after);padding:.1rem 1rem;margin:1rem 0;break-inside:avoid}.card h3,.card p{margin:.4rem 0}.card dl{display:grid;grid-template-columns:minmax(6rem,max-content) 1fr;gap:.1rem 1rem;margin:.4rem 0}.card dd{margin:0;overflow-wrap:anywhere}
.bar{height:.9rem;margin-top:.3rem;background:var(--after);min-width:1px;print-color-adjust:exact;-webkit-print-color-adjust:exact}.bar.rest{background:#999}
.k0{color:var(--ink)}.k1{color:var(--before)}.k2{color:var(--after)}
.plot{margin:1.2rem 0;display:grid;grid-template-columns:3.2rem 1fr;break-inside:avoid}.plot figcaption,.plot .legend{grid-column:1/3}.plot figcaption{font-weight:600}
.plot .ylabel{grid-column:1/3;font-size:.8rem;margin-bottom:.4rem}.plot .xlabel{grid-column:2;font-size:.8rem;text-align:right}.plot svg{width:100%;height:13rem;border:1px solid var(--line);box-sizing:border-box}.plot.map svg{height:auto;aspect-ratio:1}.plot.map{max-width:26rem}
.yticks,.xticks{position:relative;font-size:.8rem;line-height:1}.yticks span{position:absolute;right:.4rem;transform:translateY(-50%)}.xticks{grid-column:2;height:1.2rem;margin-top:.2rem}.xticks span{position:absolute;transform:translateX(-50%)}
.plot polyline{fill:none;stroke:currentColor;stroke-width:1.5;vector-effect:non-scaling-stroke}.plot polyline.k1{stroke-dasharray:6 3}.plot .grid{stroke:var(--faint);fill:none;vector-effect:non-scaling-stroke}
.legend span{margin-right:1rem;white-space:nowrap}.legend i{display:inline-block;width:1.4rem;border-top:3px solid currentColor;vertical-align:middle;margin-right:.3rem}.legend .k1 i{border-top-style:dashed}
.replay{width:100%;height:auto;border:1px solid var(--line);box-sizing:border-box;display:block}.replay.hand{max-width:22rem}.replay line{stroke:currentColor;stroke-width:4}.replay circle{fill:currentColor;fill-opacity:.15;stroke:currentColor}.replay polyline{fill:none;stroke:currentColor;stroke-width:3}.replay polyline[id^=s]{stroke-width:1;stroke-opacity:.4}
input[type=range]{width:100%;min-height:2rem}button{font:inherit;padding:.3rem 1rem}summary{padding:.5rem 0}:focus-visible{outline:3px solid var(--after)}
@media print{input,button,label{display:none}h2{break-after:avoid}tr{break-inside:avoid}main{max-width:none;padding:0}.wide{overflow:visible}body{font-size:11px}details::details-content{content-visibility:visible;display:block}}
</style>"#;
