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
            (x0 + width, y0 + height + 15.0),
            11.0,
            "#555555",
            "end",
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
