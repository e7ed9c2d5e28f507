//! The few SVG elements the pictures need.

use std::fmt::Write as _;

/// A picture being written.
#[derive(Debug)]
pub(super) struct Svg(String);

/// A point in pixels from the upper left corner.
pub(super) type Point = (f64, f64);

impl Svg {
    /// An empty white picture.
    pub(super) fn new(width: f64, height: f64) -> Self {
        let mut out = String::new();
        let _ = write!(
            out,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
             font-family=\"Helvetica, Arial, sans-serif\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n"
        );
        Self(out)
    }

    /// The finished file.
    pub(super) fn finish(mut self) -> String {
        self.0.push_str("</svg>\n");
        self.0
    }

    /// Text; `anchor` is start, middle or end.
    pub(super) fn text(
        &mut self,
        (x, y): Point,
        size: f64,
        colour: &str,
        anchor: &str,
        words: &str,
    ) {
        let words = escape(words);
        let _ = writeln!(
            self.0,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size}\" fill=\"{colour}\" text-anchor=\"{anchor}\">{words}</text>"
        );
    }

    /// A filled rectangle.
    pub(super) fn rect(&mut self, (x, y): Point, (width, height): Point, fill: &str, opacity: f64) {
        let _ = writeln!(
            self.0,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{fill}\" fill-opacity=\"{opacity}\"/>",
            width.max(0.0),
            height.max(0.0)
        );
    }

    /// A rectangle's outline.
    pub(super) fn frame(&mut self, (x, y): Point, (width, height): Point, colour: &str) {
        let _ = writeln!(
            self.0,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"none\" stroke=\"{colour}\"/>"
        );
    }

    /// A line through points.
    pub(super) fn line(&mut self, points: &[Point], colour: &str, width: f64) {
        let list = list(points);
        let _ = writeln!(
            self.0,
            "<polyline points=\"{list}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-linejoin=\"round\"/>"
        );
    }

    /// A filled shape with an outline.
    pub(super) fn polygon(&mut self, points: &[Point], fill: &str, stroke: &str, width: f64) {
        let list = list(points);
        let _ = writeln!(
            self.0,
            "<polygon points=\"{list}\" fill=\"{fill}\" stroke=\"{stroke}\" stroke-width=\"{width}\" stroke-linejoin=\"round\"/>"
        );
    }

    /// A filled circle with an outline.
    pub(super) fn circle(&mut self, (x, y): Point, radius: f64, fill: &str, stroke: &str) {
        let _ = writeln!(
            self.0,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" fill=\"{fill}\" stroke=\"{stroke}\" stroke-width=\"0.8\"/>"
        );
    }
}

fn list(points: &[Point]) -> String {
    let mut out = String::with_capacity(points.len() * 12);
    for (x, y) in points {
        let _ = write!(out, "{x:.1},{y:.1} ");
    }
    out.truncate(out.trim_end().len());
    out
}

fn escape(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c if c.is_control() => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}
