//! Plots as inline SVG.

use std::fmt::Write as _;

use super::escape;

/// Horizontal bars with a label and a value each.
pub(super) fn bars(title: &str, rows: &[(String, f64)], show: impl Fn(f64) -> String) -> String {
    const ROW: usize = 26;
    let top = rows.iter().map(|r| r.1).fold(1e-300, f64::max);
    let height = ROW * rows.len() + 6;
    let mut s = format!(
        "<svg viewBox=\"0 0 720 {height}\" role=\"img\" aria-label=\"{}\">",
        escape(title)
    );
    for (i, (label, x)) in rows.iter().enumerate() {
        let y = i * ROW + 4;
        let width = 330.0 * (x / top).clamp(0.0, 1.0);
        let _ = write!(
            s,
            "<text x=\"0\" y=\"{}\">{}</text><rect class=\"bar\" x=\"260\" y=\"{y}\" width=\"{width:.1}\" height=\"18\"/>\
             <text x=\"{:.1}\" y=\"{}\">{}</text>",
            y + 14,
            escape(label),
            268.0 + width,
            y + 14,
            escape(&show(*x))
        );
    }
    s.push_str("</svg>");
    s
}

/// Curves over time with a legend.
pub(super) fn curves(title: &str, t: &[f64], curves: &[(&str, &Vec<f64>)]) -> String {
    let (w, h) = (720.0, 220.0);
    let all = curves.iter().flat_map(|c| c.1.iter().copied());
    let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| {
        (a.min(x), b.max(x))
    });
    let (t0, t1) = (
        t.first().copied().unwrap_or(0.0),
        t.last().copied().unwrap_or(1.0),
    );
    let x = |v: f64| 50.0 + (w - 60.0) * (v - t0) / (t1 - t0).max(1e-9);
    let y = |v: f64| 20.0 + (h - 45.0) * (high - v) / (high - low).max(1e-9);
    let mut s = format!(
        "<svg viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"{}\">",
        escape(title)
    );
    let _ = write!(
        s,
        "<path class=\"axis\" d=\"M50 20V{0}H{1}\"/><text x=\"50\" y=\"13\">{2}</text><text x=\"0\" y=\"26\">{high:.3}</text>\
         <text x=\"0\" y=\"{0}\">{low:.3}</text><text x=\"{3}\" y=\"{4}\">{t1:.1} s</text>",
        h - 25.0,
        w - 10.0,
        escape(title),
        w - 60.0,
        h - 8.0
    );
    for (k, (name, v)) in curves.iter().enumerate() {
        let points: Vec<String> = t
            .iter()
            .zip(v.iter())
            .map(|(t, v)| format!("{:.1},{:.1}", x(*t), y(*v)))
            .collect();
        let _ = write!(
            s,
            "<polyline class=\"curve c{k}\" points=\"{}\"/><text x=\"{}\" y=\"{}\">{name}</text><path class=\"c{k}\" stroke-width=\"3\" d=\"M{} {}h20\"/>",
            points.join(" "),
            80 + 110 * k,
            h - 8.0,
            56 + 110 * k,
            h - 12.0
        );
    }
    s.push_str("</svg>");
    s
}
