//! The best fitness over the iterations, as the paper's figures 3 and 6 draw it.

use core::fmt::Write;

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 360.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 20.0;
const TOP: f64 = 44.0;
const BOTTOM: f64 = 50.0;
/// Height of a line of text.
const LINE: f64 = 15.0;

/// Draws `values` (one per iteration, iteration 0 first) as SVG.
#[must_use]
pub fn svg(title: &str, unit: &str, values: &[f64]) -> String {
    draw(title, unit, &[("c", "", values)])
}

/// Draws the best and, in grey, the mean of every iteration as SVG.
#[must_use]
pub fn svg_best_and_mean(title: &str, unit: &str, best: &[f64], mean: &[f64]) -> String {
    draw(title, unit, &[("m", "mean", mean), ("c", "best", best)])
}

/// Curves as (style, name at the right end, values); the last lies on top.
fn draw(title: &str, unit: &str, curves: &[(&str, &str, &[f64])]) -> String {
    let all = || curves.iter().flat_map(|curve| curve.2);
    let highest = all().copied().fold(0.0, f64::max);
    let longest = curves.iter().map(|curve| curve.2.len()).max().unwrap_or(0);
    let (step, decimals) = round_step(highest / 4.0);
    let top = if highest > 0.0 {
        (highest / step).ceil() * step
    } else {
        1.0
    };
    let count = longest.max(2) - 1;
    let x = |i: f64| LEFT + i / count as f64 * (WIDTH - LEFT - RIGHT);
    let y = |v: f64| HEIGHT - BOTTOM - v / top * (HEIGHT - TOP - BOTTOM);
    let mut out = String::new();
    let _ = write!(
        out,
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{title}">
<style>text{{font:13px system-ui,sans-serif;fill:#333}}.t{{font-size:15px;font-weight:600}}.g{{stroke:#ddd}}.c,.m{{fill:none;stroke:#3b6fd4;stroke-width:2}}.m{{stroke:#999}}text.name{{fill:#333;stroke:none}}</style>
<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>
<text class="t" x="{LEFT}" y="24">{title}</text>
"##
    );
    let mut level = 0.0;
    while level <= top * 1.0001 {
        let at = y(level);
        let _ = writeln!(
            out,
            r#"<line class="g" x1="{LEFT}" x2="{}" y1="{at:.1}" y2="{at:.1}"/><text x="{}" y="{:.1}" text-anchor="end">{level:.decimals$}</text>"#,
            WIDTH - RIGHT,
            LEFT - 8.0,
            at + 4.0
        );
        level += step;
    }
    let (stride, _) = round_step((count as f64 / 5.0).max(1.0));
    for k in 0..=(count as f64 / stride) as usize {
        let i = k as f64 * stride;
        let _ = writeln!(
            out,
            r#"<text x="{:.1}" y="{}" text-anchor="middle">{i}</text>"#,
            x(i),
            HEIGHT - BOTTOM + 20.0
        );
    }
    let _ = writeln!(
        out,
        r#"<text x="{}" y="{}" text-anchor="middle">iteration</text><text x="14" y="{}" transform="rotate(-90 14 {})" text-anchor="middle">{unit}</text>"#,
        (LEFT + WIDTH - RIGHT) / 2.0,
        HEIGHT - 10.0,
        HEIGHT / 2.0,
        HEIGHT / 2.0
    );
    let mut named_y = Vec::new();
    for (style, name, values) in curves.iter().rev() {
        if let Some(&last) = values.last().filter(|_| !name.is_empty()) {
            let at = y(last) - 6.0;
            // The names go from the top curve down, each a line below the one above it.
            let free = named_y.last().map_or(at, |above| at.max(above + LINE));
            named_y.push(free);
            let _ = writeln!(
                out,
                r#"<text class="name {style}" x="{:.1}" y="{free:.1}" text-anchor="end">{name}</text>"#,
                WIDTH - RIGHT,
            );
        }
    }
    for (style, _, values) in curves {
        let points: Vec<String> = values
            .iter()
            .enumerate()
            .map(|(i, &v)| format!("{:.1},{:.1}", x(i as f64), y(v)))
            .collect();
        let _ = writeln!(
            out,
            r#"<polyline class="{style}" points="{}"/>"#,
            points.join(" ")
        );
    }
    out.push_str("</svg>\n");
    out
}

/// A step of 1, 2 or 5 times a power of ten at or above `least`, and the decimals it needs.
fn round_step(least: f64) -> (f64, usize) {
    let mut decimals = 6usize;
    let mut power = 1e-6;
    while power < 1e9 {
        for factor in [1.0, 2.0, 5.0] {
            if factor * power >= least {
                return (factor * power, decimals);
            }
        }
        power *= 10.0;
        decimals = decimals.saturating_sub(1);
    }
    (least.max(1.0), 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_has_one_point_per_iteration_and_round_levels() {
        let drawn = svg("Best fitness", "m/s", &[0.0, 0.02, 0.05, 0.058]);
        let points = drawn
            .split("points=\"")
            .nth(1)
            .unwrap()
            .split('"')
            .next()
            .unwrap();
        assert_eq!(points.split(' ').count(), 4);
        assert!(drawn.contains(">0.02<") && drawn.contains(">0.06<"));
        // Ten iterations: 0 2 4 6 8, not 0 2 4 6 9.
        let ten = svg("Ten", "m/s", &[0.1; 10]);
        assert!(ten.contains(">8<") && !ten.contains(">9<"), "{ten}");
        assert!(svg("Nothing", "m/s", &[]).contains("</svg>"));
        let both = svg_best_and_mean("R", "F_meta", &[0.3, 0.4], &[0.1, 0.2]);
        assert_eq!(both.matches("<polyline").count(), 2);
        assert!(both.contains(">best<") && both.contains(">mean<"));
        // Names of curves that end together stand below each other.
        let near = svg_best_and_mean("R", "F_meta", &[0.3, 0.4], &[0.1, 0.399]);
        let name_y = |svg: &str, name: &str| -> f64 {
            let text = svg.split(&format!(">{name}<")).next().unwrap();
            let y = text.rsplit(" y=\"").next().unwrap();
            y.split('"').next().unwrap().parse().unwrap()
        };
        assert!(name_y(&near, "mean") - name_y(&near, "best") >= 14.0);
    }
}
