//! Plots: curves as SVG that is stretched to the width of the page, all text as HTML, so that a phone shows both in full size.

use std::fmt::Write as _;

use super::words::escape;

/// A curve and its name.
pub(crate) struct Curve<'a> {
    /// As in the legend.
    pub(crate) name: &'a str,
    /// Colour: 0 measured, 1 before, 2 after.
    pub(crate) colour: usize,
    /// Points.
    pub(crate) points: Vec<(f64, f64)>,
}

/// What the axes show.
pub(crate) struct Axes<'a> {
    /// Over the plot.
    pub(crate) title: &'a str,
    /// Quantity and unit.
    pub(crate) x: &'a str,
    /// Quantity and unit.
    pub(crate) y: &'a str,
    /// Same scale on both axes, for maps.
    pub(crate) map: bool,
}

/// Ends of an axis and its round values between them.
struct Scale {
    low: f64,
    high: f64,
    ticks: Vec<f64>,
    decimals: usize,
}

impl Scale {
    fn new(low: f64, high: f64) -> Self {
        const MOST: f64 = 5.0;
        let width = (high - low).max(1e-9);
        // 1, 2 or 5 times a power of ten, the least with at most five steps.
        let (mut ten, mut decimals) = (1e-9, 9);
        let step = loop {
            let fits = |k: &&f64| width / (*k * ten) <= MOST;
            if let Some(k) = [1.0, 2.0, 5.0].iter().find(fits) {
                break k * ten;
            }
            ten *= 10.0;
            decimals -= i32::from(decimals > 0);
        };
        let first = (low / step).ceil();
        let count = ((low + width) / step - first + 1e-9).floor() as usize + 1;
        Self {
            low,
            high: low + width,
            ticks: (0..count).map(|i| (first + i as f64) * step).collect(),
            decimals: usize::try_from(decimals).unwrap_or(0),
        }
    }

    fn of(values: impl Iterator<Item = f64>) -> Self {
        let ends = (f64::INFINITY, f64::NEG_INFINITY);
        let (low, high) = values
            .filter(|x| x.is_finite())
            .fold(ends, |(a, b), x| (a.min(x), b.max(x)));
        if low > high {
            return Self::new(0.0, 1.0);
        }
        let margin = 0.04 * (high - low).max(1e-6);
        Self::new(low - margin, high + margin)
    }

    /// The same middle over another width.
    fn widened(&self, width: f64) -> Self {
        let middle = (self.low + self.high) / 2.0;
        Self::new(middle - width / 2.0, middle + width / 2.0)
    }

    /// Share of the axis below `x`.
    fn at(&self, x: f64) -> f64 {
        (x - self.low) / (self.high - self.low)
    }

    fn label(&self, x: f64) -> String {
        let x = if x.abs() < 1e-12 { 0.0 } else { x };
        format!("{x:.*}", self.decimals)
    }
}

/// One plot with axes, grid and legend.
pub(crate) fn plot(axes: &Axes<'_>, curves: &[Curve<'_>]) -> String {
    const SIZE: f64 = 1000.0;
    let points = || curves.iter().flat_map(|c| c.points.iter());
    let mut x = Scale::of(points().map(|p| p.0));
    let mut y = Scale::of(points().map(|p| p.1));
    if axes.map {
        let width = (x.high - x.low).max(y.high - y.low);
        (x, y) = (x.widened(width), y.widened(width));
    }
    let (right, up) = (|v: f64| SIZE * x.at(v), |v: f64| SIZE * (1.0 - y.at(v)));
    let mut s = format!(
        "<figure class=\"plot{}\"><figcaption>{}</figcaption><div class=\"ylabel\">{}</div><div class=\"yticks\">",
        if axes.map { " map" } else { "" },
        escape(axes.title),
        escape(axes.y)
    );
    for t in &y.ticks {
        let (top, label) = (100.0 * (1.0 - y.at(*t)), y.label(*t));
        let _ = write!(s, "<span style=\"top:{top:.1}%\">{label}</span>");
    }
    let _ = write!(
        s,
        "</div><svg viewBox=\"0 0 {SIZE} {SIZE}\" preserveAspectRatio=\"none\" role=\"img\" aria-label=\"{}: {} over {}\">",
        escape(axes.title),
        escape(axes.y),
        escape(axes.x)
    );
    let grid: String = y
        .ticks
        .iter()
        .map(|t| format!("M0 {:.1}H{SIZE}", up(*t)))
        .chain(
            x.ticks
                .iter()
                .map(|t| format!("M{:.1} 0V{SIZE}", right(*t))),
        )
        .collect();
    let _ = write!(s, "<path class=\"grid\" d=\"{grid}\"/>");
    // The measured one lies on top, what comes before the effects below what comes after.
    let (measured, simulated): (Vec<_>, Vec<_>) = curves.iter().partition(|c| c.colour == 0);
    for c in simulated.into_iter().chain(measured) {
        let points: Vec<String> = c
            .points
            .iter()
            .map(|(a, b)| format!("{:.1},{:.1}", right(*a), up(*b)))
            .collect();
        let (colour, points) = (c.colour, points.join(" "));
        let _ = write!(s, "<polyline class=\"k{colour}\" points=\"{points}\"/>");
    }
    s.push_str("</svg><div class=\"xticks\">");
    for t in &x.ticks {
        let (left, label) = (100.0 * x.at(*t), x.label(*t));
        let _ = write!(s, "<span style=\"left:{left:.1}%\">{label}</span>");
    }
    let _ = write!(s, "</div><div class=\"xlabel\">{}</div>", escape(axes.x));
    s.push_str("<div class=\"legend\">");
    for c in curves {
        let (colour, name) = (c.colour, escape(c.name));
        let _ = write!(s, "<span class=\"k{colour}\"><i></i>{name}</span> ");
    }
    s.push_str("</div></figure>");
    s
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let s = Scale::new(-0.83, 0.83);
        assert_eq!(s.ticks, [-0.5, 0.0, 0.5]);
        assert_eq!(s.label(s.ticks[0]), "-0.5");
        let s = Scale::new(0.0, 30.0);
        assert_eq!(s.ticks, [0.0, 10.0, 20.0, 30.0]);
        assert_eq!(s.label(30.0), "30");
        // A constant curve has a plot too.
        assert!(!Scale::of([2.0, 2.0].into_iter()).ticks.is_empty());
    }
}
