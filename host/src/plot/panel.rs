//! One diagram over time.

use super::svg::{Point, Svg};

/// A line in a diagram.
#[derive(Debug)]
pub(super) struct Curve {
    pub(super) colour: &'static str,
    pub(super) width: f64,
    /// Time in s, value.
    pub(super) points: Vec<(f64, f64)>,
}

/// A shaded time.
#[derive(Debug)]
pub(super) struct Band {
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) colour: &'static str,
}

/// A diagram over time.
#[derive(Debug)]
pub(super) struct Panel {
    pub(super) title: String,
    pub(super) note: String,
    pub(super) unit: &'static str,
    /// Smallest height of the value axis, so that noise does not fill the panel.
    pub(super) least_span: f64,
    pub(super) curves: Vec<Curve>,
}

/// Room for the value labels.
const LEFT: f64 = 52.0;
/// Room for the title.
const TOP: f64 = 18.0;
/// From the end of the time axis to its unit: beyond half the label of a tick that stands at the end.
const UNIT_GAP: f64 = 14.0;
/// Most points drawn per curve: one per half pixel.
const MAX_POINTS: usize = 2000;

impl Panel {
    /// Draws the panel with its upper left corner at `at`.
    pub(super) fn draw(
        &self,
        out: &mut Svg,
        at: Point,
        size: Point,
        span: (f64, f64),
        bands: &[Band],
    ) {
        let (x0, y0) = (at.0 + LEFT, at.1 + TOP);
        let (width, height) = (size.0 - LEFT, size.1 - TOP);
        let (low, high) = self.range();
        let length = (span.1 - span.0).max(1e-9);
        let x = |t: f64| x0 + ((t - span.0) / length).clamp(0.0, 1.0) * width;
        let y = |v: f64| y0 + height - (v - low) / (high - low) * height;
        out.text((x0, at.1 + 12.0), 13.0, "#111111", "start", &self.title);
        out.text(
            (at.0 + size.0, at.1 + 12.0),
            12.0,
            "#555555",
            "end",
            &self.note,
        );
        for band in bands {
            // Half a pixel at least: a single lost sample stays visible.
            let band_width = (x(band.to) - x(band.from)).max(1.0);
            out.rect((x(band.from), y0), (band_width, height), band.colour, 0.8);
        }
        for value in ticks(low, high, 5) {
            out.line(&[(x0, y(value)), (x0 + width, y(value))], "#e4e4e4", 0.8);
            out.text(
                (x0 - 6.0, y(value) + 4.0),
                11.0,
                "#555555",
                "end",
                &label(value),
            );
        }
        for t in ticks(span.0, span.1, 8) {
            out.line(
                &[(x(t), y0 + height), (x(t), y0 + height + 4.0)],
                "#999999",
                0.8,
            );
            out.text(
                (x(t), y0 + height + 15.0),
                11.0,
                "#555555",
                "middle",
                &label(t),
            );
        }
        out.text(
            (at.0 + 2.0, at.1 + 12.0),
            11.0,
            "#555555",
            "start",
            self.unit,
        );
        out.text(
            (x0 + width + UNIT_GAP, y0 + height + 15.0),
            11.0,
            "#555555",
            "start",
            "s",
        );
        out.frame((x0, y0), (width, height), "#999999");
        for curve in &self.curves {
            let step = curve.points.len().div_ceil(MAX_POINTS).max(1);
            let points: Vec<Point> = curve
                .points
                .iter()
                .step_by(step)
                .map(|(t, v)| (x(*t), y(*v)))
                .collect();
            out.line(&points, curve.colour, curve.width);
        }
    }

    /// Value range of all curves with a margin.
    fn range(&self) -> (f64, f64) {
        let values = || {
            self.curves
                .iter()
                .flat_map(|c| c.points.iter().map(|p| p.1))
                .filter(|v| v.is_finite())
        };
        let (low, high) = (
            values().fold(f64::INFINITY, f64::min),
            values().fold(f64::NEG_INFINITY, f64::max),
        );
        if low > high {
            return (0.0, self.least_span);
        }
        let missing = (self.least_span - (high - low)).max(0.0);
        let margin = 0.06 * (high - low) + 0.5 * missing;
        (low - margin, high + margin)
    }
}

/// Round values within a range, about `count` of them.
fn ticks(low: f64, high: f64, count: usize) -> Vec<f64> {
    let rough = (high - low) / count as f64;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .iter()
        .map(|m| m * power)
        .find(|s| *s >= rough)
        .unwrap_or(rough);
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    (first..=last).map(|i| i as f64 * step).collect()
}

/// A tick's label without noise digits.
fn label(value: f64) -> String {
    let rounded = (value * 1e4).round() / 1e4;
    format!("{}", if rounded == 0.0 { 0.0 } else { rounded })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The texts of a picture as (left, right, y, words), with 0.6 em a character, which is wide.
    fn texts(svg: &str) -> Vec<(f64, f64, f64, String)> {
        let value = |line: &str, key: &str| -> String {
            let from = line.split(&format!("{key}=\"")).nth(1).unwrap();
            from.split('"').next().unwrap().to_owned()
        };
        let number = |line: &str, key: &str| value(line, key).parse::<f64>().unwrap();
        let text = |line: &str| {
            let words = line.split('>').nth(1).unwrap().split('<').next().unwrap();
            let width = 0.6 * number(line, "font-size") * words.chars().count() as f64;
            let x = number(line, " x");
            let left = match value(line, "text-anchor").as_str() {
                "start" => x,
                "middle" => x - 0.5 * width,
                _ => x - width,
            };
            (left, left + width, number(line, " y"), words.to_owned())
        };
        let lines = svg.lines().filter(|line| line.starts_with("<text"));
        lines.map(text).collect()
    }

    #[test]
    fn no_label_lies_on_another() {
        for length_s in [5.0, 9.5, 30.0, 34.0, 60.0, 100.0, 3600.0] {
            let curve = |points| Curve {
                colour: "#000000",
                width: 1.0,
                points,
            };
            let panel = Panel {
                title: "0  A.M0".to_owned(),
                note: "error 1.00 deg rms".to_owned(),
                unit: "deg",
                least_span: 10.0,
                curves: vec![curve(vec![(0.0, -40.0), (length_s, 40.0)])],
            };
            let mut out = Svg::new(600.0, 200.0);
            panel.draw(&mut out, (10.0, 10.0), (560.0, 150.0), (0.0, length_s), &[]);
            let texts = texts(&out.finish());
            for (k, a) in texts.iter().enumerate() {
                for b in &texts[k + 1..] {
                    let apart = a.1 <= b.0 || b.1 <= a.0 || (a.2 - b.2).abs() >= 10.0;
                    assert!(apart, "{length_s} s: {a:?} lies on {b:?}");
                }
            }
        }
    }
}
